//! A plan that was played on a device, measured by its telemetry; and a calibration as the streamer takes it.
//!
//! Invariant: a block was measured to [`UNKNOWN`] or better, or is left out.

use super::{BurstTravel, Calibration, Fit, Plan};
use crate::Gains;
use crate::queues::MeasuredBurst;
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_array::units::UM_PER_PULSE;
use std::collections::HashMap;

/// A measurement that is known no better counts as none: a share of what an ideal motor would travel, and µm besides. Ten
/// times less than bursts scatter by, and than a slope is known to.
const UNKNOWN: (f64, f64) = (0.01, 0.02);
/// Gains are never taken to be known better: a motor warms up.
const LEAST_SD: f64 = 0.005;
/// Nor scatter to be less.
const LEAST_SCATTER: f64 = 0.002;

/// The blocks of a plan that was played from `onset` on, of the bursts that were measured; others may be among them.
#[must_use]
pub fn travels_by_telemetry(plan: &Plan, onset: Tick, travels: &[MeasuredBurst]) -> Vec<BurstTravel> {
    let (share, um) = UNKNOWN;
    let is_known = |travel: &&MeasuredBurst| {
        f64::from(travel.sd_um) <= share * f64::from(travel.pulses) * UM_PER_PULSE + um
    };
    let found = travels.iter().filter(is_known).map(|travel| ((travel.motor, travel.start), travel));
    let found: HashMap<(u8, Tick), &MeasuredBurst> = found.collect();
    let blocks = plan.bursts(onset).filter_map(|planned| {
        let travel = found.get(&(planned.motor, planned.burst.start))?;
        (travel.pulses == planned.burst.pulses).then(|| planned.block(0.0, travel.travel_um.into()))
    });
    blocks.collect()
}

impl Calibration {
    /// It as the streamer takes it: what was not calibrated is as any motor.
    #[must_use]
    pub fn gains(&self) -> [Gains; MOTORS] {
        std::array::from_fn(|motor| {
            self.motor(motor as u8).map_or_else(Gains::default, |fit| {
                let both = [Direction::Up, Direction::Down].map(|direction| fit.of(direction));
                let squares = both.map(|fit| fit.relative_sd * fit.relative_sd);
                Gains {
                    mean: both.map(Fit::gain),
                    sd: both.map(|fit| (fit.slope_se_um_per_pulse / UM_PER_PULSE).max(LEAST_SD)),
                    scatter: ((squares[0] + squares[1]) / 2.0).sqrt().max(LEAST_SCATTER),
                }
            })
        })
    }
}
