//! What the methods of the simulator are worth: time against error, measured on this machine.
//!
//! [`tradeoff`] runs a scene by every method and step and compares each with the exact one: spike by spike, receptor
//! by receptor (`compare`), and by its cost on the target [`YARDSTICK`]. [`plot`] draws it, [`reasons`]
//! says why what was skipped need not be computed. Nothing is decided for anybody: the recommendation is a sentence.
//! The table that people read is laid out in `cli::simulate`.
//!
//! Invariant: errors depend on the scene alone; times, and with them the front and the recommendation, on the machine.

mod compare;
mod how;
mod plot;
mod reasons;

pub use compare::{MATCH_S, matching};
pub use how::MethodLabel;
pub use plot::{PlotError, plot};
pub use reasons::{Count, Reason, reasons};

use compare::{Difference, Reference};
use meissner_design::{Partition, YARDSTICK, shipped};
use meissner_skin::{Answer, Integrator, Method, MethodError, Options, Precision, Scene, Stepping, simulate};
use serde::Serialize;
use std::time::{Duration, Instant};

/// The standard scene, as a TOML text: 24 motors at 60 Hz, 306 receptors, 1 s.
pub const SIXTY_HERTZ: &str = include_str!("../../../../scenes/sixty-hertz.toml");

/// Steps that are compared, µs.
pub const STEPS_US: [u32; 12] = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
/// A step is left out if steps × receptors are more than this: about a second a run on a slow core.
pub const MOST_STEPS: f64 = 5e8;
/// Of so many runs the time is the median, if they are fast.
const RUNS: usize = 5;
/// After so long there is no further run.
const ENOUGH: Duration = Duration::from_millis(200);
/// The error that the recommendation allows, impulses/s RMS: less than another noise seed makes (SD up to 1.6).
const ALLOWED_HZ: f64 = 1.0;

/// MethodLabel the methods compare on a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MethodTradeoff {
    /// Of the scene.
    pub receptors: usize,
    /// Of the scene.
    pub duration_s: f64,
    /// The membrane's time constant.
    pub tau_s: f64,
    /// 2 tau: with a longer step forward Euler grows without end. It is refused from tau on: between the two the
    /// membrane overshoots and alternates in sign.
    pub euler_unstable_above_us: f64,
    /// By the exact method.
    pub spikes: u64,
    /// By the exact method: on the target [`YARDSTICK`]; none if the receptors are all on the edge, or none of them is.
    pub cost_hz: Option<f64>,
    /// What the exact method takes.
    pub exact_wall_s: f64,
    /// The exact method first.
    pub rows: Vec<Row>,
    /// Steps that would have taken too long.
    pub left_out: Option<LeftOut>,
    /// What to take, in a sentence.
    pub recommendation: String,
}

/// A method, what it takes and how it errs against the exact one. Figures that have no meaning are none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The method.
    #[serde(flatten)]
    pub how: MethodLabel,
    /// Wall time on all cores, per receptor and second of the scene.
    pub us_per_receptor_s: Option<f64>,
    /// MethodLabel many of the exact method's spikes have a partner within [`MATCH_S`].
    pub spikes_matched_share: Option<f64>,
    /// Of those that have one: mean distance in time.
    pub mean_error_us: Option<f64>,
    /// RMS over receptors of the difference in rate.
    pub rate_rms_hz: Option<f64>,
    /// Spikes too many, as a share of the exact method's.
    pub rate_bias: Option<f64>,
    /// Difference in cost.
    pub cost_error_hz: Option<f64>,
    /// Refused because the step is too long for forward Euler.
    pub unstable: bool,
    /// Why the method was refused, if it was; then there are no figures.
    pub reason: Option<String>,
    /// No other row is faster and errs no more, and none errs less and is as fast.
    pub pareto: bool,
}

/// Steps that were not run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Which.
    pub steps_us: Vec<u32>,
    /// By what rule.
    pub why: String,
}

