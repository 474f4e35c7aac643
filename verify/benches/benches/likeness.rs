//! How near rendered things come to real ones, on fingers and at places that no number was made with, and what an observer of real touch reads:
//! `cargo bench -p meissner-benches --bench likeness`.
//!
//! `FINGERS` [10] fingers feel `OBJECTS` [5] random places and directions of each thing. A row has the mean and, in brackets, the standard error
//! over the objects. `SEED` [0] makes other fingers and places. Words after `--` choose things by their names. It asserts nothing.
//!
//! `OFF` says what nobody knows while rendering: `motors` that go up to 10 % further or less far, each by its own share; a `finger` 1 mm off;
//! pins with a `radius` of 0.7 mm.

use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::random::uniform;
use meissner_array::spec::{Array, ArraySpec};
use meissner_render::{Judge, Method, Observer, Reads, Rival, ramps_of, render};
use meissner_skin::Finger;
use meissner_touch::{
    Contact, DOT_MM, Object, Pose, Press, Scan, Surface, Touch, braille_dots, respond, surface_of,
};
use meissner_touch::{Shape, direction};
use rayon::prelude::*;
use std::env;
use std::error::Error;

/// Afferents are counted for so long after the object has left, s.
const AFTER_S: f64 = 0.1;
const DEPTH_MM: f64 = 0.5;
const PITCH_MM: f64 = 2.9;
/// What fingers feel: the object again, methods and rules.
const ROWS: [(&str, Option<Method>); 7] = [
    ("felt again", None),
    ("auto", Some(Method::Auto)),
    ("rate", Some(Method::Rate)),
    ("field", Some(Method::Field)),
    ("rule", Some(Method::Rule)),
    ("stroke", Some(Method::Stroke)),
    ("within reach, 60 Hz", None),
];
const COLUMNS: [&str; 12] = [
    "r 10 ms", "e 10 ms", "r SA1", "r RA", "r PC", "e SA1", "e RA", "e PC", "n SA1", "n RA", "n PC",
    "likeness",
];

