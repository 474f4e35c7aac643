//! `judge --set`: how often observers name the object that was rendered, and how far off they place it.
//!
//! One observer has felt the real objects, another the rendered ones; each reads every afferent, or the blurred response. All know the finger.
//! A trace has another time than the touch, so only an observer that has felt traces reads it.

use super::{AFTER_S, FIRST_FINGER, Judge, Presented, fingers_shown, presented};
use crate::cli::output::give;
use crate::cli::{object, progress};
use anyhow::{Result, bail};
use meissner_array::pattern::Pattern;
use meissner_array::random;
use meissner_array::spec::Array;
use meissner_render::{Observer, Reads, response_of};
use meissner_skin::{Finger, FingerError};
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
    /// The distance of the named object from the real one, RMS, mm.
    place_mm: f64,
    /// The difference of their angles, RMS, degrees.
    angle_deg: f64,
    /// The difference of their gaps, RMS, mm; 0 for objects without gap.
    gap_mm: f64,
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
    spread_mm: f64,
    blur_mm: f64,
    lines: Vec<Line>,
    #[serde(skip)]
    columns: Vec<Column>,
}

/// The sums of answers.
#[derive(Clone, Debug)]
struct Sum {
    confusion: Vec<Vec<u32>>,
    answers: f64,
    right: f64,
    squared_mm: f64,
    squared_deg: f64,
    squared_gap_mm: f64,
}

impl Sum {
    fn new(objects: usize) -> Self {
        Self {
            confusion: vec![vec![0; objects]; objects],
            answers: 0.0,
            right: 0.0,
            squared_mm: 0.0,
            squared_deg: 0.0,
            squared_gap_mm: 0.0,
        }
    }

    fn add(&mut self, objects: &[Object], thing: usize, named: usize) {
        self.confusion[thing][named] += 1;
        let [is, taken] = [thing, named].map(|number| objects[number].touch().pose(0.0));
        self.answers += 1.0;
        self.right += f64::from(u8::from(thing == named));
        self.squared_mm += (is.x_mm - taken.x_mm).powi(2) + (is.y_mm - taken.y_mm).powi(2);
        // Turned by 180 degrees, a line is the same.
        let turned = (is.angle_deg - taken.angle_deg + 90.0).rem_euclid(180.0) - 90.0;
        self.squared_deg += turned * turned;
        if let [Some(is), Some(taken)] = [thing, named].map(|number| objects[number].gap_mm()) {
            self.squared_gap_mm += (is - taken) * (is - taken);
        }
    }

    fn answers(self) -> Answers {
        let mean = |sum: f64| sum / self.answers.max(1.0);
        Answers {
            named: mean(self.right),
            d_prime: d_prime(self.right, self.answers, self.confusion.len()),
            place_mm: mean(self.squared_mm).sqrt(),
            angle_deg: mean(self.squared_deg).sqrt(),
            gap_mm: mean(self.squared_gap_mm).sqrt(),
            confusion: self.confusion,
        }
    }
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

/// What the table shows of an observer's answers: names, and in what else the objects differ.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Column {
    Named,
    DPrime,
    Place,
    Angle,
    Gap,
}

impl Column {
    fn of(objects: &[Object]) -> Vec<Self> {
        let differs = |differ: &dyn Fn(&Object, &Object) -> bool| {
            objects.windows(2).any(|pair| differ(&pair[0], &pair[1]))
        };
        let pose = |object: &Object| object.touch().pose(0.0);
        let gaps = objects.iter().all(|object| object.gap_mm().is_some());
        let place = differs(&|a, b| [pose(a).x_mm, pose(a).y_mm] != [pose(b).x_mm, pose(b).y_mm]);
        let columns = [
            (Self::Named, true),
            (Self::DPrime, true),
            (Self::Place, place),
            (Self::Angle, differs(&|a, b| pose(a).angle_deg != pose(b).angle_deg)),
            (Self::Gap, gaps && differs(&|a, b| a.gap_mm() != b.gap_mm())),
        ];
        columns.into_iter().filter(|(_, shown)| *shown).map(|(column, _)| column).collect()
    }

    const fn title(self) -> &'static str {
        match self {
            Self::Named => "share named",
            Self::DPrime => "d'",
            Self::Place => "place RMS mm",
            Self::Angle => "angle RMS degrees",
            Self::Gap => "gap RMS mm",
        }
    }

    fn shown(self, answers: &Answers) -> String {
        match self {
            Self::Named => format!("{:5.2}", answers.named),
            Self::DPrime => format!("{:5.2}", answers.d_prime),
            Self::Place => format!("{:5.2}", answers.place_mm),
            Self::Angle => format!("{:5.1}", answers.angle_deg),
            Self::Gap => format!("{:5.2}", answers.gap_mm),
        }
    }
}

/// A method, and its pattern of each object.
struct Way {
    name: String,
    patterns: Vec<Pattern>,
    /// For how long the observer of the display feels each.
    seconds: f64,
    is_traced: bool,
}

/// The objects at one place on the pins, and what all methods make of them.
struct Placed {
    things: Vec<(Object, Contact)>,
    ways: Vec<Way>,
}

