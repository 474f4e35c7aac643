//! Checks the driver enable against the bursts, on the chip's pins and on the mock: an enabled driver without pulses has DC on
//! its piezo.

use crate::bench::Played;
use crate::judge::{Boot, Finding};
use crate::log::Log;
use crate::oracle::Expected;
use crate::pins::High;
use crate::time::{Grid, MS, TICK};
use firmware_protocol::controller::{DRIVER_TAIL, HORIZON};
use meissner_test_support::paper::DRIVER_LEAD;

/// Cycles from the enable to the first pulse.
const LEAD: u64 = DRIVER_LEAD as u64 * TICK;
/// Most cycles for which the drivers may be enabled without a pulse.
const IDLE: u64 = LEAD + DRIVER_TAIL as u64 * TICK;
/// Most cycles from the sending of a frame to the first tick that is rendered without the moves which it withdraws.
const WITHDRAWN: u64 = 5 * MS + HORIZON as u64 * TICK;

impl Boot {
    pub(super) fn judge_drivers(
        &self,
        log: &Log,
        expected: &Expected,
        grid: Grid,
        findings: &mut Vec<Finding>,
    ) {
        let (enabled, pulses): (Vec<_>, Vec<_>) = match &self.played {
            Played::Ticks(_) => (
                log.drivers
                    .iter()
                    .map(|&(from, to)| High { from: grid.cycle(from), to: grid.cycle(to) })
                    .collect(),
                log.lines
                    .iter()
                    .flatten()
                    .map(|train| High { from: grid.cycle(train.start), to: grid.cycle(train.end()) })
                    .collect(),
            ),
            Played::Pins(pins) => (
                pins.enable.clone(),
                pins.lines
                    .iter()
                    .flatten()
                    .map(|train| High { from: train.cycle, to: train.cycle + train.pulses * TICK })
                    .collect(),
            ),
        };
        // A move may be withdrawn, flushed or refused when the drivers are already on for it.
        let leads = expected.replaced.iter().map(|&(up, sent)| {
            let up = grid.cycle(up);
            High { from: up.saturating_sub(LEAD), to: up.min(sent + WITHDRAWN) }
        });
        let silent =
            expected.silent.iter().map(|&(from, to)| High { from: grid.cycle(from), to: grid.cycle(to) });
        findings.extend(differences(enabled, pulses, joined(leads.chain(silent).collect()), self.to));
    }
}

/// The same intervals in order and apart, without empty ones.
fn joined(mut intervals: Vec<High>) -> Vec<High> {
    intervals.sort_unstable_by_key(|interval| interval.from);
    let mut joined: Vec<High> = Vec::new();
    for interval in intervals.into_iter().filter(|interval| interval.from < interval.to) {
        match joined.last_mut() {
            Some(last) if interval.from <= last.to => last.to = last.to.max(interval.to),
            _ => joined.push(interval),
        }
    }
    joined
}

/// What is wrong with the intervals in which the drivers were enabled, given those with pulses on any line and the leads of
/// moves without a pulse. A recording ends at `end`.
fn differences(enabled: Vec<High>, mut pulses: Vec<High>, leads: Vec<High>, end: u64) -> Vec<Finding> {
    pulses.sort_unstable_by_key(|train| train.from);
    let (mut findings, mut pulses) = (Vec::new(), pulses.into_iter().peekable());
    for High { from, to } in enabled {
        let to = to.min(end);
        // Pulses outside of the enable are found elsewhere.
        while pulses.next_if(|train| train.to <= from).is_some() {}
        if let Some(first) = pulses.peek().filter(|first| first.from < to && first.from < from + LEAD) {
            findings.push(Finding::Lead { enabled: from, pulse: first.from });
        }
        let mut idle_from = from;
        while let Some(train) = pulses.next_if(|train| train.from < to) {
            idle(idle_from, train.from, &leads, &mut findings);
            idle_from = idle_from.max(train.to);
        }
        idle(idle_from, to, &leads, &mut findings);
    }
    findings
}

fn idle(from: u64, to: u64, leads: &[High], findings: &mut Vec<Finding>) {
    if to <= from + IDLE {
        return;
    }
    let excused: u64 = leads.iter().map(|lead| lead.to.min(to).saturating_sub(lead.from.max(from))).sum();
    if to > from + IDLE + excused {
        findings.push(Finding::Idle { from, to });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The drivers may wait for a stroke until it is withdrawn, and no longer.
    #[test]
    fn a_withdrawn_stroke_excuses_its_lead_alone() {
        let high = |from: u64, to: u64| High { from: from * TICK, to: to * TICK };
        let pulses = || vec![high(143, 150), high(200, 210)];
        let enabled = || vec![high(100, 212)];
        assert_eq!(differences(enabled(), pulses(), Vec::new(), 10_000 * TICK).len(), 1);
        assert_eq!(differences(enabled(), pulses(), vec![high(152, 157)], 10_000 * TICK), []);
        assert_eq!(differences(enabled(), pulses(), vec![high(153, 157)], 10_000 * TICK).len(), 1);
        let leads = joined(vec![high(30, 40), high(10, 20), high(15, 18), high(25, 25), high(20, 22)]);
        assert_eq!(leads, [high(10, 22), high(30, 40)]);
    }
}
