//! Tests that need private items of several modules: every vector width, samples of velocities, ramps, bounded memory.

mod silence;

use crate::engine::run;
use crate::membrane::{AfferentModel, Rectify, population};
use crate::track::{Track, Tracks, of_scene};
use crate::{Integrator, Method, Options, Ramps, Scene};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::motor::{HalfTick, Ramp, Shaft};
use meissner_array::pattern::Drive;
use meissner_array::random::uniform;
use meissner_array::spec::{Array, ArraySpec, names};
use pulp::Arch;
use std::sync::Arc;

/// The shipped arrays, and one whose every number is another.
pub(crate) fn arrays() -> Vec<Array> {
    let text = r#"
        name = "tests-of-skin"
        pins = { positions_mm = [[0, 0], [2.5, 1], [-3, 0.5], [1, -4], [-1.5, 3]], radius_mm = 0.7 }
        tick_hz = 44100
        duty = { up = 0.3, down = 0.7 }
        motor = { step_um = 0.41, window_ms = 11.7, travel_um = 300, most_pulses = 900 }
    "#;
    let other = Array::known(ArraySpec::parse(text, "test.toml").unwrap()).unwrap();
    let shipped = names().into_iter().map(|name| Array::named(name).unwrap());
    shipped.filter(|array| *array != other).chain([other]).collect()
}

/// Afferents of a fingertip over motors with random drives.
fn scene(array: Array, seed: u64) -> Scene {
    let draw = |n: u64, low: f64, high: f64| low + (high - low) * uniform([seed, n, 0, 1 << 33])[0];
    let motors = (0..array.motors() as u64).filter(|&motor| draw(motor, 0.0, 1.0) < 0.4);
    let drives = motors.map(|motor| Drive {
        motor: motor as u8,
        frequency_hz: draw(100 + motor, 1.0, 300.0),
        amplitude_um: draw(200 + motor, 5.0, 150.0),
        phase: draw(300 + motor, 0.0, 1.0),
        start_s: (motor % 3 == 0).then_some(0.1),
        stop_s: (motor % 4 == 0).then_some(0.9),
    });
    let rectify = [Rectify::Half, Rectify::Full, Rectify::Signed][seed as usize % 3];
    let mut model = AfferentModel::default_for(rectify, [0.0, 0.05][seed as usize % 2]);
    model.tau_s = draw(400, 0.01, 0.1);
    let afferents = population(seed).into_iter().step_by(7).collect();
    Scene::new(array, 1.3, seed, drives.collect(), afferents, model).unwrap()
}

/// The vector widths of this processor, without the scalar one.
pub(crate) fn widths() -> Vec<Arch> {
    #[cfg(target_arch = "x86_64")]
    let widths = [pulp::x86::V3::try_new().map(Arch::V3), pulp::x86::V4::try_new().map(Arch::V4)];
    #[cfg(not(target_arch = "x86_64"))]
    let widths = [Some(Arch::new())];
    widths.into_iter().flatten().collect()
}

/// Spike trains with the afferents' numbers, bit by bit.
fn bits(arch: Arch, scene: &Scene, tracks: &Tracks, method: Method) -> Vec<(u32, u64, Vec<u64>)> {
    let all: Vec<u32> = (0..scene.afferents().len() as u32).collect();
    let options = Options::spikes(method);
    let mut trains = Vec::new();
    run(arch, scene, tracks, &all, &options, &|_| (), &mut |(number, count, half_ticks)| {
        trains.push((number, count, half_ticks.into_iter().map(f64::to_bits).collect()));
    })
    .unwrap();
    trains.sort();
    trains
}

#[test]
fn every_width_of_vectors_gives_the_same_bits() {
    let [euler, propagator] = Integrator::ALL.map(|integrator| Method::stepped(330, integrator));
    let methods = [Method::Exact, euler, propagator];
    for seed in 0..12 {
        let array = Array::paper();
        let scene = scene(array, seed);
        for &method in &methods {
            same_at_every_width(&scene, &of_scene(&scene, method), method);
        }
        let (scene, tracks) = moved_unevenly(array, seed);
        same_at_every_width(&scene, &tracks, Method::Exact);
    }
    for array in arrays() {
        let scene = scene(array, 1);
        for &method in &methods {
            same_at_every_width(&scene, &of_scene(&scene, method), method);
        }
    }
}

fn same_at_every_width(scene: &Scene, tracks: &Tracks, method: Method) {
    let scalar = bits(Arch::Scalar, scene, tracks, method);
    assert!(scalar.iter().any(|(_, count, _)| *count > 0));
    for arch in widths() {
        let found = bits(arch, scene, tracks, method);
        assert!(found == scalar, "seed {}, {method:?}, {arch:?}", scene.seed());
    }
}

/// A scene with bursts of any length at any speed, often several within the window.
fn moved_unevenly(array: Array, seed: u64) -> (Scene, Tracks) {
    let mut drawn = 0;
    let mut draw = |low: f64, high: f64| {
        drawn += 1;
        low + (high - low) * uniform([seed, drawn, 0, 1 << 35])[0]
    };
    let (scene, mut ramps) = (scene(array, seed), Vec::new());
    for motor in array.numbers() {
        let mut start = draw(0.0, 10_000.0) as u64;
        while start < 100_000 {
            let ticks = draw(1.0, 600.0) as u32;
            let ramp =
                Ramp { start: Tick(start), ticks, um_per_tick: draw(-2.0, 2.0) * array.motor().um_per_pulse };
            ramps.push((motor, ramp));
            start = ramp.end().0 + draw(0.0, 700.0) as u64;
        }
    }
    let ramps = Ramps::new(array, ramps).unwrap();
    let gains = ramps.gains();
    let tracks = ramps.tracks(&gains, scene.duration_s());
    (scene.without_drives(gains), tracks)
}

