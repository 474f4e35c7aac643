//! Rendered objects, on fingers that no number of the crate was made with.

#![expect(clippy::unwrap_used, reason = "a test fails where it unwraps")]

/// Heights of one pose at a time.
mod poses;

use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_render::{Judge, Judged, Method, Rival, render, response_of};
use meissner_skin::Finger;
use meissner_touch::{Contact, Object, Pose, Press, Scan, Shape, Touch, respond, surface_of};
use std::fs;
use std::path::Path;
use toml::Table;

/// Counted after the object has left, s.
const AFTER_S: f64 = 0.1;

fn bar(y_mm: f64) -> Shape {
    Shape::Polyline(vec![[-5.6, y_mm], [5.6, y_mm]])
}

fn pressed(shape: &Shape) -> Object {
    let press = Press { depth_mm: 0.5, rise_s: 0.05, hold_s: 0.05, fall_s: 0.05 };
    Object::new("pressed", surface_of(shape), Touch::press(Pose::default(), press).unwrap())
}

fn moving(speed_mm_s: f64) -> Object {
    let duration_s = 20.0 / speed_mm_s;
    let scan = Scan { depth_mm: 0.5, rise_s: 0.03, speed_mm_s, direction_deg: 90.0, duration_s };
    Object::new("moving", surface_of(&bar(0.0)), Touch::scan(Pose::default(), scan).unwrap())
}

fn contact(object: &Object) -> Contact {
    Contact::new(object.grains(object.pitch_mm()), object.touch().most_depth_mm()).unwrap()
}

/// What two fingers feel of some patterns, against what they feel of the object; means over the fingers of what `value` takes.
fn means<const N: usize>(object: &Object, value: impl Fn(&Judged) -> [f64; N]) -> impl Fn(&str) -> [f64; N] {
    let contact = contact(object);
    let seconds = object.touch().duration_s() + AFTER_S;
    move |name| {
        let pattern = match name {
            "reach" => Rival::WithinReach.pattern(Array::paper(), &contact, object.touch()),
            method => {
                let method = match method {
                    "rule" => Method::Rule,
                    "stroke" => Method::Stroke,
                    "field" => Method::Field,
                    "rate" => Method::Rate,
                    _ => Method::Auto,
                };
                render(Array::paper(), &contact, object.touch(), method).0.pattern(
                    Array::paper(),
                    "test",
                    Table::new(),
                )
            }
        };
        let pattern = pattern.unwrap();
        let mut sum = [0.0; N];
        for seed in [9001, 9002] {
            let finger = Finger::new(seed);
            let real = respond(&contact, object.touch(), finger.afferents(), Some(1), &|_| ());
            let felt = response_of(&finger, &pattern, seconds, 2).unwrap();
            let judged = value(&Judge::new(&finger, &real, seconds).compare(&felt));
            sum.iter_mut().zip(judged).for_each(|(sum, value)| *sum += value / 2.0);
        }
        sum
    }
}

/// A pressed bar between two rows of pins, and dots: the errors of all afferents in 10 ms and of SA1 and RA afferents in 36 ms, and the spikes
/// of PC afferents.
#[test]
fn a_rendered_press_is_nearer_to_the_object_than_any_rule() {
    let dots = Shape::Dots(vec![[-2.4, 6.1], [-2.4, 0.3], [3.4, 0.3]]);
    for shape in [bar(0.8), bar(1.45), dots] {
        let object = pressed(&shape);
        let figures = means(&object, |judged| {
            [judged.error, judged.error_by_class[0], judged.error_by_class[1], judged.spikes[2]]
        });
        let (auto, rule, reach) = (figures("auto"), figures("rule"), figures("reach"));
        println!("{shape:?}: {auto:.2?}, rule {rule:.2?}, within reach {reach:.2?}");
        for of in [rule, reach] {
            assert!((0..3).all(|error| auto[error] < of[error] - 0.07), "{auto:?} {of:?}");
        }
        assert!(auto[0] < 0.65 && (0.5..2.0).contains(&auto[3]), "{auto:?}");
    }
}

