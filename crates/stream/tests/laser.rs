//! Calibration with a laser: recordings of simulated motors, good and bad, from CSV to gains.

use firmware_protocol::tick::Tick;
use meissner_array::random::{normal, uniform};
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_stream::calibrate::{
    Calibration, Figure, LaserFit, Layout, Plan, PlayedOn, PlayedPlan, Recording, Sensor, fit, fit_recording,
    laser_plan, simulated_recording, travels_by_sensor,
};
use meissner_test_support::at_length;
use meissner_test_support::statistics::rms;

fn played_plan(plan: &Plan, motor: u8, onset: Tick) -> PlayedPlan {
    let on = PlayedOn {
        device: "serial".into(),
        firmware: "0.1.0 (6d656973)".into(),
        identity: "E6614C".into(),
        boot: 7,
        date: "2026-03-04T12:00:00Z".into(),
    };
    PlayedPlan::new(plan, motor, onset, on)
}

/// The default plan of a motor.
fn played(motor: u8) -> PlayedPlan {
    played_plan(&laser_plan(Array::paper(), motor, None, None).unwrap(), motor, Tick::BOOT + 123_457)
}

fn fitted(played: &PlayedPlan, motors: &SimulatedMotorsConfig, sensor: &Sensor) -> Result<LaserFit, String> {
    let text = simulated_recording(played, motors, sensor);
    let recording =
        Recording::read(text.as_bytes(), &Layout::default()).map_err(|error| error.to_string())?;
    fit_recording(played, &recording).map_err(|error| error.to_string())
}

/// The true mean gains of a simulated motor, up and down.
fn true_gains(config: &SimulatedMotorsConfig, motor: u8) -> [f64; 2] {
    let asymmetry = config.asymmetry_sd * normal([config.seed, motor.into(), 0, 2]);
    [1.0 + asymmetry / 2.0, 1.0 - asymmetry / 2.0]
}

/// The gains that an ideal sensor finds in the same bursts: their scatter is in them.
fn realised_gains(config: &SimulatedMotorsConfig, plan: &Plan, motor: u8, onset: Tick) -> [f64; 2] {
    let mut motors =
        SimulatedMotors::new(Array::paper(), SimulatedMotorsConfig { telemetry_hz: 0, ..*config }, onset)
            .unwrap();
    let travels = travels_by_sensor(plan, &mut motors);
    let found = fit(Array::paper(), &travels).unwrap().into_iter().find(|fit| fit.motor == motor).unwrap();
    [found.up.gain(Array::paper().motor()), found.down.gain(Array::paper().motor())]
}

/// A sensor with errors of its own: 0.1 um noise, 1 kHz, a clock that is up to 500 ppm off, and the rest at random.
fn random_sensor(seed: u64) -> Sensor {
    let of = |what: u64| uniform([seed, what, 0, 99])[0];
    Sensor {
        clock_error_ppm: if of(0) < 0.5 { -500.0 } else { 500.0 },
        drift_um_per_s: 2.0 * of(1) - 1.0,
        offset_um: 1000.0 * of(2) - 500.0,
        before_s: 20.0 * of(3) + 0.3,
        after_s: 20.0 * of(4) + 0.3,
        first_s: 1e4 * of(5),
        missing: 0.02 * of(6),
        reversed: of(7) < 0.5,
        seed,
        ..Sensor::default()
    }
}

