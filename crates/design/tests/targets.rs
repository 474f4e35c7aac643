use meissner_design::{Problem, Shape, Target};
use meissner_input::document;
use meissner_skin::afferent::{AfferentModel, Rectify};
use proptest::prelude::*;
use std::fs;
use std::path::Path;

const TOML: &str = r#"name = "good"
shape = "segment"
points = [[-3, 0],
  [3, 0.5]]
reach_mm = 1.5
amplitude_um = 80

[population]
seed = 3

[receptor]
noise_sd = 0.01

[motion]
duration_s = 1
speed_mm_s = 6
direction_deg = 90
turn_deg_s = 10
frames = 8
"#;

/// Each shape with all its keys, at its defaults where it has some.
const SHAPES: [&str; 6] = [
    "shape = \"segment\"\npoints = [[-3, 0], [3, 0]]",
    "shape = \"polyline\"\npoints = [[-3, 0], [3, 0], [0, 5]]",
    "shape = \"dots\"\npoints = [[-3, 0], [3, 0], [0, 6]]",
    "shape = \"disc\"\nradius_mm = 2.5\ncenter_mm = [0, 0]",
    "shape = \"braille\"\ncharacter = \"y\"\ndot_pitch_mm = 5.8\ncenter_mm = [0, 0]",
    "shape = \"grating\"\nperiod_mm = 7\nangle_deg = 0\noffset_mm = 0",
];

fn read(text: &str) -> Result<Target, String> {
    let target = Target::read(text, "bad.toml").map_err(|error| error.to_string());
    if let Err(line) = &target {
        let breaks = |c: char| c.is_control() || matches!(c, '\u{2028}' | '\u{2029}');
        assert!(!line.contains(breaks) && line.len() < 2000, "{line:?}");
    }
    target
}

fn named(rest: &str) -> Result<Target, String> {
    read(&format!("name = \"t\"\n{rest}"))
}

#[track_caller]
fn reads_back(target: &Target) {
    let text = toml::to_string(&target.definition()).unwrap();
    assert_eq!(Target::read(&text, "again.toml").as_ref(), Ok(target), "{text}");
}

#[test]
fn the_table_of_afferents_may_have_its_old_name() {
    let new = TOML.replace("[receptor]", "[afferent]");
    assert_eq!(read(&new), read(TOML));
    for (good, bad, says) in [
        ("noise_sd = 0.01", "noise_sd = -1", "bad.toml:12: `afferent.noise_sd` is -1"),
        (
            "[afferent]",
            "[receptor]\n[afferent]",
            "`afferent` and `receptor` are both there and mean the same",
        ),
    ] {
        let line = read(&new.replacen(good, bad, 1)).unwrap_err();
        assert!(line.contains(says), "{line}");
    }
}

#[test]
fn every_shape_is_read_with_its_keys_and_written_again() {
    for shape in SHAPES {
        let target = named(shape).unwrap();
        reads_back(&target);
        reads_back(&named(&format!("{shape}\nmotion = {{ duration_s = 1, turn_deg_s = 30 }}")).unwrap());
        assert!(target.frames().len() == 1 && target.warnings().is_empty(), "{shape}");
    }
    let target = read(TOML).unwrap();
    reads_back(&target);
    let model = AfferentModel { noise_sd: 0.01, ..AfferentModel::default_for(Rectify::Half, 0.0) };
    assert_eq!((target.name(), target.population_seed(), target.model()), ("good", 3, &model));
    assert_eq!((target.duration_s(), target.frames().len()), (1.0, 8));
    read(&format!("\u{feff}{TOML}")).unwrap();
}

