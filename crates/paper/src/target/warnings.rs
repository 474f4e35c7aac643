//! Warnings: details of a target that the array cannot show.

use crate::target::checked::Target;
use crate::target::error::number;
use crate::target::limits::{FINEST_PITCHES, MAX_FRAMES, SAME_MM};
use meissner_touch::{Shape, distance};

impl Target {
    /// Warns of details finer than the array can show, points far from every pin, and frames too far apart.
    pub fn warnings(&self) -> Vec<String> {
        let (mut warnings, pins) = (Vec::new(), self.array.positions_mm());
        let pitch_mm = self.array.pitch_mm();
        let finest_mm = FINEST_PITCHES * pitch_mm;
        let mut finer = |what: &str, mm: f64, advice: &str| {
            if pins.len() == 1 && mm.is_finite() {
                warnings.push(format!("{what} run together: the array has one pin"));
            } else if mm < finest_mm - SAME_MM {
                warnings.push(format!(
                    "{what} {} mm apart run together: the array separates {what} two pin pitches apart, \
                     {} mm; {advice}",
                    number(mm),
                    number(finest_mm)
                ));
            }
        };
        match &self.shape {
            Shape::Dots(dots) => {
                let pairs = dots
                    .iter()
                    .enumerate()
                    .flat_map(|(at, &a)| dots[at + 1..].iter().map(move |&b| distance(a, b)));
                finer("dots", pairs.fold(f64::INFINITY, f64::min), "move them apart");
            }
            Shape::Grating { period_mm, .. } => finer("lines", *period_mm, "raise period_mm"),
            Shape::Polyline(_) | Shape::Disc { .. } => {}
        }
        let points = self.frames.iter().flat_map(|frame| frame.shape.points());
        let from_pins =
            |&at: &[f64; 2]| pins.iter().map(|&pin| distance(at, pin)).fold(f64::INFINITY, f64::min);
        let farthest = points.map(|at| (from_pins(at), at)).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((mm, [x, y])) = farthest.filter(|(mm, _)| *mm > pitch_mm) {
            let within = |axis: usize| pins.iter().map(|pin| pin[axis].abs()).fold(0.0, f64::max);
            warnings.push(format!(
                "the point ({}, {}) is {} mm from the nearest pin: nothing moves the skin there; the pins stand within \
                 {} mm of the middle across the finger and {} mm along it",
                number(*x),
                number(*y),
                number(mm),
                number(within(0)),
                number(within(1))
            ));
        }
        if let Some(motion) = &self.motion {
            let step_mm = motion.path_mm(&self.shape, self.duration_s) / f64::from(motion.frames);
            if step_mm > pitch_mm + SAME_MM {
                warnings.push(format!(
                    "the shape moves by up to {} mm from frame to frame, more than a pin pitch, {} mm: \
                     it will seem to jump; slow it down{}",
                    number(step_mm),
                    number(pitch_mm),
                    if motion.frames < MAX_FRAMES { ", or raise motion.frames" } else { "" }
                ));
            }
        }
        warnings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EDGE: &str = "shape = \"segment\"\npoints = [[-3, 0], [3, 0]]\n";

    #[test]
    fn details_that_the_array_cannot_show_are_warned_of() {
        let read = |rest: &str| Target::read(&format!("name = \"t\"\n{rest}"), "t.toml").unwrap();
        let line = |rest: &str| read(rest).warnings().concat();
        assert_eq!(
            line("shape = \"dots\"\npoints = [[0, 0], [6, 0], [3, 4]]"),
            "dots 5 mm apart run together: the array separates dots two pin pitches apart, 5.8 mm; move them apart"
        );
        assert!(line("shape = \"grating\"\nperiod_mm = 5.7").starts_with("lines 5.7 mm apart run together"));
        assert_eq!(
            line("shape = \"dots\"\npoints = [[8, 0]]\nreach_mm = 3"),
            "the point (8, 0) is 3.9275 mm from the nearest pin: nothing moves the skin there; the pins stand within \
             4.35 mm of the middle across the finger and 7.25 mm along it"
        );
        let jumps = "motion = { duration_s = 1, speed_mm_s = 5.9, frames = 2 }";
        assert_eq!(
            line(&format!("{EDGE}{jumps}")),
            "the shape moves by up to 2.95 mm from frame to frame, more than a pin pitch, 2.9 mm: it will seem \
             to jump; slow it down, or raise motion.frames"
        );
        for fine in [
            "shape = \"braille\"\ncharacter = \"y\"",
            "shape = \"grating\"\nperiod_mm = 5.8",
            &format!("{EDGE}{}", jumps.replace("5.9", "5.8")),
        ] {
            assert_eq!(line(fine), "");
        }
    }
}
