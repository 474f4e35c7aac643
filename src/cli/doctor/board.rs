//! Checks a device: opens it, measures its link, and judges what it found.
//!
//! The limits are here, each with its reason. [`crate::doctor::device`] has the checks that a daemon also makes on its device. The
//! device is closed again before the doctor prints anything.

use super::self_test;
use crate::doctor::device::{line, simulated, telemetry, trigger_input};
use crate::receipts::{board_status, device_info};
use firmware_protocol::frame::PROTOCOL;
use meissner_api::{BoardStatus, DeviceInfo, Finding, Level};
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::Settings;
use meissner_stream::device::{self, Spec};
use meissner_stream::diagnostics::{self, Drift, LinkReport, RoundTripStats};
use serde::Serialize;

/// A correction leaves the host this long before its burst, us: with a slower round trip it comes late.
const CORRECTION_US: f64 = 3_000.0;
/// A crystal is accurate to 50 ppm, so two differ by at most 100: a larger drift has another cause.
const CRYSTALS_PPM: f64 = 100.0;
/// The clock model treats a larger drift as noise.
const MODEL_PPM: f64 = 200.0;

/// Advice against delays between board and machine.
const DIRECT_PORT: &str = "use a USB port of the machine itself";

/// The measurements of a device.
#[derive(Debug, Serialize)]
pub(super) struct Examined {
    #[serde(flatten)]
    pub(super) device: DeviceInfo,
    serial_number: Option<String>,
    protocol: u8,
    pool: u16,
    horizon_ticks: u8,
    round_trip: RoundTripStats,
    throughput_bytes_per_s: Option<u32>,
    drift: Drift,
    board: BoardStatus,
    /// The measurements of the self-test; null if it was not requested, or did not finish.
    self_test: Option<self_test::Measured>,
}

/// Opens and measures a device, and adds what it found to `findings`; `None` if that failed.
pub(super) fn examine(
    spec: &Spec,
    array: Array,
    self_test: bool,
    findings: &mut Vec<Finding>,
) -> Option<Examined> {
    let mut device = match device::open(spec, array, &SimulatedMotorsConfig::default()) {
        Ok(device) => device,
        Err(error) => {
            findings.push(Finding::fail("device", error.found(), error.advice()));
            return None;
        }
    };
    let (kind, serial_number) = (device.kind(), device.serial_number().map(str::to_owned));
    let checked = diagnostics::measure(&mut device, array, self_test);
    drop(device);
    let checked = match checked {
        Ok(checked) => checked,
        Err(error) => {
            let found = format!("{kind}: {error}");
            findings.push(Finding::fail("device", found, error.advice()));
            return None;
        }
    };
    let examined = examined(&kind, serial_number, &checked);
    findings.extend(judged(&examined));
    findings.extend(self_test::of_report(&checked.board));
    if let Some(state) = checked.self_test {
        findings.extend(self_test::judged(state, checked.hello.array.motors, checked.hello.array.tick_hz));
    }
    Some(examined)
}

fn examined(kind: &str, serial_number: Option<String>, checked: &LinkReport) -> Examined {
    Examined {
        device: device_info(kind, &checked.hello),
        serial_number,
        protocol: PROTOCOL,
        pool: checked.hello.pool,
        horizon_ticks: checked.hello.horizon,
        round_trip: checked.round_trip,
        throughput_bytes_per_s: checked.throughput_bytes_per_s,
        drift: checked.drift,
        board: board_status(&checked.board),
        self_test: checked
            .self_test
            .and_then(|test| self_test::Measured::of(test, checked.hello.array.tick_hz)),
    }
}

fn judged(at: &Examined) -> Vec<Finding> {
    let serial =
        at.serial_number.as_deref().map_or_else(String::new, |serial| format!(", serial number {serial}"));
    let DeviceInfo { kind, firmware, build, boot, .. } = &at.device;
    let who = format!(
        "{kind}{serial}, firmware {firmware} ({build}), protocol {}, boot {boot}, {} slots, horizon {} ticks",
        at.protocol, at.pool, at.horizon_ticks
    );
    let who = simulated(at.device.simulated, who, "name a board with --device");

    let trip = at.round_trip;
    let found = format!(
        "{:.2} ms (p50), {:.2} (p99), {:.2} (max) of {} pings",
        trip.p50_us / 1e3,
        trip.p99_us / 1e3,
        trip.max_us / 1e3,
        trip.count
    );
    // If the link takes more than half the lead, strokes may come late.
    let half_lead_us = Settings::of(Array::default()).stall_ms() * 1000.0;
    let level = match trip.p99_us {
        us if us > half_lead_us => Level::Fail,
        us if us > CORRECTION_US => Level::Warn,
        _ => Level::Ok,
    };
    let advice = format!("{DIRECT_PORT}, without a hub, and check what else loads the machine");
    let trip = Finding::new("round trip", level, found, advice);

    let line = at.throughput_bytes_per_s.map_or_else(
        || {
            let found = "not measured: no full frame came through, or the machine stood still meanwhile";
            Finding::fail("line", found, "check its cable, end other programs, and run it again")
        },
        line,
    );

    let drift = at.drift;
    let found = format!("{:+.1} ppm +- {:.1}, over {:.1} s", drift.ppm, drift.uncertainty_ppm, drift.seconds);
    let beyond = drift.ppm.abs() - drift.uncertainty_ppm;
    let level = match beyond {
        ppm if ppm > MODEL_PPM => Level::Fail,
        ppm if ppm > CRYSTALS_PPM => Level::Warn,
        _ if drift.uncertainty_ppm > MODEL_PPM => Level::Warn,
        _ => Level::Ok,
    };
    let advice = if beyond > CRYSTALS_PPM {
        "no crystal drifts that far: check the board's clock, and whether this machine's clock is being set"
            .to_owned()
    } else {
        format!(
            "round trips vary too much to measure it: {DIRECT_PORT}, and check what else loads the machine"
        )
    };
    let drift = Finding::new("drift", level, found, advice);
    let mut findings = vec![who, trip, line, drift];
    findings.extend(telemetry(at.device.telemetry));
    findings.push(trigger_input(at.device.trigger_input));
    findings
}
