//! Session and controller over a line that loses, repeats and damages frames: each stroke gets one verdict, and nobody is doubted.
//!
//! The oracle is that of `crates/stream/tests/session.rs`. The device is true, so the session doubts nothing that it says.

use crate::input::{array, byte, cause, chunk, long, word};
use arbitrary::Unstructured;
use firmware_protocol::controller::{Controller, Identity, newer};
use firmware_protocol::frame::{Decoder, FrameError, MAX_FRAME};
use firmware_protocol::message::Op;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use meissner_stream::link::{Event, LineRate, Session, Verdict};
use meissner_stream::time::HostInstant;
use std::collections::VecDeque;

/// Ticks from the host's first instant to the end of an input, at most: a minute and more.
const MOST_TICKS: u64 = 6_000_000;

struct Pair {
    array: Array,
    session: Session,
    device: Controller,
    ticks: u64,
    events: Vec<Event>,
}

/// What becomes of the frames of an exchange, two bits for each.
#[derive(Clone, Copy)]
struct Fate(u32);

impl Fate {
    /// Calls `take` with what arrives of a frame.
    fn arrives(self, i: u32, frame: &mut [u8], mut take: impl FnMut(&[u8])) {
        match self.0 >> (2 * (i % 16)) & 3 {
            1 => {}
            2 => {
                take(frame);
                take(frame);
            }
            // One byte, so that the CRC finds it.
            3 => {
                let at = i as usize * 7 % frame.len();
                frame[at] ^= 1 + self.0 as u8 % 0x40;
                take(frame);
            }
            _ => take(frame),
        }
    }
}

impl Pair {
    fn now(&self) -> HostInstant {
        HostInstant::from_ns(self.ticks * 1_000_000_000 / u64::from(self.array.layout().tick_hz()))
    }

    fn wait(&mut self, ticks: u64) {
        self.ticks = (self.ticks + ticks).min(MOST_TICKS);
        let now = Tick::BOOT + self.ticks;
        while self.device.rendered() < now + 32 {
            let left = now + 32 - self.device.rendered();
            let _ = self.device.render(left as u32);
        }
        self.device.poll(now);
    }

    fn exchange(&mut self, out: Fate, back: Fate) {
        let (now, tick) = (self.now(), Tick::BOOT + self.ticks);
        let mut frame = [0; MAX_FRAME];
        let (session, device, events) = (&mut self.session, &mut self.device, &mut self.events);
        if let Some(epoch) = session.take_e_stop()
            && device.epoch().is_some_and(|present| newer(epoch, present))
        {
            device.e_stop(tick, epoch);
        }
        for i in 0..32 {
            let len = session.transmit(now, &mut frame, &mut |event| events.push(event));
            if len == 0 {
                break;
            }
            out.arrives(i, &mut frame[..len], |bytes| device.receive(tick, bytes));
        }
        for i in 0..32 {
            let len = device.transmit(tick, &mut frame);
            if len == 0 {
                break;
            }
            back.arrives(i, &mut frame[..len], |bytes| {
                session.receive(now, bytes, &mut |event| events.push(event));
            });
        }
    }
}

fn arm(array: Array) -> Op {
    let (host_timeout, limits) = (array.layout().max_host_timeout(), array.layout().no_limits());
    Op::Arm { assume_rest: true, host_timeout, limits, lower_stop: None }
}

/// The host, as far as the verdicts on its strokes go.
struct Host {
    waiting: VecDeque<Stroke>,
    forgotten: Vec<Stroke>,
    last: Tick,
}

/// See the module.
pub fn run(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let how = byte(&mut input);
    let rate = [LineRate(100_000), LineRate(11_520), LineRate::USB_FULL_SPEED][usize::from(how & 3).min(2)];
    let array = array(how);
    let session = Session::new(array, 7, rate, HostInstant::from_ns(0));
    let device = Controller::new(Identity::default(), *array.layout());
    let mut pair = Pair { array, session, device, ticks: 0, events: Vec::new() };
    // Some inputs begin after the link probe.
    for _ in 0..40 {
        if pair.session.is_open() && (how & 4 == 0 || pair.session.is_probed()) {
            break;
        }
        pair.exchange(Fate(0), Fate(0));
        pair.wait(170);
    }
    assert!(pair.session.is_open());
    pair.session.command(arm(array));
    let mut host = Host { waiting: VecDeque::new(), forgotten: Vec::new(), last: Tick(0) };
    while !input.is_empty() {
        step(&mut input, &mut pair, &mut host);
        see(&mut pair, &mut host);
    }
    pair.session.seal();
    for _ in 0..60 {
        pair.exchange(Fate(0), Fate(0));
        see(&mut pair, &mut host);
        if host.waiting.is_empty() {
            return;
        }
        pair.wait(900);
    }
    panic!("{} strokes without a verdict", host.waiting.len());
}

