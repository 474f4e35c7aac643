//! Changes heights until the rates of afferents, and the skin, are near those under the object.
//!
//! The loss is a weighted sum of three squared errors, each as a share of what is wanted: the rates of RA afferents and those of PC
//! afferents, blurred over the skin as between the afferents of different fingers and summed over 12 ms; and the displacement of the skin.
//! Projected gradients lower it; a step that does not is halved, so the result is never worse than the start.

use crate::blurred::weight;
use crate::levels::{Levels, Limits, STEP_S};
use crate::rates::{Table, of_pc};
use crate::skin::Skin;
use crate::wanted::Wanted;

/// Steps of a bin, in which rates are summed.
const BIN: usize = 3;
/// A smaller weight of the blur counts as 0: three SD.
const LEAST_WEIGHT: f64 = 0.011;

/// The weights of the errors.
#[derive(Clone, Copy, Debug)]
struct Weights {
    ra: f64,
    pc: f64,
    skin: f64,
}

/// For an object that moves.
const WEIGHTS: Weights = Weights { ra: 1.0, pc: 0.02, skin: 1.0 };

/// Numbers by moment and then by place.
type Rows = Vec<Vec<f64>>;

/// The places near each other, and the weights of their blur.
struct Blur(Vec<Vec<(usize, f64)>>);

impl Blur {
    fn new(skin: &Skin) -> Self {
        let places = &skin.places_mm;
        let row = |&place: &[f64; 2]| {
            let near = places.iter().enumerate().map(|(number, &at)| (number, weight(place, at)));
            let mut row: Vec<_> = near.filter(|(_, weight)| *weight > LEAST_WEIGHT).collect();
            let sum: f64 = row.iter().map(|(_, weight)| weight).sum();
            row.iter_mut().for_each(|(_, weight)| *weight /= sum);
            row
        };
        Self(places.iter().map(row).collect())
    }

    fn apply(&self, values: &[f64]) -> Vec<f64> {
        self.0.iter().map(|row| row.iter().map(|&(place, weight)| weight * values[place]).sum()).collect()
    }

    fn transposed(&self, values: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; values.len()];
        for (row, value) in self.0.iter().zip(values) {
            row.iter().for_each(|&(place, weight)| sums[place] += weight * value);
        }
        sums
    }
}

/// Spikes by place, step by step, and their slopes by the speeds of the skin.
struct Spikes {
    ra: Rows,
    pc: Rows,
    /// The slope of RA spikes by the step's own speed.
    ra_slopes: Rows,
    /// The slopes of PC spikes by the speed of the step before, and by the step's own.
    pc_slopes: Vec<Vec<[f64; 2]>>,
}

impl Spikes {
    /// The spikes of these velocities, mm/s.
    fn of(table: &Table, velocities: &Rows) -> Self {
        let places = velocities.first().map_or(0, Vec::len);
        let still = vec![0.0; places];
        let mut spikes =
            Self { ra: Rows::new(), pc: Rows::new(), ra_slopes: Rows::new(), pc_slopes: Vec::new() };
        for (step, now) in velocities.iter().enumerate() {
            let before = if step == 0 { &still } else { &velocities[step - 1] };
            let (ra, slopes) = now.iter().map(|speed| table.at(speed.abs())).unzip();
            spikes.ra.push(ra);
            spikes.ra_slopes.push(slopes);
            let (pc, slopes) = before.iter().zip(now).map(|(before, now)| of_pc(*before, *now)).unzip();
            spikes.pc.push(pc);
            spikes.pc_slopes.push(slopes);
        }
        spikes
    }
}

/// Blurred spikes in windows of three bins, one from each bin.
fn binned(blur: &Blur, spikes: &[Vec<f64>]) -> Rows {
    let bins: Rows = spikes.chunks(BIN).map(|bin| blur.apply(&sum(bin))).collect();
    in_windows(&bins)
}

/// Each bin together with the bin before and the bin after. This is its own transpose.
fn in_windows(bins: &Rows) -> Rows {
    let window = |at: usize| sum(&bins[at.saturating_sub(1)..(at + 2).min(bins.len())]);
    (0..bins.len()).map(window).collect()
}

