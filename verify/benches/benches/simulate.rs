//! The cost of simulating a second: 24 motors at 60 Hz and 80 um with random phases, 306 receptors, noise; and the same of 64 motors.
//!
//! It measures the exact and the stepped method, on one core and on two, and evaluations of the scene with one motor changed.
//! Before criterion's figures it prints the number of spikes, and the effect of a search's coarser reach on the rates.

use criterion::{Criterion, criterion_group, criterion_main};
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::afferents;
use meissner_skin::{
    AnyScene, Evaluator, Integrator, Keep, Method, ModelName, Options, SEARCH_MIN_WEIGHT, Scene, simulate,
};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::hint::black_box;
use std::time::Duration;

const SIXTY_HERTZ: &str = include_str!("../../../library/scenes/sixty-hertz.toml");

fn scene() -> Scene {
    Scene::read(SIXTY_HERTZ, "sixty-hertz.toml").expect("it is shipped")
}

fn threads(count: usize) -> ThreadPool {
    ThreadPoolBuilder::new().num_threads(count).build().expect("threads can be started")
}

fn whole(criterion: &mut Criterion) {
    let scene = scene();
    let methods = [
        ("exact", Method::Exact),
        ("propagator_200us", Method::stepped(200, Integrator::Propagator)),
        ("euler_200us", Method::stepped(200, Integrator::Euler)),
    ];
    let mut group = criterion.benchmark_group("second");
    group.measurement_time(Duration::from_secs(5));
    for (name, method) in methods {
        let spikes = simulate(&scene, &Options::spikes(method), &|_| ()).expect("the scene can be simulated");
        println!("{name}: {} spikes, skipped {:?}", spikes.counts.iter().sum::<u64>(), spikes.skipped);
        for cores in [1, 2] {
            let pool = threads(cores);
            group.bench_function(format!("{name}/{cores}_core"), |bencher| {
                pool.install(|| {
                    bencher.iter(|| simulate(black_box(&scene), &Options::spikes(method), &|_| ()));
                });
            });
        }
    }
    group.finish();
}

/// The exact method on the standard second, but with all pins of the array with 64.
fn sixty_four(criterion: &mut Criterion) {
    let array = Array::named("simulated-8x8").expect("it is shipped");
    let standard = scene();
    // The golden ratio spreads the phases evenly.
    let phase = |motor: u8| (f64::from(motor) * 0.618_034).fract();
    let drive = |motor| Drive { motor, phase: phase(motor), ..standard.drives()[0] };
    let (drives, receptors) = (array.numbers().map(drive).collect(), standard.afferents().to_vec());
    let scene = Scene::new(array, 1.0, 0, drives, receptors, *standard.model()).expect("it is one");
    let mut group = criterion.benchmark_group("second_of_64_motors");
    group.measurement_time(Duration::from_secs(5));
    let pool = threads(1);
    group.bench_function("exact/1_core", |bencher| {
        pool.install(|| {
            bencher.iter(|| simulate(black_box(&scene), &Options::spikes(Method::Exact), &|_| ()));
        });
    });
    group.finish();
}

/// The second model on the standard second: 306 RA, 200 SA1 and 60 PC afferents with noise under 24 pins.
fn afferents(criterion: &mut Criterion) {
    let read = |text: &str, name: &str| match AnyScene::read(text, name, Some(ModelName::Afferents)) {
        Ok(AnyScene::Afferents(scene)) => scene,
        other => panic!("it is a scene of both models: {other:?}"),
    };
    let scene = read(SIXTY_HERTZ, "sixty-hertz.toml");
    let silent = read("duration_s = 1\npopulation = {}\nnoise = false", "silent.toml");
    let answer = afferents::simulate(&scene, Keep::Spikes, &|_| ()).expect("the scene can be simulated");
    let mean = |class| answer.mean_hz(&scene, class).unwrap_or(0.0);
    let [sa1, ra, pc] = afferents::Class::ALL.map(mean);
    println!(
        "afferents: {} spikes, SA1 {sa1:.1}, RA {ra:.1}, PC {pc:.1} impulses/s",
        answer.counts.iter().sum::<u64>()
    );
    let mut group = criterion.benchmark_group("afferents");
    group.measurement_time(Duration::from_secs(5));
    for cores in [1, 2] {
        let pool = threads(cores);
        for (name, scene) in [("second", &scene), ("at_rest", &silent)] {
            group.bench_function(format!("{name}/{cores}_core"), |bencher| {
                pool.install(|| {
                    bencher.iter(|| afferents::simulate(black_box(scene), Keep::Spikes, &|_| ()));
                });
            });
        }
    }
    group.finish();
}

/// The scene's drives, with one motor a little faster.
fn faster(scene: &Scene, motor: u8) -> Vec<Drive> {
    let drive = |drive: &Drive| match drive.motor == motor {
        true => Drive { frequency_hz: 63.0, ..*drive },
        false => *drive,
    };
    scene.drives().iter().map(drive).collect()
}

/// Changes the frequency of one motor after the other: the mean time over all.
fn changed(criterion: &mut Criterion) {
    let scene = scene();
    let search = Options { min_weight: SEARCH_MIN_WEIGHT, ..Options::rates(Method::Exact) };
    let rates =
        |options| simulate(&scene, &options, &|_| ()).expect("the scene can be simulated").rates_hz(&scene);
    let (all, near) = (rates(Options::rates(Method::Exact)), rates(search));
    let squares: f64 = all.iter().zip(&near).map(|(all, near)| (all - near).powi(2)).sum();
    println!("a search's reach moves rates by {:.2} impulses/s RMS", (squares / all.len() as f64).sqrt());
    let mut group = criterion.benchmark_group("changed");
    group.measurement_time(Duration::from_secs(5));
    let pool = threads(1);
    for (name, options) in [
        ("exact", Options::rates(Method::Exact)),
        ("exact_searching", search),
        (
            "stepped_500us_searching",
            Options {
                min_weight: SEARCH_MIN_WEIGHT,
                ..Options::rates(Method::stepped(500, Integrator::Propagator))
            },
        ),
    ] {
        group.bench_function(format!("{name}/whole"), |bencher| {
            pool.install(|| bencher.iter(|| simulate(black_box(&scene), &options, &|_| ())));
        });
        let evaluator = Evaluator::new(scene.clone(), options).expect("the scene can be simulated");
        let trials: Vec<Vec<Drive>> = scene.array().numbers().map(|motor| faster(&scene, motor)).collect();
        let mut motors = (0..trials.len()).cycle();
        group.bench_function(format!("{name}/one_motor"), |bencher| {
            pool.install(|| {
                bencher.iter(|| {
                    let motor = motors.next().expect("they never end");
                    evaluator.evaluate(black_box(&trials[motor])).expect("the drives are a scene's")
                });
            });
        });
    }
    group.finish();
}

criterion_group!(benches, whole, sixty_four, afferents, changed);
criterion_main!(benches);
