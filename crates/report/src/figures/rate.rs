//! The rate of an afferent under a pin, against amplitude and against frequency.
//!
//! The paper remarks that the amplitude does not matter much. The rate against the amplitude, for some frequencies, shows where
//! that is true. The rate against the frequency, for two amplitudes, shows where afferents fire most. Rates are means over
//! afferents that differ in their threshold noise, simulated exactly.
//!
//! Invariant: the numbers in the text follow from the numbers that are drawn.

use crate::chart::{Axis, Chart, Scale, Series, draw};
use crate::figures::error::FiguresError;
use crate::figures::page::Section;
use crate::figures::table::{csv, number, table};
use crate::figures::{command, middle, title};
use crate::progress::Parts;
use crate::statistics::mean_and_sd;
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, POPULATION_NOISE_SD, Position, Rectify};
use meissner_skin::{Method, Options, Scene, simulate};
use rayon::prelude::*;
use serde::Serialize;

const AFFERENTS: usize = 8;
const DURATION_S: f64 = 1.0;
const SEED: u64 = 0;
/// Frequencies whose rates are drawn against the amplitude, Hz.
const FREQUENCIES_HZ: [f64; 6] = [10.0, 20.0, 30.0, 60.0, 100.0, 150.0];
/// The step of amplitudes, µm, up to the array's largest.
const STEP_UM: f64 = 5.0;
/// Amplitudes whose rates are drawn against the frequency, µm: the paper's, and one that does not saturate at the
/// frequencies where afferents fire most. An array has those up to its largest amplitude.
const AMPLITUDES_UM: [f64; 2] = [30.0, 80.0];
/// Frequencies against which rates are drawn, Hz.
const SWEPT_HZ: std::ops::RangeInclusive<u32> = 5..=300;
/// Rates that differ by less are equal, as a share of the larger.
const SAME: f64 = 0.10;
/// A peak is as wide as the range of rates within this share of it.
const NEAR_PEAK: f64 = 0.03;

/// A simulated rate.
#[derive(Clone, Copy, Debug)]
struct Row {
    frequency_hz: f64,
    amplitude_um: f64,
    rate_hz: f64,
    sd_hz: f64,
}

/// The key figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rate {
    /// One for each frequency.
    pub by_amplitude: Vec<Plateau>,
    /// One for each amplitude.
    pub by_frequency: Vec<Peak>,
}

/// The range in which the amplitude does not matter much, at one frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Plateau {
    /// The frequency.
    pub frequency_hz: f64,
    /// The drive is saturated from this amplitude on: it is a triangle that cannot become larger.
    pub saturated_from_um: f64,
    /// Lower end of the widest range in which the rate is above 0 and changes by less than 10 %.
    pub from_um: f64,
    /// Upper end of that range.
    pub to_um: f64,
    /// Lowest rate in that range, impulses/s.
    pub lowest_hz: f64,
    /// Highest rate in that range, impulses/s.
    pub highest_hz: f64,
    /// Rate at the smallest amplitude of the grid, impulses/s.
    pub first_hz: f64,
}

/// The frequency at which afferents fire most, at one amplitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peak {
    /// The amplitude.
    pub amplitude_um: f64,
    /// The frequency of the highest rate.
    pub frequency_hz: f64,
    /// That rate, impulses/s.
    pub rate_hz: f64,
    /// Lower end of the range around it with rates within 3 % of the highest.
    pub from_hz: f64,
    /// Upper end of that range.
    pub to_hz: f64,
}