/// A moving bar: the correlation and the spikes of RA afferents.
#[test]
fn a_rendered_motion_gives_ra_afferents_their_spikes() {
    for speed_mm_s in [40.0, 80.0] {
        let object = moving(speed_mm_s);
        let of = means(&object, |judged| [judged.r_by_class[1], judged.error_by_class[1], judged.spikes[1]]);
        let (auto, field, reach) = (of("auto"), of("field"), of("reach"));
        let (rule, stroke) = (of("rule"), of("stroke"));
        println!(
            "{speed_mm_s} mm/s: {auto:.2?}, field {field:.2?}, rule {rule:.2?}, stroke {stroke:.2?}, within reach {reach:.2?}"
        );
        for other in [field, rule, stroke, reach] {
            // At 80 mm/s one stroke correlates as well, with a third of the spikes.
            assert!(auto[0] > other[0] - 0.01 && auto[1] < other[1] - 0.05, "{auto:?} {other:?}");
        }
        assert!((0.5..1.5).contains(&auto[2]), "{auto:?}");
    }
}

/// What hardly moves is pressed, not stroked, and pins come down when the touch ends. The nearest pins lie 1 mm beside the bar.
#[test]
fn slow_objects_are_followed() {
    for speed_mm_s in [0.001, 2.0] {
        let scan = Scan { depth_mm: 0.5, rise_s: 0.05, speed_mm_s, direction_deg: 90.0, duration_s: 0.5 };
        let object = Object::new("slow", surface_of(&bar(0.0)), Touch::scan(Pose::default(), scan).unwrap());
        let (levels, _) = render(Array::paper(), &contact(&object), object.touch(), Method::Auto);
        let highest = |heights: &Vec<f64>| heights.iter().copied().fold(0.0, f64::max);
        let held: Vec<f64> = levels.heights_mm[25..125].iter().map(highest).collect();
        assert!(held.iter().all(|&mm| mm > 0.25), "{speed_mm_s} mm/s: {held:?}");
        assert!(levels.heights_mm.last().is_some_and(|heights| highest(heights) == 0.0));
    }
}

#[test]
fn heights_do_not_depend_on_threads() {
    let object = pressed(&bar(0.8));
    let contact = contact(&object);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(Array::paper(), &contact, object.touch(), Method::Auto))
    };
    assert!(on(1) == on(3));
}

/// The largest numbers that an object may have.
#[test]
fn extremes_give_heights_within_the_travel() {
    let touches = [
        Touch::press(Pose::default(), Press { depth_mm: 2.0, rise_s: 0.01, hold_s: 0.0, fall_s: 0.01 }),
        Touch::press(Pose::default(), Press { depth_mm: 0.01, rise_s: 0.05, hold_s: 0.05, fall_s: 0.05 }),
        Touch::scan(
            Pose::default(),
            Scan { depth_mm: 0.5, rise_s: 0.01, speed_mm_s: 300.0, direction_deg: 45.0, duration_s: 0.1 },
        ),
    ];
    let plate = Shape::Disc { center_mm: [0.0; 2], radius_mm: 14.0 };
    for touch in touches {
        for shape in [plate.clone(), Shape::Dots(vec![[1.0, 1.0]])] {
            let object = Object::new("extreme", surface_of(&shape), touch.clone().unwrap());
            let contact = contact(&object);
            for method in [Method::Auto, Method::Rate, Method::Field, Method::Rule, Method::Stroke] {
                let (levels, _) = render(Array::paper(), &contact, object.touch(), method);
                let travel_mm = Array::paper().motor().travel_um / 1e3;
                let all = || levels.heights_mm.iter().flatten();
                assert!(all().all(|mm| (0.0..=travel_mm).contains(mm)), "{method:?} {shape:?}");
                assert!(levels.pattern(Array::paper(), "extreme", Table::new()).is_ok());
            }
        }
    }
}

/// The rendered patterns of the library are made from the objects of today, with the method of today.
#[test]
fn the_library_is_what_objects_give() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut made = 0;
    for entry in fs::read_dir(root.join("library/objects")).unwrap() {
        let file = entry.unwrap().path();
        let text = fs::read_to_string(&file).unwrap();
        let object = Object::read(&text, "object", &mut |name| fs::read(root.join(name))).unwrap();
        let name = format!("{}-rendered", file.file_stem().unwrap().to_str().unwrap());
        let stored = fs::read_to_string(root.join(format!("library/patterns/rendered/{name}.toml"))).unwrap();
        let stored = Pattern::parse(&stored, &name).unwrap();
        let (levels, _) = render(Array::paper(), &contact(&object), object.touch(), Method::Auto);
        let again = levels.pattern(Array::paper(), &name, stored.provenance().clone()).unwrap();
        assert!(again.to_toml() == stored.to_toml(), "{name}: run docs/library.sh --rendered");
        made += 1;
    }
    assert_eq!(made, fs::read_dir(root.join("library/patterns/rendered")).unwrap().count());
}
