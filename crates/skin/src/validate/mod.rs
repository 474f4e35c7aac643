//! Compares both models of the skin with published figures and reference spikes.
//!
//! [`validate`] measures each [`Case`] with both models and judges the result. `probe` moves one pin under afferents of either
//! model, `measure` turns spikes into thresholds, plateaus and areas, `case` judges; the published figures and the tolerances are here.
//!
//! The stimuli are those of the recordings: a sine of a single pin, or a pin pressed in once. There is no noise, so a threshold is
//! a definite amplitude. A figure is the median over the recorded afferents.
//!
//! Invariant: every verdict is computed from the measured number, the published one and the tolerance.
//!
//! # Sources
//!
//! - Freeman & Johnson 1982: thresholds of RA and PC afferents against frequency, 1:1 locking ([the crate](crate) names the paper).
//! - Johansson, Landström & Lundström 1982: R. S. Johansson, U. Landström and R. Lundström, "Responses of mechanoreceptive afferent
//!   units in the glabrous skin of the human hand to sinusoidal skin displacements", *Brain Research* 244, 17-25, 1982.
//! - Muniak et al. 2007: M. A. Muniak, S. Ray, S. S. Hsiao, J. F. Dammann and S. J. Bensmaia, "The neural coding of stimulus intensity:
//!   linking the population response of mechanoreceptive afferents with psychophysical behavior", *Journal of Neuroscience* 27,
//!   11687-11699, 2007.
//! - Vega-Bermudez & Johnson 1999: areas of receptive fields.

mod case;
mod measure;
mod probe;

pub use case::{Case, Finding, Published, Validation, ValidationVerdict};

use crate::ModelName;
use crate::afferents::Class;
use case::Judged;
use measure::{LOCKED, Measured, measure};

const FREEMAN: &str = "Freeman & Johnson 1982";
const JOHANSSON: &str = "Johansson et al. 1982";
const MUNIAK: &str = "Muniak et al. 2007";
const VEGA: &str = "Vega-Bermudez & Johnson 1999";
const SAAL: &str = "Saal et al. 2017";

/// Tolerance of a threshold, as a factor: recorded afferents of one class differ by as much.
const THRESHOLD_FACTOR: f64 = 3.0;
/// The same for areas of receptive fields.
const AREA_FACTOR: f64 = 2.0;
/// Recorded afferents lock over "a wide range" of amplitudes: at least this ratio between the largest and the smallest.
const WIDE: f64 = 2.0;
/// The least share of the rate's variance that the logarithm of the amplitude must explain.
const LOGARITHMIC: f64 = 0.9;

