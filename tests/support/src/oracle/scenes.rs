//! The oracle's scenes: plain numbers, and random ones.

use super::Array;

/// A scene to simulate.
#[derive(Clone, Debug)]
pub struct Scene {
    pub array: Array,
    pub duration_s: f64,
    pub drives: Vec<Drive>,
    /// The positions of the afferents, mm.
    pub afferents: Vec<(f64, f64)>,
    pub model: Model,
    /// Per afferent, the addition to the threshold in the interval after the n-th spike. Missing or empty: 0.
    pub offsets: Vec<Vec<f64>>,
}

#[derive(Clone, Copy, Debug)]
pub struct Drive {
    pub motor: usize,
    pub frequency_hz: f64,
    pub amplitude_um: f64,
    pub phase: f64,
    pub start_s: f64,
    pub stop_s: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rectify {
    Half,
    Full,
    Signed,
}

impl Rectify {
    /// The α with which an afferent under the pin fires once per cycle from 10 µm at 40 Hz on.
    pub fn usual_alpha_per_um(self) -> f64 {
        match self {
            Self::Half => 0.0492,
            Self::Full => 0.0277,
            Self::Signed => 0.2016,
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Model {
    pub rectify: Rectify,
    pub alpha_per_um: f64,
    pub tau_s: f64,
    pub refractory_s: f64,
    pub hyperexcitability_s: f64,
    pub hyperexcitability_depth: f64,
    pub sigma_mm: f64,
}

/// SplitMix64, by Steele, Lea and Flood (2014): small and good enough for scenes.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.bits() >> 11) as f64 / 2_f64.powi(53))
    }

    fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.bits() % bound as u64) as usize
    }

    fn chance(&mut self, p: f64) -> bool {
        self.between(0.0, 1.0) < p
    }

    /// Nearly normal: twelve uniform numbers.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.between(-0.5, 0.5)).sum()
    }
}

/// A random scene of the paper's array by its seed: anything that a scene file may contain, within sensible ranges.
pub fn random_scene(seed: u64) -> Scene {
    random_scene_on(Array::paper(), seed)
}

/// A random scene of an array.
pub fn random_scene_on(array: Array, seed: u64) -> Scene {
    let random = &mut Random(seed);
    let duration_s = random.between(0.1, 0.6);
    let rectify = [Rectify::Half, Rectify::Full, Rectify::Signed][random.below(3)];
    let count = array.pins.len();
    let mut motors: Vec<usize> = (0..count).collect();
    for i in (1..count).rev() {
        motors.swap(i, random.below(i + 1));
    }
    if random.chance(0.8) {
        motors.truncate(1 + random.below(count.max(2) - 1));
    }
    let model = Model {
        rectify,
        alpha_per_um: rectify.usual_alpha_per_um() * random.log_between(0.3, 10.0),
        tau_s: random.log_between(0.005, 0.2),
        refractory_s: random.log_between(0.0002, 0.005),
        // One in five has none, one in five one that may well end within refractoriness.
        hyperexcitability_s: match random.below(5) {
            0 => 0.0,
            1 => random.between(0.0, 0.005),
            _ => random.between(0.0, 0.1),
        },
        hyperexcitability_depth: random.between(0.0, 1.0),
        sigma_mm: random.between(0.5, 3.0),
    };
    let drives: Vec<Drive> =
        motors.iter().flat_map(|&motor| random_drives(random, motor, duration_s)).collect();
    let afferents: Vec<_> = (0..=random.below(5)).map(|_| random_afferent(random, &array, &motors)).collect();
    let noise_sd = if random.chance(0.4) { random.between(0.01, 0.3) } else { 0.0 };
    let most_spikes = (duration_s / model.refractory_s) as usize + 3;
    let offsets = if noise_sd > 0.0 { afferents.len() } else { 0 };
    let offsets = (0..offsets).map(|_| (0..most_spikes).map(|_| noise_sd * random.normal()).collect());
    Scene { array, duration_s, drives, model, offsets: offsets.collect(), afferents }
}

/// One drive, or two of which the second begins where the first stops.
fn random_drives(random: &mut Random, motor: usize, duration_s: f64) -> Vec<Drive> {
    let drive = |random: &mut Random, start_s, stop_s| Drive {
        motor,
        frequency_hz: random.log_between(1.0, 1000.0),
        amplitude_um: random.log_between(1.0, 200.0),
        phase: if random.chance(0.2) { 0.0 } else { random.between(0.0, 1.0) },
        start_s,
        stop_s,
    };
    let start_s = if random.chance(0.2) { random.between(0.0, 0.5 * duration_s) } else { 0.0 };
    let stop_s = random.chance(0.3).then(|| random.between(start_s, 1.2 * duration_s));
    let mut drives = vec![drive(random, start_s, stop_s)];
    if let Some(first_stops) = stop_s.filter(|_| random.chance(0.6)) {
        let stop_s = random.chance(0.5).then(|| random.between(first_stops, 1.4 * duration_s));
        drives.push(drive(random, first_stops, stop_s));
    }
    drives
}

/// Half of them anywhere, the others near a pin that moves.
fn random_afferent(random: &mut Random, array: &Array, motors: &[usize]) -> (f64, f64) {
    if random.chance(0.5) {
        return (random.between(-7.0, 7.0), random.between(-9.0, 9.0));
    }
    let (x, y) = array.pins[motors[random.below(motors.len())]];
    (x + random.between(-1.5, 1.5), y + random.between(-1.5, 1.5))
}
