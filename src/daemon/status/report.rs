//! The status, as JSON for clients and as a line for the service manager.
//!
//! Invariant: a status is read under one lock, so its parts are consistent.

use crate::daemon::core::engine::Engine;
use crate::daemon::sessions::caller::Asker;
use crate::exposure::Now;
use crate::receipts::{DeviceState, board_status};
use meissner_api::{
    ClockSample, DaemonStatus, EStopStatus, LinkStatus, MotorStatus, Newest, PinMovement, QueuedPlay,
    Session, StandingPins, Status,
};
use meissner_stream::queues::Snapshot;
use meissner_stream::time::HostInstant;
use std::fmt::Write as _;

/// `GET /v1/status` for this client.
pub(in crate::daemon) fn status(engine: &Engine, by: Option<&Asker>) -> Status {
    let daemon = engine.lock();
    let receipts = &daemon.plays.receipts;
    let DeviceState { state, cause, position } = receipts.device_state();
    let (now, wall_ns) = HostInstant::now_with_wall();
    let snapshot = receipts.snapshot();
    let used = daemon.calibration.in_use().map(|stored| &stored.calibration);
    let is_calibrated = |motor: u8| used.is_some_and(|calibration| calibration.motor(motor).is_some());
    let (role, mine) = daemon.role_of(by);
    let motor = |at: &Snapshot, motor: u8| {
        let index = usize::from(motor);
        MotorStatus {
            rest_error_um: at.pins.rest.um[index],
            source: at.pins.rest.source[index],
            calibrated: is_calibrated(motor),
            sensor_fault: at.pins.sensor_faults[index],
            now: movement(at, motor),
        }
    };
    let settings = &daemon.settings;
    let orders = engine.estops.switch.newest();
    let at_link = snapshot.filter(|at| at.connected);
    let record = &daemon.publisher.record;
    Status {
        state: state.to_owned(),
        cause,
        position: position.to_owned(),
        armed: daemon.armed.status(),
        standing: snapshot.and_then(|at| standing(at, now)),
        estop: EStopStatus {
            orders,
            by: daemon
                .last_estop
                .filter(|(number, _)| *number == orders)
                .map(|(_, by)| engine.names.client(by)),
            age_s: engine.estops.switch.newest_at().map(|at| now.since(at).as_secs_f64()),
            off_ms: engine.estops.switch.confirmed_after().map(|after| after.as_secs_f64() * 1e3),
        },
        device: receipts.device(),
        link: LinkStatus {
            wanted: engine.wanted.clone(),
            missing: daemon.connection.missing.clone(),
            identity: daemon.calibration.identity.clone(),
            bytes_per_s: at_link.and_then(|at| at.line_bytes_per_s),
            contradictions: snapshot.map_or(0, |at| at.traffic.contradictions.total()),
            board: at_link.and_then(|at| at.board).map(|board| board_status(&board)),
        },
        play: receipts.running(),
        queued: receipts
            .queued()
            .map(|receipt| QueuedPlay {
                id: receipt.id,
                name: receipt.name.clone(),
                waits_for_edge: receipt.order.terms.on_edge_ms.is_some() && receipt.edges.start.is_none(),
            })
            .collect(),
        newest: Newest {
            play: receipts.last().map(|receipt| receipt.id),
            rendering: daemon.renderings.last_id(),
        },
        clock: receipts.clock(now).map(|(tick, uncertainty_us)| ClockSample {
            tick: tick.0,
            tick_hz: settings.array.rate().hz(),
            monotonic_ns: now.as_ns(),
            wall_ns,
            uncertainty_us,
        }),
        motors: snapshot
            .map(|at| at.settings.array.numbers().map(|number| motor(at, number)).collect())
            .unwrap_or_default(),
        session: daemon.session().map(|session| Session { mine: Some(mine), ..session }),
        participant: daemon.exposure.status(Now::read()),
        daemon: DaemonStatus {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            pid: std::process::id(),
            socket: engine.socket.display().to_string(),
            network: engine.gate.status(),
            role,
            realtime: engine.realtime,
            array: settings.array.name().to_owned(),
            calibrated: used.map(|calibration| {
                calibration.provenance().date.clone().unwrap_or_else(|| "without a date".to_owned())
            }),
            drift_limit_um: settings.drift_limit_um,
            lead_ms: snapshot.map_or(settings.lead_ms, |snapshot| snapshot.lead_ms),
            lease_ms: settings.lease_ms,
            logbook_problem: record
                .problem()
                .or_else(|| daemon.exposure.problem())
                .or_else(|| record.found()),
            logbook_lost: record.lost(),
        },
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
        let _ = write!(line, "; plays {} (play {})", play.name, play.id);
    }
    match receipts.queued().count() {
        0 => {}
        queued => drop(write!(line, "; {queued} queued")),
    }
    let problem = daemon.publisher.record.problem();
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
    let (pulses, since) = at.pins.standing?;
    let height_um = tenths(f64::from(pulses) * at.settings.array.motor().um_per_pulse);
    Some(StandingPins { height_um, age_s: tenths(now.since(since).as_secs_f64()) })
}

/// What a pin does, unless nothing tells.
fn movement(at: &Snapshot, motor: u8) -> Option<PinMovement> {
    if !at.connected || !at.position_known {
        return None;
    }
    let of = at.pins.movements.get(usize::from(motor))?;
    let um_per_pulse = at.settings.array.motor().um_per_pulse;
    let [low, high] = [of.low, of.high].map(|pulses| f64::from(pulses) * um_per_pulse);
    let (height_um, swing_um) = (tenths(f64::midpoint(low, high)), tenths(high - low));
    Some(PinMovement { height_um, swing_um, hz: tenths(of.hz.into()) })
}
