//! Measures the second model: its computing time, the error of the search's approximation, and scenes at the model's extremes.
//!
//! The model has one step, so there are no methods to choose from. A caller saves time by requesting only some classes. A search,
//! which simulates RA afferents thousands of times, saves time by [`NearEvaluator`]. Noise of another seed changes the rates, too:
//! an error below that change does not matter. A scene at an extreme runs twice, the second time with the skin pressed in by a
//! picometre more. Spikes that this moves depend on rounding errors.
//!
//! Invariant: only the times depend on the machine.

use super::tradeoff::timed;
use meissner_array::spec::Array;
use meissner_design::SEARCH_MIN_SHARES;
use meissner_skin::afferents::{Afferent, Class, NearEvaluator, PREINDENT_MM, Scene, population, simulate};
use meissner_skin::{AnyScene, Keep, MethodError, ModelName};
use serde::Serialize;
use serde_json::json;

/// Shares of the largest influence below which [`NearEvaluator`] leaves a motor out: the search's, and others around them.
const MIN_SHARES: [f64; 5] = [0.0, 0.005, SEARCH_MIN_SHARES[1], SEARCH_MIN_SHARES[0], 0.1];
/// Additional indentation of the skin in the second run, mm.
const NUDGE_MM: f64 = 1e-9;
const MANY: usize = 100_000;

/// Computing times of a scene under the second model and its approximations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AfferentsTradeoff {
    /// The duration of the scene, s.
    pub duration_s: f64,
    /// The simulations: the full model for all afferents, the full model for RA afferents, and the approximations for RA afferents.
    pub rows: Vec<AfferentsRow>,
    /// Scenes at the model's extremes.
    pub extremes: Vec<Extreme>,
}

/// A simulation of the scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct AfferentsRow {
    /// Its method.
    pub method: String,
    /// The number of afferents.
    pub afferents: usize,
    /// Wall time on all cores, s.
    pub wall_s: f64,
    /// The same if only one motor has changed since, s; none if that saves no time.
    pub one_motor_wall_s: Option<f64>,
    /// The difference from the full model's rates of RA afferents, impulses/s RMS over afferents.
    pub rate_rms_hz: Option<f64>,
    /// The excess of spikes, as a share of the full model's.
    pub rate_bias: Option<f64>,
}

/// A scene at an extreme of the model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Extreme {
    /// The scene.
    pub scene: &'static str,
    /// The number of afferents.
    pub afferents: usize,
    /// Wall time on all cores per afferent and second of the scene, µs.
    pub us_per_afferent_s: f64,
    /// Mean rates of SA1, RA and PC afferents, impulses/s.
    pub mean_hz: [Option<f64>; 3],
    /// The share of the pins' time without contact with the skin.
    pub lost_contact: f64,
    /// The number of spikes.
    pub spikes: u64,
    /// Afferents whose spike train changes if the skin is pressed in by a picometre more.
    pub nudged: usize,
}

/// Measures a scene. `progress` gets the completed share, 0 to 1.
///
/// # Errors
/// If a scene has too many spikes.
pub fn tradeoff(scene: &Scene, progress: &(dyn Fn(f64) + Sync)) -> Result<AfferentsTradeoff, MethodError> {
    let extremes = extremes(scene.array());
    let parts = (extremes.len() + 1) as f64;
    let rows = rows(scene)?;
    let of = |(index, (name, scene)): (usize, (&'static str, Scene))| {
        progress((index + 1) as f64 / parts);
        extreme(name, &scene)
    };
    let extremes = extremes.into_iter().enumerate().map(of).collect::<Result<_, _>>()?;
    Ok(AfferentsTradeoff { duration_s: scene.duration_s(), rows, extremes })
}

fn rows(scene: &Scene) -> Result<Vec<AfferentsRow>, MethodError> {
    let row = |method: String, afferents, wall_s| AfferentsRow {
        method,
        afferents,
        wall_s,
        ..AfferentsRow::default()
    };
    let simulated = |scene: &Scene| timed(|| simulate(scene, Keep::Rates, &|_| ()));
    let (_, wall_s) = simulated(scene)?;
    let mut rows = vec![row("all classes".to_owned(), scene.afferents().len(), wall_s)];
    let rapid: Vec<Afferent> = scene.afferents().iter().copied().filter(|of| of.class == Class::Ra).collect();
    if rapid.is_empty() {
        return Ok(rows);
    }
    let scene = scene.with_afferents(rapid).expect("some afferents of a scene are a scene");
    let afferents = scene.afferents().len();
    let (model, wall_s) = simulated(&scene)?;
    rows.push(row("RA alone".to_owned(), afferents, wall_s));
    let compared = |row: AfferentsRow, counts: &[u64]| {
        let [rate_rms_hz, rate_bias] = difference(&scene, &model.counts, counts);
        AfferentsRow { rate_rms_hz, rate_bias, ..row }
    };
    if scene.noise() {
        let (other, wall_s) = simulated(&scene.with_seed(scene.seed() ^ 1))?;
        rows.push(compared(
            row("RA alone, noise of another seed".to_owned(), afferents, wall_s),
            &other.counts,
        ));
    }
    let Some(drives) = scene.drives() else { return Ok(rows) };
    let most_um = drives.iter().map(|drive| drive.amplitude_um).fold(0.0, f64::max);
    let Some(first) = drives.first().map(|drive| drive.motor) else { return Ok(rows) };
    let others: Vec<_> = drives.iter().filter(|drive| drive.motor != first).copied().collect();
    for min_share in MIN_SHARES {
        // The pins may lose contact, which the approximation does not cover.
        let Some(mut near) = NearEvaluator::new(&scene, most_um, min_share) else { break };
        let evaluate = |near: &NearEvaluator, drives: &[_]| {
            near.evaluate(drives).expect("the drives of a scene are drives of a scene")
        };
        let (all, wall_s) = timed(|| Ok::<_, MethodError>(evaluate(&near, drives)))?;
        near.accept(all);
        let (_, one_motor_s) = timed(|| Ok::<_, MethodError>(evaluate(&near, &others)))?;
        let method = format!("RA nearly, influences from {} %", 100.0 * min_share);
        let near_row = AfferentsRow { one_motor_wall_s: Some(one_motor_s), ..row(method, afferents, wall_s) };
        rows.push(compared(near_row, near.counts()));
    }
    Ok(rows)
}

/// The difference in rate, impulses/s RMS, and the excess of spikes as a share.
fn difference(scene: &Scene, model: &[u64], found: &[u64]) -> [Option<f64>; 2] {
    let squares =
        model.iter().zip(found).map(|(&model, &found)| scene.rate_hz(model.abs_diff(found)).powi(2));
    let (spikes, of_found): (u64, u64) = (model.iter().sum(), found.iter().sum());
    let rms_hz = (squares.sum::<f64>() / model.len() as f64).sqrt();
    [(!model.is_empty()).then_some(rms_hz), (spikes > 0).then(|| of_found as f64 / spikes as f64 - 1.0)]
}

fn extreme(name: &'static str, scene: &Scene) -> Result<Extreme, MethodError> {
    let run = |scene: &Scene| simulate(scene, Keep::Spikes, &|_| ());
    let (answer, wall_s) = timed(|| run(scene))?;
    let nudged = scene.with_preindent_mm(scene.preindent_mm() + NUDGE_MM).expect("a picometre is little");
    let nudged = run(&nudged)?;
    let lost_s: f64 = answer.lost_contact_s.iter().sum();
    let afferents = scene.afferents().len();
    Ok(Extreme {
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
