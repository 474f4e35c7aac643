//! The configuration: its keys, their defaults and ranges, and how problems are worded.

use super::*;
use meissner_array::spec::ArraySpec;
use meissner_stream::LowerStopSettings;

fn parse(text: &str) -> Result<Config, String> {
    Config::parse(text, Path::new("m.toml")).map_err(|error| error.to_string())
}

#[test]
fn an_empty_file_is_the_default() {
    assert_eq!(parse("").unwrap(), Config::default());
    assert_eq!(Config::default().settings.lease_ms, 300.0);
}

#[test]
fn every_key_is_read() {
    let text = "device = \"pty\"\nsocket = \"/s\"\npatterns_dir = \"/s/p\"\nlead_ms = 50\nlease_ms = 100.0\ndrift_warning_um = 30\n\
                drift_limit_um = 60\nend_stop_um = 250\n\
                [limits]\nmotor_pulses_per_s = 40000\nrail_pulses_per_s = 90000\n[mock]\nseed = 3\ngain_sd = 0.0\n";
    let config = parse(text).unwrap();
    assert_eq!((config.device, config.socket), (Spec::Pty, "/s".into()));
    assert_eq!(config.patterns, PatternsDir::Configured("/s/p".into()));
    assert_eq!(config.calibration, Some("/s/calibration.toml".into()));
    assert_eq!(parse("calibration = \"/c\"").unwrap().calibration, Some("/c".into()));
    let kept = parse("logbook_dir = \"/l\"").unwrap();
    assert_eq!(kept.logbook, Some(Location { dir: "/l".into(), make_parents: false }));
    let limits = PowerLimits { motor: 40_000, rail: 90_000, ..Array::paper().layout().no_limits() };
    assert_eq!(
        config.settings,
        Settings {
            array: Array::paper(),
            lead_ms: 50.0,
            lease_ms: 100.0,
            limits,
            drift_warning_um: 30.0,
            drift_limit_um: 60.0,
            end_stop_um: 250.0,
            lower_stop: None
        }
    );
    // One shipped file serves every array: a limit above the array's own changes nothing.
    let above = "array = {rail_motors_at_once = 64, chip_motors_at_once = 64}\nparticipant.max_amplitude_um = 5000\n\
                 limits = {motor_pulses_per_s = 200000, rail_pulses_per_s = 12800000}";
    let above = parse(above).unwrap();
    assert_eq!(above.settings.limits, Array::paper().layout().no_limits());
    assert_eq!(above.participant.max_amplitude_um, 400.0);
    let stop = "array = {lower_stop = \"at_rest\", surplus_um = 12.5, rest_error_um = 4}\nlimits.stop_pulses_per_s = 9000";
    let few = parse("array.rail_motors_at_once = 3\narray.chip_motors_at_once = 1").unwrap().settings.limits;
    assert_eq!(few, PowerLimits { rail_at_once: 3, chip_at_once: 1, ..Array::paper().layout().no_limits() });
    let with_stop = parse(stop).unwrap();
    let lower_stop = LowerStopSettings { surplus_um: Some(12.5), rest_error_um: 4.0, pulses_per_s: 9000 };
    assert_eq!(with_stop.settings.lower_stop, Some(lower_stop));
    assert_eq!(with_stop.mock.lower_stop, LowerStop::AtRest);
    let auto = parse("[array]\nlower_stop = \"at_rest\"\nsurplus_um = \"auto\"").unwrap();
    assert_eq!(auto.settings.lower_stop, Some(LowerStopSettings::of(Array::paper())));
    // Without it, the simulated array's.
    assert_eq!(parse("mock.end_stop_um = 90").unwrap().settings.end_stop_um, 90.0);
    assert_eq!(
        config.mock,
        SimulatedMotorsConfig { seed: 3, gain_sd: 0.0, ..SimulatedMotorsConfig::default() }
    );
    let transient = |text: &str| parse(text).unwrap().mock.transient_gain;
    assert_eq!((transient("mock.transient_gain = 0.6"), transient("")), (Some(0.6), None));
    let text = "[participant]\nmax_amplitude_um = 90\nmax_continuous_s = 60\npause_s = 5\nmax_session_s = 900\nmax_day_s = 1800\n";
    let limits = ParticipantLimits {
        max_amplitude_um: 90.0,
        max_continuous_s: 60.0,
        pause_s: 5.0,
        max_session_s: 900.0,
        max_day_s: 1800.0,
    };
    assert_eq!(parse(text).unwrap().participant, limits);
    assert_eq!(parse("lead_ms = 50").unwrap().settings.lease_ms, 250.0);
}

