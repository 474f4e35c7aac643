//! How a shaft follows its commanded position: the seam for other motors.
//!
//! Every response is linear and does not change with time, so the displacement is the sum of what each ramp contributes. A response
//! says what a ramp of speed 1 has contributed some time after its start, and after how long it has arrived. Whatever asks a
//! [`Shaft`](super::Shaft) for samples works with every response. The exact method of the skin models asks for a velocity that is
//! linear between known instants, which only [`Response::Average`] has.
//!
//! Invariant: the contribution of a ramp ends as its travel; before its start it is 0.

/// See the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Response {
    /// The moving average over a window: the model of the paper. The velocity is piecewise linear.
    Average,
    /// A second-order lag, as of a mass on a damped spring: y'' = ω² (r - y) - 2 ζ ω y'.
    Lag {
        /// The undamped natural frequency ω, radians per half tick.
        omega: f64,
        /// The damping ratio ζ.
        damping: f64,
    },
}

/// The share of a step that is left when a lag counts as over.
const LEFT: f64 = 1e-6;

impl Response {
    /// A lag in half ticks of this length.
    #[must_use]
    pub fn lag(natural_hz: f64, damping: f64, half_ticks_per_s: f64) -> Self {
        Self::Lag { omega: std::f64::consts::TAU * natural_hz / half_ticks_per_s, damping }
    }

    /// Half ticks after which a step has arrived but for a millionth; `window` for the average over it.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the cast saturates")]
    pub fn settled_half_ticks(self, window: u64) -> u64 {
        match self {
            Self::Average => window,
            Self::Lag { omega, damping } => {
                // The slower of the two exponentials; near critical damping the step also has a term that grows with time.
                let slow = damping - (damping * damping - 1.0).max(0.0).sqrt();
                let times = -LEFT.ln() / (omega * slow.min(1.0));
                (1.5 * times).ceil() as u64
            }
        }
    }

    /// The integral of the displacement's answer to a step: what a ramp of speed 1 that goes on has contributed `after` half ticks
    /// after its start, half ticks.
    pub(super) fn of_ramp(omega: f64, damping: f64, after: f64) -> f64 {
        if after <= 0.0 {
            return 0.0;
        }
        let (t, z) = (omega * after, damping);
        // y = t - 2ζ + e^(-ζt) (2ζ c + (2ζ² - 1) s), with c and s the cosine and sine of the damped frequency over it, or their
        // hyperbolic or linear counterparts.
        let square = 1.0 - z * z;
        let (c, s) = if square > 1e-9 {
            let w = square.sqrt();
            ((w * t).cos(), (w * t).sin() / w)
        } else if square < -1e-9 {
            let w = (-square).sqrt();
            // e^(-ζt) cosh and sinh in one exponential each, which cannot overflow.
            let (up, down) = ((-(z - w) * t).exp(), (-(z + w) * t).exp());
            let (c, s) = (f64::midpoint(up, down), (up - down) / (2.0 * w));
            return (t - 2.0 * z + 2.0 * z * c + (2.0 * z * z - 1.0) * s) / omega;
        } else {
            (1.0, t)
        };
        (t - 2.0 * z + (-z * t).exp() * (2.0 * z * c + (2.0 * z * z - 1.0) * s)) / omega
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the equation itself, integrated in small steps.
    #[test]
    fn a_lag_follows_its_equation() {
        for damping in [0.2, 0.7, 1.0, 1.0 + 1e-10, 1.5, 5.0] {
            let omega = 0.01;
            let (mut y, mut v, dt) = (0.0, 0.0, 0.01);
            for step in 0..200_000_u32 {
                let t = f64::from(step) * dt;
                if step % 20_000 == 0 {
                    let found = Response::of_ramp(omega, damping, t);
                    assert!(
                        (found - y).abs() < 1e-3 * (1.0 + y.abs()),
                        "{damping} at {t}: {found} instead of {y}"
                    );
                }
                // Midpoint rule.
                let a = |t: f64, y: f64, v: f64| omega * omega * (t - y) - 2.0 * damping * omega * v;
                let (ym, vm) = (y + dt / 2.0 * v, v + dt / 2.0 * a(t, y, v));
                (y, v) = (y + dt * vm, v + dt * a(t + dt / 2.0, ym, vm));
            }
        }
    }

    #[test]
    fn a_step_has_arrived_when_it_counts_as_settled() {
        for (hz, damping) in [(20.0, 0.1), (100.0, 0.7), (100.0, 1.0), (100.0, 3.0)] {
            let lag = Response::lag(hz, damping, 170_000.0);
            let Response::Lag { omega, .. } = lag else { panic!() };
            let settled = lag.settled_half_ticks(0) as f64;
            // A step of 1 as a ramp of one half tick.
            let step = |after: f64| {
                Response::of_ramp(omega, damping, after) - Response::of_ramp(omega, damping, after - 1.0)
            };
            assert!((step(settled) - 1.0).abs() < 2.0 * LEFT, "{hz} Hz, {damping}: {}", step(settled));
        }
    }
}
