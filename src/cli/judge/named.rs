//! `judge --set`: how often observers name the object that was rendered.
//!
//! One observer has felt the real objects, another the rendered ones; each reads every afferent, or the blurred response. All know the finger.
//! A trace has another time than the touch, so only an observer that has felt traces reads it.

use super::presented::{Presented, fingers_shown, presented};
use crate::cli::output::give;
use crate::cli::{object, progress};
use crate::rendering::{AFTER_S, FIRST_FINGER};
use anyhow::Result;
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_render::{BLUR_MM, Observer, Reads, response_of};
use meissner_skin::{Finger, FingerError};
use meissner_touch::{Contact, Object, respond};
use serde::Serialize;
use std::fmt::Write;
use std::process::ExitCode;

/// Times that an observer feels each object.
const LESSONS: u64 = 4;
/// Noise of rendered objects begins here.
const RENDERED: u64 = 100;

/// What an observer answered.
#[derive(Clone, Debug, Serialize)]
struct Answers {
    /// The share of right names.
    named: f64,
    /// The sensitivity d' of an observer who is right so often among as many names.
    d_prime: f64,
    /// By object that was felt: how often each object was named.
    confusion: Vec<Vec<u32>>,
}

/// A method's line: by the observer of real touch and by that of the display, fine and blurred.
#[derive(Debug, Serialize)]
struct Line {
    name: String,
    /// None for a trace.
    real: Option<[Answers; 2]>,
    own: [Answers; 2],
}

#[derive(Debug, Serialize)]
struct Document {
    objects: Vec<String>,
    fingers: Vec<u64>,
    lines: Vec<Line>,
}

/// By object that was felt: how often each object was named.
type Named = Vec<Vec<u32>>;

/// The answers of an observer.
fn answers(confusion: Named) -> Answers {
    let right: u32 = confusion.iter().enumerate().map(|(thing, named)| named[thing]).sum();
    let all: u32 = confusion.iter().flatten().sum();
    let [right, all] = [right, all].map(f64::from);
    Answers { named: right / all.max(1.0), d_prime: d_prime(right, all, confusion.len()), confusion }
}

/// The d' at which the largest of `names` normal readings, one of them shifted by d', is the right one as often as in these answers. An
/// observer who is always right, or never, counts half an answer less, or more; one who guesses has 0.
fn d_prime(right: f64, answers: f64, names: usize) -> f64 {
    let share = (right / answers.max(1.0)).clamp(0.5 / answers.max(1.0), 1.0 - 0.5 / answers.max(1.0));
    let others = names.saturating_sub(1) as i32;
    let correct = |d_prime: f64| {
        // The density of the right reading times the chance that all others are below it.
        let density = |x: f64| (-x * x / 2.0).exp() / std::f64::consts::TAU.sqrt();
        let (step, mut below, mut sum) = (0.01, 0.0, 0.0);
        for number in -800..=1800 {
            let x = f64::from(number) * step;
            let part = density(x) * step;
            sum += density(x - d_prime) * f64::powi(below + part / 2.0, others) * step;
            below += part;
        }
        sum
    };
    let (mut low, mut high) = (0.0, 10.0);
    for _ in 0..40 {
        let middle = f64::midpoint(low, high);
        if correct(middle) < share { low = middle } else { high = middle }
    }
    high
}

/// A method, and its pattern of each object.
struct Way {
    name: String,
    patterns: Vec<Pattern>,
    /// For how long the observer of the display feels each.
    seconds: f64,
    is_traced: bool,
}

/// The objects, and what all methods make of them.
struct Placed {
    contacts: Vec<Contact>,
    ways: Vec<Way>,
}

impl Placed {
    fn new(array: Array, set: &[String], objects: &[Object]) -> Result<Self> {
        let (mut contacts, mut made) = (Vec::new(), Vec::new());
        for (argument, object) in set.iter().zip(objects) {
            let contact = object::contact(argument, object)?;
            made.push(presented(array, object, &contact)?);
            contacts.push(contact);
        }
        let touch_s = seconds(objects);
        let mut ways: Vec<Way> = Vec::new();
        for Presented { name, pattern, is_traced } in made.into_iter().flatten() {
            let lasts_s = pattern.duration_s().filter(|_| is_traced).unwrap_or(0.0) + AFTER_S;
            match ways.iter_mut().find(|way| way.name == name) {
                Some(way) => {
                    way.patterns.push(pattern);
                    way.seconds = way.seconds.max(lasts_s);
                }
                None => {
                    ways.push(Way {
                        name,
                        patterns: vec![pattern],
                        seconds: touch_s.max(lasts_s),
                        is_traced,
                    });
                }
            }
        }
        // A way counts if all objects have it: a trace needs lines, a stroke motion.
        ways.retain(|way| way.patterns.len() == objects.len());
        Ok(Self { contacts, ways })
    }
}

/// For how long touches are felt.
fn seconds(objects: &[Object]) -> f64 {
    objects.iter().map(|object| object.touch().duration_s()).fold(0.0, f64::max) + AFTER_S
}

/// A finger's answers, fine and blurred.
type Sums = [Named; 2];

/// The spikes of a finger, s, by afferent.
type Felt = Vec<Vec<f64>>;

/// Adds what observers name a response.
fn add(sums: &mut Sums, observers: &[Observer<'_>], thing: usize, felt: &[Vec<f64>]) {
    for (sum, observer) in sums.iter_mut().zip(observers) {
        if let Some(named) = observer.name(felt) {
            sum[thing][named] += 1;
        }
    }
}

/// One finger, and how it is asked.
struct Asked<'a> {
    finger: Finger,
    objects: &'a [Object],
    seed: u64,
}

