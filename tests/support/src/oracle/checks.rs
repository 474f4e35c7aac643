//! Checks the oracle against the reference spikes, against brute force, and against its own rules.

use super::{
    Array, Burst, Drive, FULL, Model, Rectify, Scene, Train, all_bursts, bursts, compare, pin_weight,
    random_scene, spikes, spikes_of_bursts,
};
use serde::Deserialize;

#[derive(Deserialize)]
struct Reference {
    duration_s: f64,
    drives: Vec<ReferenceDrive>,
    receptors: Vec<ReferencePosition>,
    receptor: ReferenceModel,
    spikes_s: Vec<Vec<f64>>,
    promised_spikes: Vec<i64>,
}

#[derive(Deserialize)]
struct ReferenceDrive {
    motor: usize,
    frequency_hz: f64,
    amplitude_um: f64,
    phase: f64,
}

#[derive(Deserialize)]
struct ReferencePosition {
    x_mm: f64,
    y_mm: f64,
}

#[derive(Deserialize)]
struct ReferenceModel {
    rectify: Rectify,
    alpha_per_um: f64,
    hyperexcitability_depth: f64,
}

fn usual_model(rectify: Rectify) -> Model {
    Model {
        rectify,
        alpha_per_um: rectify.usual_alpha_per_um(),
        tau_s: 0.044,
        refractory_s: 0.001,
        hyperexcitability_s: 0.044,
        hyperexcitability_depth: 0.3,
        sigma_mm: 1.1,
    }
}

fn times(trains: &[Train]) -> Vec<Vec<f64>> {
    trains.iter().map(|train| train.spikes.iter().map(|spike| spike.t_s).collect()).collect()
}

#[test]
fn the_oracle_has_the_reference_spikes() {
    let references: Vec<Reference> =
        serde_json::from_str(include_str!("../../../../crates/skin/tests/data/spikes.json")).unwrap();
    assert_eq!(references.len(), 18);
    let mut compared = 0;
    for (number, reference) in references.iter().enumerate() {
        let drive = |&ReferenceDrive { motor, frequency_hz, amplitude_um, phase }: &ReferenceDrive| Drive {
            motor,
            frequency_hz,
            amplitude_um,
            phase,
            start_s: 0.0,
            stop_s: None,
        };
        let scene = Scene {
            array: Array::paper(),
            duration_s: reference.duration_s,
            drives: reference.drives.iter().map(drive).collect(),
            afferents: reference.receptors.iter().map(|at| (at.x_mm, at.y_mm)).collect(),
            model: Model {
                alpha_per_um: reference.receptor.alpha_per_um,
                hyperexcitability_depth: reference.receptor.hyperexcitability_depth,
                ..usual_model(reference.receptor.rectify)
            },
            offsets: Vec::new(),
        };
        let trains = spikes(&scene);
        let promises = reference.spikes_s.iter().zip(&reference.promised_spikes);
        for ((found, expected), (listed, &promised)) in times(&trains).iter().zip(&trains).zip(promises) {
            let count = usize::try_from(promised).unwrap_or(listed.len());
            assert!(found.len() >= count, "scene {number}: {found:?} instead of {listed:?}");
            if count == listed.len() && promised >= 0 {
                assert_eq!(found.len(), count, "scene {number}: {expected:?} instead of {listed:?}");
            }
            for (found, listed) in found.iter().zip(&listed[..count]) {
                assert!((found - listed).abs() < 1e-9, "scene {number}: {found} instead of {listed}");
            }
        }
        // The oracle must have promised all of these.
        compared += compare(&trains, &reference.spikes_s, 1e-9).unwrap();
    }
    assert_eq!(compared, references.iter().flat_map(|r| &r.spikes_s).map(Vec::len).sum::<usize>());
}

/// The motors that the brute-force simulation moves.
const BRUTE: [usize; 2] = [9, 10];

