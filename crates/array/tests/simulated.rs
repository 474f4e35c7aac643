//! The simulated motors: scatter, end stops, telemetry, and times a month away.

use firmware_protocol::stroke::{Direction, Lines};
use firmware_protocol::tick::Tick;
use meissner_array::pattern::Drive;
use meissner_array::simulated::{
    LowerStop, Pin, RestStats, SPARE_SAMPLES, SimulatedMotors, SimulatedMotorsConfig,
};
use meissner_array::spec::{Array, ArraySpec};
use meissner_array::strokes::{Burst, Step};
use meissner_array::strokes::{StrokeOptions, Strokes, StrokesError};
use meissner_test_support::paper::UM_PER_PULSE;
use meissner_test_support::patterns;
use meissner_test_support::statistics::{mean, sd};

const MONTH: u64 = 30 * 86_400 * 85_000;
const SECOND: u64 = 85_000;

/// Plays bursts on simulated motors for `ticks` ticks, as a controller would; calls `look` after every step.
pub(crate) fn play(
    motors: &mut SimulatedMotors,
    steps: impl IntoIterator<Item = Result<Step, StrokesError>>,
    ticks: u64,
    look: impl FnMut(&mut SimulatedMotors),
) {
    let end = motors.now() + ticks;
    let steps = steps.into_iter().map(Result::unwrap).take_while(|step| step.begin() < end);
    let bursts = steps.flat_map(|step| step.bursts().map(move |burst| (step.motor(), burst)));
    play_bursts(motors, bursts, end, look);
}

fn play_bursts(
    motors: &mut SimulatedMotors,
    bursts: impl IntoIterator<Item = (u8, Burst)>,
    end: Tick,
    mut look: impl FnMut(&mut SimulatedMotors),
) {
    let mut toggles: Vec<(Tick, u8, Direction)> = bursts
        .into_iter()
        .flat_map(|(motor, burst)| [burst.start, burst.end()].map(|tick| (tick, motor, burst.direction)))
        .collect();
    toggles.sort_by_key(|toggle| toggle.0);
    let mut lines = Lines::OFF;
    for (tick, motor, direction) in toggles {
        if tick < end {
            motors.advance(lines, tick - motors.now());
            look(motors);
        }
        lines.set_mut(direction).toggle(motor);
    }
    motors.advance(Lines::OFF, end - motors.now());
    look(motors);
}

fn drive(motor: u8, frequency_hz: f64, amplitude_um: f64) -> Drive {
    Drive { phase: f64::from(motor) / 24.0, ..patterns::drive(motor, frequency_hz, amplitude_um) }
}

fn strokes(drives: Vec<Drive>, seconds: f64, onset: Tick) -> Strokes {
    let mut strokes =
        Strokes::new(&patterns::pattern("test", None, drives), &StrokeOptions::lasting(seconds)).unwrap();
    strokes.begin(onset);
    strokes
}

fn one_burst(direction: Direction, start: Tick, pulses: u16) -> (u8, Burst) {
    (5, Burst { start, direction, pulses })
}

/// One motor, one line for so long.
fn pulse(motors: &mut SimulatedMotors, direction: Direction, ticks: u64) {
    let mut lines = Lines::OFF;
    lines.set_mut(direction).insert(5);
    motors.advance(lines, ticks);
}

#[test]
fn after_a_month_of_strokes_the_pin_is_at_rest() {
    let config = SimulatedMotorsConfig { telemetry_hz: 0, ..SimulatedMotorsConfig::ideal() };
    let mut motors = SimulatedMotors::new(Array::paper(), config, Tick::BOOT).unwrap();
    for stroke in strokes(vec![drive(5, 1.0, 80.0)], 30.0 * 86_400.0, Tick::BOOT) {
        for burst in stroke.unwrap().bursts() {
            motors.advance(Lines::OFF, burst.start - motors.now());
            pulse(&mut motors, burst.direction, burst.pulses.into());
        }
    }
    motors.advance(Lines::OFF, 400);
    assert!(motors.now() > Tick::BOOT + (MONTH - SECOND));
    assert_eq!(motors.displacement_um(5), 0.0);
    let rest = motors.take_rest_stats().nth(5).unwrap();
    assert_eq!((rest.count, rest.max_abs_um), (30 * 86_400, 0.0));
}

