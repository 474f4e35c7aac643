//! The predicted response to an edge as played by simulated motors.
//!
//! The pattern is the shipped edge at 45 degrees, with the frequency and the amplitude of the cell.
//!
//! Invariant: the designed response is that of the drives without surplus, on ideal motors.

use crate::stop::edge::{EDGE, array};
use crate::stop::grid::StopCell;
use firmware_protocol::tick::Tick;
use meissner_array::motor::MotorError;
use meissner_array::motor::Ramp;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::simulated::{Pin, SimulatedMotorsConfig};
use meissner_array::strokes::{DriveStrokes, StrokeOptions};
use meissner_paper::{Play, PredictionError, Rates, YARDSTICK, predict_response};
use serde::Serialize;

/// Mean rate of the afferents on the edge minus that of the others, impulses/s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Contrasts {
    /// As designed: ideal motors, no surplus.
    pub designed: f64,
    /// As played above a lower stop with the cell's surplus.
    pub with_stop: f64,
    /// As played in open loop without stop and surplus.
    pub without_stop: f64,
}

/// Why a grid could not be measured.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StopError {
    /// A frequency or amplitude is out of range.
    #[error(transparent)]
    Motor(#[from] MotorError),
    /// An amplitude of less than half a pulse.
    #[error("amplitude {amplitude_um} um: moves no pin")]
    Still {
        /// The amplitude, µm.
        amplitude_um: f64,
    },
    /// A response could not be predicted.
    #[error(transparent)]
    Prediction(#[from] PredictionError),
}

/// The shipped edge with the frequency and amplitude of a cell.
pub(super) fn edge(cell: &StopCell) -> Pattern {
    let StopCell { frequency_hz, amplitude_um, .. } = *cell;
    let drive = |drive: &Drive| Drive { frequency_hz, amplitude_um, ..*drive };
    let drives = EDGE.drives().iter().map(drive).collect();
    Pattern::new(array(), YARDSTICK, None, drives, EDGE.provenance().clone())
        .expect("cells are within a pattern's range")
}

/// Designed and played contrast of a pattern on these motors.
pub(super) fn contrasts(
    pattern: &Pattern,
    options: &StrokeOptions,
    motors: &SimulatedMotorsConfig,
    seconds: f64,
) -> Result<[f64; 2], StopError> {
    contrasts_of(pattern, options, |motor| Pin::new(pattern.array(), motors, motor.into()), Tick(0), seconds)
}

/// The same for pins that may have played before; the pattern begins at `onset`.
pub(super) fn contrasts_of(
    pattern: &Pattern,
    options: &StrokeOptions,
    mut pin: impl FnMut(u8) -> Pin,
    onset: Tick,
    seconds: f64,
) -> Result<[f64; 2], StopError> {
    let array = pattern.array();
    let end = array.rate().seconds_to_ticks(seconds);
    let mut ramps = Vec::new();
    for drive in pattern.drives() {
        let mut pin = pin(drive.motor);
        let strokes = DriveStrokes::with(array, drive, options)?.take_while(|stroke| stroke.up < end);
        for burst in strokes.flat_map(|stroke| stroke.stroke(drive.motor, onset).bursts()) {
            let before = (pin.position_um(burst.start), pin.pushed_pulses());
            pin.play(burst);
            // Pulses against the stop move nothing.
            let moving = u64::from(burst.pulses) - (pin.pushed_pulses() - before.1);
            let travel_um = pin.position_um(burst.end()) - before.0;
            let moving = u32::try_from(moving).expect("at most the pulses of a burst").max(1);
            ramps.push((drive.motor, Ramp::travelled(burst.start, moving, travel_um)));
        }
    }
    let designed = StrokeOptions::lasting(seconds);
    let play = Play { pattern, options: designed, onset, observed_s: seconds };
    let response = predict_response(&play, ramps)?;
    let contrast = |rates: Rates| rates.contrast.unwrap_or_default();
    Ok([contrast(response.designed_hz), contrast(response.played_hz)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stop::grid::StopSurplus;

    #[test]
    fn ideal_motors_give_the_designed_response_with_and_without_a_stop() {
        let cell = StopCell {
            frequency_hz: 60.0,
            amplitude_um: 40.0,
            scatter: 0.0,
            asymmetry_sd: 0.0,
            surplus: StopSurplus::Um(0.0),
        };
        let ideal = SimulatedMotorsConfig { telemetry_hz: 0, ..SimulatedMotorsConfig::ideal() };
        let [designed, played] = contrasts(&edge(&cell), &cell.options(1.0), &ideal, 0.5).unwrap();
        assert!(designed > 50.0 && designed == played, "{designed} {played}");
        // The stop absorbs the whole surplus of an ideal motor, so only the pulse that meets the stop changes.
        let stop =
            SimulatedMotorsConfig { lower_stop: meissner_array::simulated::LowerStop::AtRest, ..ideal };
        let surplus = StopCell { surplus: StopSurplus::Um(10.0), ..cell };
        let [_, with_stop] = contrasts(&edge(&cell), &surplus.options(1.0), &stop, 0.5).unwrap();
        assert!((with_stop - designed).abs() < 0.02 * designed, "{with_stop} {designed}");
        // Without a stop the same surplus moves the pins down with every stroke.
        let [_, sunk] = contrasts(&edge(&cell), &surplus.options(1.0), &ideal, 0.5).unwrap();
        assert!(sunk.is_finite());
    }
}
