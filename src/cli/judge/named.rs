//! `judge --set`: how often observers name the object that was rendered, and how far off they place it.
//!
//! One observer has felt the real objects, another the rendered ones; each reads every afferent, or the blurred response. All know the finger.

use super::{AFTER_S, FIRST_FINGER, Judge, rendered};
use crate::cli::output::give;
use crate::cli::{object, progress};
use anyhow::{Result, bail};
use meissner_array::random;
use meissner_render::{Observer, Reads, response_of};
use meissner_skin::{Finger, SkinModel};
use meissner_touch::{Contact, Object, respond};
use serde::Serialize;
use std::fmt::Write;
use std::process::ExitCode;

/// Times that an observer feels each object.
const LESSONS: u64 = 4;
/// The largest spread, mm.
const MOST_MM: f64 = 10.0;
/// Separates the places of a set from other random numbers.
const PLACE_WORD: u64 = 21;

/// What an observer answered.
#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Answers {
    /// The share of right names.
    named: f64,
    /// The distance of the named object from the real one, RMS, mm.
    place_mm: f64,
    /// The difference of their angles, RMS, degrees.
    angle_deg: f64,
}

/// A method's line: by the observer of real touch and by that of the display, fine and blurred.
#[derive(Debug, Serialize)]
struct Line {
    name: String,
    real: [Answers; 2],
    own: [Answers; 2],
}

#[derive(Debug, Serialize)]
struct Document {
    objects: Vec<String>,
    fingers: Vec<u64>,
    spread_mm: f64,
    lines: Vec<Line>,
}

/// The sums of answers.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    answers: f64,
    right: f64,
    squared_mm: f64,
    squared_deg: f64,
}

impl Sum {
    fn add(&mut self, objects: &[Object], thing: usize, named: usize) {
        let [is, taken] = [thing, named].map(|number| objects[number].touch().pose(0.0));
        self.answers += 1.0;
        self.right += f64::from(u8::from(thing == named));
        self.squared_mm += (is.x_mm - taken.x_mm).powi(2) + (is.y_mm - taken.y_mm).powi(2);
        // Turned by 180 degrees, a line is the same.
        let turned = (is.angle_deg - taken.angle_deg + 90.0).rem_euclid(180.0) - 90.0;
        self.squared_deg += turned * turned;
    }

    fn answers(self) -> Answers {
        let mean = |sum: f64| sum / self.answers.max(1.0);
        Answers {
            named: mean(self.right),
            place_mm: mean(self.squared_mm).sqrt(),
            angle_deg: mean(self.squared_deg).sqrt(),
        }
    }
}