#[test]
fn a_burst_left_out_changes_no_other_burst() {
    let bursts: Vec<_> = strokes(vec![drive(5, 60.0, 40.0)], 1.0, Tick::BOOT)
        .flat_map(|stroke| stroke.unwrap().bursts().map(|burst| (5, burst)))
        .collect();
    let travels = |bursts: &[(u8, Burst)]| {
        let mut motors = SimulatedMotors::new(
            Array::paper(),
            SimulatedMotorsConfig { seed: 11, ..SimulatedMotorsConfig::default() },
            Tick::BOOT,
        )
        .unwrap();
        let (mut last, mut travels) = (0.0, Vec::new());
        play_bursts(&mut motors, bursts.to_vec(), Tick::BOOT + SECOND, |motors| {
            let travel = motors.position_um(5) - last;
            last += travel;
            if travel != 0.0 {
                travels.push((motors.now(), travel));
            }
        });
        travels
    };
    let (mut fewer, mut all) = (bursts.clone(), travels(&bursts));
    fewer.remove(40);
    all.remove(40);
    let fewer = travels(&fewer);
    assert_eq!((all.len(), fewer.len()), (bursts.len() - 1, bursts.len() - 1));
    for (a, b) in all.iter().zip(&fewer) {
        assert!(a.0 == b.0 && (a.1 - b.1).abs() < 1e-9, "{a:?} {b:?}");
    }
}

#[test]
fn gains_scatter_as_configured_and_the_first_burst_after_rest_falls_short() {
    let config = SimulatedMotorsConfig {
        asymmetry_sd: 0.0,
        end_stop_um: 10_000.0,
        ..SimulatedMotorsConfig::default()
    };
    let gains = |pause: u64| {
        let mut motors = SimulatedMotors::new(Array::paper(), config, Tick::BOOT).unwrap();
        let gains: Vec<f64> = (0..2000)
            .map(|i| {
                motors.advance(Lines::OFF, pause);
                let before = motors.position_um(5);
                pulse(&mut motors, if i % 2 == 0 { Direction::Up } else { Direction::Down }, 100);
                (motors.position_um(5) - before).abs() / (100.0 * UM_PER_PULSE)
            })
            .collect();
        (mean(&gains), sd(&gains))
    };
    // Bounds of four standard errors: that of the mean is 0.1 / sqrt(2000), that of the standard deviation is smaller by sqrt(2).
    for (pause, expected) in [(42_499, 1.0), (42_500, 0.8)] {
        let (mean, sd) = gains(pause);
        assert!((mean - expected).abs() < 0.009 && (sd - 0.1).abs() < 0.007, "{pause}: {mean} {sd}");
    }
}

#[test]
fn a_pin_stays_at_its_end_stop_and_leaves_it_at_once() {
    let config = SimulatedMotorsConfig { end_stop_um: 10.05, ..SimulatedMotorsConfig::ideal() };
    let mut motors = SimulatedMotors::new(Array::paper(), config, Tick::BOOT).unwrap();
    pulse(&mut motors, Direction::Up, 74);
    assert!((motors.position_um(5) - 74.0 * UM_PER_PULSE).abs() < 1e-12);
    pulse(&mut motors, Direction::Up, 1);
    assert!((motors.position_um(5) - 10.05).abs() < 1e-12);
    pulse(&mut motors, Direction::Up, 5000);
    assert!((motors.position_um(5) - 10.05).abs() < 1e-12);
    pulse(&mut motors, Direction::Down, 10);
    assert!((motors.position_um(5) - (10.05 - 10.0 * UM_PER_PULSE)).abs() < 1e-12);
    pulse(&mut motors, Direction::Down, 5000);
    assert!((motors.position_um(5) + 10.05).abs() < 1e-12);
    motors.advance(Lines::OFF, 366);
    assert!((motors.displacement_um(5) + 10.05).abs() < 1e-12);
    let rest = motors.take_rest_stats().nth(5).unwrap();
    assert!(
        rest.count == 1 && (rest.max_abs_um - 10.05).abs() < 1e-12 && (rest.rms_um() - 10.05).abs() < 1e-12
    );
    assert_eq!(motors.take_rest_stats().nth(5).unwrap(), RestStats::default());
}

