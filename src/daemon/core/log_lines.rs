//! Writes log lines about events and plays: one line for a play, at its end, and none for frequent events.

use crate::clock;
use crate::daemon::core::engine::Engine;
use crate::doctor::device::ON_NO_BOARD;
use crate::receipts::end_text;
use jiff::{SignedDuration, Zoned};
use meissner_api::{EndCause, Event, PlayState, Receipt};
use meissner_stream::time::HostInstant;
use std::fmt::Write;
use tracing::{info, warn};

/// Logs an event, if operators need it.
pub(in crate::daemon) fn log(engine: &Engine, event: &Event) {
    match event {
        Event::Connected { device } => {
            let (kind, firmware, boot) = (&*device.kind, &*device.firmware, device.boot);
            info!("device connected: {kind}, firmware {firmware}, boot {boot}");
            if device.simulated && device.telemetry {
                info!("telemetry: {ON_NO_BOARD}");
            }
        }
        Event::Disconnected { reason } if *reason == EndCause::AnotherDevice => info!("{reason}"),
        Event::Disconnected { reason } => {
            warn!("device disconnected: {reason}");
        }
        Event::Ended { receipt } => log_play(engine, receipt),
        Event::SensorFault { motor, fault } => {
            let cause = fault.text();
            warn!("motor {motor}: {cause}; it plays in open loop until the next `arm`");
        }
        Event::Contradiction { kind } => {
            warn!(
                "the device contradicts itself ({kind}): the daemon ignores the message, and turns the device off if \
                 it goes on; `meissner_contradictions_total` counts on"
            );
        }
        Event::Drifted { um } => {
            warn!(
                "without telemetry pins may be {um:.0} um off: `meissner home` between plays, or level them by hand"
            );
        }
        Event::Calibrated { id, motors, problem: None } => {
            info!("{} motors calibrated by play {id} and stored", motors.len());
        }
        Event::Calibrated { id, problem: Some(problem), .. } => {
            warn!("play {id} calibrated nothing: {problem}");
        }
        Event::Lost { events } => {
            warn!("the daemon was too slow for the streamer: {events} events are missing");
        }
        _ => {}
    }
}

/// The one line of a play.
fn log_play(engine: &Engine, receipt: &Receipt) {
    let client = engine.take_client(receipt.id);
    let user = client.map_or_else(|| "the daemon".to_owned(), |client| engine.names.user(client.uid));
    let (id, pattern) = (receipt.id, &*receipt.name);
    let wall = clock::now().1.to_zoned(engine.names.zone.clone());
    let outcome = outcome(receipt, HostInstant::now(), &wall);
    // Plays take time on the device, which bounds the number of their lines.
    info!(always = true, "play {id} {pattern} by {user}: {outcome}");
}

/// The outcome of a play that has just ended, in words.
fn outcome(receipt: &Receipt, now: HostInstant, wall: &Zoned) -> String {
    let mut text = end_text(receipt.state.name(), receipt.cause.as_ref(), receipt.duration_ms.cut_after);
    let Some(onset) = receipt.onset else { return text + ", it did not begin" };
    let began = HostInstant::from_ns(onset.monotonic_ns);
    let (since, until) = (now.since(began), began.since(now));
    let since = SignedDuration::try_from(since).unwrap_or_default()
        - SignedDuration::try_from(until).unwrap_or_default();
    // Counted back from the present wall clock, which may have been set since the play began.
    let at = wall.saturating_sub(since).strftime("%H:%M:%S%.6f");
    let (tick, us) = (onset.actual_tick, onset.uncertainty_ns.div_ceil(1000));
    // Writing to a string cannot fail.
    let _ = write!(text, ", began {at} (tick {tick}, ±{us} us)");
    let ordered_ms = receipt.duration_ms.ordered.filter(|_| receipt.state == PlayState::Done);
    let seconds = since.as_secs_f64().max(0.0).min(ordered_ms.map_or(f64::INFINITY, |ms| ms / 1e3));
    let _ = write!(text, ", {seconds:.1} s");
    let Some(bursts) = receipt.counts.bursts else { return text };
    let _ = if bursts.played == bursts.planned {
        write!(text, ", {} bursts", bursts.planned)
    } else {
        write!(text, ", {} of {} bursts", bursts.played, bursts.planned)
    };
    for (count, fate) in [(bursts.late, "late"), (bursts.dropped, "dropped"), (bursts.refused, "refused")] {
        if count > 0 {
            let _ = write!(text, ", {count} {fate}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::{BurstCounts, OnsetRecord, Terms};

    #[test]
    fn a_play_is_a_line_that_reads_alone() {
        let wall: Zoned = "2026-11-22T14:03:27.250000+01:00[+01:00]".parse().unwrap();
        let now = HostInstant::from_ns(20_126_544_000);
        let mut receipt = Receipt::new("edge-45", "0", 1, &Terms::default());
        receipt.duration_ms.ordered = Some(5000.0);
        receipt.state = PlayState::Stopped;
        receipt.cause = Some(EndCause::Stop);
        assert_eq!(outcome(&receipt, now, &wall), "stopped (stop), it did not begin");
        let (requested_tick, actual_tick, monotonic_ns, uncertainty_ns) =
            (0, 123_456, 15_000_000_000, 11_001);
        let latency_ms = 4.0;
        receipt.onset =
            Some(OnsetRecord { requested_tick, actual_tick, monotonic_ns, uncertainty_ns, latency_ms });
        receipt.counts.bursts =
            Some(BurstCounts { planned: 1200, played: 1190, late: 3, dropped: 7, ..BurstCounts::default() });
        let began = "began 14:03:22.123456 (tick 123456, ±12 us)";
        assert_eq!(
            outcome(&receipt, now, &wall),
            format!("stopped (stop), {began}, 5.1 s, 1190 of 1200 bursts, 3 late, 7 dropped")
        );
        (receipt.state, receipt.cause) = (PlayState::Done, None);
        receipt.counts.bursts = Some(BurstCounts { planned: 1200, played: 1200, ..BurstCounts::default() });
        assert_eq!(outcome(&receipt, now, &wall), format!("done, {began}, 5.0 s, 1200 bursts"));
    }
}
