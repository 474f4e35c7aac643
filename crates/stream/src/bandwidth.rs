//! The bandwidth that a play requires, from its compiled strokes.
//!
//! The client computes [`Bandwidth::of`] before it sends a play; the streamer compares it with the measured line and
//! refuses what the line does not carry.
//!
//! It packs strokes as the link packs them, in the batches of the streamer; the constants here bound the overhead of
//! frames, amendments and keep-alives. A line of [`Requirement::rate`] bytes per second is never behind by more than half
//! the lead; the other half is for stalls. A link that waits for acknowledgements sends full frames: it needs
//! [`Requirement::frames`] of them per second. If bytes and acknowledgements share the line's time, neither is behind by
//! more than that.
//!
//! The first [`COUNTED_S`] seconds of a play count. The strokes are compiled again while playing: [`Strokes`] computes
//! them one by one in constant memory, and how frames are really packed depends on the onset and the credits. To keep
//! them would cost megabytes per play.

use crate::settings::{Settings, batch_ticks};
use crate::source::Source;
use firmware_protocol::batch::{BATCH_BYTES, MAX_BATCH, Packer};
use firmware_protocol::tick::Tick;
use meissner_array::motor::{MotorError, SquareWave};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::{Array, MotorSpec};
use meissner_array::strokes::{LiveStrokes, Step, Strokes};
use meissner_array::units::TickRate;
use std::time::Duration;

/// Length of a play that counts, s: after a minute few plays do anything new.
const COUNTED_S: u64 = 60;
/// Most overhead of a frame of moves that marks and withdraws nothing.
pub(crate) const FRAME_BYTES: usize = 24;
/// Most bytes that the mark of an item adds to its frame.
const MARK_BYTES: usize = 11;
/// Most bytes that a withdrawal adds to its frame.
const WITHDRAW_BYTES: usize = 8;
/// Least amplitude of the drives of a live play that count, µm: two bytes for the pulses of a stroke.
const LEAST_UM: f64 = 40.0;
/// Most bytes of an amendment message without items (header, first up tick), and of an item: up tick within 12 s, count.
const AMEND_FRAME_BYTES: usize = 21;
const AMEND_BYTES: usize = 6;
/// The streamer wakes up so often in a millisecond while telemetry comes: bursts of one such slot share a message.
const AMEND_SLOTS_PER_MS: u64 = 2;
/// Most bytes of a keep-alive, and how many there are per host watchdog timeout.
const KEEP_BYTES: f64 = 14.0;
const KEEPS: f64 = 5.0;
/// Batches at a play's beginning that count one by one: they cannot be sent ahead of it.
const FIRST_BATCHES: usize = 8;

/// The requirement of a play in one mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Requirement {
    /// Bytes per second at the peak.
    pub rate: u32,
    /// Full frames per second at the peak, each behind one already on its way.
    pub frames: u32,
    /// Bytes up to the end of each of the first batches.
    head: [u32; FIRST_BATCHES],
    /// Length of a batch.
    batch: Duration,
}

/// The bandwidth that a play requires; by default none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bandwidth {
    /// Without corrections.
    pub open: Requirement,
    /// With every burst corrected.
    pub closed: Requirement,
}

impl Bandwidth {
    /// The larger of both requirements: for the parts of a play whose peaks do not come together.
    pub fn max(self, other: Self) -> Self {
        Self { open: self.open.max(other.open), closed: self.closed.max(other.closed) }
    }

    /// The sum of both: for parts of a play that come together.
    pub fn plus(self, other: Self) -> Self {
        Self { open: self.open.plus(other.open), closed: self.closed.plus(other.closed) }
    }

    /// The bandwidth of `strokes` with these settings. Takes milliseconds: do not call it in the streamer's thread.
    pub fn of(strokes: &Strokes, settings: &Settings) -> Self {
        Self::of_source(strokes.clone().into(), settings)
    }

