//! What a finger feels of the object that a pattern was rendered from, beside what it feels of the pattern: the rate of every afferent, class
//! by class, and the spikes over time along a strip of skin.
//!
//! The object stands in the provenance. The finger is one that nothing was made for.

use crate::chart::{Axis, Chart, Dot, Point, Scale, Series, stacked};
use crate::figures::error::FiguresError;
use crate::figures::map::{Pad, pads};
use crate::figures::page::Section;
use crate::figures::table::{csv, number};
use meissner_array::pattern::Pattern;
use meissner_render::{Judge, response_of};
use meissner_skin::afferents::Class;
use meissner_skin::membrane::{PAD_LENGTH_MM, Position};
use meissner_skin::{Finger, SkinModel};
use meissner_touch::{Contact, Object, respond};
use serde::Serialize;
use std::io::{Error, ErrorKind};

/// The seed of the finger; it is the first of `meissner judge`.
const FINGER: u64 = 5000;
/// After the touch, spikes are counted for so long, s.
const AFTER_S: f64 = 0.1;
/// Half the width of the strip along the finger whose spikes are drawn over time, mm.
const STRIP_MM: f64 = 1.5;
/// The height of a chart of spikes, px.
const HEIGHT: u16 = 320;

/// How near a rendered pattern comes to its object.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FeltFigures {
    /// The object.
    pub object: String,
    /// By class, SA1, RA and PC: the correlation of the blurred responses in windows of 36 ms.
    pub r: [f64; 3],
    /// By class: the size of their difference over the size of the response to the object.
    pub error: [f64; 3],
    /// By class: spikes over those under the object.
    pub spikes: [f64; 3],
}

/// The spikes of a finger, s, by afferent.
type Spikes = Vec<Vec<f64>>;

/// Adds the figures, if the provenance of the pattern has an object.
pub(super) fn add(
    section: &mut Section,
    pattern: &Pattern,
    command: &str,
) -> Result<Option<FeltFigures>, FiguresError> {
    let Some(object) = object_of(pattern) else { return Ok(None) };
    let touch = object.touch();
    let contact = Contact::new(object.grains(object.pitch_mm()), touch.most_depth_mm())?;
    let finger = Finger::new(SkinModel::AFFERENTS, FINGER);
    let seconds = touch.duration_s() + AFTER_S;
    let real_s = respond(&contact, touch, finger.afferents(), Some(0), &|_| ());
    let felt_s = response_of(&finger, pattern, seconds, 1)?;
    let judged = Judge::new(&finger, &real_s, seconds).compare(&felt_s);
    let (r, error, spikes) = (judged.r_by_class, judged.error_by_class, judged.spikes);
    let both = [("the object", &real_s), ("the pattern", &felt_s)];
    for class in Class::ALL {
        let of = class as usize;
        let caption = format!(
            "{} afferents of finger {FINGER} under the {} and under {}, for {} s: correlation {}, error {}, {} times the spikes.",
            class.name(),
            object.name(),
            pattern.name(),
            number(seconds),
            shown(r[of]),
            shown(error[of]),
            shown(spikes[of])
        );
        let name = format!("pattern-{}-felt-{}", pattern.name(), class.name().to_lowercase());
        let (svg, numbers) = maps(pattern, &finger, class, both, seconds);
        section.figure(&name, svg, Some(numbers), &caption, command);
    }
    let caption = format!(
        "Spikes over time of afferents within {STRIP_MM} mm of the finger's middle line, under the {} and under {}.",
        object.name(),
        pattern.name()
    );
    let charts = both.map(|(title, spikes_s)| over_time(title, &finger, spikes_s, seconds));
    let name = format!("pattern-{}-felt-over-time", pattern.name());
    section.figure(&name, stacked(&charts, HEIGHT), None, &caption, command);
    Ok(Some(FeltFigures { object: object.name().to_owned(), r, error, spikes }))
}

/// A number; a dash if the object gives no spikes to compare with.
fn shown(of: f64) -> String {
    if of.is_nan() { "-".to_owned() } else { number(of) }
}

/// The object that the pattern was rendered from.
fn object_of(pattern: &Pattern) -> Option<Object> {
    let object = pattern.provenance().get("object")?.as_table()?;
    // What stands in a provenance names no other file.
    let mut none = |_: &str| Err(Error::from(ErrorKind::NotFound));
    Object::read(&toml::to_string(object).ok()?, "provenance", &mut none).ok()
}

