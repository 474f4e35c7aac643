//! Calibration from plan to file: plan, measure, fit, write and read again.

use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_api::Provenance;
use meissner_array::random;
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_stream::calibrate::{
    BurstTravel, Calibration, MAX_BYTES, Plan, PlannedBurst, STROKES_PER_GROUP, fit, travels_by_sensor,
    travels_by_telemetry,
};
use meissner_stream::{Settings, simulate_play};
use meissner_test_support::documents::{assert_changes_refused, in_one_line};
use meissner_test_support::paper::UM_PER_PULSE;
use meissner_test_support::statistics::mean;
use std::collections::BTreeMap;

const HALF_SECOND: u64 = 42_500;

/// The bursts of one motor in a plan.
fn of_motor(plan: &Plan, motor: u8) -> Vec<PlannedBurst> {
    plan.bursts(Tick::BOOT).filter(|planned| planned.motor == motor).collect()
}

#[test]
fn a_plan_plays_its_strokes_and_measures_no_burst_after_a_rest() {
    for plan in
        [Plan::of(Array::paper()).unwrap(), Plan::new(Array::paper(), Some(23), &[200, 7, 70], 3).unwrap()]
    {
        assert_eq!(plan.pattern().saturated().count(), 0);
        for motor in plan.motors() {
            let bursts = of_motor(&plan, motor);
            let mut found = BTreeMap::new();
            for (index, planned) in bursts.iter().enumerate() {
                // The first stroke of each group is the warm-up.
                let in_group = index % (2 * (1 + STROKES_PER_GROUP));
                assert_eq!(planned.warm_up, in_group < 2, "{planned:?}");
                assert_eq!(planned.burst.direction == Direction::Up, index % 2 == 0, "{planned:?}");
                *found.entry((planned.burst.pulses, in_group)).or_insert(0) += 1;
                let Some(before) = index.checked_sub(1) else { continue };
                let rest = planned.burst.start - bursts[before].burst.end();
                assert!(planned.burst.start > bursts[before].rests_at(Array::paper()), "{planned:?}");
                // Only a group's first burst comes after half a second of rest.
                assert_eq!(rest >= HALF_SECOND, in_group == 0, "{planned:?}: {rest}");
            }
            let mut wanted = BTreeMap::new();
            for &pulses in plan.pulses() {
                wanted.extend((0..2 * (1 + STROKES_PER_GROUP)).map(|n| ((pulses, n), plan.repetitions())));
            }
            assert_eq!(found, wanted, "motor {motor}");
        }
        let end = plan.bursts(Tick(0)).map(|planned| planned.rests_at(Array::paper()).0).max().unwrap();
        assert!(end < (plan.duration_s() * 85_000.0) as u64);
    }
    assert_eq!(Plan::of(Array::paper()).unwrap().duration_s(), 60.0);
    assert_eq!(Plan::of(Array::paper()).unwrap().motors().count(), 24);
}

#[test]
fn a_motor_that_slowly_changes_gives_the_same_slope() {
    let plan = Plan::of(Array::paper()).unwrap();
    let groups: Vec<f64> = of_motor(&plan, 5)
        .chunks(2 * (1 + STROKES_PER_GROUP))
        .map(|group| group[0].burst.pulses.into())
        .collect();
    let mean = mean(&groups);
    let drift: f64 = groups.iter().enumerate().map(|(n, pulses)| (n as f64 - 9.5) * (pulses - mean)).sum();
    assert!(drift.abs() < 1e-9, "{groups:?}");
    // Within a round too, neighbours are far apart.
    let turns = groups[..10].windows(3).filter(|three| (three[1] - three[0]) * (three[2] - three[1]) < 0.0);
    assert!(turns.count() >= 6, "{groups:?}");
}

/// The true gains of a simulated motor, up and down.
pub(crate) fn true_gains(config: &SimulatedMotorsConfig, motor: u8) -> [f64; 2] {
    let asymmetry = config.asymmetry_sd * random::normal([config.seed, motor.into(), 0, 2]);
    [1.0 + asymmetry / 2.0, 1.0 - asymmetry / 2.0]
}

fn measured(plan: &Plan, config: SimulatedMotorsConfig) -> Vec<BurstTravel> {
    let mut motors =
        SimulatedMotors::new(Array::paper(), SimulatedMotorsConfig { telemetry_hz: 0, ..config }, Tick::BOOT)
            .unwrap();
    let travels = travels_by_sensor(plan, &mut motors);
    assert!((0..24).all(|motor| motors.displacement_um(motor).abs() < 0.9 * config.end_stop_um));
    assert_eq!(travels.len(), plan.bursts(Tick::BOOT).count());
    travels
}

