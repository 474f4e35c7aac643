//! A compiled pattern: a lane for each motor's drives and one for its motions, merged in order of time.
//!
//! Invariant: [`Run::begin`] goes back to the beginning without an allocation, so one run serves every item of its pattern.

use super::drive::NEVER;
use super::error::StrokesError;
use super::lane::Lane;
use super::motion_lane::{MotionLane, choose};
use super::options::StrokeOptions;
use crate::motion::Grid;
use crate::pattern::Pattern;
use crate::strokes::Step;
use firmware_protocol::tick::Tick;

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Run {
    lanes: Vec<AnyLane>,
    /// The motors of the lanes, a bit each.
    motors: u64,
    /// When the next step of each lane begins, in pattern time; [`NEVER`] if there is none.
    begins: Vec<u64>,
    /// What [`Self::work`] returns.
    work: u64,
}

/// A motor's drives, or its motions.
#[derive(Clone, Debug)]
enum AnyLane {
    Drives(Lane),
    Motions(MotionLane),
}

impl AnyLane {
    fn motor(&self) -> u8 {
        match self {
            Self::Drives(lane) => lane.motor(),
            Self::Motions(lane) => lane.motor(),
        }
    }

    fn begin(&mut self, end: u64) -> u64 {
        match self {
            Self::Drives(lane) => lane.begin(end),
            Self::Motions(lane) => lane.begin(end),
        }
    }

    fn advance(&mut self) -> u64 {
        match self {
            Self::Drives(lane) => lane.advance(),
            Self::Motions(lane) => lane.advance(),
        }
    }

    const fn work(&self) -> u64 {
        match self {
            Self::Drives(_) => 0,
            Self::Motions(lane) => lane.work(),
        }
    }
}

impl Run {
    /// Compiles a pattern; there is no step before [`Self::begin`].
    pub(super) fn of(pattern: &Pattern, options: &StrokeOptions) -> Result<Self, StrokesError> {
        Self::on(pattern, options, None)
    }

    /// As [`Self::of`], on a grid that was chosen for this pattern and these options before.
    pub(super) fn on(
        pattern: &Pattern,
        options: &StrokeOptions,
        grid: Option<Grid>,
    ) -> Result<Self, StrokesError> {
        let array = pattern.array();
        options.check(array)?;
        let drives =
            array.numbers().map(|motor| Lane::of(motor, pattern, options)).filter_map(Result::transpose);
        let mut lanes = drives.map(|lane| lane.map(AnyLane::Drives)).collect::<Result<Vec<_>, _>>()?;
        if !pattern.waveforms().is_empty() {
            let waveforms = pattern.waveforms().iter().map(|(motor, waveform)| (*motor, waveform));
            let chosen = || choose(array, waveforms, options.error_um, options.tried_s);
            let grid = grid.map_or_else(chosen, Ok)?;
            lanes.extend(MotionLane::of_pattern(pattern, grid, options).map(AnyLane::Motions));
            lanes.sort_by_key(AnyLane::motor);
        }
        let motors = lanes.iter().fold(0, |motors, lane| motors | 1 << lane.motor());
        Ok(Self { begins: vec![NEVER; lanes.len()], lanes, motors, work: 0 })
    }

    /// Begins, or begins again, a play that ends at `end`, in pattern time.
    pub(super) fn begin(&mut self, end: u64) {
        for (lane, begins) in self.lanes.iter_mut().zip(&mut self.begins) {
            *begins = lane.begin(end);
        }
        self.work = self.lanes.iter().map(AnyLane::work).sum();
    }

    /// The steps of the grid and the knots of waveforms that the last [`Self::begin`] or [`Self::take`] looked at.
    pub(super) const fn work(&self) -> u64 {
        self.work
    }

    /// When the last stroke of a play with `Fit::Cover` and this `end` has ended. Motions have ended by the end.
    pub(super) fn covers_until(&self, end: u64) -> Option<u64> {
        let covered = self.lanes.iter().filter_map(|lane| match lane {
            AnyLane::Drives(lane) => lane.covers_until(end),
            AnyLane::Motions(_) => None,
        });
        covered.max()
    }

    /// The grid of its motions; `None` without motions.
    pub(super) fn grid(&self) -> Option<Grid> {
        self.motions().next().map(MotionLane::grid)
    }

    /// Its lanes of motions.
    pub(super) fn motions(&self) -> impl Iterator<Item = &MotionLane> {
        self.lanes.iter().filter_map(|lane| match lane {
            AnyLane::Drives(_) => None,
            AnyLane::Motions(lane) => Some(lane),
        })
    }

    pub(super) fn is_over(&self) -> bool {
        self.begins.iter().all(|&begins| begins == NEVER)
    }

    pub(super) const fn drives(&self, motor: u8) -> bool {
        motor < 64 && (self.motors >> motor) & 1 == 1
    }

    /// When the next step of `motor` begins, in pattern time.
    pub(super) fn next_up(&self, motor: u8) -> Option<u64> {
        let own = self.lanes.iter().zip(&self.begins).filter(|(lane, _)| lane.motor() == motor);
        own.map(|(_, &begins)| begins).min().filter(|&begins| begins != NEVER)
    }

    /// Its next step: when it begins, in pattern time, its motor, and its lane for [`Self::take`].
    #[inline]
    pub(super) fn first(&self) -> Option<(u64, u8, usize)> {
        // Lanes are in order of motor, so among equal ticks the first has the lowest motor number.
        let (mut first, mut earliest) = (0, NEVER);
        for (index, &begins) in self.begins.iter().enumerate() {
            if begins < earliest {
                (first, earliest) = (index, begins);
            }
        }
        (earliest != NEVER).then(|| (earliest, self.lanes[first].motor(), first))
    }

    /// Takes the next step of a lane, of a play that began at `onset`; and of a stroke the surplus of its down burst.
    #[inline]
    pub(super) fn take(&mut self, lane: usize, onset: Tick) -> (Step, u16) {
        let next = match &self.lanes[lane] {
            AnyLane::Drives(lane) => {
                let stroke = lane.stroke(onset);
                (stroke.into(), lane.surplus(stroke.up_pulses))
            }
            AnyLane::Motions(lane) => (lane.step(onset), 0),
        };
        self.begins[lane] = self.lanes[lane].advance();
        self.work = self.lanes[lane].work();
        next
    }
}
