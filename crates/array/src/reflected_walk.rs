//! The theory of a pin above a lower stop: the rest error as a reflected random walk.
//!
//! Every down burst is longer than its up burst by a surplus S; the stop absorbs the excess. The rest error after stroke n is
//! `E(n) = max(0, E(n-1) + X(n))` (Lindley's recursion), and X is the travel of the up burst minus that of the down burst. Both
//! bursts scatter, independently: with amplitude A, scatter s and asymmetry a (gain up minus gain down),
//!
//! ```text
//! mean(X) = A (1 + a/2) - (A + S) (1 - a/2)
//! var(X)  = s² [A² (1 + a/2)² + (A + S)² (1 - a/2)²]
//! ```
//!
//! In a motion there are many bursts from one rest to the next ([`Bursts`]). A is then the travel up of all of them, because the asymmetry is
//! that of each; and A² and (A + S)² are the sums of their squares, because each scatters on its own.
//!
//! For Gaussian X with a negative mean, Spitzer's identity gives the stationary distribution: its k-th cumulant is the sum
//! over n of `mean(max(0, X(1) + … + X(n))^k) / n`. Only δ = -mean(X) / sd(X) matters, in units of sd(X). For δ below
//! `SERIES_BELOW` the sums are the power series of Janssen & van Leeuwaarden, "On Lerch's transcendent and the Gaussian
//! random walk", Ann. Appl. Probab. 17 (2007), theorems 2 and 3; above it they have few terms.
//!
//! The theory ignores that gains are never below 0, that a burst after rest falls short, and that pulses are whole.
//!
//! Invariant: the rest error is 0 or above; it has no stationary distribution where the mean step is 0 or above.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// δ below which the power series are used. Their first term left out is below 1e-7 there.
const SERIES_BELOW: f64 = 0.7;
/// ζ(1/2), ζ(-1/2), …, ζ(-11/2).
const ZETA: [f64; 7] = [
    -1.460_354_508_809_586_2,
    -0.207_886_224_977_354_57,
    -0.025_485_201_889_833_036,
    0.008_516_928_777_850_33,
    0.004_441_011_335_458_5,
    -0.003_091_669_2,
    -0.002_671_458_4,
];
/// Standard deviations beyond which a term of a sum is 0.
const FAR: f64 = 8.0;
/// Steps of a bisection: in [`surplus_um`] 2⁻²⁰ of the amplitude.
const BISECTIONS: usize = 20;

/// How the bursts of a motor differ from ideal ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Standard deviation of a burst's gain.
    pub scatter: f64,
    /// Gain up minus gain down, over their mean. If it is positive, the pin climbs without a surplus.
    pub asymmetry: f64,
}

/// The limit, in standard deviations above the mean, that with a probability of 95 % none of so many independent Gaussian values
/// exceeds, to three decimals: 2.858 for the paper's 24 motors.
///
/// `Φ(x)^motors = 0.95`. An array is as good as its worst pin, so a surplus that suits only an average motor fails on every array.
pub fn worst_of(motors: usize) -> f64 {
    let one_exceeds = 1.0 - libm::pow(0.95, 1.0 / motors.max(1) as f64);
    let (mut below, mut beyond) = (0.0, FAR);
    for _ in 0..BISECTIONS {
        let middle = f64::midpoint(below, beyond);
        if above(middle) < one_exceeds { beyond = middle } else { below = middle }
    }
    (1000.0 * beyond).round() / 1000.0
}

impl Spread {
    /// The spread of motors that are not calibrated: the asymmetry that none of so many exceeds ([`worst_of`]).
    pub fn uncalibrated(scatter: f64, asymmetry_sd: f64, motors: usize) -> Self {
        Self { scatter, asymmetry: worst_of(motors) * asymmetry_sd }
    }