/// The travels of a plan that the streamer plays, measured by telemetry.
fn played(plan: &Plan, config: &SimulatedMotorsConfig) -> Vec<BurstTravel> {
    let played = simulate_play(&plan.pattern(), None, config, Settings::of(Array::paper()), true).unwrap();
    assert_eq!(played.outcome.bursts.played as usize, plan.bursts(Tick(0)).count());
    travels_by_telemetry(plan, played.outcome.onset.unwrap().actual, &played.measured_bursts)
}

#[test]
fn without_scatter_the_true_gains_are_found() {
    let config = SimulatedMotorsConfig {
        seed: 4,
        gain_sd: 0.0,
        asymmetry_sd: 0.05,
        ..SimulatedMotorsConfig::default()
    };
    let plan = Plan::of(Array::paper()).unwrap();
    let by_sensor = measured(&plan, config);
    for (travels, most) in [(&by_sensor, 1e-9), (&played(&plan, &config), 1e-3)] {
        let fits = fit(Array::paper(), travels).unwrap();
        assert_eq!(fits.iter().map(|fit| fit.motor).collect::<Vec<_>>(), (0..24).collect::<Vec<_>>());
        for found in &fits {
            for (fit, truth) in [found.up, found.down].iter().zip(true_gains(&config, found.motor)) {
                let off = (fit.gain(Array::paper().motor()) - truth).abs();
                assert!(off < most && fit.bursts == 180, "{found:?}: {truth}");
            }
        }
        assert!(fits.iter().any(|fit| (fit.up.gain(Array::paper().motor()) - 1.0).abs() > 0.02));
    }
    // The fits left out the warm-up strokes: the first burst of each group is short, and only that.
    for travel in by_sensor.iter().filter(|travel| travel.warm_up) {
        let of_model = travel.travel_um / (f64::from(travel.pulses) * UM_PER_PULSE);
        let [up, down] = true_gains(&config, travel.motor);
        let expected = if travel.direction == Direction::Up { 0.8 * up } else { down };
        assert!((of_model - expected).abs() < 1e-9, "{travel:?}");
    }
}

#[test]
fn with_scatter_the_gains_are_found_within_the_stated_error() {
    let plan = Plan::of(Array::paper()).unwrap();
    for (seed, by_telemetry) in [(0, false), (1, false), (2, true)] {
        let config = SimulatedMotorsConfig { seed, ..SimulatedMotorsConfig::default() };
        let travels = if by_telemetry { played(&plan, &config) } else { measured(&plan, config) };
        let fits = fit(Array::paper(), &travels).unwrap();
        let gains = Calibration::new(Array::paper(), fits.clone(), provenance()).unwrap().gains();
        for (found, gains) in fits.iter().zip(&gains) {
            for (side, truth) in true_gains(&config, found.motor).into_iter().enumerate() {
                let fit = [found.up, found.down][side];
                let (gain, se) = (fit.gain(Array::paper().motor()), fit.slope_se_um_per_pulse / UM_PER_PULSE);
                // From 180 travels at 10 %, 1.5 times that of a line through the origin.
                assert!(
                    (gain - truth).abs() < 4.0 * se && (0.008..0.014).contains(&se),
                    "{found:?}: {truth}"
                );
                // The offset's own standard error: a pulse's scatter over the spread of 1/pulses, 0.054 um.
                assert!(by_telemetry || fit.offset_um.abs() < 4.0 * 0.054, "{found:?}");
                assert_eq!((gains.mean[side], gains.sd[side]), (gain, se));
            }
            assert!((gains.scatter - 0.1).abs() < 4.0 * 0.1 / 720_f64.sqrt(), "{gains:?}");
        }
    }
    // A burst that was measured badly, or is not in the plan, gives no travel.
    let plan = Plan::new(Array::paper(), Some(7), &[20, 100], 1).unwrap();
    let config = SimulatedMotorsConfig::default();
    let mut played =
        simulate_play(&plan.pattern(), None, &config, Settings::of(Array::paper()), true).unwrap();
    let onset = played.outcome.onset.unwrap().actual;
    assert_eq!(travels_by_telemetry(&plan, onset, &played.measured_bursts).len(), 40);
    played.measured_bursts[5].sd_um = 1.0;
    played.measured_bursts[9].pulses += 1;
    assert_eq!(travels_by_telemetry(&plan, onset, &played.measured_bursts).len(), 38);
    assert_eq!(travels_by_telemetry(&plan, onset + 1, &played.measured_bursts), []);
}

#[test]
fn one_motor_is_calibrated_alone() {
    let config = SimulatedMotorsConfig::default();
    let plan = Plan::new(Array::paper(), Some(7), &[20, 100, 180], 2).unwrap();
    let fits = fit(Array::paper(), &measured(&plan, config)).unwrap();
    let [found] = &fits[..] else { panic!("{fits:?}") };
    assert_eq!((found.motor, found.up.bursts, found.down.bursts), (7, 54, 54));
}

