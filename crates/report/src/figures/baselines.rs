//! Compares a pattern with the naive rules for its target, under both models and for each class of afferents.
//!
//! Invariant: all are measured in the same way: on the finger of the target's seed, with its noise.

use crate::figures::error::FiguresError;
use crate::figures::table::{number, table};
use meissner_array::pattern::Drive;
use meissner_design::{OfClass, Rule, Target, quality};
use meissner_skin::ModelName;
use serde::Serialize;

/// How well a pattern or a naive rule renders the target to each class of afferents of both models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Compared {
    /// `pattern`, or the rule's name.
    pub name: &'static str,
    /// Class by class; a class without ON or OFF afferents is left out.
    pub classes: Vec<OfClass>,
}

/// Compares drives with the naive rules for their target.
pub(super) fn compare(target: &Target, drives: &[Drive]) -> Result<Vec<Compared>, FiguresError> {
    let rules = Rule::ALL.map(|rule| (rule.name(), rule.drives(target)));
    let all = [("pattern", drives.to_vec())].into_iter().chain(rules);
    let compared = |(name, drives): (&'static str, Vec<Drive>)| {
        let mut classes = Vec::new();
        for model in [ModelName::Membrane, ModelName::Afferents] {
            classes.extend(quality(target, &drives, &[target.population_seed()], model)?);
        }
        Ok(Compared { name, classes })
    };
    all.map(compared).collect()
}

/// A row per pattern or rule and class.
pub(super) fn rows(compared: &[Compared]) -> String {
    let head = ["", "model", "class", "contrast, impulses/s", "normalised", "AUC", "gap between dots"];
    let row = |of: &Compared, class: &OfClass| {
        let quality = &class.quality;
        let mut row = vec![of.name.to_owned(), class.model.name().to_owned(), class.class.name().to_owned()];
        row.extend([quality.contrast_hz, quality.normalised_contrast, quality.auc].map(number));
        row.push(quality.gap.map_or("-".to_owned(), number));
        row
    };
    table(&head, compared.iter().flat_map(|of| of.classes.iter().map(move |class| row(of, class))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_design::shipped;

    #[test]
    fn a_pattern_that_is_a_rule_equals_it_and_both_models_are_there() {
        let target = shipped("two-dots").unwrap();
        let found = compare(&target, &Rule::Reach.drives(&target)).unwrap();
        assert_eq!(
            found.iter().map(|of| of.name).collect::<Vec<_>>(),
            ["pattern", "naive-reach", "naive-pitch"]
        );
        assert_eq!(found[0].classes, found[1].classes);
        assert_ne!(found[1].classes, found[2].classes);
        let models: Vec<_> = found[0].classes.iter().map(|of| (of.model.name(), of.class.name())).collect();
        assert_eq!(models[0], ("membrane", "RA"));
        assert!(models.contains(&("afferents", "RA")) && models.contains(&("afferents", "SA1")));
        let text = rows(&found);
        assert!(text.contains("naive-pitch") && text.contains("gap between dots"), "{text}");
    }
}