/// What to change in the good target, and the line that it must then be refused with.
const BAD: [(&str, &str, &str); 37] = [
    ("name = \"good\"", "", "bad.toml:1: `name` is missing: add name = \"...\", as the file is called"),
    ("\"good\"", "\"Good\"", "bad.toml:1: `name` is `Good`: must be 1 to 64 of a-z, 0-9 and -"),
    (
        "shape = \"segment\"",
        "",
        "bad.toml:1: `shape` is missing: add shape = \"segment\", \"polyline\", \"disc\", \"dots\", \"braille\" or \
         \"grating\"",
    ),
    (
        "\"segment\"",
        "\"segmnet\"",
        "bad.toml:2: `shape` is `segmnet`: must be segment, polyline, disc, dots, braille or grating",
    ),
    ("\"segment\"", "1", "bad.toml:2: `shape` is integer `1`: must be the name of a shape, as \"segment\""),
    ("reach_mm = 1.5", "reach = 1.5", "bad.toml:5: unknown key `reach`: did you mean `reach_mm`?"),
    ("reach_mm = 1.5", "reach_mm = -1", "bad.toml:5: `reach_mm` is -1: must be 0 to 24 mm"),
    ("reach_mm = 1.5", "reach_mm = nan", "bad.toml:5: `reach_mm` is NaN: must be 0 to 24 mm"),
    ("reach_mm = 1.5", "reach_mm = \"1\"", "bad.toml:5: `reach_mm` is string \"1\": must be a number"),
    (
        "reach_mm = 1.5",
        "reach_mm = 0",
        "bad.toml:5: `reach_mm` is 0: none of the 306 receptors is so near to the shape in frame 1 of 8; raise it, \
         or take another population.seed",
    ),
    (
        "reach_mm = 1.5",
        "reach_mm = 24",
        "bad.toml:5: `reach_mm` is 24: all 306 receptors are so near to the shape in frame 1 of 8, and none is left \
         that should not fire; lower it",
    ),
    ("amplitude_um = 80", "amplitude_um = 401", "bad.toml:6: `amplitude_um` is 401: must be 0 to 400 um"),
    (
        "amplitude_um = 80",
        "amplitude_um = ",
        "bad.toml:6: not TOML: string values must be quoted, expected literal string",
    ),
    (
        "amplitude_um = 80",
        "duration_s = 1",
        "bad.toml:6: `duration_s` is there, and `[motion]` has its own: leave it out",
    ),
    (
        "amplitude_um = 80",
        "radius_mm = 3",
        "bad.toml:6: `radius_mm` is a key of shape = disc, and this is a segment: leave it out, or change `shape`",
    ),
    (
        "amplitude_um = 80",
        "center_mm = [0, 0]",
        "bad.toml:6: `center_mm` is a key of shape = disc or braille, and this is a segment: leave it out, or change \
         `shape`",
    ),
    ("[3, 0.5]", "[3, 0.5], [4, 4]", "bad.toml:3: `points` is a list of 3: must be the 2 ends of a segment"),
    ("[3, 0.5]", "[3, 0.5, 4]", "bad.toml:4: `points[1]` is a list of 3: must be [x, y], in mm"),
    ("[3, 0.5]", "[3]", "bad.toml:4: `points[1]` is a list of 1: must be [x, y], in mm"),
    ("[3, 0.5]", "3", "bad.toml:4: `points[1]` is integer `3`: must be [x, y], in mm"),
    ("[3, 0.5]", "[3, \"a\"]", "bad.toml:4: `points[1][1]` is string \"a\": must be a number"),
    (
        "[3, 0.5]",
        "[9.1, 0.5]",
        "bad.toml:4: `points[1]` is at [9.1116, -2.8206] mm in frame 1 of 8: must be on the pad, an ellipse 18 mm wide \
         and 24 mm long about the array's middle",
    ),
    ("seed = 3", "seeds = 3", "bad.toml:9: `population`: unknown key `seeds`: did you mean `seed`?"),
    (
        "seed = 3",
        "seed = -3",
        "bad.toml:9: `population.seed` is integer `-3`: must be a whole number, 0 or more",
    ),
    ("noise_sd = 0.01", "noise_sd = -1", "bad.toml:12: `receptor.noise_sd` is -1: must be 0 to 1000000"),
    (
        "noise_sd = 0.01",
        "noise = 1",
        "bad.toml:12: `receptor`: unknown key `noise`: did you mean `noise_sd`?",
    ),
    (
        "noise_sd = 0.01",
        "rectify = \"hlaf\"",
        "bad.toml:12: `receptor.rectify` is `hlaf`: must be half, full or signed",
    ),
    (
        "duration_s = 1",
        "",
        "bad.toml:14: `motion.duration_s` is missing: add how long the motion lasts, in s",
    ),
    ("duration_s = 1", "duration_s = 0", "bad.toml:15: `motion.duration_s` is 0: must be 0.01 to 20 s"),
    (
        "speed_mm_s = 6",
        "speed_mm_s = inf",
        "bad.toml:16: `motion.speed_mm_s` is inf: must be -1000 to 1000 mm/s",
    ),
    (
        "speed_mm_s = 6",
        "speed_mm_s = 48",
        "bad.toml:3: `points[0]` is at [-2.9913, -20.7711] mm in frame 1 of 8: must be on the pad, an ellipse 18 mm wide \
         and 24 mm long about the array's middle",
    ),
    (
        "direction_deg = 90",
        "direction_deg = 361",
        "bad.toml:17: `motion.direction_deg` is 361: must be -360 to 360 degrees",
    ),
    ("turn_deg_s", "turn", "bad.toml:18: `motion`: unknown key `turn`: did you mean `turn_deg_s`?"),
    (
        "turn_deg_s = 10",
        "turn_deg_s = nan",
        "bad.toml:18: `motion.turn_deg_s` is NaN: must be -36000 to 36000 degrees/s",
    ),
    ("frames = 8", "frames = 0", "bad.toml:19: `motion.frames` is 0: must be 1 to 64"),
    ("frames = 8", "frames = 65", "bad.toml:19: `motion.frames` is 65: must be 1 to 64"),
    (
        "duration_s = 1",
        "duration_s = 0.05",
        "bad.toml:19: `motion.frames` is 8: must be so few that each lasts 0.01 s or longer",
    ),
];

