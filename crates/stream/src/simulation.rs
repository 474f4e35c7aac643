//! Virtual-time simulation: the streamer against the mock, over a line that may be bad.
//!
//! [`simulate_play`] plays a pattern and returns its outcome; [`Simulation`] gives tests control of time, commands and the
//! line. It drives [`Streamer`] and [`Mock`] as the thread and a board would, and contains none of their logic.
//!
//! Invariant: deterministic. The same seed, commands and stalls give the same bytes.

use crate::bandwidth::Bandwidth;
use crate::control::Gains;
use crate::device::mock::Mock;
use crate::faulty::{DeviceClock, Direction, Liar, Line};
use crate::link::LineRate;
use crate::queues::{
    Command, Emit, Heights, LatelyHeights, MeasuredBurst, Outcome, Play, Request, StreamEvent,
};
use crate::settings::Settings;
use crate::streamer::Streamer;
use crate::time::HostInstant;
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::DeviceMessage;
use firmware_protocol::tick::Tick;
use meissner_api::EndCause;
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::simulated::{RestStats, SimulatedMotorsConfig, SimulatedMotorsError};
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes, StrokesError};
use std::time::Duration;

/// The streamer wakes up this often.
const STEP: Duration = Duration::from_micros(500);

/// At least this often while nothing plays.
const IDLE_STEP: Duration = Duration::from_millis(50);

/// So long after a play's end, telemetry without delay has measured its last bursts.
const MEASURED_WITHIN: Duration = Duration::from_millis(100);

/// A streamer and a mock in virtual time.
#[derive(Debug)]
pub struct Simulation {
    array: Array,
    /// The streamer.
    pub streamer: Streamer,
    /// The device.
    pub mock: Mock,
    now: HostInstant,
    clock: DeviceClock,
    /// The device does nothing.
    hangs: bool,
    to_device: Direction,
    to_host: Direction,
    liar: Option<Liar>,
    events: EventLog,
    tickets: u64,
}

/// The events so far; measured bursts only on request.
#[derive(Debug)]
struct EventLog {
    events: Vec<StreamEvent>,
    measured_bursts: Option<Vec<MeasuredBurst>>,
    contradictions: u64,
    heights: Heights,
}

impl Emit for EventLog {
    fn event(&mut self, event: StreamEvent) {
        self.contradictions += u64::from(matches!(event, StreamEvent::Contradiction(_)));
        self.events.push(event);
    }

    fn measured(&mut self, burst: MeasuredBurst) {
        self.measured_bursts.iter_mut().for_each(|kept| kept.push(burst));
    }

    fn heights(&self) -> Option<&Heights> {
        Some(&self.heights)
    }
}

/// The host's time at the first boot of the device.
const STARTED: HostInstant = HostInstant::from_ns(1_000_000_000);

impl Simulation {
    /// Connects a new streamer to a mock that was just switched on.
    ///
    /// # Errors
    /// If the settings of the simulated motors are out of range.
    pub fn new(
        motors: &SimulatedMotorsConfig,
        settings: Settings,
        line: Line,
        seed: u64,
    ) -> Result<Self, SimulatedMotorsError> {
        let mut new = Self {
            array: settings.array,
            streamer: Streamer::new(settings),
            mock: Mock::new(settings.array, *motors, seed as u32)?,
            now: STARTED,
            clock: DeviceClock::started(settings.array.rate(), STARTED),
            hangs: false,
            to_device: Direction::new(line, seed ^ 0x5eed),
            to_host: Direction::new(Line { bytes_per_s: 0, ..line }, seed ^ 0xfeed),
            liar: None,
            events: EventLog {
                events: Vec::new(),
                measured_bursts: None,
                contradictions: 0,
                heights: Heights::new(None),
            },
            tickets: 0,
        };
        new.connect();
        Ok(new)
    }

    /// Opens a new session, as after [`Self::unplug`].
    pub fn connect(&mut self) {
        let id = self.now.as_ns() as u32;
        self.streamer.connect(self.now, id, LineRate::USB_FULL_SPEED, &mut self.events);
    }

    /// Pulls the cable: the device returns the pins, and the streamer sees the disconnect.
    pub fn unplug(&mut self) {
        self.mock.unplug();
        self.to_device.clear();
        self.to_host.clear();
        self.streamer.disconnect(self.now, EndCause::Unplugged, &mut self.events);
    }

    /// Replaces the device by one that has just been switched on, with another boot id: its clock begins again.
    ///
    /// # Errors
    /// If the settings of the simulated motors are out of range.
    pub fn restart(&mut self, motors: &SimulatedMotorsConfig, boot: u32) -> Result<(), SimulatedMotorsError> {
        self.unplug();
        self.mock = Mock::new(self.array, *motors, boot)?;
        self.clock.restart(self.now);
        self.hangs = false;
        self.connect();
        Ok(())
    }

