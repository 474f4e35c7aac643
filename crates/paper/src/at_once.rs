//! Keeps points within a limit on the motors of a rail that have pulses at once.
//!
//! [`AtOnce::permits`] iterates over the strokes of a point. Its frequencies are whole tenths of a hertz, so that everything
//! repeats after [`PERIOD_S`]. [`AtOnce::thinned`] turns motors off until a point is within the limit.
//!
//! Invariant: a thinned point is permitted.

use crate::point::{Point, Vibration};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::tick::Tick;
use meissner_array::motor::SquareWave;
use meissner_array::power::PulsingMotors;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;

/// Points repeat after this time, s.
const PERIOD_S: f64 = 10.0;

/// A limit on motors at once, for drives of an amplitude and a duration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtOnce {
    /// The array, whose rails have the limit.
    pub array: Array,
    /// Most motors of a rail that have pulses at once.
    pub rail_motors: u8,
    /// Amplitude of the drives, µm.
    pub amplitude_um: f64,
    /// How long they play, s.
    pub duration_s: f64,
}

impl AtOnce {
    /// Whether every rail is within the limit.
    #[must_use]
    pub fn permits(&self, point: &Point) -> bool {
        self.crowded(point).is_none()
    }

    /// The point with motors turned off until it is permitted; on each rail the last ones go first.
    #[must_use]
    pub fn thinned(&self, mut point: Point) -> Point {
        while let Some(rail) = self.crowded(&point) {
            let moving = |motor: &&u8| point.0[usize::from(**motor)].is_some();
            let Some(&last) = self.motors_of(rail).iter().filter(moving).max() else { break };
            point.0[usize::from(last)] = None;
        }
        point
    }

    fn motors_of(&self, rail: usize) -> &[u8] {
        &self.array.spec().rails().members()[rail]
    }

    /// A rail with too many.
    fn crowded(&self, point: &Point) -> Option<usize> {
        (0..self.array.rails().count()).find(|&rail| {
            let vibrations = self.motors_of(rail).iter().map(|&motor| (motor, point.0[usize::from(motor)]));
            let moving: Vec<(u8, Vibration)> =
                vibrations.filter_map(|(motor, vibration)| Some((motor, vibration?))).collect();
            moving.len() > usize::from(self.rail_motors) && self.crowds(&moving)
        })
    }

    fn crowds(&self, moving: &[(u8, Vibration)]) -> bool {
        let until = self.array.rate().seconds_to_ticks(self.duration_s.min(PERIOD_S));
        let mut strokes: Vec<Stroke> = Vec::new();
        for &(motor, vibration) in moving {
            // This always succeeds: a space's frequencies are within a motor's range.
            let (hz, phase) = (vibration.frequency_hz(), vibration.phase());
            let Ok(wave) = SquareWave::new(self.array, hz, self.amplitude_um, phase) else { continue };
            if wave.moves() {
                let excursions = wave.excursions().take_while(|excursion| excursion.up < until);
                strokes.extend(excursions.map(|excursion| excursion.stroke(motor, Tick(0))));
            }
        }
        strokes.sort_unstable_by_key(|stroke| (stroke.up, stroke.motor));
        let limits = PowerLimits {
            rail_at_once: self.rail_motors,
            chip_at_once: u8::MAX,
            ..self.array.layout().no_limits()
        };
        let mut motors = PulsingMotors::new(self.array, limits);
        for stroke in &strokes {
            motors.push(&(*stroke).into());
            if motors.too_many().is_some() {
                return true;
            }
        }
        motors.finish().1.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::make::{Budget, Request, make};
    use crate::shipped::shipped;
    use meissner_array::per_motor::PerMotor;
    use meissner_array::power::rail_pulses;
    use meissner_array::strokes::{StrokeOptions, Strokes};
    use std::ops::ControlFlow;

    fn limit() -> AtOnce {
        AtOnce { array: Array::paper(), rail_motors: 1, amplitude_um: 80.0, duration_s: 1.0 }
    }

    fn point(of: [Option<Vibration>; 3]) -> Point {
        let mut point = Point(PerMotor::all(Array::paper(), None));
        point.0[6..9].copy_from_slice(&of);
        point
    }

    #[test]
    fn bursts_that_do_not_meet_are_permitted_and_others_are_thinned() {
        let at = |decihertz, percent| Some(Vibration { decihertz, percent });
        let apart = point([at(200, 0), at(200, 15), at(200, 30)]);
        assert!(limit().permits(&apart));
        assert_eq!(limit().thinned(apart), apart);
        let together = point([at(200, 0), at(200, 10), at(200, 30)]);
        assert!(!limit().permits(&together));
        assert_eq!(limit().thinned(together), point([at(200, 0), None, None]));
        // Bursts at frequencies that differ by a tenth of a hertz meet within ten seconds, but not within one.
        let beating = point([at(100, 0), at(101, 25), None]);
        let longer = AtOnce { duration_s: 10.0, ..limit() };
        assert!(limit().permits(&beating) && !longer.permits(&beating));
    }

    #[test]
    fn a_pattern_is_made_within_the_limit() {
        let target = shipped("edge-0").unwrap();
        let made = |rail_motors_at_once| {
            let request =
                Request { budget: Budget::Evaluations(vec![40]), rail_motors_at_once, ..Request::default() };
            make(&target, "made", &request, &mut |_| ControlFlow::Continue(())).unwrap()
        };
        let most = |pattern| {
            let strokes = Strokes::new(pattern, &StrokeOptions::default()).unwrap();
            rail_pulses(&strokes).0.iter().map(|rail| rail.most_at_once).max()
        };
        let few = made(Some(2)).pattern;
        assert!(most(&few) <= Some(2) && most(&few) > Some(0), "{few:?}");
        assert_eq!(few.provenance()["rail_motors_at_once"].as_integer(), Some(2));
        let free = made(None).pattern;
        assert!(most(&free) > Some(2), "the limit is none of this target's own");
        assert!(!free.provenance().contains_key("rail_motors_at_once"));
    }
}