/// Forward Euler in steps of 0.5 us; the shafts' commanded positions summed over all bursts, twice.
fn by_brute_force(scene: &Scene, bursts: &[(usize, Burst)]) -> Vec<Vec<f64>> {
    const STEP_S: f64 = 0.5e-6;
    let model = &scene.model;
    let commanded_um = |motor: usize, t: f64| -> f64 {
        let ramp = |(_, burst): &(usize, Burst)| {
            let until = t.clamp(burst.start as f64 / 170_000.0, burst.end as f64 / 170_000.0);
            let speed = burst.speed as f64 / FULL as f64;
            speed * (until - burst.start as f64 / 170_000.0) * 85_000.0 * 0.95 / 7.0
        };
        bursts.iter().filter(|burst| burst.0 == motor).map(ramp).sum()
    };
    let steps = (scene.duration_s / STEP_S) as usize;
    let velocities: Vec<Vec<f64>> = (0..steps)
        .map(|step| {
            let t = step as f64 * STEP_S;
            BRUTE.iter().map(|&m| (commanded_um(m, t) - commanded_um(m, t - 0.0043)) / 0.0043).collect()
        })
        .collect();
    let of_afferent = |(index, &position): (usize, &(f64, f64))| {
        let weights: Vec<_> = BRUTE
            .iter()
            .map(|&motor| pin_weight(position, scene.array.pins[motor], model.sigma_mm))
            .collect();
        let (mut p, mut spikes) = (0.0, Vec::<f64>::new());
        for (step, velocities) in velocities.iter().enumerate() {
            let t = step as f64 * STEP_S;
            let since = spikes.last().map_or(f64::INFINITY, |last| t - last);
            let mut threshold: f64 =
                1.0 + scene.offsets.get(index).map_or(0.0, |offsets| offsets[spikes.len()]);
            if since < model.hyperexcitability_s {
                threshold -= model.hyperexcitability_depth * (1.0 - since / model.hyperexcitability_s);
            }
            if since >= model.refractory_s - STEP_S / 2.0 && p >= threshold.max(0.05) {
                spikes.push(t);
                p = 0.0;
            }
            let u: f64 = weights.iter().zip(velocities).map(|(weight, velocity)| weight * velocity).sum();
            let g = match model.rectify {
                Rectify::Half => u.max(0.0),
                Rectify::Full => u.abs(),
                Rectify::Signed => u,
            };
            p += STEP_S * (model.alpha_per_um * g - p / model.tau_s);
        }
        spikes
    };
    scene.afferents.iter().enumerate().map(of_afferent).collect()
}

#[test]
fn the_oracle_has_the_spikes_of_brute_force() {
    let drive = |motor, frequency_hz, phase, start_s, stop_s| Drive {
        motor,
        frequency_hz,
        amplitude_um: 40.0,
        phase,
        start_s,
        stop_s,
    };
    for (rectify, hyperexcitability_s, offset) in [
        (Rectify::Half, 0.044, 0.0),
        (Rectify::Full, 0.01, -0.3),
        (Rectify::Signed, 0.0007, 0.2),
        (Rectify::Half, 0.02, -0.5),
    ] {
        let model = Model { hyperexcitability_s, hyperexcitability_depth: 0.6, ..usual_model(rectify) };
        let scene = Scene {
            array: Array::paper(),
            duration_s: 0.12,
            drives: vec![
                drive(9, 53.7, 0.21, 0.0, Some(0.071)),
                drive(9, 131.3, 0.0, 0.071, None),
                drive(10, 88.1, 0.7, 0.013, None),
            ],
            afferents: vec![(-1.2, 1.1), (0.3, 1.9)],
            model,
            offsets: vec![
                vec![offset; 200],
                Vec::from_iter((0..200).map(|n| offset * f64::from(n % 3) / 2.0)),
            ],
        };
        // As they should be, and each with a travel of its own.
        let (even, mut uneven) = (all_bursts(&scene), all_bursts(&scene));
        let gains = [1.0, 0.7, 1.4, 0.9, 1.1, 0.8, 1.2].into_iter().cycle();
        uneven.iter_mut().zip(gains).for_each(|((_, burst), gain)| {
            burst.speed = (burst.speed as f64 * gain) as i64;
        });
        let expected = [spikes(&scene), spikes_of_bursts(&scene, &uneven)].concat();
        let found = [by_brute_force(&scene, &even), by_brute_force(&scene, &uneven)].concat();
        for (Train { spikes: expected, .. }, found) in expected.iter().zip(found) {
            assert!(expected.len() > 5 && expected.len() == found.len(), "{expected:?}\n{found:?}");
            for (expected, found) in expected.iter().zip(found) {
                // At most a step late, and the effect of a membrane that is wrong by 2e-4.
                let allowed = 1e-6 + expected.error_s * 2e8;
                assert!(
                    (expected.t_s - found).abs() < allowed,
                    "{rectify:?}: {found} instead of {expected:?}"
                );
            }
        }
    }
}

