//! How high pins stand that a cut has left above rest, until they are back.
//!
//! A cut counts at first for all that a pin may have reached ([`Standing::bound`]). The device says when it has cut, and how many return
//! pulses all pins had together: if the moves explain that, the heights are exact ([`Standing::cut`]).
//!
//! Invariant: if the device tells the truth, no pin stands higher than its height here.

use super::queued::Cutting;
use firmware_protocol::controller::HORIZON;
use firmware_protocol::tick::Tick;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;

/// See the module.
#[derive(Debug)]
pub(super) struct Standing {
    /// Pulses above rest.
    heights: PerMotor<u16>,
    /// There was a cut since pins were last at rest.
    is_cut: bool,
    /// When the device has cut what it last reported; the heights are those of this tick.
    reported: Option<Tick>,
}

fn sum(heights: &PerMotor<u16>) -> u32 {
    heights.iter().copied().map(u32::from).sum()
}

impl Standing {
    pub(super) fn none(array: Array) -> Self {
        Self { heights: PerMotor::all(array, 0), is_cut: false, reported: None }
    }

    pub(super) const fn heights(&self) -> &PerMotor<u16> {
        &self.heights
    }

    pub(super) fn highest(&self) -> u16 {
        self.heights.iter().copied().max().unwrap_or(0)
    }

    /// This pin stands at least so high.
    pub(super) fn raise(&mut self, motor: u8, pulses: u16) {
        if let Some(height) = self.heights.get_mut(usize::from(motor)) {
            *height = pulses.max(*height);
            self.is_cut = true;
        }
    }

    /// Moves were cut: each pin may stand as high as `highest` says. The device's report of the cut knows better.
    pub(super) fn bound(&mut self, highest: &PerMotor<u16>) {
        if self.reported.is_none() {
            for (height, &highest) in self.heights.iter_mut().zip(highest) {
                *height = highest.max(*height);
            }
        }
        self.is_cut = true;
    }

    /// The device has reported a cut of moves or of a return, at which so many return pulses were outstanding; `moves` gives the height of
    /// a pin by the moves until then. Returns whether they explain it: if not, a return was cut.
    pub(super) fn cut(&mut self, cut: Cutting, outstanding: u32, moves: impl Fn(u8) -> u16) -> bool {
        let mut by_moves = self.heights;
        for (motor, height) in (0..).zip(&mut by_moves) {
            *height = moves(motor);
        }
        // A return that was cut: all pins have come down at the same time, unless limits made them wait.
        let down = self.reported.map_or(0, |before| u16::try_from(cut.at - before).unwrap_or(u16::MAX));
        let by_return = self.heights.map(|height| height.saturating_sub(down));
        let explained = [by_moves, by_return].map(|heights| sum(&heights) == outstanding);
        match explained {
            [true, _] => self.heights = by_moves,
            [_, true] => self.heights = by_return,
            _ => {
                for (height, &moved) in self.heights.iter_mut().zip(&by_moves) {
                    *height = cap(moved.max(*height), outstanding);
                }
            }
        }
        (self.is_cut, self.reported) = (true, Some(cut.at));
        explained[0]
    }

    /// So many return pulses are outstanding, all in all. If the heights do not explain them, any pin may have up to `most`.
    pub(super) fn bound_by(&mut self, outstanding: u32, most: u16) {
        let is_explained = sum(&self.heights) >= outstanding;
        for height in &mut self.heights {
            *height = cap(if is_explained { *height } else { most }, outstanding);
        }
        self.is_cut = true;
    }

    /// All pins count as at rest.
    pub(super) fn clear(&mut self) {
        self.heights.iter_mut().for_each(|height| *height = 0);
        self.reported = None;
    }

    /// All pins are back. If there was a cut, returns how high they stood.
    pub(super) fn end(&mut self) -> Option<PerMotor<u16>> {
        let heights = self.heights;
        self.clear();
        std::mem::replace(&mut self.is_cut, false).then_some(heights)
    }
}

/// Spells that are kept: of more in [`LATELY_MS`](crate::queues::LATELY_MS) the first is forgotten.
const SPELLS: usize = 4;

/// When pins stood that cuts had left above rest.
#[derive(Debug, Default)]
pub(super) struct Stood {
    /// When the last cut was, at the latest.
    pub(super) cut_at: Tick,
    /// When the device cut what left them so; none: it has not said so, or none stands.
    pub(super) since: Option<Tick>,
    spells: heapless::Deque<Spell, SPELLS>,
}

/// How high pins stood from a cut until a return had brought them down, or was cut.
#[derive(Debug)]
struct Spell {
    from: Tick,
    until: Tick,
    heights: PerMotor<u16>,
    /// At its end.
    after: PerMotor<u16>,
    /// So long before its end all pins began to come down; 0: each as late as it could.
    way: u16,
}

impl Stood {
    /// A cut has left pins so high, or those that stood, or were on their way down, until then.
    pub(super) fn cut(&mut self, tick: Tick, before: &PerMotor<u16>, after: &PerMotor<u16>) {
        self.push(tick, 0, before, after);
        if let Some(last) = self.spells.back_mut().filter(|last| last.until > tick) {
            (last.until, last.after, last.way) = (tick, *after, 0);
        }
        self.since = Some(tick);
    }

    /// All pins are down at `tick`. They have begun at `begin` or later; if their way leaves no time for more, all at once.
    pub(super) fn end(&mut self, begin: Option<Tick>, tick: Tick, heights: &PerMotor<u16>) {
        let way = heights.iter().copied().max().unwrap_or(0);
        let is_direct = begin.is_some_and(|begin| begin + u64::from(way) + u64::from(HORIZON) >= tick);
        self.push(tick, if is_direct { way } else { 0 }, heights, &heights.map(|_| 0));
        self.since = None;
    }

    fn push(&mut self, until: Tick, way: u16, heights: &PerMotor<u16>, after: &PerMotor<u16>) {
        let Some(from) = self.since.filter(|from| *from < until) else { return };
        if self.spells.is_full() {
            self.spells.pop_front();
        }
        // Cannot fail: there is room.
        let _ = self.spells.push_back(Spell { from, until, heights: *heights, after: *after, way });
    }

    /// How high a pin stood at a tick, pulses above rest; none: it did not stand.
    pub(super) fn height(&self, motor: usize, tick: Tick) -> Option<u16> {
        let spell = self.spells.iter().find(|spell| spell.from <= tick && tick < spell.until)?;
        let (height, left) = (spell.heights[motor], u16::try_from(spell.until - tick).unwrap_or(u16::MAX));
        let sooner = spell.way.saturating_sub(height);
        Some(height.min(spell.after[motor].saturating_add(left).saturating_sub(sooner)))
    }
}

/// No pin has more return pulses than all together.
fn cap(height: u16, outstanding: u32) -> u16 {
    u16::try_from(outstanding).map_or(height, |outstanding| height.min(outstanding))
}