    /// The spread of one of so many motors whose gains up and down were measured, each with a standard deviation. The asymmetry is
    /// the measured one plus [`worst_of`] standard deviations of its measurement error.
    pub fn measured(scatter: f64, gains: [f64; 2], sds: [f64; 2], motors: usize) -> Self {
        let mean = f64::midpoint(gains[0], gains[1]);
        let sd = libm::hypot(sds[0], sds[1]);
        Self { scatter, asymmetry: (gains[0] - gains[1] + worst_of(motors) * sd) / mean }
    }
}

/// The bursts of a motor from one rest to the next, without a surplus. The last one goes down to rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bursts {
    /// Travel up in all, µm.
    up_um: f64,
    /// Sums of squares of the ways up, and of those down but the last, µm².
    squares_um2: [f64; 2],
    /// The last way down, µm.
    last_um: f64,
}

impl Bursts {
    /// Adds a burst: its travel, µm, above 0 if it goes up.
    pub fn add(&mut self, travel_um: f64) {
        if travel_um > 0.0 {
            self.up_um += travel_um;
            self.squares_um2[0] += travel_um * travel_um;
        } else {
            self.squares_um2[1] += self.last_um * self.last_um;
            self.last_um = -travel_um;
        }
    }

    /// Travel up in all, µm.
    pub const fn up_um(&self) -> f64 {
        self.up_um
    }
}

/// The rest error of one motor from stroke to stroke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReflectedWalk {
    /// Mean of a step, µm.
    mean_um: f64,
    /// Standard deviation of a step, µm.
    sd_um: f64,
}

impl ReflectedWalk {
    /// The walk of strokes of this amplitude and surplus.
    pub fn new(amplitude_um: f64, surplus_um: f64, spread: Spread) -> Self {
        let up = amplitude_um * (1.0 + spread.asymmetry / 2.0);
        let down = (amplitude_um + surplus_um) * (1.0 - spread.asymmetry / 2.0);
        Self { mean_um: up - down, sd_um: spread.scatter * libm::hypot(up, down) }
    }

    /// The walk of excursions of these bursts, with a surplus of the last one.
    pub fn of_bursts(bursts: &Bursts, surplus_um: f64, spread: Spread) -> Self {
        let [up, down] = [1.0 + spread.asymmetry / 2.0, 1.0 - spread.asymmetry / 2.0];
        let last_um = bursts.last_um + surplus_um;
        let [up_squares, down_squares] = bursts.squares_um2;
        let squares = up * up * up_squares + down * down * (down_squares + last_um * last_um);
        let mean_um = bursts.up_um * up - (bursts.up_um + surplus_um) * down;
        Self { mean_um, sd_um: spread.scatter * squares.sqrt() }
    }

    /// Stationary root mean square of the rest error, µm; infinite if it grows without limit.
    pub fn rms_um(&self) -> f64 {
        let (mean, variance) = self.moments();
        (mean * mean + variance).sqrt()
    }

    /// Mean and variance of the rest error after one more stroke, from those before it, µm and µm². It assumes that the free sum is
    /// normal, so it needs no history: the stationary rms of repeated calls is within 15 % of [`Self::rms_um`].
    pub fn after(&self, [mean, variance]: [f64; 2]) -> [f64; 2] {
        let (mean, sd) = (mean + self.mean_um, libm::hypot(variance.sqrt(), self.sd_um));
        if sd == 0.0 {
            return [mean.max(0.0), 0.0];
        }
        let [first, second] = positive_part(-mean / sd);
        [sd * first, sd * sd * (second - first * first)]
    }

    /// -mean / sd of a step; none: the walk has no stationary distribution.
    fn delta(&self) -> Option<f64> {
        (self.mean_um < 0.0).then(|| -self.mean_um / self.sd_um)
    }

    /// Stationary mean and variance, µm and µm².
    fn moments(&self) -> (f64, f64) {
        match self.delta() {
            // Without scatter the stop absorbs the whole surplus.
            Some(f64::INFINITY) => (0.0, 0.0),
            Some(delta) => {
                let [mean, variance] = moments(delta);
                (mean * self.sd_um, variance * self.sd_um * self.sd_um)
            }
            None if self.mean_um == 0.0 && self.sd_um == 0.0 => (0.0, 0.0),
            None => (f64::INFINITY, f64::INFINITY),
        }
    }
}

