//! The travel of a burst against its number of pulses; of the paper's array it is the paper's Fig. 2.
//!
//! Simulated motors of an array play the default plan of its calibration. The travel of every burst is the displacement at rest before
//! and after it, as the paper measured it with a laser. The bursts of one motor are drawn, as in the paper; those of all
//! motors are fitted.
//!
//! Invariant: drawing and fit use the same bursts, as `calibrate` makes them.

use crate::chart::{Axis, Chart, Dot, Point, Scale, Series, draw};
use crate::figures::error::FiguresError;
use crate::figures::page::Section;
use crate::figures::table::{csv, number, table};
use crate::figures::{command, middle, title};
use crate::statistics::mean_and_sd;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::spec::{Array, MotorSpec};
use meissner_array::units::TickRate;
use meissner_stream::calibrate::{BurstTravel, Fit, Plan, STROKES_PER_GROUP, travels_by_sensor};
use serde::Serialize;

const SEED: u64 = 0;
/// The drawing shifts up bursts to the left by this number of pulses, and down bursts to the right.
const ASIDE: f64 = 1.5;

/// The key figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pulses {
    /// Seed of the simulated motors.
    pub seed: u64,
    /// The motor that is drawn: the one nearest to the middle, as in the other figures.
    pub motor: u8,
    /// Travel of a pulse in the model, µm.
    pub model_um_per_pulse: f64,
    /// Fit of its up bursts.
    pub up: Fit,
    /// Fit of its down bursts.
    pub down: Fit,
    /// Fit of all bursts of all motors.
    pub all: Fit,
    /// Travel of the first burst of a group over the model's, mean of all motors.
    pub transient_gain: f64,
}

/// Makes the section and the key figures.
pub(super) fn section(array: Array) -> Result<(Section, Pulses), FiguresError> {
    let (plan, drawn_motor, motor) = (Plan::of(array)?, middle(array), array.motor());
    let config = SimulatedMotorsConfig { seed: SEED, telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
    let bursts = travels_by_sensor(&plan, &mut SimulatedMotors::new(array, config, Tick(0))?);
    let drawn: Vec<BurstTravel> = bursts.iter().filter(|burst| burst.motor == drawn_motor).copied().collect();
    let fit = |direction| Fit::of(motor, drawn.iter().filter(|burst| burst.direction == direction));
    let firsts = bursts.iter().filter(|burst| burst.warm_up && burst.direction == Direction::Up);
    let firsts: Vec<f64> = firsts.map(|burst| over_model(motor, burst)).collect();
    let (transient_gain, _) = mean_and_sd(&firsts);
    let figures = Pulses {
        seed: SEED,
        motor: drawn_motor,
        model_um_per_pulse: motor.um_per_pulse,
        up: fit(Direction::Up)?,
        down: fit(Direction::Down)?,
        all: Fit::of(motor, &bursts)?,
        transient_gain,
    };

    let mut section = Section::new("pulses", &title(array, "Displacement against pulses", "Fig. 2"));
    let paper = array == Array::paper();
    let step = number(motor.um_per_pulse);
    let (model, its_step) =
        if paper { (format!("0.95/7 = {step}"), "the model's 0.95/7") } else { (step, "the model's") };
    let all = figures.all;
    let caption = format!(
        "Travel of a burst against its number of pulses. Line: the motor model, {model} µm per pulse. Circles: bursts \
         of the simulated motor {drawn_motor} (seed {SEED}, gain of each burst scattered by 10 %), upwards to the left and \
         downwards to the right of their number, from the displacement at rest before and after each. Discs: their mean \
         and standard deviation. They are played as by `meissner calibrate`: groups of {} strokes of one number, a group \
         every {} s, in mixed order, all motors at once. Squares: the first stroke of each group, which counts neither in \
         the mean nor in a fit. Its up burst follows {} and travels {} of the model's on the mean{}.",
        1 + STROKES_PER_GROUP,
        number(meissner_stream::calibrate::GROUP_S),
        if paper { "more than half a second of rest" } else { "a rest" },
        number(transient_gain),
        if paper { ", which is the paper's transient" } else { "" },
    );
    let drawing = plot(&plan, &drawn, paper);
    section.figure("pulses", drawing, Some(numbers(array.rate(), &drawn)), &caption, &command(array));
    section.say(&format!(
        "For the {} measured bursts of all {} motors the fitted slope is {} µm per pulse (standard error {}), {} of \
         {its_step}, with an offset of {} µm. Bursts scatter around it by {} % of their travel{}.",
        all.bursts,
        array.motors(),
        number(all.slope_um_per_pulse),
        number(all.slope_se_um_per_pulse),
        number(all.gain(motor)),
        number(all.offset_um),
        number(all.relative_sd * 100.0),
        if paper { " (the paper: about 10 %)" } else { "" },
    ));
    section.table("Lines through the bursts, weighted by 1/pulses²", &fits(motor, &figures));
    Ok((section, figures))
}

fn over_model(motor: &MotorSpec, burst: &BurstTravel) -> f64 {
    burst.travel_um / (f64::from(burst.pulses) * motor.um_per_pulse)
}

fn fits(motor: &MotorSpec, figures: &Pulses) -> String {
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
            fit.gain(motor),
            offset_um,
            relative_sd * 100.0,
        ];
        [name].into_iter().chain(numbers.map(number)).collect()
    };
    let rows = [
        row(format!("motor {}, up", figures.motor), &figures.up),
        row(format!("motor {}, down", figures.motor), &figures.down),
        row("all motors, up and down".to_owned(), &figures.all),
    ];
    table(&head, rows)
}

