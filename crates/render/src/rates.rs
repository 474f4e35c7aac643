//! The rates of RA and PC afferents that a motion of the skin gives.
//!
//! The dynamic stimulus of an afferent is its skin's velocity ([`meissner_touch`]), so rates follow from velocities, place by place:
//!
//! - RA afferents fire while the skin moves, the more the faster ([`of_ra`]). The table is the mean response of the second model's
//!   rows to ramps of random speeds and lengths, averaged as the paper's motors do.
//! - PC afferents fire when the skin begins to move or stops ([`of_pc`]).
//!
//! The test here prints both beside the means of the second model's rows; the tests of `descent` compare the rates of RA afferents with those of
//! simulated fingers.
//!
//! Both are spikes of one afferent in a step. Real afferents fire in bursts and tire; a mean over places and steps does not see that.

/// Speeds, mm/s, and spikes of an RA afferent in a step of 4 ms.
const RA: [(f64, f64); 13] = [
    (0.0, 0.0),
    (2.0, 0.006),
    (4.0, 0.037),
    (6.0, 0.091),
    (8.0, 0.135),
    (10.0, 0.160),
    (12.0, 0.181),
    (16.0, 0.196),
    (20.0, 0.219),
    (25.0, 0.256),
    (30.0, 0.307),
    (40.0, 0.399),
    (55.0, 0.563),
];

/// Steps per mm/s in the table that is looked up.
const PER_MM_S: f64 = 4.0;

/// A table of spikes by speed.
#[derive(Clone, Debug)]
pub(crate) struct Table {
    spikes: Vec<f64>,
}

impl Table {
    /// The table of RA afferents.
    pub(crate) fn of_ra() -> Self {
        let most = RA[RA.len() - 1].0 * PER_MM_S;
        let spikes = (0..=most as usize).map(|index| {
            let speed = index as f64 / PER_MM_S;
            let above = RA.partition_point(|(known, _)| *known <= speed).clamp(1, RA.len() - 1);
            let ((x0, y0), (x1, y1)) = (RA[above - 1], RA[above]);
            y0 + (y1 - y0) * (speed - x0) / (x1 - x0)
        });
        Self { spikes: spikes.collect() }
    }

    /// The spikes at a speed, and their slope by speed. Beyond the table they stay.
    pub(crate) fn at(&self, speed_mm_s: f64) -> (f64, f64) {
        let place = speed_mm_s * PER_MM_S;
        let below = place as usize;
        let Some([low, high]) = self.spikes.get(below..below + 2) else {
            return (self.spikes[self.spikes.len() - 1], 0.0);
        };
        (low + (high - low) * (place - below as f64), (high - low) * PER_MM_S)
    }
}

/// A change of velocity counts as far as it is more than this many times the lowest speed on its way: speed itself silences PC
/// afferents.
const PC_RATIO: f64 = 3.5;

/// The spikes of a PC afferent whose skin's velocity changes from one step to the next, and their slopes by the two velocities.
pub(crate) fn of_pc(before: f64, now: f64) -> (f64, [f64; 2]) {
    let change_mm_s = now - before;
    // The way leads through rest, or it does not.
    let (lowest, by_lowest) = if before * now <= 0.0 {
        (0.0, [0.0; 2])
    } else if before.abs() < now.abs() {
        (before.abs(), [before.signum(), 0.0])
    } else {
        (now.abs(), [0.0, now.signum()])
    };
    let counts = change_mm_s.abs() - PC_RATIO * lowest;
    if counts <= 0.0 {
        return (0.0, [0.0; 2]);
    }
    let sign = change_mm_s.signum();
    let (spikes, slope) = change(counts);
    (spikes, [slope * (-sign - PC_RATIO * by_lowest[0]), slope * (sign - PC_RATIO * by_lowest[1])])
}

