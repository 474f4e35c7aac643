//! Checks the driver enable against the bursts, on the chip's pins and on the mock: an enabled driver without pulses has DC on
//! its piezo.

use crate::bench::Played;
use crate::judge::{Boot, Finding};
use crate::log::Log;
use crate::pins::High;
use crate::time::{Grid, TICK};
use firmware_protocol::controller::{DRIVER_LEAD, DRIVER_TAIL};

/// Cycles from the enable to the first pulse.
const LEAD: u64 = DRIVER_LEAD as u64 * TICK;
/// Most cycles for which the drivers may be enabled without a pulse.
const IDLE: u64 = LEAD + DRIVER_TAIL as u64 * TICK;

impl Boot {
    pub(super) fn judge_drivers(&self, log: &Log, grid: Grid, findings: &mut Vec<Finding>) {
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
        findings.extend(differences(enabled, pulses, self.to));
    }
}

/// What is wrong with the intervals in which the drivers were enabled, given those with pulses on any line. A recording ends
/// at `end`.
fn differences(enabled: Vec<High>, mut pulses: Vec<High>, end: u64) -> Vec<Finding> {
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
            idle(idle_from, train.from, &mut findings);
            idle_from = idle_from.max(train.to);
        }
        idle(idle_from, to, &mut findings);
    }
    findings
}

fn idle(from: u64, to: u64, findings: &mut Vec<Finding>) {
    if to > from + IDLE {
        findings.push(Finding::Idle { from, to });
    }
}
