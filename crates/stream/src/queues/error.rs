//! Why a command was refused, as a message for the operator.
//!
//! The streamer answers a request with [`CommandError`]; the API shows its text.

use firmware_protocol::limits::Refusal;
use meissner_array::spec::Array;

/// Most plays that wait behind the running one.
pub const MAX_QUEUED_PLAYS: usize = 16;

/// Why a command was refused or failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// No device is connected.
    #[error("no device is connected: plug it in, or see `meissner status`")]
    NoDevice,
    /// Without telemetry and stop, a pin that the play drives may be too far from rest.
    #[error(
        "pins may be {um} um from rest, which is more than drift_limit_um = {limit_um}: run `meissner home` if the motors are \
         calibrated, or level the pins by hand, then `meissner arm --assume-rest --checked NAME`"
    )]
    DriftLimit {
        /// The largest estimate of a motor that the play drives.
        um: u32,
        /// The limit.
        limit_um: u32,
    },
    /// Nobody has looked at pins that may be off by more than a script may take as at rest.
    #[error(
        "pins may be {um} um from rest: look at them, level them, and say who did: `meissner arm --assume-rest --checked NAME`, or \
         \"checked\": \"NAME\""
    )]
    LevelNotChecked {
        /// The largest estimate of a motor.
        um: u32,
    },
    /// The play, the update or the settings are for another array than the streamer's.
    #[error("it is for the array {}, but the array in use is {}: choose one that is made for that", .found.name(), .array.name())]
    OtherArray {
        /// The array that it is for.
        found: Array,
        /// The streamer's.
        array: Array,
    },
    /// The controller is not armed.
    #[error("the motors are disarmed: run `meissner arm` first")]
    Disarmed,
    /// An emergency stop or fault is latched.
    #[error("an emergency stop or fault is latched: find out why, then `meissner reset` and `meissner arm`")]
    Faulted,
    /// The device is returning pins.
    #[error("the pins are returning to rest: try again in a moment")]
    Returning,
    /// Homing and calibration need an idle streamer.
    #[error("a play is running or queued: wait for its end, or `meissner stop`")]
    Playing,
    /// The play to withdraw does not wait any more.
    #[error(
        "the play has begun, and only one that waits can be withdrawn: wait for its end, or `meissner stop`"
    )]
    Begun,
    /// Neither telemetry nor a calibration shows where the pins are.
    #[error(
        "no telemetry and no calibration say where the pins are: level them by hand, then `meissner disarm` and \
         `meissner arm --assume-rest --checked NAME`"
    )]
    NoPositionEstimate,
    /// Homing has ended and not all pins are home.
    #[error(
        "not all pins are home: `meissner status` shows how far off each is, and sensor faults; level those pins by hand, \
         then `meissner disarm` and `meissner arm --assume-rest`"
    )]
    NotHome,
    /// [`MAX_QUEUED_PLAYS`] plays wait.
    #[error("{MAX_QUEUED_PLAYS} plays are queued already: wait, or `meissner stop`")]
    QueueFull,
    /// The play before it has no end.
    #[error("the play before it has no end: stop it, or use --replace")]
    BehindEndless,
    /// The onset asked for is too soon.
    #[error("the onset asked for is too soon or already past: choose a later one")]
    TooSoon,
    /// The device has no trigger input.
    #[error(
        "the device has no trigger input, so no edge can start a play: see docs/board.md, or play it without"
    )]
    NoTriggerInput,
    /// The device cannot give a code.
    #[error("the device was built without a trigger output, so it gives no code: leave the code out")]
    NoTriggerOutput,
    /// An edge could not start the play so soon after it.
    #[error(
        "the onset must come at least {least_ms} ms after the edge, so that the play reaches the device in time: choose a longer delay"
    )]
    EdgeTooSoon {
        /// The least delay, ms.
        least_ms: u32,
    },
    /// A play before it waits for an edge, so its end is not known.
    #[error("a play before it waits for an edge of the trigger input: leave the onset out, or use --replace")]
    BehindEdge,
    /// A board takes edges by its input alone.
    #[error(
        "only a simulated array (`--device mock`) takes an edge by command: give the board a pulse at its trigger input"
    )]
    NotSimulated,
    /// The simulated array has no room for more edges to come.
    #[error("1024 edges of the simulated array wait for their ticks already: wait until they have come")]
    TooManyEdges,
    /// The onset asked for is beyond the protocol's range, or an edge of the simulated array beyond an hour.
    #[error("the time asked for is more than {most_min} minutes ahead: choose a sooner one")]
    TooFar {
        /// The farthest time, minutes ahead.
        most_min: u32,
    },
    /// The onset asked for lies within a queued play.
    #[error(
        "the onset asked for lies before the end of the plays queued: choose a later one, or use --replace"
    )]
    Overlaps,
    /// The play requires more bandwidth than the line has.
    #[error(
        "the pattern needs {:.1} kB/s at its peak, the line carries {:.1}, and waiting for answers to {frames} frames a second takes \
         {waits} % of its time: lower frequencies, fewer pins or updates, or USB", kilo(*.needs), kilo(*.carries)
    )]
    LineTooSlow {
        /// Bytes per second required.
        needs: u32,
        /// Frames per second required.
        frames: u32,
        /// Bytes per second that the line carries while nothing waits.
        carries: u32,
        /// What the frames take of the line's time to wait for answers, percent.
        waits: u32,
    },
    /// The device refused the command.
    #[error("the device refused: {}", refusal_text(*.0))]
    Device(Refusal),
    /// The device did not answer in time.
    #[error("the device does not answer: check its cable and power")]
    Timeout,
}

fn kilo(bytes: u32) -> f64 {
    f64::from(bytes) / 1000.0
}

/// The text of a device's refusal.
pub fn refusal_text(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::NotArmed => "it is not armed",
        Refusal::Motor => "there is no such motor",
        Refusal::Level => "a pin would go higher than the controller allows",
        Refusal::Surplus => "a stroke does not come back to rest",
        Refusal::TooFar => "it lies too far ahead",
        Refusal::PoolFull => "no free stroke slot",
        Refusal::MotorOnTime => "a motor's on-time limit",
        Refusal::RailOnTime => "a rail's on-time limit",
        Refusal::RailAtOnce => "more motors of a rail at once than `rail_motors_at_once` allows",
        Refusal::ChipAtOnce => "more motors of a driver chip at once than `chip_motors_at_once` allows",
        Refusal::Dense => "more moves within 10 ms, or of a motor within 1 ms, than the device has time for",
        Refusal::PositionUnknown => {
            "it does not know where the pins are; see that all are at rest, then `meissner arm --assume-rest`"
        }
        Refusal::State => "not in its present state",
        Refusal::Travel => {
            "a pin is further off than it may be moved since it was armed; `meissner disarm`, `meissner arm` and again"
        }
        Refusal::Malformed => "it could not read it",
        Refusal::Pushing => {
            "it would push too often against the lower stop, or there is none; see `stop_pulses_per_s`"
        }
    }
}
