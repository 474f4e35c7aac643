//! Solves the contact of grains with the skin, an elastic half space.
//!
//! At a depth, the object's highest point is that far below the surface of the skin at rest. [`solve`] finds loads of the grains such
//! that no load pulls, the skin lies on every grain that presses, and no other grain reaches into it. It takes the constrained
//! conjugate gradients of Polonsky & Keer 1999, with the depth given in place of the total load. Grains lie on a grid, so the
//! skin's profile is a convolution (`fft`), and memory grows with the number of cells.
//!
//! A [`Contact`] holds the loads for a whole touch. If all grains are at height 0, loads are proportional to depth. Otherwise they are
//! solved at [`DEPTHS`] depths and interpolated between them by cubics with continuous slopes, because a step in the rate of a load
//! would be felt.
//!
//! Invariant: no solved load is negative. Interpolated loads may be below 0 by the error of interpolation, where a grain begins to
//! touch.
//!
//! # Source
//!
//! I. A. Polonsky and L. M. Keer, "A numerical method for solving rough contact problems based on the multi-level multi-summation and
//! conjugate gradient techniques", *Wear* 231, 206-219, 1999.

use crate::fft::{Convolution, Plan, Work, padded};
use crate::grains::Grains;
use meissner_skin::afferents::{ELASTICITY, POISSON};

/// Depths at which the contact of an uneven object is solved. Depth number n of these is (n / DEPTHS)² of the largest.
pub const DEPTHS: usize = 12;
/// The most memory that a contact takes, bytes.
pub const MAX_BYTES: usize = 256 << 20;

/// The largest error of the skin's profile, in shares of the depth.
const TOLERANCE: f64 = 1e-9;
/// More steps than any contact needs: a round one takes some dozens.
const MAX_STEPS: usize = 2000;

/// Why there is no contact.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum ContactError {
    #[error(
        "{grains} grains of {pitch_mm} mm need {} MB: at most {} MB are used, take larger grains or a smaller object",
        bytes >> 20, MAX_BYTES >> 20
    )]
    TooLarge { grains: usize, pitch_mm: f64, bytes: usize },
    #[error(
        "the contact of {grains} grains at {depth_mm} mm was not found in {MAX_STEPS} steps: take larger grains"
    )]
    NotFound { grains: usize, depth_mm: f64 },
}

/// The loads of an object's grains at every depth up to a largest one.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    grains: Grains,
    /// The largest depth.
    most_mm: f64,
    /// By depth and then by grain, N: one depth, the largest, if loads are proportional to it.
    loads_n: Vec<Vec<f64>>,
}

/// Weights of the solved depths, by their numbers, for a depth in between; most are none.
pub(crate) type Weights = [Option<(usize, f64)>; 4];

/// The bytes that the contact of grains takes, before it is solved.
pub fn bytes(grains: &Grains) -> usize {
    let [columns, rows] = padded(grains.size, grains.size);
    let depths = if grains.are_flat() { 1 } else { DEPTHS };
    // The kernel's spectrum, and the two grids of `Work`; per grain its loads and the state of the solver.
    3 * 16 * columns * rows + 8 * grains.len() * (depths + 8)
}

/// The loads of grains at a depth, N, by grain. They begin at `start`, loads of a similar depth.
///
/// # Errors
/// If it takes too much memory, or too many steps.
pub fn solve(grains: &Grains, depth_mm: f64, start: Option<&[f64]>) -> Result<Vec<f64>, ContactError> {
    Solver::new(grains)?.solve(depth_mm, start)
}

impl Contact {
    /// Solves the contact at all depths up to `most_mm`.
    ///
    /// # Errors
    /// If it takes too much memory, or too many steps.
    pub fn new(grains: Grains, most_mm: f64) -> Result<Self, ContactError> {
        Self::with_progress(grains, most_mm, &|_| ())
    }

