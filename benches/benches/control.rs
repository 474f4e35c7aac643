//! The cost of position control: `cargo bench --bench control`. Times are for a millisecond of device time of 24 motors at 80 µm,
//! with telemetry every millisecond.
//!
//! `loop and pins` is [`MotorRun`], with the simulated pins it measures; `pins` is the same pins, bursts and samples alone.
//! The loop is the difference.

use criterion::{Criterion, criterion_group, criterion_main};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::motor::SquareWave;
use meissner_array::simulated::{Pin, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_array::strokes::Burst;
use meissner_stream::MotorRun;
use meissner_test_support::paper::{MOTORS, TICKS_PER_MS};
use std::hint::black_box;
use std::time::Instant;

const MILLISECONDS: u32 = 1000;
const SAMPLE: u64 = TICKS_PER_MS;

/// All motors with their loops, one after the other.
fn loops(frequency_hz: f64) {
    for seed in 0..MOTORS as u64 {
        let motor_run = MotorRun { frequency_hz, seed, ..MotorRun::of(Array::paper()) };
        let fault = motor_run.run(
            f64::from(MILLISECONDS) / 1000.0,
            |_, y| Some(y),
            |period| {
                black_box(period);
            },
        );
        assert_eq!(fault, Ok(None));
    }
}

/// All motors, as planned.
fn pins(frequency_hz: f64) {
    let (array, config) = (Array::paper(), SimulatedMotorsConfig::default());
    let amplitude_um = MotorRun::of(array).amplitude_um;
    let wave = SquareWave::new(array, frequency_hz, amplitude_um, 0.0).expect("in range");
    for seed in 0..MOTORS as u64 {
        let mut pin = Pin::new(array, &SimulatedMotorsConfig { seed, ..config }, 0);
        let mut bursts = wave.excursions().flat_map(|excursion| {
            let pulses = excursion.pulses as u16;
            let burst = |start, direction| Burst { start: Tick::BOOT + start, direction, pulses };
            [burst(excursion.up, Direction::Up), burst(excursion.down, Direction::Down)]
        });
        let mut next = bursts.next();
        for sample in (0..u64::from(MILLISECONDS)).map(|number| Tick::BOOT + number * SAMPLE) {
            while let Some(burst) = next.filter(|burst| burst.start <= sample) {
                pin.play(burst);
                black_box(pin.position_um(burst.end()));
                next = bursts.next();
            }
            black_box(pin.quanta(sample));
        }
    }
}

fn control(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("control, 24 motors, per ms");
    for frequency_hz in [60.0, 300.0] {
        for (name, work) in [("loop and pins", loops as fn(f64)), ("pins", pins)] {
            group.bench_function(format!("{name}, {frequency_hz} Hz"), |bencher| {
                bencher.iter_custom(|times| {
                    let begun = Instant::now();
                    (0..times).for_each(|_| work(black_box(frequency_hz)));
                    begun.elapsed() / MILLISECONDS
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, control);
criterion_main!(benches);