#[test]
fn every_mistake_is_one_line_that_says_what_where_and_what_to_do() {
    for (good, bad, line) in BAD {
        assert!(TOML.contains(good), "{good}");
        assert_eq!(read(&TOML.replacen(good, bad, 1)).unwrap_err(), line, "{bad}");
    }
}

/// What is wrong with targets of other shapes.
#[test]
fn every_shape_has_mistakes_of_its_own() {
    let pad = "must be on the pad, an ellipse 18 mm wide and 24 mm long about the array's middle";
    for (rest, line) in [
        (
            "shape = \"dots\"",
            "2: `points` is missing: add points = [[x, y], ...], in mm from the array's middle",
        ),
        ("shape = \"dots\"\npoints = []", "3: `points` is a list of 0: must be 1 to 64 dots"),
        (
            "shape = \"polyline\"\npoints = [[0, 0]]",
            "3: `points` is a list of 1: must be the 2 to 64 points of a polyline",
        ),
        (
            "shape = \"dots\"\npoints = [[0, 0],\n [0, nan]]",
            &format!("4: `points[1]` is at [0, NaN] mm: {pad}"),
        ),
        ("shape = \"disc\"", "2: `radius_mm` is missing: add a radius, 0 to 24 mm"),
        ("shape = \"disc\"\nradius_mm = nan", "3: `radius_mm` is NaN: must be 0 to 24 mm"),
        (
            "shape = \"disc\"\nradius_mm = 1\ncenter_mm = [0, -12.1]",
            &format!("4: `center_mm` is at [0, -12.1] mm: {pad}"),
        ),
        (
            "shape = \"disc\"\nradius_mm = 20",
            "2: `reach_mm` is 1.5: all 306 receptors are so near to the shape, and none is left that should not \
             fire; lower it",
        ),
        ("shape = \"braille\"", "2: `character` is missing: add a letter, or a six-dot Braille character"),
        (
            "shape = \"braille\"\ncharacter = \"B\"",
            "3: `character` is `B`: must be a letter a to z, or a six-dot Braille character, U+2801 to U+283F",
        ),
        (
            "shape = \"braille\"\ncharacter = \"\u{2800}\"",
            "3: `character` is `\u{2800}`: must be a letter a to z, or a six-dot Braille character, U+2801 to U+283F",
        ),
        (
            "shape = \"braille\"\ncharacter = \"b\"\ndot_pitch_mm = 0",
            "4: `dot_pitch_mm` is 0: must be 0.1 to 24 mm",
        ),
        (
            "shape = \"braille\"\ncharacter = \"c\"\ncenter_mm = [6, 0]",
            &format!("3: `character`: dot 4 is at [8.9, 5.8] mm: {pad}"),
        ),
        ("shape = \"grating\"", "2: `period_mm` is missing: add how far it is from line to line, in mm"),
        ("shape = \"grating\"\nperiod_mm = 0", "3: `period_mm` is 0: must be 0.1 to 1000 mm"),
        (
            "shape = \"grating\"\nperiod_mm = 6\nangle_deg = inf",
            "4: `angle_deg` is inf: must be -360 to 360 degrees",
        ),
        (
            "shape = \"grating\"\nperiod_mm = 6\noffset_mm = nan",
            "4: `offset_mm` is NaN: must be -1000 to 1000 mm",
        ),
        (
            "shape = \"grating\"\nperiod_mm = 6\nreach_mm = 3",
            "4: `reach_mm` is 3: all 306 receptors are so near to the shape, and none is left that should not fire; \
             lower it",
        ),
        (
            "shape = \"grating\"\nperiod_mm = 6\npoints = []",
            "4: `points` is a key of shape = segment, polyline or dots, and this is a grating: leave it out, or \
             change `shape`",
        ),
    ] {
        assert_eq!(named(rest).unwrap_err(), format!("bad.toml:{line}"), "{rest}");
    }
    let long = Target::read(&" ".repeat(meissner_design::MAX_BYTES + 1), "long.toml").unwrap_err();
    assert_eq!(long.problem, document::Problem::Own(Problem::TooLarge { bytes: 65537 }));
    assert_eq!(long.to_string(), "long.toml: 65537 bytes are too many: a target file has at most 65536");
}

