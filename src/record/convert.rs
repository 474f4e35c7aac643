//! The streamer's and the controller's types in the words of the API.

use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{DeviceHello, State};
use meissner_api::{CalibrateRequest, Code, DeviceInfo, Problem};
use meissner_stream::calibrate::Plan;
use meissner_stream::queues::Refused;

/// The controller's state as the API calls it.
#[must_use]
pub const fn state_name(state: State) -> &'static str {
    match state {
        State::Disarmed => "disarmed",
        State::Armed => "armed",
        State::Returning => "returning",
        State::Faulted => "faulted",
    }
}

/// What a device said of itself, reached by `kind`.
#[must_use]
pub fn device_info(kind: &str, hello: &DeviceHello) -> DeviceInfo {
    let [major, minor, patch] = hello.firmware;
    DeviceInfo {
        kind: kind.to_owned(),
        firmware: format!("{major}.{minor}.{patch}"),
        build: format!("{:08x}", u32::from_be_bytes(hello.build)),
        boot: hello.boot,
        simulated: hello.features & DeviceHello::SIMULATED != 0,
        telemetry: hello.features & DeviceHello::TELEMETRY != 0,
    }
}

/// Why the streamer refused a command, as an error of the API.
#[must_use]
pub fn refusal(refused: Refused) -> Problem {
    let code = match refused {
        Refused::NoDevice => Code::NoDevice,
        Refused::Disarmed => Code::Disarmed,
        Refused::Faulted => Code::Faulted,
        Refused::Returning => Code::Returning,
        Refused::Playing => Code::Playing,
        Refused::NotHome => Code::NotHome,
        Refused::NothingToGoBy => Code::NoPositionEstimate,
        Refused::QueueFull => Code::QueueFull,
        Refused::BehindEndless => Code::BehindEndless,
        Refused::TooSoon => Code::TooSoon,
        Refused::TooFar => Code::BadRequest,
        Refused::Overlaps => Code::Overlaps,
        Refused::LineTooSlow { .. } => Code::LineTooSlow,
        Refused::Device(Refusal::PositionUnknown) => Code::PositionUnknown,
        Refused::Device(_) => Code::DeviceRefused,
        Refused::Timeout => Code::Timeout,
    };
    Problem::new(code, refused.to_string())
}

/// What a request for a calibration asks to be played.
///
/// # Errors
/// A `bad-request` that says what is wrong with it.
pub fn calibration_plan(request: &CalibrateRequest) -> Result<Plan, Problem> {
    let default = Plan::default();
    let pulses = request.pulses.as_deref().unwrap_or(default.pulses());
    let repetitions = request.repetitions.unwrap_or(default.repetitions());
    Plan::new(request.motor, pulses, repetitions)
        .map_err(|error| Problem::new(Code::BadRequest, error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_have_their_codes() {
        for (refused, code, status) in [
            (Refused::Disarmed, "disarmed", 409),
            (Refused::QueueFull, "queue-full", 429),
            (Refused::NoDevice, "no-device", 503),
            (Refused::Timeout, "timeout", 504),
            (Refused::Device(Refusal::PositionUnknown), "position-unknown", 409),
            (Refused::LineTooSlow { needs: 41_200, carries: 11_300 }, "line-too-slow", 409),
        ] {
            let problem = refusal(refused);
            assert_eq!((problem.code.as_str(), problem.status), (code, status));
        }
    }
}