/// Measures both models and judges them. Takes some seconds.
pub fn validate() -> Validation {
    let [membrane, afferents] = measure();
    type Of<'f> = &'f dyn Fn(&Measured) -> Option<f64>;
    // Numbers of both models, or of the second only, because the first has only RA afferents.
    let both = |of: Of<'_>| ([of(&membrane), of(&afferents)], [true, true]);
    let second = |of: Of<'_>| ([None, of(&afferents)], [false, true]);
    let mut cases = Vec::new();
    let mut add = |name: &str, source, unit, published, (found, modelled), says: [&'static str; 2]| {
        // The widths of the first model's fields follow from the recorded areas; the second model's rows come with the spikes.
        let made_from = match (source, unit) {
            (VEGA, "mm2") => Some(ModelName::Membrane),
            (SAAL, _) => Some(ModelName::Afferents),
            _ => None,
        };
        let published_words = match source {
            FREEMAN if name.contains("plateau") || name.contains("per cycle") => {
                Some("1:1 over a wide range")
            }
            MUNIAK if unit == "R2" => Some("grows with the logarithm"),
            _ => None,
        };
        let name = name.to_owned();
        let judged = Judged { name, source, unit, published, published_words, made_from, says };
        cases.push(judged.with(found, modelled));
    };
    use Published::{About, AtLeast, AtMost, Between};
    let tuned = ["tuned too low", "tuned too high"];

    let best = |class: Class| move |of: &Measured| of.best_hz(class);
    let threshold = |class: Class, hz: f64| move |of: &Measured| of.threshold_um(class, hz);
    let sensitivity = ["too sensitive", "not sensitive enough"];
    add(
        "RA: frequency of the lowest threshold",
        FREEMAN,
        "Hz",
        Between(25.0, 50.0),
        both(&best(Class::Ra)),
        tuned,
    );
    add(
        "RA: frequency of the lowest threshold, human",
        JOHANSSON,
        "Hz",
        Between(8.0, 64.0),
        both(&best(Class::Ra)),
        tuned,
    );
    for (hz, um) in [(34.0, 1.0), (10.0, 5.0)] {
        let published = About(um, THRESHOLD_FACTOR);
        add(
            &format!("RA: threshold at {hz} Hz"),
            FREEMAN,
            "um",
            published,
            both(&threshold(Class::Ra, hz)),
            sensitivity,
        );
    }
    let rise = |of: &Measured| Some(of.threshold_um(Class::Ra, 150.0)? / of.threshold_um(Class::Ra, 34.0)?);
    add(
        "RA: threshold at 150 Hz over that at 34 Hz",
        FREEMAN,
        "",
        AtLeast(1.0),
        both(&rise),
        ["too sensitive above 34 Hz", ""],
    );
    add(
        "PC: frequency of the lowest threshold",
        FREEMAN,
        "Hz",
        Between(171.0, 234.0),
        second(&best(Class::Pc)),
        tuned,
    );
    add(
        "PC: frequency of the lowest threshold, human",
        JOHANSSON,
        "Hz",
        AtLeast(64.0),
        second(&best(Class::Pc)),
        tuned,
    );
    let lowest = |of: &Measured| of.threshold_um(Class::Pc, of.best_hz(Class::Pc)?);
    add("PC: lowest threshold", FREEMAN, "um", About(0.04, THRESHOLD_FACTOR), second(&lowest), sensitivity);

    let display = |of: &Measured| of.impulses_per_cycle(60.0, 80.0);
    add(
        "RA: impulses per cycle at 60 Hz and 80 um",
        FREEMAN,
        "",
        Between(1.0 - LOCKED, 1.0 + LOCKED),
        both(&display),
        ["fires less than once per cycle", "fires several times per cycle"],
    );
    for hz in measure::LOCKING_HZ {
        let width = |of: &Measured| of.plateau(hz).map(|(from, to)| to / from);
        let says = ["locks over a narrow range", ""];
        add(
            &format!("RA: width of the 1:1 plateau at {hz} Hz"),
            FREEMAN,
            "times",
            AtLeast(WIDE),
            both(&width),
            says,
        );
    }
    let begins = |of: &Measured| of.plateau(40.0).map(|(from, _)| from);
    add(
        "RA: amplitude at which the plateau at 40 Hz begins",
        MUNIAK,
        "um",
        Between(100.0, 200.0),
        both(&begins),
        ["plateau begins too low", "plateau begins too high"],
    );
    let straight = |of: &Measured| of.logarithmic();
    let says = ["does not grow with the logarithm", ""];
    add(
        "RA: rate under the pin explained by log amplitude, 40 Hz",
        MUNIAK,
        "R2",
        AtLeast(LOGARITHMIC),
        both(&straight),
        says,
    );

    let area = |class: Class, um: f64| move |of: &Measured| of.area_mm2(class, um);
    let size = ["field too small", "field too large"];
    for (um, mm2) in [(50.0, 5.5), (500.0, 22.4)] {
        let published = About(mm2, AREA_FACTOR);
        add(
            &format!("RA: area of the field at {um} um"),
            VEGA,
            "mm2",
            published,
            both(&area(Class::Ra, um)),
            size,
        );
    }
    let ratio = |of: &Measured| Some(of.area_mm2(Class::Sa1, 500.0)? / of.area_mm2(Class::Ra, 500.0)?);
    add(
        "SA1: area of the field over that of RA, 500 um",
        VEGA,
        "",
        AtMost(1.0),
        second(&ratio),
        ["", "SA1 field larger than RA"],
    );

    let same = |of: &Measured| of.reference_share;
    add(
        "share of the 1929 reference spikes at their sample",
        SAAL,
        "",
        AtLeast(1.0),
        second(&same),
        ["spikes differ", ""],
    );

    Validation { cases }
}

#[cfg(test)]
mod tests;
