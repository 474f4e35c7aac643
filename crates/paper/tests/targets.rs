use meissner_array::pattern::Pattern;
use meissner_array::spec::{Array, ArraySpec};
use meissner_paper::{Budget, Request, Rule, Target, make};
use meissner_skin::membrane::{AfferentModel, Rectify};
use meissner_touch::Shape;
use proptest::prelude::*;
use std::fs;
use std::ops::ControlFlow::Continue;
use std::path::Path;

const TOML: &str = r#"name = "good"
shape = "segment"
points = [[-3, 0],
  [3, 0.5]]
reach_mm = 1.5
amplitude_um = 80

[population]
seed = 3

[afferent]
noise_sd = 0.01

[motion]
duration_s = 1
speed_mm_s = 6
direction_deg = 90
turn_deg_s = 10
frames = 8
"#;

/// Each shape with all its keys, at their defaults if they have any.
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

const PAD: &str = "must be on the pad, an ellipse 18 mm wide and 24 mm long about the array's middle";

/// Changes of the good target; below each, the line and message with which it is refused.
const BAD: &str = r#"
name = "good" =>
    1: `name` is missing: add name = "...", the name of the file
"good" => "Good"
    1: `name` is `Good`: must be 1 to 64 of a-z, 0-9 and -
reach_mm = 1.5 => reach_m = 1.5
    5: unknown key `reach_m`: did you mean `reach_mm`?
reach_mm = 1.5 => reach_mm = -1
    5: `reach_mm` is -1: must be 0 to 24 mm
reach_mm = 1.5 => reach_mm = nan
    5: `reach_mm` is NaN: must be 0 to 24 mm
reach_mm = 1.5 => reach_mm = "1"
    5: `reach_mm` is string "1": must be a number
reach_mm = 1.5 => reach_mm = 0
    5: `reach_mm` is 0: none of the 306 afferents is within reach of the shape in frame 1 of 8; raise it, or take another population.seed
reach_mm = 1.5 => reach_mm = 24
    5: `reach_mm` is 24: all 306 afferents are within reach of the shape in frame 1 of 8; lower it
amplitude_um = 80 => amplitude_um = 401
    6: `amplitude_um` is 401: must be 0 to 400 um
amplitude_um = 80 => amplitude_um =
    6: not TOML: string values must be quoted, expected literal string
amplitude_um = 80 => duration_s = 1
    6: `duration_s` is there, but `[motion]` has its own: leave it out
amplitude_um = 80 => radius_mm = 3
    6: `radius_mm` is a key of shape = disc, and this is a segment: leave it out, or change `shape`
[3, 0.5] => [3, 0.5], [4, 4]
    3: `points` is a list of 3: must be the 2 ends of a segment
[3, 0.5] => [9.1, 0.5]
    3: `points` has a point at [9.1116, -2.8206] mm in frame 1 of 8: {pad}
seed = 3 => seeds = 3
    9: `population`: unknown key `seeds`: did you mean `seed`?
seed = 3 => seed = -3
    9: `population.seed` is integer `-3`: must be a whole number, 0 or more
noise_sd = 0.01 => noise_sd = -1
    12: `afferent.noise_sd` is -1: must be 0 to 1000000
noise_sd = 0.01 => noise = 1
    12: `afferent`: unknown key `noise`: did you mean `noise_sd`?
noise_sd = 0.01 => rectify = "hlaf"
    12: `afferent.rectify` is `hlaf`: must be half, full or signed
duration_s = 1 =>
    14: `motion.duration_s` is missing: add the duration of the motion, in s
duration_s = 1 => duration_s = 0
    15: `motion.duration_s` is 0: must be 0.01 to 20 s
speed_mm_s = 6 => speed_mm_s = inf
    16: `motion.speed_mm_s` is inf: must be -1000 to 1000 mm/s
speed_mm_s = 6 => speed_mm_s = 48
    3: `points` has a point at [-2.9913, -20.7711] mm in frame 1 of 8: {pad}
direction_deg = 90 => direction_deg = 361
    17: `motion.direction_deg` is 361: must be -360 to 360 degrees
turn_deg_s => turn
    18: `motion`: unknown key `turn`: did you mean `turn_deg_s`?
turn_deg_s = 10 => turn_deg_s = nan
    18: `motion.turn_deg_s` is NaN: must be -36000 to 36000 degrees/s
frames = 8 => frames = 0
    19: `motion.frames` is 0: must be 1 to 64
