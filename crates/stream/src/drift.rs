//! Forecasts how far a play lets pins drift on a device without telemetry, by the estimate that ends plays there.
//!
//! [`forecast_drift`] gives the play's strokes to the position control as the streamer does, and asks it every [`EVERY_MS`] for the
//! estimate of the pins that the play drives. No link and no motors are simulated.
//!
//! Bound: [`MOST`] strokes and looks, and [`MAX_WORK`]; it says so if the play has more.

use crate::control::{Gains, PositionControl};
use crate::settings::Settings;
use firmware_protocol::tick::Tick;
use meissner_array::per_motor::PerMotor;
use meissner_array::strokes::{MAX_WORK, Strokes, StrokesError};

/// Time between two looks at the estimate, ms: less than a stroke at 60 Hz.
const EVERY_MS: u64 = 10;
/// Strokes are known so long before they begin, ms, as with the default lead.
const LEAD_MS: u64 = 100;
/// Strokes and looks, at most: more than an hour of 24 motors at 60 Hz, in seconds.
const MOST: u32 = 10_000_000;

/// What a play does to pins that are level at its onset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// The largest estimate of a pin that it drives, when it ends, is stopped or was followed no longer: root mean square, µm.
    pub um: f32,
    /// The motor of that pin.
    pub motor: u8,
    /// When the limit ends it, ticks from its onset.
    pub stopped_at: Option<u64>,
    /// Until when it was followed, ticks from its onset, if not to its end.
    pub followed_until: Option<u64>,
}

/// Follows a play from level pins to its end, or until the estimate exceeds [`Settings::drift_limit_um`]. With a lower stop nothing
/// drifts.
///
/// # Errors
/// If a stroke cannot be made.
pub fn forecast_drift(
    mut strokes: Strokes,
    settings: &Settings,
    gains: &PerMotor<Gains>,
) -> Result<Drift, StrokesError> {
    let rate = settings.array.rate();
    let mut control = PositionControl::new(settings);
    control.connected(false);
    control.set_gains(gains);
    control.assume_rest();
    let driven: Vec<u8> = strokes.motors().collect();
    let worst = |control: &PositionControl, now| {
        let of = driven.iter().map(|&motor| (control.dead_reckoning_um(now, [motor].into_iter()), motor));
        of.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0))
    };
    let none = Drift { um: 0.0, motor: 0, stopped_at: None, followed_until: None };
    if settings.lower_stop.is_some() {
        return Ok(none);
    }
    let (onset, every, lead) = (Tick(rate.per_s()), rate.of_ms(EVERY_MS), rate.of_ms(LEAD_MS));
    strokes.begin(onset);
    let until = onset + strokes.end().unwrap_or(u64::MAX / 2);
    let (mut now, mut left) = (onset, MOST);
    loop {
        let step = strokes.next().transpose()?;
        // All that begins earlier is known.
        let known = step.as_ref().map_or(until + 2 * lead, |step| step.begin());
        while now + lead <= known {
            left = left.saturating_sub(1);
            control.correct(now, |_| known, |_| true);
            let (um, motor) = worst(&control, now);
            if um > settings.drift_limit_um {
                return Ok(Drift { um, motor, stopped_at: Some(now - onset), ..none });
            }
            now = now + every;
            if control.is_idle() {
                // Nothing happens in a long pause.
                now = now.max(Tick(known.0.saturating_sub(rate.per_s())));
            }
        }
        left = left.saturating_sub(1);
        let is_too_long = left == 0 || strokes.work() >= MAX_WORK;
        let Some(step) = step.filter(|_| !is_too_long) else {
            let (um, motor) = worst(&control, now);
            return Ok(Drift { um, motor, followed_until: is_too_long.then(|| now - onset), ..none });
        };
        control.sent(&step, true, until);
        control.accepted(step.motor(), step.begin());
    }
}
