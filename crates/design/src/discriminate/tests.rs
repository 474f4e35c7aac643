//! Comparisons of whole patterns: one with itself, different ones, by times and by counts; and plans that are refused.

use super::*;
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, POPULATION_NOISE_SD, Rectify};

fn pattern(name: &str, motors: &[u8], amplitude_um: f64) -> Pattern {
    let drive = |&motor: &u8| Drive {
        motor,
        frequency_hz: 60.0,
        amplitude_um,
        phase: 0.0,
        start_s: None,
        stop_s: None,
    };
    Pattern::new(Array::paper(), name, None, motors.iter().map(drive).collect(), toml::Table::new()).unwrap()
}

fn plan(model: SkinModel) -> Plan {
    Plan {
        model,
        trials: 12,
        fingers: vec![0, 1],
        seconds: 0.2,
        resolution_ms: 5.0,
        seed: 7,
        efficiency: 0.01,
    }
}

fn models() -> [SkinModel; 2] {
    [
        SkinModel::Membrane(AfferentModel::default_for(Rectify::default(), POPULATION_NOISE_SD)),
        SkinModel::AFFERENTS,
    ]
}

#[test]
fn a_pattern_is_not_told_from_itself_and_from_another_it_is() {
    let (near, same, far) = (pattern("a", &[9], 80.0), pattern("b", &[9], 80.0), pattern("c", &[21], 80.0));
    for model in models() {
        let found = discriminate([&near, &same], &plan(model), &|_| ()).unwrap();
        for of in &found {
            for reading in [&of.counts, &of.times, &of.total] {
                assert!(reading.d_prime.abs() < 4.0 * reading.d_prime_se + 0.5, "{model:?} {of:?}");
            }
        }
        let found = discriminate([&near, &far], &plan(model), &|_| ()).unwrap();
        let all = found.last().unwrap();
        assert_eq!(all.class.is_none(), model.classes().len() > 1);
        assert!(
            all.counts.d_prime > 10.0 && all.counts.d_prime > 10.0 * all.counts.d_prime_se,
            "{model:?} {all:?}"
        );
        // Both patterns drive the same number of pins at the same amplitude, so the total count tells less than the place of the
        // spikes.
        assert!(all.total.d_prime < 0.8 * all.counts.d_prime, "{model:?} {all:?}");
        assert!(
            all.counts.correct_percent > 60.0
                && all.counts.correct_percent_range[0] <= all.counts.correct_percent
        );
    }
}

#[test]
fn more_efficient_observers_are_right_more_often_and_results_come_again() {
    let patterns = [&pattern("a", &[9], 20.0), &pattern("b", &[9], 30.0)];
    let model = SkinModel::AFFERENTS;
    let found = discriminate(patterns, &plan(model), &|_| ()).unwrap();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(one.install(|| discriminate(patterns, &plan(model), &|_| ())).unwrap(), found);
    let ideal = discriminate(patterns, &Plan { efficiency: 1.0, ..plan(model) }, &|_| ()).unwrap();
    for (of, ideal) in found.iter().zip(&ideal) {
        assert_eq!(of.counts.d_prime, ideal.counts.d_prime);
        assert!(of.counts.d_prime <= 0.0 || of.counts.correct_percent < ideal.counts.correct_percent);
    }
}

/// A phase of half a cycle moves the spikes but hardly changes the counts: times reveal it, counts hardly do.
#[test]
fn times_tell_what_counts_do_not() {
    let at = |name, phase| {
        let drive =
            Drive { motor: 9, frequency_hz: 25.0, amplitude_um: 120.0, phase, start_s: None, stop_s: None };
        Pattern::new(Array::paper(), name, None, vec![drive], toml::Table::new()).unwrap()
    };
    let plan = Plan { seconds: 0.4, ..plan(SkinModel::AFFERENTS) };
    let found = discriminate([&at("a", 0.0), &at("b", 0.25)], &plan, &|_| ()).unwrap();
    let all = found.last().unwrap();
    assert!(all.times.d_prime > 1.5 * all.counts.d_prime.max(1.0), "{all:?}");
}

#[test]
fn a_set_is_named_by_counts_better_than_by_the_total() {
    let patterns = [pattern("a", &[5], 80.0), pattern("b", &[10], 80.0), pattern("c", &[18], 80.0)];
    let plan = Plan { efficiency: 0.005, ..plan(SkinModel::AFFERENTS) };
    let found = confusion(&patterns.each_ref(), &plan, &|_| ()).unwrap();
    assert!((0..3).all(|at| found.percent[at][at] > 80.0 && found.d_prime[at][at] == 0.0), "{found:?}");
    assert!(found.correct_percent > found.chance_percent && found.correct_percent_se.is_some(), "{found:?}");
    assert!(found.total_correct_percent < found.correct_percent - 10.0, "{found:?}");
}

#[test]
fn a_plan_out_of_range_is_refused_in_one_line() {
    let good = plan(SkinModel::AFFERENTS);
    assert!(good.check(2).is_ok() && good.bins() == 40);
    for bad in [
        Plan { trials: 7, ..good.clone() },
        Plan { trials: 1001, ..good.clone() },
        Plan { fingers: vec![], ..good.clone() },
        Plan { seconds: 0.0, ..good.clone() },
        Plan { resolution_ms: 0.0, ..good.clone() },
        Plan { resolution_ms: 0.1, seconds: 1.0, ..good.clone() },
        Plan { resolution_ms: 1e-300, ..good.clone() },
        Plan {
            trials: 1000,
            seconds: 20.0,
            resolution_ms: 1000.0,
            fingers: (0..3).collect(),
            ..good.clone()
        },
        Plan { efficiency: 0.0, ..good.clone() },
        Plan { efficiency: f64::NAN, ..good },
    ] {
        let line = bad.check(2).unwrap_err();
        assert!(line.contains("must be") && !line.contains('\n'), "{line}");
    }
}
