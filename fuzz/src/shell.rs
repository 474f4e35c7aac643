//! A shell around the controller, as thin as the firmware's, that checks every tick it plays.
//!
//! It renders in blocks and holds the lines low while `forced_off`. Only [`Shell::run`] moves time. An event reaches the
//! controller in the tick `now`, whose lines are already out. It plays runs of ticks, not single ones, to be fast.

use firmware_protocol::controller::{BLOCK, Controller, DRIVER_TAIL, HORIZON, Identity, Run, newer};
use firmware_protocol::frame::{self, Decoder, MAX_FRAME};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{DeviceMessage, HostMessage, Op, State, Status};
use firmware_protocol::stroke::Lines;
use firmware_protocol::tick::Tick;
use firmware_protocol::urgent::Watch;
use meissner_array::spec::{Array, Groups};
use std::collections::VecDeque;

const OFF: Run = Run { lines: Lines::OFF, trigger: false, drivers: false, ticks: 0 };

/// A burst that a line is in.
#[derive(Clone, Copy, Debug, Default)]
struct Burst {
    end: u64,
    up: bool,
    pulses: u64,
}

/// See the module.
#[derive(Debug)]
pub struct Shell {
    /// The controller.
    pub device: Controller,
    /// The motors of each rail, and of each chip, as sets of bits: from the description, not from what the controller made of it.
    rails: Vec<u64>,
    chips: Vec<u64>,
    /// The tick being played.
    pub now: u64,
    start: u64,
    ahead: u64,
    block: u64,
    runs: VecDeque<(Run, bool)>,
    taken_back: u64,
    /// The tick by which a shift of rest has begun or was flushed.
    shift_by: u64,
    /// Ticks for which the drivers have been enabled, and those without a pulse.
    enabled: u64,
    enabled_idle: u64,
    /// Pulses on all lines.
    pub total: u64,
    /// Per motor, up pulses minus down pulses.
    pub net: Vec<i64>,
    bursts: Vec<Burst>,
    /// The longest burst that any line may have.
    pub longest: u64,
    decoder: Decoder,
    watch: Watch,
    /// The last status and the reports counted since.
    pub status: Option<Status>,
    /// The present epoch, as the last hello or status named it.
    pub epoch: u16,
    /// The next frame of the stream.
    pub seq: u16,
    /// The last report read in order.
    pub seen: u16,
    /// Whether the host reads reports.
    pub reading: bool,
}

fn sets(groups: &Groups) -> Vec<u64> {
    let set = |motors: &Vec<u8>| motors.iter().fold(0, |set, motor| set | 1 << motor);
    groups.members().iter().map(set).collect()
}

impl Shell {
    /// A controller of `array` that has just started. `tight` renders the tick being played alone.
    #[must_use]
    pub fn new(array: Array, tight: bool, start: Tick) -> Self {
        let (ahead, block) = if tight { (1, 1) } else { (HORIZON.into(), BLOCK.into()) };
        let mut shell = Self {
            device: Controller::starting_at(
                Identity { boot: 7, ..Identity::default() },
                *array.layout(),
                start,
            ),
            rails: sets(array.rails()),
            chips: sets(array.chips()),
            now: start.0,
            start: start.0,
            ahead,
            block,
            runs: VecDeque::with_capacity(256),
            taken_back: 0,
            shift_by: 0,
            enabled: 0,
            enabled_idle: 0,
            total: 0,
            net: vec![0; array.motors()],
            bursts: vec![Burst::default(); array.motors()],
            longest: u64::MAX,
            decoder: Decoder::new(),
            watch: Watch::new(),
            status: None,
            epoch: 0,
            seq: 0,
            seen: 0,
            reading: true,
        };
        shell.fill();
        shell.play(shell.now, 1);
        shell
    }

