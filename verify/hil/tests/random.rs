//! Random patterns: 24 motors, each with its own frequency, amplitude and phase.

use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

pub(crate) fn uniform(random: &mut ChaCha8Rng, from: f64, to: f64) -> f64 {
    from + (to - from) * f64::from(random.next_u32()) / 2f64.powi(32)
}

/// Pattern `number`: 20 to 300 Hz. Of four patterns one reverses as often as it can, and one does so with all motors in
/// phase.
pub(crate) fn pattern(number: u64) -> Pattern {
    let mut random = ChaCha8Rng::seed_from_u64(number);
    let least = if number.is_multiple_of(4) { 280.0 } else { 20.0 };
    let in_phase = number % 4 == 1;
    let drive = |motor| {
        let frequency_hz = if in_phase { 300.0 } else { uniform(&mut random, least, 300.0) };
        // What the motor reaches at this frequency, at most.
        let most = (11.6 * 500.0 / frequency_hz).min(400.0);
        Drive {
            motor,
            frequency_hz,
            amplitude_um: uniform(&mut random, 1.0, most),
            phase: if in_phase { 0.0 } else { uniform(&mut random, 0.0, 0.999) },
            start_s: None,
            stop_s: None,
        }
    };
    let drives = (0..24).map(drive).collect();
    Pattern::new(Array::paper(), &format!("random-{number}"), None, drives, Default::default()).unwrap()
}

/// Three motors of each rail in phase, the others a quarter of a period later: each burst begins when those of the others have ended.
pub(crate) fn taking_turns(number: u64) -> Pattern {
    let mut random = ChaCha8Rng::seed_from_u64(number);
    let (frequency_hz, phase) = (uniform(&mut random, 280.0, 300.0), uniform(&mut random, 0.0, 0.7));
    let drive = |motor| Drive {
        motor,
        frequency_hz,
        amplitude_um: uniform(&mut random, 2.0, 9.0),
        phase: if motor % 6 < 3 { phase } else { phase + 0.25 },
        start_s: None,
        stop_s: None,
    };
    let drives = (0..24).map(drive).collect();
    Pattern::new(Array::paper(), &format!("turns-{number}"), None, drives, Default::default()).unwrap()
}
