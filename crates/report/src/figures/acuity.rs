//! Predicts the orientation and two-point thresholds of an array, beside published human ones.
//!
//! A line is turned, or two dots are moved apart. All pins within a pitch of the shape vibrate at 60 Hz in phase, without a search.
//! An ideal observer of the second model's spikes compares each step with the reference. A threshold is the smallest step from
//! which on three of four answers are correct. It is given for observers of several efficiencies, because no efficiency of a person
//! at this display is published.
//!
//! Invariant: the observer cannot distinguish a step from the reference if it moves the same pins.

use crate::figures::error::FiguresError;
use crate::figures::page::Section;
use crate::figures::table::{number, table};
use crate::figures::title;
use crate::progress::Parts;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;
use meissner_design::{Plan, Rule, Target, correct_of_two, discriminate};
use meissner_skin::SkinModel;
use rayon::prelude::*;
use serde::Serialize;

/// Turns of a line through the middle, degrees.
const TURNS_DEG: [f64; 9] = [5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 45.0, 60.0, 90.0];
/// Distances of two dots, mm.
const PARTED_MM: [f64; 9] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0];
/// Half the length of the line, mm.
const HALF_LINE_MM: f64 = 5.0;
/// Efficiencies of the observers; 1 is ideal.
pub const EFFICIENCIES: [f64; 3] = [1.0, 1e-3, 1e-5];
/// The share of correct answers at a threshold.
const CORRECT: f64 = 0.75;
const TRIALS: usize = 8;
const SECONDS: f64 = 0.3;
const FINGER: u64 = 0;
/// A d′ of fewer standard errors than this counts as no difference.
const CERTAIN: f64 = 2.0;

/// Predicted thresholds of an array.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Acuity {
    /// A line that is turned; steps in degrees.
    pub orientation: Vec<AcuityStep>,
    /// Two dots against one; steps in mm.
    pub two_points: Vec<AcuityStep>,
    /// The thresholds.
    pub thresholds: Vec<AcuityThreshold>,
}

/// A step away from the reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AcuityStep {
    /// Degrees or mm.
    pub step: f64,
    /// Pins that vibrate in only one of the two patterns.
    pub pins_changed: usize,
    /// Sensitivity d′ of an ideal observer of all spike counts.
    pub d_prime: f64,
    /// Its standard error.
    pub d_prime_se: f64,
    /// Correct answers in a two-interval task, per cent, for each of [`EFFICIENCIES`].
    pub correct_percent: [f64; 3],
}

/// Thresholds of an observer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AcuityThreshold {
    /// The observer's efficiency.
    pub efficiency: f64,
    /// The smallest turn of a line that it detects, degrees; none if it detects none of those tried.
    pub orientation_deg: Option<f64>,
    /// The smallest distance at which it distinguishes two dots from one, mm; none if it does so at none of those tried.
    pub two_point_mm: Option<f64>,
}