/// Within 2 % of the mean gains that the motors have, and nearer to those that the played bursts had.
#[test]
fn gains_are_found_through_noise_drift_gaps_a_wrong_clock_and_a_wrong_sign() {
    let (mut worst, mut worst_realised, mut told) = (0.0_f64, 0.0_f64, Vec::new());
    for seed in 0..at_length(2, 8) {
        let config = SimulatedMotorsConfig { seed, ..SimulatedMotorsConfig::default() };
        for motor in [0, 9, 23] {
            let (played, sensor) = (played(motor), random_sensor(seed * 24 + u64::from(motor)));
            let found = fitted(&played, &config, &sensor).unwrap();
            let plan = laser_plan(Array::paper(), motor, None, None).unwrap();
            let realised = realised_gains(&config, &plan, motor, Tick::BOOT + 123_457);
            let gains = [found.gain_up, found.gain_down];
            for ((gain, truth), realised) in gains.into_iter().zip(true_gains(&config, motor)).zip(realised) {
                worst = worst.max((gain.value / truth - 1.0).abs());
                worst_realised = worst_realised.max((gain.value / realised - 1.0).abs());
                told.push((gain.value - truth) / gain.sd);
            }
            assert_eq!(found.reversed, sensor.reversed, "{seed} {motor}");
            assert!((found.noise_um - 0.1).abs() < 0.002, "{found:?}");
            let off = |figure: Figure, truth: f64| (figure.value - truth).abs() / figure.sd;
            let sign = if sensor.reversed { -1.0 } else { 1.0 };
            let drift_off = off(found.drift_um_per_s, sensor.drift_um_per_s);
            assert!(drift_off < 4.5, "{seed} {motor}: {drift_off} {sign} {:?}", found.drift_um_per_s);
            assert!(off(found.clock_error_ppm, sensor.clock_error_ppm) < 4.5, "{:?}", found.clock_error_ppm);
            let first_s = sensor.first_s + sensor.before_s * (1.0 + sensor.clock_error_ppm / 1e6);
            assert!(
                (found.first_burst_s.value - first_s).abs() < 5e-5,
                "{:?}: {first_s}",
                found.first_burst_s
            );
            for scatter in [found.scatter_up, found.scatter_down] {
                assert!(off(scatter, 0.1) < 4.5, "{scatter:?}");
            }
            assert!(found.correlation > 0.99 && found.bursts_covered > 900, "{found:?}");
        }
    }
    println!(
        "worst error {:.2} % of the truth, {:.3} % of the bursts as played",
        worst * 100.0,
        worst_realised * 100.0
    );
    assert!(worst < 0.02, "{worst}");
    assert!(worst_realised < 0.002, "{worst_realised}");
    // The stated standard deviations are true: 12 gains, 48 at length, within four standard errors.
    let ratio = rms(told.iter().copied());
    assert!((ratio - 1.0).abs() < 4.0 / (2.0 * told.len() as f64).sqrt(), "{ratio}");
}

/// A plan of one minute is enough for what is not about scatter.
fn short() -> PlayedPlan {
    let plan = laser_plan(Array::paper(), 3, Some(&[7, 35, 70, 91]), Some(2)).unwrap();
    played_plan(&plan, 3, Tick::BOOT)
}

/// Motors without scatter: what is left is the method's own error.
fn steady() -> SimulatedMotorsConfig {
    SimulatedMotorsConfig { gain_sd: 0.0, asymmetry_sd: 0.05, seed: 4, ..SimulatedMotorsConfig::default() }
}

#[test]
fn without_scatter_the_gains_are_found_to_a_tenth_of_a_per_cent() {
    let (played, truth) = (short(), true_gains(&steady(), 3));
    for sensor in [
        Sensor { noise_um: 0.001, ..Sensor::default() },
        Sensor { noise_um: 0.001, samples_per_s: 210.0, ..Sensor::default() },
        Sensor { noise_um: 0.05, samples_per_s: 5000.0, clock_error_ppm: -950.0, ..Sensor::default() },
        Sensor { drift_um_per_s: 20.0, reversed: true, clock_error_ppm: 0.0, ..Sensor::default() },
        // Started late and stopped early, by a group each.
        Sensor { before_s: -2.9, after_s: -3.1, ..Sensor::default() },
    ] {
        let found = fitted(&played, &steady(), &sensor).unwrap();
        for (gain, truth) in [found.gain_up, found.gain_down].into_iter().zip(truth) {
            assert!((gain.value / truth - 1.0).abs() < 0.001, "{sensor:?}: {gain:?} {truth}");
        }
        assert!(found.scatter_up.value < 0.01 && found.scatter_down.value < 0.01, "{found:?}");
        assert_eq!(found.pin_shift_um.is_some(), sensor.before_s > 0.0, "{sensor:?}");
    }
    // The transients are in the recording, and not in the gains: the pin ended lower.
    let found = fitted(&played, &steady(), &Sensor::default()).unwrap();
    assert!(found.pin_shift_um.unwrap() < -5.0, "{found:?}");
}

