//! Strokes per second of the compiler on its hardest ordinary load: 24 motors × 60 Hz × 147 pulses.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use firmware_protocol::tick::Tick;
use meissner::pattern::{Drive, Pattern};
use meissner::strokes::Strokes;
use std::hint::black_box;

/// About a minute of play.
const STROKES: usize = 86_400;

fn strokes(criterion: &mut Criterion) {
    let drive = |motor| Drive {
        motor,
        frequency_hz: 60.0,
        amplitude_um: 20.0,
        phase: f64::from(motor) / 24.0,
        start_s: None,
        stop_s: None,
    };
    let pattern =
        Pattern::new("bench", None, (0..24).map(drive).collect(), toml::Table::new()).expect("in range");
    let mut strokes = Strokes::new(&pattern, None).expect("endless");
    let mut group = criterion.benchmark_group("strokes");
    group.throughput(Throughput::Elements(STROKES as u64));
    group.bench_function("24 motors, 60 Hz, 147 pulses", |bencher| {
        bencher.iter(|| {
            strokes.begin(Tick::BOOT);
            for stroke in strokes.by_ref().take(STROKES) {
                black_box(stroke.expect("within limits"));
            }
        });
    });
    group.finish();
}

criterion_group!(benches, strokes);
criterion_main!(benches);
