//! The spikes of afferents under an object.
//!
//! The dynamic stimulus of an afferent is the rate of the loads spread over the skin, each with the delay of its wave, over the square
//! of the afferent's depth; the static stimulus of SA1 afferents is the pressure there. For an object that stays in place this is, term
//! by term, what the second model of [`meissner_skin`] computes for pins, and delays are its whole samples.
//!
//! For an object that moves, the spread loads at the afferent change because the object passes. Waves then arrive with the mean delay
//! of all loads: the stimulus at a time is the rate of what left the loads so long before. Objects are more than ten times slower than waves, so the
//! spread of delays about their mean hardly matters.
//!
//! The neurons are those of [`meissner_skin::afferents::respond`].

use crate::contact::{Contact, distance};
use crate::field::Field;
use crate::skin::reach;
use crate::timeline::Timeline;
use crate::touch::Touch;
use meissner_skin::afferents::{Afferent, Class, SAMPLES_PER_S, Stimuli, respond as spikes};

/// The times of each afferent's spikes, s, through a touch. An afferent's place in the list keys its noise; without `noise_seed`
/// there is none. `progress` is called now and then with the completed share.
pub fn respond(
    contact: &Contact,
    touch: &Touch,
    afferents: &[Afferent],
    noise_seed: Option<u64>,
    progress: &(dyn Fn(f64) + Sync),
) -> Vec<Vec<f64>> {
    let samples = (touch.duration_s() * SAMPLES_PER_S).round() as u32;
    let timeline =
        Timeline::new(contact, touch, (0..samples).map(|sample| f64::from(sample) / SAMPLES_PER_S));
    if touch.stays_in_place() {
        let rates = depth_rates(contact, &timeline);
        let stimuli = |afferent: &Afferent| in_place(contact, &timeline, &rates, afferent);
        spikes(afferents, samples, noise_seed, &stimuli, progress)
    } else {
        let places = afferents.iter().map(|afferent| [afferent.at.x_mm, afferent.at.y_mm]);
        let field = Field::<3>::new(contact, reach(&timeline, places));
        let stimuli = |afferent: &Afferent| moving(&field, &timeline, afferent);
        spikes(afferents, samples, noise_seed, &stimuli, progress)
    }
}

/// The rate at a sample of what `at` gives by sample, as in a scene of pins: from the sample before to the one after; the first and
/// the last sample have one neighbour.
fn rate(at: impl Fn(usize) -> f64, sample: usize, samples: usize) -> f64 {
    let (before, after) = (sample.saturating_sub(1), (sample + 1).min(samples - 1));
    match after - before {
        0 => 0.0,
        apart => (at(after) - at(before)) * (SAMPLES_PER_S / apart as f64),
    }
}

/// By sample: the solved depths whose weights change, and their rates.
fn depth_rates(contact: &Contact, timeline: &Timeline) -> Vec<Vec<(usize, f64)>> {
    let weight = |sample: usize, depth: usize| {
        let found = timeline.weights[sample].iter().flatten().find(|(number, _)| *number == depth);
        found.map_or(0.0, |(_, weight)| *weight)
    };
    let of = |sample: usize| {
        let rates = (0..contact.depths())
            .map(|depth| (depth, rate(|sample| weight(sample, depth), sample, timeline.len())));
        rates.filter(|(_, rate)| *rate != 0.0).collect()
    };
    (0..timeline.len()).map(of).collect()
}

/// The stimuli under an object that stays in place.
fn in_place(
    contact: &Contact,
    timeline: &Timeline,
    rates: &[Vec<(usize, f64)>],
    afferent: &Afferent,
) -> Stimuli {
    let Some(frame) = timeline.frames.first() else { return Stimuli::default() };
    let (grains, punch, depths) = (contact.grains(), contact.grains().punch(), contact.depths());
    let depth_mm = afferent.class.depth_mm();
    let is_held = afferent.class == Class::Sa1;
    let at = frame.inward([afferent.at.x_mm, afferent.at.y_mm]);
    // The sum of the loads by delay and solved depth, and of the pressures by solved depth.
    let (mut by_delay, mut pressures): (Vec<Vec<f64>>, _) = (Vec::new(), vec![0.0; depths]);
    for (grain, place) in grains.places_mm.iter().enumerate() {
        let distance_mm = distance(at, *place);
        let delay = usize::from(punch.delay(distance_mm));
        if by_delay.len() <= delay {
            by_delay.resize(delay + 1, vec![0.0; depths]);
        }
        let spread = punch.spread(distance_mm) / (depth_mm * depth_mm);
        let pressure = if is_held { punch.pressure(distance_mm, depth_mm) } else { 0.0 };
        for (depth, (spreads, pressures)) in by_delay[delay].iter_mut().zip(&mut pressures).enumerate() {
            let load = contact.solved(depth)[grain];
            *spreads += spread * load;
            *pressures += pressure * load;
        }
    }
    let mut moving = vec![0.0; timeline.len()];
    for (sample, rates) in rates.iter().enumerate() {
        for &(depth, rate) in rates {
            for (moving, spreads) in moving[sample..].iter_mut().zip(&by_delay) {
                *moving += spreads[depth] * rate;
            }
        }
    }
    let pressure = |weights: &[Option<(usize, f64)>; 4]| {
        weights.iter().flatten().map(|&(depth, weight)| weight * pressures[depth]).sum()
    };
    let held = if is_held { timeline.weights.iter().map(pressure).collect() } else { Vec::new() };
    Stimuli { moving, held }
}

/// The stimuli under an object that moves.
fn moving(field: &Field<3>, timeline: &Timeline, afferent: &Afferent) -> Stimuli {
    let at = [afferent.at.x_mm, afferent.at.y_mm];
    let samples = timeline.len();
    let (mut spread, mut lags, mut held) =
        (Vec::with_capacity(samples), Vec::with_capacity(samples), Vec::new());
    for (frame, weights) in timeline.frames.iter().zip(&timeline.weights) {
        let [spread_here, delayed, pressure] = field.at(frame.inward(at), weights);
        spread.push(spread_here);
        lags.push(if spread_here > 0.0 { (delayed / spread_here).max(0.0) } else { 0.0 });
        if afferent.class == Class::Sa1 {
            held.push(pressure);
        }
    }
    let arrived: Vec<f64> = lags
        .iter()
        .enumerate()
        .map(|(sample, lag)| {
            let left = (sample as f64 - lag).max(0.0);
            let (from, share) = (left.floor() as usize, left - left.floor());
            let to = (from + 1).min(samples - 1);
            spread[from] + share * (spread[to] - spread[from])
        })
        .collect();
    let squared = afferent.class.depth_mm() * afferent.class.depth_mm();
    let moving =
        (0..samples).map(|sample| rate(|sample| arrived[sample], sample, samples) / squared).collect();
    Stimuli { moving, held }
}
