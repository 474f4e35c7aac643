//! A finding of the doctor: what it looked at, how good that is, what it found, and what to do.
//!
//! Invariant: a finding that is `ok` has no advice; every other has one.

use serde::Serialize;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Level {
    Ok,
    /// The system plays, but perhaps not in time, or not as it stands.
    Warn,
    /// The system does not play.
    Fail,
}

#[derive(Debug, Serialize)]
pub(super) struct Finding {
    pub(super) what: &'static str,
    pub(super) level: Level,
    pub(super) found: String,
    /// What to do; empty if nothing.
    pub(super) advice: String,
}

impl Finding {
    /// `advice` is dropped if the level is `ok`.
    pub(super) fn new(
        what: &'static str,
        level: Level,
        found: impl Into<String>,
        advice: impl AsRef<str>,
    ) -> Self {
        let advice = if level == Level::Ok { "" } else { advice.as_ref() };
        Self { what, level, found: found.into(), advice: advice.to_owned() }
    }

    pub(super) fn ok(what: &'static str, found: impl Into<String>) -> Self {
        Self::new(what, Level::Ok, found, "")
    }

    pub(super) fn warn(what: &'static str, found: impl Into<String>, advice: impl AsRef<str>) -> Self {
        Self::new(what, Level::Warn, found, advice)
    }

    pub(super) fn fail(what: &'static str, found: impl Into<String>, advice: impl AsRef<str>) -> Self {
        Self::new(what, Level::Fail, found, advice)
    }

    /// `ok` or a warning.
    pub(super) fn check(
        what: &'static str,
        good: bool,
        found: impl Into<String>,
        advice: impl AsRef<str>,
    ) -> Self {
        Self::new(what, if good { Level::Ok } else { Level::Warn }, found, advice)
    }
}

/// What the tests of all checks share: the files of a simulated machine, and findings as text.
#[cfg(test)]
pub(super) mod fake {
    use super::{Finding, Level};
    use std::fs;
    use std::path::Path;

    /// Writes a file, and the directories it needs, below a root.
    pub(crate) fn write(root: &Path, path: &str, text: &str) {
        let file = root.join(path);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }

    /// A finding on one line: level, what, found, advice.
    pub(crate) fn line(finding: &Finding) -> String {
        let Finding { what, level, found, advice } = finding;
        assert_eq!(*level == Level::Ok, advice.is_empty(), "{finding:?}");
        format!("{level:?} {what}: {found} -> {advice}")
    }

    pub(crate) fn all<'a>(findings: impl IntoIterator<Item = &'a Finding>) -> Vec<String> {
        findings.into_iter().map(line).collect()
    }
}
