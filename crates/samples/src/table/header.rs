//! The rows of a header that describe the columns: their names and units.

use super::Table;
use super::units::{LengthUnit, Said, Unit, is_alone};

/// Rows of names and units that are looked at.
const ROWS: usize = 4;

/// The words of a name, in lower case and without numbers at their ends.
#[must_use]
pub fn words(name: &str) -> Vec<String> {
    let lower = name.to_lowercase();
    let words = lower.split(|c: char| !c.is_alphanumeric());
    words
        .map(|word| word.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned())
        .filter(|word| !word.is_empty())
        .collect()
}

/// The rows of names and of units above a table's numbers. Either may be missing.
#[derive(Clone, Copy, Debug)]
pub struct Header<'t> {
    table: &'t Table<'t>,
    names: &'t [String],
    units: &'t [String],
}

impl<'t> Header<'t> {
    /// Finds the rows. `is_names` tells a row of names from others; without one, the lowest row that is not one of units has the names.
    #[must_use]
    pub fn of(table: &'t Table<'t>, is_names: impl Fn(&[String]) -> bool) -> Self {
        let rows: Vec<&[String]> = table.names().take(ROWS).collect();
        let is_units = |row: &&&[String]| {
            let mut filled = row.iter().filter(|cell| !cell.is_empty() && *cell != "-").peekable();
            filled.peek().is_some() && filled.all(|cell| is_alone(cell))
        };
        let units = rows.iter().find(is_units).copied().unwrap_or_default();
        let mut names = rows.iter().filter(|row| !is_units(row));
        let names = names.clone().find(|row| is_names(row)).or_else(|| names.next());
        Self { table, names: names.copied().unwrap_or_default(), units }
    }

    /// The names of the columns; the units, if no other row has names.
    #[must_use]
    pub const fn names(&self) -> &'t [String] {
        if self.names.is_empty() { self.units } else { self.names }
    }

    /// The name of a column: empty if it has none.
    #[must_use]
    pub fn name(&self, column: usize) -> &'t str {
        self.names.get(column).map_or("", String::as_str)
    }

    /// What the header says of a column's unit; `axis` are the words of a line that states it.
    #[must_use]
    pub fn unit<U: Unit>(&self, column: usize, axis: &[&str]) -> Said<U> {
        let by = |row: &[String]| row.get(column).map_or(Said::Nothing, |cell| Said::by(cell));
        match (by(self.units), by(self.names)) {
            (Said::Unit(one), Said::Unit(other)) if one != other => {
                Said::Other(format!("{} and {}", self.units[column], self.names[column]))
            }
            (Said::Nothing, Said::Nothing) => self.stated(axis),
            (Said::Nothing, said) | (said, _) => said,
        }
    }

    /// What the header says of the unit of a displacement.
    #[must_use]
    pub fn length(&self, column: usize) -> Said<LengthUnit> {
        // The empty word: a unit of nothing in particular is the displacement's.
        self.unit(column, &["", "y", "vertical", "displacement", "position", "distance", "weg"])
    }

    /// What a line such as `Vertical Units,V` or `Unit: mm` says.
    fn stated<U: Unit>(&self, axis: &[&str]) -> Said<U> {
        const UNIT: [&str; 4] = ["unit", "units", "einheit", "einheiten"];
        let mut found = Said::Nothing;
        for row in self.table.header() {
            let joined =
                row.iter().filter(|cell| !cell.is_empty()).map(String::as_str).collect::<Vec<_>>().join(":");
            let Some((key, value)) = joined.split_once([':', '=']) else { continue };
            let words = words(key);
            let is_of = |known: &[&str]| words.iter().any(|word| known.contains(&word.as_str()));
            let is_axis = is_of(axis) || words.len() == 1 && axis.contains(&"");
            if !is_of(&UNIT) || !is_axis {
                continue;
            }
            let value = value.trim_matches([' ', '[', ']', '(', ')', '"', ':']);
            let said =
                U::named(&value.to_lowercase()).map_or_else(|| Said::Other(value.to_owned()), Said::Unit);
            found =
                if found == Said::Nothing || found == said { said } else { Said::Other(value.to_owned()) };
        }
        found
    }
}
