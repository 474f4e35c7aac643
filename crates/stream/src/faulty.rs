//! A line that may be bad, a device that lies, and a clock that runs wrong: what tests put between a host and a mock.
//!
//! [`Direction`] carries frames one way, as its [`Line`] says; [`Liar`] changes messages of the device; [`DeviceClock`] tells the
//! device's tick at an instant of the host. [`Simulation`](crate::Simulation) uses them in virtual time, the tests over a
//! pseudo-terminal in wall time.
//!
//! Invariant: nothing here reads a clock; the same seed and calls give the same bytes.

use crate::time::HostInstant;
use firmware_protocol::frame::{self, Decoder, MAX_FRAME};
use firmware_protocol::message::DeviceMessage;
use firmware_protocol::tick::Tick;
use meissner_array::units::TickRate;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::fmt;
use std::time::Duration;

/// A simulated line, both ways: the shares of frames it damages, and its delays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Line {
    /// Share of frames lost.
    pub loss: f64,
    /// Share of frames delivered twice.
    pub repeat: f64,
    /// Share of frames with a byte changed.
    pub corrupt: f64,
    /// Share of bytes lost, those between frames too.
    pub byte_loss: f64,
    /// Delay of each frame.
    pub delay: Duration,
    /// Most bytes per second towards the device; 0: no bound.
    pub bytes_per_s: u32,
    /// Largest additional random delay: frames overtake each other.
    pub jitter: Duration,
    /// It delivers nothing, and everything at once when this ends.
    pub holds: bool,
}

/// One way of a line, with the frames that are under way.
#[derive(Debug)]
pub struct Direction {
    /// How bad it is from here on.
    pub line: Line,
    random: ChaCha8Rng,
    /// The line is busy until then with the bytes sent so far.
    busy: HostInstant,
    /// Arrival time and frame, unsorted.
    frames: Vec<(HostInstant, Vec<u8>)>,
    harmed: u64,
}

impl Default for Direction {
    fn default() -> Self {
        Self::new(Line::default(), 0)
    }
}

impl Direction {
    /// A line on which nothing is under way.
    pub fn new(line: Line, seed: u64) -> Self {
        let random = ChaCha8Rng::seed_from_u64(seed);
        Self { line, random, busy: HostInstant::default(), frames: Vec::new(), harmed: 0 }
    }

    fn chance(&mut self, share: f64) -> bool {
        share > 0.0 && f64::from(self.random.next_u32()) < share * 2f64.powi(32)
    }

    /// Sends bytes: the line loses whole frames, each with its delimiter.
    pub fn send(&mut self, now: HostInstant, bytes: &[u8]) {
        for frame in bytes.split_inclusive(|&byte| byte == 0) {
            let rate = u64::from(self.line.bytes_per_s);
            let taken = (frame.len() as u64 * 1_000_000_000).checked_div(rate).unwrap_or(0);
            // A lost frame has used the line's time too.
            self.busy = self.busy.max(now) + Duration::from_nanos(taken);
            let Line { delay, jitter, holds, .. } = self.line;
            let is_late = holds || !delay.is_zero() || !jitter.is_zero();
            if self.chance(self.line.loss) {
                self.harmed += 1;
                continue;
            }
            let whole = frame;
            let mut frame = whole.to_vec();
            if self.chance(self.line.corrupt) {
                let at = self.random.next_u32() as usize % frame.len();
                frame[at] ^= 1 << (self.random.next_u32() % 8);
            }
            if self.line.byte_loss > 0.0 {
                frame.retain(|_| !self.chance(self.line.byte_loss));
            }
            let copies = 1 + usize::from(self.chance(self.line.repeat));
            self.harmed += u64::from(is_late || copies > 1 || frame != whole);
            for _ in 0..copies {
                let share = f64::from(self.random.next_u32()) / 2f64.powi(32);
                let at = self.busy + delay + jitter.mul_f64(share);
                self.frames.push((at, frame.clone()));
            }
        }
    }