    /// The same; `progress` is called after each depth with the completed share.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_progress(grains: Grains, most_mm: f64, progress: &dyn Fn(f64)) -> Result<Self, ContactError> {
        let mut solver = Solver::new(&grains)?;
        let mut loads_n: Vec<Vec<f64>> = Vec::new();
        let first = if grains.are_flat() { DEPTHS } else { 1 };
        for number in first..=DEPTHS {
            let share = number as f64 / DEPTHS as f64;
            let next = solver.solve(most_mm * share * share, loads_n.last().map(Vec::as_slice))?;
            loads_n.push(next);
            progress(share);
        }
        Ok(Self { grains, most_mm, loads_n })
    }

    /// The grains.
    pub const fn grains(&self) -> &Grains {
        &self.grains
    }

    /// The largest depth, mm.
    pub const fn most_mm(&self) -> f64 {
        self.most_mm
    }

    /// The loads of all grains at a depth from 0 to the largest, N.
    pub fn loads_n(&self, depth_mm: f64) -> Vec<f64> {
        let mut sum = vec![0.0; self.grains.len()];
        for (number, weight) in self.weights(depth_mm).into_iter().flatten() {
            sum.iter_mut().zip(&self.loads_n[number]).for_each(|(sum, load)| *sum += weight * load);
        }
        sum
    }

    /// The displacement of the skin, mm, at a place in the object's frame, `[x, y]` in mm.
    pub fn displacement_mm(&self, depth_mm: f64, at: [f64; 2]) -> f64 {
        let punch = self.grains.punch();
        let terms = self.grains.places_mm.iter().zip(self.loads_n(depth_mm));
        terms.map(|(place, load)| load * punch.flexibility(distance(at, *place))).sum()
    }

    /// The number of solved depths.
    pub(crate) const fn depths(&self) -> usize {
        self.loads_n.len()
    }

    /// The loads at a solved depth.
    pub(crate) fn solved(&self, number: usize) -> &[f64] {
        &self.loads_n[number]
    }

    /// The weights of the solved depths for a depth.
    pub(crate) fn weights(&self, depth_mm: f64) -> Weights {
        let share = (depth_mm / self.most_mm).clamp(0.0, 1.0);
        if self.depths() == 1 {
            return [(share > 0.0).then_some((0, share)), None, None, None];
        }
        // Loads are smooth over the square root of the depth, which counts the solved depths.
        let place = share.sqrt() * DEPTHS as f64;
        let from = (place.floor() as usize).min(DEPTHS - 1);
        let t = place - from as f64;
        let mut of = cubic(t);
        if from == 0 {
            // At depth 0 loads rise at least as the depth, so their slope over its root is 0.
            of[2] += of[0];
            of[0] = 0.0;
        }
        if from == DEPTHS - 1 {
            // Beyond the largest depth the parabola through the last three goes on.
            of[2] += 3.0 * of[3];
            of[1] -= 3.0 * of[3];
            of[0] += of[3];
            of[3] = 0.0;
        }
        // Depth number n + 1 is in place n; number 0 has no loads.
        std::array::from_fn(|index| {
            let number = (from + index).checked_sub(2)?;
            (of[index] != 0.0).then_some((number, of[index]))
        })
    }
}

struct Solver<'g> {
    grains: &'g Grains,
    skin: Convolution,
    work: Work,
}

impl<'g> Solver<'g> {
    fn new(grains: &'g Grains) -> Result<Self, ContactError> {
        let bytes = bytes(grains);
        if bytes > MAX_BYTES {
            return Err(ContactError::TooLarge { grains: grains.len(), pitch_mm: grains.pitch_mm, bytes });
        }
        let (size, punch, pitch_mm) = (grains.size, grains.punch(), grains.pitch_mm);
        let kernel = |[x, y]: [f64; 2]| punch.flexibility(pitch_mm * (x * x + y * y).sqrt());
        let skin = Convolution::new(Plan::new(size, size), size, size, [0, 0], kernel);
        Ok(Self { grains, skin, work: Work::default() })
    }

