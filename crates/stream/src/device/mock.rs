//! The mock: a controller and simulated motors, in virtual time.
//!
//! It is a thin shell around the controller, as the firmware is: it renders blocks ahead within the horizon, plays them
//! tick by tick into the simulated motors, and holds the lines low when the controller says so. Its owner passes the tick
//! up to which it runs ([`Mock::run`]), and moves bytes with [`Mock::write`] and [`Mock::read`]. Each run takes the
//! waiting bytes in first, so a stall of the host does not make strokes late.
//!
//! Invariant: it reads no clock; the same seed and bytes in give the same bytes out.

use firmware_protocol::board::{Measures, Reset, SelfTest};
use firmware_protocol::controller::{BLOCK, Controller, HORIZON, Identity, Run};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{Cause, DeviceHello, State};
use firmware_protocol::stroke::Lines;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::{
    RestStats, Sample, SimulatedMotors, SimulatedMotorsConfig, SimulatedMotorsError,
};
use meissner_array::spec::Array;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Edges of the trigger input that wait for their ticks, at most.
const EDGES: usize = 1024;
/// Bytes that wait in either direction at most; beyond that the sender waits.
const BUFFER: usize = 1 << 16;

/// The true positions of simulated pins, whatever telemetry says. Other threads read it while the mock runs.
#[derive(Debug)]
pub struct TruePositions {
    /// Of each motor.
    rest: Mutex<Vec<RestStats>>,
}

impl TruePositions {
    /// Where pins came to rest, over all motors.
    pub fn rest(&self) -> RestStats {
        let mut all = RestStats::default();
        for motor in self.rest.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            all.merge(motor);
        }
        all
    }
}

/// A simulated device.
#[derive(Debug)]
pub struct Mock {
    controller: Box<Controller>,
    motors: SimulatedMotors,
    /// Rendered but not played.
    ahead: VecDeque<Run>,
    /// The first tick not played.
    now: Tick,
    to_controller: Vec<u8>,
    to_host: VecDeque<u8>,
    /// What was played, if [`Mock::record`] was called.
    trace: Option<Vec<(Tick, Run)>>,
    positions: Arc<TruePositions>,
    distort: Option<Distortion>,
    /// Ticks of the edges to come, in order, and who has ordered each.
    edges: VecDeque<(Tick, u64)>,
}

/// What changes telemetry samples before they are sent.
struct Distortion(Box<dyn FnMut(&mut Sample) -> bool + Send>);

impl std::fmt::Debug for Distortion {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("Distortion")
    }
}

impl Mock {
    /// A mock of this array that has just been switched on; `boot` is its boot id.
    ///
    /// # Errors
    /// If the settings of the simulated motors are out of range.
    pub fn new(array: Array, motors: SimulatedMotorsConfig, boot: u32) -> Result<Self, SimulatedMotorsError> {
        Self::starting_at(array, motors, boot, Tick::BOOT)
    }

    /// Like [`Self::new`], but its clock starts at `now`.
    ///
    /// # Errors
    /// If the settings of the simulated motors are out of range.
    pub fn starting_at(
        array: Array,
        motors: SimulatedMotorsConfig,
        boot: u32,
        now: Tick,
    ) -> Result<Self, SimulatedMotorsError> {
        let mut version = env!("CARGO_PKG_VERSION").split('.').map(|part| part.parse().unwrap_or(0));
        let firmware = std::array::from_fn(|_| version.next().unwrap_or(0));
        let telemetry = if motors.telemetry_hz > 0 { DeviceHello::TELEMETRY } else { 0 };
        let features = DeviceHello::SIMULATED | DeviceHello::TRIGGER_INPUT | telemetry;
        let identity = Identity { firmware, build: *b"mock", boot, features };
        let mut controller = Box::new(Controller::starting_at(identity, *array.layout(), now));
        // It renders in no time, and has no USB and no executor.
        controller.measured(Measures { reset: Reset::Program, ..Measures::NONE });
        Ok(Self {
            controller,
            motors: SimulatedMotors::new(array, motors, now)?,
            ahead: VecDeque::with_capacity(2 * HORIZON as usize),
            now,
            to_controller: Vec::with_capacity(BUFFER),
            to_host: VecDeque::with_capacity(BUFFER),
            trace: None,
            positions: Arc::new(TruePositions {
                rest: Mutex::new(vec![RestStats::default(); array.motors()]),
            }),
            distort: None,
            edges: VecDeque::with_capacity(EDGES),
        })
    }

