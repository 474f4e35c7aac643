//! Converts the streamer's and the controller's types to the API's.

use firmware_protocol::array::MAX_MOTORS;
use firmware_protocol::board::{Board, Counts, Output, Outputs, Reset};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{DeviceHello, State};
use meissner_api::{BoardRecord, BoardStatus, CalibrateRequest, Code, DeviceInfo, EndCause, Problem};
use meissner_array::spec::Array;
use meissner_array::strokes::Fit;
use meissner_stream::PlayBoard;
use meissner_stream::calibrate::{Plan, PlanError, laser_plan};
use meissner_stream::queues::CommandError;
use std::collections::BTreeMap;

/// The controller's state as the API names it.
pub const fn state_name(state: State) -> &'static str {
    match state {
        State::Disarmed => "disarmed",
        State::Armed => "armed",
        State::Returning => "returning",
        State::Faulted => "faulted",
    }
}

/// The device information of a handshake; `kind` says how the device is reached.
pub fn device_info(kind: &str, hello: &DeviceHello) -> DeviceInfo {
    let [major, minor, patch] = hello.firmware;
    DeviceInfo {
        kind: kind.to_owned(),
        firmware: format!("{major}.{minor}.{patch}"),
        build: format!("{:08x}", u32::from_be_bytes(hello.build)),
        boot: hello.boot,
        simulated: hello.features & DeviceHello::SIMULATED != 0,
        telemetry: hello.features & DeviceHello::TELEMETRY != 0,
        trigger_input: hello.features & DeviceHello::TRIGGER_INPUT != 0,
    }
}

/// The device's counters as the API shows them.
pub fn board_status(board: &Board) -> BoardStatus {
    BoardStatus {
        reset: reset_name(board.reset).to_owned(),
        uptime_s: board.uptime_s,
        slack_ticks: board.slack_since_boot,
        counters: counters(&board.counts),
        high_at_boot: board.high_at_boot.map(outputs),
    }
}

/// The numbers of the outputs: those of motors, then the trigger and the driver enable.
pub fn outputs(outputs: Outputs) -> Vec<u8> {
    let number = |output| match output {
        Output::Line(motor) => motor,
        Output::Trigger => MAX_MOTORS as u8,
        Output::Enable => MAX_MOTORS as u8 + 1,
    };
    outputs.iter().map(number).collect()
}

/// The API's name of the cause of a device's start.
pub const fn reset_name(reset: Reset) -> &'static str {
    match reset {
        Reset::Unknown => "unknown",
        Reset::Power => "power",
        Reset::RunPin => "run-pin",
        Reset::Debugger => "debugger",
        Reset::Watchdog => "watchdog",
        Reset::Panic => "panic",
        Reset::Program => "program",
    }
}

/// The device's counters during a play.
pub(super) fn board_record(board: PlayBoard) -> BoardRecord {
    BoardRecord { slack_ticks: board.slack, counters: counters(&board.counts) }
}

fn counters(counts: &Counts) -> BTreeMap<String, Option<u32>> {
    counts.iter().map(|(counter, value)| (counter.name.to_owned(), value)).collect()
}

/// The fit that a request asks for.
pub const fn fit(asked: meissner_api::Fit) -> Fit {
    match asked {
        meissner_api::Fit::Whole => Fit::Whole,
        meissner_api::Fit::Cover => Fit::Cover,
    }
}

/// How a play ended, in words: its state, its cause, and how long after the onset it was cut.
pub fn end_text(state: &str, cause: Option<&EndCause>, cut_after_ms: Option<f64>) -> String {
    let cut = cut_after_ms.map_or_else(String::new, |ms| format!(", cut {ms:.1} ms after the onset"));
    match cause {
        None => state.to_owned(),
        Some(EndCause::HostTimeout) => {
            format!("{state}: the PC was silent for longer than the host watchdog timeout{cut}")
        }
        Some(EndCause::DriftLimit) => {
            format!(
                "{state}: a pin may be farther from rest than `drift_limit_um`; see `meissner status`{cut}"
            )
        }
        Some(cause) => format!("{state} ({cause}){cut}"),
    }
}

