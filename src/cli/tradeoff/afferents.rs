//! `tradeoff` under the second model: its time, and its answers at the model's extremes.
//!
//! The model has one step, so there are no methods to choose from. Every scene runs twice, the second time with the skin pressed in by
//! a picometre more. Spikes that this moves depend on rounding errors.
//!
//! Invariant: only the times depend on the machine.

use super::methods::timed;
use crate::cli::text::{columns, number};
use meissner_array::spec::Array;
use meissner_skin::afferents::{Afferent, Class, PREINDENT_MM, SAMPLE_US, Scene, population, simulate};
use meissner_skin::{AnyScene, Keep, MethodError, ModelName};
use serde::Serialize;
use serde_json::json;

/// Additional indentation of the skin in the second run, mm.
const NUDGE_MM: f64 = 1e-9;
const MANY: usize = 100_000;

/// The document of `tradeoff --json` under the second model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct AfferentsTradeoff {
    duration_s: f64,
    /// The scene that was asked for, then those at the model's extremes.
    rows: Vec<Row>,
}

/// The time and the answer of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Row {
    scene: &'static str,
    afferents: usize,
    /// Wall time on all cores per afferent and second of the scene, µs.
    us_per_afferent_s: f64,
    /// Mean rates of SA1, RA and PC afferents, impulses/s.
    mean_hz: [Option<f64>; 3],
    /// The share of the pins' time without contact with the skin.
    lost_contact: f64,
    spikes: u64,
    /// Afferents whose spike train changes if the skin is pressed in by a picometre more.
    nudged: usize,
}

/// Measures a scene. `progress` gets the completed share, 0 to 1.
pub(super) fn measure(
    scene: &Scene,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<AfferentsTradeoff, MethodError> {
    let scenes = [("as asked", scene.clone())].into_iter().chain(extremes(scene.array())).collect::<Vec<_>>();
    let mut rows = Vec::new();
    for (name, scene) in &scenes {
        rows.push(row(name, scene)?);
        progress(rows.len() as f64 / scenes.len() as f64);
    }
    Ok(AfferentsTradeoff { duration_s: scene.duration_s(), rows })
}

fn row(name: &'static str, scene: &Scene) -> Result<Row, MethodError> {
    let run = |scene: &Scene| simulate(scene, Keep::Spikes, &|_| ());
    let (answer, wall_s) = timed(|| run(scene))?;
    let nudged = scene.with_preindent_mm(scene.preindent_mm() + NUDGE_MM).expect("a picometre is little");
    let nudged = run(&nudged)?;
    let lost_s: f64 = answer.lost_contact_s.iter().sum();
    let afferents = scene.afferents().len();
    Ok(Row {
        scene: name,
        afferents,
        us_per_afferent_s: wall_s * 1e6 / (afferents as f64 * scene.duration_s()),
        mean_hz: Class::ALL.map(|class| answer.mean_hz(scene, class)),
        lost_contact: lost_s / (answer.lost_contact_s.len() as f64 * scene.duration_s()),
        spikes: answer.counts.iter().sum(),
        nudged: answer
            .spikes_s
            .iter()
            .flatten()
            .zip(nudged.spikes_s.iter().flatten())
            .filter(|(a, b)| a != b)
            .count(),
    })
}

/// The scenes at the extremes: all pins of the array at 60 Hz, unless the name says otherwise.
fn extremes(array: Array) -> Vec<(&'static str, Scene)> {
    let pins = |frequency_hz: f64, amplitude_um: f64| -> Vec<_> {
        array
            .numbers()
            .map(|motor| {
                let [x_mm, y_mm] = array.position_mm(motor);
                // Each motor has its own phase; the golden ratio spreads them evenly.
                let phase = (f64::from(motor) * 0.618_034).fract();
                json!({"x_mm": x_mm, "y_mm": y_mm, "frequency_hz": frequency_hz, "amplitude_um": amplitude_um, "phase": phase})
            })
            .collect()
    };
    let scene = |duration_s: f64,
                 preindent_mm: f64,
                 pins: Vec<serde_json::Value>,
                 afferents: Vec<Afferent>| {
        let text = json!({
            "model": "afferents", "array": array.name(), "duration_s": duration_s, "preindent_mm": preindent_mm, "ramp_s": 0.0, "begin_s": 0.0,
            "noise": true, "pins": pins, "afferents": []
        });
        match AnyScene::read(&text.to_string(), "extreme.json", Some(ModelName::Afferents)) {
            Ok(AnyScene::Afferents(scene)) => {
                scene.with_afferents(afferents).expect("the afferents are those of a finger")
            }
            other => panic!("a test reads the scenes: {other:?}"),
        }
    };
    let finger = || population(0);
    let [x_mm, y_mm] = array.position_mm(array.nearest_to([0.0, 0.0]).0);
    // Afferents below the pin's rim, where the pressure under a flat punch has a pole.
    let edge = Class::ALL.map(|class| {
        let at = meissner_skin::membrane::Position { x_mm: x_mm + array.pin_radius_mm(), y_mm };
        Afferent { class, row: 0, at }
    });
    let many = (0..).flat_map(population).take(MANY).collect();
    vec![
        ("0.01 um", scene(1.0, PREINDENT_MM, pins(60.0, 0.01), finger())),
        ("80 um", scene(1.0, PREINDENT_MM, pins(60.0, 80.0), finger())),
        ("400 um", scene(1.0, PREINDENT_MM, pins(60.0, 400.0), finger())),
        ("400 um, pins just touch the skin", scene(1.0, 0.0, pins(60.0, 400.0), finger())),
        ("80 um, all pins 1 mm below the skin", scene(1.0, -1.0, pins(60.0, 80.0), finger())),
        ("80 um at 2500 Hz, half the sampling rate", scene(1.0, PREINDENT_MM, pins(2500.0, 80.0), finger())),
        (
            "80 um, one afferent of each class under a pin's edge",
            scene(1.0, PREINDENT_MM, pins(60.0, 80.0), edge.into()),
        ),
        ("80 um, 100 000 afferents, 0.1 s", scene(0.1, PREINDENT_MM, pins(60.0, 80.0), many)),
    ]
}

pub(super) fn table(found: &AfferentsTradeoff) -> String {
    let row = |row: &Row| {
        let [sa1, ra, pc] = row.mean_hz;
        vec![
            row.scene.to_owned(),
            row.afferents.to_string(),
            format!("{:.2}", row.us_per_afferent_s),
            number(sa1, 1),
            number(ra, 1),
            number(pc, 1),
            format!("{:.1}", 100.0 * row.lost_contact),
            row.spikes.to_string(),
            row.nudged.to_string(),
        ]
    };
    let head = ["scene", "afferents", "us/afferent/s", "SA1", "RA", "PC", "no contact %", "spikes", "nudged"];
    format!(
        "A scene of {} s under the model afferents, on all cores, and scenes at the model's extremes: all pins at 60 Hz if nothing else \
         is said. Rates in impulses/s. Nudged: afferents with another spike train if the skin is pressed in by a picometre more.\n{}\n\
         The step of {SAMPLE_US} us is part of the model: its noise and its filters go by samples, and its parameters were fitted \
         with it. What it costs: spikes come at whole steps, and no vibration may be faster than 2500 Hz.",
        found.duration_s,
        columns(&head, found.rows.iter().map(row))
    )
}
