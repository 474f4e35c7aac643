//! Events at one instant: a spike at a breakpoint, at the end of refractoriness, or
//! at the end of the scene.
//!
//! The tests do not aim at exact equality of floats. They take the two neighbouring numbers between which the answer
//! changes; a lost or doubled spike would show on one of the two sides.

use super::{as_the_oracle, drive, exact, methods, model, propagator, scene, spikes, stepped, under};
use meissner_skin::Method;
use meissner_skin::membrane::{AfferentModel, Rectify};

/// The least float in `no..=yes` at which `is` holds; it must not at `no` and must at `yes`.
fn first(mut no: f64, mut yes: f64, is: impl Fn(f64) -> bool) -> f64 {
    assert!(is(yes) && !is(no));
    while no.next_up() < yes {
        let middle = f64::midpoint(no, yes);
        if is(middle) { yes = middle } else { no = middle }
    }
    yes
}

#[test]
fn a_spike_at_a_breakpoint_is_one_spike() {
    // The stroke's breakpoints: its end, and the window's length after its beginning.
    for breakpoint_s in [589.0 / 85_000.0, 0.0043] {
        for rectify in [Rectify::Half, Rectify::Full, Rectify::Signed] {
            let of = |alpha_per_um| {
                let model = AfferentModel { alpha_per_um, refractory_s: 1.0, ..model(rectify) };
                scene(0.5, &[drive(9, 0.001, 80.0)], &[under(9)], model)
            };
            let at =
                first(0.015, 1.0, |alpha| exact(&of(alpha))[0].first().is_some_and(|&t| t < breakpoint_s));
            let mut alpha = at;
            for _ in 0..4 {
                alpha = alpha.next_down();
            }
            for _ in 0..9 {
                let found = exact(&of(alpha));
                assert!(found[0].len() == 1 && (found[0][0] - breakpoint_s).abs() < 1e-13, "{found:?}");
                alpha = alpha.next_up();
            }
            let found = spikes(&of(at), propagator(10));
            assert!(found[0].len() == 1 && (found[0][0] - breakpoint_s).abs() < 1e-5, "{found:?}");
        }
    }
}

#[test]
fn a_threshold_reached_just_as_refractoriness_ends() {
    // Refractoriness delays the second spike, or ends before it; at the boundary both coincide.
    let of = |refractory_s| {
        let model = AfferentModel { refractory_s, alpha_per_um: 0.12, ..model(Rectify::Half) };
        scene(0.02, &[drive(9, 0.001, 80.0)], &[under(9)], model)
    };
    let free = exact(&of(1e-5)).remove(0);
    let interval_s = free[1] - free[0];
    for ulps in -4..=4 {
        let refractory_s = f64::from_bits(interval_s.to_bits().wrapping_add_signed(ulps));
        let found = as_the_oracle(&of(refractory_s), 0).remove(0);
        assert!((found[1] - free[1]).abs() < 1e-13, "{found:?}, {free:?}");
    }
    for more_s in [1e-9, 1e-6, 1e-4] {
        let held = exact(&of(interval_s + more_s)).remove(0);
        assert!((held[1] - held[0] - interval_s - more_s).abs() < 1e-14, "{held:?}");
        let let_go = exact(&of(interval_s - more_s)).remove(0);
        assert!((let_go[1] - free[1]).abs() < 1e-14, "{let_go:?}");
    }
    for method in stepped(10) {
        let held = spikes(&of(2.0 * interval_s), method).remove(0);
        // Within a millionth of the refractory time, or within a step for Euler.
        let late = if method == propagator(10) { 1e-8 } else { 1.1e-5 };
        assert!((0.0..late).contains(&(held[1] - held[0] - 2.0 * interval_s + 2e-9)), "{method:?}: {held:?}");
    }
}

#[test]
fn a_spike_at_the_end_of_the_scene_does_not_count() {
    let of = |duration_s, start_s| {
        let drive = meissner_array::pattern::Drive { start_s: Some(start_s), ..drive(9, 0.001, 80.0) };
        scene(duration_s, &[drive], &[under(9)], AfferentModel { alpha_per_um: 0.3, ..model(Rectify::Half) })
    };
    for start_s in [0.0, 0.1, 0.37, 1.0, 3.3, 7.77, 12.4, 31.0] {
        for method in methods(1_000) {
            let all = spikes(&of(start_s + 0.1, start_s), method).remove(0);
            assert!(all.len() > 3, "{method:?}: {all:?}");
            for (number, &t) in all.iter().enumerate().skip(1) {
                // A segment is cut at the end of the scene: its spike may move by a last bit.
                let cut = |duration_s| spikes(&of(duration_s, start_s), method).remove(0);
                for duration_s in [t.next_down(), t, t.next_up()] {
                    let found = cut(duration_s);
                    assert!(found.iter().all(|&t| t < duration_s), "{method:?}: {found:?}");
                    assert!(found.len().abs_diff(number) <= 1, "{method:?}: {found:?}");
                }
                if method != Method::Exact {
                    // A step is never cut.
                    assert_eq!(cut(t).len(), number, "{method:?}, {t}");
                    assert_eq!(cut(t.next_up()).len(), number + 1, "{method:?}, {t}");
                }
            }
        }
    }
}
