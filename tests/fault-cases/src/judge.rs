//! What a run has shown, and whether that is what its case expects.
//!
//! A runner fills in [`Seen`] from the recorded lines and the receipt, and [`Observed`] from what host and device counted.

use crate::PLAY;
use crate::case::{Ends, Evidence, Expect};
use firmware_protocol::controller::Run;
use firmware_protocol::stroke::Lines;
use firmware_protocol::tick::Tick;
use meissner_api::ErrorSource;
use meissner_stream::queues::{Snapshot, StreamEvent};

/// What became of the play.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// The play came to its end.
    pub is_done: bool,
    /// Of a play that was cut: from the last fault until all lines were low for good.
    pub safe_ms: Option<f64>,
    /// The device is latched at the end.
    pub is_latched: bool,
    /// Bursts that were not played, of those planned.
    pub lost: u64,
    pub planned: u64,
}

impl Seen {
    pub fn lost_percent(&self) -> f64 {
        100.0 * self.lost as f64 / self.planned.max(1) as f64
    }
}

/// What host and device counted while the fault lasted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Observed {
    pub resent: u64,
    pub unread: u64,
    pub unread_by_device: u64,
    pub contradictions: u64,
    /// By how many millionths the host's estimate of the device's clock ran off, at most, either way.
    pub rate_ppm: f64,
    pub sensors_set_aside: u64,
    /// Frames that the runner's line lost, repeated, damaged, delayed or held back.
    pub harmed: u64,
    /// Most motors that the play drives and whose position the host knew by dead reckoning only, at any time after the fault
    /// began.
    pub unmeasured: u64,
}

impl Observed {
    /// What the streamer has told.
    pub fn told(events: &[StreamEvent]) -> Self {
        let snapshots = events.iter().filter_map(|event| match event {
            StreamEvent::Snapshot(snapshot) if snapshot.connected => Some(snapshot),
            _ => None,
        });
        let snapshots: Vec<&Snapshot> = snapshots.collect();
        let most =
            |count: fn(&Snapshot) -> u64| snapshots.iter().map(|snapshot| count(snapshot)).max().unwrap_or(0);
        let count = |is: fn(&StreamEvent) -> bool| events.iter().filter(|event| is(event)).count() as u64;
        let rates = snapshots.windows(8).map(|some| {
            let (first, last) = (some[0], some[7]);
            let ticks = last.tick.since(first.tick) as f64;
            1e6 * (ticks / 85_000.0 / last.at.since(first.at).as_secs_f64() - 1.0).abs()
        });
        Self {
            resent: most(|snapshot| snapshot.traffic.retransmitted),
            unread: most(|snapshot| {
                let frames = snapshot.traffic.bad;
                frames.crc + frames.malformed + frames.too_long
            }),
            contradictions: count(|event| matches!(event, StreamEvent::Contradiction(_))),
            rate_ppm: rates.fold(0.0, f64::max),
            sensors_set_aside: count(|event| matches!(event, StreamEvent::SensorFault { .. })),
            unmeasured: most(unmeasured),
            ..Self::default()
        }
    }

    pub fn shows(&self, evidence: Evidence) -> bool {
        match evidence {
            Evidence::Resent => self.resent > 0,
            Evidence::Unread => self.unread > 0,
            Evidence::UnreadByDevice => self.unread_by_device > 0,
            Evidence::Contradictions => self.contradictions > 0,
            Evidence::Rate => self.rate_ppm > 50.0,
            Evidence::SensorSetAside => self.sensors_set_aside > 0,
            Evidence::Line => self.harmed > 0,
            Evidence::Unmeasured => self.unmeasured > 0,
        }
    }
}

impl Expect {
    /// Judges a run. `allowance_ms` is added to the bound on time: for what the runner cannot measure exactly.
    ///
    /// # Errors
    /// What was not as expected, in one line.
    pub fn judge(&self, seen: &Seen, observed: &Observed, allowance_ms: f64) -> Result<(), String> {
        if seen.planned == 0 {
            return Err("the play was cut before anything of it was sent".to_owned());
        }
        if (self.play == Ends::Done) != seen.is_done && self.play != Ends::Any {
            let ended = if seen.is_done { "done" } else { "cut" };
            return Err(format!("the play was {ended}, expected {:?}", self.play));
        }
        if self.latched && !seen.is_latched {
            return Err("the e-stop did not reach the device".to_owned());
        }
        if let Some(evidence) = self.shows
            && !observed.shows(evidence)
        {
            return Err(format!("nothing shows that the fault happened: {evidence:?}, {observed:?}"));
        }
        if let (Some(most), Some(ms)) = (self.safe_ms, seen.safe_ms)
            && ms > most + allowance_ms
        {
            let most = most + allowance_ms;
            return Err(format!(
                "lines were high until {ms:.2} ms after the fault, expected {most} ms at most"
            ));
        }
        let (lost, most) = (seen.lost_percent(), self.lost_percent);
        if seen.is_done && lost > most {
            return Err(format!("{lost:.1} % of the bursts were lost, expected {most} % at most"));
        }
        Ok(())
    }
}

/// Motors whose position is known by dead reckoning only, in the second half of a play.
fn unmeasured(snapshot: &Snapshot) -> u64 {
    let half = PLAY.as_secs_f64() / 2.0;
    let sources =
        snapshot.pins.rest.source.iter().filter(|source| matches!(source, ErrorSource::DeadReckoning));
    if snapshot.play.is_some_and(|(_, played_s)| played_s > half) { sources.count() as u64 } else { 0 }
}

/// Milliseconds from the fault to the last pulse.
pub fn high_until(trace: &[(Tick, Run)], fault: Option<Tick>) -> f64 {
    let high = trace.iter().rev().find(|(_, run)| run.lines != Lines::OFF);
    let last = high.map_or(Tick(0), |(tick, run)| *tick + u64::from(run.ticks));
    // A board that has just started was not there when the fault began: all its pulses come after it.
    let fault = fault.or(trace.first().map(|(tick, _)| *tick));
    fault.map_or(0.0, |fault| (last.since(fault).max(0)) as f64 / 85.0)
}