    fn fill(&mut self) {
        let to = self.now + self.ahead;
        while self.device.rendered().0 < to {
            let begin = self.device.rendered().0;
            let run = self.device.render((to - begin) as u32);
            let counters = self.device.counters();
            // A move that has begun may find its pin where it should be.
            let taken_back = counters.refused + counters.replaced + counters.dropped + counters.played;
            let refuses =
                taken_back > std::mem::replace(&mut self.taken_back, taken_back) || begin < self.shift_by;
            assert!(run.ticks > 0, "rendering makes progress");
            assert!((run.lines.up & run.lines.down).is_empty(), "a line in both sets");
            let all = self.device.layout().all();
            assert!(run.lines.pulsing().without(all).is_empty(), "a line that does not exist");
            self.runs.push_back((run, refuses));
        }
        assert!(self.device.rendered() - Tick(self.now) <= u64::from(HORIZON));
    }

    /// Puts out the lines of `ticks` ticks from `at` on. Nothing else happens in them.
    fn play(&mut self, mut at: u64, mut ticks: u64) {
        while ticks > 0 {
            let (front, refuses) = self.runs.front_mut().expect("a rendered tick");
            let mut some = u64::from(front.ticks).min(ticks);
            let forced = self.device.forced_off(Tick(at));
            if forced != self.device.forced_off(Tick(at + some - 1)) {
                some = 1;
            }
            let (run, refuses) = (if forced { OFF } else { *front }, *refuses);
            front.ticks -= some as u32;
            if front.ticks == 0 {
                self.runs.pop_front();
            }
            self.put_out(run, at, some, refuses);
            (at, ticks) = (at + some, ticks - some);
        }
    }

    fn put_out(&mut self, run: Run, at: u64, ticks: u64, refuses: bool) {
        let lines = run.lines;
        self.check_drivers(lines != Lines::OFF, run.drivers, at, ticks, refuses);
        if lines == Lines::OFF {
            return;
        }
        let state = self.device.state();
        assert!(matches!(state, State::Armed | State::Returning), "a pulse while {state:?} at {at}");
        let PowerLimits { rail_at_once, chip_at_once, .. } = self.device.limits();
        let mut left = lines.pulsing().bits();
        for (groups, limit) in [(&self.rails, rail_at_once), (&self.chips, chip_at_once)] {
            for motors in groups {
                let at_once = (left & motors).count_ones();
                assert!(at_once <= limit.into(), "{at_once} of the motors {motors:#b} at {at}");
            }
        }
        self.total += u64::from(left.count_ones()) * ticks;
        while left != 0 {
            let motor = left.trailing_zeros() as usize;
            left &= left - 1;
            let up = lines.up.contains(motor as u8);
            self.net[motor] += if up { ticks.cast_signed() } else { -ticks.cast_signed() };
            let burst = &mut self.bursts[motor];
            if burst.end != at || burst.up != up {
                (burst.up, burst.pulses) = (up, 0);
            }
            burst.end = at + ticks;
            burst.pulses += ticks;
            assert!(burst.pulses <= self.longest, "{} pulses in a burst of motor {motor}", burst.pulses);
        }
    }

    /// As `firmware-protocol/tests/bench.rs` does: no pulse before the drivers' lead, and no enable for long without a pulse.
    fn check_drivers(&mut self, pulse: bool, enabled: bool, at: u64, ticks: u64, refuses: bool) {
        if !enabled {
            assert!(!pulse, "a pulse with the drivers off at {at}");
            (self.enabled, self.enabled_idle) = (0, 0);
            return;
        }
        let lead = self.device.layout().driver_lead();
        assert!(!pulse || self.enabled >= lead.into(), "a pulse before the drivers are ready at {at}");
        self.enabled += ticks;
        self.enabled_idle = if pulse || refuses { 0 } else { self.enabled_idle + ticks };
        let most = u64::from(lead + DRIVER_TAIL);
        assert!(self.enabled_idle <= most, "drivers enabled without a pulse at {at}");
    }

    /// Lets ticks pass.
    pub fn run(&mut self, ticks: u64) {
        let end = self.now + ticks;
        while self.now < end {
            let boundary = self.now + self.block - (self.now - self.start) % self.block;
            let quiet = boundary.min(end + 1) - self.now - 1;
            self.play(self.now + 1, quiet);
            self.now += quiet;
            if self.now == end {
                break;
            }
            self.now += 1;
            self.device.poll(Tick(self.now));
            self.fill();
            self.drain();
            self.play(self.now, 1);
        }
    }