    /// The bandwidth of a live play of all motors at `most_hz` at most, with so many updates per second. An update takes the place
    /// of all strokes that were sent ahead.
    ///
    /// # Errors
    /// If the frequency is out of a motor's range.
    pub fn of_live(most_hz: f64, updates_hz: f64, settings: &Settings) -> Result<Self, MotorError> {
        let array = settings.array;
        let silent = SquareWave::new(array, most_hz, 0.0, 0.0)?;
        let mut waves = PerMotor::all(array, silent);
        let MotorSpec { travel_um, um_per_pulse, .. } = *array.motor();
        for (motor, wave) in waves.iter_mut().enumerate() {
            // Neighbouring strokes differ, also where the travel limits them, so that the packer cannot shorten them.
            let most_um = (travel_um - (motor % 2) as f64 * um_per_pulse).max(um_per_pulse);
            let motor = motor as f64;
            let amplitude_um = (LEAST_UM + motor).min(most_um);
            *wave = SquareWave::new(array, most_hz, amplitude_um, motor / array.motors() as f64)?;
        }
        let mut strokes = LiveStrokes::new(waves);
        let mut whole = Self::of_source(Source::Live(Box::new(strokes.clone())), settings);
        strokes.begin(Tick(0));
        let ahead = Tick(array.rate().ms_in_ticks(settings.lead_ms) as u64 + batch_ticks(settings));
        let (mut frame, mut bytes, mut frames) = (Packer::<BATCH_BYTES>::new(Tick(0)), 0, 0_u32);
        while let Some(Ok(step)) = strokes.next()
            && step.begin() < ahead
        {
            if frames == 0 || step.pack(&mut frame).is_err() {
                bytes += frame.bytes().len() + FRAME_BYTES + WITHDRAW_BYTES;
                frame = Packer::new(step.begin());
                let _ = step.pack(&mut frame);
                frames += 1;
            }
        }
        bytes += frame.bytes().len();
        for required in [&mut whole.open, &mut whole.closed] {
            required.rate += (bytes as f64 * updates_hz).ceil() as u32;
            required.frames += (f64::from(frames) * updates_hz).ceil() as u32;
        }
        Ok(whole)
    }

    /// The same with pins that follow levels besides: all of them glide all the time.
    pub fn with_levels(mut self, array: Array) -> Self {
        // A move each 2 ms takes two bytes in a row, or three with its share of the frame.
        let moves_per_s = array.motors() as u32 * 500;
        for required in [&mut self.open, &mut self.closed] {
            required.rate += 3 * moves_per_s;
            required.frames += moves_per_s.div_ceil(MAX_BATCH as u32);
        }
        self
    }

    fn of_source(mut strokes: Source, settings: &Settings) -> Self {
        let mut counter = Counter::new(settings);
        strokes.begin(Tick(0));
        loop {
            if let Some(onset) = strokes.next_onset().filter(|onset| onset.0 < counter.counted) {
                counter.item(onset);
                strokes.next_item();
            }
            let Some(Ok(step)) = strokes.next() else { break };
            if step.begin().0 >= counter.counted {
                break;
            }
            counter.step(&step);
        }
        counter.bandwidth(settings)
    }
}

/// Counts the bytes of a play, step by step.
struct Counter {
    /// The ticks that count.
    counted: u64,
    batch: u64,
    amend_slot: u64,
    bytes: Sums,
    amendments: Sums,
    frames: Sums,
    full: Packer<BATCH_BYTES>,
    slots: Vec<bool>,
    frame: Packer<BATCH_BYTES>,
    /// The batch of the frame.
    framed: u64,
}

impl Counter {
    fn new(settings: &Settings) -> Self {
        let batch = batch_ticks(settings).max(1);
        let rate = settings.array.rate();
        let [bytes, amendments, frames] = [(); 3].map(|()| Sums::new(batch, rate));
        Self {
            counted: COUNTED_S * rate.per_s(),
            batch,
            amend_slot: rate.of_ms(1) / AMEND_SLOTS_PER_MS,
            bytes,
            amendments,
            frames,
            full: Packer::new(Tick(0)),
            slots: Vec::new(),
            frame: Packer::new(Tick(0)),
            framed: u64::MAX,
        }
    }

    /// An item begins, with a frame of its own.
    fn item(&mut self, onset: Tick) {
        self.bytes.add(onset.0, FRAME_BYTES + MARK_BYTES);
        (self.frame, self.framed) = (Packer::new(onset), onset.0 / self.batch);
        self.full = Packer::new(onset);
    }