#[test]
fn a_pin_stays_on_its_lower_stop_does_not_bounce_and_leaves_it_with_the_first_pulse() {
    let config = SimulatedMotorsConfig { lower_stop: LowerStop::AtRest, ..SimulatedMotorsConfig::ideal() };
    let mut motors = SimulatedMotors::new(Array::paper(), config, Tick::BOOT).unwrap();
    pulse(&mut motors, Direction::Down, 500);
    assert_eq!((motors.position_um(5), motors.pushed_pulses(5), motors.pushed_pulses(6)), (0.0, 500, 0));
    pulse(&mut motors, Direction::Up, 1);
    assert!((motors.position_um(5) - UM_PER_PULSE).abs() < 1e-12);
    pulse(&mut motors, Direction::Up, 99);
    // 100 pulses down undo the 100 up; the stop absorbs 30 more.
    let mut lowest = f64::INFINITY;
    for _ in 0..130 {
        pulse(&mut motors, Direction::Down, 1);
        lowest = lowest.min(motors.position_um(5));
    }
    assert!(
        lowest.abs() < 1e-9 && (motors.pushed_pulses(5) - 530) <= 1,
        "{lowest} {}",
        motors.pushed_pulses(5)
    );
    // The shaft follows the clipped command, not the pulses, through the moving average.
    assert!(motors.displacement_um(5) > 1.0);
    motors.advance(Lines::OFF, 366);
    assert!(motors.displacement_um(5).abs() < 1e-9);
    // The upper end stop is where it was.
    pulse(&mut motors, Direction::Up, 5000);
    assert!((motors.position_um(5) - config.end_stop_um).abs() < 1e-9);
}

#[test]
fn steps_of_any_length_give_the_same_motion() {
    let config = SimulatedMotorsConfig {
        end_stop_um: 30.0,
        lower_stop: LowerStop::AtRest,
        ..SimulatedMotorsConfig::default()
    };
    let bursts =
        [one_burst(Direction::Up, Tick::BOOT + 10, 600), one_burst(Direction::Down, Tick::BOOT + 700, 1000)];
    let end = Tick::BOOT + 3000;
    let (mut whole, mut pieces) = (
        SimulatedMotors::new(Array::paper(), config, Tick::BOOT).unwrap(),
        SimulatedMotors::new(Array::paper(), config, Tick::BOOT).unwrap(),
    );
    let mut whole_samples = Vec::new();
    play_bursts(&mut whole, bursts, end, |motors| {
        whole_samples.extend(std::iter::from_fn(|| motors.telemetry()));
    });
    let mut piece_samples = Vec::new();
    while pieces.now() < end {
        let mut lines = Lines::OFF;
        for (motor, burst) in bursts {
            if (burst.start..burst.end()).contains(&pieces.now()) {
                lines.set_mut(burst.direction).insert(motor);
            }
        }
        pieces.advance(lines, 1);
        piece_samples.extend(pieces.telemetry());
    }
    assert_eq!(whole_samples, piece_samples);
    assert_eq!(whole.displacement_um(5).to_bits(), pieces.displacement_um(5).to_bits());
    // Both stops are met.
    assert!(whole.pushed_pulses(5) == pieces.pushed_pulses(5) && whole.pushed_pulses(5) > 500);
    let mut pin = Pin::new(Array::paper(), &config, 5);
    bursts.iter().for_each(|(_, burst)| pin.play(*burst));
    assert_eq!(pin.pushed_pulses(), whole.pushed_pulses(5));
    assert!(whole.take_rest_stats().eq(pieces.take_rest_stats()));
}