    /// Changes the line.
    pub fn set_line(&mut self, line: Line) {
        (self.to_device.line, self.to_host.line) = (line, Line { bytes_per_s: 0, ..line });
    }

    /// Frames that the line has lost, repeated, damaged, delayed or held back so far.
    pub fn harmed_frames(&self) -> u64 {
        self.to_device.harmed() + self.to_host.harmed()
    }

    /// Changes each direction of the line.
    pub fn set_lines(&mut self, to_device: Line, to_host: Line) {
        (self.to_device.line, self.to_host.line) = (to_device, to_host);
    }

    /// From here on the device's clock runs fast by so many millionths, or slow.
    pub fn set_clock_error(&mut self, ppm: f64) {
        self.clock.set_error(self.now, ppm);
    }

    /// From here on the error of the device's clock changes by so many millionths each second, as with the temperature.
    pub fn drift_clock(&mut self, ppm_per_s: f64) {
        self.clock.drift(self.now, ppm_per_s);
    }

    /// The device's clock goes on by `time` and the host's stands still, as while the host is suspended.
    pub fn suspend(&mut self, time: Duration) {
        let before = self.clock;
        // The device does not wait either.
        for _ in 0..time.as_micros() / STEP.as_micros() {
            self.clock.jump(STEP);
            self.device();
        }
        self.clock = before;
        self.clock.jump(time);
    }

    /// From here on the device does nothing, with its lines as the board's watchdog leaves them: low. It restarts at
    /// [`Self::restart`].
    pub fn hang(&mut self) {
        self.hangs = true;
    }

    /// Bytes come as if from the device.
    pub fn inject(&mut self, bytes: &[u8]) {
        self.to_host.send(self.now, bytes);
    }

    /// The device's clock at an instant.
    pub fn device_tick_at(&self, at: HostInstant) -> Tick {
        self.clock.tick_at(at)
    }

    fn device_tick(&self) -> Tick {
        self.device_tick_at(self.now)
    }

    /// From here on `lie` may change each message of the device before it is sent: the device lies, the line does not.
    pub fn lie(&mut self, lie: impl FnMut(&mut DeviceMessage) + Send + 'static) {
        self.liar = Some(Liar::new(lie));
    }

    /// From here on the device's messages are sent as they are.
    pub fn stop_lying(&mut self) {
        self.liar = None;
    }

    /// How often the streamer reported that the device contradicts itself.
    pub fn contradictions(&self) -> u64 {
        self.events.contradictions
    }

    /// Virtual time.
    pub fn now(&self) -> HostInstant {
        self.now
    }

    /// Sends a command; returns its ticket.
    pub fn send(&mut self, command: Command) -> u64 {
        self.send_issued_at(self.now, command)
    }

    /// Sends a command issued before now, while the host was stalled; returns its ticket.
    pub fn send_issued_at(&mut self, given: HostInstant, command: Command) -> u64 {
        self.tickets += 1;
        let request = Request { ticket: self.tickets, issued_at: given, command };
        self.streamer.execute(self.now, request, &mut self.events);
        self.tickets
    }

    /// Advances the time of both.
    pub fn run(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now = (self.now + STEP).min(end);
            self.device();
            self.wake();
        }
    }

    /// Advances the time of both while nothing plays. The streamer wakes up only when it has something to do or bytes are under
    /// way: so days pass in seconds.
    pub fn idle(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            let under_way = !(self.to_device.is_empty() && self.to_host.is_empty());
            let due = if under_way { self.now } else { self.streamer.wake_at(self.now) };
            self.now = due.clamp(self.now + STEP, self.now + IDLE_STEP).min(end);
            self.device();
            self.wake();
        }
    }

    /// Advances the time of the device only: the host stalls, and what the device sends waits.
    pub fn stall(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now = (self.now + STEP).min(end);
            self.device();
        }
    }

    fn device(&mut self) {
        let bytes = self.to_device.arrived(self.now);
        if self.hangs {
            return;
        }
        self.mock.write(&bytes);
        self.mock.run(self.device_tick());
        let mut bytes = [0; 4096];
        loop {
            let len = self.mock.read(&mut bytes);
            if len == 0 {
                break;
            }
            let (now, to_host) = (self.now, &mut self.to_host);
            match &mut self.liar {
                Some(liar) => liar.change(&bytes[..len], |frame| to_host.send(now, frame)),
                None => to_host.send(now, &bytes[..len]),
            }
        }
    }

    /// The host wakes up now, as after [`Self::stall`]: it reads, decides and sends.
    pub fn wake(&mut self) {
        let emit = &mut self.events;
        for chunk in self.to_host.arrived(self.now).chunks(1024) {
            self.streamer.receive(self.now, chunk, emit);
        }
        self.streamer.step(self.now, emit);
        let mut frame = [0; MAX_FRAME];
        loop {
            let len = self.streamer.transmit(self.now, &mut frame, emit);
            if len == 0 {
                break;
            }
            self.to_device.send(self.now, &frame[..len]);
        }
    }

    /// Takes the events since the last call.
    pub fn take_events(&mut self) -> Vec<StreamEvent> {
        std::mem::take(&mut self.events.events)
    }

    /// Asks for the heights of the pins, and returns those that the streamer has written last.
    pub fn heights(&mut self) -> Option<LatelyHeights> {
        self.events.heights.ask();
        self.wake();
        self.events.heights.read(self.array.motors())
    }

    /// Takes the measured bursts since the last call; the first call starts to keep them.
    pub fn take_measured_bursts(&mut self) -> Vec<MeasuredBurst> {
        self.events.measured_bursts.replace(Vec::new()).unwrap_or_default()
    }

    /// Runs until the play `id` has ended, for `at_most`; returns its outcome.
    pub fn run_to_end(&mut self, id: u64, at_most: Duration) -> Option<Outcome> {
        let end = self.now + at_most;
        while self.now < end {
            self.run(Duration::from_millis(10));
            let ended =
                self.events.events.iter().position(
                    |event| matches!(event, StreamEvent::PlayEnded { id: ended, .. } if *ended == id),
                );
            if let Some(StreamEvent::PlayEnded { outcome, .. }) =
                ended.map(|at| self.events.events.remove(at))
            {
                return Some(outcome);
            }
        }
        None
    }
}

