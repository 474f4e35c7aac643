//! Reading a pattern file: TOML with every key known and every mistake at its line.
//!
//! The tables are walked by hand because the errors of a derived reader span several lines and do not count
//! drives. Ranges are not checked here but by [`Pattern`]'s own check, which serves built patterns too.
//!
//! Invariant: no key is ignored; an unknown one is refused with the nearest known one.

use super::error::Fault;
use super::{Drive, FORMAT, MAX_DRIVES, MAX_FILE_BYTES, Pattern, PatternError, Problem};
use firmware_protocol::stroke::MOTORS;
use meissner_input::message;
use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue, ValueDeserializer};

const PATTERN_KEYS: [&str; 5] = ["format", "name", "duration_s", "drive", "provenance"];
const DRIVE_KEYS: [&str; 6] = ["motor", "frequency_hz", "amplitude_um", "phase", "start_s", "stop_s"];

pub(super) fn parse(text: &str, file: &str) -> Result<Pattern, PatternError> {
    if text.len() > MAX_FILE_BYTES {
        return Err(Fault::offset(0, Problem::TooLarge { bytes: text.len() }).at(file, None));
    }
    let line = |offset: usize| 1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count();
    let root = DeTable::parse(text).map_err(|syntax| {
        let message = syntax.message().lines().collect::<Vec<_>>().join("; ");
        Fault::offset(0, Problem::Syntax { message }).at(file, syntax.span().map(|span| line(span.start)))
    })?;
    let root = Table { table: root.get_ref(), start: 0 };
    let pattern = read(&root);
    pattern.and_then(|pattern| pattern.check().map(|()| pattern)).map_err(|fault| {
        let offset = fault.offset.or_else(|| root.offset_of(&fault));
        fault.at(file, offset.map(line))
    })
}

fn read(root: &Table<'_>) -> Result<Pattern, Fault> {
    // The format comes first: another one may have other keys.
    let format = root.required("format", Table::integer, "format = 1")?;
    if format != i64::from(FORMAT) {
        return Err(Fault::key("format", Problem::Format { found: format }));
    }
    root.only(&PATTERN_KEYS)?;
    let mut drives = Vec::new();
    for (index, value) in root.drives()?.iter().enumerate() {
        let DeValue::Table(table) = value.get_ref() else {
            return Err(root.mistyped("drive", value, "tables headed [[drive]]"));
        };
        let table = Table { table, start: value.span().start };
        drives.push(read_drive(&table).map_err(|fault| fault.in_drive(index))?);
    }
    Ok(Pattern {
        format: FORMAT,
        name: root.required("name", Table::string, "name = \"...\", as the file is called")?,
        duration_s: root.number("duration_s")?,
        drives,
        provenance: root.provenance()?,
    })
}

fn read_drive(table: &Table<'_>) -> Result<Drive, Fault> {
    table.only(&DRIVE_KEYS)?;
    let motor = table.required("motor", Table::integer, "the motor's number, 0 to 23")?;
    #[expect(clippy::cast_precision_loss, reason = "only shown")]
    let out_of_range = Problem::Range { key: "motor", found: motor as f64, range: "0 to 23" };
    Ok(Drive {
        motor: u8::try_from(motor)
            .ok()
            .filter(|&motor| usize::from(motor) < MOTORS)
            .ok_or(Fault::key("motor", out_of_range))?,
        frequency_hz: table.required("frequency_hz", Table::number, "a frequency, 0.1 to 300 Hz")?,
        amplitude_um: table.required(
            "amplitude_um",
            Table::number,
            "an amplitude, 0 to 400 um peak to peak",
        )?,
        phase: table.number("phase")?.unwrap_or(0.0),
        start_s: table.number("start_s")?,
        stop_s: table.number("stop_s")?,
    })
}

/// A table of the file, and where it begins.
struct Table<'t> {
    table: &'t DeTable<'t>,
    start: usize,
}

