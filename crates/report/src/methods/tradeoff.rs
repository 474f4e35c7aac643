//! Runs a scene by all methods and compares them.
//!
//! Invariant: errors depend on the scene alone. Times, and with them the front and the recommendation, depend on the
//! machine.

use crate::methods::compare::{Difference, Reference};
use crate::methods::label::MethodLabel;
use meissner_skin::{Integrator, Method, MethodError, Options, Precision, Scene, Stepping, simulate};
use serde::Serialize;
use std::time::{Duration, Instant};

/// The steps to compare, µs.
pub const STEPS_US: [u32; 12] = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
/// A step is left out if steps × afferents exceed this: about a second per run on a slow core.
pub const MOST_STEPS: f64 = 5e8;
/// The most runs of a method; its time is their median.
const RUNS: usize = 5;
/// No further run begins after this time.
const ENOUGH: Duration = Duration::from_millis(200);
/// The rate error that the recommendation allows, impulses/s RMS: less than another noise seed causes (SD up to 1.6).
const ALLOWED_HZ: f64 = 1.0;

/// The methods compared on one scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MethodTradeoff {
    /// The number of afferents in the scene.
    #[serde(rename = "receptors")]
    pub afferents: usize,
    /// The duration of the scene, s.
    pub duration_s: f64,
    /// The time constant of the membrane, s.
    pub tau_s: f64,
    /// 2 tau, µs. With a longer step forward Euler diverges. Between tau and 2 tau the membrane alternates in sign, so
    /// steps above tau are refused.
    pub euler_unstable_above_us: f64,
    /// Spikes by the exact method.
    pub spikes: u64,
    /// Contrast by the exact method on the target [`YARDSTICK`](meissner_design::YARDSTICK); none if all afferents are ON
    /// or all are OFF.
    pub cost_hz: Option<f64>,
    /// Wall time of the exact method, s.
    pub exact_wall_s: f64,
    /// The methods, the exact one first.
    pub rows: Vec<Row>,
    /// Steps that would take too long.
    pub left_out: Option<LeftOut>,
    /// The method to take, in a sentence.
    pub recommendation: String,
}

/// A method, its time, and its error against the exact method.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The method.
    #[serde(flatten)]
    pub method: MethodLabel,
    /// Wall time on all cores per afferent and second of the scene, µs.
    #[serde(rename = "us_per_receptor_s")]
    pub us_per_afferent_s: Option<f64>,
    /// Its error.
    #[serde(flatten)]
    pub difference: Difference,
    /// Whether the method was refused because the step is too long for forward Euler.
    pub unstable: bool,
    /// Why the method was refused, if it was. It then has no figures.
    pub reason: Option<String>,
    /// Whether the row is on the Pareto front: no other row is better in time or error and at least as good in both.
    pub pareto: bool,
}

/// The steps that were left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// The steps, µs.
    pub steps_us: Vec<u32>,
    /// The reason.
    pub why: String,
}

/// Compares all methods on a scene with the finest. `progress` gets the completed share, 0 to 1, on any thread.
///
/// # Errors
/// If the finest method cannot simulate the scene.
pub fn tradeoff(scene: &Scene, progress: &(dyn Fn(f64) + Sync)) -> Result<MethodTradeoff, MethodError> {
    let (finest, afferents) = (Method::Exact, scene.afferents().len());
    let feasible =
        |step_us: &u32| scene.duration_s() * 1e6 / f64::from(*step_us) * afferents as f64 <= MOST_STEPS;
    let (steps, too_fine): (Vec<u32>, Vec<u32>) = STEPS_US.into_iter().partition(feasible);
    let methods = stepped(&steps);
    let all = methods.len() as f64 + 1.0;

    let afferent_s = afferents as f64 * scene.duration_s();
    let run = |method, done: &(dyn Fn(f64) + Sync)| timed(|| simulate(scene, &Options::spikes(method), done));
    let (exact, exact_wall_s) = run(finest, &|part| progress(part / all))?;
    let reference = Reference::new(scene, exact);
    let itself = reference.difference(reference.answer());
    let mut rows = vec![row(finest, afferent_s, Ok((exact_wall_s, itself)))];
    for (index, method) in methods.into_iter().enumerate() {
        let done = |part: f64| progress((index as f64 + 1.0 + part) / all);
        let found = run(method, &done).map(|(answer, wall_s)| (wall_s, reference.difference(&answer)));
        rows.push(row(method, afferent_s, found));
    }
    mark_front(&mut rows);
    Ok(MethodTradeoff {
        afferents,
        duration_s: scene.duration_s(),
        tau_s: scene.model().tau_s,
        euler_unstable_above_us: scene.model().tau_s * 2e6,
        spikes: reference.spikes(),
        cost_hz: reference.cost_hz(),
        exact_wall_s,
        recommendation: recommendation(&rows),
        rows,
        left_out: (!too_fine.is_empty()).then(|| LeftOut {
            steps_us: too_fine,
            why: format!("more than {MOST_STEPS:e} steps x receptors take too long"),
        }),
    })
}

