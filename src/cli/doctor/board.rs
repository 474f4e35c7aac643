//! The doctor's look at a device: it opens it, measures, and judges what it found.
//!
//! Bounds of what is good stand here, each with its reason. The device is closed again before anything is printed.

use super::{Examined, Finding, Level, port};
use crate::cli::text;
use crate::receipts::device_info;
use firmware_protocol::frame::PROTOCOL;
use meissner_api::DeviceInfo;
use meissner_array::simulated::PlantConfig;
use meissner_stream::Settings;
use meissner_stream::device::{self, DeviceError, Spec};
use meissner_stream::diagnostics::{self, LinkReport};
use std::path::{Path, PathBuf};

/// A line that carries less refuses some of the shipped patterns, their corrections included.
const ALL_BYTES_PER_S: u32 = 60_000;
/// Below this not even a few pins can be driven.
const ANY_BYTES_PER_S: u32 = 2_000;
/// A correction leaves its burst so much time to be there, us: slower round trips make it late.
const CORRECTION_US: f64 = 3_000.0;
/// A crystal is within 50 ppm, two of them within 100; what is beyond is no crystal.
const CRYSTALS_PPM: f64 = 100.0;
/// The clock model takes a drift beyond this for noise.
const MODEL_PPM: f64 = 200.0;

/// Opens and measures; what there is to tell of it goes into `findings`.
pub(super) fn examine(root: &Path, spec: &Spec, findings: &mut Vec<Finding>) -> Option<Examined> {
    let mut device = match device::open(spec, &PlantConfig::default()) {
        Ok(device) => device,
        Err(error) => {
            findings.push(Finding::new("device", Level::Fail, error.found(), &error.advice()));
            findings.extend(taken(&error).and_then(|path| port::holders(root, &path, true)));
            return None;
        }
    };
    let (kind, serial_number) = (device.kind(), device.serial_number().map(str::to_owned));
    let checked = diagnostics::measure(&mut device);
    drop(device);
    // Who had it open before we did reads what is ours.
    if let Spec::Serial(path) = spec {
        findings.extend(port::holders(root, path, false));
    }
    let checked = match checked {
        Ok(checked) => checked,
        Err(error) => {
            let found = format!("{kind}: {error}");
            findings.push(Finding::new("device", Level::Fail, found, error.advice()));
            return None;
        }
    };
    let examined = examined(&kind, serial_number, &checked);
    findings.extend(judged(&examined));
    Some(examined)
}

/// What another program may have open, if that is what is wrong.
fn taken(error: &DeviceError) -> Option<PathBuf> {
    match error {
        DeviceError::InUse(path) => Some(path.clone()),
        DeviceError::UsbInUse(place) => Some(Path::new("/dev/bus/usb").join(place)),
        _ => None,
    }
}

fn examined(kind: &str, serial_number: Option<String>, checked: &LinkReport) -> Examined {
    let DeviceInfo { kind, firmware, build, boot, simulated, telemetry } = device_info(kind, &checked.hello);
    Examined {
        kind,
        serial_number,
        firmware,
        build,
        protocol: PROTOCOL,
        boot,
        simulated,
        telemetry,
        pool: checked.hello.pool,
        horizon_ticks: checked.hello.horizon,
        round_trip: checked.round_trip,
        throughput_bytes_per_s: checked.throughput_bytes_per_s,
        drift: checked.drift,
    }
}

fn judged(at: &Examined) -> Vec<Finding> {
    let serial =
        at.serial_number.as_deref().map_or_else(String::new, |serial| format!(", serial number {serial}"));
    let who = format!(
        "{}{serial}, firmware {} ({}), protocol {}, boot {}, {} slots, horizon {} ticks",
        at.kind, at.firmware, at.build, at.protocol, at.boot, at.pool, at.horizon_ticks
    );
    let level = if at.simulated { Level::Warn } else { Level::Ok };
    let who =
        Finding::new("device", level, who, "it is simulated, no real pin moves: name a board with --device");

    let trip = at.round_trip;
    let found = format!(
        "{:.2} ms (p50), {:.2} (p99), {:.2} (max) of {} pings",
        trip.p50_us / 1e3,
        trip.p99_us / 1e3,
        trip.max_us / 1e3,
        trip.count
    );
    // Half the lead: beyond it, what is sent a lead ahead may be late.
    let half_lead_us = Settings::default().lead_ms * 500.0;
    let level = match trip.p99_us {
        us if us > half_lead_us => Level::Fail,
        us if us > CORRECTION_US => Level::Warn,
        _ => Level::Ok,
    };
    let advice = "use a USB port of the machine itself, without a hub, and see what else it does";
    let trip = Finding::new("round trip", level, found, advice);

    let line = at.throughput_bytes_per_s.map_or_else(
        || Finding::new("line", Level::Fail, "not measured", "see its cable: no long frame came through"),
        line,
    );

    let drift = at.drift;
    let found =
        format!("{:+.1} ppm, known to {:.1}, in {:.1} s", drift.ppm, drift.uncertainty_ppm, drift.seconds);
    let beyond = drift.ppm.abs() - drift.uncertainty_ppm;
    let level = match beyond {
        ppm if ppm > MODEL_PPM => Level::Fail,
        ppm if ppm > CRYSTALS_PPM => Level::Warn,
        _ if drift.uncertainty_ppm > MODEL_PPM => Level::Warn,
        _ => Level::Ok,
    };
    let advice = if beyond > CRYSTALS_PPM {
        "that is no crystal: see the board's clock, and whether this machine's is being set"
    } else {
        "round trips are too uneven to tell: use a USB port of the machine itself, and see what else it does"
    };
    let drift = Finding::new("drift", level, found, advice);
    let mut findings = vec![who, trip, line, drift];
    findings.extend(telemetry(at.telemetry));
    findings
}

/// What there is to say of its measuring, if it does none.
pub(super) fn telemetry(there: bool) -> Option<Finding> {
    let none = || Finding::new("telemetry", Level::Warn, text::NO_TELEMETRY, text::SHORT_PLAYS);
    (!there).then(none)
}

/// What the line carries.
pub(super) fn line(bytes_per_s: u32) -> Finding {
    let level = match bytes_per_s {
        rate if rate < ANY_BYTES_PER_S => Level::Fail,
        rate if rate < ALL_BYTES_PER_S => Level::Warn,
        _ => Level::Ok,
    };
    let found = format!("carries {:.1} kB/s", f64::from(bytes_per_s) / 1000.0);
    Finding::new("line", level, found, "plays that need more are refused: use USB, or a faster UART")
}
