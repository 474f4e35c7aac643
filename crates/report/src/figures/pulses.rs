//! MethodLabel far a burst moves a pin: the paper's Fig. 2.
//!
//! The default plan of a calibration is played on the simulated plant, and every burst's travel read at rest before and
//! after it, as the paper did with its laser. One motor's blocks are drawn, as the paper drew one motor's; all motors' are fitted.
//!
//! Invariant: what is drawn and what is fitted are the same blocks, as `calibrate` makes them.

use super::chart::{Axis, Chart, Dot, Point, Scale, Series, draw};
use super::page::Section;
use super::table::{number, table};
use super::{FiguresError, mean_and_sd};
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::units::{UM_PER_PULSE, ticks_to_seconds};
use meissner_stream::calibrate::{BurstTravel, Fit, Plan, STROKES_PER_GROUP, travels_by_sensor};
use plotters::chart::SeriesLabelPosition;
use serde::Serialize;
use std::fmt::Write;

/// Whose blocks are drawn: the motor of the other figures.
const MOTOR: u8 = 9;
const SEED: u64 = 0;
/// In the drawing up bursts stand so many pulses to the left of their number, down bursts to the right.
const ASIDE: f64 = 1.5;

/// What the figure comes to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pulses {
    /// Of the plant's scatter.
    pub seed: u64,
    /// Whose blocks are drawn.
    pub motor: u8,
    /// What a pulse does by the model, µm.
    pub model_um_per_pulse: f64,
    /// Of the motor that is drawn.
    pub up: Fit,
    /// Of the motor that is drawn.
    pub down: Fit,
    /// Of all motors, up and down.
    pub all: Fit,
    /// What a group's first burst travels on the mean of all motors, over the model's.
    pub transient_gain: f64,
}

