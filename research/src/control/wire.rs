//! Bytes of corrections on the line, and the rest error that they save.

use crate::sixty_hertz;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_stream::{Settings, simulate_play};
use serde::Serialize;

/// Duration of a play, s.
const WIRE_S: f64 = 10.0;

/// Bytes to the device for all motors at 60 Hz and 80 µm, through link and controller in virtual time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Wire {
    /// Duration of the plays, s.
    pub seconds: f64,
    /// With position control.
    pub on: WireRow,
    /// In open loop.
    pub off: WireRow,
}

/// The bytes and the rest error of a play.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WireRow {
    /// Bytes to the device per planned burst.
    pub bytes_per_burst: f64,
    /// Bytes to the device per second.
    pub bytes_per_s: f64,
    /// Planned bursts.
    pub bursts: u64,
    /// Bursts whose count was corrected.
    pub amended: u64,
    /// Rest error of all motors, RMS, including the first second.
    pub rest_rms_um: f64,
}

impl Wire {
    /// Simulates both plays.
    pub(super) fn measure() -> Self {
        let (on, off) = rayon::join(|| WireRow::of(false), || WireRow::of(true));
        Self { seconds: WIRE_S, on, off }
    }
}

impl WireRow {
    fn of(open_loop: bool) -> Self {
        let (pattern, motors) = (sixty_hertz::pattern(), SimulatedMotorsConfig::default());
        let played = simulate_play(&pattern, Some(WIRE_S), &motors, Settings::of(pattern.array()), open_loop)
            .expect("the play has an end, and the default configuration is valid");
        let (bursts, bytes) = (played.outcome.bursts, played.outcome.wire_bytes as f64);
        Self {
            bytes_per_burst: bytes / bursts.planned.max(1) as f64,
            bytes_per_s: bytes / WIRE_S,
            bursts: bursts.planned,
            amended: bursts.amended,
            rest_rms_um: played.rest.rms_um(),
        }
    }
}
