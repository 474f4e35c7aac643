//! Thresholds, plateaus, areas and rates of both models.
//!
//! A figure is the median over the recorded afferents of a class; the first model has one afferent.
//!
//! Invariant: amplitudes come from fixed grids, so a threshold is accurate to one step of its grid, 21 %.

use super::probe::{COUNTED_S, Placed, can_give, press, sine, spikes_s};
use crate::ModelName;
use crate::afferents::Class;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::f64::consts::{PI, TAU};

/// Locking 1:1 allows this many impulses per cycle more or less.
pub(super) const LOCKED: f64 = 0.1;
/// Frequencies of thresholds, Hz.
const THRESHOLD_HZ: [f64; 15] =
    [5.0, 8.0, 10.0, 16.0, 20.0, 25.0, 34.0, 40.0, 50.0, 64.0, 80.0, 100.0, 150.0, 171.0, 200.0];
/// Further frequencies, for PC afferents. The first model cannot have them, because a motor cannot make them.
const HIGH_HZ: [f64; 6] = [234.0, 300.0, 400.0, 500.0, 700.0, 1000.0];
/// The smallest amplitude of thresholds, µm, steps in a decade, and their number.
const THRESHOLDS_UM: (f64, i32, i32) = (0.01, 12, 61);
/// Frequencies of plateaus, Hz: recorded RA afferents lock from 10 to 80 Hz.
pub(super) const LOCKING_HZ: [f64; 4] = [10.0, 20.0, 40.0, 80.0];
/// The frequency and the amplitude at which the display's patterns vibrate.
const DISPLAY_HZ: f64 = 60.0;
const DISPLAY_UM: f64 = 80.0;
/// The smallest amplitude of plateaus, µm, steps in a decade, and their number: to 950 µm.
const PLATEAU_UM: (f64, i32, i32) = (3.0, 24, 61);
/// The largest amplitude at which a rate is compared with the logarithm, µm, and the frequency, Hz.
const LOGARITHM_UM: f64 = 200.0;
const LOGARITHM_HZ: f64 = 40.0;
/// Depths to which a pin is pressed in for the area of a field, µm.
const PRESSED_UM: [f64; 2] = [50.0, 500.0];
/// Distance between afferents along a field's radius, and the farthest, mm.
const FIELD_MM: (f64, f64) = (0.05, 8.0);
/// An independent program's spikes; the tests use the same file.
const REFERENCE: &str = include_str!("../../tests/data/afferents.json");

/// The measurements of a model.
#[derive(Clone, Debug, Default)]
pub(super) struct Measured {
    /// Class, frequency (Hz), and the median of the least amplitudes at which an afferent fires (µm).
    thresholds: Vec<(Class, f64, Option<f64>)>,
    /// Frequency, and per amplitude (µm) the median of the RA afferents' impulses per cycle, and their mean.
    cycles: Vec<(f64, Vec<[f64; 3]>)>,
    /// Class, depth (µm), and the median area of the fields (mm²).
    areas: Vec<(Class, f64, f64)>,
    /// The share of the reference spikes that come at their sample.
    pub(super) reference_share: Option<f64>,
}

/// Measures both models.
pub(super) fn measure() -> [Measured; 2] {
    [ModelName::Membrane, ModelName::Afferents].map(of_model)
}

fn of_model(model: ModelName) -> Measured {
    let second = model == ModelName::Afferents;
    let rapid = under_the_pin(model, Class::Ra);
    let pacinian = if second { under_the_pin(model, Class::Pc) } else { Vec::new() };
    let all = [rapid.clone(), pacinian.clone()].concat();
    let high: &[f64] = if second { &HIGH_HZ } else { &[] };
    let frequencies: Vec<f64> = THRESHOLD_HZ.iter().chain(high).copied().collect();
    let thresholds = frequencies.par_iter().flat_map_iter(|&hz| {
        let of = if HIGH_HZ.contains(&hz) { &pacinian } else { &all };
        let found = thresholds_um(model, hz, of);
        [Class::Ra, Class::Pc].map(|class| {
            let of_class = of.iter().zip(&found).filter(|(of, _)| of.class == class).map(|(_, um)| *um);
            (class, hz, median_or_never(of_class.collect()))
        })
    });
    let thresholds = thresholds.collect();
    let cycles = LOCKING_HZ.par_iter().map(|&hz| (hz, None)).chain([(DISPLAY_HZ, Some(DISPLAY_UM))]).map(
        |(hz, display)| {
            let at = |um: f64| {
                let found = sine(model, hz, um, &rapid);
                let mut per_cycle: Vec<f64> =
                    found.iter().map(|&count| count as f64 / (hz * COUNTED_S)).collect();
                let mean = per_cycle.iter().sum::<f64>() / per_cycle.len() as f64;
                [um, median(&mut per_cycle), mean]
            };
            let amplitudes = grid(PLATEAU_UM).take_while(|&um| can_give(model, hz, um)).chain(display);
            let found = amplitudes.map(at).collect();
            (hz, found)
        },
    );
    let cycles = cycles.collect();
    let mut areas = Vec::new();
    for um in PRESSED_UM {
        for class in if second { &[Class::Ra, Class::Sa1][..] } else { &[Class::Ra] } {
            areas.push((*class, um, area_mm2(model, *class, um)));
        }
    }
    let reference_share = second.then(reference_share);
    Measured { thresholds, cycles, areas, reference_share }
}