#[test]
fn bursts_of_any_speed_leave_every_motor_at_exactly_rest() {
    for (array, seed) in arrays().into_iter().flat_map(|array| (0..6).map(move |seed| (array, seed))) {
        let window = array.motor().window_half_ticks as f64;
        for track in moved_unevenly(array, seed).1.iter().flatten() {
            let (mut at, mut d, mut slope, mut most) = (0.0, 0.0_f64, 0.0_f64, 0.0_f64);
            for found in track.breakpoints() {
                assert!(
                    found.at >= at && found.at.fract() == 0.0 && found.slope_change.abs() <= 1.0,
                    "{found:?}"
                );
                d += slope * (found.at - at);
                (at, slope) = (found.at, slope + found.slope_change);
                most = most.max(d.abs());
                assert_eq!((d * (1_u64 << 40) as f64).fract(), 0.0);
            }
            assert_eq!((d, slope), (0.0, 0.0));
            assert!(most > 100.0 && most <= window, "{most}");
        }
    }
}

/// Each motor's samples, read `at_a_time` at a time; none for a motor at rest.
fn samples(scene: &Scene, method: Method, steps: usize, at_a_time: usize) -> Vec<Vec<f64>> {
    let of_track = |track: &Option<Arc<Track>>| {
        let Some(track) = track else { return Vec::new() };
        let mut sampler = track.sampler().unwrap();
        let (mut all, mut samples) = (Vec::new(), Vec::<f64>::new());
        for first in (0..steps).step_by(at_a_time) {
            let count = at_a_time.min(steps - first);
            sampler.fill(first as u64, count, &mut samples);
            all.extend_from_slice(&samples[..count]);
        }
        all
    };
    of_scene(scene, method).iter().map(of_track).collect()
}

#[test]
fn samples_do_not_depend_on_how_many_are_read_at_a_time() {
    for seed in 1..5 {
        let integrator = [Integrator::Propagator, Integrator::Euler][seed as usize % 2];
        for step_us in [30, 500, 10_000, 176_471] {
            let (scene, method) = (scene(Array::paper(), seed), Method::stepped(step_us, integrator));
            let steps = (scene.duration_s() * 1e6 / f64::from(step_us)).ceil() as usize;
            let whole = samples(&scene, method, steps, steps);
            for at_a_time in [1, 8, 37, 256] {
                let found = samples(&scene, method, steps, at_a_time);
                assert!(found == whole, "{seed} {step_us} {at_a_time}");
            }
            // The kept samples are the same.
            for (track, expected) in of_scene(&scene, method).iter().zip(&whole) {
                let kept = track.as_ref().map_or(&[][..], |track| track.samples().unwrap());
                assert!(
                    kept[..expected.len()] == **expected && kept[expected.len()..].iter().all(|&d| d == 0.0)
                );
            }
        }
    }
}

#[test]
fn the_mean_velocity_times_the_step_is_the_shaft_s_motion() {
    for (array, seed) in arrays().into_iter().flat_map(|array| (0..6).map(move |seed| (array, seed))) {
        let (scene, ticks_per_s) = (scene(array, seed), f64::from(array.rate().hz()));
        // A whole number of half ticks.
        let step_us = if ticks_per_s == 85_000.0 { 500 } else { 10_000 };
        let step = (f64::from(step_us) * 1e-6 * 2.0 * ticks_per_s).round() as u64;
        let steps = 1_200_000 / step_us as usize;
        let found = samples(&scene, Method::stepped(step_us, Integrator::Propagator), steps, 100);
        let um_per_pulse = array.motor().um_per_pulse;
        let um = um_per_pulse / 2.0 / array.motor().window_half_ticks as f64 * step as f64;
        for drive in scene.drives() {
            let start = (drive.start() * ticks_per_s).round() as u64;
            let stop = drive.stop_s.map_or(u64::MAX, |stop| (stop * ticks_per_s).round() as u64);
            let end = scene.duration_s() * ticks_per_s;
            let strokes = drive
                .wave(array)
                .unwrap()
                .excursions()
                .take_while(|stroke| start + stroke.end() <= stop && ((start + stroke.up) as f64) < end);
            let mut ramps = strokes
                .flat_map(|stroke| {
                    [(stroke.up, Direction::Up), (stroke.down, Direction::Down)].map(|(tick, direction)| {
                        Ramp::new(Tick(start + tick), stroke.pulses, direction, um_per_pulse)
                    })
                })
                .peekable();
            let (mut shaft, mut before) = (Shaft::new(array.motor()), 0.0);
            for (index, &mean) in found[usize::from(drive.motor)].iter().enumerate() {
                let at = HalfTick((index as u64 + 1) * step);
                while let Some(ramp) = ramps.next_if(|ramp| HalfTick::from(ramp.start) <= at) {
                    shaft.push(ramp);
                }
                let y = shaft.displacement_um(at);
                assert!((mean * um - (y - before)).abs() < 1e-9, "{drive:?}, step {index}: {mean} {y}");
                before = y;
            }
        }
    }
}
