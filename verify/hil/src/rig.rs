//! Runs the host's streamer and the chip in lock-step.
//!
//! Unlike `meissner_stream::Simulation`, it has a cable, a tty and an operating system between them: a device is plugged in
//! and out, a process ends. It has no logic of streamer or controller. The device receives what the host sends at the beginning
//! of the next step.

use crate::bench::chip::{ChipBench, ChipOptions};
use crate::bench::{BenchError, CpuEvent, Function};
use crate::judge::{self, Boot};
use crate::tap::{Event, Tap};
use crate::time::{Grid, MS, host};
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::HostMessage;
use firmware_protocol::tick::Tick;
use firmware_protocol::urgent::e_stop_request;
use meissner_api::EndCause;
use meissner_array::spec::Array;
use meissner_stream::faulty::{Direction, Line};
use meissner_stream::link::LineRate;
use meissner_stream::queues::{Command, Outcome, Request, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_stream::{Settings, Streamer};

/// Interval of the host's wake-ups.
const STEP: u64 = MS / 2;
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
}

impl Default for RigOptions {
    fn default() -> Self {
        let settings = Settings { drift_limit_um: f32::INFINITY, ..Settings::of(Array::paper()) };
        Self { settings, function: Function::default() }
    }
}

/// A host and a device.
#[derive(Debug)]
pub struct Rig {
    /// The device.
    pub chip: ChipBench,
    /// The host.
    pub streamer: Streamer,
    function: Function,
    now: u64,
    /// The line for the host's frames.
    line: Direction,
    /// What has reached the host, which has not read it.
    heard: Vec<u8>,
    /// Whether the host asks for e-stops by control requests, too.
    pub requests_e_stops: bool,
    /// The epoch of an e-stop to ask for.
    e_stop: Option<u16>,
    /// Whether the host opens a device that is plugged in.
    hot_plug: bool,
    connected: bool,
    sessions: u32,
    resets: u64,
    tap: Tap,
    death: Option<u64>,
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
    pub fn new(chip: &ChipOptions, options: RigOptions) -> Result<Self, RigError> {
        Ok(Self {
            chip: ChipBench::start(chip)?,
            streamer: Streamer::new(options.settings),
            function: options.function,
            now: 0,
            line: Direction::default(),
            heard: Vec::new(),
            requests_e_stops: true,
            e_stop: None,
            hot_plug: true,
            connected: false,
            sessions: 0,
            resets: 0,
            tap: Tap::default(),
            death: None,
            from: 0,
            boots: Vec::new(),
            notices: Vec::new(),
            tickets: 0,
        })
    }

    /// The bench's clock.
    pub fn now(&self) -> u64 {
        self.now
    }

    /// The host's clock now.
    pub fn host_time(&self) -> HostInstant {
        host(self.now)
    }

    /// The traffic of the link in this boot.
    pub fn tap(&self) -> &Tap {
        &self.tap
    }

    /// The grid of the device's ticks.
    pub fn grid(&self) -> Grid {
        judge::grid(&self.tap, &self.chip.pins, self.link_grid())
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

    /// Gives the host's process a command and returns its ticket.
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
            self.step((self.now + STEP).min(cycle))?;
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
        let ended = |rig: &Self| {
            rig.notices
                .iter()
                .position(|notice| matches!(notice, StreamEvent::PlayEnded { id: ended, .. } if *ended == id))
        };
        while ended(self).is_none() && self.now < end {
            self.step(self.now + STEP)?;
        }
        match ended(self).map(|at| &self.notices[at]) {
            Some(StreamEvent::PlayEnded { outcome, .. }) => Ok(outcome),
            _ => Err(RigError::Timeout("the end of a play", at_most)),
        }
    }