/// The rates of a class's afferents on two pads, and as numbers.
fn maps(
    pattern: &Pattern,
    finger: &Finger,
    class: Class,
    both: [(&str, &Spikes); 2],
    seconds: f64,
) -> (String, String) {
    let places: Vec<Position> = finger.of_class(class).map(|number| finger.afferents()[number].at).collect();
    let rates = both.map(|(_, spikes_s)| {
        finger.of_class(class).map(|number| spikes_s[number].len() as f64 / seconds).collect::<Vec<f64>>()
    });
    let pad = |index: usize| Pad {
        title: format!("{}: {}", class.name(), both[index].0),
        afferents: &places,
        rates_hz: Some(&rates[index]),
        aim: None,
    };
    let row = |index: usize| {
        let Position { x_mm, y_mm } = places[index];
        format!("{x_mm:.3},{y_mm:.3},{:.2},{:.2}", rates[0][index], rates[1][index])
    };
    let numbers = csv("x_mm,y_mm,object_hz,pattern_hz", (0..places.len()).map(row));
    (pads(&pattern.array(), &[pad(0), pad(1)]), numbers)
}

/// The spikes of the strip: a point at each spike's time and its afferent's place along the finger.
fn over_time<'t>(title: &'t str, finger: &Finger, spikes_s: &Spikes, seconds: f64) -> Chart<'t> {
    let points = |class: Class| {
        let in_strip =
            finger.of_class(class).filter(|&number| finger.afferents()[number].at.x_mm.abs() < STRIP_MM);
        let of = |number: usize| {
            let y = finger.afferents()[number].at.y_mm;
            spikes_s[number].iter().map(move |&x| Point { x, y, sd: 0.0 })
        };
        in_strip.flat_map(of).collect()
    };
    let series = Class::ALL.map(|class| Series {
        points: points(class),
        dot: Dot::Ring,
        ..Series::line(class.name(), Vec::new())
    });
    let half_mm = PAD_LENGTH_MM / 2.0;
    Chart {
        title: Some(title),
        x: Axis { name: "time, s", scale: Scale::linear(0.0, seconds) },
        y: Axis { name: "along the finger, mm", scale: Scale::linear(-half_mm, half_mm) },
        series: series.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::Array;
    use meissner_render::{Method, render};
    use toml::Table;

    const OBJECT: &str = "kind = 'object'\nname = 'ridge'\nshape = 'bar'\nlength_mm = 12\nwidth_mm = 0.8\n\
                          touch.press = { depth_um = 500, rise_s = 0.02, hold_s = 0.05, fall_s = 0.02 }";

    fn section_of(pattern: &Pattern) -> (Section, Option<FeltFigures>) {
        let mut section = Section::new("", "");
        let figures = add(&mut section, pattern, "meissner report ridge").unwrap();
        (section, figures)
    }

    #[test]
    fn a_rendered_pattern_is_drawn_beside_its_object() {
        let object: Table = OBJECT.parse().unwrap();
        let provenance = Table::from_iter([("object".to_owned(), object.into())]);
        let pattern = Pattern::new(Array::paper(), "pressed", Some(0.1), Vec::new(), provenance).unwrap();
        let object = object_of(&pattern).unwrap();
        let touch = object.touch();
        let contact = Contact::new(object.grains(object.pitch_mm()), touch.most_depth_mm()).unwrap();
        let still = section_of(&pattern).1.unwrap();
        assert_eq!((still.object.as_str(), still.spikes[1]), ("ridge", 0.0));

        let levels = render(Array::paper(), &contact, touch, Method::Field);
        let provenance = pattern.provenance().clone();
        let pattern = levels.pattern(Array::paper(), "pressed", provenance).unwrap();
        let (section, figures) = section_of(&pattern);
        let figures = figures.unwrap();
        assert!(figures.r[1] > 0.6 && figures.error[1] < 0.8 && figures.spikes[1] > 0.4, "{figures:?}");
        let names: Vec<&str> = section.files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(names.len(), 7, "{names:?}");
        let csv = &section.files.iter().find(|file| file.name == "pattern-pressed-felt-ra.csv").unwrap().text;
        let finger = Finger::new(SkinModel::AFFERENTS, FINGER);
        assert_eq!(csv.lines().count(), 1 + finger.of_class(Class::Ra).count());
    }

    #[test]
    fn a_pattern_without_an_object_has_no_such_figure() {
        for object in ["'edge-45'", "{ kind = 'object', name = 'a', shape = 'map', file = '/etc/passwd' }"] {
            let provenance: Table = format!("object = {object}").parse().unwrap();
            let pattern = Pattern::new(Array::paper(), "pressed", Some(0.1), Vec::new(), provenance).unwrap();
            assert_eq!(section_of(&pattern).1, None, "{object}");
        }
    }
}
