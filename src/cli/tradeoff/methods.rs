//! Runs a scene by all methods and compares them.
//!
//! Invariant: errors depend on the scene alone, and only times on the machine.

use super::compare::{Difference, Reference};
use crate::cli::simulate::MethodLabel;
use meissner_skin::{Integrator, Method, MethodError, Options, Scene, simulate};
use serde::Serialize;
use std::time::{Duration, Instant};

/// The steps to compare, µs.
pub(super) const STEPS_US: [u32; 12] = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
/// A step is left out if steps × afferents exceed this: about a second per run on a slow core.
const MOST_STEPS: f64 = 5e8;
/// The most runs of a method; its time is their median.
const RUNS: usize = 5;
/// No further run begins after this time.
const ENOUGH: Duration = Duration::from_millis(200);

/// The methods compared on one scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct MethodTradeoff {
    /// The number of afferents in the scene.
    #[serde(rename = "receptors")]
    pub(super) afferents: usize,
    pub(super) duration_s: f64,
    /// The time constant of the membrane, s.
    pub(super) tau_s: f64,
    /// 2 tau, µs. With a longer step forward Euler diverges. Between tau and 2 tau the membrane alternates in sign, so
    /// steps above tau are refused.
    euler_unstable_above_us: f64,
    /// Spikes by the exact method.
    pub(super) spikes: u64,
    /// Wall time of the exact method, s.
    pub(super) exact_wall_s: f64,
    /// The methods, the exact one first.
    pub(super) rows: Vec<Row>,
    /// Steps that would take too long.
    pub(super) left_out: Option<LeftOut>,
}

/// A method, its time, and its error against the exact method.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Row {
    #[serde(flatten)]
    pub(super) method: MethodLabel,
    /// Wall time on all cores per afferent and second of the scene, µs.
    #[serde(rename = "us_per_receptor_s")]
    pub(super) us_per_afferent_s: Option<f64>,
    #[serde(flatten)]
    pub(super) difference: Difference,
    /// Whether the method was refused because the step is too long for forward Euler.
    pub(super) unstable: bool,
    /// Why the method was refused, if it was. It then has no figures.
    pub(super) reason: Option<String>,
}

/// The steps that were left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct LeftOut {
    pub(super) steps_us: Vec<u32>,
    pub(super) why: String,
}

/// Compares all methods on a scene with the exact one. `progress` gets the completed share, 0 to 1, on any thread.
pub(super) fn compare(scene: &Scene, progress: &(dyn Fn(f64) + Sync)) -> Result<MethodTradeoff, MethodError> {
    let afferents = scene.afferents().len();
    let feasible =
        |step_us: &u32| scene.duration_s() * 1e6 / f64::from(*step_us) * afferents as f64 <= MOST_STEPS;
    let (steps, too_fine): (Vec<u32>, Vec<u32>) = STEPS_US.into_iter().partition(feasible);
    let methods = stepped(&steps);
    let all = methods.len() as f64 + 1.0;

    let afferent_s = afferents as f64 * scene.duration_s();
    let run = |method, done: &(dyn Fn(f64) + Sync)| timed(|| simulate(scene, &Options::spikes(method), done));
    let (exact, exact_wall_s) = run(Method::Exact, &|part| progress(part / all))?;
    let reference = Reference::new(scene, exact);
    let itself = reference.difference(reference.answer());
    let mut rows = vec![row(Method::Exact, afferent_s, Ok((exact_wall_s, itself)))];
    for (index, method) in methods.into_iter().enumerate() {
        let done = |part: f64| progress((index as f64 + 1.0 + part) / all);
        let found = run(method, &done).map(|(answer, wall_s)| (wall_s, reference.difference(&answer)));
        rows.push(row(method, afferent_s, found));
    }
    Ok(MethodTradeoff {
        afferents,
        duration_s: scene.duration_s(),
        tau_s: scene.model().tau_s,
        euler_unstable_above_us: scene.model().tau_s * 2e6,
        spikes: reference.spikes(),
        exact_wall_s,
        rows,
        left_out: (!too_fine.is_empty()).then(|| LeftOut {
            steps_us: too_fine,
            why: format!("more than {MOST_STEPS:e} steps x receptors take too long"),
        }),
    })
}

fn stepped(steps: &[u32]) -> Vec<Method> {
    let of = |integrator| steps.iter().map(move |&step_us| Method::stepped(step_us, integrator));
    Integrator::ALL.into_iter().flat_map(of).collect()
}

/// The result of a run, and the median wall time of some runs in seconds.
pub(super) fn timed<A, E>(run: impl Fn() -> Result<A, E>) -> Result<(A, f64), E> {
    let begun = Instant::now();
    let mut walls = Vec::new();
    loop {
        let started = Instant::now();
        let answer = run()?;
        walls.push(started.elapsed().as_secs_f64());
        if walls.len() == RUNS || begun.elapsed() > ENOUGH {
            walls.sort_by(f64::total_cmp);
            return Ok((answer, walls[(walls.len() - 1) / 2]));
        }
    }
}

/// The row of a method: its wall time and error, or why it was refused.
fn row(method: Method, afferent_s: f64, run: Result<(f64, Difference), MethodError>) -> Row {
    let (wall_s, difference) = run.unwrap_or_default();
    let error = run.err();
    Row {
        method: method.into(),
        us_per_afferent_s: (error.is_none() && afferent_s > 0.0).then(|| wall_s * 1e6 / afferent_s),
        difference,
        unstable: matches!(error, Some(MethodError::Unstable { .. })),
        reason: error.map(|error| error.to_string()),
    }
}