#[test]
fn every_shipped_target_is_good() {
    let names = meissner_design::shipped_names();
    assert!(names.len() >= 16 && names.contains(&meissner_design::YARDSTICK), "{names:?}");
    for name in names {
        let target = meissner_design::shipped(name).unwrap();
        assert_eq!(target.name(), name);
        assert_eq!(target.warnings(), [""; 0], "{name}");
        reads_back(&target);
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../targets/{name}.toml"));
        let head =
            fs::read_to_string(file).unwrap().lines().take_while(|line| line.starts_with("# ")).count();
        assert!((1..=2).contains(&head), "{name}: says in one or two lines what one is to feel");
        for seed in 0..20 {
            target.with_population_seed(seed).unwrap();
        }
    }
    assert_eq!((meissner_design::shipped("edge-46"), meissner_design::shipped("../Cargo")), (None, None));
}

/// As `tradeoff` and the book describe it.
#[test]
fn the_yardstick_is_twelve_mm_at_45_degrees() {
    let target = meissner_design::shipped(meissner_design::YARDSTICK).unwrap();
    let Shape::Polyline(ends) = &target.frames()[0].shape else { panic!("{target:?}") };
    let half = 6.0 * std::f64::consts::FRAC_1_SQRT_2;
    for (end, expected) in ends.iter().zip([-half, half]) {
        assert!(end.iter().all(|found| (found - expected).abs() < 1e-12), "{end:?}");
    }
    assert_eq!((ends.len(), target.reach_mm()), (2, 1.5));
}

#[test]
fn the_target_of_the_reference_is_read() {
    let blocks = include_str!("../../../docs/reference/target.md").split("```toml\n").skip(1);
    let mut targets =
        blocks.filter_map(|rest| rest.split("```").next()).filter(|text| text.contains("\nshape ="));
    let target = read(targets.next().unwrap()).unwrap();
    assert_eq!((target.name(), target.frames().len()), ("slow-hand", 13));
}

#[test]
fn the_moving_edge_moves_across_and_the_turning_one_turns() {
    let middle = |target: &Target, frame: usize| {
        let Shape::Polyline(ends) = &target.frames()[frame].shape else { panic!("{target:?}") };
        ([0, 1].map(|axis| (ends[0][axis] + ends[1][axis]) / 2.0), ends[1][1] - ends[0][1])
    };
    let edge = meissner_design::shipped("moving-edge").unwrap();
    assert_eq!(edge.frames().len(), 9);
    let steps = (0..9).map(|frame| middle(&edge, frame).0[1]);
    for (found, expected) in steps.zip((-4..=4).map(|step| f64::from(step) * 12.0 / 9.0)) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
    let hand = meissner_design::shipped("rotating-edge").unwrap();
    assert_eq!(hand.frames().len(), 13);
    for (frame, rise) in [(6, 0.0), (0, -12.0 * (90.0_f64 / 13.0).to_radians().cos())] {
        let (middle, found) = middle(&hand, frame);
        assert!(middle[0].hypot(middle[1]) < 1e-12 && (found - rise).abs() < 1e-12, "{found} {rise}");
    }
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in any::<String>()) {
        let _ = read(&text);
    }

    /// Good targets with a bite taken out.
    #[test]
    fn no_damage_makes_the_reader_panic(
        which in 0..=SHAPES.len(), from in 0..TOML.len(), length in 0_usize..30, what in "\\PC{0,3}"
    ) {
        let good = SHAPES.get(which).map_or(TOML.to_owned(), |shape| format!("name = \"t\"\n{shape}"));
        let from = from.min(good.len());
        let to = (from + length).min(good.len());
        if let Ok(target) = read(&format!("{}{what}{}", &good[..from], &good[to..])) {
            reads_back(&target);
        }
    }
}
