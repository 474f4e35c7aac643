//! A scripted host: it sends what a test says, while the streamer decides by itself what to send.
//!
//! The line loses nothing. Between frames it pings, so that the device's statuses and reports arrive.

use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::controller::POOL;
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::{Counters, HostMessage, Mark, Op, Report, State, Status, Withdraw};
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::Function;
use meissner_hil::bench::chip::{ChipBench, ChipOptions};
use meissner_hil::tap::{Event, Tap};
use meissner_hil::time::{Grid, MS};

/// Cycles between two looks at what the device says.
const STEP: u64 = MS / 4;
/// Cycles between two pings.
const PING: u64 = 2 * MS;

pub(crate) struct Hand {
    pub(crate) chip: ChipBench,
    pub(crate) tap: Tap,
    now: u64,
    epoch: u16,
    seq: u16,
    window: u16,
    pinged: u64,
    /// Moves sent.
    pub(crate) sent: u64,
}

impl Hand {
    /// An armed device with all pins at rest, which disarms after so many ticks of silence.
    pub(crate) fn armed(options: &ChipOptions, host_timeout: u32) -> Self {
        let chip = ChipBench::start(options).unwrap_or_else(|error| panic!("{error}"));
        let (tap, now, epoch, seq, window, pinged, sent) = (Tap::default(), 0, 0, 0, 0, 0, 0);
        let mut hand = Self { chip, tap, now, epoch, seq, window, pinged, sent };
        let limit = 3_000 * MS;
        while !hand.chip.configured() {
            hand.run(MS);
            assert!(hand.now < limit, "no device");
        }
        hand.chip.dtr(true).unwrap();
        while hand.tap.hello().is_none() {
            hand.send(&HostMessage::Hello { session: 77 });
            hand.run(5 * MS);
            assert!(hand.now < limit, "no answer to a hello");
        }
        hand.epoch = hand.tap.epoch() + 1;
        let limits = hand.tap.hello().unwrap().limits;
        let op = Op::Arm { assume_rest: true, host_timeout, limits, lower_stop: None };
        hand.send(&HostMessage::Control { epoch: hand.epoch, seen: hand.tap.reports_read(), op });
        hand.run(60 * MS);
        assert_eq!(hand.status().state, State::Armed);
        hand
    }

    pub(crate) fn now(&self) -> u64 {
        self.now
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
            if self.tap.hello().is_some() && self.now >= self.pinged + PING {
                self.pinged = self.now;
                self.send(&HostMessage::Ping { token: 1, seen: self.tap.reports_read() });
            }
            let to = (self.now + STEP).min(cycle);
            self.chip.run(to).unwrap();
            self.now = self.chip.cycle().max(to);
            self.tap.from_device(self.now, &self.chip.take_heard().cdc);
        }
    }

    pub(crate) fn send(&mut self, message: &HostMessage<'_>) {
        let mut frame = [0; MAX_FRAME];
        let len = encode(message, &mut frame).unwrap();
        self.tap.from_host(self.now, &frame[..len]);
        self.chip.write(Function::Cdc, &frame[..len]).unwrap();
    }

    /// Sends the next frame of the stream: what is packed, with a mark that begins a play, or with the motors from which it withdraws.
    pub(crate) fn moves(&mut self, packer: &Packer<BATCH_BYTES>, mark: Option<Mark>, withdraw: u32) {
        let (epoch, seq, seen) = (self.epoch, self.seq, self.tap.reports_read());
        let withdraw = (withdraw != 0)
            .then_some(Withdraw { motors: MotorSet::from_bits(withdraw.into()), generation: 0 });
        let (base, batch) = (packer.base().wire(), packer.bytes());
        self.send(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch });
        self.seq = self.seq.wrapping_add(1);
        self.sent += packer.count() as u64;
    }

    /// Appends strokes.
    pub(crate) fn append(&mut self, mut strokes: Vec<Stroke>) {
        strokes.sort_by_key(|stroke| stroke.up);
        let mut rest = &strokes[..];
        while let Some(first) = rest.first() {
            rest = &rest[self.some(0, first.up, rest)..];
        }
    }

    /// Replaces what these motors have queued from `base` on.
    pub(crate) fn replace(&mut self, motors: u32, base: Tick, mut strokes: Vec<Stroke>) {
        strokes.sort_by_key(|stroke| stroke.up);
        let mut rest = &strokes[self.some(motors, base, &strokes)..];
        while !rest.is_empty() {
            rest = &rest[self.some(0, base, rest)..];
        }
    }

    /// Sends one frame with as many of these strokes as fit, and returns their number.
    fn some(&mut self, withdraw: u32, base: Tick, strokes: &[Stroke]) -> usize {
        let mut packer = Packer::new(base);
        let fits = strokes.iter().take_while(|stroke| stroke.pack(&mut packer).is_ok()).count();
        self.moves(&packer, None, withdraw);
        fits
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

    /// The device's tick now, by the link: a status was sent after its tick began.
    pub(crate) fn tick(&self) -> Tick {
        let told = self.tap.events.iter().filter_map(|(cycle, event)| match event {
            Event::Status(_, tick) => Some(Grid::through(*tick, *cycle)),
            _ => None,
        });
        told.min_by_key(|grid| grid.origin).unwrap().tick(self.now).0
    }

    /// Ends the window of the board report, and returns the least time left to render in it, in ticks.
    pub(crate) fn slack(&mut self) -> u64 {
        self.window += 1;
        self.send(&HostMessage::Board { window: self.window });
        self.run(5 * MS);
        let slack = self.tap.events.iter().rev().find_map(|(_, event)| match event {
            Event::Board(board) => Some(board.slack),
            _ => None,
        });
        slack.flatten().unwrap().into()
    }

    /// Lets everything be played, and checks that all of it was in time and is counted, and that each slot has returned to the pool.
    pub(crate) fn finish(mut self, ms: u64) -> Counters {
        self.run(ms * MS);
        let status = self.status();
        let counters = status.counters;
        let late = self.tap.events.iter().filter_map(|(_, event)| match event {
            Event::Report(Report::Verdict { late, kept, .. }) => Some((late.count_ones(), kept.bits())),
            _ => None,
        });
        assert!(late.into_iter().all(|late| late == (0, 0)), "a replacement was late");
        assert_eq!(usize::from(status.credits), POOL, "{status:?}");
        assert_eq!((status.outstanding, counters.reports_lost, counters.bad_frames), (0, 0, 0));
        assert_eq!((counters.late, counters.dropped, counters.refused), (0, 0, 0), "{counters:?}");
        assert_eq!(counters.played + counters.replaced, self.sent, "{counters:?}");
        counters
    }
}
