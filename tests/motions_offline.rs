use crate::harness::{Daemon, complaint, document, meissner, printed};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

fn wave(motor: u8, file: &str, keys: &str) -> String {
    format!("[[wave]]\nmotor = {motor}\nfile = \"{file}\"\n{keys}\n")
}

fn pattern(tables: &str) -> String {
    format!("format = 2\nname = \"touch\"\n{tables}")
}

/// A WAV file of one channel of 16 bits.
fn wav(rate_hz: u32, samples: &[i16]) -> Vec<u8> {
    let bytes = 2 * samples.len() as u32;
    let mut wav = b"RIFF".to_vec();
    wav.extend((36 + bytes).to_le_bytes());
    wav.extend(b"WAVEfmt \x10\0\0\0\x01\0\x01\0");
    wav.extend(rate_hz.to_le_bytes());
    wav.extend((2 * rate_hz).to_le_bytes());
    wav.extend(b"\x02\0\x10\0data");
    wav.extend(bytes.to_le_bytes());
    wav.extend(samples.iter().flat_map(|sample| sample.to_le_bytes()));
    wav
}

/// A column of an NPY file.
fn npy(values: &[f32]) -> Vec<u8> {
    let head = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({},), }}", values.len());
    let head = format!("{head:<117}\n");
    let mut npy = b"\x93NUMPY\x01\0".to_vec();
    npy.extend((head.len() as u16).to_le_bytes());
    npy.extend(head.as_bytes());
    npy.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    npy
}

/// The table of a wave.
const A: &str = "time_s,pin_um\n0,0\n0.01,20\n0.02,40\n0.03,20\n0.04,0\n";

fn write(dir: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    fs::write(dir.join(name), bytes).unwrap();
}

