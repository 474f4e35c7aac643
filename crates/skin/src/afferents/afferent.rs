//! Afferents of three classes: their parameters, and how deep in the skin they lie.
//!
//! Invariant: the row of an [`Afferent`] is one of its class.

use super::rows::{PARAMETERS, PC, RA, SA1};
use crate::membrane::Position;
use serde::{Deserialize, Serialize};

/// A class of afferents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Class {
    /// Slowly adapting, type 1: Merkel cells. It responds to sustained pressure, too.
    #[serde(rename = "SA1")]
    Sa1,
    /// Rapidly adapting: Meissner corpuscles.
    #[serde(rename = "RA")]
    Ra,
    /// Pacinian corpuscles.
    #[serde(rename = "PC")]
    Pc,
}

impl Class {
    /// All classes, as outputs list them.
    pub const ALL: [Self; 3] = [Self::Sa1, Self::Ra, Self::Pc];

    /// The name in documents.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sa1 => "SA1",
            Self::Ra => "RA",
            Self::Pc => "PC",
        }
    }

    /// The depth of its endings below the surface of the skin, mm (Saal et al. 2017).
    pub const fn depth_mm(self) -> f64 {
        match self {
            Self::Sa1 => 0.3,
            Self::Ra => 1.6,
            Self::Pc => 2.0,
        }
    }

    /// The number of recorded afferents of this class: an afferent has the parameters of one of them.
    pub const fn rows(self) -> usize {
        self.parameters().len()
    }

    const fn parameters(self) -> &'static [[f64; PARAMETERS]] {
        match self {
            Self::Sa1 => &SA1,
            Self::Ra => &RA,
            Self::Pc => &PC,
        }
    }
}

/// An afferent: its class, the row of its parameters, and its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Afferent {
    /// Its class.
    pub class: Class,
    /// The row of its parameters, below [`Class::rows`].
    pub row: u8,
    /// Its place.
    pub at: Position,
}

/// The parameters of a neuron. A sample is 0.2 ms.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameters {
    /// Cutoff of the low-pass filter of both stimuli, Hz.
    pub(super) cutoff_hz: f64,
    /// Weights of the static stimulus: inward, outward.
    pub(super) held: [f64; 2],
    /// Weights of the dynamic stimulus: inward, outward.
    pub(super) moving: [f64; 2],
    /// Weights of the change of the dynamic stimulus per sample: up, down.
    pub(super) changing: [f64; 2],
    /// The limit of the input current for strong stimuli; 0: no limit.
    pub(super) saturation: f64,
    /// SD of the noise that each sample adds to the current.
    pub(super) noise_sd: f64,
    /// Time constant of the membrane, samples.
    pub(super) leak_samples: f64,
    /// Weights of the two currents that follow a spike.
    pub(super) after_spike: [f64; 2],
}

impl Parameters {
    pub(super) fn of(afferent: &Afferent) -> Self {
        Self::of_row(afferent.class, afferent.row.into())
    }

    pub(super) fn of_row(class: Class, row: usize) -> Self {
        let p = class.parameters()[row];
        Self {
            cutoff_hz: 10.0 * p[0],
            held: [p[1], p[2]],
            moving: [p[3], p[4]],
            changing: [p[5], p[6]],
            saturation: p[7],
            noise_sd: p[8],
            leak_samples: p[9],
            after_spike: [p[10], p[11]],
        }
    }
}
