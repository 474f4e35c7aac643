//! Runs the host's streamer and a device on a bench in lock-step.
//!
//! Unlike `meissner_stream::Simulation`, it has a cable, a tty and an operating system between them: a device is plugged in
//! and out, a process is stalled or killed. It has no logic of streamer or controller. The device receives what the host
//! sends at the beginning of the next step.

mod cable;
mod faults;

use crate::bench::chip::ChipBench;
use crate::bench::{Bench, BenchError, Function, Which};
use crate::judge::{Boot, Quiet};
use crate::oracle;
use crate::tap::{Event, Tap};
use crate::time::{Grid, HostClock, MS, host};
use cable::Cable;
pub use cable::Faults;
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::HostMessage;
use firmware_protocol::tick::Tick;
use meissner_api::EndCause;
use meissner_array::spec::Array;
use meissner_stream::link::LineRate;
use meissner_stream::queues::{Command, Outcome, Request, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_stream::{Settings, Streamer};

/// Interval of the host's wake-ups.
const STEP: u64 = MS / 2;
/// The same while the host stands still for longer than [`LONG`]: nothing happens in between.
const LONG_STEP: u64 = 10 * MS;
const LONG: u64 = 1_000 * MS;
/// The host's nominal line rate: USB at full speed, as for a real board.
const RATE: LineRate = LineRate::USB_FULL_SPEED;

/// Why a run cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The device is gone.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// Something expected did not happen.
    #[error("{0} did not happen within {1} ms")]
    Timeout(&'static str, u64),
}

/// How a rig is set up.
#[derive(Clone, Copy, Debug)]
pub struct RigOptions {
    /// The streamer's settings. By default drift limits no play: a chip has no sensor.
    pub settings: Settings,
    /// The USB function the host uses.
    pub function: Function,
    /// Faults of the line for the host's frames.
    pub faults: Faults,
    /// Seed of the line's faults and the session numbers.
    pub seed: u64,
}

impl Default for RigOptions {
    fn default() -> Self {
        let settings = Settings { drift_limit_um: f32::INFINITY, ..Settings::of(Array::paper()) };
        Self { settings, function: Function::default(), faults: Faults::default(), seed: 0 }
    }
}

/// A host and a device.
#[derive(Debug)]
pub struct Rig {
    /// The device.
    pub bench: Bench,
    /// The host.
    pub streamer: Streamer,
    function: Function,
    now: u64,
    /// The host's clock, by the cycles.
    clock: HostClock,
    cable: Cable,
    /// Whether the host asks for e-stops by control requests, too.
    pub requests_e_stops: bool,
    /// The epoch of an e-stop to ask for.
    e_stop: Option<u16>,
    /// Whether the host opens a device that is plugged in.
    hot_plug: bool,
    connected: bool,
    dead: bool,
    held_until: u64,
    sessions: u32,
    resets: u64,
    tap: Tap,
    death: Option<u64>,
    quiets: Vec<Quiet>,
    from: u64,
    boots: Vec<Boot>,
    /// The host's events, in order.
    pub notices: Vec<StreamEvent>,
    tickets: u64,
}

impl Rig {
    /// Powers the device up; the host waits for it.
    ///
    /// # Errors
    /// If there is no device.
    pub fn new(which: &Which, options: RigOptions) -> Result<Self, RigError> {
        Ok(Self {
            bench: Bench::start(which)?,
            streamer: Streamer::new(options.settings),
            function: options.function,
            now: 0,
            clock: HostClock::default(),
            cable: Cable::new(options.faults.line(), options.seed),
            requests_e_stops: true,
            e_stop: None,
            hot_plug: true,
            connected: false,
            dead: false,
            held_until: 0,
            sessions: options.seed as u32,
            resets: 0,
            tap: Tap::default(),
            death: None,
            quiets: Vec::new(),
            from: 0,
            boots: Vec::new(),
            notices: Vec::new(),
            tickets: 0,
        })
    }

    /// The bench's clock.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.now
    }

    /// The host's clock now.
    #[must_use]
    pub fn host_time(&self) -> HostInstant {
        self.clock.at(self.now)
    }

    /// The traffic of the link in this boot.
    #[must_use]
    pub fn tap(&self) -> &Tap {
        &self.tap
    }

    /// The emulated chip, if the bench is one.
    pub fn chip(&mut self) -> Option<&mut ChipBench> {
        match &mut self.bench {
            Bench::Mock(_) => None,
            Bench::Chip(chip) => Some(chip),
        }
    }

    /// The grid of the device's ticks: from its pins once they have pulsed, before that from the link.
    #[must_use]
    pub fn grid(&self) -> Grid {
        match &self.bench {
            Bench::Mock(mock) => mock.grid(),
            Bench::Chip(chip) => {
                let first = chip.pins.first().zip(oracle::expect(&self.tap, None).log.first());
                first.map_or_else(|| self.link_grid(), |(cycle, tick)| Grid::through(tick, cycle))
            }
        }
    }

    /// The grid by the link: a message with a tick was sent after that tick began, at least by the time of its transfer.
    fn link_grid(&self) -> Grid {
        let told = self.tap.events.iter().filter_map(|(cycle, event)| match event {
            Event::Status(_, tick) => Some(Grid::through(*tick, *cycle)),
            Event::Greeted(hello) => Some(Grid::through(Tick(hello.tick), *cycle)),
            _ => None,
        });
        told.min_by_key(|grid| grid.origin).unwrap_or(Grid { origin: self.now.cast_signed() })
    }

    /// Gives the host's process a command and returns its ticket. A killed process takes none.
    pub fn order(&mut self, job: Command) -> u64 {
        self.tickets += 1;
        let now = self.host_time();
        let order = Request { ticket: self.tickets, issued_at: now, command: job };
        self.streamer.execute(now, order, &mut self.notices);
        // The process wakes up at once.
        self.host();
        self.tickets
    }

    /// Runs up to a cycle.
    ///
    /// # Errors
    /// If the device is gone; also for the methods below.
    pub fn run_to(&mut self, cycle: u64) -> Result<(), RigError> {
        while self.now < cycle {
            let is_idle = self.held_until > self.now + LONG;
            let step = if is_idle { LONG_STEP } else { STEP };
            self.step((self.now + step).min(cycle))?;
        }
        Ok(())
    }

    /// Runs until the host has greeted a device and knows its clock.
    ///
    /// # Errors
    /// If that takes longer than `at_most` ms.
    pub fn run_to_greeting(&mut self, at_most: u64) -> Result<(), RigError> {
        let end = self.now + at_most * MS;
        while self.tap.hello().is_none() || self.streamer.tick_at(self.host_time()).is_none() {
            if self.now >= end {
                return Err(RigError::Timeout("a handshake", at_most));
            }
            self.step(self.now + STEP)?;
        }
        Ok(())
    }

    /// Runs until play `id` has ended and returns its outcome.
    ///
    /// # Errors
    /// If that takes longer than `at_most` ms.
    pub fn run_to_end(&mut self, id: u64, at_most: u64) -> Result<&Outcome, RigError> {
        let end = self.now + at_most * MS;
        while !self
            .notices
            .iter()
            .any(|notice| matches!(notice, StreamEvent::PlayEnded { id: ended, .. } if *ended == id))
        {
            if self.now >= end {
                return Err(RigError::Timeout("the end of a play", at_most));
            }
            self.step(self.now + STEP)?;
        }
        let outcome = self.notices.iter().find_map(|notice| match notice {
            StreamEvent::PlayEnded { id: ended, outcome } if *ended == id => Some(outcome),
            _ => None,
        });
        outcome.ok_or(RigError::Timeout("the end of a play", at_most))
    }

    fn step(&mut self, to: u64) -> Result<(), RigError> {
        if let Some(epoch) = self.e_stop.take() {
            self.bench.e_stop(epoch)?;
        }
        self.deliver()?;
        let heard = self.bench.run(to)?;
        self.now = self.bench.cycle().max(to);
        let bytes = if self.function == Function::Cdc { heard.cdc } else { heard.bulk };
        self.tap.from_device(self.now, &bytes);
        self.cable.hear(host(self.now), &bytes);
        if self.bench.resets() != self.resets {
            self.resets = self.bench.resets();
            self.end_boot();
        }
        if self.connected && !self.bench.configured() {
            self.disconnect("unplugged");
        }
        if self.hot_plug && !self.connected && self.bench.configured() && !self.dead {
            if self.function == Function::Cdc {
                self.bench.dtr(true)?;
            }
            self.connect();
        }
        self.host();
        Ok(())
    }

    /// Hands what has reached the device over to it.
    fn deliver(&mut self) -> Result<(), RigError> {
        let bytes = self.cable.for_device(host(self.now));
        self.tap.from_host(self.now, &bytes);
        Ok(self.bench.write(self.function, &bytes)?)
    }

    /// One wake-up of the host's process.
    fn host(&mut self) {
        if self.dead || self.now < self.held_until {
            return;
        }
        let now = self.host_time();
        let emit = &mut self.notices;
        for chunk in self.cable.for_host(host(self.now)).chunks(1024) {
            self.streamer.receive(now, chunk, emit);
        }
        self.streamer.step(now, emit);
        let e_stop = self.streamer.take_e_stop().filter(|_| self.requests_e_stops);
        self.e_stop = e_stop.or(self.e_stop);
        let mut frame = [0; MAX_FRAME];
        loop {
            let len = self.streamer.transmit(now, &mut frame, emit);
            if len == 0 {
                break;
            }
            self.cable.send(host(self.now), &frame[..len]);
        }
    }

    /// The host opens a session.
    pub fn connect(&mut self) {
        self.sessions = self.sessions.wrapping_add(1);
        self.connected = true;
        self.streamer.connect(self.host_time(), self.sessions, RATE, &mut self.notices);
    }

    /// The host's operating system says that the device is gone.
    pub fn disconnect(&mut self, why: &'static str) {
        self.connected = false;
        self.cable.clear();
        self.tap.broken();
        self.streamer.disconnect(self.host_time(), EndCause::Other(why.into()), &mut self.notices);
    }

    /// Plugs the cable in, or out with all bytes that are under way.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn plug(&mut self, plugged: bool) -> Result<(), RigError> {
        if !plugged {
            // Bytes handed over before are on the wire; the rest is lost.
            self.deliver()?;
        }
        self.bench.usb(plugged)?;
        if !plugged {
            self.disconnect("unplugged");
        }
        Ok(())
    }

    /// Ends the host's process and closes its tty; with `false`, another process opens it.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn close(&mut self, closed: bool) -> Result<(), RigError> {
        self.hot_plug = !closed;
        self.bench.dtr(!closed)?;
        if closed {
            self.disconnect("closed");
        }
        Ok(())
    }

    /// Stops the host's process for ever, with its tty open; with `false`, another process takes its place.
    pub fn kill(&mut self, dead: bool) {
        self.dead = dead;
        if dead {
            self.connected = false;
            self.streamer.disconnect(self.host_time(), EndCause::Other("killed".into()), &mut self.notices);
        }
    }

    /// Has another host process take over, through this function.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn take_over(&mut self, function: Function) -> Result<(), RigError> {
        self.disconnect("another host");
        self.function = function;
        if function == Function::Cdc {
            self.bench.dtr(true)?;
        }
        self.connect();
        self.host();
        Ok(())
    }

    /// Sends bytes between the host's frames.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.cable.push(host(self.now), bytes);
    }

    /// Sends a message as if the streamer had sent it.
    pub fn message(&mut self, message: &HostMessage<'_>) {
        let mut frame = [0; MAX_FRAME];
        let len = encode(message, &mut frame).unwrap_or(0);
        self.cable.push(host(self.now), &frame[..len]);
    }

    /// Sends bytes to the USB function that the host does not use.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn stray(&mut self, bytes: &[u8]) -> Result<(), RigError> {
        Ok(self.bench.write(self.function.other(), bytes)?)
    }

    fn end_boot(&mut self) {
        let grid = if let Bench::Mock(_) = self.bench { self.grid() } else { self.link_grid() };
        let boot = Boot {
            tap: std::mem::take(&mut self.tap),
            played: self.bench.take_lines(),
            grid,
            death: self.death.take(),
            quiets: std::mem::take(&mut self.quiets),
            from: self.from,
            to: self.now,
        };
        self.from = self.now;
        self.boots.push(boot);
        if self.connected {
            self.disconnect("reset");
        }
    }

    /// Ends the run and returns all boots of the device, in order.
    #[must_use]
    pub fn finish(mut self) -> (Vec<Boot>, Vec<StreamEvent>) {
        self.end_boot();
        (self.boots, self.notices)
    }
}
