//! The skin under a flat round punch: an elastic half space (Sneddon 1946).
//!
//! A [`Punch`] gives what one load does at a distance: how far the skin moves, the pressure below it, and when the wave arrives. Pins
//! and pieces of objects are such punches.

use super::{ELASTICITY, POISSON, SAMPLES_PER_S};
use std::f64::consts::PI;

/// How fast a wave travels in the skin, mm/s (Saal et al. 2017).
const WAVE_MM_PER_S: f64 = 8000.0;

/// A flat round punch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Punch {
    /// Its radius, mm, above 0.
    pub radius_mm: f64,
}

impl Punch {
    /// The share of a load that reaches a distance r, 1/mm: asin(a/r)/(πa) with the punch's radius a, and 1/(2a) under it.
    pub fn spread(self, distance_mm: f64) -> f64 {
        if distance_mm <= self.radius_mm {
            1.0 / (2.0 * self.radius_mm)
        } else {
            libm::asin(self.radius_mm / distance_mm) / (PI * self.radius_mm)
        }
    }

    /// The displacement of the skin at a distance, per load, mm/N.
    pub fn flexibility(self, distance_mm: f64) -> f64 {
        (1.0 - POISSON * POISSON) / ELASTICITY * self.spread(distance_mm)
    }

    /// The pressure at a distance and a depth above 0, per load, 1/mm².
    pub fn pressure(self, distance_mm: f64, depth_mm: f64) -> f64 {
        let (xi, rho) = (depth_mm / self.radius_mm, distance_mm / self.radius_mm);
        let a = rho * rho + xi * xi - 1.0;
        let r = (a * a + 4.0 * xi * xi).sqrt();
        let (theta, phi) = (libm::atan(1.0 / xi), libm::atan2(2.0 * xi, a));
        let j01 = libm::sin(phi / 2.0) / r.sqrt();
        let j02 = (1.0 + xi * xi).sqrt() * libm::sin(1.5 * phi - theta) / (r * r.sqrt());
        (j01 + xi * j02) / (2.0 * PI * self.radius_mm * self.radius_mm)
    }

    /// The samples that a wave from the punch's edge takes to a distance. It is not a whole number.
    pub fn lag(self, distance_mm: f64) -> f64 {
        (distance_mm - self.radius_mm).max(0.0) / WAVE_MM_PER_S * SAMPLES_PER_S
    }

    /// Whole samples until the wave arrives; halves to even.
    pub fn delay(self, distance_mm: f64) -> u16 {
        self.lag(distance_mm).round_ties_even() as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wave_travels_8_mm_in_a_millisecond_from_the_pins_edge() {
        for (distance_mm, samples) in [
            (0.0, 0),
            (0.5, 0),
            (1.29, 0),
            (1.31, 1),
            (2.1, 1),
            (2.89, 1),
            (2.91, 2),
            (8.5, 5),
            (1600.5, 1000),
        ] {
            assert_eq!(Punch { radius_mm: 0.5 }.delay(distance_mm), samples, "{distance_mm}");
        }
    }

    /// On the axis the pressure under a flat punch is P/(2πa²)·(1 + 3ξ²)/(1 + ξ²)²; far away it vanishes.
    #[test]
    fn the_pressure_on_the_axis_is_the_books() {
        let pressure = |distance_mm, depth_mm| Punch { radius_mm: 0.5 }.pressure(distance_mm, depth_mm);
        for depth_mm in [0.1_f64, 0.3, 1.0, 2.0] {
            let square = (depth_mm / 0.5).powi(2);
            let expected = (1.0 + 3.0 * square) / (1.0 + square).powi(2) / (2.0 * PI * 0.25);
            assert!((pressure(0.0, depth_mm) - expected).abs() < 1e-12, "{depth_mm}");
        }
        assert!(pressure(20.0, 0.3).abs() < 1e-4 * pressure(0.0, 0.3));
    }
}