/// Why the streamer refused a command, as an error of the API.
pub fn refusal(refused: CommandError) -> Problem {
    let code = match refused {
        CommandError::DriftLimit { .. } => Code::DriftLimit,
        CommandError::LevelNotChecked { .. } => Code::LevelNotChecked,
        CommandError::NoDevice => Code::NoDevice,
        CommandError::OtherArray { .. } => Code::OtherArray,
        CommandError::Disarmed => Code::Disarmed,
        CommandError::Faulted => Code::Faulted,
        CommandError::Returning => Code::Returning,
        CommandError::Playing | CommandError::Begun => Code::Playing,
        CommandError::NotHome => Code::NotHome,
        CommandError::NoPositionEstimate => Code::NoPositionEstimate,
        CommandError::QueueFull | CommandError::TooManyEdges => Code::QueueFull,
        CommandError::BehindEndless => Code::BehindEndless,
        CommandError::TooSoon | CommandError::EdgeTooSoon { .. } => Code::TooSoon,
        CommandError::NoTriggerInput => Code::NoTriggerInput,
        CommandError::NotSimulated | CommandError::NoTriggerOutput => Code::DeviceRefused,
        CommandError::TooFar { .. } => Code::BadRequest,
        CommandError::Overlaps | CommandError::BehindEdge => Code::Overlaps,
        CommandError::LineTooSlow { .. } => Code::LineTooSlow,
        CommandError::Device(Refusal::PositionUnknown) => Code::PositionUnknown,
        CommandError::Device(_) => Code::DeviceRefused,
        CommandError::Timeout => Code::Timeout,
    };
    Problem::new(code, refused.to_string())
}

/// The plan that a calibration request asks for.
///
/// # Errors
/// A `bad-request` that says what is wrong.
pub fn calibration_plan(array: Array, request: &CalibrateRequest) -> Result<Plan, Problem> {
    let pulses = request.pulses.as_deref();
    let bad = |error: PlanError| Problem::new(Code::BadRequest, error.to_string());
    let plan = match (request.laser, request.motor) {
        (true, Some(motor)) => laser_plan(array, motor, pulses, request.repetitions),
        (true, None) => {
            let detail = "`motor` is missing: name the one motor whose pin the laser measures";
            return Err(Problem::new(Code::BadRequest, detail));
        }
        (false, motor) => Plan::with_defaults(array, motor, pulses, request.repetitions),
    };
    plan.map_err(bad)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_names_its_cause() {
        assert_eq!(end_text("done", None, None), "done");
        assert_eq!(end_text("stopped", Some(&EndCause::EStop), None), "stopped (estop)");
        assert_eq!(
            end_text("stopped", Some(&EndCause::Stop), Some(812.34)),
            "stopped (stop), cut 812.3 ms after the onset"
        );
        let silent = end_text("stopped", Some(&EndCause::HostTimeout), Some(1200.0));
        assert!(
            silent.starts_with("stopped: the PC was silent")
                && silent.ends_with("cut 1200.0 ms after the onset")
        );
    }

    #[test]
    fn refusals_have_their_codes() {
        for (refused, code, status) in [
            (CommandError::Disarmed, "disarmed", 409),
            (CommandError::QueueFull, "queue-full", 429),
            (CommandError::NoDevice, "no-device", 503),
            (CommandError::Timeout, "timeout", 504),
            (CommandError::Device(Refusal::PositionUnknown), "position-unknown", 409),
            (
                CommandError::LineTooSlow { needs: 41_200, frames: 160, carries: 11_300, waits: 4 },
                "line-too-slow",
                409,
            ),
        ] {
            let problem = refusal(refused);
            assert_eq!((problem.code.as_str(), problem.status), (code, status));
        }
    }
}
