//! A [`Scene`] of the second model, and its checks.
//!
//! Invariant: every scene has been checked: each number is finite and within its range, the loads of the pins can be told
//! apart, and an afferent's row is one of its class.

use super::SAMPLES_PER_S;
use super::afferent::Afferent;
use super::contact::{Contact, FlatPins};
use super::punch::Punch;
use crate::membrane::Position;
use crate::ramps::Ramps;
use crate::scene::{Problem, check_drives};
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_input::document::{self, in_range};
use std::sync::Arc;

/// Indentation of the skin by the pins under the finger's weight, mm (C).
pub const PREINDENT_MM: f64 = 0.5;
/// The most pins that move by a formula.
pub const MAX_PINS: usize = 256;
/// The longest scene, s: its samples are counted in 32 bits.
const MAX_DURATION_S: f64 = 100_000.0;
/// Half the sampling rate: a faster vibration would alias to a slower one.
const MAX_FREQUENCY_HZ: f64 = SAMPLES_PER_S / 2.0;
const MAX_PLACE_MM: f64 = 1000.0;

type KeyError = document::KeyError<Problem>;

/// A checked scene of the second model.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    pub(super) array: Array,
    pub(super) duration_s: f64,
    pub(super) seed: u64,
    pub(super) preindent_mm: f64,
    pub(super) noise: bool,
    pub(super) pins: Pins,
    pub(super) afferents: Arc<Vec<Afferent>>,
    /// Whether the afferents are a file's population.
    pub(super) population: bool,
}

/// The pins under the finger.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Pins {
    /// Pins that are pressed in during `ramp_s`, and vibrate by a formula from `begin_s` on.
    Sines { pins: Vec<SinePin>, ramp_s: f64, begin_s: f64 },
    /// All pins of the array, pressed in long before. Motors with these drives move them.
    Drives(Vec<Drive>),
    /// All pins of the array, pressed in long before. The bursts that motors made move them.
    Ramps(Ramps),
}

/// A pin that moves by a formula: its height above the pressed-in position is `amplitude/2 · (cos 2πφ − cos 2π(f·t + φ))`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SinePin {
    /// Its place along x, mm.
    pub x_mm: f64,
    /// Its place along y, mm.
    pub y_mm: f64,
    /// Frequency, Hz, at most half the sampling rate.
    pub frequency_hz: f64,
    /// Amplitude, µm peak to peak.
    pub amplitude_um: f64,
    /// Phase, cycles.
    pub phase: f64,
}

impl Scene {
    /// The scene with other afferents. Their numbers key the noise.
    ///
    /// # Errors
    /// The first thing that is wrong with them, by the key it would have in a file.
    pub fn with_afferents(&self, afferents: Vec<Afferent>) -> Result<Self, document::DocumentError<Problem>> {
        Self { afferents: Arc::new(afferents), population: false, ..self.clone() }
            .checked()
            .map_err(|fault| fault.in_file(None))
    }

    /// The scene with another indentation of the skin by pins at rest, mm.
    ///
    /// # Errors
    /// If it is out of range.
    pub fn with_preindent_mm(&self, preindent_mm: f64) -> Result<Self, document::DocumentError<Problem>> {
        Self { preindent_mm, ..self.clone() }.checked().map_err(|fault| fault.in_file(None))
    }

    /// A scene of the bursts of motors, for their first `duration_s`, with noise. `seed` is that of the noise.
    ///
    /// # Errors
    /// The first thing that is wrong with it, by the key it would have in a file.
    pub fn of_ramps(
        ramps: &Ramps,
        duration_s: f64,
        seed: u64,
        preindent_mm: f64,
        afferents: Vec<Afferent>,
    ) -> Result<Self, document::DocumentError<Problem>> {
        Self {
            array: ramps.array(),
            duration_s,
            seed,
            preindent_mm,
            noise: true,
            pins: Pins::Ramps(ramps.clone()),
            afferents: Arc::new(afferents),
            population: false,
        }
        .checked()
        .map_err(|fault| fault.in_file(None))
    }

    /// The array under the finger. Pins that move by a formula have places of their own, and its pins' radius.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// Duration, s.
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// The afferents, in the file's order.
    pub fn afferents(&self) -> &[Afferent] {
        &self.afferents
    }

    /// The indentation of the skin by pins at rest, mm.
    pub const fn preindent_mm(&self) -> f64 {
        self.preindent_mm
    }

    /// Whether the currents have noise.
    pub const fn noise(&self) -> bool {
        self.noise
    }

    /// Whether its file asked for the population of a fingertip.
    pub const fn has_population(&self) -> bool {
        self.population
    }

