//! What a receptor under a pin makes of amplitude and frequency.
//!
//! The paper remarks that the amplitude does not matter much. Rate against amplitude, for some frequencies, says where that
//! holds and where not; rate against frequency, for two amplitudes, where receptors fire most. Receptors are simulated
//! exactly; each draws its own threshold noise, and the mean over them is shown.
//!
//! Invariant: what the page says in numbers is found in the numbers that are drawn.

use super::chart::{Axis, Chart, Dot, Scale, Series, draw};
use super::page::Section;
use super::table::{number, table};
use super::{FiguresError, Parts, mean_and_sd};
use firmware_protocol::tick::TICK_HZ;
use meissner_array::geometry;
use meissner_array::pattern::{AMPLITUDE_UM, Drive};
use meissner_array::units::UM_PER_PULSE;
use meissner_skin::afferent::{AfferentModel, POPULATION_NOISE_SD, Position, Rectify};
use meissner_skin::{Method, Options, Scene, simulate};
use plotters::chart::SeriesLabelPosition;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write;

/// Whose pin the receptors lie under; its neighbours rest.
const MOTOR: u8 = 9;
const RECEPTORS: usize = 8;
const DURATION_S: f64 = 1.0;
const SEED: u64 = 0;
/// Frequencies whose rates are drawn against the amplitude, Hz.
const FREQUENCIES_HZ: [f64; 6] = [10.0, 20.0, 30.0, 60.0, 100.0, 150.0];
/// Between amplitudes, µm; the first is one, the last a pattern's largest.
const STEP_UM: f64 = 5.0;
/// Amplitudes whose rates are drawn against the frequency, µm: the paper's, and one that saturates at none of the
/// frequencies at which receptors fire most.
const AMPLITUDES_UM: [f64; 2] = [30.0, 80.0];
/// 5 to 300 Hz, by 1.
const SWEPT_HZ: std::ops::RangeInclusive<u32> = 5..=300;
/// Rates that differ by less are the same, as a share of the larger.
const SAME: f64 = 0.10;
/// Rates so near to the peak belong to it, as a share of it.
const NEAR_PEAK: f64 = 0.03;

/// A simulated rate.
#[derive(Clone, Copy, Debug)]
struct Row {
    frequency_hz: f64,
    amplitude_um: f64,
    rate_hz: f64,
    sd_hz: f64,
}

/// What the figures come to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rate {
    /// One for each frequency.
    pub by_amplitude: Vec<Plateau>,
    /// One for each amplitude.
    pub by_frequency: Vec<Peak>,
}

/// Amplitudes that do not matter much, at one frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Plateau {
    /// The frequency.
    pub frequency_hz: f64,
    /// From here on the drive is a triangle that no amplitude makes larger.
    pub saturated_from_um: f64,
    /// The widest range of amplitudes in which the rate is above 0 and changes by less than 10 %: from here ...
    pub from_um: f64,
    /// ... to here.
    pub to_um: f64,
    /// Lowest rate in that range, impulses/s.
    pub lowest_hz: f64,
    /// Highest rate in that range, impulses/s.
    pub highest_hz: f64,
    /// Rate at the smallest amplitude, impulses/s.
    pub first_hz: f64,
}

/// Where receptors fire most, at one amplitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peak {
    /// The amplitude.
    pub amplitude_um: f64,
    /// The frequency of the highest rate.
    pub frequency_hz: f64,
    /// That rate, impulses/s.
    pub rate_hz: f64,
    /// Around it the rate is within 3 % of the highest: from here ...
    pub from_hz: f64,
    /// ... to here.
    pub to_hz: f64,
}

