//! Judges a play that has met faults: by its case, by the judge of boots, by the compiled strokes and by the accounts of the plays.

use crate::judge::{Boot, Judged, differences};
use crate::scenario::compiled;
use crate::time::MS;
use firmware_protocol::stroke::Direction;
use meissner_fault_cases::{Case, Observed, Seen};
use meissner_stream::queues::{End, Outcome, StreamEvent};
use meissner_test_support::paper::MOTORS;

/// For so many cycles all lines have to be low before the next play.
const RESTS: u64 = 200 * MS;

/// What a run came to, before the next play and after it.
pub(super) struct Verdict {
    /// When the last fault began.
    pub(super) fault: u64,
    /// When the last pulse before the next play fell.
    pub(super) low_since: u64,
    /// When everything was mended, and the lines had to be at rest.
    pub(super) rested_at: u64,
    pub(super) is_latched: bool,
    pub(super) observed: Observed,
    pub(super) restarts: u32,
    /// The play that met the faults, and the next one.
    pub(super) plays: [u64; 2],
}

impl Verdict {
    pub(super) fn judge(&self, case: &Case, boots: &[Boot], notices: &[StreamEvent]) -> Result<Seen, String> {
        let [first, next] = self.plays.map(|play| ended(notices, play));
        let (first, next) = (first?, next?);
        let is_done = first.end == End::Done;
        let safe_ms = (!is_done).then(|| self.low_since.saturating_sub(self.fault) as f64 / MS as f64);
        let seen = Seen {
            is_done,
            safe_ms,
            is_latched: self.is_latched,
            lost: first.bursts.planned - first.bursts.played,
            planned: first.bursts.planned,
        };
        case.expect.judge(&seen, &self.observed, 0.0)?;
        if self.low_since + RESTS > self.rested_at {
            let ago = self.rested_at.saturating_sub(self.low_since) as f64 / MS as f64;
            return Err(format!("the lines do not come to rest: the last pulse was {ago:.1} ms ago"));
        }
        if next.end != End::Done || next.bursts.played != next.bursts.planned {
            return Err(format!("the next play is not whole: {:?}, {:?}", next.end, next.bursts));
        }
        let judged: Vec<Judged> = boots.iter().map(Boot::judge).collect();
        let findings: Vec<String> =
            judged.iter().flat_map(|boot| &boot.findings).map(ToString::to_string).collect();
        if !findings.is_empty() {
            return Err(format!("the pins: {}", findings.join("; ")));
        }
        for outcome in [first, next] {
            as_compiled(outcome, &judged)?;
        }
        if self.restarts == 0 {
            returned(&judged)?;
        }
        Ok(seen)
    }
}

/// The outcome of a play, in which every planned burst has one fate.
fn ended(notices: &[StreamEvent], play: u64) -> Result<&Outcome, String> {
    let outcome = notices.iter().find_map(|notice| match notice {
        StreamEvent::PlayEnded { id, outcome } if *id == play => Some(outcome),
        _ => None,
    });
    let outcome = outcome.ok_or_else(|| format!("play {play} did not end"))?;
    let bursts = outcome.bursts;
    let fates = bursts.played + bursts.late + bursts.dropped + bursts.refused + bursts.replaced;
    if bursts.planned == fates {
        Ok(outcome)
    } else {
        Err(format!("the receipt of play {play} does not add up: {bursts:?}"))
    }
}

/// The pulses of a play of which nothing was lost are its strokes, tick for tick.
fn as_compiled(outcome: &Outcome, boots: &[Judged]) -> Result<(), String> {
    let bursts = outcome.bursts;
    let (Some(onset), Some(length)) = (outcome.onset.map(|onset| onset.actual), outcome.play.strokes.end())
    else {
        return Ok(());
    };
    if outcome.end != End::Done || bursts.played != bursts.planned {
        return Ok(());
    }
    let wanted = compiled(&outcome.play.strokes, onset);
    let boot = boots.iter().find(|boot| boot.expected.onsets.contains(&onset));
    let boot = boot.ok_or("no board has reported the onset of a play that is done")?;
    let found = boot.log.within(onset, onset + length);
    match differences(&found, &wanted).first() {
        None => Ok(()),
        Some(difference) => Err(format!("against its strokes: {difference}")),
    }
}

/// Every pin is where it began, counted in pulses; a pulse that an e-stop has cut off may be missing in the recording.
fn returned(boots: &[Judged]) -> Result<(), String> {
    let cut_off =
        boots.iter().flat_map(|boot| &boot.expected.cuts).filter(|cut| cut.return_ticks.is_none()).count()
            as i64;
    let mut net = [0_i64; MOTORS];
    for (net, line) in net.iter_mut().zip(boots.iter().flat_map(|boot| &boot.log.lines)) {
        for train in line {
            let sign = if train.direction == Direction::Up { 1 } else { -1 };
            *net += sign * train.pulses as i64;
        }
    }
    if net.iter().all(|net| net.abs() <= cut_off) {
        Ok(())
    } else {
        Err(format!("pins are not where they began, pulses: {net:?}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::{Log, Train};
    use crate::oracle::{CutAt, Expected};
    use crate::time::Grid;
    use firmware_protocol::message::Cause;
    use firmware_protocol::tick::Tick;

    /// A pin that is so many pulses up after a boot with these cuts.
    fn boot(up: u64, returns: Option<bool>) -> Judged {
        let train = |start, direction, pulses| Train { start: Tick(start), direction, pulses };
        let log =
            Log::of(vec![(3, train(1_000, Direction::Up, 20)), (3, train(1_100, Direction::Down, 20 - up))]);
        let cuts = returns.map(|returns| CutAt {
            cause: Cause::EStop,
            at: Tick(1_120),
            return_ticks: returns.then_some(0),
            outstanding: 0,
        });
        let expected = Expected { cuts: cuts.into_iter().collect(), ..Expected::default() };
        Judged { findings: Vec::new(), log, expected, grid: Grid { origin: 0 } }
    }

    #[test]
    fn a_pin_that_stays_up_is_told_but_for_the_pulse_that_an_e_stop_cuts_off() {
        assert!(returned(&[boot(0, None)]).is_ok());
        assert!(returned(&[boot(1, None)]).unwrap_err().contains("pins are not where they began"));
        assert!(returned(&[boot(1, Some(true))]).is_err());
        assert!(returned(&[boot(1, Some(false))]).is_ok());
        assert!(returned(&[boot(2, Some(false))]).is_err());
    }
}
