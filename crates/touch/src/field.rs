//! What the loads of an object do to the skin, as tables in the object's frame.
//!
//! The half space is the same everywhere and the object is rigid. So everything that the loads do at a place follows from the depth
//! and from the place in the object's frame. A [`Field`] tabulates it for each solved depth: the spread loads alone, for which a [`Field`] of one
//! channel is enough, or also the spread loads each times its delay in samples, and the pressure at the depth of SA1 afferents. A moving object then
//! takes one look-up per place and time, however many grains it has.
//!
//! There are two tables: a fine one about the grains, by convolution, and a coarse one around it, by sums over loads seen from afar. Both are
//! interpolated by bicubics with continuous slopes (Catmull & Rom).
//!
//! Invariant: a look-up depends on the grains and the depth alone, and on the box of places only by its rounding.

use crate::contact::{Contact, MAX_BYTES, Weights, cubic, distance};
use crate::fft::{Convolution, Plan};
use meissner_skin::afferents::{Class, Punch};
use rayon::prelude::*;
use std::array::from_fn;

/// The fine table goes so far beyond the grains, mm.
const MARGIN_MM: f64 = 4.0;
/// The step of the coarse table, mm.
const COARSE_MM: f64 = 0.25;
/// The distance of loads seen from the coarse table, unless grains lie further apart, mm: spread loads err by less than a thousandth.
const NODES_MM: f64 = 0.25;
/// The step of distances from the coarse table's points to loads, mm. They are above 3 mm: interpolation changes effects by less than 1e-5.
const DISTANCE_MM: f64 = 0.02;
/// Steps of the fine table per diameter of a grain: the most and fewer, if memory is short.
const FINE: [usize; 3] = [4, 2, 1];
/// Sums over all loads at a place: the first `N` of the spread loads, N/mm, the same each times its delay in samples, and the pressure at
/// the depth of SA1 afferents, N/mm².
pub(crate) type Effect<const N: usize> = [f64; N];

/// Tables of effects, with `N` numbers of a point for each solved depth.
#[derive(Clone, Debug)]
pub(crate) struct Field<const N: usize> {
    depths: usize,
    fine: Table,
    coarse: Table,
}

#[derive(Clone, Debug)]
struct Table {
    low: [f64; 2],
    step_mm: f64,
    size: [usize; 2],
    /// By row, column, solved depth and channel.
    values: Vec<f64>,
}

/// The effect of a load of 1 N at a distance, by channel.
fn effect(punch: Punch, channel: usize, distance_mm: f64) -> f64 {
    match channel {
        0 => punch.spread(distance_mm),
        1 => punch.spread(distance_mm) * punch.lag(distance_mm),
        _ => punch.pressure(distance_mm, Class::Sa1.depth_mm()),
    }
}

impl<const N: usize> Field<N> {
    /// The field of a contact for places within a box of the object's frame, given by its lowest and highest x and y.
    pub(crate) fn new(contact: &Contact, [low, high]: [[f64; 2]; 2]) -> Self {
        let depths = contact.depths();
        // The coarse table has two points more at each side for the interpolation.
        let low = low.map(|low| low - 2.0 * COARSE_MM);
        let size = [0, 1].map(|axis| ((high[axis] - low[axis]) / COARSE_MM).ceil() as usize + 3);
        let mut coarse = Table { low, step_mm: COARSE_MM, size, values: Vec::new() };
        let fine = fine::<N>(contact);
        let high = [0, 1].map(|axis| low[axis] + size[axis] as f64 * COARSE_MM);
        let far = Far::<N>::new(contact, low, high);
        coarse.values = vec![0.0; size[0] * size[1] * depths * N];
        let rows = coarse.values.par_chunks_mut(size[0] * depths * N).enumerate();
        rows.for_each(|(row, values)| {
            for (column, values) in values.chunks_exact_mut(depths * N).enumerate() {
                let at = [low[0] + column as f64 * COARSE_MM, low[1] + row as f64 * COARSE_MM];
                if !fine.has_near(at) {
                    far.add(at, values);
                }
            }
        });
        Self { depths, fine, coarse }
    }