    fn step(&mut self, to: u64) -> Result<(), RigError> {
        if let Some(epoch) = self.e_stop.take() {
            self.chip.control(e_stop_request(epoch))?;
        }
        self.deliver()?;
        self.chip.run(to)?;
        self.now = self.chip.cycle().max(to);
        let heard = self.chip.take_heard();
        let bytes = if self.function == Function::Cdc { heard.cdc } else { heard.bulk };
        self.tap.from_device(self.now, &bytes);
        self.heard.extend(bytes);
        if self.chip.resets() != self.resets {
            self.resets = self.chip.resets();
            self.end_boot();
        }
        if self.connected && !self.chip.configured() {
            self.disconnect("unplugged");
        }
        if self.hot_plug && !self.connected && self.chip.configured() {
            self.connect()?;
        }
        self.host();
        Ok(())
    }

    /// Hands what has reached the device over to it.
    fn deliver(&mut self) -> Result<(), RigError> {
        let bytes = self.line.arrived(host(self.now));
        self.tap.from_host(self.now, &bytes);
        Ok(self.chip.write(self.function, &bytes)?)
    }

    /// One wake-up of the host's process.
    fn host(&mut self) {
        let now = self.host_time();
        let emit = &mut self.notices;
        for chunk in std::mem::take(&mut self.heard).chunks(1024) {
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
            self.line.send(now, &frame[..len]);
        }
    }

    /// The host opens a session.
    fn connect(&mut self) -> Result<(), RigError> {
        if self.function == Function::Cdc {
            self.chip.dtr(true)?;
        }
        self.sessions = self.sessions.wrapping_add(1);
        self.connected = true;
        self.streamer.connect(self.host_time(), self.sessions, RATE, &mut self.notices);
        Ok(())
    }

    /// The host's operating system says that the device is gone.
    pub fn disconnect(&mut self, why: &'static str) {
        self.connected = false;
        self.line.clear();
        self.heard.clear();
        self.tap.broken();
        self.streamer.disconnect(self.host_time(), EndCause::Other(why.into()), &mut self.notices);
    }

    /// Changes the line for the host's frames.
    pub fn set_line(&mut self, line: Line) {
        self.line.line = line;
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
        self.chip.usb(plugged)?;
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
        self.chip.dtr(!closed)?;
        if closed {
            self.disconnect("closed");
        }
        Ok(())
    }

    /// Has another host process take over, through this function.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn take_over(&mut self, function: Function) -> Result<(), RigError> {
        self.disconnect("another host");
        self.function = function;
        self.connect()?;
        self.host();
        Ok(())
    }

    /// Makes the core fail.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn fail(&mut self, event: CpuEvent) -> Result<(), RigError> {
        self.death = Some(self.now);
        Ok(self.chip.cpu(event)?)
    }

    /// Sends bytes between the host's frames, which the line does not harm.
    pub fn raw(&mut self, bytes: &[u8]) {
        let line = std::mem::take(&mut self.line.line);
        self.line.send(host(self.now), bytes);
        self.line.line = line;
    }

    /// Sends a message as if the streamer had sent it.
    pub fn message(&mut self, message: &HostMessage<'_>) {
        let mut frame = [0; MAX_FRAME];
        let len = encode(message, &mut frame).unwrap_or(0);
        self.raw(&frame[..len]);
    }

    /// Sends bytes to the USB function that the host does not use.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn stray(&mut self, bytes: &[u8]) -> Result<(), RigError> {
        Ok(self.chip.write(self.function.other(), bytes)?)
    }

    fn end_boot(&mut self) {
        let link_grid = self.link_grid();
        let boot = Boot {
            tap: std::mem::take(&mut self.tap),
            pins: std::mem::take(&mut self.chip.pins),
            link_grid,
            death: self.death.take(),
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
    pub fn finish(mut self) -> (Vec<Boot>, Vec<StreamEvent>) {
        self.end_boot();
        (self.boots, self.notices)
    }

    /// Ends the run, and returns what the judge finds on the pins of all boots.
    pub fn judged(self) -> Vec<String> {
        let (boots, notices) = self.finish();
        let findings = boots.iter().enumerate().flat_map(|(number, boot)| {
            boot.judge(&notices).into_iter().map(move |finding| format!("boot {number}: {finding}"))
        });
        findings.collect()
    }
}
