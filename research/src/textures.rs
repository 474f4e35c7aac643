//! What the motors can carry of a texture that is scanned: the real finger, a finger whose skin moves as the real one as far as a motor can follow,
//! and the finger on the array.

use crate::mean;
use anyhow::{Context, Result};
use meissner_array::random::uniform;
use meissner_array::spec::Array;
use meissner_render::{Judge, Judged, Method, render, response_of};
use meissner_skin::Finger;
use meissner_skin::afferents::{
    Afferent, Class, ELASTICITY, POISSON, SAMPLES_PER_S, Stimuli, respond as spikes,
};
use meissner_touch::{Contact, HeightMap, Object, Pose, Scan, Surface, Touch, displacements_mm, respond};
use serde::Serialize;

/// Speeds of the scan, mm/s.
const SPEEDS_MM_S: [f64; 4] = [20.0, 40.0, 80.0, 120.0];
/// The profile: this many values this far apart.
const VALUES: usize = 300;
const MM_PER_VALUE: f64 = 0.2;
/// Wavelengths of the profile, mm, and its peak to peak, mm.
const WAVELENGTHS_MM: [f64; 2] = [1.0, 6.0];
const PEAK_TO_PEAK_MM: f32 = 0.2;
/// Grains of the texture, mm.
const GRAIN_MM: f64 = 0.4;
/// How far the texture is pressed, mm, and how long the scan lasts, s.
const DEPTH_MM: f64 = 0.4;
const SCAN_S: f64 = 0.4;
/// The first finger of `judge`.
const FIRST_FINGER: u64 = 5000;
/// The number of cosines in the profile.
const WAVES: u64 = 24;

/// What fingers feel of a texture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TextureFigures {
    /// A row per speed and what is felt.
    pub rows: Vec<TextureRow>,
}

/// What fingers feel of a texture, against the real one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TextureRow {
    /// The speed of the scan, mm/s.
    pub speed_mm_s: f64,
    /// What they feel.
    pub felt: &'static str,
    /// The correlation with the blurred real response in windows of 36 ms, RA and PC: means over fingers.
    pub r: [f64; 2],
    /// The size of the difference over that of the real response.
    pub errors: [f64; 2],
    /// Spikes over the real ones.
    pub spikes: [f64; 2],
}

/// Scans a rough profile at several speeds.
///
/// # Errors
/// If it cannot be touched or played.
pub fn texture_figures(fingers: u64) -> Result<TextureFigures> {
    let rows = SPEEDS_MM_S.map(|speed_mm_s| of_speed(speed_mm_s, fingers));
    Ok(TextureFigures { rows: rows.into_iter().collect::<Result<Vec<_>>>()?.concat() })
}

/// A sum of cosines of random wavelengths and phases, their amplitude as their wavelength.
fn profile() -> Option<HeightMap> {
    let waves: Vec<[f64; 3]> = (0..WAVES)
        .map(|wave| {
            let [length, phase] = uniform([wave, 0, 0, 83]);
            let [shortest, longest] = WAVELENGTHS_MM;
            let length_mm = shortest * libm::pow(longest / shortest, length);
            [length_mm, std::f64::consts::TAU / length_mm, std::f64::consts::TAU * phase]
        })
        .collect();
    let height = |index: usize| {
        let at_mm = index as f64 * MM_PER_VALUE;
        waves.iter().map(|[size, per_mm, phase]| size * libm::cos(per_mm * at_mm + phase)).sum::<f64>() as f32
    };
    let heights: Vec<f32> = (0..VALUES).map(height).collect();
    let (low, high) = heights.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), height| {
        (low.min(*height), high.max(*height))
    });
    let scaled = heights.iter().map(|height| (height - low) / (high - low) * PEAK_TO_PEAK_MM).collect();
    HeightMap::new([VALUES, 1], [MM_PER_VALUE, 30.0], scaled)
}

