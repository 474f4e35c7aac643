//! A case: the published figure, the models' numbers, and the verdicts.
//!
//! Invariant: the verdict compares numbers; a missing number never agrees.

use crate::ModelName;

/// A published figure, with the tolerance for a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Published {
    /// A value, and the factor by which a model may be above or below it.
    About(f64, f64),
    /// A range.
    Between(f64, f64),
    /// A lower bound.
    AtLeast(f64),
    /// An upper bound.
    AtMost(f64),
}

/// How a model's number compares with the published figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValidationVerdict {
    /// It is within the tolerance.
    Agrees,
    /// It is below.
    Low,
    /// It is above.
    High,
    /// The model has no such number: it never fires, or never locks.
    None,
    /// The model has no afferents of the class.
    NotModelled,
}

/// A model's result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finding {
    /// The number, in the case's unit; none if the model has none.
    pub value: Option<f64>,
    /// The verdict on it.
    pub verdict: ValidationVerdict,
    /// What is wrong, in words; empty if it agrees.
    pub says: &'static str,
}

/// A published case, and both models in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// What is compared.
    pub name: String,
    /// Where the figure was published.
    pub source: &'static str,
    /// Its unit; amplitudes are peak to peak.
    pub unit: &'static str,
    /// The published figure; where only words are published, our own figure.
    pub published: Published,
    /// The published words, if no figure is published.
    pub published_words: Option<&'static str>,
    /// The model whose parameters come from this figure. Its agreement shows only that it was implemented correctly.
    pub made_from: Option<ModelName>,
    /// The first model.
    pub membrane: Finding,
    /// The second.
    pub afferents: Finding,
}

/// All cases.
#[derive(Clone, Debug, PartialEq)]
pub struct Validation {
    /// The cases.
    pub cases: Vec<Case>,
}

impl Published {
    /// The numbers that agree.
    pub fn bounds(self) -> [Option<f64>; 2] {
        match self {
            Self::About(value, factor) => [Some(value / factor), Some(value * factor)],
            Self::Between(from, to) => [Some(from), Some(to)],
            Self::AtLeast(least) => [Some(least), None],
            Self::AtMost(most) => [None, Some(most)],
        }
    }

    /// The verdict on a number; without one the model has none.
    pub fn verdict(self, value: Option<f64>) -> ValidationVerdict {
        let [least, most] = self.bounds();
        match value {
            None => ValidationVerdict::None,
            Some(value) if least.is_some_and(|least| value < least) => ValidationVerdict::Low,
            Some(value) if most.is_some_and(|most| value > most) => ValidationVerdict::High,
            Some(value) if value.is_nan() => ValidationVerdict::None,
            Some(_) => ValidationVerdict::Agrees,
        }
    }
}

/// A case before its numbers.
pub(super) struct Judged {
    pub(super) name: String,
    pub(super) source: &'static str,
    pub(super) unit: &'static str,
    pub(super) published: Published,
    pub(super) published_words: Option<&'static str>,
    pub(super) made_from: Option<ModelName>,
    /// The words for a number below the tolerance and for one above it.
    pub(super) says: [&'static str; 2],
}

impl Judged {
    pub(super) fn with(self, [membrane, afferents]: [Option<f64>; 2], modelled: [bool; 2]) -> Case {
        let Self { name, source, unit, published, published_words, made_from, says } = self;
        let finding = |value: Option<f64>, modelled: bool| {
            let verdict = if modelled { published.verdict(value) } else { ValidationVerdict::NotModelled };
            let says = match verdict {
                ValidationVerdict::Agrees | ValidationVerdict::NotModelled => "",
                ValidationVerdict::Low => says[0],
                ValidationVerdict::High => says[1],
                ValidationVerdict::None => "has no such value",
            };
            Finding { value, verdict, says }
        };
        let (membrane, afferents) = (finding(membrane, modelled[0]), finding(afferents, modelled[1]));
        Case { name, source, unit, published, published_words, made_from, membrane, afferents }
    }
}

impl Validation {
    /// The number of cases in which a model agrees, and the number of cases that it has and was not made from.
    pub fn agreements(&self, model: ModelName) -> [usize; 2] {
        let of = |case: &Case| match model {
            ModelName::Membrane => case.membrane.verdict,
            ModelName::Afferents => case.afferents.verdict,
        };
        let cases = || self.cases.iter().filter(|case| case.made_from != Some(model));
        let count = |holds: fn(ValidationVerdict) -> bool| cases().filter(|case| holds(of(case))).count();
        [
            count(|verdict| verdict == ValidationVerdict::Agrees),
            count(|verdict| verdict != ValidationVerdict::NotModelled),
        ]
    }
}