#[test]
fn random_scenes_keep_the_oracle_s_own_rules() {
    let (mut count, mut compared, mut active, mut doubtful) = (0, 0, 0, 0);
    for seed in 0..50 {
        let scene = random_scene(seed);
        let trains = spikes(&scene);
        for train in &trains {
            for spike in &train.spikes {
                assert!((0.0..scene.duration_s).contains(&spike.t_s), "seed {seed}: {spike:?}");
                assert!(spike.margin >= 0.0 && spike.error_s >= 0.0, "seed {seed}: {spike:?}");
            }
            for pair in train.spikes.windows(2) {
                let apart = pair[1].t_s - pair[0].t_s;
                assert!(apart >= scene.model.refractory_s - 1e-15, "seed {seed}: {pair:?}");
            }
            active += usize::from(!train.spikes.is_empty());
            doubtful += usize::from(train.doubtful_from_s.is_finite());
            count += train.spikes.len();
        }
        compared += compare(&trains, &times(&trains), 1e-9).unwrap();
    }
    assert!(active > 50 && count > 1_000, "{active} active afferents, {count} spikes: too quiet a test");
    assert!(
        compared * 10 > count * 9,
        "{compared} of {count} spikes promised, {doubtful} trains are doubtful"
    );
}

#[test]
fn a_comparison_sees_a_spike_moved_lost_or_added() {
    let trains = spikes(&random_scene(2));
    let right = times(&trains);
    let afferent = (0..right.len()).max_by_key(|&r| right[r].len()).unwrap();
    assert!(right[afferent].len() > 2 && compare(&trains, &right, 1e-9).is_ok());
    let wrong = |change: fn(&mut Vec<f64>)| {
        let mut wrong = right.clone();
        change(&mut wrong[afferent]);
        compare(&trains, &wrong, 1e-9).unwrap_err()
    };
    wrong(|spikes| spikes[1] += 2e-9);
    wrong(|spikes| _ = spikes.remove(1));
    wrong(|spikes| _ = spikes.pop());
    wrong(|spikes| spikes.push(spikes.last().unwrap() + 1e-5));
    assert!(compare(&trains, &right[1..], 1e-9).is_err());
}

#[test]
fn a_graze_is_called_doubtful() {
    let mut scene = random_scene(6);
    let first = |offset: f64, scene: &mut Scene| {
        scene.offsets = vec![vec![offset; 2_000]];
        spikes(scene).remove(0)
    };
    // The offset of the threshold at which the first spike is gone for good, or later.
    let sure = first(0.0, &mut scene).spikes[0].t_s;
    let (mut spiking, mut silent) = (0.0, 100.0);
    while silent - spiking > 1e-12 {
        let middle = (spiking + silent) / 2.0;
        let early = first(middle, &mut scene).spikes.first().is_some_and(|spike| spike.t_s < sure + 0.05);
        (spiking, silent) = if early { (middle, silent) } else { (spiking, middle) };
    }
    for offset in [spiking, silent] {
        let train = first(offset, &mut scene);
        assert!(train.doubtful_from_s <= sure + 0.05, "{train:?}");
        assert!(compare(&[train], &[Vec::new()], 1e-9).is_ok());
    }
    let clear = first(spiking - 1e-3, &mut scene);
    assert!(clear.spikes[0].t_s < clear.doubtful_from_s, "{clear:?}");
    assert!(compare(&[clear], &[Vec::new()], 1e-9).is_err());
}

#[test]
fn a_drive_starts_after_its_start_and_ends_by_its_stop() {
    // 10 pulses, a period of 1000 ticks, up first at a quarter of it; it starts at tick 850.
    let drive = |frequency_hz, stop_tick: f64| Drive {
        motor: 0,
        frequency_hz,
        amplitude_um: 9.5 / 7.0,
        phase: 0.25,
        start_s: 0.01,
        stop_s: Some(stop_tick / 85_000.0),
    };
    let half_ticks = |drive: Drive| -> Vec<_> {
        bursts(&Array::paper(), &drive, 1.0)
            .iter()
            .map(|burst| (burst.start, burst.end, burst.speed / FULL))
            .collect()
    };
    let first = [(2200, 2220, 1), (3200, 3220, -1)];
    let second = [(4200, 4220, 1), (5200, 5220, -1)];
    assert_eq!(half_ticks(drive(85.0, 1609.0)), []);
    assert_eq!(half_ticks(drive(85.0, 2609.0)), first);
    assert_eq!(half_ticks(drive(85.0, 2610.0)), [first, second].concat());
    // 17 ticks a period: edges at ticks 4, 13 and 21 after the start; of 10 pulses 8 fit.
    assert_eq!(half_ticks(drive(5_000.0, 872.0)), [(1708, 1724, 1), (1726, 1742, -1)]);
}
