//! The format of a case: what happens when, and what must be true after.
//!
//! Unknown keys are errors. A number may be written as `"value"`: then it is each of the case's values, a kind of its own.

use firmware_protocol::message::{DeviceMessage, State};
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Stroke;
use meissner_stream::Line;
use meissner_stream::queues::Command;
use meissner_test_support::paper::RATE;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use std::collections::VecDeque;
use std::time::Duration;

/// Ticks from the order to the onset.
pub const ONSET: u64 = 17_000;
/// Ticks from the onset on in which no phase is looked for.
pub const PHASE_AFTER: u64 = 42_500;

/// A case: a table of a file of `tests/faults`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// The table's name.
    #[serde(skip)]
    pub name: String,
    /// What the case stands for in a lab.
    pub why: String,
    /// Each is a kind of its own; the faults name it as `"value"`.
    #[serde(default = "one_value")]
    pub values: Vec<f64>,
    /// What the values are.
    #[serde(default)]
    pub unit: String,
    /// Each is a kind of its own, with each of the values; the faults name it as `at = "phase"`.
    #[serde(default)]
    pub phases: Vec<Phase>,
    pub fault: Vec<Fault>,
    pub expect: Expect,
}

fn one_value() -> Vec<f64> {
    vec![0.0]
}

/// A case with one of its values, and one of its phases if it has any.
#[derive(Clone, Copy)]
pub struct Kind<'a> {
    pub case: &'a Case,
    pub value: f64,
    pub phase: Option<Phase>,
}

impl Case {
    pub fn kinds(&self) -> impl Iterator<Item = Kind<'_>> {
        let phases = self.phases.iter().copied().map(Some);
        let phases: Vec<_> = if self.phases.is_empty() { vec![None] } else { phases.collect() };
        let with =
            move |value| phases.clone().into_iter().map(move |phase| Kind { case: self, value, phase });
        self.values.iter().copied().flat_map(with)
    }

    /// Whether it is about telemetry: then it plays with position control.
    pub fn is_closed_loop(&self) -> bool {
        self.fault.iter().any(|fault| matches!(fault.what, What::Telemetry(_)))
    }
}

impl Kind<'_> {
    /// Its value with the unit, and its phase; empty if it has neither.
    pub fn label(&self) -> String {
        let unit = &self.case.unit;
        let value = if unit.is_empty() { String::new() } else { format!("{} {unit}", self.value) };
        let phase = self.phase.map_or("", Phase::name);
        [value.as_str(), phase].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
    }

    /// When a fault begins, each time it happens: the time from the order. The order came at the tick `ordered`; its play has
    /// these strokes.
    pub fn begins(
        &self,
        fault: &Fault,
        ordered: Tick,
        strokes: &[Stroke],
    ) -> impl Iterator<Item = Duration> + use<> {
        let at = match fault.at {
            Moment::Ms(ms) => Duration::from_secs_f64(ms / 1e3),
            Moment::Phase(phase) => phase.after(ordered, strokes),
            Moment::OfKind(OfKind::Phase) => self.phase.unwrap().after(ordered, strokes),
        };
        let first = at.saturating_sub(Duration::from_secs_f64(fault.before_ms / 1e3));
        let every = fault.every_ms.map_or(Duration::ZERO, |every| every.ms(self.value));
        (0..fault.times).map(move |time| first + every * time)
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    pub at: Moment,
    /// The fault begins so many milliseconds before that moment.
    #[serde(default)]
    pub before_ms: f64,
    pub what: What,
    /// It happens so many times, each so many milliseconds after the one before.
    #[serde(default = "once")]
    pub times: u32,
    #[serde(default)]
    pub every_ms: Option<Number>,
    /// Milliseconds; without it the fault lasts until the play has ended.
    #[serde(default)]
    pub lasts_ms: Option<Number>,
}

fn once() -> u32 {
    1
}

/// Milliseconds after the order to play, or a phase of the first stroke half a second after the onset.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(untagged)]
pub enum Moment {
    Ms(f64),
    Phase(Phase),
    OfKind(OfKind),
}

