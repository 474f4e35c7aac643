//! The chosen method stays within the allowed error, measured on random scenes.

use meissner_skin::{Method, Options, Scene, choose, simulate};
use meissner_test_support::random::Random;
use meissner_test_support::statistics::rms;
use rayon::prelude::*;
use std::ops::Range;

/// A method's true rate error: RMS over afferents, impulses/s.
fn rate_error_hz(scene: &Scene, method: Method) -> f64 {
    let counts = |method| simulate(scene, &Options::rates(method), &|_| ()).unwrap().counts;
    let (found, exact) = (counts(method), counts(Method::Exact));
    rms(found.iter().zip(&exact).map(|(&a, &b)| a as f64 - b as f64)) / scene.duration_s()
}

#[derive(Debug, Default)]
struct Figures {
    scenes: u32,
    within: u32,
    exact: u32,
    /// The largest true error, in units of the allowed one.
    worst: f64,
}

fn figures(seeds: Range<u64>, populations: f64) -> Figures {
    let of_one = |seed| {
        let mut random = Random::new(seed);
        let scene = random.scene(populations);
        let allowed_hz = random.log_between(0.3, 20.0);
        let choice = choose(&scene, allowed_hz).unwrap();
        (choice.method, rate_error_hz(&scene, choice.method) / allowed_hz)
    };
    let all: Vec<_> = seeds.into_par_iter().map(of_one).collect();
    let mut figures = Figures::default();
    for (method, ratio) in all {
        figures.scenes += 1;
        figures.within += u32::from(ratio <= 1.0);
        figures.exact += u32::from(method == Method::Exact);
        figures.worst = figures.worst.max(ratio);
    }
    figures
}

#[test]
fn the_chosen_method_keeps_to_the_allowed_error() {
    let figures = figures(0..200, 0.25);
    assert!(f64::from(figures.within) >= 0.95 * f64::from(figures.scenes), "{figures:?}");
    assert!(figures.worst <= 2.0, "{figures:?}");
    assert!(2 * figures.exact < figures.scenes, "{figures:?}");
}
