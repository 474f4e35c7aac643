//! Pattern files: what is refused and in which words; the shipped library.

use meissner_array::pattern::{Drive, Pattern, Problem};
use meissner_array::strokes::Strokes;
use meissner_input::document;
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

/// A change of the good file, and what the message must then begin with and contain.
const BAD: [(&str, &str, &str, &str); 36] = [
    ("format = 1", "format = 2", "bad.toml:1: `format` is 2", "format = 1"),
    ("format = 1", "", "bad.toml:1: `format` is missing", "add format = 1"),
    ("format = 1", "format = \"1\"", "bad.toml:1: `format` is string \"1\"", "a whole number"),
    ("name = \"good\"", "", "bad.toml:1: `name` is missing", "as the file is called"),
    ("\"good\"", "\"Good\"", "bad.toml:2: `name` is `Good`", "a-z, 0-9 and -"),
    ("\"good\"", "\"\"", "bad.toml:2: `name` is ``", "1 to 64"),
    ("\"good\"", "\"../a\\nb\"", "bad.toml:2: `name` is `../a\\nb`", "a-z, 0-9 and -"),
    ("duration_s = 5", "duration_s = 0", "bad.toml:3: `duration_s` is 0", "at least one tick"),
    ("duration_s = 5", "duration_s = -1.0", "bad.toml:3: `duration_s` is -1", "at least one tick"),
    ("duration_s = 5", "duration_s = nan", "bad.toml:3: `duration_s` is NaN", "at least one tick"),
    ("duration_s = 5", "duration_s = inf", "bad.toml:3: `duration_s` is inf", "at most"),
    ("duration_s = 5", "durations = 5", "bad.toml:3: unknown key `durations`", "did you mean `duration_s`?"),
    ("duration_s = 5", "duration_s = 5\n\"a\\nb\" = 1", "bad.toml:4: unknown key `a\\nb`", "did you mean"),
    (
        "duration_s = 5",
        "duration_s = 1",
        "bad.toml:16: drive 2: `start_s` is 1: beyond",
        "raise duration_s from 1",
    ),
    ("duration_s = 5", "duration_s = 1.5", "bad.toml:17: drive 2: `stop_s` is 2: beyond", "raise duration_s"),
    ("duration_s = 5", "duration_s = ", "bad.toml:3: not TOML", ""),
    ("motor = 9", "motor = 24", "bad.toml:6: drive 1: `motor` is 24", "0 to 23"),
    ("motor = 9", "motor = -1", "bad.toml:6: drive 1: `motor` is -1", "0 to 23"),
    ("motor = 9", "motor = 9.0", "bad.toml:6: drive 1: `motor` is floating point `9.0`", "a whole number"),
    ("motor = 9", "motor = 99999999999999999999", "bad.toml:6: drive 1: `motor`", "a whole number"),
    ("motor = 9", "", "bad.toml:5: drive 1: `motor` is missing", "0 to 23"),
    (
        "motor = 9",
        "motor = 3",
        "bad.toml:12: drive 2: `motor` is 3, which drive 1 still drives",
        "stop that one by 1 s",
    ),
    ("motor = 3", "motr = 3", "bad.toml:12: drive 2: unknown key `motr`", "did you mean `motor`?"),
    ("frequency_hz = 60.0", "frequency = 60.0", "bad.toml:7: drive 1: unknown key", "`frequency_hz`?"),
    (
        "frequency_hz = 60.0",
        "frequency_hz = 300.1",
        "bad.toml:7: drive 1: `frequency_hz` is 300.1",
        "0.1 to 300",
    ),
    ("frequency_hz = 60.0", "frequency_hz = 0", "bad.toml:7: drive 1: `frequency_hz` is 0", "0.1 to 300"),
    ("frequency_hz = 60.0", "frequency_hz = nan", "bad.toml:7: drive 1: `frequency_hz` is NaN", "0.1 to 300"),
    (
        "frequency_hz = 60.0",
        "frequency_hz = []",
        "bad.toml:7: drive 1: `frequency_hz` is sequence",
        "a number",
    ),
    ("amplitude_um = 80\n", "amplitude_um = 401\n", "bad.toml:8: drive 1: `amplitude_um` is 401", "0 to 400"),
    (
        "amplitude_um = 80\n",
        "amplitude_um = -inf\n",
        "bad.toml:8: drive 1: `amplitude_um` is -inf",
        "0 to 400",
    ),
    ("phase = 0.25", "phase = 1.0", "bad.toml:9: drive 1: `phase` is 1", "below 1"),
    ("start_s = 1.0", "start_s = -1.0", "bad.toml:16: drive 2: `start_s` is -1", "0 to"),
    ("stop_s = 2.0", "stop_s = 1.0", "bad.toml:17: drive 2: `stop_s` is 1", "above start_s, which is 1"),
    (
        "[[drive]]\nmotor = 9",
        "[[driv]]\nmotor = 9",
        "bad.toml:5: unknown key `driv`",
        "did you mean `drive`?",
    ),
    ("model = 1", "made = 2013-01-01", "bad.toml:19: `provenance` holds a date at `made`", "quote it"),
    ("[provenance]", "[[provenance]]", "bad.toml:19: `provenance` is sequence", "must be a table"),
];

#[test]
fn every_error_is_one_line_that_says_what_where_and_what_to_do() {
    for (good, bad, start, advice) in BAD {
        assert!(GOOD.contains(good), "{good}");
        let line = Pattern::parse(&GOOD.replacen(good, bad, 1), "bad.toml").unwrap_err().to_string();
        assert!(line.starts_with(start) && line.contains(advice) && !line.contains('\n'), "{bad}: {line}");
    }
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
    assert!(!Pattern::parse("", "a\nb").unwrap_err().to_string().contains('\n'));
}

#[test]
fn no_text_makes_the_reader_panic() {
    for cut in 0..GOOD.len() {
        if let Err(error) = Pattern::parse(&GOOD[..cut], "cut") {
            assert!(!error.to_string().contains('\n'), "{error}");
        }
    }
    for text in ["drive = 1", "format = 1\nname = 'a'\ndrive = [1]", "[[[[", "a.b.c.d = {", "\u{feff}", "\0"]
    {
        assert!(Pattern::parse(text, "odd").is_err());
    }
}

#[test]
fn every_shipped_pattern_is_sound_and_moves() {
    let library = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../patterns");
    let mut names = Vec::new();
    for entry in fs::read_dir(library).unwrap() {
        let path = entry.unwrap().path();
        let pattern =
            Pattern::parse(&fs::read_to_string(&path).unwrap(), &path.display().to_string()).unwrap();
        assert_eq!(path.file_stem().unwrap(), pattern.name());
        assert_eq!(pattern.warnings(), []);
        assert!(pattern.provenance().contains_key("method"), "{}", pattern.name());
        let strokes = Strokes::new(&pattern, Some(1.0)).unwrap().map(Result::unwrap);
        assert!(strokes.count() > 5, "{}", pattern.name());
        names.push(pattern.name().to_owned());
    }
    names.sort();
    // Made by hand; the design crate makes the others for targets.
    for name in ["all-in-phase", "pin-60", "sweep", "wave"] {
        assert!(names.contains(&name.to_owned()), "{name}");
    }
}
