//! The parsed targets and patterns of a plan.
//!
//! Invariant: every document that a value of the plan names is here.

use crate::axis::Document;
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_design::Target;
use std::collections::BTreeMap;

/// See the module.
#[derive(Debug, Default)]
pub(crate) struct Documents {
    targets: BTreeMap<String, Target>,
    /// Each with the target that it was made for, if it says so.
    patterns: BTreeMap<String, (Pattern, Option<Target>)>,
}

impl Documents {
    /// Parses texts. An error names the document.
    pub(crate) fn read(
        texts: &BTreeMap<(Document, String), String>,
    ) -> Result<Self, (Document, String, String)> {
        let mut all = Self::default();
        for ((kind, name), text) in texts {
            let wrong = |why: &dyn ToString| (*kind, name.clone(), why.to_string());
            match kind {
                Document::Target => {
                    let target = Target::read(text, name).map_err(|error| wrong(&error))?;
                    all.targets.insert(name.clone(), target);
                }
                Document::Pattern => {
                    let pattern = Pattern::parse(text, name).map_err(|error| wrong(&error))?;
                    if !pattern.motions().is_empty() {
                        let why = format!(
                            "`{}` has motions, and a sweep scales drives only: name a pattern without",
                            pattern.name()
                        );
                        return Err(wrong(&why));
                    }
                    let target = Target::made_for(&pattern);
                    all.patterns.insert(name.clone(), (pattern, target));
                }
            }
        }
        Ok(all)
    }

    /// The arrays that they name and that are not shipped.
    pub(crate) fn arrays(&self) -> impl Iterator<Item = Array> {
        let patterns = self.patterns.values().flat_map(|(pattern, target)| {
            [Some(pattern.array()), target.as_ref().map(Target::array)].into_iter().flatten()
        });
        self.targets.values().map(Target::array).chain(patterns).filter(|array| !array.is_shipped())
    }

    pub(crate) fn target(&self, name: &str) -> &Target {
        self.targets.get(name).expect("a plan's targets were read")
    }

    pub(crate) fn pattern(&self, name: &str) -> &Pattern {
        &self.patterns.get(name).expect("a plan's patterns were read").0
    }

    pub(crate) fn target_of_pattern(&self, name: &str) -> Option<&Target> {
        self.patterns.get(name)?.1.as_ref()
    }

    /// The target that a pattern was made for.
    pub(crate) fn target_of(&self, pattern: &str) -> &Target {
        self.target_of_pattern(pattern).expect("a plan without targets has patterns that name theirs")
    }
}