fn of_speed(speed_mm_s: f64, fingers: u64) -> Result<Vec<TextureRow>> {
    let map = profile().context("a profile of finite heights")?;
    let scan =
        Scan { depth_mm: DEPTH_MM, rise_s: 0.05, speed_mm_s, direction_deg: 0.0, duration_s: SCAN_S + 0.05 };
    let object = Object::new("texture", Surface::Map(map), Touch::scan(Pose::default(), scan)?);
    let touch = object.touch();
    let contact = Contact::new(object.grains(GRAIN_MM), DEPTH_MM)?;
    let array = Array::paper();
    let pattern =
        render(array, &contact, touch, Method::Auto).pattern(array, "texture", toml::Table::new())?;
    let seconds = touch.duration_s();
    let mm_per_s = array.motor().um_per_pulse * f64::from(array.rate().hz()) / 1e3;
    let averaged_s = array.motor().window_ticks() / f64::from(array.rate().hz());
    let averaged = (averaged_s * SAMPLES_PER_S).round() as usize;
    let mut judged: [Vec<Judged>; 4] = Default::default();
    for seed in FIRST_FINGER..FIRST_FINGER + fingers {
        let finger = Finger::new(seed);
        let real_s = respond(&contact, touch, finger.afferents(), Some(0), &|_| ());
        let judge = Judge::new(&finger, &real_s, seconds);
        judged[0].push(judge.compare(&respond(&contact, touch, finger.afferents(), Some(1), &|_| ())));
        for (limit, fastest) in [f64::INFINITY, mm_per_s].into_iter().enumerate() {
            judged[1 + limit]
                .push(judge.compare(&through_motors(&finger, &contact, touch, averaged, fastest)));
        }
        judged[3].push(judge.compare(&response_of(&finger, &pattern, seconds, 2)?));
    }
    let names = ["the texture again", "averaged by the motor", "and no faster than it", "render auto"];
    let row = |(felt, judged): (&'static str, &Vec<Judged>)| {
        let of = |value: &dyn Fn(&Judged) -> [f64; 3]| {
            [1, 2].map(|class| mean(judged.iter().map(|judged| value(judged)[class])))
        };
        let (r, errors) = (of(&|judged| judged.r_by_class), of(&|judged| judged.error_by_class));
        TextureRow { speed_mm_s, felt, r, errors, spikes: of(&|judged| judged.spikes) }
    };
    Ok(names.into_iter().zip(&judged).map(row).collect())
}

/// The spikes of a finger whose skin at each afferent moves as under the object, as far as one motor of its own could move it: no faster than so many
/// mm/s, and averaged over so many samples.
fn through_motors(
    finger: &Finger,
    contact: &Contact,
    touch: &Touch,
    averaged: usize,
    fastest: f64,
) -> Vec<Vec<f64>> {
    let samples = (touch.duration_s() * SAMPLES_PER_S).round() as usize;
    let times_s: Vec<f64> = (0..samples).map(|sample| sample as f64 / SAMPLES_PER_S).collect();
    let places: Vec<[f64; 2]> =
        finger.afferents().iter().map(|afferent| [afferent.at.x_mm, afferent.at.y_mm]).collect();
    let asked = displacements_mm(contact, touch, &places, &times_s);
    let moving = |class: Class, asked: &Vec<f64>| {
        let mut at_mm = 0.0;
        let velocities: Vec<f64> = asked
            .iter()
            .map(|asked| {
                let most = fastest / SAMPLES_PER_S;
                let by: f64 = (asked - at_mm).clamp(-most, most);
                at_mm += by;
                by * SAMPLES_PER_S
            })
            .collect();
        let squared = class.depth_mm() * class.depth_mm();
        let per_mm_s = ELASTICITY / (1.0 - POISSON * POISSON) / squared;
        let mut sum = 0.0;
        let of_sample = |sample: usize| {
            sum += velocities[sample] - sample.checked_sub(averaged).map_or(0.0, |old| velocities[old]);
            per_mm_s * sum / averaged as f64
        };
        (0..samples).map(of_sample).collect()
    };
    let by_place: Vec<Vec<f64>> = finger
        .afferents()
        .iter()
        .zip(&asked)
        .map(|(afferent, asked)| moving(afferent.class, asked))
        .collect();
    let stimuli = |afferent: &Afferent| {
        let number = finger.afferents().iter().position(|other| other == afferent);
        Stimuli {
            moving: number.map(|number| by_place[number].clone()).unwrap_or_default(),
            held: Vec::new(),
        }
    };
    spikes(finger.afferents(), samples as u32, Some(2), &stimuli, &|_| ())
}
