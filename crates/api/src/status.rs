//! The status: the device, the running play, the queue, the clock, the motors.
//!
//! `GET /v1/status` and every command but `play` and `calibrate` answer with a [`Status`].

use crate::board::BoardStatus;
use crate::pattern::FollowedMotion;
use crate::receipt::ErrorSource;
use crate::session::Session;
use crate::token::{NetworkStatus, Role};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The state when no device answers and no emergency stop is latched.
pub const NO_DEVICE: &str = "no-device";

/// The connected device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct DeviceInfo {
    /// How the device is reached: `mock`, `pty:PATH`, `serial:PATH` or `usb:SERIAL`.
    pub kind: String,
    /// Firmware version.
    pub firmware: String,
    /// Hash of the firmware's build, in hexadecimal.
    pub build: String,
    /// A random number, new at every start of the device. A tick belongs to one boot.
    pub boot: u32,
    /// Whether the motors are simulated.
    pub simulated: bool,
    /// Whether the device measures where its pins are; without telemetry the daemon corrects no bursts by measurement.
    pub telemetry: bool,
    /// Whether the device has a trigger input: its edges can start and stop plays.
    pub trigger_input: bool,
}

/// The running play.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunningPlay {
    /// The play's id.
    #[schema(minimum = 1)]
    pub id: u64,
    /// What the play is called.
    pub name: String,
    /// Time since the onset, s.
    pub played_s: f64,
}

/// A play or calibration that the daemon has queued.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"id": 7, "ordered_ms": 300.0, "compiled_ms": 298.6, "motions": []})))]
pub struct PlayAccepted {
    /// The play's id; its receipt is at `/v1/plays/ID`.
    #[schema(minimum = 1)]
    pub id: u64,
    /// Duration as ordered, by the request or else by the pattern, ms; null: without end.
    pub ordered_ms: Option<f64>,
    /// Duration as compiled, to the end of the last whole stroke, ms; null: without end.
    pub compiled_ms: Option<f64>,
    /// How the motors follow their motions, by motor; empty without motions. Of a sequence those of the item in which the motor is off the
    /// most.
    #[schema(max_items = 64)]
    pub motions: Vec<FollowedMotion>,
}

/// A play that waits in the queue.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct QueuedPlay {
    /// The play's id.
    #[schema(minimum = 1)]
    pub id: u64,
    /// What the play is called.
    pub name: String,
    /// Whether it waits for an edge of the trigger input, which has not come.
    pub waits_for_edge: bool,
}

/// Which real-time rights the system granted the daemon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Realtime {
    /// Whether the streamer's thread runs under `SCHED_FIFO`.
    pub fifo: bool,
    /// Whether the process's memory is locked (`mlockall`).
    pub mlock: bool,
}

/// What the daemon has ordered a pin to do in the 0.2 s before a moment. Position control corrects what the pin really does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"height_um": 31.0, "swing_um": 62.0, "hz": 60.0})))]
pub struct PinMovement {
    /// Middle between the highest and the lowest point, µm above rest.
    pub height_um: f64,
    /// From the lowest to the highest point, µm. 0: the pin does not move.
    pub swing_um: f64,
    /// Strokes per second; of a movement with fewer than two rises half as many as its changes of direction.
    pub hz: f64,
}

/// What every pin did lately, as the daemon has ordered it: heights 1 ms apart, the last at `tick`. Position control corrects what a pin
/// really does, and the motor smooths it. Small moves that bring pins back to rest (`home`) count as none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"tick": 6442450944_u64, "tick_hz": 85000, "step_ms": 1.0, "heights_um": [[0.0], [0.0, 12.1, 23.6]]})))]
pub struct PinHeights {
    /// The tick of the last height.
    pub tick: u64,
    /// Nominal rate of the device's clock, Hz.
    #[schema(minimum = 20000, maximum = 200000)]
    pub tick_hz: u32,
    /// From one height to the next, ms.
    #[schema(minimum = 1.0, maximum = 1.0)]
    pub step_ms: f64,
    /// By motor, oldest first, µm above rest; of a pin that kept its height one value. After an emergency stop a pin stands where it was.
    /// Empty if nothing is known: without a device, or while the position of the pins is unknown.
    #[schema(max_items = 64)]
    pub heights_um: Vec<Vec<f32>>,
}