/// The smallest surplus that keeps the stationary rms of the rest error within `rest_error_um`, µm. None: no surplus up to the
/// amplitude does.
pub fn surplus_um(amplitude_um: f64, spread: Spread, rest_error_um: f64) -> Option<f64> {
    least(amplitude_um, |surplus_um| {
        ReflectedWalk::new(amplitude_um, surplus_um, spread).rms_um() <= rest_error_um
    })
}

/// As [`surplus_um`], of the last of these bursts. None: no surplus up to `most_um` does.
pub fn surplus_after_um(bursts: &Bursts, most_um: f64, spread: Spread, rest_error_um: f64) -> Option<f64> {
    least(most_um, |surplus_um| {
        ReflectedWalk::of_bursts(bursts, surplus_um, spread).rms_um() <= rest_error_um
    })
}

/// The least value up to `most` that is enough, to 2⁻²⁰ of that.
fn least(most: f64, enough: impl Fn(f64) -> bool) -> Option<f64> {
    let enough = |share: f64| enough(share * most);
    if enough(0.0) {
        return Some(0.0);
    }
    if !enough(1.0) {
        return None;
    }
    let (mut below, mut above) = (0.0, 1.0);
    for _ in 0..BISECTIONS {
        let middle = f64::midpoint(below, above);
        if enough(middle) { above = middle } else { below = middle }
    }
    Some(above * most)
}

/// Stationary mean and variance of the walk with steps of mean -δ and variance 1.
fn moments(delta: f64) -> [f64; 2] {
    if delta < SERIES_BELOW {
        let root = (2.0 * PI).sqrt();
        let mean = 0.5 / delta
            + ZETA[0] / root
            + delta / 4.0
            + delta * delta / root * series(delta, 1, |r| (2.0 * r + 1.0) * (2.0 * r + 2.0));
        let variance = 0.25 / (delta * delta)
            - 0.25
            - 2.0 * ZETA[1] * delta / root
            - delta * delta / 24.0
            - 2.0 * delta.powi(3) / root
                * series(delta, 2, |r| (2.0 * r + 1.0) * (2.0 * r + 2.0) * (2.0 * r + 3.0));
        return [mean, variance];
    }
    terms(delta).fold([0.0; 2], |[mean, variance], (n, z)| {
        let [first, second] = positive_part(z);
        [mean + first / n.sqrt(), variance + second]
    })
}

/// `Σ_r ζ(1/2 - first - r) (-δ²/2)^r / (r! divisor(r))`.
fn series(delta: f64, first: usize, divisor: impl Fn(f64) -> f64) -> f64 {
    let (mut power, mut sum) = (1.0, 0.0);
    for (r, zeta) in (0..).map(f64::from).zip(&ZETA[first..]) {
        sum += zeta * power / divisor(r);
        power *= -delta * delta / 2.0 / (r + 1.0);
    }
    sum
}

/// The terms of Spitzer's sums that count: n, and δ √n.
fn terms(delta: f64) -> impl Iterator<Item = (f64, f64)> {
    (1..).map(f64::from).map(move |n| (n, delta * n.sqrt())).take_while(|&(_, z)| z < FAR)
}

/// The first two moments of `max(0, N - z)` for a standard normal N.
fn positive_part(z: f64) -> [f64; 2] {
    let density = libm::exp(-z * z / 2.0) / (2.0 * PI).sqrt();
    let above = above(z);
    [density - z * above, (1.0 + z * z) * above - z * density]
}

