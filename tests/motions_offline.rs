use crate::harness::{Daemon, complaint, document, offline, printed};

use std::fs;
use std::path::Path;
use tempfile::tempdir;

fn wave(motor: u8, file: &str) -> String {
    format!("[[wave]]\nmotor = {motor}\nfile = \"{file}\"\n")
}

fn pattern(tables: &str) -> String {
    format!("format = 1\nname = \"touch\"\n{tables}")
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
    fs::create_dir(dir.path().join("in")).unwrap();
    write(dir.path(), "in/b.csv", A);
    let text = pattern(&[wave(1, "a.csv"), wave(3, "in/b.csv")].concat());
    write(dir.path(), "touch.toml", &text);
    let (from, to) = (dir.path().join("touch.toml"), dir.path().join("packed.toml"));
    let said = printed(offline().args(["pattern", "pack"]).arg(&from).arg("-o").arg(&to));
    assert!(said.contains("motor 1: 5 samples at 100 Hz: a.csv: CSV column pin_um, 100 Hz"), "{said}");
    // On stdout it is the same text.
    let stdout = printed(offline().args(["pattern", "pack"]).arg(&from));
    let packed = fs::read_to_string(&to).unwrap();
    assert_eq!(stdout.trim_end(), packed.trim_end());
    let samples = |file: &Path| printed(offline().arg("displacement").arg(file));
    let before = samples(&from);
    for name in ["a.csv", "in/b.csv"] {
        fs::remove_file(dir.path().join(name)).unwrap();
    }
    assert_eq!(samples(&to), before);
    assert_eq!(before.lines().next(), Some("time_s,motor_1_um,motor_3_um"));
    let lost = complaint(offline().args(["pattern", "check"]).arg(&from));
    assert!(
        lost.contains("wave 1: `file`: motor 1: `a.csv`: cannot be read; name an NPY, CSV or WAV file"),
        "{lost}"
    );
    let itself = complaint(offline().args(["pattern", "pack"]).arg(&to).arg("-o").arg(&to));
    assert!(itself.contains("this is the pattern's own file: write to another"), "{itself}");
    assert_eq!(fs::read_to_string(&to).unwrap(), packed);
    // A mistake in a sample file is one line with motor, sample and time.
    write(dir.path(), "a.csv", "time_s,pin_um\n0,0\n0.005,1\n0.01,nan\n");
    let line = complaint(offline().args(["pattern", "pack"]).arg(&from));
    assert!(
        line.contains("touch.toml:5: wave 1: `file`: motor 1: `a.csv`: sample 2 at 0.01 s is NaN"),
        "{line}"
    );
}

#[test]
fn a_pattern_is_checked_before_it_is_played() {
    let ramp = |rise_s: f64| {
        pattern(&format!("[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = {rise_s}\nhold_s = 0.5\n"))
    };
    let dir = tempdir().unwrap();
    let check = |text: &str, more: &[&str]| {
        write(dir.path(), "touch.toml", text);
        let mut command = offline();
        command.args(["pattern", "check"]).arg(dir.path().join("touch.toml")).args(more);
        command
    };
    let found = document(&mut check(&ramp(0.05), &["--json"]));
    let motor = &found["followed"]["motors"][0];
    assert_eq!((&motor["motor"], &found["motions"], &found["drives"]), (&9.into(), &1.into(), &0.into()));
    assert!(motor["from_filtered"]["peak_um"].as_f64().unwrap() < 0.95, "{found}");
    assert!(found["warnings"].as_array().unwrap().is_empty(), "{found}");
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
}

#[test]
fn the_shipped_motions_do_what_motors_can_do() {
    for name in ["press-hold", "rough-noise"] {
        let found = document(offline().args(["pattern", "check", name, "--strict", "--json"]));
        for motor in found["followed"]["motors"].as_array().unwrap() {
            assert!(motor["from_filtered"]["r"].as_f64().unwrap() > 0.98, "{name}: {motor}");
        }
    }
    let table = printed(offline().args(["displacement", "press-hold", "--rate-hz", "1000"]));
    let rows: Vec<f64> =
        table.lines().skip(1).map(|row| row.split(',').nth(1).unwrap().parse().unwrap()).collect();
    assert!((rows[300] - 200.0).abs() < 0.1 && rows[25] < 100.0, "{} {}", rows[25], rows[300]);
    // Down again within 50 ms, and the motor's 4.3 ms.
    assert!((600..612).contains(&rows.len()) && rows.last().unwrap().abs() < 1.0, "{rows:?}");
    // Patterns without drives are simulated, too.
    let [rough, press] = ["rough-noise", "press-hold"].map(|name| {
        let found = document(offline().args(["simulate", name, "--seconds", "1", "--json"]));
        found["spikes_s"]
            .as_array()
            .unwrap()
            .iter()
            .map(|train| train.as_array().unwrap().len())
            .sum::<usize>()
    });
    assert!(rough > 300 && press > 0, "{rough} {press}");
}

pub(crate) fn a_daemon_stores_a_pattern_with_its_samples_and_shows_what_it_reaches(daemon: &Daemon) {
    write(&daemon.path(""), "a.csv", A);
    let drive = "[[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = 80.0\nstop_s = 1.0\n";
    write(&daemon.path(""), "touch.toml", pattern(&format!("{drive}{}", wave(1, "a.csv"))));
    let said = printed(daemon.meissner().args(["import", "touch.toml"]));
    assert!(said.contains("imported touch, packed with its sample files (sha256 "), "{said}");
    let list = printed(daemon.meissner().arg("list"));
    assert!(list.lines().any(|line| line.starts_with("touch ") && line.contains("1 + 1 motions")), "{list}");
    let shown = printed(daemon.meissner().args(["show", "touch"]));
    assert!(shown.contains("too_slow_s") && shown.contains("longest hold"), "{shown}");
    let json = document(daemon.meissner().args(["show", "touch", "--json"]));
    assert!(json["pattern"]["wave"][0]["source"].as_str().unwrap().starts_with("a.csv: CSV"), "{json}");
}