fn numbers(rate: TickRate, bursts: &[BurstTravel]) -> String {
    let row = |burst: &BurstTravel| {
        let start_s = rate.ticks_to_seconds(burst.start.0);
        let (up, settling) = (u8::from(burst.direction == Direction::Up), u8::from(burst.warm_up));
        format!("{start_s:.6},{up},{settling},{},{:.4}", burst.pulses, burst.travel_um)
    };
    csv("start_s,up,settling,pulses,travel_um", bursts.iter().map(row))
}

/// Draws the bursts and the model, with the step as a fraction if it is the paper's.
fn plot(plan: &Plan, bursts: &[BurstTravel], paper: bool) -> String {
    let um_per_pulse = plan.array().motor().um_per_pulse;
    let step = if paper { "0.95/7".to_owned() } else { number(um_per_pulse) };
    let of = |warm_up: bool| bursts.iter().filter(move |travel| travel.warm_up == warm_up);
    let point = |burst: &BurstTravel| {
        let aside = if burst.direction == Direction::Up { -ASIDE } else { ASIDE };
        Point { x: f64::from(burst.pulses) + aside, y: burst.travel_um, sd: 0.0 }
    };
    let mean = |&pulses: &u16| {
        let travels: Vec<f64> =
            of(false).filter(|burst| burst.pulses == pulses).map(|burst| burst.travel_um).collect();
        let (y, sd) = mean_and_sd(&travels);
        Point { x: pulses.into(), y, sd }
    };
    let most = f64::from(plan.pulses().iter().copied().max().unwrap_or_default()) + 10.0;
    let highest = bursts.iter().map(|burst| burst.travel_um).fold(0.0, f64::max);
    let series = |name, points, dot| Series { points, dot, ..Series::line(name, Vec::new()) };
    let chart = Chart {
        title: None,
        x: Axis { name: "pulses", scale: Scale::linear(0.0, most) },
        y: Axis { name: "travel, µm", scale: Scale::linear(0.0, (highest / 5.0).ceil() * 5.0) },
        series: vec![
            Series::line(
                format!("model: {step} µm per pulse"),
                vec![(0.0, 0.0), (most, most * um_per_pulse)],
            ),
            series("bursts", of(false).map(point).collect(), Dot::Ring),
            series("first stroke of a group", of(true).map(point).collect(), Dot::Square),
            series("mean and standard deviation", plan.pulses().iter().map(mean).collect(), Dot::Filled),
        ],
    };
    draw(&chart)
}