fn provenance() -> Provenance {
    let mut made = Plan::of(Array::paper()).unwrap().provenance(
        "mock",
        "0.1.0 (build \"a\")",
        "seed 3",
        "plant, 1000 Hz",
    );
    made.date = Some("yesterday".into());
    made
}

#[test]
fn a_file_is_read_back_as_the_same_calibration() {
    let fits =
        fit(Array::paper(), &measured(&Plan::of(Array::paper()).unwrap(), SimulatedMotorsConfig::default()))
            .unwrap();
    let all = Calibration::new(Array::paper(), fits.clone(), provenance()).unwrap();
    let text = all.to_toml();
    assert!(text.starts_with("format = 1\n") && text.len() < MAX_BYTES, "{text}");
    assert_eq!(Calibration::parse(&text, "c.toml").as_ref(), Ok(&all), "{text}");
    assert_eq!(Calibration::parse(&format!("\u{feff}{text}"), "c.toml").as_ref(), Ok(&all));
    assert_eq!((all.motors(), all.provenance()), (&fits[..], &provenance()));
    assert!((0..24).all(|motor| all.gain(motor, Direction::Down)
        == fits[usize::from(motor)].down.gain(Array::paper().motor())));

    // Of some motors, in any order; the others follow the model.
    let undated = Provenance { date: None, ..provenance() };
    let some = Calibration::new(Array::paper(), vec![fits[20].clone(), fits[3].clone()], undated).unwrap();
    assert_eq!(Calibration::parse(&some.to_toml(), "c.toml").as_ref(), Ok(&some));
    assert_eq!(some.motors(), [fits[3].clone(), fits[20].clone()]);
    assert!(!some.to_toml().contains("date"));
    assert_eq!(some.gain(20, Direction::Up), fits[20].up.gain(Array::paper().motor()));
    assert_eq!((some.gain(4, Direction::Up), some.motor(4)), (1.0, None));
}

const FILE: &str = r#"format = 1

[[motor]]
motor = 3
[motor.up]
gain = 1.05
slope_um_per_pulse = 0.1425
slope_se_um_per_pulse = 0.001
offset_um = 0.01
relative_sd = 0.1
blocks = 180
[motor.down]
gain = 0.98
slope_um_per_pulse = 0.133
slope_se_um_per_pulse = 0.001
offset_um = -0.01
relative_sd = 0.1
blocks = 180

[provenance]
device = "mock"
firmware = "0.1.0"
identity = "seed 0"
telemetry = "plant"
pulses = [14, 70]
repetitions = 2
groups = 4
um_per_pulse = 0.13571428571428570
"#;

