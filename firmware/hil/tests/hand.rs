//! A scripted host: it sends what a test says, while the streamer decides by itself what to send.
//!
//! It uses the bench and the tap as the rig does, so the judge works on what it has sent. The line loses nothing. Between frames
//! it pings, so that the device's statuses and reports arrive.

use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::controller::POOL;
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{Counters, HostMessage, Mark, MarkKind, Op, State, Status, Withdraw};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::chip::ChipBench;
use meissner_hil::bench::{Bench, Function, Which};
use meissner_hil::judge::{Boot, Judged};
use meissner_hil::oracle;
use meissner_hil::tap::{Event, Tap};
use meissner_hil::time::{Grid, MS};

/// Cycles between two looks at what the device says.
const STEP: u64 = MS / 4;
/// Cycles between two pings.
const PING: u64 = 2 * MS;
/// Cycles after which all strokes sent have been played.
const LATELY: u64 = 300 * MS;

pub(crate) struct Hand {
    pub(crate) bench: Bench,
    pub(crate) tap: Tap,
    now: u64,
    epoch: u16,
    seq: u16,
    window: u16,
    pinged: u64,
    /// Whether it pings.
    pub(crate) speaks: bool,
    grid: Option<Grid>,
    /// Moves sent.
    pub(crate) sent: u64,
    host_timeout: u32,
}

/// What a replacement came to: the motors that the device kept, and all late strokes of its frames.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Verdicts {
    pub(crate) kept: u32,
    pub(crate) late: u32,
}

impl Hand {
    /// An armed device with all pins at rest, which disarms after so many ticks of silence.
    pub(crate) fn armed(which: &Which, host_timeout: u32) -> Self {
        let mut hand = Self {
            bench: Bench::start(which).unwrap_or_else(|error| panic!("{error}")),
            tap: Tap::default(),
            now: 0,
            epoch: 0,
            seq: 0,
            window: 0,
            pinged: 0,
            speaks: false,
            grid: None,
            sent: 0,
            host_timeout,
        };
        hand.greet(77);
        hand.arm(true);
        hand
    }

    /// Opens a session.
    fn greet(&mut self, session: u32) {
        let limit = self.now + 3_000 * MS;
        while !self.bench.configured() {
            self.run(MS);
            assert!(self.now < limit, "no device");
        }
        self.bench.dtr(true).unwrap();
        while self.tap.hello().is_none_or(|hello| hello.session != session) {
            self.send(&HostMessage::Hello { session });
            self.run(5 * MS);
            assert!(self.now < limit, "no answer to a hello");
        }
        (self.epoch, self.seq, self.speaks) = (self.tap.epoch(), 0, true);
    }

    /// The cycle at which the last pulse so far has fallen.
    pub(crate) fn low_since(&mut self) -> u64 {
        let low = match &self.bench {
            Bench::Mock(mock) => mock.log.end().map(|tick| mock.grid().cycle(tick)),
            Bench::Chip(chip) => chip.pins.low_since(u64::MAX),
        };
        low.unwrap_or(0)
    }

    /// Arms the device, and waits until it has returned its pins.
    pub(crate) fn arm(&mut self, assume_rest: bool) {
        self.arm_with(assume_rest, self.tap.hello().unwrap().limits);
    }

    pub(crate) fn arm_with(&mut self, assume_rest: bool, limits: PowerLimits) {
        let host_timeout = self.host_timeout;
        self.control(Op::Arm { assume_rest, host_timeout, limits, lower_stop: None });
        self.run(60 * MS);
        assert_eq!(self.status().state, State::Armed);
    }

    pub(crate) fn now(&self) -> u64 {
        self.now
    }

    /// The chip of a bench that has one.
    pub(crate) fn chip(&mut self) -> &mut ChipBench {
        let Bench::Chip(chip) = &mut self.bench else { panic!("the bench has no chip") };
        chip
    }

    /// The last status.
    pub(crate) fn status(&self) -> Status {
        self.tap.status().unwrap()
    }

    /// Lets so many cycles pass.
    pub(crate) fn run(&mut self, cycles: u64) {
        self.run_to(self.now + cycles);
    }

    pub(crate) fn run_to(&mut self, cycle: u64) {
        while self.now < cycle {
            if self.speaks && self.now >= self.pinged + PING {
                self.ping();
            }
            let heard = self.bench.run((self.now + STEP).min(cycle)).unwrap();
            self.now = self.bench.cycle().max((self.now + STEP).min(cycle));
            self.tap.from_device(self.now, &heard.cdc);
        }
    }