impl Asked<'_> {
    fn observers(&self, seconds: f64) -> [Observer<'_>; 2] {
        [Reads::Fine, Reads::Blurred]
            .map(|reads| Observer::new(&self.finger, reads, seconds, self.objects.len()))
    }

    /// What an observer learns under each object, and what it is asked then: `feel` gives the response to an object by noise.
    fn taught<E>(
        &self,
        seconds: f64,
        feel: impl Fn(usize, u64) -> Result<Felt, E>,
    ) -> Result<([Observer<'_>; 2], Vec<Felt>), E> {
        let mut observers = self.observers(seconds);
        let mut tests = Vec::new();
        for thing in 0..self.objects.len() {
            for lesson in 0..LESSONS {
                let felt = feel(thing, self.seed.wrapping_add(lesson))?;
                observers.iter_mut().for_each(|observer| observer.learn(thing, &felt));
            }
            tests.push(feel(thing, self.seed.wrapping_add(LESSONS))?);
        }
        Ok((observers, tests))
    }

    /// Adds the answers to the object felt again, and then to each method.
    fn answer(&self, placed: &Placed, sums: &mut [[Sums; 2]], progress: &dyn Fn(f64)) -> Result<()> {
        let real = |thing: usize, noise| -> Result<_, FingerError> {
            let touch = self.objects[thing].touch();
            Ok(respond(&placed.contacts[thing], touch, self.finger.afferents(), Some(noise), &|_| ()))
        };
        let (learned, tests) = self.taught(seconds(self.objects), real)?;
        for (thing, felt) in tests.iter().enumerate() {
            // The observer of the display has felt the same.
            sums[0].iter_mut().for_each(|sums| add(sums, &learned, thing, felt));
        }
        let share = 1.0 / (placed.ways.len() + 1) as f64;
        progress(share);
        for (number, (way, [of_real, of_own])) in placed.ways.iter().zip(&mut sums[1..]).enumerate() {
            let rendered = |thing: usize, noise: u64| {
                response_of(&self.finger, &way.patterns[thing], way.seconds, noise.wrapping_add(RENDERED))
            };
            let (own, tests) = self.taught(way.seconds, rendered)?;
            for (thing, felt) in tests.iter().enumerate() {
                add(of_own, &own, thing, felt);
                if !way.is_traced {
                    add(of_real, &learned, thing, felt);
                }
            }
            progress((number + 2) as f64 * share);
        }
        Ok(())
    }
}

pub(super) fn run(array: Array, set: &[String], fingers: u64, seed: u64, json: bool) -> Result<ExitCode> {
    let objects: Vec<Object> = set.iter().map(|argument| object::read(argument)).collect::<Result<_>>()?;
    let fingers: Vec<u64> = (FIRST_FINGER..FIRST_FINGER + fingers).collect();
    let lines = progress::metered(|progress| {
        let placed = Placed::new(array, set, &objects)?;
        let none = vec![vec![0; objects.len()]; objects.len()];
        let sums: Sums = [none.clone(), none];
        let mut sums = vec![[sums.clone(), sums]; placed.ways.len() + 1];
        for (index, &finger) in fingers.iter().enumerate() {
            let finger = Finger::new(finger);
            let one = Asked { finger, objects: &objects, seed };
            let progress = |share: f64| progress((index as f64 + share) / fingers.len() as f64);
            one.answer(&placed, &mut sums, &progress)?;
        }
        let mut lines = vec![("the object again".to_owned(), false)];
        lines.extend(placed.ways.into_iter().map(|way| (way.name, way.is_traced)));
        let line = |((name, is_traced), [real, own]): ((String, bool), [Sums; 2])| Line {
            name,
            real: (!is_traced).then(|| real.map(answers)),
            own: own.map(answers),
        };
        anyhow::Ok(lines.into_iter().zip(sums).map(line).collect())
    })?;
    let names = objects.iter().map(|object| object.name().to_owned()).collect();
    let document = Document { objects: names, fingers, lines };
    give(json, &document, || table(&document))
}

fn table(document: &Document) -> String {
    let width = "display, blurred".len();
    let mut table = format!(
        "{} objects, {}, by observers of real touch and of the display (blurred: {BLUR_MM} mm): share named, d'\n{:24}",
        document.objects.len(),
        fingers_shown(document.fingers.len()),
        ""
    );
    // Writing to a string does not fail.
    for title in ["real, fine", "real, blurred", "display, fine", "display, blurred"] {
        let _ = write!(table, " | {title:>width$}");
    }
    for Line { name, real, own } in &document.lines {
        let _ = write!(table, "\n{name:24}");
        let real = real.as_ref().map_or([None; 2], |real| real.each_ref().map(Some));
        for answers in real.into_iter().chain(own.each_ref().map(Some)) {
            let shown = |of: &Answers| format!("{:5.2} {:5.2}", of.named, of.d_prime);
            let shown = answers.map_or_else(|| "-".to_owned(), shown);
            let _ = write!(table, " | {shown:>width$}");
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sensitivity_is_that_of_the_share_of_right_names() {
        // Of two, the share is that of a normal distribution below d'/sqrt 2.
        assert!((d_prime(855_577.0, 1e6, 2) - 1.5).abs() < 1e-3);
        assert!(d_prime(25.0, 100.0, 4) < 0.02 && d_prime(0.0, 9.0, 3) < 1e-6);
        assert!(d_prime(10.0, 10.0, 4) < d_prime(100.0, 100.0, 4));
    }
}