#[test]
fn a_pattern_is_packed_with_its_files_and_then_needs_them_no_longer() {
    let dir = tempdir().unwrap();
    write(dir.path(), "a.csv", A);
    let sound: Vec<i16> = (0..4410_i32).map(|k| (8000.0 * (f64::from(k) * 0.01).sin()) as i16).collect();
    write(dir.path(), "b.wav", wav(44_100, &sound));
    fs::create_dir(dir.path().join("in")).unwrap();
    write(dir.path(), "in/c.npy", npy(&[0.0, 5.0, 5.0, 0.0]));
    let text = pattern(
        &[
            wave(1, "a.csv", ""),
            wave(2, "b.wav", "scale_um = 40.0\noffset_um = 20.0"),
            wave(3, "in/c.npy", "rate_hz = 50"),
        ]
        .concat(),
    );
    write(dir.path(), "touch.toml", &text);
    let (from, to) = (dir.path().join("touch.toml"), dir.path().join("packed.toml"));
    let said = printed(meissner().args(["pattern", "pack"]).arg(&from).arg("-o").arg(&to));
    for part in [
        "motor 1: 5 samples at 100 Hz: a.csv: CSV column pin_um, 100 Hz",
        "motor 2: 800 samples at 8000 Hz: b.wav: ",
        "full scale 40 um, plus 20 um, resampled to 8000 Hz",
        "motor 3: 4 samples at 50 Hz: in/c.npy: NPY <f4",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    // On stdout it is the same text.
    let stdout = printed(meissner().args(["pattern", "pack"]).arg(&from));
    let packed = fs::read_to_string(&to).unwrap();
    assert_eq!(stdout.trim_end(), packed.trim_end());
    let samples = |file: &Path| printed(meissner().arg("displacement").arg(file));
    let before = samples(&from);
    for name in ["a.csv", "b.wav", "in/c.npy"] {
        fs::remove_file(dir.path().join(name)).unwrap();
    }
    assert_eq!(samples(&to), before);
    assert_eq!(before.lines().next(), Some("time_s,motor_1_um,motor_2_um,motor_3_um"));
    let lost = complaint(meissner().args(["pattern", "check"]).arg(&from));
    assert!(
        lost.contains("wave 1: `file`: motor 1: `a.csv`: cannot be read; name an NPY, CSV or WAV file"),
        "{lost}"
    );
    let again =
        printed(meissner().args(["pattern", "pack"]).arg(&to).arg("-o").arg(dir.path().join("again.toml")));
    assert!(again.contains("no wave names a file: the pattern is complete as it is"), "{again}");
    let itself = complaint(meissner().args(["pattern", "pack"]).arg(&to).arg("-o").arg(&to));
    assert!(itself.contains("this is the pattern's own file: write to another"), "{itself}");
    assert_eq!(fs::read_to_string(&to).unwrap(), packed);
}

#[test]
fn a_mistake_in_a_sample_file_is_one_line_with_motor_sample_and_time() {
    let dir = tempdir().unwrap();
    let text = pattern(&wave(7, "a.csv", ""));
    write(dir.path(), "touch.toml", &text);
    for (samples, says) in [
        (
            "0,0\n0.005,1\n0.01,nan\n",
            "touch.toml:5: wave 1: `file`: motor 7: `a.csv`: sample 2 at 0.01 s is NaN: must be a number",
        ),
        ("0,0\n0.005,1\n0.01,x\n", "motor 7: `a.csv`: line 4: `x` is no number; a CSV file begins with "),
        ("0,1\n", "motor 7: `a.csv`: 1 samples: must be 2 to 4194302"),
        (
            "0,0\n0.005,1\n0.01,401\n0.015,0\n",
            "wave 1: motor 7 goes to 401.000 um at 0.01 s, sample 2: must be 0 to 400 um",
        ),
    ] {
        write(dir.path(), "a.csv", format!("time_s,pin_um\n{samples}"));
        let line = complaint(meissner().args(["pattern", "pack"]).arg(dir.path().join("touch.toml")));
        assert!(line.contains(says), "{line}\n  does not say {says}");
        assert_eq!(line.trim_end().lines().count(), 1, "{line}");
    }
}

#[test]
fn a_pattern_is_checked_before_it_is_played() {
    let ramp = |rise_s: f64| {
        pattern(&format!("[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = {rise_s}\nhold_s = 0.5\n"))
    };
    let check = |text: &str, more: &[&str]| {
        let mut command = meissner();
        command.args(["pattern", "check", "-"]).args(more).write_stdin(text.to_owned());
        command
    };
    let found = document(&mut check(&ramp(0.05), &["--json"]));
    let motor = &found["followed"]["motors"][0];
    assert_eq!((&motor["motor"], &found["motions"], &found["drives"]), (&9.into(), &1.into(), &0.into()));
    let number = |value: &Value| value.as_f64().unwrap();
    assert!(
        number(&motor["from_filtered"]["peak_um"]) < 0.95 && number(&motor["from_asked"]["peak_um"]) > 7.0
    );
    assert!(
        motor["too_slow_s"].as_array().unwrap().is_empty()
            && found["warnings"].as_array().unwrap().is_empty()
    );
    assert!((0.49..0.51).contains(&number(&found["followed"]["longest_hold_s"])));
    printed(&mut check(&ramp(0.05), &["--strict"]));
    let told = printed(&mut check(&ramp(0.0), &[]));
    assert!(told.contains("2 times from 0.0000") && told.contains("warning: motor 9 is too slow"), "{told}");
    let refused = complaint(&mut check(&ramp(0.0), &["--strict"]));
    assert!(refused.contains("touch: motor 9 is too slow for its motion from 0.0000 to 0.01"), "{refused}");
    // A saturated drive is refused, too.
    let fast =
        "format = 1\nname = \"fast\"\n[[drive]]\nmotor = 3\nfrequency_hz = 300.0\namplitude_um = 80.0\n";
    let saturated = complaint(&mut check(fast, &["--strict"]));
    assert!(saturated.contains("drive 1 (motor 3) is saturated"), "{saturated}");
    let error = complaint(&mut check(&ramp(0.05), &["--error-um", "0"]));
    assert!(error.contains("error_um is 0 um: must be 0.01"), "{error}");
    let tradeoff = document(meissner().args(["pattern", "tradeoff", "rough-noise", "--json"]));
    let rows = tradeoff["rows"].as_array().unwrap();
    let moves: Vec<f64> = rows.iter().map(|row| number(&row["moves_per_s"])).collect();
    assert!(moves.len() == 4 && moves.is_sorted_by(|a, b| a > b), "{moves:?}");
    let none = complaint(meissner().args(["pattern", "tradeoff", "pin-60"]));
    assert!(none.contains("pin-60: it has no motions"), "{none}");
}

#[test]
fn the_shipped_motions_do_what_motors_can_do() {
    for name in ["press-hold", "rough-noise"] {
        let found = document(meissner().args(["pattern", "check", name, "--strict", "--json"]));
        for motor in found["followed"]["motors"].as_array().unwrap() {
            assert!(motor["from_filtered"]["r"].as_f64().unwrap() > 0.98, "{name}: {motor}");
        }
    }
    let table = printed(meissner().args(["displacement", "press-hold", "--rate-hz", "1000"]));
    let rows: Vec<f64> =
        table.lines().skip(1).map(|row| row.split(',').nth(1).unwrap().parse().unwrap()).collect();
    assert!((rows[300] - 200.0).abs() < 0.1 && rows[25] < 100.0, "{} {}", rows[25], rows[300]);
    // Down again within 50 ms, and the motor's 4.3 ms.
    assert!((600..612).contains(&rows.len()) && rows.last().unwrap().abs() < 1.0, "{rows:?}");
    // Half the scale, half the height.
    let half =
        printed(meissner().args(["displacement", "press-hold", "--rate-hz", "1000", "--scale", "0.5"]));
    let held: f64 = half.lines().nth(301).unwrap().split(',').nth(1).unwrap().parse().unwrap();
    assert!((held - 100.0).abs() < 0.1, "{held}");
}

#[test]
fn motions_are_simulated_by_both_models() {
    for model in ["membrane", "afferents"] {
        let spikes = |pattern: &str, seconds: &str| {
            let asked = ["simulate", pattern, "--model", model, "--seconds", seconds, "--json"];
            let found = document(meissner().args(asked));
            assert_eq!((&found["model"], &found["pattern"]), (&model.into(), &pattern.into()));
            let afferents = found["afferents"].as_array().unwrap().len();
            let trains = found["spikes_s"].as_array().unwrap();
            assert_eq!((trains.len(), found["rates_hz"].as_array().unwrap().len()), (afferents, afferents));
            trains.iter().map(|train| train.as_array().unwrap().len()).sum::<usize>()
        };
        let [rough, press] = ["rough-noise", "press-hold"].map(|name| spikes(name, "1"));
        assert!(rough > 300 && press > 0, "{model}: {rough} {press}");
        assert!(spikes("rough-noise", "0.5") < rough);
    }
    // A pattern of drives gives the spikes of the scene with these drives and a fingertip.
    let rows = printed(meissner().args(["simulate", "press-hold", "--csv"]));
    assert_eq!(rows.lines().next(), Some("afferent,class,row,x_mm,y_mm,spikes,rate_hz"));
    let endless = complaint(meissner().args(["simulate", "pin-60"]));
    assert!(endless.contains("`pin-60` has no end: say for how long with --seconds"), "{endless}");
    let refused = meissner().args(["simulate", "press-hold", "--method", "exact"]).output().unwrap();
    assert_eq!(refused.status.code(), Some(2));
    for option in [["--seconds", "1"], ["--scale", "0.5"], ["--fit", "cover"]] {
        let scene =
            meissner().args(["simulate", "library/scenes/sixty-hertz.toml"]).args(option).output().unwrap();
        assert_eq!(scene.status.code(), Some(2));
    }
    let rates = |options: &[&str]| {
        let found = document(meissner().args(["simulate", "edge-45", "--json"]).args(options));
        (found["seconds"].as_f64().unwrap(), found["classes"][0]["mean_hz"].as_f64().unwrap())
    };
    let [whole, half] = ["1", "0.5"].map(|scale| rates(&["--seconds", "0.3", "--scale", scale]));
    assert!(whole.0 == half.0 && 0.0 < half.1 && half.1 < whole.1, "{whole:?} {half:?}");
    let [whole, cover] = ["whole", "cover"].map(|fit| rates(&["--seconds", "0.333", "--fit", fit]).0);
    assert!(whole < cover, "{whole} {cover}");
}

#[test]
fn what_changes_drives_only_refuses_motions() {
    let dir = tempdir().unwrap();
    let press = printed(meissner().args(["pattern", "pack"]).arg("library/patterns/motions/press-hold.toml"));
    write(dir.path(), "press-hold.toml", press);
    let file = dir.path().join("press-hold.toml");
    let out = dir.path().join("new.toml");
    let resumed = complaint(meissner().args(["optimise", "dot", "--resume"]).arg(&file).arg("-o").arg(&out));
    assert!(resumed.contains("`press-hold` has motions, and a search changes drives only"), "{resumed}");
}

#[test]
fn a_daemon_stores_a_pattern_with_its_samples_and_shows_what_it_reaches() {
    let daemon = Daemon::start();
    let dir = tempdir().unwrap();
    write(dir.path(), "a.csv", A);
    let drive = "[[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = 80.0\nstop_s = 1.0\n";
    write(dir.path(), "touch.toml", pattern(&format!("{drive}{}", wave(1, "a.csv", ""))));
    let said = printed(daemon.meissner().arg("import").arg(dir.path().join("touch.toml")));
    assert!(said.contains("imported touch, packed with its sample files (sha256 "), "{said}");
    let list = printed(daemon.meissner().arg("list"));
    assert!(list.lines().any(|line| line.starts_with("touch ") && line.contains("1 + 1 motions")), "{list}");
    let shown = printed(daemon.meissner().args(["show", "touch"]));
    assert!(shown.contains("too_slow_s") && shown.contains("longest hold"), "{shown}");
    let json = document(daemon.meissner().args(["show", "touch", "--json"]));
    assert!(json["pattern"]["wave"][0]["source"].as_str().unwrap().starts_with("a.csv: CSV"), "{json}");
    let plain = printed(daemon.meissner().args(["show", "pin-60"]));
    assert!(!plain.contains("too_slow_s"), "{plain}");
}