/// Measures, draws, and says what it comes to.
pub(super) fn section() -> Result<(Section, Pulses), FiguresError> {
    let plan = Plan::default();
    let config = SimulatedMotorsConfig { seed: SEED, telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
    let blocks = travels_by_sensor(&plan, &mut SimulatedMotors::new(config, Tick(0))?);
    let drawn: Vec<BurstTravel> = blocks.iter().filter(|block| block.motor == MOTOR).copied().collect();
    let fit = |direction| Fit::of(drawn.iter().filter(|block| block.direction == direction));
    let firsts = blocks.iter().filter(|block| block.warm_up && block.direction == Direction::Up);
    let firsts: Vec<f64> = firsts.map(over_model).collect();
    let (transient_gain, _) = mean_and_sd(&firsts);
    let figures = Pulses {
        seed: SEED,
        motor: MOTOR,
        model_um_per_pulse: UM_PER_PULSE,
        up: fit(Direction::Up)?,
        down: fit(Direction::Down)?,
        all: Fit::of(&blocks)?,
        transient_gain,
    };

    let mut section = Section::new("pulses", "Displacement against pulses (the paper's Fig. 2)");
    let all = figures.all;
    let caption = format!(
        "Displacement of a pin by a burst against the burst's number of pulses. Line: the motor model, 0.95/7 = {} µm per \
         pulse. Circles: bursts of motor {MOTOR} of the simulated plant (seed {SEED}, gain of each burst scattered by 10 %), \
         upwards to the left and downwards to the right of their number, by the displacement at rest before and after \
         each; discs: their mean and standard deviation. They were played as `meissner calibrate` plays them: groups of \
         {} strokes of one number, a group every {} s, the numbers mixed, all motors side by side. A group's first stroke, up \
         and down, is drawn as squares and counts neither in the mean nor in a fit: its up burst comes after more than half a \
         second of rest and travels {} of the model's on the mean, which is the paper's transient.",
        number(UM_PER_PULSE),
        1 + STROKES_PER_GROUP,
        number(meissner_stream::calibrate::GROUP_S),
        number(transient_gain),
    );
    section.figure("pulses", plot(&plan, &drawn)?, Some(csv(&drawn)), &caption, "meissner report");
    section.say(&format!(
        "Of the {} measured bursts of all {MOTORS} motors the fitted slope is {} µm per pulse (standard error {}), {} of the model's 0.95/7, \
         with an offset of {} µm; a burst scatters around it by {} % of its travel (the paper: about 10 %).",
        all.bursts,
        number(all.slope_um_per_pulse),
        number(all.slope_se_um_per_pulse),
        number(all.gain()),
        number(all.offset_um),
        number(all.relative_sd * 100.0),
    ));
    section.table("Lines through the bursts, weighted by 1/pulses²", &fits(&figures));
    Ok((section, figures))
}

fn over_model(block: &BurstTravel) -> f64 {
    block.travel_um / (f64::from(block.pulses) * UM_PER_PULSE)
}

fn fits(figures: &Pulses) -> String {
    let head = [
        "bursts",
        "count",
        "slope, µm per pulse",
        "standard error",
        "gain",
        "offset, µm",
        "SD of a burst, %",
    ];
    let row = |name: String, fit: &Fit| {
        let Fit { slope_um_per_pulse, slope_se_um_per_pulse, offset_um, relative_sd, bursts } = *fit;
        let numbers = [
            bursts as f64,
            slope_um_per_pulse,
            slope_se_um_per_pulse,
            fit.gain(),
            offset_um,
            relative_sd * 100.0,
        ];
        [name].into_iter().chain(numbers.map(number)).collect()
    };
    let rows = [
        row(format!("motor {MOTOR}, up"), &figures.up),
        row(format!("motor {MOTOR}, down"), &figures.down),
        row("all motors, up and down".to_owned(), &figures.all),
    ];
    table(&head, rows)
}

fn csv(blocks: &[BurstTravel]) -> String {
    let mut csv = String::from("start_s,up,settling,pulses,travel_um\n");
    for block in blocks {
        let start_s = ticks_to_seconds(block.start.0);
        let (up, settling) = (u8::from(block.direction == Direction::Up), u8::from(block.warm_up));
        // Writing to a string does not fail.
        let _ = writeln!(csv, "{start_s:.6},{up},{settling},{},{:.4}", block.pulses, block.travel_um);
    }
    csv
}

fn plot(plan: &Plan, blocks: &[BurstTravel]) -> Result<String, FiguresError> {
    let of = |warm_up: bool| blocks.iter().filter(move |travel| travel.warm_up == warm_up);
    let point = |block: &BurstTravel| {
        let aside = if block.direction == Direction::Up { -ASIDE } else { ASIDE };
        Point { x: f64::from(block.pulses) + aside, y: block.travel_um, sd: 0.0 }
    };
    let mean = |&pulses: &u16| {
        let travels: Vec<f64> =
            of(false).filter(|block| block.pulses == pulses).map(|block| block.travel_um).collect();
        let (y, sd) = mean_and_sd(&travels);
        Point { x: pulses.into(), y, sd }
    };
    let most = f64::from(plan.pulses().iter().copied().max().unwrap_or_default()) + 10.0;
    let highest = blocks.iter().map(|block| block.travel_um).fold(0.0, f64::max);
    let series = |name: &str, points, dot| Series { name: name.to_owned(), line: Vec::new(), points, dot };
    let chart = Chart {
        title: "Displacement of a pin by a burst: model (line) and simulated plant",
        x: Axis { name: "pulses", scale: Scale { from: 0.0, to: most, logarithmic: false } },
        y: Axis {
            name: "displacement, um",
            scale: Scale { from: 0.0, to: (highest / 5.0).ceil() * 5.0, logarithmic: false },
        },
        legend: SeriesLabelPosition::UpperLeft,
        series: vec![
            Series {
                line: vec![(0.0, 0.0), (most, most * UM_PER_PULSE)],
                ..series("model: 0.95/7 um per pulse", Vec::new(), Dot::Disc)
            },
            series("bursts", of(false).map(point).collect(), Dot::Ring),
            series("first stroke of a group", of(true).map(point).collect(), Dot::Square),
            series("mean and standard deviation", plan.pulses().iter().map(mean).collect(), Dot::Disc),
        ],
    };
    Ok(draw(&chart)?)
}
