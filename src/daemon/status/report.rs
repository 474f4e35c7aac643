//! The status, as JSON for clients and as a line for the service manager.
//!
//! Invariant: a status is read under one lock, so its parts are consistent.

use crate::daemon::core::engine::Engine;
use crate::daemon::sessions::caller::Asker;
use crate::exposure::Now;
use crate::receipts::{DeviceState, board_status};
use meissner_api::{ClockSample, MotorStatus, PinMovement, QueuedPlay, Session, StandingPins, Status};
use meissner_stream::queues::Snapshot;
use meissner_stream::time::HostInstant;
use std::fmt::Write as _;

/// `GET /v1/status` for this client.
pub(in crate::daemon) fn status(engine: &Engine, by: Option<&Asker>) -> Status {
    let daemon = engine.lock();
    let receipts = &daemon.plays.receipts;
    let DeviceState { state, cause, position } = receipts.device_state();
    let (now, wall_ns) = HostInstant::now_with_wall();
    let clock = receipts.clock(now);
    let snapshot = receipts.snapshot();
    let used = daemon.calibration.in_use().map(|stored| &stored.calibration);
    let is_calibrated = |motor: u8| used.is_some_and(|calibration| calibration.motor(motor).is_some());
    let (role, mine) = daemon.role_of(by);
    let motor = |at: &Snapshot, motor: u8| {
        let index = usize::from(motor);
        MotorStatus {
            rest_error_um: at.rest_error_um[index],
            source: at.source[index],
            calibrated: is_calibrated(motor),
            sensor_fault: at.sensor_faults[index],
            now: movement(at, motor),
        }
    };
    Status {
        state: state.to_owned(),
        cause,
        armed: daemon.armed.status(),
        estops: engine.estops.switch.newest(),
        estop_off_ms: engine.estops.switch.confirmed_after().map(|after| after.as_secs_f64() * 1e3),
        position: position.to_owned(),
        standing: snapshot.and_then(|at| standing(at, now)),
        device: receipts.device(),
        array: daemon.settings.array.name().to_owned(),
        device_identity: daemon.calibration.identity.clone(),
        requested_device: engine.wanted.clone(),
        no_device_reason: daemon.connection.missing.clone(),
        play: receipts.running(),
        queued: receipts
            .queued()
            .map(|receipt| QueuedPlay {
                id: receipt.id,
                pattern: receipt.pattern.clone(),
                waits_for_edge: receipt.on_edge_ms.is_some() && receipt.start_edge.is_none(),
            })
            .collect(),
        last_play: receipts.last().map(|receipt| receipt.id),
        last_rendering: daemon.renderings.last_id(),
        tick: clock.map(|(tick, _)| tick.0),
        clock_uncertainty_us: clock.map(|(_, uncertainty_us)| uncertainty_us),
        clock: clock.map(|(tick, uncertainty_us)| ClockSample {
            tick: tick.0,
            tick_hz: daemon.settings.array.rate().hz(),
            monotonic_ns: now.as_ns(),
            wall_ns,
            uncertainty_us,
        }),
        lead_ms: snapshot.map_or(daemon.settings.lead_ms, |snapshot| snapshot.lead_ms),
        lease_ms: daemon.settings.lease_ms,
        line_bytes_per_s: snapshot.filter(|at| at.connected).and_then(|at| at.line_bytes_per_s),
        drift_limit_um: daemon.settings.drift_limit_um,
        board: snapshot.filter(|at| at.connected).and_then(|at| at.board).map(|board| board_status(&board)),
        contradictions: snapshot.map_or(0, |at| at.traffic.contradictions.total()),
        motors: snapshot
            .map(|at| at.settings.array.numbers().map(|number| motor(at, number)).collect())
            .unwrap_or_default(),
        calibrated: used.map(|calibration| {
            calibration.provenance().date.clone().unwrap_or_else(|| "without a date".to_owned())
        }),
        session: daemon.session().map(|session| Session { mine: Some(mine), ..session }),
        role,
        participant: daemon.exposure.status(Now::read()),
        realtime: engine.realtime,
        logbook_problem: daemon
            .publisher
            .session_record
            .problem()
            .or_else(|| daemon.exposure.problem())
            .or_else(|| daemon.publisher.session_record.gaps()),
        logbook_lost: daemon.publisher.session_record.lost(),
        socket: engine.socket.display().to_string(),
        network: engine.gate.status(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        pid: std::process::id(),
    }
}

/// The status in one line.
pub(in crate::daemon) fn status_line(engine: &Engine) -> String {
    let daemon = engine.lock();
    let receipts = &daemon.plays.receipts;
    let DeviceState { state, cause, .. } = receipts.device_state();
    let mut line = match (receipts.device(), &daemon.connection.missing) {
        (Some(device), _) if device.simulated => format!("{state} ({cause}); {}, simulated", device.kind),
        (Some(device), _) => format!("{state} ({cause}); {}", device.kind),
        (None, Some(missing)) => format!("no device: {missing}"),
        (None, None) => format!("no device yet: looking for `{}`", engine.wanted),
    };
    // Writing to a string does not fail.
    if let Some(standing) = receipts.snapshot().and_then(|at| standing(at, HostInstant::now())) {
        let _ = write!(line, "; {}", standing.text());
    }
    if let Some(play) = receipts.running() {
        let _ = write!(line, "; plays {} (play {})", play.pattern, play.id);
    }
    match receipts.queued().count() {
        0 => {}
        queued => drop(write!(line, "; {queued} queued")),
    }
    let problem = daemon.publisher.session_record.problem();
    if let Some(problem) = problem.or_else(|| daemon.exposure.problem()) {
        let _ = write!(line, "; {problem}");
    }
    line
}

fn tenths(number: f64) -> f64 {
    (10.0 * number).round() / 10.0
}

/// The pins that stand above rest, and since when.
fn standing(at: &Snapshot, now: HostInstant) -> Option<StandingPins> {
    let (pulses, since) = at.standing?;
    let height_um = tenths(f64::from(pulses) * at.settings.array.motor().um_per_pulse);
    Some(StandingPins { height_um, age_s: tenths(now.since(since).as_secs_f64()) })
}

/// What a pin does, unless nothing tells.
fn movement(at: &Snapshot, motor: u8) -> Option<PinMovement> {
    if !at.connected || !at.position_known {
        return None;
    }
    let of = at.movements.get(usize::from(motor))?;
    let um_per_pulse = at.settings.array.motor().um_per_pulse;
    let [low, high] = [of.low, of.high].map(|pulses| f64::from(pulses) * um_per_pulse);
    let (height_um, swing_um) = (tenths(f64::midpoint(low, high)), tenths(high - low));
    Some(PinMovement { height_um, swing_um, hz: tenths(of.hz.into()) })
}
