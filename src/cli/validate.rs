//! `validate`: compares both models of skin and afferents with published figures. It needs no daemon.

use super::output::give;
use super::{progress, text};
use anyhow::Result;
use meissner_skin::ModelName;
use meissner_skin::validate::{Case, Finding, Published, Validation, ValidationVerdict, validate};
use std::process::ExitCode;

pub(super) fn run() -> Result<ExitCode> {
    let found = progress::waiting("measuring both models", validate);
    give(false, &(), || summary(&found))
}

fn summary(found: &Validation) -> String {
    let row = |case: &Case| {
        vec![
            case.name.clone(),
            case.source.to_owned(),
            published(case),
            value(&case.membrane),
            value(&case.afferents),
            verdicts(case),
        ]
    };
    let head = ["case", "source", "published", "membrane", "afferents", "verdict"];
    let models = [ModelName::Membrane, ModelName::Afferents].map(|model| {
        let [agrees, of] = found.agreements(model);
        format!("{} agrees in {agrees} of {of} cases that it was not made from", model.name())
    });
    format!(
        "Both models against published figures. Amplitudes are peak to peak; there is no noise; of several recorded afferents the \
         median counts. In brackets: what agrees.\n\n{}\n\n{}.",
        text::columns(&head, found.cases.iter().map(row)),
        models.join("; ")
    )
}

/// The published figure, and in brackets the range that agrees with it.
fn published(case: &Case) -> String {
    let unit = if case.unit.is_empty() { String::new() } else { format!(" {}", case.unit) };
    let bound = match case.published {
        Published::About(value, factor) => {
            format!("{value}{unit} ({} to {})", three(value / factor), three(value * factor))
        }
        Published::Between(from, to) => format!("{from} to {to}{unit}"),
        Published::AtLeast(least) => format!("at least {least}{unit}"),
        Published::AtMost(most) => format!("at most {most}{unit}"),
    };
    case.published_words.map_or(bound.clone(), |words| format!("{words} ({bound})"))
}

fn value(finding: &Finding) -> String {
    match finding.verdict {
        ValidationVerdict::NotModelled => "-".to_owned(),
        _ => finding.value.map_or_else(|| "none".to_owned(), three),
    }
}

/// What is wrong with each model, or that it agrees.
fn verdicts(case: &Case) -> String {
    let one = |name: ModelName, finding: &Finding| match finding.verdict {
        _ if case.made_from == Some(name) => Some(format!("{} was made from it", name.name())),
        ValidationVerdict::Agrees => Some(format!("{} agrees", name.name())),
        ValidationVerdict::NotModelled => None,
        _ => Some(format!("{} {}", name.name(), finding.says)),
    };
    let both = [one(ModelName::Membrane, &case.membrane), one(ModelName::Afferents, &case.afferents)];
    both.into_iter().flatten().collect::<Vec<_>>().join("; ")
}

/// A number with three significant digits.
fn three(number: f64) -> String {
    let digits = (2.0 - number.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{number:.digits$}")
}