/// The result of a simulated play.
#[derive(Debug)]
pub struct SimulatedPlay {
    /// True rest errors of the pins.
    pub rest: RestStats,
    /// How the pattern became strokes.
    pub options: StrokeOptions,
    /// The play's outcome.
    pub outcome: Outcome,
    /// Its bursts as telemetry measured them.
    pub measured_bursts: Vec<MeasuredBurst>,
}

/// Why a play could not be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// The settings of the simulated motors are out of range.
    #[error(transparent)]
    Motors(#[from] SimulatedMotorsError),
    /// The pattern could not be compiled.
    #[error(transparent)]
    Strokes(#[from] StrokesError),
    /// The pattern is for another array.
    #[error("pattern `{pattern}` is not for the array {array}: choose a pattern that is")]
    OtherArray {
        /// The pattern's name.
        pattern: String,
        /// The array of the simulation.
        array: &'static str,
    },
    /// The pattern has no end, and no length was given.
    #[error("pattern `{0}` has no end: say how many seconds")]
    Endless(String),
    /// The play did not end.
    #[error("the simulation of pattern `{0}` did not end: a bug, please report it")]
    NoEnd(String),
}

/// Plays `pattern` for `seconds` (or to its end) on a new mock over a perfect line, in virtual time.
///
/// # Errors
/// If it is for another array, cannot be compiled or has no end.
pub fn simulate_play(
    pattern: &Pattern,
    seconds: Option<f64>,
    motors: &SimulatedMotorsConfig,
    settings: Settings,
    open_loop: bool,
) -> Result<SimulatedPlay, SimulationError> {
    if pattern.array() != settings.array {
        let (pattern, array) = (pattern.name().to_owned(), settings.array.spec().name());
        return Err(SimulationError::OtherArray { pattern, array });
    }
    let surplus = settings.surplus(&PerMotor::all(settings.array, Gains::default()));
    let options = StrokeOptions { surplus, ..StrokeOptions::lasting(seconds) };
    let strokes = Strokes::new(pattern, &options)?;
    let name = || pattern.name().to_owned();
    let end = strokes.end().ok_or_else(|| SimulationError::Endless(name()))?;
    let mut simulation = Simulation::new(motors, settings, Line::default(), motors.seed)?;
    simulation.take_measured_bursts();
    simulation.run(Duration::from_millis(100));
    simulation.send(Command::Arm { assume_rest: settings.lower_stop.is_none() });
    // With a lower stop this seeks it.
    simulation.run(Duration::from_millis(20) + settings.seek_time());
    let bandwidth = Bandwidth::of(&strokes, &settings);
    let play = Play { open_loop, bandwidth, ..Play::new(1, strokes) };
    simulation.send(Command::Play(Box::new(play)));
    let length = Duration::from_secs_f64(settings.array.rate().ticks_to_seconds(end));
    let outcome = simulation.run_to_end(1, length + Duration::from_secs(2));
    let outcome = outcome.ok_or_else(|| SimulationError::NoEnd(name()))?;
    // Telemetry still has to measure the last bursts.
    simulation.run(MEASURED_WITHIN + Duration::from_millis(motors.telemetry_age_ms.into()));
    let measured_bursts = simulation.take_measured_bursts();
    Ok(SimulatedPlay { options, rest: simulation.mock.true_positions().rest(), outcome, measured_bursts })
}
