//! What a play does next: a stroke, or one move to a level.

use super::stroke::{Burst, Stroke};
use crate::motor::Ramp;
use firmware_protocol::array::Layout;
use firmware_protocol::batch::{Full, Packer};
use firmware_protocol::limits::Refusal;
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// What a play does next: drives make strokes, waveforms make single moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Step {
    /// Up and down again: two moves that the device takes both or neither.
    Stroke(Stroke),
    /// To a level, from the level of the motor's step before.
    Move {
        /// The move.
        of: Move,
        /// The level before, pulses above rest.
        from: u16,
    },
}

impl From<Stroke> for Step {
    fn from(stroke: Stroke) -> Self {
        Self::Stroke(stroke)
    }
}

impl Step {
    /// The stroke, unless it is a move.
    pub const fn stroke(&self) -> Option<Stroke> {
        match self {
            Self::Stroke(stroke) => Some(*stroke),
            Self::Move { .. } => None,
        }
    }

    /// Its motor.
    pub const fn motor(&self) -> u8 {
        match self {
            Self::Stroke(stroke) => stroke.motor,
            Self::Move { of, .. } => of.motor,
        }
    }

    /// The tick of its first pulse.
    pub const fn begin(&self) -> Tick {
        match self {
            Self::Stroke(stroke) => stroke.up,
            Self::Move { of, .. } => of.tick,
        }
    }

    /// The first tick after its last pulse.
    pub fn end(&self) -> Tick {
        self.begin().max(self.bursts().map(|burst| burst.end()).max().unwrap_or_default())
    }

    /// Pulses of its bursts.
    pub fn pulses(&self) -> u32 {
        self.bursts().map(|burst| u32::from(burst.pulses)).sum()
    }

    /// Its bursts in order of time: two of a stroke, one of a move, none of a move to the level before.
    pub fn bursts(&self) -> impl Iterator<Item = Burst> + use<> {
        let (first, second) = match *self {
            Self::Stroke(stroke) => {
                let [up, down] = stroke.bursts();
                (up, Some(down))
            }
            Self::Move { of: Move { tick, level, surplus, .. }, from } => {
                let direction = if level > from { Direction::Up } else { Direction::Down };
                (Burst { start: tick, direction, pulses: level.abs_diff(from) + surplus }, None)
            }
        };
        std::iter::once(first).chain(second).filter(|burst| burst.pulses > 0)
    }

    /// What an ideal motor with this travel per pulse does. A lower stop absorbs a surplus, so the surplus moves nothing.
    pub fn ramps(&self, um_per_pulse: f64) -> impl Iterator<Item = Ramp> + use<> {
        let surplus = self.surplus();
        self.bursts().map(move |Burst { start, direction, pulses }| {
            let surplus = if direction == Direction::Down { surplus } else { 0 };
            Ramp::new(start, (pulses - surplus).into(), direction, um_per_pulse)
        })
    }

    /// Pulses after the pin is at rest, against a lower stop.
    pub const fn surplus(&self) -> u16 {
        match self {
            Self::Stroke(stroke) => stroke.down_pulses.saturating_sub(stroke.up_pulses),
            Self::Move { of, .. } => of.surplus,
        }
    }

    /// How many moves it is.
    pub const fn moves(&self) -> usize {
        match self {
            Self::Stroke(_) => 2,
            Self::Move { .. } => 1,
        }
    }

    /// Pulses above rest after it.
    pub const fn level(&self) -> u16 {
        match self {
            Self::Stroke(_) => 0,
            Self::Move { of, .. } => of.level,
        }
    }

    /// The most pulses above rest in it.
    pub const fn highest(&self) -> u16 {
        match self {
            Self::Stroke(stroke) => stroke.up_pulses,
            Self::Move { of, .. } => of.level,
        }
    }

    /// Appends it to a packed list.
    ///
    /// # Errors
    /// [`Full`] if it does not fit, or cannot be sent.
    pub fn pack<const N: usize>(&self, into: &mut Packer<N>) -> Result<(), Full> {
        match self {
            Self::Stroke(stroke) => stroke.pack(into),
            Self::Move { of, .. } => into.to_level(of),
        }
    }

    /// Checks it against the controller's limits.
    ///
    /// # Errors
    /// The limit that it breaks; see [`Stroke::check`].
    pub fn check(&self, layout: &Layout) -> Result<(), Refusal> {
        match self {
            Self::Stroke(stroke) => stroke.check(layout),
            Self::Move { of, .. } => layout.check(of),
        }
    }
}