#[test]
fn an_error_is_one_line_with_its_place() {
    for (text, says) in [
        ("\nlaed_ms = 5", "m.toml:2: unknown key `laed_ms`: did you mean `lead_ms`?"),
        ("[mock]\nsede = 1", "m.toml:2: `mock`: unknown key `sede`: did you mean `seed`?"),
        (
            "[limits]\n\nmotor = 1",
            "m.toml:3: `limits`: unknown key `motor`: did you mean `motor_pulses_per_s`?",
        ),
        ("lead_ms = 4", "m.toml:1: `lead_ms` is 4: must be 5 to 1000 ms"),
        ("lead_ms = nan", "`lead_ms` is NaN"),
        ("drift_warning_um = 0.5", "`drift_warning_um` is 0.5: must be 1 to 10000 um"),
        ("end_stop_um = -1", "`end_stop_um` is -1: must be 0 to 10000 um"),
        ("lease_ms = 149", "`lease_ms` is 149: must be 150 to"),
        ("limits.rail_pulses_per_s = 0", "`limits.rail_pulses_per_s` is 0"),
        (
            "[participant]\nmax_amplitude = 3",
            "m.toml:2: `participant`: unknown key `max_amplitude`: did you mean `max_amplitude_um`?",
        ),
        (
            "participant.max_amplitude_um = 5001",
            "`participant.max_amplitude_um` is 5001: must be 1 to 5000 um",
        ),
        ("participant.max_day_s = 0", "`participant.max_day_s` is 0: must be 0.1 to 86400 s"),
        ("participant.max_continuous_s = inf", "`participant.max_continuous_s` is inf"),
        ("participant.pause_s = -1", "`participant.pause_s` is -1: must be 0.5 to 3600 s"),
        ("session_silence_s = 0", "`session_silence_s` is 0: must be 0.1 to 3600 s"),
        ("limits = 3", "m.toml:1: `limits` is integer `3`: must be a table"),
        ("\nmock = []", "m.toml:2: `mock` is sequence: must be a table"),
        ("lead_ms = \"5\"", "m.toml:1: `lead_ms` is string \"5\": must be a number"),
        ("limits.motor_pulses_per_s = -1", "integer `-1`: must be a whole number, 0 to 4294967295"),
        ("mock.seed = -1", "`mock.seed` is integer `-1`: must be a whole number, 0 or more"),
        ("socket = 1", "must be a path in quotes"),
        ("patterns_dir = \"\"", "m.toml:1: `patterns_dir` is empty"),
        ("socket = \"\"", "m.toml:1: `socket` is empty"),
        ("calibration = \"\"", "m.toml:1: `calibration` is empty"),
        ("logbook_dir = \"\"", "m.toml:1: `logbook_dir` is empty"),
        ("array.lower_stop = \"below\"", "unknown variant `below`"),
        ("array.surplus_um = \"much\"", "`array.surplus_um` is `much`: must be a number of um, or \"auto\""),
        ("array.surplus_um = 0", "`array.surplus_um` is 0: must be 1 to 120 um, or \"auto\""),
        ("array.surplus_um = []", "must be a number, or \"auto\""),
        ("array.rail_motors_at_once = 0", "`array.rail_motors_at_once` is 0: must be 1 to 64 motors"),
        ("array.chip_motors_at_once = 65", "`array.chip_motors_at_once` is 65: must be 1 to 64 motors"),
        ("array.rest_error_um = 0", "`array.rest_error_um` is 0: must be 0.5 to 100 um"),
        ("limits.stop_pulses_per_s = 0", "`limits.stop_pulses_per_s` is 0"),
        (
            "array.lower_stop = \"at_rest\"\nlimits.stop_pulses_per_s = 7000",
            "m.toml:2: `limits.stop_pulses_per_s` is 7000: must be at least 7369 pulses/s",
        ),
        ("end_stop_um = 2000\narray.lower_stop = \"at_rest\"", "`end_stop_um` is 2000: must be at most"),
        ("mock.gain_sd = -1.0", "m.toml:1: `mock.gain_sd` is -1: must be 0 to 1"),
        ("mock.transient_gain = 3", "m.toml:1: `mock.transient_gain` is 3: must be 0 to 2"),
        ("device = \"uart\"", "m.toml:1: `device` is `uart`: not one of"),
        ("device = 3", "m.toml:1: `device` is integer `3`: must be a string"),
        ("lead_ms = ", "m.toml:1: not TOML: "),
    ] {
        let line = parse(text).unwrap_err();
        assert!(line.contains(says) && !line.contains('\n'), "{text}: {line}");
    }
    for (file, says) in [
        ("/dev/zero", "is not a regular file"),
        ("/", "is not a regular file"),
        ("/proc/self/exe", "more than"),
    ] {
        let line = Config::read(Path::new(file)).unwrap_err().to_string();
        assert!(line.contains(says) && !line.contains('\n'), "{line}");
    }
    assert!(Config::read(Path::new("/nonexistent/m.toml")).unwrap_err().to_string().contains("/nonexistent"));
}