frames = 8 => frames = 65
    19: `motion.frames` is 65: must be 1 to 64
duration_s = 1 => duration_s = 0.05
    19: `motion.frames` is 8: must be so few that each lasts 0.01 s or longer
"#;

/// Pairs of lines, with the pad in words.
fn cases(text: &str) -> impl Iterator<Item = (&str, String)> {
    let lines: Vec<&str> = text.trim().lines().collect();
    assert!(lines.len().is_multiple_of(2));
    (0..lines.len()).step_by(2).map(move |n| (lines[n], lines[n + 1].trim_start().replace("{pad}", PAD)))
}

#[test]
fn every_refusal_is_one_line_with_the_place_the_problem_and_the_remedy() {
    for (change, line) in cases(BAD) {
        let (good, bad) = change.split_once(" =>").unwrap();
        assert!(TOML.contains(good), "{good}");
        let found = read(&TOML.replacen(good, bad.trim_start(), 1)).unwrap_err();
        assert_eq!(found, format!("bad.toml:{line}"), "{change}");
    }
}

/// Objects that no search takes, with a bar for each line break, and their messages.
const BAD_SHAPES: &str = r#"
shape = "dots" | points = [[0, 0], |  [0, 12.1]]
    3: `points` has a point at [0, 12.1] mm: {pad}
shape = "disc" | radius_mm = 1 | center_mm = [0, -12.1]
    4: `center_mm` has a point at [0, -12.1] mm: {pad}
shape = "disc" | radius_mm = 2 | touch.scan = { depth_um = 500, speed_mm_s = 1, duration_s = 21 }
    4: `touch.scan.duration_s` is 21: must be 0.01 to 20 s
shape = "disc" | radius_mm = 2 | duration_s = 1 | touch.scan = { depth_um = 500, speed_mm_s = 1, duration_s = 1 }
    4: `duration_s` is there, but `[touch.scan]` has its own: leave it out
shape = "disc" | radius_mm = 20
    2: `reach_mm` is 1.5: all 306 afferents are within reach of the shape; lower it
shape = "braille" | character = "c" | center_mm = [6, 0]
    3: `character` has a point at [8.9, 5.8] mm: {pad}
shape = "grating" | period_mm = 6 | reach_mm = 3
    4: `reach_mm` is 3: all 306 afferents are within reach of the shape; lower it
shape = "edge"
    2: `shape` is edge, in which a search finds no line: draw it as bar, segment, polyline, disc, dots, grating or braille
shape = "texture" | file = "a.npy" | mm_per_pixel = 1
    2: `shape` is texture, in which a search finds no line: draw it as bar, segment, polyline, disc, dots, grating or braille
shape = "disc" | radius_mm = 2 | touch.path = { poses = [[0, 0, 0, 0, 0], [1, 0, 0, 90, 500]] }
    4: `touch` is a path, and a search follows none: add [motion] with duration_s, speed_mm_s or turn_deg_s
"#;

#[test]
fn objects_that_no_search_takes_are_refused_in_one_line_too() {
    for (rest, line) in cases(BAD_SHAPES) {
        assert_eq!(named(&rest.replace(" | ", "\n")).unwrap_err(), format!("bad.toml:{line}"), "{rest}");
    }
    let many = named(&format!("shape = \"dots\"\npoints = {:?}", [[0.0, 0.0]; 65])).unwrap_err();
    assert_eq!(many, "bad.toml:3: `points` has 65 points: a search takes at most 64");
}

/// What an object says of its place and its scan, a search takes.
#[test]
fn an_object_is_a_target_where_it_lies_and_moves() {
    let bar = "kind = \"object\"\nshape = \"bar\"\nlength_mm = 6\nwidth_mm = 1\ncenter_mm = [1, 2]";
    let touch = "touch.scan = { depth_um = 500, speed_mm_s = 6, direction_deg = 90, duration_s = 1 }";
    let motion = "motion = { duration_s = 1, speed_mm_s = 6, direction_deg = 90 }";
    let segment = "shape = \"segment\"\npoints = [[-2, 2], [4, 2]]";
    assert_eq!(named(&format!("{bar}\n{touch}")), named(&format!("{segment}\n{motion}")));
    let upright = named(&format!("{bar}\nangle_deg = 90")).unwrap();
    assert_eq!(upright.shape(), &Shape::Polyline(vec![[1.0, -1.0], [1.0, 5.0]]));
    let lines = named("shape = \"lines\"\nlines = [[[-2, 2], [4, 2]]]\nwidth_mm = 1");
    assert_eq!(lines, named(segment));
}