#[test]
fn a_calibration_by_laser_is_a_calibration_like_any_other() {
    let played = short();
    assert_eq!(PlayedPlan::parse(&played.to_json()), Ok(played.clone()));
    let found = fitted(&played, &steady(), &Sensor::default()).unwrap();
    let calibration = found.calibration(&played).unwrap();
    let read = Calibration::parse(&calibration.to_toml(), "c.toml").unwrap();
    assert_eq!(read, calibration);
    assert_eq!(
        (read.provenance().telemetry.as_str(), read.provenance().identity.as_str()),
        ("laser", "E6614C")
    );
    // The trace follows the pin, transients and all.
    let left: Vec<f64> = found.trace.iter().map(|point| point.measured_um - point.fitted_um).collect();
    assert!((rms(left.iter().copied()) - 0.1).abs() < 0.01 && left.len() > 20_000);
    // A second motor joins the file; one that is measured again replaces itself.
    let plan = laser_plan(Array::paper(), 9, None, None).unwrap();
    let ninth = played_plan(&plan, 9, Tick(500));
    let second = fitted(&ninth, &steady(), &Sensor::default()).unwrap().calibration(&ninth).unwrap();
    let both = second.with_other_motors(&read);
    assert_eq!(both.motors().iter().map(|fit| fit.motor).collect::<Vec<_>>(), [3, 9]);
    assert_eq!(both.clone().with_other_motors(&both), both);
}

/// Every kind of bad recording is refused in a line that says what is wrong.
#[test]
fn bad_recordings_are_refused_in_one_line() {
    let (played, good) = (short(), Sensor::default());
    let refused = |motors: &SimulatedMotorsConfig, sensor: Sensor| {
        fitted(&played, motors, &sensor).map(drop).unwrap_err()
    };
    let edited = |edit: &dyn Fn(f64, f64) -> Option<(f64, f64)>| {
        let text = simulated_recording(&played, &steady(), &good);
        let line = |line: &str| {
            let (time, um) = line.split_once(',')?;
            let (time, um) = edit(time.parse().ok()?, um.parse().ok()?)?;
            Some(format!("{time:.6},{um:.4}\n"))
        };
        let header = "time_s,displacement_um\n".to_owned();
        let text = header + &text.lines().filter_map(line).collect::<String>();
        let recording =
            Recording::read(text.as_bytes(), &Layout::default()).map_err(|error| error.to_string())?;
        fit_recording(&played, &recording).map(drop).map_err(|error| error.to_string())
    };
    let dead = SimulatedMotorsConfig { end_stop_um: 0.0, ..steady() };
    let wild = SimulatedMotorsConfig { gain_sd: 0.48, seed: 2, ..steady() };
    let long_and_wild = fitted(&self::played(3), &wild, &good).map(drop).unwrap_err();
    let other =
        played_plan(&laser_plan(Array::paper(), 3, Some(&[91, 7, 50, 28]), Some(2)).unwrap(), 3, Tick::BOOT);
    let of_other = simulated_recording(&other, &steady(), &good);
    let of_other = Recording::read(of_other.as_bytes(), &Layout::default()).unwrap();
    let middle = good.first_s + good.before_s + played.duration_s() / 2.0;
    for (line, says) in [
        (refused(&dead, good), "the pin moves by 0.0"),
        (refused(&steady(), Sensor { samples_per_s: 100.0, ..good }), "one sample each 10.0 ms is too slow"),
        (
            refused(&steady(), Sensor { clock_error_ppm: 1150.0, ..good }),
            "the sensor's clock differs by 1150 ppm",
        ),
        (
            refused(&steady(), Sensor { clock_error_ppm: 20_000.0, ..good }),
            "does not follow the plan's bursts",
        ),
        (refused(&steady(), Sensor { noise_um: 60.0, ..good }), "does not follow the plan's bursts"),
        (long_and_wild, "bursts upwards scatter by "),
        (
            fit_recording(&played, &of_other).unwrap_err().to_string(),
            "does not follow the plan's bursts (correlation 0.",
        ),
        (
            edited(&|time, um| (time < middle - 5.0).then_some((time, um))).unwrap_err(),
            "it covers 46 of 160 bursts: record from before",
        ),
        (
            edited(&|time, um| Some((time, um.max(-10.0)))).unwrap_err(),
            "the sensor is clipped at -10.00 um, in ",
        ),
        (
            edited(&|time, um| Some((time, um * 3.0))).unwrap_err(),
            "motor 3, upwards: a pulse moves the pin by 0.386 um",
        ),
        (
            edited(&|time, um| Some((time, um * 1000.0))).unwrap_err(),
            "motor 3, upwards: a pulse moves the pin by 12",
        ),
        (edited(&|time, um| Some((time * 1000.0, um))).unwrap_err(), "lasts "),
        (edited(&|_, _| None).unwrap_err(), "has no row of numbers"),
    ] {
        assert!(line.contains(says) && !line.contains('\n') && line.len() < 300, "{says}: {line}");
    }
}