    /// Takes the bytes that have arrived by now.
    pub fn arrived(&mut self, now: HostInstant) -> Vec<u8> {
        if self.line.holds {
            return Vec::new();
        }
        let mut here: Vec<_> = self.frames.extract_if(.., |(at, _)| *at <= now).collect();
        here.sort_by_key(|(at, _)| *at);
        here.into_iter().flat_map(|(_, frame)| frame).collect()
    }

    /// Frames that it has lost, repeated, damaged, delayed or held back.
    pub fn harmed(&self) -> u64 {
        self.harmed
    }

    /// Whether nothing is under way.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Loses everything that is under way.
    pub fn clear(&mut self) {
        self.frames.clear();
    }
}

/// Changes messages of the device before they are sent.
pub struct Liar {
    decoder: Decoder,
    lie: Box<dyn FnMut(&mut DeviceMessage) + Send>,
}

impl fmt::Debug for Liar {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Liar")
    }
}

impl Liar {
    /// Each message is changed by `lie`.
    pub fn new(lie: impl FnMut(&mut DeviceMessage) + Send + 'static) -> Self {
        Self { decoder: Decoder::new(), lie: Box::new(lie) }
    }

    /// Sends the bytes of the device with changed messages, each in a frame that is whole.
    pub fn change(&mut self, mut bytes: &[u8], mut send: impl FnMut(&[u8])) {
        while let Some(body) = self.decoder.next(&mut bytes) {
            let Ok(mut message) = frame::read(body) else { continue };
            (self.lie)(&mut message);
            let mut out = [0; MAX_FRAME];
            let len = frame::encode(&message, &mut out).unwrap_or(0);
            send(&out[..len]);
        }
    }
}

/// A device's clock, by the host's. It may run fast or slow, and more so from second to second.
#[derive(Clone, Copy, Debug)]
pub struct DeviceClock {
    /// How fast it should run.
    rate: TickRate,
    /// An instant, and the device's clock then.
    at: HostInstant,
    tick: Tick,
    /// By how much it runs fast at that instant, and how much more so each second.
    fast: f64,
    drift_per_s: f64,
}

impl DeviceClock {
    /// A clock of this rate that starts at [`Tick::BOOT`] and runs right.
    pub const fn started(rate: TickRate, at: HostInstant) -> Self {
        Self { rate, at, tick: Tick::BOOT, fast: 0.0, drift_per_s: 0.0 }
    }

    /// The same crystal, in a device that starts again.
    pub fn restart(&mut self, now: HostInstant) {
        self.set_error(now, self.error_ppm(now));
        self.tick = Tick::BOOT;
    }

    /// The clock at an instant.
    pub fn tick_at(&self, at: HostInstant) -> Tick {
        let passed = at.since(self.at);
        let seconds = passed.as_secs_f64();
        let extra =
            (seconds * (self.fast + self.drift_per_s * seconds / 2.0) * f64::from(self.rate.hz())) as i64;
        Tick((self.tick + self.rate.duration_to_ticks(passed)).0.saturating_add_signed(extra))
    }

    fn error_ppm(&self, at: HostInstant) -> f64 {
        (self.fast + self.drift_per_s * at.since(self.at).as_secs_f64()) * 1e6
    }

    /// From here on it runs fast by so many millionths, or slow.
    pub fn set_error(&mut self, now: HostInstant, ppm: f64) {
        *self = Self { rate: self.rate, at: now, tick: self.tick_at(now), fast: ppm / 1e6, drift_per_s: 0.0 };
    }

    /// From here on its error changes by so many millionths each second, as with the temperature.
    pub fn drift(&mut self, now: HostInstant, ppm_per_s: f64) {
        self.set_error(now, self.error_ppm(now));
        self.drift_per_s = ppm_per_s / 1e6;
    }

    /// It goes on by `time` at once, as while the host is suspended.
    pub fn jump(&mut self, time: Duration) {
        self.tick = self.tick + self.rate.duration_to_ticks(time);
    }
}
