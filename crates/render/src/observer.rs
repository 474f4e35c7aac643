//! Observers that name what a finger feels.
//!
//! An observer knows the mean response of a finger to each thing of a set, and names the thing whose mean is nearest to the response that it
//! gets. One reads each afferent (fine), one the responses blurred over the skin (blurred): what is common to different fingers. Both
//! read counts in three windows of the touch. Distances are between roots of counts, whose scatter hardly depends on their size
//! (Anscombe 1948). The roots of each class are scaled to the same size: what is felt stronger or weaker as a whole is the same thing.
//!
//! # Source
//!
//! F. J. Anscombe, "The transformation of Poisson, binomial and negative-binomial data", *Biometrika* 35, 246-254, 1948.

use crate::blurred::{Blurred, counts};
use meissner_skin::Finger;
use meissner_skin::afferents::Class;

/// Windows of a touch: its beginning, middle and end.
const WINDOWS: usize = 3;

/// What an observer reads in a response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reads {
    /// Each afferent.
    Fine,
    /// The mean of the afferents near each place, with a Gaussian weight of [`BLUR_MM`](crate::BLUR_MM).
    Blurred,
}

/// An observer of one finger's responses.
#[derive(Clone, Debug)]
pub struct Observer<'f> {
    finger: &'f Finger,
    blurred: Option<Blurred>,
    seconds: f64,
    /// By thing: the sum of the responses it has seen, and their number.
    seen: Vec<(Vec<f64>, f64)>,
}

impl<'f> Observer<'f> {
    /// An observer of touches of so many seconds, who has to tell `things` apart and has felt none.
    pub fn new(finger: &'f Finger, reads: Reads, seconds: f64, things: usize) -> Self {
        let blurred = match reads {
            Reads::Fine => None,
            Reads::Blurred => Some(Blurred::new(finger.afferents())),
        };
        Self { finger, blurred, seconds, seen: vec![(Vec::new(), 0.0); things] }
    }

    /// Feels a thing, with its number in the set: spikes in s, by afferent.
    pub fn learn(&mut self, thing: usize, spikes_s: &[Vec<f64>]) {
        let response = self.read(spikes_s);
        let (sum, number) = &mut self.seen[thing];
        sum.resize(response.len(), 0.0);
        sum.iter_mut().zip(response).for_each(|(sum, value)| *sum += value);
        *number += 1.0;
    }

    /// The number of the thing that it takes a response for; none if it has felt no thing.
    pub fn name(&self, spikes_s: &[Vec<f64>]) -> Option<usize> {
        let response = self.read(spikes_s);
        let far = |(sum, number): &(Vec<f64>, f64)| -> f64 {
            sum.iter()
                .zip(&response)
                .map(|(sum, value)| (sum / number - value) * (sum / number - value))
                .sum()
        };
        let known = self.seen.iter().enumerate().filter(|(_, (_, number))| *number > 0.0);
        known
            .map(|(thing, seen)| (thing, far(seen)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(thing, _)| thing)
    }

    /// The roots of counts, by class, window, and afferent or place; those of each class scaled to the same size.
    fn read(&self, spikes_s: &[Vec<f64>]) -> Vec<f64> {
        let counts = counts(spikes_s, self.seconds / WINDOWS as f64, WINDOWS);
        let of_class = |class: Class| {
            let of_window = |window: usize| -> Vec<f64> {
                let count = |number: usize| counts[number][window];
                match &self.blurred {
                    Some(blurred) => blurred.of_class(class, count),
                    None => self.finger.of_class(class).map(count).collect(),
                }
            };
            let roots: Vec<f64> = (0..WINDOWS).flat_map(of_window).map(f64::sqrt).collect();
            let size = roots.iter().map(|root| root * root).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
            roots.into_iter().map(move |root| root / size).collect::<Vec<f64>>()
        };
        Class::ALL.map(of_class).concat()
    }
}
