//! The page of the book with what was measured in real time: a row for each kind, a column for each target.
//!
//! A runner renews its own column with [`renew`] and leaves the other as it is. `docs/reference/faults.md`, of virtual time,
//! is another page: a test compares it byte for byte, which figures of real time cannot be.

use crate::case::{Case, Kind};
use crate::judge::Worst;
use crate::plays::Shown;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// What real time can be measured on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// A daemon on the simulated array behind a pseudo-terminal.
    Pty,
    /// The firmware in an emulated chip.
    Chip,
}

const TARGETS: [(Target, &str); 2] = [(Target::Pty, "pty"), (Target::Chip, "chip")];

/// What one kind has shown on one target.
#[derive(Clone, Debug)]
pub enum Cell {
    Worst(Worst),
    /// The target cannot do it; why.
    NotPossible(&'static str),
    /// It was not as its case says.
    Failed,
}

impl From<&Shown> for Cell {
    fn from(shown: &Shown) -> Self {
        if shown.problems.is_empty() { Self::Worst(shown.worst.clone()) } else { Self::Failed }
    }
}

impl Cell {
    fn text(&self) -> String {
        match self {
            Self::Worst(worst) => format!("{}; {}; {}", worst.ends(), worst.safe(), worst.lost()),
            Self::NotPossible(why) => format!("not possible: {why}"),
            Self::Failed => "**not as expected**".to_owned(),
        }
    }
}

/// A run over all kinds, or over some of them again.
#[derive(Clone, Debug)]
pub struct Account<'a> {
    /// As in 2026-11-24.
    pub date: &'a str,
    pub commit: &'a str,
    /// The command that made it.
    pub command: &'a str,
    /// What else has to be known: how many runs, what was allowed.
    pub remark: &'a str,
}

pub fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference/faults-measured.md")
}

/// The name of a kind's row: its case and value.
pub fn row_of(kind: &Kind<'_>) -> (String, String) {
    (kind.case.name.clone(), kind.label())
}

/// Writes the page with a new column for this target: the given cells; kinds that were not played keep their old cells.
///
/// # Errors
/// If the page cannot be read or written.
pub fn renew(
    target: Target,
    account: &Account<'_>,
    cells: &BTreeMap<(String, String), Cell>,
    cases: &[Case],
) -> io::Result<()> {
    let old = match fs::read_to_string(path()) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
        other => other?,
    };
    fs::write(path(), renewed(&old, target, account, cells, cases))
}

fn renewed(
    old: &str,
    target: Target,
    account: &Account<'_>,
    cells: &BTreeMap<(String, String), Cell>,
    cases: &[Case],
) -> String {
    let old = Rows::read(old);
    let mut text = HEAD.to_owned();
    for (other, name) in TARGETS {
        let Account { date, commit, command, remark } = account;
        let kept = old.accounts.get(name).cloned().unwrap_or_else(|| "– | – | – | –".to_owned());
        let is_whole = cells.len() == cases.iter().flat_map(Case::kinds).count();
        let new = if is_whole {
            format!("{date} | {commit} | `{command}` | {remark}")
        } else {
            format!("{kept}; on {date} at {commit} again: {remark}")
        };
        let _ = writeln!(text, "| {name} | {} |", if other == target { new } else { kept });
    }
    text.push_str(ROWS);
    for kind in cases.iter().flat_map(Case::kinds) {
        let row = row_of(&kind);
        let kept = old.kinds.get(&row);
        let columns = TARGETS.iter().enumerate().map(|(column, (other, _))| {
            let new = cells.get(&row).filter(|_| *other == target).map(Cell::text);
            let kept = || kept.and_then(|kept| kept.get(column).cloned());
            new.or_else(kept).unwrap_or_else(|| "–".to_owned())
        });
        let columns: Vec<String> = columns.collect();
        let _ = writeln!(text, "| {} | {} | {} |", row.0, row.1, columns.join(" | "));
    }
    text
}

/// The rows of a page that was written before.
#[derive(Default)]
struct Rows {
    accounts: BTreeMap<String, String>,
    kinds: BTreeMap<(String, String), Vec<String>>,
}

impl Rows {
    fn read(page: &str) -> Self {
        let mut rows = Self::default();
        for line in page.lines().filter(|line| line.starts_with("| ")) {
            let cells: Vec<String> = line.split('|').map(|cell| cell.trim().to_owned()).collect();
            match &cells[1..cells.len() - 1] {
                [name, rest @ ..] if TARGETS.iter().any(|(_, target)| target == name) => {
                    rows.accounts.insert(name.clone(), rest.join(" | "));
                }
                [name, value, columns @ ..] => {
                    rows.kinds.insert((name.clone(), value.clone()), columns.to_vec());
                }
                _ => {}
            }
        }
        rows
    }
}

const HEAD: &str = "# Faults in real time

The cases of [faults](faults.md), played in real time. *pty*: the real daemon, on the simulated array at the far end of a
pseudo-terminal. *chip*: the host's streamer, on the firmware in an emulated chip. Both are judged as in virtual time: on the recorded
lines and the receipt, and the next play must be whole.

Each cell: how the plays ended; of those that were cut, milliseconds from the (last) fault to the last pulse, with the return of the
pins; the bursts that were not played. The worst of the patterns is shown. A dash: not run.

| target | date | commit | made by | remark |
|---|---|---|---|---|
";

const ROWS: &str = "
| fault | value | pty | chip |
|---|---|---|---|
";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::Seen;

    #[test]
    fn a_column_is_renewed_and_the_other_stays() {
        let cases = crate::cases();
        let kinds: Vec<Kind<'_>> = cases.iter().flat_map(Case::kinds).collect();
        let mut worst = Worst::default();
        worst.add(&Seen { is_done: false, safe_ms: Some(2.0), is_latched: false, lost: 1, planned: 10 });
        let cells = |cell: &Cell| kinds.iter().map(|kind| (row_of(kind), cell.clone())).collect();
        let account = Account { date: "2026-11-24", commit: "abc", command: "run", remark: "none" };
        let one = renewed("", Target::Pty, &account, &cells(&Cell::Worst(worst)), &cases);
        assert!(one.contains("| pty | 2026-11-24 | abc | `run` | none |\n| chip | – | – | – | – |\n"));
        assert!(one.contains("| host-dies | 50 ms | cut; 2.0; 10.0 % | – |\n"));
        let other = Account { commit: "def", ..account };
        let both = renewed(&one, Target::Chip, &other, &cells(&Cell::NotPossible("no host")), &cases);
        assert!(both.contains("| pty | 2026-11-24 | abc |") && both.contains("| chip | 2026-11-24 | def |"));
        assert!(both.contains("| host-dies | 50 ms | cut; 2.0; 10.0 % | not possible: no host |\n"));
    }
}