fn sum(rows: &[Vec<f64>]) -> Vec<f64> {
    let mut sum = rows[0].clone();
    for row in &rows[1..] {
        sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
    sum
}

fn squares(rows: &Rows) -> f64 {
    rows.iter().flatten().map(|value| value * value).sum()
}

fn difference(a: &Rows, b: &Rows) -> Rows {
    let row = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| a - b).collect();
    a.iter().zip(b).map(row).collect()
}

/// What is wanted, and how much each error counts.
pub(crate) struct Goal<'g> {
    skin: &'g Skin,
    wanted: &'g Wanted,
    table: Table,
    blur: Blur,
    ra: Rows,
    pc: Rows,
    /// The weights over the squares of what is wanted.
    weights: Weights,
}

impl<'g> Goal<'g> {
    pub(crate) fn new(skin: &'g Skin, wanted: &'g Wanted) -> Self {
        Self::weighed(skin, wanted, WEIGHTS)
    }

    /// The goal by which a start is chosen. With the skin's full weight a motion of 20 mm/s would be followed, and RA afferents be silent.
    pub(crate) fn of_start(skin: &'g Skin, wanted: &'g Wanted) -> Self {
        Self::weighed(skin, wanted, Weights { skin: 0.3, ..WEIGHTS })
    }

    fn weighed(skin: &'g Skin, wanted: &'g Wanted, weights: Weights) -> Self {
        let (table, blur) = (Table::of_ra(), Blur::new(skin));
        let velocities = velocities(&wanted.skin_mm);
        let spikes = Spikes::of(&table, &velocities);
        let touched = wanted.touched;
        let (ra, pc) = (binned(&blur, &spikes.ra[..touched]), binned(&blur, &spikes.pc[..touched]));
        // An object that moves no skin, or too slowly for a class, asks nothing of it.
        let share = |weight: f64, rows: &Rows| match squares(rows) {
            0.0 => 0.0,
            wanted => weight / wanted,
        };
        let weights = Weights {
            ra: share(weights.ra, &ra),
            pc: share(weights.pc, &pc),
            skin: share(weights.skin, &wanted.skin_mm),
        };
        Self { skin, wanted, table, blur, ra, pc, weights }
    }

    /// The loss of some heights, and what its slopes need.
    fn loss(&self, levels: &Levels) -> (f64, State) {
        let moved = |heights: &Vec<f64>| {
            let mut at = vec![0.0; self.skin.places()];
            self.skin.under(heights, &mut at);
            at
        };
        let skin_mm: Rows = levels.heights_mm.iter().map(moved).collect();
        let raw = velocities(&skin_mm);
        let averaged = averaged(&raw);
        let spikes = Spikes::of(&self.table, &averaged);
        let touched = self.wanted.touched;
        let ra = difference(&binned(&self.blur, &spikes.ra[..touched]), &self.ra);
        let pc = difference(&binned(&self.blur, &spikes.pc[..touched]), &self.pc);
        let skin = difference(&skin_mm, &self.wanted.skin_mm);
        let Weights { ra: of_ra, pc: of_pc, skin: of_skin } = self.weights;
        let loss = of_ra * squares(&ra) + of_pc * squares(&pc) + of_skin * squares(&skin);
        (loss, State { averaged, spikes, ra, pc, skin })
    }