fn step(input: &mut Unstructured<'_>, pair: &mut Pair, host: &mut Host) {
    let tick = Tick::BOOT + pair.ticks;
    match byte(input) % 20 {
        0..=3 => {
            let (count, ahead) = (byte(input) % 40, i64::from(word(input) % 5_200) - 200);
            for i in 0..u64::from(count) {
                let up = host.last.max(Tick(tick.0.saturating_add_signed(ahead)) + 5 * i);
                let motor = (i % pair.array.motors() as u64) as u8;
                let stroke = Stroke { motor, up, up_pulses: 9, down: up + 20, down_pulses: 9 };
                if !pair.session.push(&stroke) {
                    break;
                }
                host.last = up;
                host.waiting.push_back(stroke);
            }
        }
        4 => {
            let ahead = i64::from(word(input) % 5_200) - 200;
            let trigger = (byte(input) & 1 == 1).then(|| pair.array.layout().trigger_pulse());
            if pair.session.has_room() {
                host.last = host.last.max(Tick(tick.0.saturating_add_signed(ahead)));
                pair.session.begin(host.last, trigger, u32::MAX);
            }
        }
        5 | 6 => pair.session.seal(),
        7 => {
            pair.session.command(match byte(input) % 8 {
                0 | 1 => Op::Stop,
                2 => Op::Disarm(cause(input)),
                3 => Op::EStop,
                4 => Op::Reset,
                _ => arm(pair.array),
            });
            host.forget();
        }
        8 => {
            let (now, events) = (pair.now(), &mut pair.events);
            let bytes = chunk(input);
            // A whole frame would be the device's word, one of another version too: eight bytes of 0xff have a right CRC.
            let whole = |body: Result<&[u8], FrameError>| matches!(body, Ok(_) | Err(FrameError::Version(_)));
            let (mut decoder, mut rest) = (Decoder::new(), bytes);
            if std::iter::from_fn(|| decoder.next(&mut rest).map(whole)).any(|found| found)
                || decoder.next(&mut &[0][..]).is_some_and(whole)
            {
                return;
            }
            pair.session.receive(now, bytes, &mut |event| events.push(event));
            pair.session.receive(now, &[0], &mut |event| events.push(event));
        }
        9 => pair.session.request_status(),
        10 => {
            let _ = pair.session.ask_board();
        }
        11 => {
            let (now, session) = (pair.now(), &pair.session);
            assert!(session.credits() <= 2_048 && session.traffic().contradictions.total() == 0);
            let _ =
                (session.wake_at(now), session.clock().tick_at(now), session.known_to(), session.capacity());
        }
        12..=15 => {
            let (out, back) = (long(input), long(input));
            pair.exchange(Fate(out & out >> 5), Fate(back & back >> 5));
        }
        _ => pair.wait((word(input) % 4_000).into()),
    }
}

impl Host {
    fn forget(&mut self) {
        self.forgotten.extend(self.waiting.drain(..));
        // No later stroke is the same as one of these.
        self.last = self.last + 1;
    }
}

fn see(pair: &mut Pair, host: &mut Host) {
    for event in std::mem::take(&mut pair.events) {
        match event {
            Event::Stroke(stroke, verdict) => {
                if let Some(at) = host.forgotten.iter().position(|&before| before == stroke) {
                    host.forgotten.swap_remove(at);
                    assert_ne!(verdict, Verdict::Accepted);
                } else {
                    assert_eq!(host.waiting.pop_front(), Some(stroke));
                }
                if let Verdict::Late { rendered, .. } = verdict {
                    assert!(stroke.up < rendered);
                }
            }
            // The device refused the whole first frame; this host gives it up.
            Event::OnsetRefused { .. } => {
                host.forget();
                pair.session.command(Op::Stop);
            }
            Event::Lost(reason) => panic!("a link was lost without silence: {reason:?}"),
            Event::Contradiction(how) => panic!("a true device was doubted: {how:?}"),
            _ => {}
        }
    }
}