    pub(crate) fn ping(&mut self) {
        self.pinged = self.now;
        self.send(&HostMessage::Ping { token: 1, seen: self.tap.reports_read() });
    }

    pub(crate) fn send(&mut self, message: &HostMessage<'_>) {
        let mut frame = [0; MAX_FRAME];
        let len = encode(message, &mut frame).unwrap();
        self.tap.from_host(self.now, &frame[..len]);
        self.bench.write(Function::Cdc, &frame[..len]).unwrap();
    }

    /// Begins an epoch with this command.
    pub(crate) fn control(&mut self, op: Op) {
        (self.epoch, self.seq) = (self.epoch.wrapping_add(1), 0);
        let (epoch, seen) = (self.epoch, self.tap.reports_read());
        self.send(&HostMessage::Control { epoch, seen, op });
    }

    /// Sends one frame with as many of these strokes as fit, and returns their number.
    fn frame(&mut self, withdraw: Option<u32>, base: Tick, strokes: &[Stroke]) -> usize {
        let mut packer = Packer::<BATCH_BYTES>::new(base);
        let fits = strokes.iter().take_while(|stroke| stroke.pack(&mut packer).is_ok()).count();
        let (epoch, seq, seen) = (self.epoch, self.seq, self.tap.reports_read());
        let withdraw =
            withdraw.map(|motors| Withdraw { motors: MotorSet::from_bits(motors.into()), generation: 0 });
        let (base, batch) = (base.wire(), packer.bytes());
        self.send(&HostMessage::Moves { epoch, seq, seen, mark: None, withdraw, base, batch });
        self.seq = self.seq.wrapping_add(1);
        self.sent += 2 * fits as u64;
        fits
    }

    /// Sends the next frame of the stream: what is packed, with a mark that begins a play if it says for how long pins may be held.
    pub(crate) fn moves(&mut self, packer: &Packer<BATCH_BYTES>, hold: Option<u32>) {
        let (epoch, seq, seen) = (self.epoch, self.seq, self.tap.reports_read());
        let mark = hold.map(|hold| Mark { kind: MarkKind::Play, trigger: None, hold });
        let (base, batch) = (packer.base().wire(), packer.bytes());
        self.send(&HostMessage::Moves { epoch, seq, seen, mark, withdraw: None, base, batch });
        self.seq = self.seq.wrapping_add(1);
        self.sent += packer.count() as u64;
    }

    /// Appends strokes.
    pub(crate) fn append(&mut self, mut strokes: Vec<Stroke>) {
        strokes.sort_by_key(|stroke| stroke.up);
        let mut rest = &strokes[..];
        while let Some(first) = rest.first() {
            rest = &rest[self.frame(None, first.up, rest)..];
        }
    }

    /// Replaces what these motors have queued from `base` on. Each motor is withdrawn from in the frame of its first new stroke; a
    /// motor without new strokes, or any if `at_once`, in the first frame.
    pub(crate) fn replace(&mut self, motors: u32, base: Tick, mut strokes: Vec<Stroke>, at_once: bool) {
        strokes.sort_by_key(|stroke| stroke.up);
        let with_strokes = strokes.iter().fold(0, |mask, stroke| mask | 1 << stroke.motor);
        let mut left = motors;
        let mut due = if at_once { motors } else { motors & !with_strokes };
        let mut rest = &strokes[..];
        while left != 0 || !rest.is_empty() {
            let mut packer = Packer::<BATCH_BYTES>::new(base);
            let fits = rest.iter().take_while(|stroke| stroke.pack(&mut packer).is_ok());
            due |= left & fits.fold(0, |mask, stroke| mask | 1 << stroke.motor);
            let withdraw = (due != 0).then_some(due);
            rest = &rest[self.frame(withdraw, base, rest)..];
            (left, due) = (left & !due, 0);
        }
    }

    /// Waits until the device has taken all frames and the host has read all reports.
    pub(crate) fn settle(&mut self) {
        let until = self.now + 200 * MS;
        loop {
            self.run(MS / 2);
            let status = self.status();
            let is_read = status.reports == self.tap.reports_read();
            if status.epoch == self.epoch && status.next_seq == self.seq && is_read {
                break;
            }
            assert!(self.now < until, "{status:?} at frame {}", self.seq);
        }
        // A frame may be acknowledged before its last strokes are taken.
        self.run(MS);
    }