impl<'t> Table<'t> {
    fn only(&self, known: &[&'static str]) -> Result<(), Fault> {
        // The map is sorted by key; the first mistake is the first in the file.
        let unknown = self.table.keys().filter(|key| !known.contains(&key.get_ref().as_ref()));
        let Some(key) = unknown.min_by_key(|key| key.span().start) else { return Ok(()) };
        let nearest = message::nearest(known, key.get_ref());
        let problem = Problem::UnknownKey { key: message::quote(key.get_ref()), nearest };
        Err(Fault::offset(key.span().start, problem))
    }

    fn required<T>(
        &self,
        key: &'static str,
        read: impl Fn(&Self, &'static str) -> Result<Option<T>, Fault>,
        wanted: &'static str,
    ) -> Result<T, Fault> {
        read(self, key)?.ok_or_else(|| Fault::offset(self.start, Problem::Missing { key, wanted }))
    }

    fn mistyped(&self, key: &'static str, value: &Spanned<DeValue<'_>>, wanted: &'static str) -> Fault {
        Fault::offset(value.span().start, Problem::Type { key, found: value.get_ref().type_str(), wanted })
    }

    fn integer(&self, key: &'static str) -> Result<Option<i64>, Fault> {
        let Some(value) = self.table.get(key) else { return Ok(None) };
        let integer = value.get_ref().as_integer();
        let integer = integer.and_then(|found| i64::from_str_radix(found.as_str(), found.radix()).ok());
        integer.map(Some).ok_or_else(|| self.mistyped(key, value, "a whole number"))
    }

    #[expect(clippy::cast_precision_loss, reason = "no range reaches to where it is lost")]
    fn number(&self, key: &'static str) -> Result<Option<f64>, Fault> {
        let Some(value) = self.table.get(key) else { return Ok(None) };
        if value.get_ref().is_integer() {
            return Ok(self.integer(key)?.map(|found| found as f64));
        }
        let number = value.get_ref().as_float().and_then(|found| found.as_str().parse().ok());
        number.map(Some).ok_or_else(|| self.mistyped(key, value, "a number"))
    }

    fn string(&self, key: &'static str) -> Result<Option<String>, Fault> {
        let Some(value) = self.table.get(key) else { return Ok(None) };
        let string = value.get_ref().as_str().map(str::to_owned);
        string.map(Some).ok_or_else(|| self.mistyped(key, value, "a string"))
    }

    fn drives(&self) -> Result<&'t [Spanned<DeValue<'t>>], Fault> {
        let Some(value) = self.table.get("drive") else { return Ok(&[]) };
        let drives = value.get_ref().as_array().map(|array| &array[..]);
        let drives = drives.ok_or_else(|| self.mistyped("drive", value, "tables headed [[drive]]"))?;
        if drives.len() > MAX_DRIVES {
            return Err(Fault::key("drive", Problem::TooManyDrives { count: drives.len() }));
        }
        Ok(drives)
    }

    fn provenance(&self) -> Result<toml::Table, Fault> {
        let Some(value) = self.table.get("provenance") else { return Ok(toml::Table::new()) };
        toml::Table::deserialize(ValueDeserializer::from(value.clone())).map_err(|_| {
            self.mistyped("provenance", value, "a table headed [provenance], of what 64 bits hold")
        })
    }

    /// Where a fault's key, or else its drive, stands.
    fn offset_of(&self, fault: &Fault) -> Option<usize> {
        let Some(index) = fault.drive else { return self.key_offset(fault.key?) };
        let drive = self.drives().ok()?.get(index)?;
        let table = Table { table: drive.get_ref().as_table()?, start: drive.span().start };
        fault.key.and_then(|key| table.key_offset(key)).or(Some(table.start))
    }

    fn key_offset(&self, key: &str) -> Option<usize> {
        self.table.get_key_value(key).map(|(key, _)| key.span().start)
    }
}