    /// The start with the lowest loss.
    pub(crate) fn nearest(&self, starts: Vec<Levels>) -> Levels {
        let with_loss = starts.into_iter().map(|start| (self.loss(&start).0, start));
        with_loss.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, start)| start).unwrap_or_default()
    }

    /// Heights near a start, with a lower loss, after so many steps.
    pub(crate) fn descend(&self, limits: Limits, start: Levels, steps: usize) -> Levels {
        let mut best = start;
        best.limit(limits);
        let (mut loss, mut state) = self.loss(&best);
        // The first step moves the pins that gain most by a tenth of what they may go in a moment.
        let mut slopes = self.slopes(&state);
        let steepest = slopes.iter().flatten().fold(0.0_f64, |most, slope| most.max(slope.abs()));
        let mut pace = 0.1 * limits.step_mm / steepest.max(f64::MIN_POSITIVE);
        for _ in 0..steps {
            let mut next = best.clone();
            for (heights, slopes) in next.heights_mm.iter_mut().zip(&slopes) {
                heights.iter_mut().zip(slopes).for_each(|(height, slope)| *height -= pace * slope);
            }
            next.limit(limits);
            let (next_loss, next_state) = self.loss(&next);
            if next_loss < loss {
                (best, loss, state) = (next, next_loss, next_state);
                slopes = self.slopes(&state);
                pace *= 1.5;
            } else {
                pace *= 0.5;
            }
        }
        best
    }

    /// The slopes of the loss by each height.
    fn slopes(&self, state: &State) -> Rows {
        let moments = state.skin.len();
        let places = self.skin.places();
        let mut by_velocity = vec![vec![0.0; places]; moments];
        let (ra, pc) = (in_windows(&state.ra), in_windows(&state.pc));
        for (bin, (ra, pc)) in ra.iter().zip(&pc).enumerate() {
            let (ra, pc) = (self.blur.transposed(ra), self.blur.transposed(pc));
            for step in bin * BIN..((bin + 1) * BIN).min(self.wanted.touched) {
                for place in 0..places {
                    let [before, now] = state.spikes.pc_slopes[step][place];
                    let of_pc = 2.0 * self.weights.pc * pc[place];
                    let of_ra = 2.0 * self.weights.ra * ra[place] * state.spikes.ra_slopes[step][place];
                    by_velocity[step][place] += of_ra * state.averaged[step][place].signum() + of_pc * now;
                    if step > 0 {
                        by_velocity[step - 1][place] += of_pc * before;
                    }
                }
            }
        }
        // From their means to velocities, and from those to displacements.
        let mut found = Vec::with_capacity(moments);
        let half = |step: usize, place: usize| -> f64 {
            let next = by_velocity.get(step + 1).map_or(0.0, |row| row[place]);
            f64::midpoint(by_velocity[step][place], next)
        };
        for moment in 0..moments {
            let at: Vec<f64> = (0..places)
                .map(|place| {
                    let next = if moment + 1 < moments { half(moment + 1, place) } else { 0.0 };
                    (half(moment, place) - next) / STEP_S
                        + 2.0 * self.weights.skin * state.skin[moment][place]
                })
                .collect();
            let mut pins = vec![0.0; self.skin.motors];
            self.skin.onto(&at, &mut pins);
            found.push(pins);
        }
        found
    }
}

/// A loss's parts.
struct State {
    averaged: Rows,
    spikes: Spikes,
    ra: Rows,
    pc: Rows,
    skin: Rows,
}

/// The velocity in each step, mm/s, from displacements at its end, mm. Before the first, the skin rests.
fn velocities(skin_mm: &Rows) -> Rows {
    let mut before = vec![0.0; skin_mm.first().map_or(0, Vec::len)];
    let mut found = Vec::with_capacity(skin_mm.len());
    for now in skin_mm {
        found.push(now.iter().zip(&before).map(|(now, before)| (now - before) / STEP_S).collect());
        before.clone_from(now);
    }
    found
}