#[test]
fn a_bad_plan_is_refused_in_one_line() {
    let good = short().to_json();
    for (from, to, says) in [
        ("\"format\":1", "\"format\":2", "`format` is 2: this version reads format 1"),
        ("\"motor\":3", "\"motor\":24", "`motor` is 24: must be 0 to 23"),
        ("\"repetitions\":2", "\"repetitions\":0", "`pulses`: 0 repetitions: must be 1 to 25"),
        (
            "\"boot\"",
            "\"boots\"",
            "not a plan that `meissner calibrate --plan` writes: unknown field `boots`",
        ),
        ("{\"format\"", "[{\"format\"", "not a plan that `meissner calibrate --plan` writes"),
    ] {
        let line = PlayedPlan::parse(&good.replace(from, to)).unwrap_err().to_string();
        assert!(line.starts_with(says) && !line.contains('\n'), "{line}");
    }
    // Of a plan for all motors, too.
    let all = Plan::new(Array::paper(), None, &[14, 70, 140], 1).unwrap();
    for motor in [0, 23] {
        let played = played_plan(&all, motor, Tick(500));
        assert_eq!(PlayedPlan::parse(&played.to_json()), Ok(played));
    }
    let mut bursts: Vec<&str> = good.lines().collect();
    bursts.swap(4, 5);
    let line = PlayedPlan::parse(&bursts.join("\n")).unwrap_err().to_string();
    assert!(line.contains("is not as planned"), "{line}");
    // Each field of a burst that differs from the plan, the first and the last burst, and one burst more or less.
    let value: serde_json::Value = serde_json::from_str(&good).unwrap();
    let last = value["bursts"].as_array().unwrap().len() - 1;
    let edit = |index: usize, key: &str, to: serde_json::Value| {
        let mut edited = value.clone();
        edited["bursts"][index][key] = to;
        PlayedPlan::parse(&edited.to_string()).unwrap_err().to_string()
    };
    let burst = &value["bursts"][last];
    let (tick, pulses) = (burst["tick"].as_u64().unwrap(), burst["pulses"].as_u64().unwrap());
    for (index, key, to) in [
        (0, "pulses", 0.into()),
        (last, "pulses", 0.into()),
        (last, "pulses", (pulses + 1).into()),
        (last, "tick", (tick + 1).into()),
        (last, "tick", u64::MAX.into()),
        (last, "direction", "up".into()),
        (last, "warm_up", (!burst["warm_up"].as_bool().unwrap()).into()),
    ] {
        let line = edit(index, key, to);
        assert!(line.starts_with(&format!("`bursts[{index}]` is not as planned")), "{key}: {line}");
    }
    // All ticks count from the first.
    assert!(edit(0, "tick", 0.into()).starts_with("`bursts[1]` is not as planned"));
    for more in [false, true] {
        let mut edited = value.clone();
        let bursts = edited["bursts"].as_array_mut().unwrap();
        if more {
            bursts.push(burst.clone());
        } else {
            bursts.pop();
        }
        let found = bursts.len();
        let line = PlayedPlan::parse(&edited.to_string()).unwrap_err().to_string();
        assert_eq!(line, format!("`bursts` has {found}: the plan has {}; do not edit it", last + 1));
    }
}
