//! `render` and `judge` on small sets: what is traced, what observers read, and what is left if something is not as told.

use crate::harness::{complaint, document, offline, printed};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::tempdir;

const PRESS: &str = "[touch]\npress = { depth_um = 500, rise_s = 0.03, hold_s = 0.02, fall_s = 0.03 }\n";

fn write(dir: &Path, name: &str, shape: &str, touch: &str) {
    let text = format!("kind = \"object\"\nname = \"{name}\"\n{shape}\n{touch}");
    fs::write(dir.join(format!("{name}.toml")), text).unwrap();
}

fn line<'d>(document: &'d Value, name: &str) -> &'d Value {
    let lines = document["lines"].as_array().unwrap();
    lines.iter().find(|line| line["name"] == name).unwrap_or_else(|| panic!("{name}: {document}"))
}

/// An l and a t have the same trace until the t is crossed. A set with a height map has no traces.
#[test]
fn traced_letters_are_named_and_heights_are_not_traced() {
    let dir = tempdir().unwrap();
    let at = |lines: &str| format!("shape = \"lines\"\nlines = {lines}\nwidth_mm = 0.8");
    write(dir.path(), "l", &at("[[[0, 6], [0, -6]]]"), PRESS);
    write(dir.path(), "t", &at("[[[0, 6], [0, -6]], [[-4, 2], [4, 2]]]"), PRESS);
    write(dir.path(), "p", "shape = \"texture\"\nfile = \"p.csv\"\nmm_per_pixel = 0.5", PRESS);
    fs::write(dir.path().join("p.csv"), "height_um\n0\n0\n0\n0\n").unwrap();
    let set = |objects: [&str; 2]| {
        let mut judge = offline();
        judge.args(["judge", "--fingers", "1", "--set"]).args(objects.map(|object| dir.path().join(object)));
        judge
    };
    let found = document(set(["l.toml", "t.toml"]).arg("--json"));
    let traced = line(&found, "render trace");
    assert!(traced["real"].is_null(), "{found}");
    for reads in 0..2 {
        assert_eq!(traced["own"][reads]["named"], 1.0, "{found}");
    }
    // The share of right names is that of the confusion.
    let answers = &line(&found, "render rule")["real"][0];
    let counts: Vec<Vec<u32>> = serde_json::from_value(answers["confusion"].clone()).unwrap();
    let (right, all) = (counts[0][0] + counts[1][1], counts.concat().iter().sum::<u32>());
    let share = f64::from(right) / f64::from(all);
    assert!(all > 0 && (share - answers["named"].as_f64().unwrap()).abs() < 1e-9, "{found}");
    assert!(answers["d_prime"].as_f64().unwrap() >= 0.0, "{found}");
    let text = printed(&mut set(["l.toml", "t.toml"]));
    assert!(text.contains("2 objects, 1 finger, by") && text.contains("share named, d'\n"), "{text}");
    let mixed = document(set(["l.toml", "p.toml"]).arg("--json"));
    assert!(mixed["lines"].as_array().unwrap().iter().all(|line| line["name"] != "render trace"));

    let render = |object: &str, more: &[&str]| {
        let mut render = offline();
        let at = dir.path().join(object);
        let object = if at.exists() { at } else { object.into() };
        render.arg("render").arg(object).args(["--method", "trace"]).args(more);
        render
    };
    let seconds = |speed: &str| {
        document(&mut render("l.toml", &["--json", "--trace-mm-s", speed]))["duration_s"].as_f64().unwrap()
    };
    // 12 mm, and 0.108 s at its ends.
    assert!((seconds("20") - 0.71).abs() < 0.02 && (seconds("60") - 0.31).abs() < 0.02);
    for (object, more, line) in [
        (
            "p.toml",
            &[][..],
            "p.toml: heights have no lines to trace: draw it with shape = \"lines\", or take another method",
        ),
        (
            "moving-edge",
            &[],
            "the object moves, and a trace moves by itself: press it, or take another method",
        ),
        ("l.toml", &["--trace-mm-s", "0"], "--trace-mm-s 0: must be 1 to 200 mm/s"),
    ] {
        let found = complaint(&mut render(object, more));
        assert!(found.contains(line), "{found}");
    }
}

#[test]
fn what_renders_nothing_is_said_in_one_line() {
    let dir = tempdir().unwrap();
    let bar = "shape = \"bar\"\nlength_mm = 12\nwidth_mm = 0.8";
    let tap = "[touch]\npress = { depth_um = 500, rise_s = 0.001, hold_s = 0.001, fall_s = 0.001 }\n";
    write(dir.path(), "tap", bar, tap);
    fs::write(dir.path().join("p.toml"), "name = \"p\"\n[[ramp]]\nmotor = 1\n").unwrap();
    for (asked, line) in [
        (
            &["render", "tap.toml"][..],
            "tap.toml: the touch lasts 0.003 s, and pins move every 0.004 s: let it last longer",
        ),
        (&["render", "dot", "-o", "-"], "-o -: not a file: leave -o out to write to stdout"),
        (
            &["optimise", "dot", "--budget", "1", "-o", "-"],
            "-o -: not a file: leave -o out to write to stdout",
        ),
        (&["render", "p.toml"], "p.toml: this is a pattern, not an object: `meissner play`, `simulate`"),
        (&["judge", "--object", "p.toml"], "p.toml: this is a pattern, not an object"),
        (&["judge", "tap.toml", "--object", "dot"], "tap.toml: this is an object, not a pattern: make"),
        (&["simulate", "tap.toml"], "tap.toml: this is an object, not a scene: make a pattern of it with"),
        (&["tradeoff", "tap.toml"], "tap.toml: this is an object, not a scene"),
        (&["tradeoff", "p.toml"], "p.toml: this is a pattern, not a scene"),
        (&["simulate", "p.toml"], "p.toml:1: `format` is missing: add format = 1"),
        (&["render", "moving-edg"], "no object is called `moving-edg`: did you mean `moving-edge`?"),
    ] {
        let at = |argument: &&str| {
            let at = dir.path().join(argument);
            if at.is_file() { at } else { argument.into() }
        };
        let found = complaint(offline().args(asked.iter().map(at)));
        assert!(found.contains(line), "{found}");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
}