pub(super) fn section(
    array: Array,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(Section, Acuity), FiguresError> {
    let parts = Parts::new(TURNS_DEG.len() + PARTED_MM.len(), progress);
    let orientation = steps(array, &TURNS_DEG, line, &parts)?;
    let two_points = steps(array, &PARTED_MM, dots, &parts)?;
    let threshold = |(index, &efficiency): (usize, &f64)| AcuityThreshold {
        efficiency,
        orientation_deg: threshold(&orientation, index),
        two_point_mm: threshold(&two_points, index),
    };
    let thresholds = EFFICIENCIES.iter().enumerate().map(threshold).collect();
    let acuity = Acuity { orientation, two_points, thresholds };
    let mut section = Section::new("acuity", &title(array, "Predicted thresholds of this display", ""));
    section.say(&format!(
        "Which turn of a line, and which distance of two dots, can be told on pins {} mm apart? All pins within a pitch of the shape vibrate \
         at 60 Hz in phase. An ideal observer of all spike counts (model afferents, {TRIALS} trials of each, {SECONDS} s, one finger) tells \
         each step from the reference in two intervals. A person is less efficient: the tables have the ideal observer, and two whose d′ is \
         √η of its. No efficiency of a person is published for this display. A step that moves the same pins cannot be told by anyone.",
        number(array.pitch_mm())
    ));
    section.table("Thresholds, 75 % correct of two intervals", &thresholds_table(&acuity));
    section.say(
        "People: the orientation of bars and edges, about 20° on average (Bensmaia, Hsiao, Denchev, Killebrew & Craig 2008); a gap, 0.87 mm \
         (Johnson & Phillips 1981); the orientation of gratings, grooves of 0.94 mm (Van Boven & Johnson 1994). These are thresholds of \
         pressed edges, not of vibrating pins.",
    );
    let head = ["step", "pins changed", "d′", "± s.e.", "% correct, η = 1", "η = 0.001", "η = 0.00001"];
    for (name, unit, steps) in
        [("A line turned", "°", &acuity.orientation), ("Two dots against one", "mm", &acuity.two_points)]
    {
        let row = |of: &AcuityStep| {
            let AcuityStep { step, pins_changed, d_prime, d_prime_se, correct_percent } = of;
            let mut row = vec![
                format!("{step} {unit}"),
                pins_changed.to_string(),
                number(*d_prime),
                number(*d_prime_se),
            ];
            row.extend(correct_percent.map(|percent| format!("{percent:.0}")));
            row
        };
        section.table(name, &table(&head, steps.iter().map(row)));
    }
    Ok((section, acuity))
}

fn thresholds_table(acuity: &Acuity) -> String {
    let head = ["efficiency η", "orientation, °", "two dots, mm"];
    let cell = |of: Option<f64>| of.map_or("none of those tried".to_owned(), number);
    let row =
        |of: &AcuityThreshold| vec![number(of.efficiency), cell(of.orientation_deg), cell(of.two_point_mm)];
    table(&head, acuity.thresholds.iter().map(row))
}

/// Compares every step with the reference, a step of 0.
fn steps(
    array: Array,
    steps: &[f64],
    shape: fn(f64) -> String,
    parts: &Parts<'_>,
) -> Result<Vec<AcuityStep>, FiguresError> {
    let reference = pattern(array, &shape(0.0))?;
    let one = |&step: &f64| {
        let other = pattern(array, &shape(step))?;
        let [a, b] = [&reference, &other].map(pins);
        let plan = Plan {
            model: SkinModel::AFFERENTS,
            trials: TRIALS,
            fingers: vec![FINGER],
            seconds: SECONDS,
            resolution_ms: 1000.0 * SECONDS,
            seed: 0,
            efficiency: 1.0,
        };
        let found = discriminate([&reference, &other], &plan, &|_| ())?;
        let counts = &found.last().expect("the model has classes").counts;
        parts.done();
        // A smaller d′ may be chance.
        let told = if counts.d_prime > CERTAIN * counts.d_prime_se { counts.d_prime } else { 0.0 };
        Ok(AcuityStep {
            step,
            pins_changed: (a ^ b).count_ones() as usize,
            d_prime: counts.d_prime,
            d_prime_se: counts.d_prime_se,
            correct_percent: EFFICIENCIES.map(|efficiency| 100.0 * correct_of_two(told, efficiency)),
        })
    };
    steps.par_iter().map(one).collect()
}

/// The first step from which on an observer reaches the share [`CORRECT`].
fn threshold(steps: &[AcuityStep], observer: usize) -> Option<f64> {
    let right = |of: &&AcuityStep| of.correct_percent[observer] >= 100.0 * CORRECT;
    steps.iter().rev().take_while(right).last().map(|of| of.step)
}

fn line(turn_deg: f64) -> String {
    let (y, x) = turn_deg.to_radians().sin_cos();
    let (x, y) = (HALF_LINE_MM * x, HALF_LINE_MM * y);
    format!("shape = \"segment\"\npoints = [[{:.6}, {:.6}], [{x:.6}, {y:.6}]]", -x, -y)
}

fn dots(parted_mm: f64) -> String {
    let half = parted_mm / 2.0;
    let points = if parted_mm == 0.0 {
        "[0.0, 0.0]".to_owned()
    } else {
        format!("[0.0, -{half:.6}], [0.0, {half:.6}]")
    };
    format!("shape = \"dots\"\npoints = [{points}]")
}

/// The pattern of the naive rule for a shape on an array.
fn pattern(array: Array, shape: &str) -> Result<Pattern, FiguresError> {
    let text = format!("name = \"acuity\"\narray = \"{}\"\n{shape}\nreach_mm = 1.5", array.name());
    let target = Target::read(&text, "acuity")?;
    let drives = Rule::Pitch.drives(&target);
    Ok(Pattern::new(array, "acuity", None, drives, toml::Table::new())
        .expect("the name is one, and the rule makes good drives"))
}

/// The pins that a pattern moves, as bits.
fn pins(pattern: &Pattern) -> u64 {
    pattern.drives().iter().fold(0, |pins, Drive { motor, .. }| pins | 1 << motor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_threshold_is_the_first_step_from_which_all_are_told() {
        let step = |step, percent| AcuityStep {
            step,
            pins_changed: 1,
            d_prime: 1.0,
            d_prime_se: 0.1,
            correct_percent: [percent, 50.0, 100.0],
        };
        let steps = [step(5.0, 90.0), step(10.0, 60.0), step(20.0, 75.0), step(30.0, 99.0)];
        assert_eq!([0, 1, 2].map(|observer| threshold(&steps, observer)), [Some(20.0), None, Some(5.0)]);
    }

    #[test]
    fn steps_that_move_the_same_pins_are_not_told_and_large_ones_are() {
        let (section, acuity) = section(Array::paper(), &|_| ()).unwrap();
        for of in acuity.orientation.iter().chain(&acuity.two_points) {
            if of.pins_changed == 0 {
                assert!(of.correct_percent[0] < 90.0, "{of:?}");
            } else {
                assert!(of.d_prime > 10.0 && of.correct_percent[0] > 99.0, "{of:?}");
            }
            assert!(of.correct_percent.is_sorted_by(|a, b| a >= b), "less efficient, less correct: {of:?}");
        }
        let changes = |steps: &[AcuityStep]| steps.iter().filter(|of| of.pins_changed > 0).count();
        assert!(changes(&acuity.orientation) > 3 && changes(&acuity.two_points) > 3, "{acuity:?}");
        let ideal = acuity.thresholds[0];
        assert!(
            ideal.orientation_deg.is_some_and(|deg| deg < 90.0) && ideal.two_point_mm.is_some(),
            "{ideal:?}"
        );
        assert!(section.html.contains("0.87 mm") && section.html.contains("about 20°"));
    }
}