/// Spikes by a change of speed, and the slope: a quarter of the rows answer any change, the others large ones.
fn change(speed: f64) -> (f64, f64) {
    let part = |most: f64, half: f64| {
        let (square, half) = (speed * speed, half * half);
        (most * square / (square + half), 2.0 * most * speed * half / ((square + half) * (square + half)))
    };
    let ((low, low_slope), (high, high_slope)) = (part(0.25, 0.4), part(0.5, 8.0));
    (low + high, low_slope + high_slope)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::levels::STEP_S;
    use meissner_array::random::uniform;
    use meissner_skin::afferents::{
        Afferent, Class, ELASTICITY, POISSON, SAMPLES_PER_S, Stimuli, population, respond,
    };

    const STEPS: usize = 15_000;
    const SAMPLES_PER_STEP: usize = (STEP_S * SAMPLES_PER_S) as usize;
    /// How long the paper's motors average, samples: 4.3 ms.
    const AVERAGED: usize = 21;

    /// The velocity of each step, mm/s: random speeds, either way, for up to eleven steps, or rest.
    fn random_velocities(seed: u64) -> Vec<f64> {
        let mut velocities = Vec::with_capacity(STEPS);
        let mut drawn = 0;
        while velocities.len() < STEPS {
            let [kind, sign] = uniform([seed, drawn, 0, 41]);
            let [speed, length] = uniform([seed, drawn, 1, 41]);
            drawn += 1;
            let speed_mm_s = -10.0 * libm::log(1.0 - speed);
            let velocity = if kind < 0.45 { 0.0 } else { speed_mm_s.copysign(sign - 0.5) };
            velocities.extend(std::iter::repeat_n(velocity, 1 + (11.0 * length) as usize));
        }
        velocities.truncate(STEPS);
        velocities
    }

    /// The mean spikes of a class's rows in each step.
    fn simulated(class: Class, velocities: &[f64], seed: u64) -> Vec<f64> {
        let at = population(1)[0].at;
        let copies = 0..8;
        let rows: Vec<Afferent> = copies
            .flat_map(|_| (0..class.rows()).map(|row| Afferent { class, row: row as u8, at }))
            .collect();
        // The skin's velocity as a rate of spread loads.
        let per_mm_s = ELASTICITY / (1.0 - POISSON * POISSON) / (class.depth_mm() * class.depth_mm());
        let sample = |sample: usize| velocities[sample / SAMPLES_PER_STEP];
        let samples = velocities.len() * SAMPLES_PER_STEP;
        let mean = |last: usize| {
            (0..AVERAGED).filter_map(|back| last.checked_sub(back)).map(sample).sum::<f64>() / AVERAGED as f64
        };
        let moving: Vec<f64> = (0..samples).map(|last| per_mm_s * mean(last)).collect();
        let stimuli = |_: &Afferent| Stimuli { moving: moving.clone(), held: Vec::new() };
        let trains = respond(&rows, samples as u32, Some(seed), &stimuli, &|_| ());
        let mut spikes = vec![0.0; velocities.len()];
        for at_s in trains.iter().flatten() {
            spikes[(at_s / STEP_S) as usize] += 1.0 / rows.len() as f64;
        }
        spikes
    }

    /// The means of what was simulated and of what the function gives, in classes of steps, where there are enough.
    fn means(classes: &[usize], simulated: &[f64], given: &[f64]) -> Vec<Option<[f64; 2]>> {
        let most = classes.iter().copied().max().unwrap_or(0);
        let mut sums = vec![[0.0; 3]; most + 1];
        for (&class, (simulated, given)) in classes.iter().zip(simulated.iter().zip(given)) {
            let [count, of_simulated, of_given] = &mut sums[class];
            *count += 1.0;
            *of_simulated += simulated;
            *of_given += given;
        }
        sums.iter().map(|[count, a, b]| (*count >= 100.0).then_some([a / count, b / count])).collect()
    }

    #[test]
    fn rates_are_those_of_the_second_models_rows() {
        for (class, worst) in [(Class::Ra, 0.05), (Class::Pc, 0.09)] {
            let velocities = random_velocities(1);
            let averaged: Vec<f64> = (0..STEPS)
                .map(|step| f64::midpoint(velocities[step], velocities[step.saturating_sub(1)]))
                .collect();
            let simulated = simulated(class, &velocities, 5);
            let table = Table::of_ra();
            let before = |step: usize| if step == 0 { 0.0 } else { averaged[step - 1] };
            let (given, stimulus): (Vec<f64>, Vec<f64>) = (0..STEPS)
                .map(|step| match class {
                    Class::Ra => (table.at(averaged[step].abs()).0, averaged[step].abs()),
                    _ => (of_pc(before(step), averaged[step]).0, (averaged[step] - before(step)).abs()),
                })
                .unzip();
            let classes: Vec<usize> =
                stimulus.iter().map(|mm_s| (2.0 * libm::log2(1.0 + mm_s)) as usize).collect();
            println!("{}: mm/s, simulated spikes, given spikes", class.name());
            for (number, means) in means(&classes, &simulated, &given).into_iter().enumerate() {
                let Some([simulated, given]) = means else { continue };
                println!("{:6.1} {simulated:.3} {given:.3}", libm::exp2(number as f64 / 2.0) - 1.0);
                assert!((simulated - given).abs() < worst, "{} {number}: {simulated} {given}", class.name());
            }
            let (r, _) = crate::judge::compared(&given, &simulated);
            println!("r {r:.2} step by step");
            assert!(r > 0.5, "{r}");
        }
    }
}