/// Simulates, draws, and says what it comes to.
pub(super) fn section(progress: &(dyn Fn(f64) + Sync)) -> Result<(Section, Rate), FiguresError> {
    let last_um = *AMPLITUDE_UM.end();
    let steps = (1..).map(|n| f64::from(n) * STEP_UM).take_while(|um| *um <= last_um);
    let amplitudes: Vec<f64> = steps.collect();
    let by_amplitude = FREQUENCIES_HZ.iter().flat_map(|&hz| amplitudes.iter().map(move |&um| (hz, um)));
    let by_frequency = AMPLITUDES_UM.iter().flat_map(|&um| SWEPT_HZ.map(move |hz| (f64::from(hz), um)));
    let asked: Vec<(f64, f64)> = by_amplitude.chain(by_frequency).collect();
    let parts = Parts::new(asked.len(), progress);
    let rows = asked.into_par_iter().map(|(frequency_hz, amplitude_um)| {
        let row = row(frequency_hz, amplitude_um);
        parts.done();
        row
    });
    let mut by_amplitude = rows.collect::<Result<Vec<_>, FiguresError>>()?;
    let by_frequency = by_amplitude.split_off(FREQUENCIES_HZ.len() * amplitudes.len());
    let figures = Rate {
        by_amplitude: by_amplitude.chunks(amplitudes.len()).filter_map(plateau).collect(),
        by_frequency: by_frequency.chunks(SWEPT_HZ.count()).filter_map(peak).collect(),
    };

    let mut section = Section::new("rate", "Impulse rate of a receptor under a pin");
    let what = format!(
        "Mean of {RECEPTORS} receptors under the pin of motor {MOTOR}, simulated exactly for {} s (noise seed {SEED}, SD \
         {POPULATION_NOISE_SD} of the threshold, indentation only), all other motors off.",
        number(DURATION_S)
    );
    let caption = format!("Impulse rate against amplitude, for {} frequencies. {what}", FREQUENCIES_HZ.len());
    let drawn = by_amplitude_plot(&by_amplitude)?;
    let numbers = csv("frequency_hz,amplitude_um", &by_amplitude, |row| (row.frequency_hz, row.amplitude_um));
    section.figure("rate-amplitude", drawn, Some(numbers), &caption, "meissner report");
    for plateau in figures.by_amplitude.iter().filter(|plateau| plateau.frequency_hz == 60.0) {
        section.say(&remark(plateau));
    }
    section.table("Where the amplitude does not matter much", &plateaus(&figures.by_amplitude));

    let peaks = figures.by_frequency.iter().map(|peak| {
        format!(
            "at {} µm the rate is highest at {} Hz, {} impulses/s, and within 3 % of that from {} to {} Hz",
            number(peak.amplitude_um),
            number(peak.frequency_hz),
            number(peak.rate_hz),
            number(peak.from_hz),
            number(peak.to_hz)
        )
    });
    let peaks = peaks.collect::<Vec<_>>().join("; ");
    let caption = format!("Impulse rate against frequency: {peaks}. {what}");
    let drawn = by_frequency_plot(&by_frequency)?;
    let numbers = csv("amplitude_um,frequency_hz", &by_frequency, |row| (row.amplitude_um, row.frequency_hz));
    section.figure("rate-frequency", drawn, Some(numbers), &caption, "meissner report");
    Ok((section, figures))
}

fn row(frequency_hz: f64, amplitude_um: f64) -> Result<Row, FiguresError> {
    let [x_mm, y_mm] = geometry::position_mm(MOTOR);
    let drive = Drive { motor: MOTOR, frequency_hz, amplitude_um, phase: 0.0, start_s: None, stop_s: None };
    let receptors = vec![Position { x_mm, y_mm }; RECEPTORS];
    let model = AfferentModel::default_for(Rectify::Half, POPULATION_NOISE_SD);
    let scene = Scene::new(DURATION_S, SEED, vec![drive], receptors, model)?;
    let answer = simulate(&scene, &Options::rates(Method::Exact), &|_| ())?;
    let (rate_hz, sd_hz) = mean_and_sd(&answer.rates_hz(&scene));
    Ok(Row { frequency_hz, amplitude_um, rate_hz, sd_hz })
}

/// The widest range of a frequency's amplitudes with nearly the same rate.
fn plateau(rows: &[Row]) -> Option<Plateau> {
    let mut widest: Option<Plateau> = None;
    for (index, first) in rows.iter().enumerate() {
        let (mut lowest_hz, mut highest_hz) = (first.rate_hz, first.rate_hz);
        for row in &rows[index..] {
            (lowest_hz, highest_hz) = (lowest_hz.min(row.rate_hz), highest_hz.max(row.rate_hz));
            if lowest_hz <= 0.0 || highest_hz - lowest_hz >= SAME * highest_hz {
                break;
            }
            if widest
                .is_none_or(|widest| row.amplitude_um - first.amplitude_um > widest.to_um - widest.from_um)
            {
                widest = Some(Plateau {
                    frequency_hz: row.frequency_hz,
                    saturated_from_um: UM_PER_PULSE * f64::from(TICK_HZ) / 2.0 / row.frequency_hz,
                    from_um: first.amplitude_um,
                    to_um: row.amplitude_um,
                    lowest_hz,
                    highest_hz,
                    first_hz: rows[0].rate_hz,
                });
            }
        }
    }
    widest
}

fn peak(rows: &[Row]) -> Option<Peak> {
    // Of equal ones the first.
    let highest = rows.iter().map(|row| row.rate_hz).fold(f64::NEG_INFINITY, f64::max);
    let at = rows.iter().position(|row| row.rate_hz == highest)?;
    let near = |row: &&Row| row.rate_hz >= highest * (1.0 - NEAR_PEAK);
    let from = rows[..at].iter().rev().take_while(near).last().unwrap_or(&rows[at]);
    let to = rows[at..].iter().take_while(near).last().unwrap_or(&rows[at]);
    Some(Peak {
        amplitude_um: rows[at].amplitude_um,
        frequency_hz: rows[at].frequency_hz,
        rate_hz: highest,
        from_hz: from.frequency_hz,
        to_hz: to.frequency_hz,
    })
}