/// A seek of the lower stop fits into what the array allows of one seek, and of pushes in a second.
#[test]
fn a_lower_stop_is_within_reach_of_a_seek() {
    let described = |name: &str, motor: &str| {
        let text = format!(
            "name = \"{name}\"\npins = {{ rows = 1, columns = 1, pitch_mm = 2.0 }}\ntick_hz = 20000\n\
             duty = {{ up = 0.2, down = 0.8 }}\n[motor]\nstep_um = 0.125\nwindow_ms = 4.0\ntravel_um = 100.0\n{motor}\n"
        );
        Array::known(ArraySpec::parse(&text, name).unwrap()).unwrap();
    };
    described("seek-exact", "most_pulses = 1000\nseek_pulses = 2300");
    described("seek-short", "most_pulses = 1600\nseek_pulses = 9000");
    let parse = |name: &str, end_stop_um: u32, more: &str| {
        parse(&format!(
            "end_stop_um = {end_stop_um}\n{more}\n[array]\ndescription = \"{name}\"\nlower_stop = \"at_rest\"\n"
        ))
    };
    let seek = |config: Config| config.settings.seek_pulses();
    // As far as the seek's limit reaches, and no farther.
    assert_eq!(parse("seek-exact", 100, "").map(seek), Ok(2_300));
    assert_eq!(parse("seek-exact", 143, "").map(seek), Ok(2_300));
    let line = parse("seek-exact", 144, "").unwrap_err();
    assert!(line.contains("`end_stop_um` is 144: must be at most 143 um with a lower stop"), "{line}");
    // As far as three tenths of the carrier.
    assert_eq!(parse("seek-short", 375, "").map(seek), Ok(6_000));
    let line = parse("seek-short", 376, "").unwrap_err();
    assert!(line.contains("`end_stop_um` is 376: must be at most 375 um with a lower stop"), "{line}");
    let line = parse("seek-short", 375, "limits.stop_pulses_per_s = 5999").unwrap_err();
    assert!(line.contains("`limits.stop_pulses_per_s` is 5999: must be at least 6000 pulses/s"), "{line}");

    let text = "name = \"seek-never\"\npins = { rows = 1, columns = 1, pitch_mm = 2.0 }\ntick_hz = 20000\n\
                duty = { up = 0.2, down = 0.8 }\n[motor]\nstep_um = 0.125\nwindow_ms = 4.0\ntravel_um = 350.0\nmost_pulses = 2800\n";
    Array::known(ArraySpec::parse(text, "seek-never").unwrap()).unwrap();
    let line = parse("seek-never", 100, "").unwrap_err();
    assert!(
        line.contains("`array.lower_stop` is at_rest: a seek of the stop takes 6440 pulses, and a motor of this array may push for 6000")
            && !line.contains('\n'),
        "{line}"
    );
}
