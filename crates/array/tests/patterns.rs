//! Pattern files: valid ones, mistakes, and the shipped library.

use meissner_array::pattern::{
    Drive, MAX_PROVENANCE_TABLES, MAX_PROVENANCE_TEXT, MAX_PROVENANCE_VALUES, Pattern, Problem,
};
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_input::document;
use meissner_test_support::documents::{assert_changes_refused, in_one_line};
use std::fs;
use std::path::Path;

const GOOD: &str = r#"format = 1
name = "good"
duration_s = 5

[[drive]]
motor = 9
frequency_hz = 60.0
amplitude_um = 80
phase = 0.25

[[drive]]
motor = 3
frequency_hz = 60.0
amplitude_um = 80.0
phase = 0.0
start_s = 1.0
stop_s = 2.0

[provenance]
method = "hand-made"
model = 1
cost = { mean = 193.0, seeds = [1, 2] }
"#;

#[test]
fn a_file_is_read_and_written_back_as_the_same_pattern() {
    let pattern = Pattern::parse(GOOD, "good.toml").unwrap();
    assert_eq!((pattern.name(), pattern.duration_s()), ("good", Some(5.0)));
    let drive =
        Drive { motor: 9, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.25, start_s: None, stop_s: None };
    assert_eq!(pattern.drives()[0], drive);
    assert_eq!(pattern.provenance()["cost"]["seeds"][1].as_integer(), Some(2));
    assert_eq!(Pattern::parse(&pattern.to_toml(), "again").unwrap(), pattern);
    let json = serde_json::to_value(&pattern).unwrap();
    assert_eq!(json["drive"][1]["stop_s"], 2.0);
    assert_eq!(json["provenance"]["method"], "hand-made");
}

const MISTAKES: &str = r#"
format = 1 => format = 3 => 1: `format` is 3…format = 1
format = 1 =>  => 1: `format` is missing…add format = 1
format = 1 => format = "1" => 1: `format` is string "1"…a whole number
name = "good" =>  => 1: `name` is missing…as the file is called
"good" => "Good" => 2: `name` is `Good`…a-z, 0-9 and -
"good" => "" => 2: `name` is ``…1 to 64
"good" => "../a\nb" => 2: `name` is `../a\nb`…a-z, 0-9 and -
duration_s = 5 => duration_s = 0 => 3: `duration_s` is 0…at least one tick
duration_s = 5 => duration_s = -1.0 => 3: `duration_s` is -1…at least one tick
duration_s = 5 => duration_s = nan => 3: `duration_s` is NaN…at least one tick
duration_s = 5 => duration_s = inf => 3: `duration_s` is inf…at most
duration_s = 5 => durations = 5 => 3: unknown key `durations`…did you mean `duration_s`?
duration_s = 5 => duration_s = 5⏎"a\nb" = 1 => 4: unknown key `a\nb`…did you mean
duration_s = 5 => duration_s = 1 => 16: drive 2: `start_s` is 1: beyond…raise duration_s from 1
duration_s = 5 => duration_s = 1.5 => 17: drive 2: `stop_s` is 2: beyond…raise duration_s
duration_s = 5 => duration_s =  => 3: not TOML…
motor = 9 => motor = 24 => 6: drive 1: `motor` is 24…0 to 23
motor = 9 => motor = -1 => 6: drive 1: `motor` is -1…the number of a motor…
motor = 9 => motor = 9.0 => 6: drive 1: `motor` is floating point `9.0`…a whole number
motor = 9 => motor = 99999999999999999999 => 6: drive 1: `motor`…a whole number
motor = 9 =>  => 5: drive 1: `motor` is missing…from 0 on
motor = 9 => motor = 3 => 12: drive 2: `motor` is 3, which drive 1 still drives…stop that one by 1 s
motor = 3 => motr = 3 => 12: drive 2: unknown key `motr`…did you mean `motor`?
frequency_hz = 60.0 => frequency = 60.0 => 7: drive 1: unknown key…`frequency_hz`?
frequency_hz = 60.0 => frequency_hz = 300.1 => 7: drive 1: `frequency_hz` is 300.1…0.1 to 300
frequency_hz = 60.0 => frequency_hz = 0 => 7: drive 1: `frequency_hz` is 0…0.1 to 300
frequency_hz = 60.0 => frequency_hz = nan => 7: drive 1: `frequency_hz` is NaN…0.1 to 300
frequency_hz = 60.0 => frequency_hz = [] => 7: drive 1: `frequency_hz` is sequence…a number
amplitude_um = 80⏎ => amplitude_um = 401⏎ => 8: drive 1: `amplitude_um` is 401…0 to 400
amplitude_um = 80⏎ => amplitude_um = -inf⏎ => 8: drive 1: `amplitude_um` is -inf…0 to 400
phase = 0.25 => phase = 1.0 => 9: drive 1: `phase` is 1…below 1
start_s = 1.0 => start_s = -1.0 => 16: drive 2: `start_s` is -1…0 to
stop_s = 2.0 => stop_s = 1.0 => 17: drive 2: `stop_s` is 1…above start_s, which is 1
[[drive]]⏎motor = 9 => [[driv]]⏎motor = 9 => 5: unknown key `driv`…did you mean `drive`?
model = 1 => made = 2013-01-01 => 19: `provenance` holds a date at `made`…quote it
[provenance] => [[provenance]] => 19: `provenance` is sequence…must be a table
"#;

#[test]
fn a_mistake_is_refused_in_one_line_with_place_and_remedy() {
    assert_changes_refused(GOOD, MISTAKES, Pattern::parse);
}

