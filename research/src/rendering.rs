//! Speed against accuracy of rendering: how near fingers come to the real object, and how long it takes, by the size of grains, the
//! distance of places and the steps of the descent.

use crate::mean;
use anyhow::{Context, Result};
use meissner_array::spec::Array;
use meissner_render::{Effort, Judge, Method, render_with, response_of};
use meissner_skin::Finger;
use meissner_touch::{Contact, Object, Pose, Press, Scan, Shape, Touch, respond, surface_of};
use serde::Serialize;
use std::time::Instant;

/// Grains of the real object, mm.
const REAL_GRAIN_MM: f64 = 0.1;
/// Grains of the rendered object where something else changes, mm.
const GRAIN_MM: f64 = 0.4;
/// After the touch, spikes are counted for so long, s.
const AFTER_S: f64 = 0.1;
/// The first finger of `judge`.
const FIRST_FINGER: u64 = 5000;

/// Errors and times of renderings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RenderingFigures {
    /// A row per object and way to render it.
    pub rows: Vec<RenderingRow>,
}

/// A way to render an object, and what comes of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RenderingRow {
    /// What is rendered.
    pub object: String,
    /// What changes.
    pub what: String,
    /// Grains of the object, mm.
    pub grain_mm: f64,
    /// The distance of places, mm.
    pub spacing_mm: f64,
    /// Steps of each descent.
    pub steps: usize,
    /// The error of the blurred response of SA1 and RA afferents in windows of 36 ms: the mean over fingers.
    pub errors: [f64; 2],
    /// The time of the contact, ms.
    pub contact_ms: f64,
    /// The time of the heights, ms.
    pub heights_ms: f64,
}

/// Renders a pressed bar, a letter and a moving bar in several ways.
///
/// # Errors
/// If an object cannot be touched or played.
pub fn rendering_figures(fingers: u64) -> Result<RenderingFigures> {
    let bar = Shape::Polyline(vec![[-5.6, 0.8], [5.6, 0.8]]);
    let letter = Shape::Dots(vec![[-2.2, 5.3], [-2.2, -6.3], [3.6, 5.3]]);
    let press = Press { depth_mm: 0.5, rise_s: 0.02, hold_s: 0.08, fall_s: 0.02 };
    let scan = Scan { depth_mm: 0.5, rise_s: 0.05, speed_mm_s: 40.0, direction_deg: 90.0, duration_s: 0.5 };
    let pressed = Touch::press(Pose::default(), press)?;
    let objects = [
        Object::new("pressed bar", surface_of(&bar), pressed.clone()),
        Object::new("pressed letter", surface_of(&letter), pressed),
        Object::new("moving bar", surface_of(&bar), Touch::scan(Pose::default(), scan)?),
    ];
    let rows = objects.iter().map(|object| of_object(object, fingers)).collect::<Result<Vec<_>>>()?;
    Ok(RenderingFigures { rows: rows.concat() })
}

fn of_object(object: &Object, fingers: u64) -> Result<Vec<RenderingRow>> {
    let touch = object.touch();
    let seconds = touch.duration_s() + AFTER_S;
    let contact = |grain_mm| {
        Contact::new(object.grains(grain_mm), touch.most_depth_mm())
            .with_context(|| format!("grains of {grain_mm} mm"))
    };
    let real = contact(REAL_GRAIN_MM)?;
    let felt: Vec<(Finger, Vec<Vec<f64>>)> = (FIRST_FINGER..FIRST_FINGER + fingers)
        .map(|seed| {
            let finger = Finger::new(seed);
            let spikes_s = respond(&real, touch, finger.afferents(), Some(0), &|_| ());
            (finger, spikes_s)
        })
        .collect();
    let usual = Effort::of(touch);
    let row = |what: &str, grain_mm: f64, effort: Effort| -> Result<RenderingRow> {
        let begun = Instant::now();
        let contact = contact(grain_mm)?;
        let contact_ms = begun.elapsed().as_secs_f64() * 1e3;
        let begun = Instant::now();
        let levels = render_with(Array::paper(), &contact, touch, Method::Auto, effort);
        let heights_ms = begun.elapsed().as_secs_f64() * 1e3;
        let pattern = levels.pattern(Array::paper(), "rendered", toml::Table::new())?;
        let errors = felt
            .iter()
            .map(|(finger, real_s)| {
                let found_s = response_of(finger, &pattern, seconds, 2)?;
                Ok(Judge::new(finger, real_s, seconds).compare(&found_s).error_by_class)
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(RenderingRow {
            object: object.name().to_owned(),
            what: what.to_owned(),
            grain_mm,
            spacing_mm: effort.spacing_mm,
            steps: effort.steps,
            errors: [0, 1].map(|class| mean(errors.iter().map(|errors| errors[class]))),
            contact_ms,
            heights_ms,
        })
    };
    let mut rows = Vec::new();
    for grain_mm in [0.8, 0.4, 0.2, 0.1] {
        rows.push(row("grain", grain_mm, usual)?);
    }
    for spacing_mm in [2.9, 1.45, 0.725] {
        rows.push(row("places", GRAIN_MM, Effort { spacing_mm, ..usual })?);
    }
    for steps in [0, 10, 20, 60, 200] {
        rows.push(row("steps", GRAIN_MM, Effort { steps, ..usual })?);
    }
    Ok(rows)
}
