//! What a long play with motions takes before it begins: 24 pins for ten minutes at 1 kHz, 14.4 million samples. `cargo bench --bench motions`.
//! Elements are samples.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use meissner_array::pattern::{Form, Motion, Pattern, Wave};
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_stream::{Bandwidth, Settings, find_dense, find_longest_hold};
use std::hint::black_box;
use std::sync::Arc;

/// Samples of each pin.
const SAMPLES: u32 = 600_000;

fn motions(criterion: &mut Criterion) {
    let array = Array::paper();
    let um = |k: u32| 60.0 + 40.0 * (f64::from(k) * 0.09).sin() + 20.0 * (f64::from(k) * 0.31).sin();
    let um: Arc<[f32]> = (0..SAMPLES).map(|k| um(k) as f32).collect();
    let wave = |motor| Motion {
        motor,
        form: Form::Wave(Wave { start_s: 0.0, rate_hz: 1000.0, um: Arc::clone(&um), source: None }),
    };
    let pattern = || {
        let empty = Pattern::new(array, "bench", None, vec![], toml::Table::new()).expect("in range");
        empty.with_motions(array.numbers().map(wave).collect()).expect("in range")
    };
    let compiled = |pattern: &Pattern| Strokes::new(pattern, &StrokeOptions::default()).expect("in range");
    let mut group = criterion.benchmark_group("motions");
    group.sample_size(10).throughput(Throughput::Elements(u64::from(SAMPLES) * array.motors() as u64));
    group.bench_function("check", |bencher| bencher.iter(pattern));
    let pattern = pattern();
    let text = pattern.to_toml();
    group.bench_function("read", |bencher| {
        bencher.iter(|| Pattern::parse(&text, "bench").expect("it was written"));
    });
    group.bench_function("choose the grid", |bencher| bencher.iter(|| compiled(&pattern)));
    let strokes = compiled(&pattern);
    group.bench_function("measure the error", |bencher| bencher.iter(|| strokes.followed()));
    let settings = Settings::of(array);
    group.bench_function("bandwidth", |bencher| bencher.iter(|| Bandwidth::of(&strokes, &settings)));
    group.bench_function("density", |bencher| bencher.iter(|| black_box(find_dense(&strokes))));
    group.bench_function("holds", |bencher| bencher.iter(|| black_box(find_longest_hold(&strokes))));
    group.finish();
}

criterion_group!(benches, motions);
criterion_main!(benches);