/// MethodLabel far the paper's remark holds, in a sentence of computed numbers.
fn remark(plateau: &Plateau) -> String {
    let Plateau { frequency_hz, saturated_from_um, from_um, to_um, lowest_hz, highest_hz, first_hz } =
        *plateau;
    format!(
        "The paper remarks that the amplitude does not affect much. At {} Hz the rate changes by less than {} % between \
         {} and {} µm ({} to {} impulses/s); the drive saturates from {} µm on, beyond which the motor does the same \
         whatever is asked. Below that range it matters: at {} µm the rate is {} impulses/s.",
        number(frequency_hz),
        number(SAME * 100.0),
        number(from_um),
        number(to_um),
        number(lowest_hz),
        number(highest_hz),
        number(saturated_from_um),
        number(STEP_UM),
        number(first_hz),
    )
}

fn plateaus(plateaus: &[Plateau]) -> String {
    let head = [
        "frequency, Hz",
        "rate changes by less than 10 % from, µm",
        "to, µm",
        "lowest there, impulses/s",
        "highest there, impulses/s",
        "drive saturates from, µm",
    ];
    let row = |plateau: &Plateau| {
        let Plateau { frequency_hz, saturated_from_um, from_um, to_um, lowest_hz, highest_hz, .. } = *plateau;
        [frequency_hz, from_um, to_um, lowest_hz, highest_hz, saturated_from_um].map(number).to_vec()
    };
    table(&head, plateaus.iter().map(row))
}

fn csv(keys: &str, rows: &[Row], of: impl Fn(&Row) -> (f64, f64)) -> String {
    let mut csv = format!("{keys},rate_hz,rate_sd_hz\n");
    for row in rows {
        let (first, second) = of(row);
        // Writing to a string does not fail.
        let _ = writeln!(csv, "{first},{second},{:.4},{:.4}", row.rate_hz, row.sd_hz);
    }
    csv
}

const RATE: &str = "rate, impulses/s";

fn by_amplitude_plot(rows: &[Row]) -> Result<String, FiguresError> {
    let curve = |hz: f64| {
        let of_frequency = rows.iter().filter(|row| row.frequency_hz == hz);
        Series {
            name: format!("{hz} Hz"),
            line: of_frequency.map(|row| (row.amplitude_um, row.rate_hz)).collect(),
            points: Vec::new(),
            dot: Dot::Disc,
        }
    };
    let chart = Chart {
        title: "Rate against amplitude, under one pin",
        x: Axis {
            name: "amplitude asked for, um peak to peak",
            scale: Scale { from: 0.0, to: *AMPLITUDE_UM.end(), logarithmic: false },
        },
        y: Axis { name: RATE, scale: rate_scale(rows) },
        legend: SeriesLabelPosition::LowerRight,
        series: FREQUENCIES_HZ.map(curve).into(),
    };
    Ok(draw(&chart)?)
}

fn by_frequency_plot(rows: &[Row]) -> Result<String, FiguresError> {
    let curve = |um: f64| {
        let of_amplitude = rows.iter().filter(|row| row.amplitude_um == um);
        Series {
            name: format!("{um} um"),
            line: of_amplitude.map(|row| (row.frequency_hz, row.rate_hz)).collect(),
            points: Vec::new(),
            dot: Dot::Disc,
        }
    };
    let chart = Chart {
        title: "Rate against frequency, under one pin",
        x: Axis { name: "frequency, Hz", scale: Scale { from: 0.0, to: 300.0, logarithmic: false } },
        y: Axis { name: RATE, scale: rate_scale(rows) },
        legend: SeriesLabelPosition::UpperRight,
        series: AMPLITUDES_UM.map(curve).into(),
    };
    Ok(draw(&chart)?)
}

/// From 0 to the next fifty.
fn rate_scale(rows: &[Row]) -> Scale {
    let highest = rows.iter().map(|row| row.rate_hz).fold(0.0, f64::max);
    Scale { from: 0.0, to: (highest / 50.0).ceil().max(1.0) * 50.0, logarithmic: false }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(rates: &[f64]) -> Vec<Row> {
        let row = |(n, &rate_hz)| {
            let place = f64::from(n) * 10.0;
            Row { frequency_hz: 60.0 + place, amplitude_um: place, rate_hz, sd_hz: 0.0 }
        };
        (0..).zip(rates).map(row).collect()
    }

    #[test]
    fn a_plateau_is_the_widest_range_of_nearly_one_rate() {
        let found = plateau(&rows(&[0.0, 0.0, 0.0, 0.0, 50.0, 91.0, 100.0, 99.0, 89.0])).unwrap();
        assert_eq!(
            (found.from_um, found.to_um, found.lowest_hz, found.highest_hz),
            (50.0, 70.0, 91.0, 100.0)
        );
        assert_eq!(plateau(&rows(&[0.0, 0.0])), None);
    }

    #[test]
    fn a_peak_has_a_width() {
        let found = peak(&rows(&[97.5, 90.0, 98.0, 100.0, 97.0, 96.9])).unwrap();
        assert_eq!((found.frequency_hz, found.rate_hz), (90.0, 100.0));
        assert_eq!((found.from_hz, found.to_hz), (80.0, 100.0));
        assert_eq!(peak(&[]), None);
    }
}
