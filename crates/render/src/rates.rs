//! The rates of RA and PC afferents that a motion of the skin gives.
//!
//! The dynamic stimulus of an afferent is its skin's velocity ([`meissner_touch`]), so rates follow from velocities, place by place:
//!
//! - RA afferents fire while the skin moves, the more the faster ([`of_ra`]). The table is the mean response of the second model's
//!   rows to ramps of random speeds and lengths, averaged as the paper's motors do.
//! - PC afferents fire when the skin begins to move or stops ([`of_pc`]).
//!
//! The tests of `descent` compare the rates of RA afferents with those of simulated fingers.
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
