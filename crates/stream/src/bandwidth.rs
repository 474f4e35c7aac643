//! What a play needs of the line: counted from its strokes as compiled, before it is ordered.
//!
//! Strokes are packed as the link packs them, stretch by stretch as the streamer hands them over; what a frame, an
//! amendment and a keep-alive cost besides is bounded by constants that are written here. A line of
//! [`Requirement::rate`] bytes per second never falls behind by more than half the lead: the other half is for stalls.
//! A link that has to wait for acknowledgements fills its frames: it needs [`Requirement::frames`] of them a second. Who
//! gives the line's time to both, each its share, is behind with neither by more.
//! It computes, knows no line and decides nothing.
//!
//! Bounds: the first [`LOOKED_S`] seconds of a play are counted.

use crate::{Settings, batch_ticks};
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Strokes;
use meissner_array::units::{TICKS_PER_MS, TICKS_PER_S, ticks_to_seconds};
use std::time::Duration;

/// So much of a play is counted, s: what it does after a minute it will mostly have done before.
const LOOKED_S: u64 = 60;
/// A frame of strokes besides its strokes, at the most.
const FRAME_BYTES: usize = 24;
/// An amendment message besides its items, and an item, at the most: head, up tick within 12 s, count.
const AMEND_FRAME_BYTES: usize = 21;
const AMEND_BYTES: usize = 6;
/// While telemetry comes the streamer wakes up so often, ticks: bursts of one such slot share a message.
const AMEND_SLOT: u64 = TICKS_PER_MS / 2;
/// A keep-alive at the most, and how many there are per lease.
const KEEP_BYTES: f64 = 14.0;
const KEEPS: f64 = 5.0;
/// Stretches at a play's beginning that are told one by one: they cannot be sent ahead of it.
const HEAD: usize = 8;

/// What one kind of playing asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Requirement {
    /// Bytes per second at the peak: a line that carries so many is never behind by more than half the lead.
    pub rate: u32,
    /// Full frames per second at the peak, by the same rule, each time behind one that was on its way before.
    pub frames: u32,
    /// Bytes of the first stretches, each with those before it.
    head: [u32; HEAD],
    /// How long a stretch is.
    stretch: Duration,
}

/// What a play needs of the line; by default nothing, whatever it plays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bandwidth {
    /// Without corrections.
    pub open: Requirement,
    /// With every burst corrected.
    pub closed: Requirement,
}

impl Bandwidth {
    /// What `strokes` bandwidth when they are played with these settings. Takes milliseconds: not for the streamer's thread.
    #[must_use]
    pub fn of(strokes: &Strokes, settings: &Settings) -> Self {
        let stretch = batch_ticks(settings).max(1);
        let mut strokes = strokes.clone();
        strokes.begin(Tick(0));
        let [mut bytes, mut amendments, mut frames] = [(); 3].map(|()| Sums::new(stretch));
        let mut full = Packer::<BATCH_BYTES>::new(Tick(0));
        let mut slots = Vec::new();
        let mut frame = Packer::<BATCH_BYTES>::new(Tick(0));
        let mut framed = u64::MAX;
        let strokes = strokes.map_while(Result::ok);
        for stroke in strokes.take_while(|stroke| stroke.up.0 < LOOKED_S * TICKS_PER_S) {
            let (at, before) = (stroke.up.0, frame.bytes().len());
            if framed == at / stretch && frame.stroke(&stroke).is_ok() {
                bytes.add(at, frame.bytes().len() - before);
            } else {
                framed = at / stretch;
                frame = Packer::new(stroke.up);
                let _ = frame.stroke(&stroke);
                bytes.add(at, FRAME_BYTES + frame.bytes().len());
            }
            if full.items() == 0 || full.stroke(&stroke).is_err() {
                full = Packer::new(stroke.up);
                let _ = full.stroke(&stroke);
                frames.add(at, 1);
            }
            for burst in stroke.bursts() {
                let slot = (burst.start.0 / AMEND_SLOT) as usize;
                slots.resize(slots.len().max(slot + 1), false);
                let shared = std::mem::replace(&mut slots[slot], true);
                amendments.add(burst.start.0, AMEND_BYTES + if shared { 0 } else { AMEND_FRAME_BYTES });
            }
        }
        let frames = frames.least(settings, 1.0);
        let open = bytes.demand(frames, settings);
        for (at, more) in amendments.sums.into_iter().enumerate() {
            bytes.add(at as u64 * stretch, more);
        }
        Self { open, closed: bytes.demand(frames, settings) }
    }
}

/// Bytes by stretches.
struct Sums {
    stretch: u64,
    sums: Vec<usize>,
}

impl Sums {
    fn new(stretch: u64) -> Self {
        Self { stretch, sums: Vec::new() }
    }

    fn add(&mut self, tick: u64, bytes: usize) {
        let at = (tick / self.stretch) as usize;
        self.sums.resize(self.sums.len().max(at + 1), 0);
        self.sums[at] += bytes;
    }

    /// Whether a line of `rate` bytes per second, with never less than `before` to do, is never behind by more than
    /// `slack_s`.
    fn fits(&self, rate: f64, before: f64, slack_s: f64) -> bool {
        let drained = rate * self.stretch as f64 / TICKS_PER_S as f64;
        let mut waiting = before;
        self.sums.iter().all(|&bytes| {
            waiting += bytes as f64;
            let fits = waiting <= rate * slack_s;
            waiting = (waiting - drained).max(before);
            fits
        })
    }

    /// The least rate that fits; 0 if there is nothing to do.
    fn least(&self, settings: &Settings, before: f64) -> u32 {
        if self.sums.is_empty() {
            return 0;
        }
        let slack_s = settings.lead_ms / 2000.0;
        // By halves: to one per second.
        let (mut low, mut high) = (0u32, 1u32 << 30);
        while low + 1 < high {
            let middle = low.midpoint(high);
            if self.fits(middle.into(), before, slack_s) { high = middle } else { low = middle }
        }
        high
    }

    fn demand(&self, frames: u32, settings: &Settings) -> Requirement {
        let stretch = Duration::from_secs_f64(ticks_to_seconds(self.stretch));
        if self.sums.is_empty() {
            return Requirement { stretch, ..Requirement::default() };
        }
        let rate = self.least(settings, 0.0);
        let mut sum = 0;
        let head = std::array::from_fn(|at| {
            sum += self.sums.get(at).copied().unwrap_or(0);
            sum as u32
        });
        let keeps = KEEPS * KEEP_BYTES / (settings.lease_ms / 1000.0);
        Requirement { rate: rate + keeps.ceil() as u32, frames, head, stretch }
    }
}

impl Requirement {
    /// How long before its onset a play has to be sent from, over a line of `rate` bytes per second.
    #[must_use]
    pub fn ahead(&self, rate: u32) -> Duration {
        let sent = |(at, bytes): (u32, &u32)| {
            let sending = Duration::from_secs_f64(f64::from(*bytes) / f64::from(rate.max(1)));
            sending.saturating_sub(self.stretch * at)
        };
        (0..).zip(&self.head).map(sent).max().unwrap_or_default()
    }
}