    fn step(&mut self, step: &Step) {
        let (at, before) = (step.begin().0, self.frame.bytes().len());
        if self.framed == at / self.batch && step.pack(&mut self.frame).is_ok() {
            // A row may take fewer bytes than the moves in it.
            self.bytes.add(at, self.frame.bytes().len().saturating_sub(before));
        } else {
            self.framed = at / self.batch;
            self.frame = Packer::new(step.begin());
            let _ = step.pack(&mut self.frame);
            self.bytes.add(at, FRAME_BYTES + self.frame.bytes().len());
        }
        if self.full.count() == 0 || step.pack(&mut self.full).is_err() {
            self.full = Packer::new(step.begin());
            let _ = step.pack(&mut self.full);
            self.frames.add(at, 1);
        }
        for burst in step.bursts() {
            let slot = (burst.start.0 / self.amend_slot) as usize;
            self.slots.resize(self.slots.len().max(slot + 1), false);
            let shared = std::mem::replace(&mut self.slots[slot], true);
            self.amendments.add(burst.start.0, AMEND_BYTES + if shared { 0 } else { AMEND_FRAME_BYTES });
        }
    }

    fn bandwidth(self, settings: &Settings) -> Bandwidth {
        let Self { batch, mut bytes, amendments, frames, .. } = self;
        let frames = frames.least(settings, 1.0);
        let open = bytes.requirement(frames, settings);
        for (at, more) in amendments.sums.into_iter().enumerate() {
            bytes.add(at as u64 * batch, more);
        }
        Bandwidth { open, closed: bytes.requirement(frames, settings) }
    }
}

/// Bytes per batch.
struct Sums {
    batch: u64,
    /// Of the ticks.
    rate: TickRate,
    sums: Vec<usize>,
}

impl Sums {
    fn new(batch: u64, rate: TickRate) -> Self {
        Self { batch, rate, sums: Vec::new() }
    }

    fn add(&mut self, tick: u64, bytes: usize) {
        let at = (tick / self.batch) as usize;
        self.sums.resize(self.sums.len().max(at + 1), 0);
        self.sums[at] += bytes;
    }

    /// Whether a line of `rate` per second, with at least `before` always waiting, is never behind by more than `slack_s`.
    fn fits(&self, rate: f64, before: f64, slack_s: f64) -> bool {
        let drained = rate * self.batch as f64 / self.rate.per_s() as f64;
        let mut waiting = before;
        self.sums.iter().all(|&bytes| {
            waiting += bytes as f64;
            let fits = waiting <= rate * slack_s;
            waiting = (waiting - drained).max(before);
            fits
        })
    }

    /// The least rate that fits; 0 for nothing.
    fn least(&self, settings: &Settings, before: f64) -> u32 {
        if self.sums.is_empty() {
            return 0;
        }
        let slack_s = settings.stall_ms() / 1000.0;
        // Bisection, to one per second.
        let (mut low, mut high) = (0u32, 1u32 << 30);
        while low + 1 < high {
            let middle = low.midpoint(high);
            if self.fits(middle.into(), before, slack_s) { high = middle } else { low = middle }
        }
        high
    }

    fn requirement(&self, frames: u32, settings: &Settings) -> Requirement {
        let batch = Duration::from_secs_f64(self.rate.ticks_to_seconds(self.batch));
        if self.sums.is_empty() {
            return Requirement { batch, ..Requirement::default() };
        }
        let rate = self.least(settings, 0.0);
        let mut sum = 0;
        let head = std::array::from_fn(|at| {
            sum += self.sums.get(at).copied().unwrap_or(0);
            sum as u32
        });
        let keeps = KEEPS * KEEP_BYTES / (settings.lease_ms / 1000.0);
        Requirement { rate: rate + keeps.ceil() as u32, frames, head, batch }
    }
}

impl Requirement {
    /// The higher peak of both, with this one's beginning.
    fn max(self, other: Self) -> Self {
        Self { rate: self.rate.max(other.rate), frames: self.frames.max(other.frames), ..self }
    }

    /// Both peaks together, with this one's beginning.
    const fn plus(self, other: Self) -> Self {
        let (rate, frames) = (self.rate.saturating_add(other.rate), self.frames.saturating_add(other.frames));
        Self { rate, frames, ..self }
    }

    /// How long before its onset a play must be sent over a line of `rate` bytes per second.
    pub fn ahead(&self, rate: u32) -> Duration {
        let sent = |(at, bytes): (u32, &u32)| {
            let sending = Duration::from_secs_f64(f64::from(*bytes) / f64::from(rate.max(1)));
            sending.saturating_sub(self.batch * at)
        };
        (0..).zip(&self.head).map(sent).max().unwrap_or_default()
    }
}