    /// Reads what the device sends now.
    pub fn drain(&mut self) {
        let mut out = [0; MAX_FRAME];
        loop {
            let len = self.device.transmit(Tick(self.now), &mut out);
            if len == 0 {
                return;
            }
            let body = self.decoder.next(&mut &out[..len]).expect("a whole frame");
            match frame::read(body).expect("a message of this version") {
                DeviceMessage::Hello(hello) => {
                    (self.epoch, self.seq, self.seen) = (hello.epoch, 0, hello.reports);
                }
                DeviceMessage::Status(status) => {
                    (self.epoch, self.seq) = (status.epoch, status.next_seq);
                    self.status = Some(status);
                }
                DeviceMessage::Report { number, .. } if number == self.seen.wrapping_add(1) => {
                    self.seen = number;
                }
                DeviceMessage::NoSession => self.status = None,
                _ => {}
            }
        }
    }

    /// Gives the device bytes, as a firmware does: it looks for an e-stop in them first.
    pub fn bytes(&mut self, mut bytes: &[u8], in_pieces: bool) {
        let now = Tick(self.now);
        let mut rest = bytes;
        loop {
            let present = self.device.epoch();
            let is_new = |epoch| present.is_some_and(|present| newer(epoch, present));
            let Some(epoch) = self.watch.e_stop(&mut rest, is_new) else { break };
            self.e_stop(epoch);
        }
        if in_pieces {
            while !bytes.is_empty() {
                self.device.read(now, &mut bytes);
            }
            while self.device.advance(now) {}
        } else {
            self.device.receive(now, bytes);
        }
        self.after_event();
    }

    /// Orders an e-stop past the bytes that wait.
    pub fn e_stop(&mut self, epoch: u16) {
        self.device.e_stop(Tick(self.now), epoch);
        assert_eq!(self.device.state(), State::Faulted, "an e-stop latches");
        assert!(self.device.forced_off(Tick(self.now)));
        self.after_event();
    }

    /// What follows a call of the controller in the tick being played.
    pub fn after_event(&mut self) {
        if self.device.state() == State::Faulted {
            // A shell forces the drivers off at once.
            (self.enabled, self.enabled_idle) = (0, 0);
        }
        self.drain();
    }

    /// Sends a message.
    pub fn send(&mut self, message: &HostMessage<'_>) {
        let mut out = [0; MAX_FRAME];
        let len = frame::encode(message, &mut out).expect("a message that fits");
        self.bytes(&out[..len], false);
    }

    /// Sends a command in a new epoch.
    pub fn control(&mut self, op: Op) {
        let (epoch, seen) = (self.epoch.wrapping_add(1), self.seen());
        if let Op::Move { .. } = op {
            self.shift_by = self.now + u64::from(self.device.layout().horizon()) + 5;
        }
        self.send(&HostMessage::Control { epoch, seen, op });
    }

    /// The report that the host says it has read last.
    #[must_use]
    pub fn seen(&self) -> u16 {
        if self.reading { self.seen } else { 0 }
    }

    /// Outstanding return pulses of all motors.
    #[must_use]
    pub fn outstanding(&self) -> u64 {
        (0..self.net.len() as u8).map(|motor| u64::from(self.device.outstanding(motor))).sum()
    }

    /// Free slots, if there is a session.
    pub fn credits(&mut self) -> Option<u16> {
        // Noise may have left half a frame.
        self.bytes(&[0], false);
        // An answer may bring reports, 32 at a time. A refused move takes a slot until the device knows that its report is read.
        let mut seen = None;
        while seen.replace(self.seen()) != Some(self.seen()) {
            self.status = None;
            self.send(&HostMessage::Ping { token: 1, seen: self.seen() });
        }
        self.status.map(|status| status.credits)
    }
}
