//! The arguments of `simulate`.

use crate::cli::arguments::{ArrayOption, FITS, Output, choice, positive};
use clap::{Args, ValueEnum};
use meissner_api::Fit;
use meissner_skin::{Integrator, ModelName};
use std::path::PathBuf;

/// The models of skin and afferents.
pub(in crate::cli) const MODELS: &[(&str, &str)] = &[
    ("membrane", "RA afferents with a leaky membrane, Gaussian receptive fields"),
    ("afferents", "Skin under flat pins, and SA1, RA and PC afferents fitted to recordings; steps of 200 us"),
];
/// The default step, µs.
pub(super) const STEP_US: u32 = 200;

#[derive(Debug, Args)]
pub(in crate::cli) struct Simulate {
    /// Simulate this scene: a TOML or JSON file, or - for stdin; or this pattern: a name of the library, or a file
    pub(super) scene: PathBuf,
    /// Choose the model of skin and afferents [default: the scene's key `model`, else membrane]
    #[arg(long, value_parser = choice::<ModelName>(MODELS))]
    pub(super) model: Option<ModelName>,
    /// Choose the method [default: stepped if a step or integrator is given, else exact]
    #[arg(long, value_enum)]
    pub(super) method: Option<Name>,
    /// Take steps of N us [default: 200]
    #[arg(long, value_name = "N")]
    pub(super) step_us: Option<u32>,
    /// Choose how a step is integrated [default: propagator]
    #[arg(long, value_parser = choice::<Integrator>(&[("euler", "Use eq. 2 of the paper: input and leak at the step's start, a spike at its end"), ("propagator", "Use the exact leak, the mean input, and threshold crossings within the step")]))]
    pub(super) integrator: Option<Integrator>,
    /// Simulate a pattern for S seconds: truncate or loop it
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = positive)]
    pub(super) seconds: Option<f64>,
    /// Choose which strokes of a pattern are played at the end
    #[arg(long, default_value = "whole", value_parser = choice::<Fit>(FITS))]
    pub(super) fit: Fit,
    /// Multiply the amplitude of every drive and motion of a pattern by X, 0 to 1
    #[arg(long, value_name = "X", default_value_t = 1.0, allow_negative_numbers = true, value_parser = positive)]
    pub(super) scale: f64,
    /// Simulate a pattern on the fingertip N, with its noise
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    pub(super) seed: u64,
    /// Let steps move pins at most UM um away from what the motors can do of a motion [default: the array's shortest burst]
    #[arg(long, value_name = "UM", allow_negative_numbers = true, value_parser = positive)]
    pub(super) error_um: Option<f64>,
    /// Count spikes without keeping their times
    #[arg(long)]
    pub(super) rates_only: bool,
    /// Print one row per afferent: its class, place, spikes and rate
    #[arg(long, conflicts_with = "json")]
    pub(super) csv: bool,
    #[command(flatten)]
    pub(super) array: ArrayOption,
    #[command(flatten)]
    pub(super) output: Output,
}

impl Simulate {
    /// Whether it asks for a method of the membrane.
    pub(super) const fn names_a_method(&self) -> bool {
        self.method.is_some() || self.step_us.is_some() || self.integrator.is_some()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Name {
    /// Go from event to event, without a step
    Exact,
    /// Go by a fixed step
    Stepped,
}