/// `"phase"`: that of the kind.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OfKind {
    Phase,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    BeforeOnset,
    Up,
    Hold,
    Down,
    Between,
}

impl Phase {
    fn name(self) -> &'static str {
        match self {
            Self::BeforeOnset => "before-onset",
            Self::Up => "up",
            Self::Hold => "hold",
            Self::Down => "down",
            Self::Between => "between",
        }
    }

    fn after(self, ordered: Tick, strokes: &[Stroke]) -> Duration {
        let first = strokes.iter().position(|stroke| stroke.up >= ordered + ONSET + PHASE_AFTER).unwrap();
        let stroke = strokes[first];
        let next = strokes[first..].iter().skip(1).find(|next| next.motor == stroke.motor).unwrap();
        let tick = match self {
            Self::BeforeOnset => ordered + (ONSET - 850),
            Self::Up => stroke.up + u64::from(stroke.up_pulses / 2),
            Self::Hold => stroke.up + (u64::from(stroke.up_pulses) + (stroke.down - stroke.up)) / 2,
            Self::Down => stroke.down + u64::from(stroke.down_pulses / 2),
            Self::Between => stroke.end() + (next.up - stroke.end()) / 2,
        };
        Duration::from_secs_f64(RATE.ticks_to_seconds(tick - ordered))
    }
}

/// A number, or the value of the kind.
#[derive(Clone, Copy, Debug)]
pub struct Number(Option<f64>);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Either {
            Number(f64),
            Text(String),
        }
        match Either::deserialize(from)? {
            Either::Number(number) => Ok(Self(Some(number))),
            Either::Text(text) if text == "value" => Ok(Self(None)),
            Either::Text(text) => {
                Err(D::Error::custom(format!("`{text}` is neither a number nor \"value\"")))
            }
        }
    }
}

impl Number {
    pub fn of(self, value: f64) -> f64 {
        self.0.unwrap_or(value)
    }

