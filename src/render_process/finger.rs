//! The finger of renderings and previews, and its spikes as the API has them.

use crate::rendering::FIRST_FINGER;
use meissner_skin::Finger;

/// Added to the seed of the noise when the finger feels a pattern, as in `meissner judge`.
pub(super) const OF_PATTERN: u64 = 2;

/// The first finger of `meissner judge`.
pub(super) fn finger() -> Finger {
    Finger::new(FIRST_FINGER)
}

/// The place of each afferent, mm, and the name of its class.
pub(super) fn afferents(finger: &Finger) -> (Vec<[f64; 2]>, Vec<String>) {
    let of = |of: &meissner_skin::afferents::Afferent| ([of.at.x_mm, of.at.y_mm], of.class.name().to_owned());
    finger.afferents().iter().map(of).unzip()
}

/// The spikes from one time until before another, s, to 0.1 ms.
pub(super) fn piece(spikes_s: &[Vec<f64>], from_s: f64, until_s: f64) -> Vec<Vec<f64>> {
    let is_in = |at_s: &&f64| (from_s..until_s).contains(*at_s);
    let rounded = |at_s: &f64| (at_s * 1e4).round() / 1e4;
    spikes_s.iter().map(|train| train.iter().filter(is_in).map(rounded).collect()).collect()
}