/// A name, a number of things, and the value of each.
type Read = (&'static str, usize, fn(usize) -> f64);
type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

#[derive(Clone, Copy)]
enum Thing {
    Pressed { gap_mm: Option<f64>, rise_s: f64 },
    Ring,
    Moving { mm_s: f64 },
}

const THINGS: [(&str, Thing); 7] = [
    ("bar", Thing::Pressed { gap_mm: None, rise_s: 0.05 }),
    ("quick", Thing::Pressed { gap_mm: None, rise_s: 0.02 }),
    ("two-bars", Thing::Pressed { gap_mm: Some(4.4), rise_s: 0.05 }),
    ("ring", Thing::Ring),
    ("moving-20", Thing::Moving { mm_s: 20.0 }),
    ("moving-40", Thing::Moving { mm_s: 40.0 }),
    ("moving-80", Thing::Moving { mm_s: 80.0 }),
];

/// What observers read, the number of its values, and the value of each.
const READ: [Read; 3] = [
    ("letter", 26, |number| number as f64),
    ("place, mm", 11, |number| 0.29 * number as f64 - 1.45),
    ("angle, degrees", 11, |number| 4.5 * number as f64),
];

fn press(rise_s: f64) -> Press {
    Press { depth_mm: DEPTH_MM, rise_s, hold_s: 0.05, fall_s: rise_s }
}

fn bar(y_mm: f64) -> Vec<[f64; 2]> {
    vec![[-6.0, y_mm - 0.4], [6.0, y_mm - 0.4], [6.0, y_mm + 0.4], [-6.0, y_mm + 0.4]]
}

fn felt(surface: Surface, touch: Touch) -> Outcome<(Touch, Contact)> {
    let object = Object::new("thing", surface, touch);
    let contact = Contact::new(object.grains(object.pitch_mm()), DEPTH_MM)?;
    Ok((object.touch().clone(), contact))
}

/// A random place within half a pitch of the array's middle.
fn somewhere(seed: u64, number: u64) -> Pose {
    let [x, y] = uniform([seed, number, 0, 62]);
    Pose { x_mm: PITCH_MM * (x - 0.5), y_mm: PITCH_MM * (y - 0.5), ..Pose::default() }
}

fn thing(of: Thing, seed: u64, number: u64) -> Outcome<(Touch, Contact)> {
    let turn = 360.0 * uniform([seed, number, 1, 62])[0];
    let pose = Pose { angle_deg: turn, ..somewhere(seed, number) };
    match of {
        Thing::Pressed { gap_mm, rise_s } => {
            let bars = gap_mm.map_or(vec![0.0], |gap| vec![-(gap + 0.8) / 2.0, (gap + 0.8) / 2.0]);
            felt(Surface::Polygons(bars.into_iter().map(bar).collect()), Touch::press(pose, press(rise_s))?)
        }
        Thing::Ring => {
            let points = (0..=32).map(|point| direction(11.25 * f64::from(point)).map(|of| 4.0 * of));
            felt(surface_of(&Shape::Polyline(points.collect())), Touch::press(pose, press(0.05))?)
        }
        Thing::Moving { mm_s } => {
            let scan = Scan {
                depth_mm: DEPTH_MM,
                rise_s: 0.03,
                speed_mm_s: mm_s,
                direction_deg: turn,
                duration_s: 20.0 / mm_s,
            };
            let across = Pose { angle_deg: turn + 90.0, ..pose };
            felt(Surface::Polygons(vec![bar(0.0)]), Touch::scan(across, scan)?)
        }
    }
}

/// What differs from what was rendered for.
struct Off {
    array: Array,
    motors: bool,
    finger: bool,
}

impl Off {
    fn asked() -> Outcome<Self> {
        let (paper, off) = (Array::paper(), env::var("OFF").unwrap_or_default());
        let array = match &*off {
            "" | "motors" | "finger" => paper,
            "radius" => {
                let text = paper.text().replace("tula35-6x4", "thick-pins");
                let text = text.replace("pitch_mm = 2.9", "pitch_mm = 2.9, radius_mm = 0.7");
                Array::known(ArraySpec::parse(&text, "thick-pins.toml")?)?
            }
            _ => return Err("OFF: must be motors, finger or radius".into()),
        };
        Ok(Self { array, motors: off == "motors", finger: off == "finger" })
    }

    /// The gains of the motors, and by how much the finger is off, mm, under an object of this number.
    fn draw(&self, number: u64) -> (PerMotor<f64>, [f64; 2]) {
        let random = |of: u64| uniform([number, of, 2, 62])[0];
        let gain = |motor: u8| if self.motors { 0.9 + 0.2 * random(motor.into()) } else { 1.0 };
        let finger_mm = if self.finger { direction(360.0 * random(99)) } else { [0.0; 2] };
        (PerMotor::from_fn(self.array, gain), finger_mm)
    }

    /// The spikes of a finger under a pattern, or under the object of this number.
    fn felt_s(
        &self,
        pattern: Option<&Pattern>,
        finger: &Finger,
        (touch, contact): (&Touch, &Contact),
        number: u64,
        noise: u64,
    ) -> Outcome<Vec<Vec<f64>>> {
        let Some(pattern) = pattern else {
            return Ok(respond(contact, touch, finger.afferents(), Some(noise), &|_| ()));
        };
        let (seconds, (gains, finger_mm)) = (touch.duration_s() + AFTER_S, self.draw(number));
        let ramps = ramps_of(pattern, seconds)?.scaled(&gains)?;
        Ok(finger.clone().shifted(finger_mm).spikes_s(&ramps, seconds, noise)?)
    }
}

/// The pattern of each row; none feels the object itself.
fn patterns(touch: &Touch, contact: &Contact, felt: Array) -> Outcome<Vec<Option<Pattern>>> {
    let array = Array::paper();
    let of_row = |(name, method): &(&str, Option<Method>)| match (*name, method) {
        ("felt again", _) => Ok(None),
        (_, Some(method)) => {
            let (levels, _) = render(array, contact, touch, *method);
            Ok(Some(levels.pattern(felt, "rendered", toml::Table::new())?))
        }
        (_, None) => Ok(Some(Rival::WithinReach.pattern(felt, contact, touch)?)),
    };
    ROWS.iter().map(of_row).collect()
}

/// The columns of a thing's rows, by object: near the array, or on the whole pad.
fn judged(
    of: Thing,
    off: &Off,
    [seed, number, fingers]: [u64; 3],
    near: bool,
) -> Outcome<Vec<[f64; COLUMNS.len()]>> {
    let (touch, contact) = thing(of, seed, number)?;
    let (seconds, patterns) = (touch.duration_s() + AFTER_S, patterns(&touch, &contact, off.array)?);
    let mut rows = vec![[0.0; COLUMNS.len()]; ROWS.len()];
    for finger in 0..fingers {
        let finger = Finger::new(20_000 + 1_000 * seed + finger);
        let real_s = respond(&contact, &touch, finger.afferents(), Some(0), &|_| ());
        let judge = Judge::new(&finger, &real_s, seconds);
        let judge = if near { judge.near(Array::paper()) } else { judge };
        for (sums, pattern) in rows.iter_mut().zip(&patterns) {
            let of = judge.compare(&off.felt_s(pattern.as_ref(), &finger, (&touch, &contact), number, 1)?);
            let mut columns = vec![of.r, of.error];
            for group in [of.r_by_class, of.error_by_class, of.spikes] {
                columns.extend(group);
            }
            columns.push(of.likeness());
            sums.iter_mut().zip(columns).for_each(|(sum, value)| *sum += value / fingers as f64);
        }
    }
    Ok(rows)
}

/// A mean and its standard error.
fn mean(values: &[f64]) -> String {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
    format!("{mean:.2} ({:.2})", (squares / (count - 1.0).max(1.0) / count).sqrt())
}

/// One of the things that observers tell apart.
fn read(of: &str, value: f64, at: Pose) -> Outcome<(Touch, Contact)> {
    let pose = match of {
        "place, mm" => Pose { y_mm: at.y_mm + value, ..at },
        "angle, degrees" => Pose { angle_deg: value, ..at },
        _ => {
            let letter = char::from(b'a' + value as u8).to_string();
            let dots = braille_dots(&letter, 2.0 * PITCH_MM, [0.0; 2]).unwrap_or_default();
            let surface = surface_of(&Shape::Dots(dots.into_iter().map(|(_, at)| at).collect()));
            return felt(surface, Touch::press(at, press(0.05))?);
        }
    };
    felt(Surface::Polygons(vec![bar(0.0)]), Touch::press(pose, press(0.05))?)
}

/// By row and observer: the errors of what is read on one finger.
fn errors(of: Read, off: &Off, seed: u64, number: u64) -> Outcome<Vec<[Vec<f64>; 2]>> {
    let (name, count, value) = of;
    let finger = Finger::new(20_000 + 1_000 * seed + number);
    let at = somewhere(seed, 500 + number);
    let all = (0..count).map(|thing| read(name, value(thing), at)).collect::<Outcome<Vec<_>>>()?;
    let seconds = all[0].0.duration_s() + AFTER_S;
    let mut observers =
        [Reads::Fine, Reads::Blurred].map(|reads| Observer::new(&finger, reads, seconds, count));
    for (thing, (touch, contact)) in all.iter().enumerate() {
        for noise in 0..3 {
            let felt_s = off.felt_s(None, &finger, (touch, contact), number, noise)?;
            observers.iter_mut().for_each(|observer| observer.learn(thing, &felt_s));
        }
    }
    let mut rows = vec![[Vec::new(), Vec::new()]; ROWS.len()];
    for (thing, (touch, contact)) in all.iter().enumerate() {
        for (row, pattern) in rows.iter_mut().zip(&patterns(touch, contact, off.array)?) {
            let felt_s = off.felt_s(pattern.as_ref(), &finger, (touch, contact), number, 9)?;
            for (errors, observer) in row.iter_mut().zip(&observers) {
                errors.push(value(observer.name(&felt_s).unwrap_or(0)) - value(thing));
            }
        }
    }
    Ok(rows)
}

fn main() -> Outcome<()> {
    let number = |name: &str, otherwise: u64| -> Outcome<u64> {
        Ok(env::var(name).map_or(Ok(otherwise), |text| text.parse())?)
    };
    let (fingers, objects, seed) = (number("FINGERS", 10)?, number("OBJECTS", 5)?, number("SEED", 0)?);
    let off = Off::asked()?;
    let words: Vec<String> = env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let is_asked = |name: &str| words.is_empty() || words.iter().any(|word| name.starts_with(&**word));
    println!("{objects} random places, {fingers} fingers: mean (standard error); dots of {DOT_MM} mm");
    for (name, of) in THINGS.into_iter().filter(|(name, _)| is_asked(name)) {
        let moves = matches!(of, Thing::Moving { .. });
        for near in [false, true].into_iter().filter(|near| moves || !near) {
            let places = if near { ", places within 1.45 mm of the array" } else { "" };
            println!(
                "\n{name}{places}\n{:20} {}",
                "",
                COLUMNS.map(|column| format!("{column:>12}")).join("")
            );
            let by_object = (0..objects)
                .into_par_iter()
                .map(|number| judged(of, &off, [seed, number, fingers], near))
                .collect::<Outcome<Vec<_>>>()?;
            for (row, (row_name, method)) in ROWS.iter().enumerate() {
                if *method == Some(Method::Stroke) && !moves {
                    continue;
                }
                let column =
                    |column: usize| by_object.iter().map(|rows| rows[row][column]).collect::<Vec<_>>();
                let cells: Vec<String> =
                    (0..COLUMNS.len()).map(|at| format!("{:>12}", mean(&column(at)))).collect();
                println!("{row_name:20} {}", cells.join(""));
            }
        }
    }
    for of in READ.into_iter().filter(|(name, ..)| is_asked(name)) {
        println!("\n{}, read by each afferent and blurred: share right, RMS, bias", of.0);
        let by_finger = (0..fingers)
            .into_par_iter()
            .map(|finger| errors(of, &off, seed, finger))
            .collect::<Outcome<Vec<_>>>()?;
        for (row, (row_name, method)) in ROWS.iter().enumerate() {
            if *method == Some(Method::Stroke) {
                continue;
            }
            let cells = [0, 1].map(|observer| {
                let all: Vec<f64> = by_finger.iter().flat_map(|rows| rows[row][observer].clone()).collect();
                let mean = |of: &dyn Fn(f64) -> f64| {
                    all.iter().map(|error| of(*error)).sum::<f64>() / all.len() as f64
                };
                let right = mean(&|error| f64::from(u8::from(error == 0.0)));
                format!("{right:7.2}{:7.2}{:7.2}", mean(&|error| error * error).sqrt(), mean(&|error| error))
            });
            println!("{row_name:20} {}", cells.join("   "));
        }
    }
    Ok(())
}