    /// The effect at a place in the object's frame. The place must lie in the box.
    pub(crate) fn at(&self, at: [f64; 2], weights: &Weights) -> Effect<N> {
        let table = if self.fine.has(at) { &self.fine } else { &self.coarse };
        table.at(at, self.depths, weights)
    }
}

/// Loads seen from afar: their effects at places of the coarse table, which are more than 3 mm away.
struct Far<const N: usize> {
    /// The place of each load, mm.
    places_mm: Vec<[f64; 2]>,
    /// By place and then by solved depth, N.
    loads_n: Vec<f64>,
    /// The effect of a load of 1 N by steps of distance: the functions take many times as long as a look-up.
    effects: Vec<Effect<N>>,
}

impl<const N: usize> Far<N> {
    /// The loads of a contact for a table from `low` to `high`. Grains that are closer than [`NODES_MM`] share nodes: each has its load on the
    /// four about it, with the sum and the centre kept.
    fn new(contact: &Contact, low: [f64; 2], high: [f64; 2]) -> Self {
        let (grains, depths) = (contact.grains(), contact.depths());
        let apart = ((NODES_MM / grains.pitch_mm) as usize).max(1);
        let size = grains.size.map(|size| size.div_ceil(apart) + 1);
        let mut nodes = vec![0.0; size[0] * size[1] * depths];
        for (grain, cell) in grains.cells.iter().enumerate() {
            let share = cell.map(|at| (at % apart) as f64 / apart as f64);
            for [x, y] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                let [across, along] = [(x, share[0]), (y, share[1])]
                    .map(|(of, share)| if of == 1 { share } else { 1.0 - share });
                let node = (cell[1] / apart + y) * size[0] + cell[0] / apart + x;
                for (depth, load) in nodes[node * depths..][..depths].iter_mut().enumerate() {
                    *load += across * along * contact.solved(depth)[grain];
                }
            }
        }
        let (mut places_mm, mut loads_n) = (Vec::new(), Vec::new());
        for (node, loads) in nodes.chunks_exact(depths).enumerate() {
            if loads.iter().any(|load| *load != 0.0) {
                let place =
                    |axis: usize, at: usize| grains.origin_mm[axis] + (at * apart) as f64 * grains.pitch_mm;
                places_mm.push([place(0, node % size[0]), place(1, node / size[0])]);
                loads_n.extend(loads);
            }
        }
        let furthest = |place: &[f64; 2]| {
            let along =
                [0, 1].map(|axis| (place[axis] - low[axis]).abs().max((high[axis] - place[axis]).abs()));
            distance(along, [0.0; 2])
        };
        let furthest_mm = places_mm.iter().map(furthest).fold(0.0, f64::max);
        let of = |step: usize| from_fn(|channel| effect(grains.punch(), channel, DISTANCE_MM * step as f64));
        let effects = (0..(furthest_mm / DISTANCE_MM) as usize + 3).map(of).collect();
        Self { places_mm, loads_n, effects }
    }

    /// Adds the effects of all loads at a place, by solved depth and channel.
    fn add(&self, at: [f64; 2], values: &mut [f64]) {
        let depths = values.len() / N;
        for (place, loads) in self.places_mm.iter().zip(self.loads_n.chunks_exact(depths)) {
            let steps = distance(at, *place) / DISTANCE_MM;
            let (below, shares) = (steps as usize, cubic(steps.fract()));
            let four = &self.effects[below - 1..below + 3];
            let effect: Effect<N> =
                from_fn(|channel| four.iter().zip(shares).map(|(of, share)| share * of[channel]).sum());
            for (values, load) in values.chunks_exact_mut(N).zip(loads) {
                values.iter_mut().zip(effect).for_each(|(value, effect)| *value += load * effect);
            }
        }
    }
}