#[test]
fn every_shipped_target_is_valid() {
    let names = meissner_paper::shipped_names();
    assert!(names.len() >= 16 && names.contains(&meissner_paper::YARDSTICK), "{names:?}");
    for name in names {
        let target = meissner_paper::shipped(name).unwrap();
        assert_eq!(target.name(), name);
        assert_eq!(target.warnings(), [""; 0], "{name}");
        reads_back(&target);
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../library/objects/{name}.toml"));
        let head =
            fs::read_to_string(file).unwrap().lines().take_while(|line| line.starts_with("# ")).count();
        assert!((1..=2).contains(&head), "{name}: describes the object in one or two lines");
        for seed in 0..20 {
            let mut keys = target.definition();
            keys["population"]["seed"] = seed.into();
            read(&toml::to_string(&keys).unwrap()).unwrap();
        }
    }
    assert_eq!((meissner_paper::shipped("edge-46"), meissner_paper::shipped("../Cargo")), (None, None));
}

/// As the book describes it.
#[test]
fn the_yardstick_is_an_edge_of_12_mm_at_45_degrees() {
    let target = meissner_paper::shipped(meissner_paper::YARDSTICK).unwrap();
    let Shape::Polyline(ends) = &target.frames()[0].shape else { panic!("{target:?}") };
    let half = 6.0 * std::f64::consts::FRAC_1_SQRT_2;
    for (end, expected) in ends.iter().zip([-half, half]) {
        assert!(end.iter().all(|found| (found - expected).abs() < 1e-12), "{end:?}");
    }
    assert_eq!((ends.len(), target.reach_mm()), (2, 1.5));
}

#[test]
fn the_target_of_the_reference_page_is_read() {
    let blocks = include_str!("../../../docs/reference/object.md").split("```toml\n").skip(1);
    let mut targets =
        blocks.filter_map(|rest| rest.split("```").next()).filter(|text| text.contains("[motion]"));
    let target = read(targets.next().unwrap()).unwrap();
    assert_eq!((target.name(), target.frames().len()), ("slow-hand", 13));
}

#[test]
fn the_moving_edge_shifts_and_the_rotating_edge_turns() {
    let middle = |target: &Target, frame: usize| {
        let Shape::Polyline(ends) = &target.frames()[frame].shape else { panic!("{target:?}") };
        ([0, 1].map(|axis| (ends[0][axis] + ends[1][axis]) / 2.0), ends[1][1] - ends[0][1])
    };
    let edge = meissner_paper::shipped("moving-edge").unwrap();
    assert_eq!(edge.frames().len(), 9);
    let steps = (0..9).map(|frame| middle(&edge, frame).0[1]);
    for (found, expected) in steps.zip((-4..=4).map(|step| f64::from(step) * 12.0 / 9.0)) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
    let hand = meissner_paper::shipped("rotating-edge").unwrap();
    assert_eq!(hand.frames().len(), 13);
    for (frame, rise) in [(6, 0.0), (0, -12.0 * (90.0_f64 / 13.0).to_radians().cos())] {
        let (middle, found) = middle(&hand, frame);
        assert!(middle[0].hypot(middle[1]) < 1e-12 && (found - rise).abs() < 1e-12, "{found} {rise}");
    }
}

#[test]
fn the_target_of_a_pattern_is_read_from_its_provenance() {
    let target = meissner_paper::shipped("rotating-edge").unwrap();
    let made = |provenance| Pattern::new(Array::paper(), "t", None, vec![], provenance).unwrap();
    let kept = toml::Table::from_iter([("definition".to_owned(), target.definition().into())]);
    assert_eq!(Target::made_for(&made(kept)), Some(target));
    for bad in ["", "definition = 1", "definition = { name = \"a\" }"] {
        assert_eq!(Target::made_for(&made(bad.parse().unwrap())), None, "{bad}");
    }
}