#[test]
fn size_and_number_of_drives_are_bounded() {
    let large = format!("{GOOD}#{}", "x".repeat(1 << 20));
    let problem = |text: &str| Pattern::parse(text, "f").unwrap_err().0.problem;
    assert!(matches!(problem(&large), document::Problem::Own(Problem::TooLarge { .. })));
    let drive = "[[drive]]\nmotor = 0\nfrequency_hz = 60.0\namplitude_um = 80.0\n";
    let many = format!("format = 1\nname = \"many\"\n{}", drive.repeat(4097));
    assert_eq!(problem(&many), document::Problem::Own(Problem::TooManyDrives { count: 4097 }));
    // A file's name does not break the line either.
    in_one_line(Pattern::parse("", "a\nb")).unwrap_err();
}

/// A pattern's text with `drives` drives on all motors in turn, every key written out, and a comment on each line.
fn long(drives: usize) -> String {
    let mut text = "format = 1\nname = \"long\"\nduration_s = 1e4\n".to_owned();
    for number in 0..drives {
        let (motor, start_s) = (number % 24, (number / 24) as f64);
        text += &format!(
            "[[drive]] #\nmotor = {motor} #\nfrequency_hz = 60.5 #\namplitude_um = 80.5 #\nphase = 0.25 #\n"
        );
        text += &format!("start_s = {start_s:.3} #\nstop_s = {:.3} #\n\n", start_s + 0.875);
    }
    text
}

#[test]
fn the_longest_pattern_with_a_full_provenance_is_read() {
    let lists = format!("{:?}", [0; 127]).repeat(MAX_PROVENANCE_VALUES / 128 - 1).replace("][", "], [");
    let text = format!("{}[provenance]\nlists = [{lists}]\ntext = {:?}\n", long(4096), "x".repeat(1 << 16));
    let pattern = Pattern::parse(&text, "long.toml").unwrap();
    assert_eq!(pattern.drives().len(), 4096);
    let again = Pattern::parse(&pattern.to_toml(), "again").unwrap();
    assert_eq!(again, pattern);
}

#[test]
fn a_large_provenance_is_refused_with_place_and_remedy() {
    let remedy = "leave some out, or keep them in a file of their own";
    let nested =
        |open: &str, close: &str, count| [open.repeat(count), "1".into(), close.repeat(count)].concat();
    for (provenance, says) in [
        (format!("a = {:?}", [1; MAX_PROVENANCE_VALUES]), "16384 keys and list items"),
        (format!("a = [{}]", "{},".repeat(MAX_PROVENANCE_TABLES + 1)), "2048 tables"),
        (format!("a = {:?}", "x".repeat(MAX_PROVENANCE_TEXT)), "131072 bytes of text"),
        (format!("{} = 1", "x".repeat(MAX_PROVENANCE_TEXT + 1)), "131072 bytes of text"),
        (format!("a = {}", nested("[", "]", 16)), "16 tables and lists within one another"),
        (format!("a.{} = 1", nested("b.", "c", 15)), "16 tables and lists within one another"),
    ] {
        let head = "format = 1\nname = \"large\"\n[provenance]\n";
        let line = in_one_line(Pattern::parse(&format!("{head}{provenance}\n"), "large.toml")).unwrap_err();
        assert_eq!(line, format!("large.toml:3: `provenance` holds more than {says}: {remedy}"));
    }
    let deep = format!("{GOOD}a = {}", nested("[", "]", 15));
    Pattern::parse(&deep, "deep.toml").unwrap();
}

/// The reader counts what the parser would allocate before it parses: a table for each dot, 24 bytes for each sign.
#[test]
fn a_text_that_would_fill_the_memory_is_refused_before_it_is_read() {
    let dotted: String = (0..8000).map(|key| format!("k{key}{} = 1\n", ".a".repeat(60))).collect();
    let tables = "t = [{}, {}, {}, {}, {}, {}, {}, {}]\n".repeat(1 << 11);
    for (text, says) in [
        (dotted, "GOOD.toml:159: more than 8192 tables (each dot of a key makes one): leave some out"),
        (tables, "more than 8192 tables"),
        (
            format!("t = [{}]\n", "[1],".repeat(1 << 15)),
            "GOOD.toml:23: more than 40964 values: leave some out",
        ),
        ("\n".repeat((1 << 20) - GOOD.len()), "more than 524288 words and signs: leave some out"),
    ] {
        let line = in_one_line(Pattern::parse(&format!("{GOOD}{text}"), "GOOD.toml")).unwrap_err();
        assert!(line.contains(says), "{line}");
    }
}

#[test]
fn every_shipped_pattern_is_sound_and_moves() {
    let library = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../library/patterns");
    let mut names = Vec::new();
    let inner = ["paper", "motions"].map(|folder| fs::read_dir(library.join(folder)).unwrap());
    for entry in fs::read_dir(library).unwrap().chain(inner.into_iter().flatten()) {
        let path = entry.unwrap().path();
        if path.is_dir() {
            continue;
        }
        let pattern =
            Pattern::parse(&fs::read_to_string(&path).unwrap(), &path.display().to_string()).unwrap();
        assert_eq!(path.file_stem().unwrap(), pattern.name());
        assert_eq!(pattern.saturated().count(), 0);
        assert!(pattern.provenance().contains_key("method"), "{}", pattern.name());
        let strokes = Strokes::new(&pattern, &StrokeOptions::lasting(1.0)).unwrap().map(Result::unwrap);
        assert!(strokes.count() > 5, "{}", pattern.name());
        names.push(pattern.name().to_owned());
    }
    names.sort();
    // Made by hand; the design crate makes the others for targets.
    for name in ["all-in-phase", "pin-60", "press-hold", "rough-noise", "sweep", "wave"] {
        assert!(names.contains(&name.to_owned()), "{name}");
    }
}