/// The mean of each step and the one before: motors average over about a step.
fn averaged(velocities: &Rows) -> Rows {
    let mut before = vec![0.0; velocities.first().map_or(0, Vec::len)];
    let mut found = Vec::with_capacity(velocities.len());
    for now in velocities {
        found.push(now.iter().zip(&before).map(|(now, before)| f64::midpoint(*now, *before)).collect());
        before.clone_from(now);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blurred::{Blurred, counts};
    use crate::judge::compared;
    use crate::skin::SPACING_MM;
    use meissner_array::spec::Array;
    use meissner_skin::afferents::{Class, population};
    use meissner_touch::{Contact, Object, Pose, Scan, Shape, Touch, respond, surface_of};

    /// The slopes are those of the loss, by differences.
    #[test]
    fn slopes_are_those_of_the_loss() {
        let skin = Skin::new(Array::paper(), SPACING_MM);
        let motors = skin.motors;
        let wave = |scale: f64| {
            let height = |moment: usize, motor: usize| {
                let phase = 0.37 * moment as f64 + 1.3 * motor as f64;
                scale * (0.1 + 0.05 * libm::sin(phase) + 0.03 * libm::sin(2.3 * phase))
            };
            let row = |moment| (0..motors).map(|motor| height(moment, motor)).collect();
            Levels { heights_mm: (0..20).map(row).collect() }
        };
        let moved = |heights: &Vec<f64>| {
            let mut at = vec![0.0; skin.places()];
            skin.under(heights, &mut at);
            at
        };
        let skin_mm = wave(1.4).heights_mm.iter().map(moved).collect();
        let wanted = Wanted { skin_mm, touched: 16 };
        for weights in [
            Weights { ra: 1.0, pc: 0.0, skin: 0.0 },
            Weights { ra: 0.0, pc: 1.0, skin: 0.0 },
            Weights { ra: 0.0, pc: 0.0, skin: 1.0 },
        ] {
            let goal = Goal::weighed(&skin, &wanted, weights);
            let levels = wave(1.0);
            let (_, state) = goal.loss(&levels);
            let slopes = goal.slopes(&state);
            for (moment, motor) in [(1, 3), (7, 9), (12, 14), (19, 20)] {
                let at = |by: f64| {
                    let mut levels = levels.clone();
                    levels.heights_mm[moment][motor] += by;
                    goal.loss(&levels).0
                };
                let by = 1e-7;
                let found = (at(by) - at(-by)) / (2.0 * by);
                let slope = slopes[moment][motor];
                assert!(
                    (found - slope).abs() < 0.02 * (found.abs() + 1e-3),
                    "{weights:?} {moment} {motor}: {found} {slope}"
                );
            }
        }
    }

    /// The function of velocities against simulated fingers, under a bar that moves over them: correlation in windows of 36 ms, and the sum.
    #[test]
    fn rates_under_a_moving_bar_are_those_of_fingers() {
        let skin = Skin::new(Array::paper(), SPACING_MM);
        for (speed_mm_s, least_r) in [(20.0, 0.65), (40.0, 0.7), (80.0, 0.8)] {
            let bar = surface_of(&Shape::Polyline(vec![[-5.6, 0.0], [5.6, 0.0]]));
            let (depth_mm, rise_s, direction_deg) = (0.5, 0.03, 90.0);
            let scan = Scan { depth_mm, rise_s, speed_mm_s, direction_deg, duration_s: 20.0 / speed_mm_s };
            let object = Object::new("bar", bar, Touch::scan(Pose::default(), scan).unwrap());
            let contact = Contact::new(object.grains(object.pitch_mm()), depth_mm).unwrap();
            let wanted = Wanted::new(&skin, &contact, object.touch(), Limits::of(Array::paper()));
            let spikes = Spikes::of(&Table::of_ra(), &velocities(&wanted.skin_mm));
            let found = binned(&Blur::new(&skin), &spikes.ra[..wanted.touched]);
            let mut real = vec![vec![0.0; skin.places()]; found.len()];
            let fingers = 3;
            for seed in 0..fingers {
                let afferents = population(9100 + seed);
                let spikes_s = respond(&contact, object.touch(), &afferents, Some(seed), &|_| ());
                let blurred = Blurred::new(&afferents);
                let counts = counts(&spikes_s, BIN as f64 * STEP_S, found.len());
                for (bin, real) in real.iter_mut().enumerate() {
                    let of_class = blurred.of_class(Class::Ra, |number| counts[number][bin]);
                    real.iter_mut().zip(of_class).for_each(|(real, count)| *real += count / fingers as f64);
                }
            }
            let (found, real) = (found.concat(), in_windows(&real).concat());
            let (r, _) = compared(&found, &real);
            let sum = found.iter().sum::<f64>() / real.iter().sum::<f64>();
            println!("{speed_mm_s} mm/s: r {r:.2}, sum {sum:.2}");
            assert!(r > least_r && (0.75..1.5).contains(&sum), "{speed_mm_s} mm/s: {r} {sum}");
        }
    }
}