/// Pins that an emergency stop, a fault, a lost link or a restart of the device has left above rest. A device that knows where its
/// pins are returns them at the next `reset` or `arm`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"height_um": 200.0, "age_s": 12.5})))]
pub struct StandingPins {
    /// Height of the highest one, µm above rest. It may be lower if the device could not say when it stopped.
    pub height_um: f64,
    /// For how long the daemon knows of them, s.
    pub age_s: f64,
}

impl StandingPins {
    /// As a clause.
    pub fn text(&self) -> String {
        let time = if self.age_s < 0.5 { String::new() } else { format!(", for {:.0} s", self.age_s) };
        format!("pins stand up to {:.0} um above rest{time}", self.height_um)
    }
}

/// Why the daemon does not trust the telemetry of a motor: `jumps` (the signal moves where the motor rests), `gain` (it shows far
/// less or more travel than bursts make), `scatter` (equal bursts differ too much) or `limit` (corrections at their limit
/// have not helped).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SensorFault {
    /// The signal jumps where nothing moved, or moves where the motor should rest.
    Jumps,
    /// The travel it shows per burst is far below or above any motor's.
    Gain,
    /// Equal bursts differ by more than any motor's scatter.
    Scatter,
    /// Corrections have stood at their limit for long, and the shaft has not come nearer to rest.
    Limit,
}

impl SensorFault {
    /// The fault, as a clause about the motor.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Jumps => "its telemetry moves where its bursts do not",
            Self::Gain => "its telemetry shows far less or more travel than its bursts make",
            Self::Limit => "corrections at their limit have not brought it nearer to its rest",
            Self::Scatter => "its telemetry has little to do with its bursts",
        }
    }
}

/// The state of one motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MotorStatus {
    /// Estimated offset of the pin from rest, µm, positive upwards. By the lower stop and by dead reckoning: root mean square to
    /// expect; by dead reckoning at most the distance of the end stops. The height of a pin that stands above rest (`standing`) is
    /// part of it.
    pub rest_error_um: f32,
    /// Where the estimate comes from: `none`, `telemetry`, `dead-reckoning` or `lower-stop`.
    pub source: ErrorSource,
    /// Whether the calibration in use holds gains of this motor.
    pub calibrated: bool,
    /// Why its telemetry is not trusted, until somebody arms again; null: it is, or there is none.
    pub sensor_fault: Option<SensorFault>,
    /// What the pin does now, whatever the play: renewed ten times a second while pins move. After an emergency stop it stands where it
    /// was. Null if that is not known: without a device, or while the position of the pins is unknown.
    pub now: Option<PinMovement>,
}

/// The clocks of device and host at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ClockSample {
    /// The device's clock, ticks since the device's start.
    pub tick: u64,
    /// Nominal rate of the device's clock, Hz.
    #[schema(minimum = 20000, maximum = 200000)]
    pub tick_hz: u32,
    /// The host's `CLOCK_MONOTONIC`, ns.
    pub monotonic_ns: u64,
    /// The host's wall clock, Unix time, ns.
    pub wall_ns: u64,
    /// Uncertainty of `tick` against `monotonic_ns`, µs.
    pub uncertainty_us: f64,
}

/// The limits for the person who feels the pins, what is used and what is left. Vibration is time in which pins move, by
/// their compiled moves.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ParticipantStatus {
    /// Whose vibration is counted: the running session's participant; null without one: everybody's together.
    pub participant: Option<String>,
    /// Largest amplitude of a drive, µm, peak to peak.
    #[schema(minimum = 1.0, maximum = 400.0)]
    pub max_amplitude_um: f64,
    /// Longest vibration without a pause, s.
    #[schema(minimum = 0.1, maximum = 86400.0)]
    pub max_continuous_s: f64,
    /// Time without vibration that makes a pause, s.
    #[schema(minimum = 0.5, maximum = 3600.0)]
    pub pause_s: f64,
    /// Vibration since the last pause, s.
    pub continuous_used_s: f64,
    /// Vibration that is left before a pause, s.
    pub continuous_left_s: f64,
    /// Longest vibration in a session, s.
    #[schema(minimum = 0.1, maximum = 86400.0)]
    pub max_session_s: f64,
    /// Vibration in the running session, s; null without one.
    pub session_used_s: Option<f64>,
    /// Vibration that is left in the running session, s; null without one.
    pub session_left_s: Option<f64>,
    /// Longest vibration in a local calendar day, s.
    #[schema(minimum = 0.1, maximum = 86400.0)]
    pub max_day_s: f64,
    /// Vibration today, s.
    pub day_used_s: f64,
    /// Vibration that is left today, s.
    pub day_left_s: f64,
}