/// Makes the section and the key figures.
pub(super) fn section(
    array: Array,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(Section, Rate), FiguresError> {
    let last_um = array.motor().travel_um;
    let (motor, command) = (middle(array), command(array));
    let amplitudes: Vec<f64> =
        (1..).map(|n| f64::from(n) * STEP_UM).take_while(|um| *um <= last_um).collect();
    let by_amplitude = FREQUENCIES_HZ.iter().flat_map(|&hz| amplitudes.iter().map(move |&um| (hz, um)));
    let swept_um = AMPLITUDES_UM.iter().filter(|um| **um <= last_um);
    let by_frequency = swept_um.flat_map(|&um| SWEPT_HZ.map(move |hz| (f64::from(hz), um)));
    let settings: Vec<(f64, f64)> = by_amplitude.chain(by_frequency).collect();
    let parts = Parts::new(settings.len(), progress);
    let rows = settings.into_par_iter().map(|(frequency_hz, amplitude_um)| {
        let row = row(array, frequency_hz, amplitude_um);
        parts.done();
        row
    });
    let mut by_amplitude = rows.collect::<Result<Vec<_>, FiguresError>>()?;
    let by_frequency = by_amplitude.split_off(FREQUENCIES_HZ.len() * amplitudes.len());
    let of_frequency = by_amplitude.chunk_by(|a, b| a.frequency_hz == b.frequency_hz);
    let figures = Rate {
        by_amplitude: of_frequency.filter_map(|rows| plateau(array, rows)).collect(),
        by_frequency: by_frequency.chunks(SWEPT_HZ.count()).filter_map(peak).collect(),
    };

    let mut section = Section::new("rate", &title(array, "Rate of an afferent under a pin", ""));
    let what = format!(
        "Mean of {AFFERENTS} afferents under the pin of motor {motor}, simulated for {} s by the finest method for these \
         motors (noise seed {SEED}, SD {POPULATION_NOISE_SD} of the threshold, indentation only), all other motors off.",
        number(DURATION_S)
    );
    let caption = format!("Impulse rate against amplitude, for {} frequencies. {what}", FREQUENCIES_HZ.len());
    let drawn = plot(
        Axis { name: "amplitude of the drive, µm peak to peak", scale: Scale::linear(0.0, last_um) },
        &by_amplitude,
        |row| format!("{} Hz", row.frequency_hz),
        |row| row.amplitude_um,
    );
    let row = |row: &Row| {
        let Row { frequency_hz, amplitude_um, rate_hz, sd_hz } = row;
        format!("{frequency_hz},{amplitude_um},{rate_hz:.4},{sd_hz:.4}")
    };
    let numbers = csv("frequency_hz,amplitude_um,rate_hz,rate_sd_hz", by_amplitude.iter().map(row));
    section.figure("rate-amplitude", drawn, Some(numbers), &caption, &command);
    for plateau in figures.by_amplitude.iter().filter(|plateau| plateau.frequency_hz == 60.0) {
        section.say(&remark(array, plateau));
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
    let drawn = plot(
        Axis { name: "frequency, Hz", scale: Scale::linear(0.0, 300.0) },
        &by_frequency,
        |row| format!("{} µm", row.amplitude_um),
        |row| row.frequency_hz,
    );
    let row = |row: &Row| {
        let Row { frequency_hz, amplitude_um, rate_hz, sd_hz } = row;
        format!("{amplitude_um},{frequency_hz},{rate_hz:.4},{sd_hz:.4}")
    };
    let numbers = csv("amplitude_um,frequency_hz,rate_hz,rate_sd_hz", by_frequency.iter().map(row));
    section.figure("rate-frequency", drawn, Some(numbers), &caption, &command);
    Ok((section, figures))
}

/// The rate of afferents under the pin of the middle motor; all others are off.
fn row(array: Array, frequency_hz: f64, amplitude_um: f64) -> Result<Row, FiguresError> {
    let motor = middle(array);
    let [x_mm, y_mm] = array.position_mm(motor);
    let drive = Drive { motor, frequency_hz, amplitude_um, phase: 0.0, start_s: None, stop_s: None };
    let afferents = vec![Position { x_mm, y_mm }; AFFERENTS];
    let model = AfferentModel::default_for(Rectify::Half, POPULATION_NOISE_SD);
    let scene = Scene::new(array, DURATION_S, SEED, vec![drive], afferents, model)?;
    let answer = simulate(&scene, &Options::rates(Method::Exact), &|_| ())?;
    let (rate_hz, sd_hz) = mean_and_sd(&answer.rates_hz(&scene));
    Ok(Row { frequency_hz, amplitude_um, rate_hz, sd_hz })
}

/// The widest range of amplitudes with nearly one rate, at one frequency.
fn plateau(array: Array, rows: &[Row]) -> Option<Plateau> {
    let speed_um_s = array.motor().um_per_pulse * f64::from(array.rate().hz());
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
                    saturated_from_um: speed_um_s / 2.0 / row.frequency_hz,
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
    // Take the first among equals.
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

/// Says in computed numbers where the amplitude does not matter much; of the paper's array it is a remark of the paper.
fn remark(array: Array, plateau: &Plateau) -> String {
    let Plateau { frequency_hz, saturated_from_um, from_um, to_um, lowest_hz, highest_hz, first_hz } =
        *plateau;
    let paper = if array == Array::paper() {
        "The paper remarks that the amplitude does not affect much. "
    } else {
        ""
    };
    format!(
        "{paper}At {} Hz the rate changes by less than {} % between \
         {} and {} µm ({} to {} impulses/s); the drive saturates from {} µm on, so larger amplitudes change nothing. \
         Below that range the amplitude matters: at {} µm the rate is {} impulses/s.",
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

/// Draws the rates of each group, which `name` names, against `x`.
fn plot(x: Axis<'_>, rows: &[Row], name: impl Fn(&Row) -> String, place: impl Fn(&Row) -> f64) -> String {
    let groups = rows.chunk_by(|a, b| name(a) == name(b));
    let series = groups
        .map(|rows| Series::line(name(&rows[0]), rows.iter().map(|row| (place(row), row.rate_hz)).collect()));
    let highest = rows.iter().map(|row| row.rate_hz).fold(0.0, f64::max);
    let y = Axis { name: "rate, impulses/s", scale: Scale::fifties(0.0, highest) };
    draw(&Chart { title: None, x, y, series: series.collect() })
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
        let found =
            plateau(Array::paper(), &rows(&[0.0, 0.0, 0.0, 0.0, 50.0, 91.0, 100.0, 99.0, 89.0])).unwrap();
        assert_eq!(
            (found.from_um, found.to_um, found.lowest_hz, found.highest_hz),
            (50.0, 70.0, 91.0, 100.0)
        );
        assert_eq!(plateau(Array::paper(), &rows(&[0.0, 0.0])), None);
    }

    #[test]
    fn a_peak_has_a_place_and_a_width() {
        let found = peak(&rows(&[97.5, 90.0, 98.0, 100.0, 97.0, 96.9])).unwrap();
        assert_eq!((found.frequency_hz, found.rate_hz), (90.0, 100.0));
        assert_eq!((found.from_hz, found.to_hz), (80.0, 100.0));
        assert_eq!(peak(&[]), None);
    }
}