/// The table about the grains.
fn fine<const N: usize>(contact: &Contact) -> Table {
    let (grains, depths) = (contact.grains(), contact.depths());
    let pitch_mm = grains.pitch_mm;
    let margin = (MARGIN_MM / pitch_mm).ceil() as usize;
    let cells = grains.size.map(|size| size + 2 * margin);
    // Pins lie further apart than their diameter.
    let parts_of_pitch =
        |fine: usize| (fine as f64 * pitch_mm / (2.0 * grains.radius_mm)).round().max(1.0) as usize;
    let bytes = |parts: usize| 8 * N * depths * cells[0] * cells[1] * parts * parts;
    let fits = |fine: &usize| bytes(parts_of_pitch(*fine)) <= MAX_BYTES / 2;
    let fine = FINE.into_iter().find(fits).unwrap_or(1);
    let parts = parts_of_pitch(fine);
    let (size, step_mm) = (cells.map(|cells| cells * parts), pitch_mm / parts as f64);
    let low = grains.origin_mm.map(|origin| origin - margin as f64 * pitch_mm);
    let mut values = vec![0.0; size[0] * size[1] * depths * N];
    let plan = Plan::new(grains.size, cells);
    // Two depths at a time.
    let loads: Vec<_> = (0..depths)
        .step_by(2)
        .map(|depth| {
            let second =
                |grain: usize| if depth + 1 < depths { contact.solved(depth + 1)[grain] } else { 0.0 };
            let of = |(grain, &cell): (usize, _)| (cell, [contact.solved(depth)[grain], second(grain)]);
            plan.spectrum(grains.cells.iter().enumerate().map(of))
        })
        .collect();
    let parts_of = |part: usize| [part % parts, part / parts];
    let planes: Vec<usize> = (0..parts * parts * N).collect();
    // A few planes at a time, so that memory does not depend on the number of threads.
    for planes in planes.chunks(2) {
        let computed: Vec<Vec<_>> = planes
            .par_iter()
            .map(|plane| {
                let (part, channel) = (parts_of(plane / N), plane % N);
                let kernel = |[x, y]: [f64; 2]| {
                    let x_mm = x * pitch_mm + part[0] as f64 * step_mm;
                    let y_mm = y * pitch_mm + part[1] as f64 * step_mm;
                    effect(grains.punch(), channel, (x_mm * x_mm + y_mm * y_mm).sqrt())
                };
                let convolution =
                    Convolution::new(plan.clone(), grains.size, cells, [margin, margin], kernel);
                loads.iter().map(|loads| convolution.apply(loads)).collect()
            })
            .collect();
        for (plane, computed) in planes.iter().zip(computed) {
            let (part, channel) = (parts_of(plane / N), plane % N);
            for row in 0..cells[1] {
                for column in 0..cells[0] {
                    let point = (row * parts + part[1]) * size[0] + column * parts + part[0];
                    let values = &mut values[point * depths * N..][..depths * N];
                    for (pair, outputs) in values.chunks_mut(2 * N).zip(&computed) {
                        let found = outputs([column, row]);
                        for (values, found) in pair.chunks_exact_mut(N).zip(found) {
                            values[channel] = found;
                        }
                    }
                }
            }
        }
    }
    let mut table = Table { low, step_mm, size, values };
    table.smooth(fine, depths * N);
    table
}

impl Table {
    /// Takes the mean over a square of this many steps, by the trapezoidal rule: first along rows, then along columns.
    fn smooth(&mut self, steps: usize, stride: usize) {
        let half = steps / 2;
        if half == 0 {
            return;
        }
        for axis in 0..2 {
            let apart = stride * [1, self.size[0]][axis];
            let from = self.values.clone();
            for point in 0..self.size[0] * self.size[1] {
                let place = [point % self.size[0], point / self.size[0]][axis];
                if place < half || place + half >= self.size[axis] {
                    continue;
                }
                let start = point * stride;
                for (index, value) in self.values[start..start + stride].iter_mut().enumerate() {
                    let of = |step: usize| from[start + index + step * apart - half * apart];
                    let inner: f64 = (1..steps).map(of).sum();
                    *value = (inner + (of(0) + of(steps)) / 2.0) / steps as f64;
                }
            }
        }
    }

