//! The cost of a real touch on one core: the contact of a bar, a sphere and a plate, the response of a finger's 566 afferents to a
//! second of a bar that is pressed and of one that moves, the rendering of both, and heights for one pose of a live play.

use criterion::{Criterion, criterion_group, criterion_main};
use meissner_array::spec::Array;
use meissner_render::{Method, Poses, render};
use meissner_skin::afferents::population;
use meissner_touch::{
    Contact, HeightMap, Object, Pose, Press, Scan, Surface, Touch, displacements_mm, respond,
};
use rayon::ThreadPoolBuilder;
use std::hint::black_box;

fn rectangle(length_mm: f64, width_mm: f64) -> Surface {
    let (x, y) = (length_mm / 2.0, width_mm / 2.0);
    Surface::Polygons(vec![vec![[-x, -y], [x, -y], [x, y], [-x, y]]])
}

/// A sphere of 8 mm radius, in pixels of 0.1 mm.
fn sphere() -> Surface {
    let height_mm = |pixel: usize| {
        let [x, y] = [pixel % 60, pixel / 60].map(|index| 0.1 * index as f32 - 2.95);
        -(x * x + y * y) / 16.0
    };
    Surface::Map(HeightMap::new([60; 2], [0.1; 2], (0..3600).map(height_mm).collect()).expect("heights"))
}

fn pressed(surface: Surface) -> Object {
    let press = Press { depth_mm: 0.5, rise_s: 0.05, hold_s: 0.9, fall_s: 0.05 };
    Object::new("pressed", surface, Touch::press(Pose::default(), press).expect("a press"))
}

fn moving(surface: Surface) -> Object {
    let scan = Scan { depth_mm: 0.5, rise_s: 0.05, speed_mm_s: 20.0, direction_deg: 90.0, duration_s: 0.95 };
    Object::new("moving", surface, Touch::scan(Pose::default(), scan).expect("a scan"))
}

fn contact(object: &Object, pitch_mm: f64) -> Contact {
    Contact::new(object.grains(pitch_mm), object.touch().most_depth_mm()).expect("a small contact")
}

fn touch(criterion: &mut Criterion) {
    let pool = ThreadPoolBuilder::new().num_threads(1).build().expect("threads can be started");
    let afferents = population(0);
    for (name, object, pitch_mm) in [
        ("bar", pressed(rectangle(12.0, 0.8)), 0.2),
        ("sphere", pressed(sphere()), 0.2),
        ("plate", pressed(rectangle(60.0, 60.0)), 0.4),
    ] {
        criterion.bench_function(&format!("contact_{name}"), |bencher| {
            bencher.iter(|| pool.install(|| contact(black_box(&object), pitch_mm)));
        });
    }
    let places: Vec<[f64; 2]> =
        (0..425_u16).map(|n| [f64::from(n % 17) * 0.725 - 5.8, f64::from(n / 17) * 0.725 - 8.7]).collect();
    let times_s: Vec<f64> = (0..1000_u16).map(|n| f64::from(n) / 1000.0).collect();
    for (name, object) in [
        ("pressed_bar", pressed(rectangle(12.0, 0.8))),
        ("pressed_sphere", pressed(sphere())),
        ("moving_bar", moving(rectangle(12.0, 0.8))),
        ("moving_sphere", moving(sphere())),
    ] {
        let contact = contact(&object, 0.2);
        criterion.bench_function(&format!("respond_{name}"), |bencher| {
            bencher.iter(|| {
                pool.install(|| respond(black_box(&contact), object.touch(), &afferents, Some(0), &|_| ()))
            });
        });
        criterion.bench_function(&format!("displacements_{name}"), |bencher| {
            bencher.iter(|| {
                pool.install(|| displacements_mm(black_box(&contact), object.touch(), &places, &times_s))
            });
        });
    }
}

/// A second of a pressed bar, 0.55 s of one that moves by 20 mm, and one pose of live objects.
fn rendering(criterion: &mut Criterion) {
    let pool = ThreadPoolBuilder::new().num_threads(1).build().expect("threads can be started");
    let array = Array::paper();
    let scan = Scan { depth_mm: 0.5, rise_s: 0.05, speed_mm_s: 40.0, direction_deg: 90.0, duration_s: 0.5 };
    let scan = Touch::scan(Pose::default(), scan).expect("a scan");
    let bar = || rectangle(12.0, 0.8);
    for (name, object) in [("pressed", pressed(bar())), ("moving", Object::new("moving", bar(), scan))] {
        let contact = contact(&object, 0.2);
        criterion.bench_function(&format!("render_{name}_bar"), |bencher| {
            bencher
                .iter(|| pool.install(|| render(array, black_box(&contact), object.touch(), Method::Auto)));
        });
    }
    for (name, surface) in [("bar", bar()), ("sphere", sphere()), ("plate", rectangle(60.0, 60.0))] {
        let object = Object::new(name, surface, Touch::default());
        criterion.bench_function(&format!("poses_new_{name}"), |bencher| {
            bencher.iter(|| pool.install(|| Poses::new(array, black_box(&object))));
        });
        let poses = Poses::new(array, &object).expect("a small object");
        let mut angle_deg = 0.0;
        criterion.bench_function(&format!("pose_{name}"), |bencher| {
            bencher.iter(|| {
                angle_deg += 1.0;
                poses.heights_mm(black_box(&Pose { x_mm: 0.7, y_mm: 0.4, angle_deg, depth_mm: 0.5 }))
            });
        });
    }
}

criterion_group!(name = benches; config = Criterion::default().sample_size(10); targets = touch, rendering);
criterion_main!(benches);