/// For whom the motors are armed, and whose silence disarms them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"by": "ada (uid 1000, pid 4711)", "for_s": 312.5, "silence_s": 10.0, "left_s": 7.4})))]
pub struct ArmedStatus {
    /// The client that armed last.
    pub by: String,
    /// For how long they are armed by it, s.
    pub for_s: f64,
    /// The daemon stops and disarms when it has heard nothing for so long, s; null: never, the client allows that.
    #[schema(minimum = 1.0)]
    pub silence_s: Option<f64>,
    /// What is left of that time unless a request comes, s; null: no end.
    pub left_s: Option<f64>,
}

/// The emergency stops.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EStopStatus {
    /// How many orders have come since the daemon began. Clients send one by two ways at once, and both count.
    pub orders: u64,
    /// The client that ordered the last one; null: none was ordered, or it is not known.
    pub by: Option<String>,
    /// How long ago that was, s; null: none was ordered.
    pub age_s: Option<f64>,
    /// By when the device had confirmed the last one, ms after its order: all lines were off by then. Null: it has confirmed none.
    pub off_ms: Option<f64>,
}

/// The way to the device, and what it reports of itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LinkStatus {
    /// The device the daemon looks for, as `--device` names it.
    pub wanted: String,
    /// Why no device is connected, and what to do; null if one is connected or the daemon has not looked yet.
    pub missing: Option<String>,
    /// Which device a calibration belongs to: a board's serial number, or a simulated array's seed and settings; empty before
    /// a device is opened.
    pub identity: String,
    /// Measured capacity of the line to the device, bytes/s; null until it is measured.
    pub bytes_per_s: Option<u32>,
    /// Undamaged messages from the device that cannot be true, since it was connected. 0 from a sound device.
    pub contradictions: u64,
    /// The device's counters; null until it has reported them.
    pub board: Option<BoardStatus>,
}

/// The newest of what has a number, whether it waits, runs or is over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Newest {
    /// The play; null before the first.
    pub play: Option<u64>,
    /// The rendering; null before the first.
    pub rendering: Option<u64>,
}

/// The daemon, and what it is set to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DaemonStatus {
    /// The daemon's version.
    pub version: String,
    /// The daemon's process id.
    pub pid: u32,
    /// The socket the daemon listens on.
    pub socket: String,
    /// Who can reach the daemon over the network; null: nothing listens there.
    pub network: Option<NetworkStatus>,
    /// What the client that asks may do: `operate` or `observe`, by the role of the access token that it shows.
    pub role: Role,
    /// The daemon's real-time rights.
    pub realtime: Realtime,
    /// The array that the daemon drives, as `GET /v1/array` shows it.
    pub array: String,
    /// When the calibration in use was measured, UTC; null if none is used.
    pub calibrated: Option<String>,
    /// Estimate by dead reckoning above which no play drives a pin, µm (configuration key `drift_limit_um`).
    pub drift_limit_um: f32,
    /// How far ahead the daemon sends strokes, ms: the configured lead; during a play the lead that is reached.
    pub lead_ms: f64,
    /// Host watchdog timeout, ms: the device stops when the daemon is silent for longer.
    #[schema(minimum = 0.0, maximum = 10000.0)]
    pub lease_ms: f64,
    /// Why the daemon cannot write the session record, or which entries it has found missing; null if all is well, or it keeps none.
    pub logbook_problem: Option<String>,
    /// Entries that the session record lost since the daemon started: the disk or the queue was full, or somebody removed them.
    pub logbook_lost: u64,
}