    pub fn ms(self, value: f64) -> Duration {
        Duration::from_secs_f64(self.of(value) / 1e3)
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum What {
    /// The line, both ways or one.
    Line(LineFault),
    /// The host does nothing for so many ms.
    Stall(Number),
    /// The host is suspended for so many ms: its clock stands still.
    Suspend(Number),
    /// The host's program dies, and another begins so many ms later.
    Die(Number),
    /// The cable is out for so many ms.
    Unplug(Number),
    /// The board restarts.
    Restart,
    /// The board hangs, until its watchdog restarts it after so many ms.
    Hang(Number),
    /// The device's clock runs fast by so many millionths.
    ClockPpm(Number),
    /// The error of the device's clock changes by so many millionths each second, as with the temperature.
    ClockDrift(Number),
    /// So many bytes of nonsense come from the device.
    Nonsense(Number),
    /// A frame of an older protocol version comes.
    OlderVersion,
    /// The device lies in all its statuses.
    Lie(Lie),
    /// What the sensors say is wrong.
    Telemetry(Telemetry),
    /// An order.
    Order(Order),
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    Stop,
    Disarm,
    Estop,
}

impl Order {
    pub fn command(self) -> Command {
        match self {
            Self::Stop => Command::Stop,
            Self::Disarm => Command::Disarm,
            Self::Estop => Command::EStop,
        }
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lie {
    Clock,
    Credits,
    State,
    Counters,
    Sequence,
}

impl Lie {
    /// Changes a message of the device.
    pub fn tell(self, message: &mut DeviceMessage) {
        let DeviceMessage::Status(status) = message else { return };
        match self {
            Self::Clock => status.tick = Tick(0).wire(),
            Self::Credits => status.credits = u16::MAX,
            Self::State => status.state = State::Disarmed,
            Self::Counters => status.counters.played = 0,
            Self::Sequence => status.next_seq = status.next_seq.wrapping_add(100),
        }
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Telemetry {
    /// Every reading is the same.
    Stuck,
    /// Every reading is three times what it should be.
    Scaled,
    /// The readings are those of other motors.
    Swapped,
    /// No reading comes.
    Dead,
    /// Each reading is so many ms old, and says that it is new.
    LateMs(Number),
}

impl Telemetry {
    /// What changes the readings of the sensors, each with its tick. It returns whether the device sends them.
    pub fn fault(self, value: f64) -> impl FnMut(Tick, &mut [i32]) -> bool + Send + use<> {
        let mut before: VecDeque<(Tick, Vec<i32>)> = VecDeque::new();
        move |tick, y| {
            match self {
                Self::Stuck => y.fill(700),
                Self::Scaled => y.iter_mut().for_each(|y| *y *= 3),
                Self::Swapped => y.reverse(),
                Self::Dead => return false,
                Self::LateMs(ms) => {
                    let late = RATE.ms_in_ticks(ms.of(value)) as i64;
                    before.push_back((tick, y.to_vec()));
                    while before.get(1).is_some_and(|(then, _)| tick.since(*then) >= late) {
                        before.pop_front();
                    }
                    y.copy_from_slice(&before[0].1);
                }
            }
            true
        }
    }
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum To {
    Device,
    Host,
    #[default]
    Both,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LineFault {
    #[serde(default)]
    to: To,
    #[serde(default)]
    loses_percent: Option<Number>,
    #[serde(default)]
    repeats_percent: Option<Number>,
    #[serde(default)]
    damages_percent: Option<Number>,
    #[serde(default)]
    loses_bytes_percent: Option<Number>,
    #[serde(default)]
    delay_ms: Option<Number>,
    #[serde(default)]
    jitter_ms: Option<Number>,
    /// It delivers nothing, and everything at once when the fault is over.
    #[serde(default)]
    holds: bool,
}

impl LineFault {
    /// The lines towards the device and towards the host.
    pub fn lines(&self, value: f64) -> (Line, Line) {
        let share = |number: Option<Number>| number.map_or(0.0, |number| number.of(value) / 100.0);
        let time = |number: Option<Number>| number.map_or(Duration::ZERO, |number| number.ms(value));
        let bad = Line {
            loss: share(self.loses_percent),
            repeat: share(self.repeats_percent),
            corrupt: share(self.damages_percent),
            byte_loss: share(self.loses_bytes_percent),
            delay: time(self.delay_ms),
            jitter: time(self.jitter_ms),
            bytes_per_s: 0,
            holds: self.holds,
        };
        match self.to {
            To::Device => (bad, Line::default()),
            To::Host => (Line::default(), bad),
            To::Both => (bad, bad),
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expect {
    /// `done`: the play comes to its end; `cut`: it does not; `any`.
    pub play: Ends,
    /// For a play that is cut: at most so many ms after the last fault began, all lines are low for good.
    #[serde(default)]
    pub safe_ms: Option<f64>,
    /// The device is latched at the end.
    #[serde(default)]
    pub latched: bool,
    /// What shows that the fault has happened.
    #[serde(default)]
    pub shows: Option<Evidence>,
    /// For a play that is done: at most this percentage of its bursts is not played; 0 if it is left out.
    #[serde(default)]
    pub lost_percent: f64,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// Frames were sent again.
    Resent,
    /// The host could not read frames.
    Unread,
    /// The device could not read frames.
    UnreadByDevice,
    /// The daemon was told that the device contradicts itself.
    Contradictions,
    /// The host's estimate of the device's clock runs off by at least 50 millionths.
    Rate,
    /// A sensor was set aside.
    SensorSetAside,
    /// The line lost, repeated, damaged, delayed or held back frames.
    Line,
    /// The host did not know from telemetry where a pin was.
    Unmeasured,
}

impl Evidence {
    pub const ALL: [Self; 8] = [
        Self::Resent,
        Self::Unread,
        Self::UnreadByDevice,
        Self::Contradictions,
        Self::Rate,
        Self::SensorSetAside,
        Self::Line,
        Self::Unmeasured,
    ];
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "kebab-case")]
pub enum Ends {
    Done,
    Cut,
    Any,
}