#[test]
fn telemetry_comes_on_time_and_only_the_newest_samples_are_kept() {
    let config = SimulatedMotorsConfig { telemetry_age_ms: 5, ..SimulatedMotorsConfig::ideal() };
    let mut motors = SimulatedMotors::new(Array::paper(), config, Tick::BOOT).unwrap();
    pulse(&mut motors, Direction::Up, 85 + 5 * 85 - 1);
    assert_eq!(motors.telemetry(), None);
    pulse(&mut motors, Direction::Up, 1);
    let sample = motors.telemetry().unwrap();
    // 85 ticks up: the mean of the ramp over the window, 85² / 2 / 365.5 pulses.
    let expected = (100.0 * UM_PER_PULSE * 85.0 * 85.0 / 2.0 / 365.5_f64).round() as i32;
    assert_eq!((sample.tick, sample.y[5], sample.y[6]), (Tick::BOOT + 85, expected, 0));
    assert_eq!(motors.telemetry(), None);

    motors.advance(Lines::OFF, MONTH);
    let samples: Vec<_> = std::iter::from_fn(|| motors.telemetry()).collect();
    assert_eq!(samples.len(), SPARE_SAMPLES);
    assert!(samples.windows(2).all(|pair| pair[1].tick == pair[0].tick + 85));
    let newest = samples.last().unwrap();
    assert!(motors.now() - newest.tick >= 5 * 85 && motors.now() - newest.tick < 6 * 85);
    assert_eq!(newest.y[5], (100.0 * 510.0 * UM_PER_PULSE).round() as i32);
}

#[test]
fn a_setting_out_of_range_is_refused_in_one_line() {
    for config in [
        SimulatedMotorsConfig { gain_sd: -0.1, ..SimulatedMotorsConfig::default() },
        SimulatedMotorsConfig { asymmetry_sd: f64::NAN, ..SimulatedMotorsConfig::default() },
        SimulatedMotorsConfig { telemetry_hz: 85_000, ..SimulatedMotorsConfig::default() },
        SimulatedMotorsConfig { telemetry_age_ms: 1_001, ..SimulatedMotorsConfig::default() },
    ] {
        let line = SimulatedMotors::new(Array::paper(), config, Tick(0)).unwrap_err().to_string();
        assert!(line.starts_with("mock.") && line.contains("must be 0 to"), "{line}");
    }
}

/// The mean gain of a first burst is that of the array's description, unless the settings have another.
#[test]
fn a_first_burst_is_as_the_description_of_the_array_says() {
    let array = |name: &str, transient: &str| {
        let text = format!(
            "name = \"{name}\"\npins = {{ rows = 1, columns = 1, pitch_mm = 2.0 }}\ntick_hz = 50000\n\
             duty = {{ up = 0.2, down = 0.8 }}\n[motor]\nstep_um = 0.125\nwindow_ms = 4.0\ntravel_um = 100.0\n\
             most_pulses = 1000\n{transient}\n"
        );
        Array::known(ArraySpec::parse(&text, name).unwrap()).unwrap()
    };
    let (weak, none) =
        (array("weak-first", "transient = { rest_s = 0.1, gain = 0.875 }"), array("none-first", ""));
    // Travels of bursts of 80 pulses (10 um), the second one a tick after the first, the third after the rest.
    let travels = |array: Array, transient_gain: Option<f64>| {
        let config = SimulatedMotorsConfig {
            transient_gain,
            gain_sd: 0.0,
            asymmetry_sd: 0.0,
            ..SimulatedMotorsConfig::default()
        };
        let mut pin = Pin::new(array, &config, 0);
        let mut before = 0.0;
        [0, 81, 161 + 5_000].map(|start| {
            let burst = Burst { start: Tick(start), direction: Direction::Up, pulses: 80 };
            pin.play(burst);
            let at = pin.position_um(burst.end());
            let travel = at - before;
            before = at;
            travel
        })
    };
    assert_eq!(travels(weak, None), [8.75, 10.0, 8.75]);
    assert_eq!(travels(weak, Some(0.5)), [5.0, 10.0, 5.0]);
    assert_eq!(travels(none, None), [10.0; 3]);
    // A motor without transients never rests.
    assert_eq!(travels(none, Some(0.5)), [10.0; 3]);
    let identity = |array: Array| {
        SimulatedMotors::new(array, SimulatedMotorsConfig::default(), Tick::BOOT).unwrap().identity()
    };
    assert!(identity(weak).contains("transient_gain 0.875,") && identity(none).contains("transient_gain 1,"));
}