    /// Impulses per second of an afferent with `count` spikes; 0 in a scene without duration.
    pub fn rate_hz(&self, count: u64) -> f64 {
        if count == 0 { 0.0 } else { count as f64 / self.duration_s }
    }

    pub(super) const fn pins(&self) -> &Pins {
        &self.pins
    }

    /// All pins that touch the skin.
    pub(super) fn flat_pins(&self) -> FlatPins {
        let places = match &self.pins {
            Pins::Sines { pins, .. } => {
                pins.iter().map(|pin| Position { x_mm: pin.x_mm, y_mm: pin.y_mm }).collect()
            }
            Pins::Drives(_) | Pins::Ramps(_) => {
                self.array.positions_mm().iter().map(|&[x_mm, y_mm]| Position { x_mm, y_mm }).collect()
            }
        };
        FlatPins { places, punch: Punch { radius_mm: self.array.pin_radius_mm() } }
    }

    /// The number of samples: those with a time below the duration.
    pub(super) fn samples(&self) -> u64 {
        let samples = self.duration_s * SAMPLES_PER_S;
        // A duration of whole samples may be rounded up by its last bit.
        let whole = samples.round();
        if (samples - whole).abs() < 1e-6 { whole as u64 } else { samples.ceil() as u64 }
    }

    pub(super) fn checked(self) -> Result<Self, KeyError> {
        let range = |key: &str, found: f64, most: f64, range: &'static str| {
            in_range(key, found, (0.0..=most).contains(&found), range)
        };
        range("duration_s", self.duration_s, MAX_DURATION_S, "0 to 100000 s with the model afferents")?;
        let pressed = (-10.0..=10.0).contains(&self.preindent_mm);
        in_range("preindent_mm", self.preindent_mm, pressed, "-10 to 10 mm")?;
        if let Pins::Drives(drives) = &self.pins {
            check_drives(self.array, drives)?;
        }
        if let Pins::Sines { pins, ramp_s, begin_s } = &self.pins {
            range("ramp_s", *ramp_s, MAX_DURATION_S, "0 to 100000 s")?;
            range("begin_s", *begin_s, MAX_DURATION_S, "0 to 100000 s")?;
            if pins.len() > MAX_PINS {
                return Err(KeyError::key("pins", Problem::ManyPins { pins: pins.len(), most: MAX_PINS }));
            }
            for (index, pin) in pins.iter().enumerate() {
                check_pin(pin).map_err(|fault| fault.within(&format!("pins[{index}]")))?;
            }
            check_apart(&self.flat_pins())?;
        }
        for (index, afferent) in self.afferents.iter().enumerate() {
            let Afferent { class, row, at } = *afferent;
            let checked = check_place(at.x_mm, at.y_mm).and_then(|()| {
                if usize::from(row) < class.rows() {
                    return Ok(());
                }
                let problem = Problem::Row { row: row.into(), class: class.name(), most: class.rows() - 1 };
                Err(KeyError::key("row", problem))
            });
            checked.map_err(|fault| fault.within(&format!("afferents[{index}]")))?;
        }
        Ok(self)
    }
}

fn check_pin(pin: &SinePin) -> Result<(), KeyError> {
    let SinePin { x_mm, y_mm, frequency_hz, amplitude_um, phase } = *pin;
    check_place(x_mm, y_mm)?;
    let slow = (0.0..=MAX_FREQUENCY_HZ).contains(&frequency_hz);
    in_range("frequency_hz", frequency_hz, slow, "0 to 2500 Hz, half the sampling rate")?;
    in_range(
        "amplitude_um",
        amplitude_um,
        (0.0..=1e6).contains(&amplitude_um),
        "0 to 1000000 um peak to peak",
    )?;
    in_range("phase", phase, phase.abs() <= 1000.0, "-1000 to 1000 cycles")
}

fn check_place(x_mm: f64, y_mm: f64) -> Result<(), KeyError> {
    for (key, found) in [("x_mm", x_mm), ("y_mm", y_mm)] {
        in_range(key, found, found.abs() <= MAX_PLACE_MM, "-1000 to 1000 mm with the model afferents")?;
    }
    Ok(())
}

/// Refuses pins whose loads cannot be told apart.
fn check_apart(pins: &FlatPins) -> Result<(), KeyError> {
    let FlatPins { places, punch: Punch { radius_mm } } = pins;
    for (second, at) in places.iter().enumerate() {
        let near = |other: &Position| other.distance_mm(*at) <= *radius_mm;
        if let Some(first) = places[..second].iter().position(near) {
            let problem = Problem::SamePlace { first, radius_mm: *radius_mm };
            return Err(KeyError::key(&format!("pins[{second}]"), problem));
        }
    }
    match Contact::new(pins) {
        Some(_) => Ok(()),
        None => Err(KeyError::key("pins", Problem::Crowded)),
    }
}