const MISTAKES: &str = r#"
format = 1 =>  => 1: `format` is missing: add format = 1
format = 1 => format = 3⏎new = 1 => 1: `format` is 3: this version reads format = 1
format = 1 => format = "1" => 1: `format` is string "1": must be a whole number, 0 or more
format = 1 => format = 1⏎motors = 1 => 2: unknown key `motors`: did you mean `motor`?
motor = 3 => motr = 3 => 4: `motor[0]`: unknown key `motr`: did you mean `motor`?
motor = 3 =>  => 3: `motor[0].motor` is missing: add a motor's number, from 0 on, below each [[motor]]
motor = 3 => motor = 24 => 4: `motor[0].motor` is 24: must be 0 to 23
motor = 3 => motor = 300 => 4: `motor[0].motor` is 300: must be 0 to 23
motor = 3 => motor = -1 => 4: `motor[0].motor` is integer `-1`: must be a whole number, 0 or more
motor = 3 => motor = 3.5 => 4: `motor[0].motor` is floating point `3.5`: must be a whole number, 0 or more
motor = 3 => motor = 3⏎motor = 4 => 5: not TOML: duplicate key…
[motor.down] => [motor.dwon] => 12: `motor[0]`: unknown key `dwon`: did you mean `down`?
gain = 0.98⏎ =>  => 12: `motor[0].down.gain` is missing: add a number, as `meissner calibrate` writes it
gain = 1.05 => gain = 1.06 => 6: `motor[0].up.gain` is 1.06, but slope_um_per_pulse gives 1.05…
gain = 1.05 => gain = nan => 6: `motor[0].up.gain` is NaN, but slope_um_per_pulse gives 1.05…
gain = 1.05 => gain = true => 6: `motor[0].up.gain` is boolean `true`: must be a number
gain = 1.05⏎slope_um_per_pulse = 0.1425 => gain = 1.75⏎slope_um_per_pulse = 0.2375 => 7: `motor[0].up.slope_um_per_pulse` is 0.2375: must be 0.5 to 1.5 times the model's, 0.1357142857142857
gain = 1.05⏎slope_um_per_pulse = 0.1425 => gain = nan⏎slope_um_per_pulse = nan => 7: `motor[0].up.slope_um_per_pulse` is NaN: must be…
slope_se_um_per_pulse = 0.001⏎offset_um = 0.01 => slope_se_um_per_pulse = 0.01⏎offset_um = 0.01 => 8: `motor[0].up.slope_se_um_per_pulse` is 0.01: must be 0 to 5 % of the slope
offset_um = -0.01 => offset_um = -inf => 16: `motor[0].down.offset_um` is -inf: must be -100 to 100 um
relative_sd = 0.1⏎ => relative_sd = -0.1⏎ => 10: `motor[0].up.relative_sd` is -0.1: must be 0 to 1
blocks = 180⏎⏎ => blocks = 9⏎⏎ => 18: `motor[0].down.blocks` is 9: must be 10 to 1000000
blocks = 180⏎⏎ => blocks = 180⏎points = [[6, 1.0, 0.1, 9]]⏎⏎ => 19: `motor[0].down.points[0][0]` is 6: must be 7 to 200
blocks = 180⏎⏎ => blocks = 180⏎points = [[7, 1.0, 0.1, 9], [7, 1.0, 0.1, 171]]⏎⏎ => 19: `motor[0].down.points[1][0]` is 7, after 7: list the numbers of pulses in rising order, each once
blocks = 180⏎⏎ => blocks = 180⏎points = [[7, 1.0, 0.1, 9], [14, 2.0, 0.1, 9]]⏎⏎ => 19: `motor[0].down.points`: 18 bursts in all, but `blocks` is 180: edit neither by hand, calibrate again
blocks = 180⏎⏎ => blocks = 180⏎points = [[7, nan, 0.1, 9]]⏎⏎ => 19: `motor[0].down.points[0][1]` is NaN: must be…
blocks = 180⏎⏎ => blocks = 180⏎points = [[7, 1.0, 0.1]]⏎⏎ => 19: `motor[0].down.points[0]`: invalid length 3, expected a tuple of size 4
[provenance] => [provenence] => 20: unknown key `provenence`: did you mean `provenance`?
device = "mock"⏎ =>  => 20: `provenance.device` is missing: add its description, in quotes
device = "mock" => device = ["mock"] => 21: `provenance.device` is…
device => date = 2024-05-01⏎device => 21: `provenance.date` is map: must be a string
repetitions = 2 => repetition = 2 => 26: `provenance`: unknown key `repetition`: did you mean `repetitions`?
repetitions = 2 => repetitions = 0 => 25: `provenance.pulses` is not a valid plan: 0 repetitions: must be 1 to 50…
[14, 70] => [14, 14] => 25: `provenance.pulses` is not a valid plan: bursts of 14 pulses are listed twice: leave one out
[14, 70] => [14, "70"] => 25: `provenance.pulses[1]` is string "70": must be a whole number, 0 to 65535
groups = 4 => groups = 5 => 27: `provenance.groups` is 5, but pulses and repetitions give 4
um_per_pulse = 0.1357 => um_per_pulse = 0.1358 => 28: `provenance.um_per_pulse` is 0.1358142857142857: the array's motors have 0.1357142857142857, so the gains do not apply…
um_per_pulse = 0.13571428571428570 => um_per_pulse = nan => 28: `provenance.um_per_pulse` is NaN: the array's…
[provenance]⏎ => [provenance]⏎date = " => 21: not TOML: …
[[motor]] => [motor] => 3: `motor` is map: must be a list
"#;

#[test]
fn a_mistake_is_refused_in_one_line_with_place_and_remedy() {
    let good = Calibration::parse(FILE, "good.toml").unwrap();
    assert!((good.gain(3, Direction::Up) - 1.05).abs() < 1e-9 && good.gain(9, Direction::Up) == 1.0);
    assert_changes_refused(FILE, MISTAKES, Calibration::parse);
    let (head, motor) = FILE.split_at(FILE.find("[[motor]]").unwrap());
    let (motor, made) = motor.split_at(motor.find("[provenance]").unwrap());
    for (document, says) in [
        (format!("{head}{motor}{motor}{made}"), ":21: `motor[1].motor` is 3, as is motor[0]: leave one out"),
        (
            format!("{head}{made}"),
            ":1: `motor` is missing: add a motor's number, from 0 on, below each [[motor]]",
        ),
        (format!("{head}motor = []\n{made}"), ":3: `motor` is empty: calibrate at least one motor"),
        (
            format!("{FILE}date = {:?}", "x".repeat(201)),
            ":29: `provenance.date` is 201 characters long: must be at most 200",
        ),
        (" ".repeat(MAX_BYTES + 1), ": 262145 bytes are too many: a calibration file has at most 262144"),
    ] {
        let line = in_one_line(Calibration::parse(&document, "bad.toml")).unwrap_err();
        assert_eq!(line, format!("bad.toml{says}"));
    }
}