/// How the daemon and its device stand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "state": "armed", "cause": "request", "position": "known",
    "armed": {"by": "ada (uid 1000, pid 4711)", "for_s": 312.5, "silence_s": 10.0, "left_s": 7.4}, "standing": null,
    "estop": {"orders": 0, "by": null, "age_s": null, "off_ms": null},
    "device": {
        "kind": "mock", "firmware": "0.1.0", "build": "6d656973", "boot": 305419896, "simulated": true, "telemetry": true, "trigger_input": true
    },
    "link": {
        "wanted": "mock", "missing": null,
        "identity": "seed 0, gain_sd 0.1, asymmetry_sd 0.02, transient_gain 0.8, end_stop_um 500",
        "bytes_per_s": 1000000, "contradictions": 0,
        "board": {
            "reset": "power", "uptime_s": 5400, "slack_ticks": 26, "stalls": 0, "usb_recoveries": 0, "output_faults": 0,
            "high_at_boot": []
        }
    },
    "play": {"id": 7, "name": "edge-45", "played_s": 0.52},
    "queued": [{"id": 8, "name": "pin-60", "waits_for_edge": false}], "newest": {"play": 8, "rendering": null},
    "clock": {
        "tick": 6442450944_u64, "tick_hz": 85000, "monotonic_ns": 75793540741176_u64, "wall_ns": 1767225600000000000_u64,
        "uncertainty_us": 9.6
    },
    "motors": [{
        "rest_error_um": 0.4, "source": "telemetry", "calibrated": false, "sensor_fault": null,
        "now": {"height_um": 31.0, "swing_um": 62.0, "hz": 60.0}
    }],
    "session": null,
    "participant": {
        "participant": null, "max_amplitude_um": 400.0, "max_continuous_s": 600.0, "pause_s": 10.0,
        "continuous_used_s": 12.5, "continuous_left_s": 587.5, "max_session_s": 3600.0,
        "session_used_s": null, "session_left_s": null, "max_day_s": 7200.0, "day_used_s": 900.0, "day_left_s": 6300.0
    },
    "daemon": {
        "version": "0.1.0", "pid": 1234, "socket": "/run/meissner/meissner.sock", "network": null, "role": "operate",
        "realtime": {"fifo": true, "mlock": true}, "array": "tula35-6x4", "calibrated": null, "drift_limit_um": 150.0,
        "lead_ms": 100.0, "lease_ms": 300.0, "logbook_problem": null, "logbook_lost": 0
    }
})))]
pub struct Status {
    /// `disarmed`, `armed`, `returning` (pins return to rest), `faulted` or `no-device`.
    pub state: String,
    /// Why the device is in this state: `boot`, `request`, `stop`, `shutdown`, `abort`, `estop`, `lease` (the host watchdog
    /// ran out), `link-lost`, `new-host`, `starved`, `panic`, `watchdog`, `output` (PIO or DMA failed) or `no-device`.
    pub cause: String,
    /// Whether the device knows where its pins are: `known` or `unknown`.
    pub position: String,
    /// For whom the motors are armed, and until when without a sign of life; null while they are not armed.
    pub armed: Option<ArmedStatus>,
    /// Pins that stand above rest while nothing drives them; null: none that the daemon knows of.
    pub standing: Option<StandingPins>,
    /// The emergency stops.
    pub estop: EStopStatus,
    /// The connected device; null without one.
    pub device: Option<DeviceInfo>,
    /// The way to the device.
    pub link: LinkStatus,
    /// The running play; null without one.
    pub play: Option<RunningPlay>,
    /// The plays that wait, in their order.
    pub queued: Vec<QueuedPlay>,
    /// The newest play and rendering.
    pub newest: Newest,
    /// The clocks of device and host at one instant; null without a device.
    pub clock: Option<ClockSample>,
    /// The motors, by number; empty until a device has connected.
    #[schema(max_items = 64)]
    pub motors: Vec<MotorStatus>,
    /// The running session; null without one.
    pub session: Option<Session>,
    /// The participant's limits, and what is used and left.
    pub participant: ParticipantStatus,
    /// The daemon, and what it is set to.
    pub daemon: DaemonStatus,
}

impl Status {
    /// Whether a device has completed the handshake; before that the daemon takes no commands for it.
    pub fn is_connected(&self) -> bool {
        self.device.is_some() && self.state != NO_DEVICE && self.clock.is_some()
    }
}