/// A target for another array says so in its definition; one for the paper's has the definition that it always had.
#[test]
fn a_target_is_for_an_array() {
    let on =
        |name: &str| named(&format!("array = \"{name}\"\nshape = \"braille\"\ncharacter = \"b\"")).unwrap();
    // Another test adds arrays without rows.
    let arrays = meissner_array::spec::names().into_iter().map(|name| Array::named(name).unwrap());
    for array in arrays.filter(|array| array.grid().is_some()) {
        let name = array.name();
        let target = on(name);
        assert_eq!(target.array(), array);
        reads_back(&target);
        assert_eq!(target.definition().contains_key("array"), array != Array::paper(), "{name}");
        // Two dots one above the other, two pitches apart.
        let [above, below] = &target.frames()[0].shape.outline()[..] else { panic!("{target:?}") };
        assert!((above[0][1] - below[0][1] - 2.0 * array.pitch_mm()).abs() < 1e-12, "{name}");
        let finer = target.warnings().into_iter().find(|line| line.contains("run together"));
        assert_eq!(finer, None, "{name}");
    }
    let line = named("array = \"6x4\"\nshape = \"disc\"\nradius_mm = 1").unwrap_err();
    assert!(line.starts_with("bad.toml:2: `array` is unknown: no array is called `6x4`"), "{line}");
    // The shape stays where it is on the finger.
    let edge = meissner_paper::shipped("moving-edge").unwrap();
    let small = edge.with_array(Array::named("tula35-2x3").unwrap()).unwrap();
    assert_eq!((small.array().motors(), small.frames()), (6, edge.frames()));
    assert!(
        small.warnings()[0].ends_with("within 2.9 mm of the middle across the finger and 1.45 mm along it")
    );
}

/// Pins that stand in no rows, with less travel than the default amplitude; and a single pin.
#[test]
fn an_array_may_have_pins_anywhere_or_one_pin() {
    let known = |name: &str, positions: &str| {
        let text = format!(
            "name = \"{name}\"\npins = {{ positions_mm = {positions}, radius_mm = 0.4 }}\ntick_hz = 50000\n\
             duty = {{ up = 0.3, down = 0.6 }}\n\
             motor = {{ step_um = 0.2, window_ms = 6, travel_um = 60, most_pulses = 600 }}\n"
        );
        Array::known(ArraySpec::parse(&text, "test.toml").unwrap()).unwrap()
    };
    let scattered = known("scattered", "[[0, 0], [2, 1], [-3, 0.5], [1, -4], [-1.5, 3]]");
    let target =
        named("array = \"scattered\"\nshape = \"segment\"\npoints = [[-3, 0], [3, 0]]\nreach_mm = 1.2")
            .unwrap();
    assert_eq!((target.array(), target.amplitude_um()), (scattered, 60.0));
    // The shipped target has 80 um; these motors travel 60.
    assert_eq!(meissner_paper::shipped("dot").unwrap().with_array(scattered).unwrap().amplitude_um(), 60.0);
    let (reach, pitch) = (Rule::Reach.drives(&target), Rule::Pitch.drives(&target));
    assert_eq!(reach.iter().map(|drive| drive.motor).collect::<Vec<_>>(), [0, 1, 2]);
    assert_eq!((scattered.pitch_mm(), pitch.len()), (5_f64.sqrt(), 3));
    let single = known("single", "[[0, 0]]");
    let dots = named("array = \"single\"\nshape = \"dots\"\npoints = [[0, 0], [9, 0]]").unwrap();
    assert_eq!((dots.array(), Rule::Pitch.drives(&dots).len()), (single, 1));
    assert!(
        dots.warnings()[0].starts_with("dots run together: the array has one pin"),
        "{:?}",
        dots.warnings()
    );
    // A search turns it off or moves it; no move needs a neighbour.
    for target in [target, dots] {
        let request = Request { budget: Budget::Evaluations(vec![30]), ..Request::default() };
        let made = make(&target, "made", &request, &mut |_| Continue(())).unwrap();
        assert_eq!(made.pattern.array(), target.array());
        assert!(!made.pattern.drives().is_empty());
    }
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in any::<String>()) {
        let _ = read(&text);
    }

    /// Good targets, in which a part is replaced at random.
    #[test]
    fn no_damaged_target_makes_the_reader_panic(
        which in 0..=SHAPES.len(), from in 0..TOML.len(), length in 0_usize..30, new in "\\PC{0,3}"
    ) {
        let good = SHAPES.get(which).map_or(TOML.to_owned(), |shape| format!("name = \"t\"\n{shape}"));
        let from = from.min(good.len());
        let to = (from + length).min(good.len());
        if let Ok(target) = read(&format!("{}{new}{}", &good[..from], &good[to..])) {
            reads_back(&target);
        }
    }
}