/// The probability that a standard normal deviate is above `z`.
fn above(z: f64) -> f64 {
    0.5 * libm::erfc(z * FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Normals;

    const PAPER: Spread = Spread { scatter: 0.1, asymmetry: 0.0 };

    #[test]
    fn the_series_and_the_sums_meet() {
        for delta in [0.05, 0.2, 0.5, 0.69] {
            let sums = terms(delta).fold([0.0; 2], |[mean, variance], (n, z)| {
                let [first, second] = positive_part(z);
                [mean + first / n.sqrt(), variance + second]
            });
            let [mean, variance] = moments(delta);
            assert!((mean - sums[0]).abs() < 1e-6 * mean, "{delta}: {mean} {sums:?}");
            assert!((variance - sums[1]).abs() < 1e-6 * variance, "{delta}: {variance} {sums:?}");
        }
    }

    /// Against Lindley's recursion with Gaussian steps.
    #[test]
    fn the_stationary_walk_is_that_of_the_recursion() {
        for surplus_um in [3.0, 8.0, 20.0] {
            let walk = ReflectedWalk::new(80.0, surplus_um, PAPER);
            let (mut normals, mut error, mut squares) = (Normals::new(1, 0), 0.0_f64, 0.0);
            const STEPS: u32 = 2_000_000;
            for _ in 0..STEPS {
                error = (error + walk.mean_um + walk.sd_um * normals.next()).max(0.0);
                squares += error * error;
            }
            let rms = (squares / f64::from(STEPS)).sqrt();
            assert!((walk.rms_um() / rms - 1.0).abs() < 0.03, "{surplus_um}: {} {rms}", walk.rms_um());
        }
        let free = ReflectedWalk::new(80.0, 0.0, PAPER);
        assert!(free.rms_um().is_infinite());
        assert_eq!(ReflectedWalk::new(80.0, 3.0, Spread { scatter: 0.0, asymmetry: 0.02 }).rms_um(), 0.0);
    }

    #[test]
    fn the_surplus_is_the_smallest_that_is_enough_and_scales_with_the_amplitude() {
        for spread in
            [PAPER, Spread { scatter: 0.2, asymmetry: 0.06 }, Spread { scatter: 0.05, asymmetry: -0.02 }]
        {
            let mut last = f64::INFINITY;
            for allowed_um in [1.0, 2.0, 5.0, 10.0, 30.0] {
                let rms = |surplus_um| ReflectedWalk::new(80.0, surplus_um, spread).rms_um();
                let Some(surplus) = surplus_um(80.0, spread, allowed_um) else {
                    assert!(rms(80.0) > allowed_um);
                    continue;
                };
                assert!(rms(surplus) <= allowed_um && surplus <= last, "{spread:?} {allowed_um}: {surplus}");
                assert!(
                    surplus == 0.0 || rms(surplus - 1e-3) > allowed_um,
                    "{spread:?} {allowed_um}: {surplus}"
                );
                let tenth = surplus_um(8.0, spread, allowed_um / 10.0).unwrap();
                assert!((tenth - surplus / 10.0).abs() < 1e-3, "{tenth} {surplus}");
                last = surplus;
            }
        }
        assert_eq!(surplus_um(80.0, Spread { scatter: 0.0, asymmetry: 0.0 }, 1.0), Some(0.0));
        assert_eq!(surplus_um(80.0, Spread { scatter: 0.5, asymmetry: 0.0 }, 1e-6), None);
    }

    #[test]
    fn the_worst_motor_is_within_its_bound_on_19_arrays_of_20() {
        for (motors, bound) in [(1, 1.645), (9, 2.531), (24, 2.858), (64, 3.155)] {
            assert_eq!(worst_of(motors), bound);
            assert!((libm::pow(1.0 - above(bound), motors as f64) - 0.95).abs() < 1e-4);
        }
        let spread = Spread::uncalibrated(0.1, 0.02, 24);
        assert_eq!(spread, Spread { scatter: 0.1, asymmetry: 0.05716 });
        let known = Spread::measured(0.08, [1.02, 0.98], [0.0, 0.0], 24);
        assert!((known.asymmetry - 0.04).abs() < 1e-12);
        let vague = Spread::measured(0.08, [1.02, 0.98], [0.003, 0.004], 24);
        assert!((vague.asymmetry - 0.04 - 0.005 * 2.858).abs() < 1e-12);
    }
}