    /// The grid of the device's ticks, from its pins if they have pulsed.
    pub(crate) fn grid(&mut self) -> Grid {
        if let Some(grid) = self.grid {
            return grid;
        }
        match &self.bench {
            Bench::Mock(mock) => mock.grid(),
            Bench::Chip(chip) => {
                let first = oracle::expect(&self.tap, None).log.first();
                if let Some((tick, cycle)) = first.zip(chip.pins.first()) {
                    self.grid = Some(Grid::through(tick, cycle));
                }
                self.grid.unwrap_or_else(|| self.link_grid())
            }
        }
    }

    /// By the link: a status was sent after its tick began.
    fn link_grid(&self) -> Grid {
        let told = self.tap.events.iter().filter_map(|(cycle, event)| match event {
            Event::Status(_, tick) => Some(Grid::through(*tick, *cycle)),
            _ => None,
        });
        told.min_by_key(|grid| grid.origin).unwrap()
    }

    /// The device's tick now.
    pub(crate) fn tick(&mut self) -> Tick {
        let now = self.now;
        self.grid().tick(now).0
    }

    /// The strokes that the device plays, by what went over the link lately.
    pub(crate) fn planned(&self) -> Vec<Stroke> {
        let since = self.now.saturating_sub(LATELY);
        let from = self.tap.events.partition_point(|&(cycle, _)| cycle < since);
        let mut tap = Tap::default();
        tap.events = self.tap.events[from..].to_vec();
        let moves = oracle::accepted(&tap);
        let pairs = moves.windows(2).filter(|pair| pair[1].1).map(|pair| (pair[0].0, pair[1].0));
        let stroke = |(up, down): (Move, Move)| {
            let (motor, down_pulses) = (up.motor, up.level + down.surplus);
            Stroke { motor, up: up.tick, up_pulses: up.level, down: down.tick, down_pulses }
        };
        pairs.map(stroke).collect()
    }

    /// What the verdicts since event `from` say together.
    pub(crate) fn verdicts(&self, from: usize) -> Verdicts {
        use firmware_protocol::message::Report;
        let mut all = Verdicts::default();
        for (_, event) in &self.tap.events[from..] {
            if let Event::Report(Report::Verdict { late, kept, .. }) = event {
                all.kept |= kept.bits() as u32;
                all.late += late.count_ones();
            }
        }
        all
    }

    /// Ends the window of the board report, and returns the least time left to render in it, in ticks.
    pub(crate) fn slack(&mut self) -> Option<u8> {
        self.window += 1;
        self.send(&HostMessage::Board { window: self.window });
        self.run(5 * MS);
        self.tap.events.iter().rev().find_map(|(_, event)| match event {
            Event::Board(board) => Some(board.slack),
            _ => None,
        })?
    }

    /// Lets everything be played, and checks that each burst sent is counted once, as the judge sees it, and that each slot has
    /// returned to the pool. Then judges. `stopped`: the device was stopped meanwhile, and not all frames were taken.
    pub(crate) fn finish(mut self, stopped: bool) -> (Judged, Counters) {
        let end = self.planned().iter().map(Stroke::end).max().unwrap_or(Tick::BOOT);
        let end = self.grid().cycle(end) + 5 * MS;
        self.run_to(end.max(self.now + 5 * MS));
        let status = self.status();
        let (counters, not_taken) = (status.counters, self.verdicts(0).late);
        assert_eq!(usize::from(status.credits), POOL, "{status:?}");
        assert_eq!((status.outstanding, counters.reports_lost, counters.bad_frames), (0, 0, 0));
        let grid = if let Bench::Mock(mock) = &self.bench { mock.grid() } else { self.link_grid() };
        let boot = Boot {
            tap: self.tap,
            played: self.bench.take_lines(),
            grid,
            death: None,
            quiets: Vec::new(),
            from: 0,
            to: self.now,
        };
        let judged = boot.judge();
        let findings: Vec<_> = judged.findings.iter().map(ToString::to_string).collect();
        assert!(findings.is_empty(), "{}", findings.join("\n"));
        let Counters { played, late, dropped, refused, replaced, .. } = counters;
        if !stopped {
            assert_eq!(played + late + dropped + refused + replaced, self.sent, "{counters:?}");
            assert_eq!((dropped, refused), (0, 0), "{counters:?}");
            assert_eq!(counters.pulses, judged.log.pulses());
            // Strokes that were not taken, because the old ones stay, count as replaced, too.
            assert_eq!(late + replaced, u64::from(not_taken) + judged.expected.replaced.len() as u64);
            assert_eq!(played, judged.expected.moves.len() as u64);
        }
        (judged, counters)
    }
}
