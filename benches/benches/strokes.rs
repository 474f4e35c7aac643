//! The compiler, alone and with the link's encoding, on an ordinary heavy load: 24 motors × 60 Hz × 147 pulses.
//! `cargo bench --bench strokes`. Elements are bursts, two to a stroke.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::HostMessage;
use firmware_protocol::tick::Tick;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::strokes::{StrokeOptions, Strokes};
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
    let mut strokes = Strokes::new(&pattern, &StrokeOptions::default()).expect("endless");
    let mut group = criterion.benchmark_group("strokes");
    group.throughput(Throughput::Elements(2 * STROKES as u64));
    group.bench_function("compile", |bencher| {
        bencher.iter(|| {
            strokes.begin(Tick::BOOT);
            for stroke in strokes.by_ref().take(STROKES) {
                black_box(stroke.expect("within limits"));
            }
        });
    });
    group.bench_function("compile and encode", |bencher| {
        bencher.iter(|| {
            strokes.begin(Tick::BOOT);
            let (mut out, mut seq, mut bytes) = ([0; MAX_FRAME], 0u16, 0);
            let mut batch = Packer::<BATCH_BYTES>::new(Tick::BOOT);
            for stroke in strokes.by_ref().take(STROKES) {
                let stroke = stroke.expect("within limits");
                if batch.stroke(&stroke).is_err() {
                    let (base, packed) = (batch.base().wire(), batch.bytes());
                    let frame = HostMessage::Strokes {
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
                    batch = Packer::new(stroke.up);
                    batch.stroke(&stroke).expect("it is empty");
                }
            }
            black_box(bytes)
        });
    });
    group.finish();
}

criterion_group!(benches, strokes);
criterion_main!(benches);