    /// From here on keeps every run of lines that it plays, for [`Self::take_trace`].
    pub fn record(&mut self) {
        self.trace = Some(Vec::new());
    }

    /// From here on `distort` changes each telemetry sample before it is sent: a sensor fault (stuck, swapped, out of
    /// scale).
    pub fn distort_telemetry(&mut self, mut distort: impl FnMut(&mut Sample) + Send + 'static) {
        self.filter_telemetry(move |sample| {
            distort(sample);
            true
        });
    }

    /// Like [`Self::distort_telemetry`], but only the samples for which `distort` returns true are sent.
    pub fn filter_telemetry(&mut self, distort: impl FnMut(&mut Sample) -> bool + Send + 'static) {
        self.distort = Some(Distortion(Box::new(distort)));
    }

    /// The true position of a pin at rest, µm.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn position_um(&self, motor: u8) -> f64 {
        self.motors.position_um(motor)
    }

    /// As [`Self::position_um`], of every pin.
    pub fn positions_um(&self) -> Vec<f64> {
        (0..self.motors.count()).map(|motor| self.position_um(motor)).collect()
    }

    /// The runs played since [`Self::record`] or the last call: for each its first tick, lines and length.
    pub fn take_trace(&mut self) -> Vec<(Tick, Run)> {
        self.trace.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// The controller.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// The first tick not played.
    pub fn now(&self) -> Tick {
        self.now
    }

    /// Which simulated array it is: see [`SimulatedMotors::identity`].
    pub fn identity(&self) -> String {
        self.motors.identity()
    }

    /// The true positions of its pins, for other threads to read.
    pub fn true_positions(&self) -> Arc<TruePositions> {
        Arc::clone(&self.positions)
    }

    /// Hands over bytes for the controller, which takes them in at the next [`Self::run`]; returns how many had room.
    pub fn write(&mut self, bytes: &[u8]) -> usize {
        let len = bytes.len().min(BUFFER - self.to_controller.len());
        self.to_controller.extend_from_slice(&bytes[..len]);
        len
    }

    /// Reads bytes from the controller; returns how many.
    pub fn read(&mut self, bytes: &mut [u8]) -> usize {
        let len = bytes.len().min(self.to_host.len());
        for (to, from) in bytes.iter_mut().zip(self.to_host.drain(..len)) {
            *to = from;
        }
        len
    }

    /// Pulls the cable.
    pub fn unplug(&mut self) {
        self.to_controller.clear();
        self.to_host.clear();
        self.controller.link_lost(self.now);
    }

    /// The device finds a fault of its own: all lines go off after this tick.
    pub fn fault(&mut self, cause: Cause) {
        self.controller.fault(self.now, cause);
        self.play(1, false);
    }

    /// A rising edge of the trigger input comes at this tick, or in the last tick played if that is later, by order of client `by`.
    /// Returns whether there was room for it: 1 024 may wait.
    pub fn edge_at(&mut self, tick: Tick, by: u64) -> bool {
        if tick < self.now {
            self.controller.edge(Tick(self.now.0 - 1));
            return true;
        }
        let room = self.edges.len() < EDGES;
        if room {
            self.edges.insert(self.edges.partition_point(|&(waits, _)| waits <= tick), (tick, by));
        }
        room
    }

    /// Forgets the edges to come that this client has ordered.
    pub fn withdraw_edges(&mut self, by: u64) {
        self.edges.retain(|&(_, of)| of != by);
    }

    /// Whether nothing can happen in the controller until bytes come.
    fn is_quiet(&self) -> bool {
        matches!(self.controller.state(), State::Disarmed | State::Faulted)
    }

    /// Takes the bytes in, then plays all ticks before `until`.
    pub fn run(&mut self, until: Tick) {
        if self.is_quiet() && self.now < until {
            // Nothing happened since the last run. Bytes that wait now count as received now, not then.
            self.pass(until);
        }
        let latched = self.controller.state() == State::Faulted;
        self.controller.receive(self.now, &self.to_controller);
        self.to_controller.clear();
        if !latched && self.controller.state() == State::Faulted {
            // An e-stop ends with the tick in which it comes: that one counts as played.
            self.play(1, false);
        }
        self.pass(until);
        // Send after all blocks were played: a status must carry the tick of now, not of an earlier block.
        self.send();
        while let Some(mut sample) = self.motors.telemetry() {
            if let Some(Distortion(distort)) = &mut self.distort
                && !distort(&mut sample)
            {
                continue;
            }
            self.controller.telemetry(sample.tick, &sample.y);
            self.send();
        }
        if let Ok(mut rest) = self.positions.rest.try_lock() {
            for (all, new) in rest.iter_mut().zip(self.motors.take_rest_stats()) {
                all.merge(&new);
            }
        }
    }

    fn pass(&mut self, until: Tick) {
        loop {
            let quiet = self.is_quiet();
            let end = if quiet { until } else { until.min(self.now + u64::from(BLOCK)) };
            self.render(end);
            while self.now < end {
                self.play(end - self.now, self.controller.forced_off(self.now));
            }
            while let Some((tick, _)) = self.edges.pop_front_if(|(tick, _)| *tick < self.now) {
                self.controller.edge(tick);
            }
            self.controller.poll(self.now);
            if self.now >= until {
                break;
            }
        }
        self.render(self.now);
    }

    /// Renders whole blocks: as many as fit the horizon, and at least up to `end`.
    fn render(&mut self, end: Tick) {
        loop {
            let rendered = self.controller.rendered();
            let block = (end - rendered).max(1).next_multiple_of(BLOCK.into());
            if rendered >= end && rendered + block > self.now + u64::from(HORIZON) {
                break;
            }
            let block_end = rendered + block;
            while self.controller.rendered() < block_end {
                let max = (block_end - self.controller.rendered()).min(u32::MAX.into());
                self.ahead.push_back(self.controller.render(max as u32));
            }
        }
    }

    /// Plays at most `max` rendered ticks, with all lines low if they are `forced` off.
    fn play(&mut self, max: u64, forced: bool) {
        let Some(front) = self.ahead.front_mut() else { return };
        // Forcing may end within a block, so check every tick; only a fault keeps it until bytes come.
        let most = if forced && self.controller.state() != State::Faulted { 1 } else { max };
        let ticks = u64::from(front.ticks).min(most) as u32;
        let off = Run { lines: Lines::OFF, trigger: false, drivers: false, ticks };
        let run = if forced { off } else { Run { ticks, ..*front } };
        front.ticks -= ticks;
        if front.ticks == 0 {
            self.ahead.pop_front();
        }
        if let Some(trace) = &mut self.trace {
            trace.push((self.now, run));
        }
        // A line does nothing while its driver is off.
        self.motors.advance(if run.drivers { run.lines } else { Lines::OFF }, ticks.into());
        self.now = self.now + u64::from(ticks);
    }

    fn send(&mut self) {
        // It has nothing of what a self-test checks.
        self.controller.tested(SelfTest::default());
        let mut frame = [0; MAX_FRAME];
        while self.to_host.len() + MAX_FRAME <= BUFFER {
            let len = self.controller.transmit(self.now, &mut frame);
            if len == 0 {
                break;
            }
            self.to_host.extend(&frame[..len]);
        }
    }
}