impl Measured {
    /// The median threshold of a class at a frequency, µm peak to peak.
    pub(super) fn threshold_um(&self, class: Class, hz: f64) -> Option<f64> {
        self.thresholds.iter().find(|of| of.0 == class && of.1 == hz)?.2
    }

    /// The frequency of a class's lowest threshold, Hz; the middle one of several (the geometric mean of their ends).
    pub(super) fn best_hz(&self, class: Class) -> Option<f64> {
        let of_class = || self.thresholds.iter().filter(move |of| of.0 == class);
        let lowest = of_class().filter_map(|of| of.2).reduce(f64::min)?;
        let mut best = of_class().filter(|of| of.2 == Some(lowest)).map(|of| of.1);
        let first = best.next()?;
        let last = best.next_back().unwrap_or(first);
        let middle = (first * last).sqrt();
        let near = |hz: f64| (hz / middle).ln().abs();
        of_class().map(|of| of.1).min_by(|a, b| near(*a).total_cmp(&near(*b)))
    }

    /// Median impulses per cycle of the RA afferents under the pin.
    pub(super) fn impulses_per_cycle(&self, hz: f64, um: f64) -> Option<f64> {
        self.of_frequency(hz)?.iter().find(|of| of[0] == um).map(|of| of[1])
    }

    /// The widest range of amplitudes at which the median RA afferent fires once per cycle, µm.
    pub(super) fn plateau(&self, hz: f64) -> Option<(f64, f64)> {
        let rows = self.of_frequency(hz)?;
        let ranges = rows.chunk_by(|a, b| locked(a) == locked(b)).filter(|run| locked(&run[0]));
        let ends = ranges.map(|run| (run[0][0], run[run.len() - 1][0]));
        ends.max_by(|a, b| (a.1 / a.0).total_cmp(&(b.1 / b.0)))
    }

    /// The share of the variance of the mean RA rate that the logarithm of the amplitude explains, from the first amplitude with a
    /// spike on.
    pub(super) fn logarithmic(&self) -> Option<f64> {
        let rows = self.of_frequency(LOGARITHM_HZ)?.iter().filter(|of| of[2] > 0.0 && of[0] <= LOGARITHM_UM);
        explained(&rows.map(|of| [of[0].ln(), of[2]]).collect::<Vec<_>>())
    }

    /// The median area of a class's fields, mm².
    pub(super) fn area_mm2(&self, class: Class, um: f64) -> Option<f64> {
        self.areas.iter().find(|of| of.0 == class && of.1 == um).map(|of| of.2)
    }

    fn of_frequency(&self, hz: f64) -> Option<&[[f64; 3]]> {
        self.cycles.iter().find(|of| of.0 == hz).map(|of| of.1.as_slice())
    }
}

fn locked(of: &[f64; 3]) -> bool {
    (of[1] - 1.0).abs() <= LOCKED
}

/// All rows of a class under the pin; the first model has one.
fn under_the_pin(model: ModelName, class: Class) -> Vec<Placed> {
    along(model, class, &[0.0])
}

fn along(model: ModelName, class: Class, away_mm: &[f64]) -> Vec<Placed> {
    let rows = if model == ModelName::Membrane { 1 } else { class.rows() };
    (0..rows).flat_map(|row| away_mm.iter().map(move |&away_mm| Placed { class, row, away_mm })).collect()
}

fn grid((from, per_decade, count): (f64, i32, i32)) -> impl Iterator<Item = f64> {
    (0..count).map(move |step| from * 10.0_f64.powf(f64::from(step) / f64::from(per_decade)))
}

/// The least amplitude of the grid at which each afferent fires; none if none does.
fn thresholds_um(model: ModelName, hz: f64, afferents: &[Placed]) -> Vec<Option<f64>> {
    let mut found = vec![None; afferents.len()];
    for um in grid(THRESHOLDS_UM).take_while(|&um| can_give(model, hz, um)) {
        if found.iter().all(Option::is_some) {
            break;
        }
        for (found, count) in found.iter_mut().zip(sine(model, hz, um, afferents)) {
            *found = found.or((count > 0).then_some(um));
        }
    }
    found
}

/// The median; none if half of them or more have none.
fn median_or_never(found: Vec<Option<f64>>) -> Option<f64> {
    let mut found: Vec<f64> = found.into_iter().map(|um| um.unwrap_or(f64::INFINITY)).collect();
    Some(median(&mut found)).filter(|um| um.is_finite())
}

/// The median; for an even number of values the mean of the two in the middle; NaN for no values.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => f64::midpoint(values[n / 2 - 1], values[n / 2]),
    }
}