/// Compares all methods on a scene. `progress` hears now and then which part is done, on any thread.
///
/// # Errors
/// If the exact method cannot simulate the scene.
pub fn tradeoff(scene: &Scene, progress: &(dyn Fn(f64) + Sync)) -> Result<MethodTradeoff, MethodError> {
    let receptors = scene.afferents().len();
    let feasible =
        |step_us: &u32| scene.duration_s() * 1e6 / f64::from(*step_us) * receptors as f64 <= MOST_STEPS;
    let (steps, too_fine): (Vec<u32>, Vec<u32>) = STEPS_US.into_iter().partition(feasible);
    let methods = stepped(&steps);
    let all = methods.len() as f64 + 1.0;

    let receptor_s = receptors as f64 * scene.duration_s();
    let (exact, exact_wall_s) = timed(scene, Method::Exact, &|part| progress(part / all))?;
    let reference = Reference::new(scene, exact);
    let itself = reference.difference(reference.answer());
    let mut rows = vec![row(Method::Exact, receptor_s, Ok((exact_wall_s, itself)))];
    for (index, method) in methods.into_iter().enumerate() {
        let done = |part: f64| progress((index as f64 + 1.0 + part) / all);
        let run = timed(scene, method, &done);
        rows.push(row(
            method,
            receptor_s,
            run.map(|(answer, wall_s)| (wall_s, reference.difference(&answer))),
        ));
    }
    mark_front(&mut rows);
    Ok(MethodTradeoff {
        receptors,
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

/// Which receptors of the scene are on the yardstick.
fn partition(scene: &Scene) -> Partition {
    let target = shipped(YARDSTICK).expect("it is shipped, as a test shows");
    Partition::of(&target.frames()[0].shape, target.reach_mm(), scene.afferents())
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

/// The answer, and the median of what it took.
fn timed(
    scene: &Scene,
    method: Method,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(Answer, f64), MethodError> {
    let begun = Instant::now();
    let mut walls = Vec::new();
    loop {
        let started = Instant::now();
        let answer = simulate(scene, &Options::spikes(method), progress)?;
        walls.push(started.elapsed().as_secs_f64());
        if walls.len() == RUNS || begun.elapsed() > ENOUGH {
            walls.sort_by(f64::total_cmp);
            return Ok((answer, walls[(walls.len() - 1) / 2]));
        }
    }
}

/// A method's row: what it took and how it differs, or why it was refused.
fn row(method: Method, receptor_s: f64, run: Result<(f64, Difference), MethodError>) -> Row {
    let (wall_s, difference) = run.unwrap_or_default();
    let error = run.err();
    Row {
        how: method.into(),
        us_per_receptor_s: (error.is_none() && receptor_s > 0.0).then(|| wall_s * 1e6 / receptor_s),
        spikes_matched_share: difference.matched_share,
        mean_error_us: difference.mean_error_us,
        rate_rms_hz: difference.rate_rms_hz,
        rate_bias: difference.rate_bias,
        cost_error_hz: difference.cost_error_hz,
        unstable: matches!(error, Some(MethodError::Unstable { .. })),
        reason: error.map(|error| error.to_string()),
        pareto: false,
    }
}

impl Row {
    /// Time and error, if it has both.
    fn place(&self) -> Option<(f64, f64)> {
        self.us_per_receptor_s.zip(self.rate_rms_hz)
    }
}

fn mark_front(rows: &mut [Row]) {
    let places: Vec<_> = rows.iter().filter_map(Row::place).collect();
    for row in rows {
        row.pareto = row.place().is_some_and(|(time, error)| {
            !places.iter().any(|&other| other != (time, error) && other.0 <= time && other.1 <= error)
        });
    }
}

/// The fastest way whose error is allowed; and the error below which there is none but the exact.
fn recommendation(rows: &[Row]) -> String {
    let exact = rows.iter().find(|row| row.how.step_us.is_none()).and_then(Row::place);
    let Some((exact_time, _)) = exact else {
        return "There is nothing to compare: the scene has no receptors, or no duration.".to_owned();
    };
    let faster = || {
        rows.iter()
            .filter_map(|row| row.place().map(|(time, error)| (row, time, error)))
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
    format!("Take the {}: {error} impulses/s RMS at {share} of the exact method's time{rest}.", row.how)
}

/// A number that is not negative, with two significant digits.
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
    fn every_refusal_has_a_reason_and_only_eulers_is_unstable() {
        let counting = MethodError::Precision { key: "refractory_s", steps: 1e9, step_us: 1 };
        for (error, unstable) in
            [(counting, false), (MethodError::Unstable { step_us: 50_000, tau_s: 0.044 }, true)]
        {
            let row = refused(error);
            assert_eq!((row.unstable, row.reason.clone()), (unstable, Some(error.to_string())));
            assert_eq!((row.place(), row.pareto), (None, false));
        }
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
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
        let front: Vec<_> = rows.iter().filter(|row| row.pareto).map(|row| row.how.step_us).collect();
        assert_eq!(front, [None, Some(100), Some(200), Some(1000)]);
        assert_eq!(
            recommendation(&rows),
            "Take the propagator in f32 at 200 us: 0.25 impulses/s RMS at 0.33 of the exact method's time; \
             below 0.10 impulses/s take the exact method."
        );
    }

    #[test]
    fn where_no_step_is_good_enough_the_exact_method_is_recommended() {
        let said = recommendation(&[at(None, 3.0, 0.0), at(Some(1), 90.0, 0.0), at(Some(500), 1.0, 1.1)]);
        assert!(said.starts_with("Take the exact method"), "{said}");
        let said = recommendation(&[refused(MethodError::Step { step_us: 0 })]);
        assert!(said.contains("nothing to compare"), "{said}");
        let said = recommendation(&[at(None, 3.0, 0.0), at(Some(500), 1.5, 0.0)]);
        assert!(said.ends_with("us: 0 impulses/s RMS at 0.50 of the exact method's time."), "{said}");
    }

    #[test]
    fn the_shipped_scene_is_the_standard_one() {
        let scene = Scene::read(SIXTY_HERTZ, "sixty-hertz.toml").unwrap();
        assert_eq!((scene.afferents().len(), scene.drives().len(), scene.duration_s()), (306, 24, 1.0));
        assert_eq!(scene.model().noise_sd, meissner_skin::afferent::POPULATION_NOISE_SD);
        let mut phases: Vec<_> = scene.drives().iter().map(|drive| drive.phase.to_bits()).collect();
        phases.sort_unstable();
        phases.dedup();
        assert_eq!(phases.len(), 24);
        assert!(scene.drives().iter().all(|drive| (drive.frequency_hz, drive.amplitude_um) == (60.0, 80.0)));
    }
}
