//! The compiler, alone and with the link's encoding, on an ordinary heavy load: 24 motors × 60 Hz × 147 pulses; the compiler alone
//! with 64 motors, too. `cargo bench -p meissner-benches --bench strokes`. Elements are bursts, two to a stroke.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::HostMessage;
use firmware_protocol::tick::Tick;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use std::hint::black_box;

/// About a minute of play.
const STROKES: usize = 86_400;

/// All motors of an array, with phases spread evenly.
fn all(array: Array) -> Strokes {
    let drive = |motor| Drive {
        motor,
        frequency_hz: 60.0,
        amplitude_um: 20.0,
        phase: f64::from(motor) / array.motors() as f64,
        start_s: None,
        stop_s: None,
    };
    let drives = array.numbers().map(drive).collect();
    let pattern = Pattern::new(array, "bench", None, drives, toml::Table::new()).expect("in range");
    Strokes::new(&pattern, &StrokeOptions::default()).expect("endless")
}

fn strokes(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("strokes");
    group.throughput(Throughput::Elements(2 * STROKES as u64));
    for (name, array) in [("compile", "tula35-6x4"), ("compile, 64 motors", "simulated-8x8")] {
        let mut strokes = all(Array::named(array).expect("it is shipped"));
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                strokes.begin(Tick::BOOT);
                for stroke in strokes.by_ref().take(STROKES) {
                    black_box(stroke.expect("within limits"));
                }
            });
        });
    }
    let mut strokes = all(Array::paper());
    group.bench_function("compile and encode", |bencher| {
        bencher.iter(|| {
            strokes.begin(Tick::BOOT);
            let (mut out, mut seq, mut bytes) = ([0; MAX_FRAME], 0u16, 0);
            let mut batch = Packer::<BATCH_BYTES>::new(Tick::BOOT);
            for step in strokes.by_ref().take(STROKES) {
                let step = step.expect("within limits");
                if step.pack(&mut batch).is_err() {
                    let (base, packed) = (batch.base().wire(), batch.bytes());
                    let frame = HostMessage::Moves {
                        epoch: 1,
                        seq,
                        seen: 0,
                        mark: None,
                        withdraw: None,
                        base,
                        batch: packed,
                    };
                    bytes += encode(&frame, &mut out).expect("it fits");
                    black_box(&out);
                    seq = seq.wrapping_add(1);
                    batch = Packer::new(step.begin());
                    step.pack(&mut batch).expect("it is empty");
                }
            }
            black_box(bytes)
        });
    });
    group.finish();
}

criterion_group!(benches, strokes);
criterion_main!(benches);