pub(super) fn run(asked: &Judge) -> Result<ExitCode> {
    if !(0.0..=MOST_MM).contains(&asked.spread_mm) {
        bail!("--spread-mm {}: must be 0 to {MOST_MM} mm", asked.spread_mm);
    }
    let array = asked.array.find()?.unwrap_or_default();
    let objects: Vec<Object> =
        asked.set.iter().map(|argument| Ok(object::of_argument(argument)?.0)).collect::<Result<_>>()?;
    let fingers: Vec<u64> = (FIRST_FINGER..FIRST_FINGER + asked.fingers).collect();
    let seconds = objects.iter().map(|object| object.touch().duration_s()).fold(0.0, f64::max) + AFTER_S;
    let lines = progress::metered(|progress| {
        let mut sums: Vec<(String, [[Sum; 2]; 2])> = Vec::new();
        for (index, &seed) in fingers.iter().enumerate() {
            let finger = Finger::new(SkinModel::AFFERENTS, seed);
            let shares = random::uniform([asked.seed, seed, 0, PLACE_WORD]);
            let by_mm = shares.map(|share| asked.spread_mm * (2.0 * share - 1.0));
            let mut learned = [Reads::Fine, Reads::Blurred]
                .map(|reads| Observer::new(&finger, reads, seconds, objects.len()));
            let mut patterns = Vec::new();
            for (thing, object) in objects.iter().enumerate() {
                let touch = object.touch().moved(by_mm)?;
                let moved = object.clone().with_touch(touch);
                let contact = Contact::new(moved.grains(moved.pitch_mm()), moved.touch().most_depth_mm())?;
                let feel = |noise| respond(&contact, moved.touch(), finger.afferents(), Some(noise), &|_| ());
                for lesson in 0..LESSONS {
                    let felt = feel(asked.seed.wrapping_add(lesson));
                    learned.iter_mut().for_each(|observer| observer.learn(thing, &felt));
                }
                let mut all = rendered(array, &contact, moved.touch())?;
                all.sort_by(|a, b| a.0.cmp(&b.0));
                patterns.push((feel(asked.seed.wrapping_add(LESSONS)), all));
                progress(
                    (index as f64 + (thing + 1) as f64 / objects.len() as f64 / 2.0) / fingers.len() as f64,
                );
            }
            let names = patterns
                .first()
                .map_or(Vec::new(), |(_, all)| all.iter().map(|(name, _)| name.clone()).collect());
            if sums.is_empty() {
                let names = std::iter::once("the object again".to_owned()).chain(names.iter().cloned());
                sums = names.map(|name| (name, Default::default())).collect();
            }
            for (thing, (felt, _)) in patterns.iter().enumerate() {
                for (reads, observer) in learned.iter().enumerate() {
                    if let Some(named) = observer.name(felt) {
                        // The observer of the display has felt the same.
                        sums[0].1.iter_mut().for_each(|sums| sums[reads].add(&objects, thing, named));
                    }
                }
            }
            for method in 0..names.len() {
                let mut own = [Reads::Fine, Reads::Blurred]
                    .map(|reads| Observer::new(&finger, reads, seconds, objects.len()));
                let mut tests = Vec::new();
                for (thing, (_, all)) in patterns.iter().enumerate() {
                    let feel = |noise| response_of(&finger, &all[method].1, seconds, noise);
                    for lesson in 0..LESSONS {
                        let felt = feel(asked.seed.wrapping_add(100 + lesson))?;
                        own.iter_mut().for_each(|observer| observer.learn(thing, &felt));
                    }
                    tests.push(feel(asked.seed.wrapping_add(100 + LESSONS))?);
                }
                for (thing, felt) in tests.iter().enumerate() {
                    let of_method = &mut sums[method + 1].1;
                    for (sums, observers) in of_method.iter_mut().zip([&learned, &own]) {
                        for (sum, observer) in sums.iter_mut().zip(observers) {
                            if let Some(named) = observer.name(felt) {
                                sum.add(&objects, thing, named);
                            }
                        }
                    }
                }
            }
            progress((index + 1) as f64 / fingers.len() as f64);
        }
        let line = |(name, [real, own]): (String, [[Sum; 2]; 2])| Line {
            name,
            real: real.map(Sum::answers),
            own: own.map(Sum::answers),
        };
        anyhow::Ok(sums.into_iter().map(line).collect())
    })?;
    let names = objects.iter().map(|object| object.name().to_owned()).collect();
    let document = Document { objects: names, fingers, spread_mm: asked.spread_mm, lines };
    give(asked.output.json, &document, || table(&document))
}

fn table(document: &Document) -> String {
    let mut table = format!(
        "{} objects, {} fingers, by observers of real touch and of the display: share named, place RMS mm, angle RMS degrees\n\
         {:24} | {:>18} | {:>18} | {:>18} | {:>18}",
        document.objects.len(),
        document.fingers.len(),
        "",
        "real, fine",
        "real, blurred",
        "display, fine",
        "display, blurred"
    );
    for Line { name, real, own } in &document.lines {
        // Writing to a string does not fail.
        let _ = write!(table, "\n{name:24}");
        for Answers { named, place_mm, angle_deg } in real.iter().chain(own) {
            let _ = write!(table, " | {named:5.2} {place_mm:5.2} {angle_deg:6.1}");
        }
    }
    table
}