fn stepped(steps: &[u32]) -> Vec<Method> {
    let mut methods = Vec::new();
    for integrator in Integrator::ALL {
        for precision in Precision::ALL {
            let method = |&step_us| Method::Stepped(Stepping { step_us, integrator, precision });
            methods.extend(steps.iter().map(method));
        }
    }
    methods
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
        pareto: false,
    }
}

impl Row {
    /// Time and error, if there are both.
    pub(super) fn time_and_error(&self) -> Option<(f64, f64)> {
        self.us_per_afferent_s.zip(self.difference.rate_rms_hz)
    }
}

fn mark_front(rows: &mut [Row]) {
    let all: Vec<_> = rows.iter().filter_map(Row::time_and_error).collect();
    for row in rows {
        row.pareto = row.time_and_error().is_some_and(|(time, error)| {
            !all.iter().any(|&other| other != (time, error) && other.0 <= time && other.1 <= error)
        });
    }
}

/// Recommends the fastest method with an allowed error, and names the error below which only the exact method remains.
fn recommendation(rows: &[Row]) -> String {
    let exact = rows.iter().find(|row| row.method.step_us.is_none()).and_then(Row::time_and_error);
    let Some((exact_time, _)) = exact else {
        return "There is nothing to compare: the scene has no afferents, or no duration.".to_owned();
    };
    let faster = || {
        rows.iter()
            .filter_map(|row| row.time_and_error().map(|(time, error)| (row, time, error)))
            .filter(|&(_, time, _)| time < exact_time)
    };
    let best = faster().filter(|&(.., error)| error <= ALLOWED_HZ).min_by(|a, b| a.1.total_cmp(&b.1));
    let least = faster().map(|(.., error)| error).fold(f64::INFINITY, f64::min);
    let Some((row, time, error)) = best else {
        return format!(
            "Take the exact method: no faster one keeps the rate error within {} impulses/s RMS.",
            short(ALLOWED_HZ)
        );
    };
    let (error, share) = (short(error), short(time / exact_time));
    let rest = if least > 0.0 {
        format!("; below {} impulses/s take the exact method", short(least))
    } else {
        String::new()
    };
    format!("Take the {}: {error} impulses/s RMS at {share} of the exact method's time{rest}.", row.method)
}

/// A non-negative number with two significant digits.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
fn short(number: f64) -> String {
    if number == 0.0 {
        return "0".to_owned();
    }
    let digits = (1.0 - number.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{number:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(step_us: Option<u32>, time: f64, error: f64) -> Row {
        let stepping =
            |step_us| Stepping { step_us, integrator: Integrator::Propagator, precision: Precision::F32 };
        let method = step_us.map_or(Method::Exact, |step_us| Method::Stepped(stepping(step_us)));
        let difference = Difference { rate_rms_hz: Some(error), ..Difference::default() };
        row(method, 1e6, Ok((time, difference)))
    }

    fn refused(error: MethodError) -> Row {
        row(Method::Exact, 1e6, Err(error))
    }

    #[test]
    fn every_refused_method_has_a_reason_and_only_euler_is_unstable() {
        let counting = MethodError::Precision { key: "refractory_s", steps: 1e9, step_us: 1 };
        for (error, unstable) in
            [(counting, false), (MethodError::Unstable { step_us: 50_000, tau_s: 0.044 }, true)]
        {
            let row = refused(error);
            assert_eq!((row.unstable, row.reason.clone()), (unstable, Some(error.to_string())));
            assert_eq!((row.time_and_error(), row.pareto), (None, false));
        }
    }

    #[test]
    fn the_front_has_the_rows_that_no_other_beats() {
        let mut rows = vec![
            at(None, 30.0, 0.0),
            at(Some(1), 90.0, 0.0),
            at(Some(100), 20.0, 0.1),
            at(Some(150), 20.0, 0.2),
            at(Some(200), 10.0, 0.25),
            at(Some(500), 11.0, 3.0),
            at(Some(1000), 2.0, 9.0),
        ];
        rows.push(refused(MethodError::Step { step_us: 0 }));
        mark_front(&mut rows);
        let front: Vec<_> = rows.iter().filter(|row| row.pareto).map(|row| row.method.step_us).collect();
        assert_eq!(front, [None, Some(100), Some(200), Some(1000)]);
        assert_eq!(
            recommendation(&rows),
            "Take the propagator in f32 at 200 us: 0.25 impulses/s RMS at 0.33 of the exact method's time; \
             below 0.10 impulses/s take the exact method."
        );
    }

    #[test]
    fn the_exact_method_is_recommended_if_no_step_is_good_enough() {
        let said = recommendation(&[at(None, 3.0, 0.0), at(Some(1), 90.0, 0.0), at(Some(500), 1.0, 1.1)]);
        assert!(said.starts_with("Take the exact method"), "{said}");
        let said = recommendation(&[refused(MethodError::Step { step_us: 0 })]);
        assert!(said.contains("nothing to compare"), "{said}");
        let said = recommendation(&[at(None, 3.0, 0.0), at(Some(500), 1.5, 0.0)]);
        assert!(said.ends_with("us: 0 impulses/s RMS at 0.50 of the exact method's time."), "{said}");
    }
}