/// The median area over which the afferents of a class fire when a pin is pressed in.
fn area_mm2(model: ModelName, class: Class, um: f64) -> f64 {
    let (step, most) = FIELD_MM;
    let away_mm: Vec<f64> = (0..(most / step) as u32).map(|ring| (f64::from(ring) + 0.5) * step).collect();
    let counts = press(model, um, &along(model, class, &away_mm));
    let area = |of_row: &[usize]| {
        let rings = away_mm.iter().zip(of_row).filter(|(_, count)| **count > 0);
        rings.fold(0.0, |sum, (away_mm, _)| sum + TAU * away_mm * step)
    };
    let mut areas: Vec<f64> = counts.chunks(away_mm.len()).map(area).collect();
    debug_assert!(areas.iter().all(|&area| area <= PI * most * most));
    median(&mut areas)
}

/// The share of the variance of y that a rising straight line in x explains (R²); none with fewer than three points, or if y does
/// not rise.
fn explained(points: &[[f64; 2]]) -> Option<f64> {
    let n = points.len() as f64;
    let mean = |of: usize| points.iter().map(|point| point[of]).sum::<f64>() / n;
    let (x, y) = (mean(0), mean(1));
    let sum = |a: usize, b: usize| {
        let means = [x, y];
        points.iter().map(|point| (point[a] - means[a]) * (point[b] - means[b])).sum::<f64>()
    };
    let (xx, xy, yy) = (sum(0, 0), sum(0, 1), sum(1, 1));
    (points.len() > 2 && xy > 0.0 && yy > 0.0).then(|| xy * xy / (xx * yy))
}

/// The share of the reference spikes that come at their sample, of all spikes of either side.
fn reference_share() -> f64 {
    let all: Value = serde_json::from_str(REFERENCE).expect("the reference is JSON");
    let (mut same, mut either) = (0, 0);
    for case in all["cases"].as_array().into_iter().flatten() {
        let afferents = case["afferents"].as_array().map_or(&[][..], Vec::as_slice);
        let mut scene = case["stimulus"].clone();
        scene["noise"] = json!(false);
        let placed = |of: &Value| json!({"class": of["class"], "row": of["index"], "x_mm": of["x_mm"], "y_mm": of["y_mm"]});
        scene["afferents"] = afferents.iter().map(placed).collect();
        for (train, of) in spikes_s(&scene).iter().zip(afferents) {
            let found: Vec<i64> = train.iter().map(|at_s| (at_s * 5000.0).round() as i64).collect();
            let expected: Vec<i64> = serde_json::from_value(of["spike_samples"].clone()).unwrap_or_default();
            let common = found.iter().filter(|at| expected.contains(at)).count();
            same += common;
            either += found.len() + expected.len() - common;
        }
    }
    same as f64 / either.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plateau_is_the_widest_locked_range_and_the_best_frequency_the_middle_of_equals() {
        let rows = [
            [1.0, 0.0, 0.0],
            [2.0, 1.0, 1.0],
            [4.0, 1.05, 1.0],
            [8.0, 1.5, 1.0],
            [16.0, 0.95, 2.0],
            [20.0, 1.0, 2.0],
            [32.0, 2.0, 3.0],
        ];
        let measured = Measured {
            cycles: vec![(LOGARITHM_HZ, rows.to_vec())],
            thresholds: [
                (8.0, None),
                (10.0, Some(3.0)),
                (16.0, Some(2.0)),
                (20.0, Some(2.0)),
                (25.0, Some(2.0)),
                (40.0, Some(9.0)),
            ]
            .map(|(hz, um)| (Class::Ra, hz, um))
            .to_vec(),
            ..Measured::default()
        };
        assert_eq!((measured.plateau(40.0), measured.plateau(20.0)), (Some((2.0, 4.0)), None));
        assert_eq!((measured.best_hz(Class::Ra), measured.best_hz(Class::Pc)), (Some(20.0), None));
        assert_eq!(
            (measured.threshold_um(Class::Ra, 8.0), measured.threshold_um(Class::Ra, 40.0)),
            (None, Some(9.0))
        );
    }

    #[test]
    fn medians_and_straight_lines() {
        assert_eq!((median(&mut [3.0, 1.0, 2.0]), median(&mut [4.0, 1.0])), (2.0, 2.5));
        assert_eq!(median_or_never(vec![Some(1.0), None, None]), None);
        assert_eq!(median_or_never(vec![Some(1.0), Some(2.0), None]), Some(2.0));
        assert!((explained(&[[0.0, 1.0], [1.0, 3.0], [2.0, 5.0]]).unwrap() - 1.0).abs() < 1e-12);
        assert!(explained(&[[0.0, 0.0], [1.0, 2.0], [2.0, 0.1]]).unwrap() < 0.01);
        for no_rise in [[1.0, 1.0, 1.0], [5.0, 3.0, 1.0]] {
            assert_eq!(explained(&[[0.0, no_rise[0]], [1.0, no_rise[1]], [2.0, no_rise[2]]]), None);
        }
    }
}