    /// The point below a place, and how far it lies beyond, in steps.
    fn point(&self, at: [f64; 2]) -> [(f64, f64); 2] {
        [0, 1].map(|axis| {
            let place = (at[axis] - self.low[axis]) / self.step_mm;
            (place.floor(), place - place.floor())
        })
    }

    /// Whether a place can be interpolated.
    fn has(&self, at: [f64; 2]) -> bool {
        let point = self.point(at);
        (0..2).all(|axis| point[axis].0 >= 1.0 && point[axis].0 + 2.0 < self.size[axis] as f64)
    }

    /// Whether a place and all within two steps of the coarse table can be.
    fn has_near(&self, at: [f64; 2]) -> bool {
        let by = 2.5 * COARSE_MM;
        self.has([at[0] - by, at[1] - by]) && self.has([at[0] + by, at[1] + by])
    }

    fn at<const N: usize>(&self, at: [f64; 2], depths: usize, weights: &Weights) -> Effect<N> {
        let [(column, x), (row, y)] = self.point(at);
        let (across, along) = (cubic(x), cubic(y));
        // A place on the edge of the box may be rounded beyond it.
        let first = |place: f64, size: usize| (place.max(1.0) as usize - 1).min(size.saturating_sub(4));
        let (column, row) = (first(column, self.size[0]), first(row, self.size[1]));
        let stride = depths * N;
        let mut sum = [0.0; N];
        for &(number, weight) in weights.iter().flatten() {
            for (line, along) in along.iter().enumerate() {
                let start = ((row + line) * self.size[0] + column) * stride + number * N;
                for (point, across) in across.iter().enumerate() {
                    let values = &self.values[start + point * stride..][..N];
                    let weight = weight * along * across;
                    sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grains::Grains;
    use meissner_array::random::uniform;

    /// Seen from 3.2 mm and more, uneven loads on fine grains have the effects of their direct sum.
    #[test]
    fn loads_seen_from_afar_have_the_effects_of_each() {
        for pitch_mm in [0.05, 0.12, 0.2] {
            let random = |of: usize| uniform([of as u64, 0, 0, 5])[0];
            let cells: Vec<_> =
                (0..900).map(|of| [of % 30, of / 30]).filter(|[x, y]| random(40 * x + y) > 0.3).collect();
            let heights = cells.iter().map(|[x, y]| -0.3 * random(7 + 40 * x + y)).collect();
            let grains = Grains::new(pitch_mm, pitch_mm / 2.0, [1.0, -2.0], cells, heights);
            let contact = Contact::new(grains, 0.5).unwrap();
            let grains = contact.grains();
            let far = Far::<3>::new(&contact, [-20.0; 2], [30.0; 2]);
            let end = 1.0 + 30.0 * pitch_mm;
            for at in [[-2.2, -2.0], [end + 3.2, 0.0], [end + 4.0, 9.0], [-18.0, 25.0], [1.0, 30.0]] {
                let mut found = vec![0.0; 3 * contact.depths()];
                far.add(at, &mut found);
                for (depth, found) in found.chunks_exact(3).enumerate() {
                    for (channel, found) in found.iter().enumerate() {
                        let of = |(place, load): (&[f64; 2], &f64)| {
                            load * effect(grains.punch(), channel, distance(at, *place))
                        };
                        let direct: f64 = grains.places_mm.iter().zip(contact.solved(depth)).map(of).sum();
                        // The pressure is so small there that no afferent feels it, and falls with the fifth power.
                        let most = if channel == 2 { 0.02 } else { 1e-3 };
                        assert!(
                            (found - direct).abs() <= most * direct.abs(),
                            "{pitch_mm} {at:?} {depth} {channel}: {found} {direct}"
                        );
                    }
                }
            }
        }
    }
}