    /// The displacement of the skin at the grains.
    fn profile_mm(&mut self, loads: &[f64]) -> Vec<f64> {
        let values = self.grains.cells.iter().zip(loads).map(|(&cell, &load)| (cell, [load, 0.0]));
        let profile = self.skin.of(values, &mut self.work);
        self.grains.cells.iter().map(|&cell| profile(cell)[0]).collect()
    }

    fn solve(&mut self, depth_mm: f64, start: Option<&[f64]>) -> Result<Vec<f64>, ContactError> {
        // A grain whose wanted displacement is not above 0 never touches, because no skin is lifted.
        let wanted: Vec<f64> = self.grains.heights_mm.iter().map(|height_mm| depth_mm + height_mm).collect();
        let count = wanted.len();
        let stiffness = 2.0 * self.grains.radius_mm * ELASTICITY / (1.0 - POISSON * POISSON);
        let guess = |(wanted, load): (&f64, f64)| if *wanted > 0.0 { load.max(0.0) } else { 0.0 };
        let mut loads: Vec<f64> = match start {
            Some(start) => wanted.iter().zip(start.iter().copied()).map(guess).collect(),
            None => wanted.iter().map(|&wanted| guess((&wanted, stiffness * wanted))).collect(),
        };
        let mut direction = vec![0.0; count];
        let (mut last, mut conjugate) = (1.0, false);
        let mut profile = self.profile_mm(&loads);
        for _ in 0..MAX_STEPS {
            let gaps: Vec<f64> = profile.iter().zip(&wanted).map(|(mm, wanted)| mm - wanted).collect();
            let error = |(gap, load): (&f64, &f64)| if *load > 0.0 { gap.abs() } else { (-gap).max(0.0) };
            let worst = gaps.iter().zip(&loads).map(error).fold(0.0, f64::max);
            if worst <= TOLERANCE * depth_mm {
                return Ok(loads);
            }
            let touching = |index: usize| loads[index] > 0.0;
            let squared: f64 =
                (0..count).filter(|&index| touching(index)).map(|index| gaps[index] * gaps[index]).sum();
            let share = if conjugate { squared / last } else { 0.0 };
            last = squared;
            for index in 0..count {
                direction[index] = if touching(index) { gaps[index] + share * direction[index] } else { 0.0 };
            }
            let effect = self.profile_mm(&direction);
            let product = |of: &[f64]| direction.iter().zip(of).map(|(a, b)| a * b).sum::<f64>();
            let (along, curved) = (product(&gaps), product(&effect));
            // If nothing touches, the first step is that of single grains.
            let length = if curved > 0.0 { along / curved } else { stiffness };
            conjugate = true;
            // Whether the loads go the whole step: then the profile follows from its effect.
            let mut whole = true;
            for index in 0..count {
                if loads[index] > 0.0 {
                    let next = loads[index] - length * direction[index];
                    whole &= next >= 0.0;
                    loads[index] = next.max(0.0);
                } else if gaps[index] < 0.0 {
                    loads[index] = -length * gaps[index];
                    conjugate = false;
                }
            }
            if whole && conjugate {
                profile.iter_mut().zip(&effect).for_each(|(mm, effect)| *mm -= length * effect);
            } else {
                profile = self.profile_mm(&loads);
            }
        }
        Err(ContactError::NotFound { grains: count, depth_mm })
    }
}

/// The weights of four points for a place between the two in the middle, by Catmull & Rom: the slope at each is that of its neighbours.
pub(crate) fn cubic(t: f64) -> [f64; 4] {
    [
        0.5 * t * (t * (2.0 - t) - 1.0),
        0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
        0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
        0.5 * t * t * (t - 1.0),
    ]
}

pub(crate) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    (x * x + y * y).sqrt()
}