impl Placed {
    fn new(asked: &Judge, array: Array, objects: &[Object], by_mm: [f64; 2]) -> Result<Self> {
        let (mut things, mut made) = (Vec::new(), Vec::new());
        for (argument, object) in asked.set.iter().zip(objects) {
            let moved = object.clone().with_touch(object.touch().moved(by_mm)?);
            let contact = object::contact(argument, &moved)?;
            made.push(presented(array, &moved, &contact)?);
            things.push((moved, contact));
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
        // Traces count if all objects have lines.
        ways.retain(|way| way.patterns.len() == objects.len());
        Ok(Self { things, ways })
    }
}

/// For how long touches are felt.
fn seconds(objects: &[Object]) -> f64 {
    objects.iter().map(|object| object.touch().duration_s()).fold(0.0, f64::max) + AFTER_S
}

/// The sums of a finger's answers, fine and blurred.
type Sums = [Sum; 2];

/// The spikes of a finger, s, by afferent.
type Felt = Vec<Vec<f64>>;

/// One finger, and how it is asked.
struct Asked<'a> {
    finger: Finger,
    objects: &'a [Object],
    blur_mm: f64,
    seed: u64,
}

impl Asked<'_> {
    fn observers(&self, seconds: f64) -> [Observer<'_>; 2] {
        [Reads::Fine, Reads::Blurred(self.blur_mm)]
            .map(|reads| Observer::new(&self.finger, reads, seconds, self.objects.len()))
    }

    fn add(&self, sums: &mut Sums, observers: &[Observer<'_>], thing: usize, felt: &[Vec<f64>]) {
        for (sum, observer) in sums.iter_mut().zip(observers) {
            if let Some(named) = observer.name(felt) {
                sum.add(self.objects, thing, named);
            }
        }
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
            let (object, contact) = &placed.things[thing];
            Ok(respond(contact, object.touch(), self.finger.afferents(), Some(noise), &|_| ()))
        };
        let (learned, tests) = self.taught(seconds(self.objects), real)?;
        for (thing, felt) in tests.iter().enumerate() {
            // The observer of the display has felt the same.
            sums[0].iter_mut().for_each(|sums| self.add(sums, &learned, thing, felt));
        }
        let share = 1.0 / (placed.ways.len() + 1) as f64;
        progress(share);
        for (number, (way, [of_real, of_own])) in placed.ways.iter().zip(&mut sums[1..]).enumerate() {
            let rendered = |thing: usize, noise: u64| {
                response_of(&self.finger, &way.patterns[thing], way.seconds, noise.wrapping_add(RENDERED))
            };
            let (own, tests) = self.taught(way.seconds, rendered)?;
            for (thing, felt) in tests.iter().enumerate() {
                self.add(of_own, &own, thing, felt);
                if !way.is_traced {
                    self.add(of_real, &learned, thing, felt);
                }
            }
            progress((number + 2) as f64 * share);
        }
        Ok(())
    }
}

pub(super) fn run(asked: &Judge) -> Result<ExitCode> {
    if !(0.0..=MOST_MM).contains(&asked.spread_mm) {
        bail!("--spread-mm {}: must be 0 to {MOST_MM} mm", asked.spread_mm);
    }
    if !(0.5..=5.0).contains(&asked.blur_mm) {
        bail!("--blur-mm {}: must be 0.5 to 5 mm", asked.blur_mm);
    }
    let array = asked.array.find()?.unwrap_or_default();
    let objects: Vec<Object> =
        asked.set.iter().map(|argument| object::read(argument)).collect::<Result<_>>()?;
    let fingers: Vec<u64> = (FIRST_FINGER..FIRST_FINGER + asked.fingers).collect();
    let lines = progress::metered(|progress| {
        let place = |finger: u64| {
            let shares = random::uniform([asked.seed, finger, 0, PLACE_WORD]);
            let by_mm = shares.map(|share| asked.spread_mm * (2.0 * share - 1.0));
            Placed::new(asked, array, &objects, by_mm)
        };
        let mut placed = place(FIRST_FINGER)?;
        let sum = Sum::new(objects.len());
        let sums: Sums = [sum.clone(), sum];
        let mut sums = vec![[sums.clone(), sums]; placed.ways.len() + 1];
        for (index, &seed) in fingers.iter().enumerate() {
            // Without a spread, all fingers have the set at one place.
            if asked.spread_mm > 0.0 && index > 0 {
                placed = place(seed)?;
            }
            let finger = Finger::new(seed);
            let one = Asked { finger, objects: &objects, blur_mm: asked.blur_mm, seed: asked.seed };
            let progress = |share: f64| progress((index as f64 + share) / fingers.len() as f64);
            one.answer(&placed, &mut sums, &progress)?;
        }
        let mut lines = vec![("the object again".to_owned(), false)];
        lines.extend(placed.ways.into_iter().map(|way| (way.name, way.is_traced)));
        let line = |((name, is_traced), [real, own]): ((String, bool), [Sums; 2])| Line {
            name,
            real: (!is_traced).then(|| real.map(Sum::answers)),
            own: own.map(Sum::answers),
        };
        anyhow::Ok(lines.into_iter().zip(sums).map(line).collect())
    })?;
    let columns = Column::of(&objects);
    let names = objects.iter().map(|object| object.name().to_owned()).collect();
    let (spread_mm, blur_mm) = (asked.spread_mm, asked.blur_mm);
    let document = Document { objects: names, fingers, spread_mm, blur_mm, lines, columns };
    give(asked.output.json, &document, || table(&document))
}

fn table(document: &Document) -> String {
    let Document { columns, blur_mm, .. } = document;
    let titles: Vec<&str> = columns.iter().map(|column| column.title()).collect();
    let width = (6 * columns.len()).max("display, blurred".len());
    let mut table = format!(
        "{} objects, {}, by observers of real touch and of the display (blurred: {blur_mm} mm): {}\n{:24}",
        document.objects.len(),
        fingers_shown(document.fingers.len()),
        titles.join(", "),
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
            let shown: Option<Vec<String>> =
                answers.map(|answers| columns.iter().map(|column| column.shown(answers)).collect());
            let shown = shown.map_or_else(|| "-".to_owned(), |shown| shown.join(" "));
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
