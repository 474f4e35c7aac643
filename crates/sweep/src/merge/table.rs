//! The table of a sweep, as CSV and as Parquet: cell, axes, results, error.
//!
//! Invariant: both have the same columns and rows, and no byte depends on time or machine.

use super::Row;
use crate::axis::{Axis, Command, Domain, Value};
use crate::command::{Column, Kind, columns};
use crate::plan::Plan;
use parquet::basic::{Compression, ConvertedType, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;
use std::io::{self, Write};
use std::sync::Arc;

/// Rows of a group, which Parquet keeps in memory.
const GROUP: usize = 50_000;

/// The columns of the table.
pub(super) fn all(command: Command) -> impl Iterator<Item = Column> {
    let cell = Column { name: "cell", kind: Kind::Whole, about: "number of the cell in the plan" };
    let axes = Axis::of(command).map(move |axis| {
        let kind = match axis.domain(command) {
            Domain::Document(_) | Domain::Choice(_) => Kind::Text,
            Domain::Number(_) => Kind::Number,
            Domain::Whole(_) => Kind::Whole,
            Domain::Flag => Kind::Flag,
        };
        Column { name: axis.name(), kind, about: axis.about(command) }
    });
    let error = Column { name: "error", kind: Kind::Text, about: "why the cell has no results" };
    [cell].into_iter().chain(axes).chain(columns(command).iter().copied()).chain([error])
}

/// The values of a row in the columns of the table.
fn values(plan: &Plan, row: &Row<'_>) -> Vec<Option<Value>> {
    let cell = Value::Whole(i64::try_from(row.cell.number).unwrap_or(i64::MAX));
    let axes = Axis::of(plan.command()).map(|axis| Some(plan.shown(row.cell, axis)));
    let error = row.error.clone().map(Value::Text);
    [Some(cell)].into_iter().chain(axes).chain(row.results.iter().cloned()).chain([error]).collect()
}

/// The underlying error of the file, if there is one.
fn of_file(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(source) => match source.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(other) => io::Error::other(other),
        },
        other => io::Error::other(other),
    }
}

/// The table as CSV.
pub(super) struct Csv<'a, W: Write> {
    plan: &'a Plan,
    writer: csv::Writer<W>,
}

impl<'a, W: Write> Csv<'a, W> {
    pub(super) fn new(plan: &'a Plan, file: W) -> io::Result<Self> {
        let mut writer = csv::Writer::from_writer(file);
        writer.write_record(all(plan.command()).map(|column| column.name))?;
        Ok(Self { plan, writer })
    }

    pub(super) fn write(&mut self, row: &Row<'_>) -> io::Result<()> {
        let values = values(self.plan, row);
        let text = |value: &Option<Value>| value.as_ref().map_or_else(String::new, ToString::to_string);
        Ok(self.writer.write_record(values.iter().map(text))?)
    }

    pub(super) fn finish(mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

/// The table as Parquet.
pub(super) struct Parquet<'a, W: Write + Send> {
    plan: &'a Plan,
    writer: SerializedFileWriter<W>,
    /// The rows of the group that is not written yet, column by column.
    group: Vec<Vec<Option<Value>>>,
}

impl<'a, W: Write + Send> Parquet<'a, W> {
    pub(super) fn new<const N: usize>(
        plan: &'a Plan,
        file: W,
        facts: [(&str, String); N],
    ) -> io::Result<Self> {
        let fields: Result<Vec<_>, ParquetError> =
            all(plan.command()).map(|column| field(&column).map(Arc::new)).collect();
        let schema = Type::group_type_builder("sweep").with_fields(fields.map_err(of_file)?).build();
        let facts = facts.map(|(key, fact)| KeyValue::new(key.to_owned(), fact)).to_vec();
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(facts))
            .build();
        let writer =
            SerializedFileWriter::new(file, Arc::new(schema.map_err(of_file)?), Arc::new(properties));
        let group = all(plan.command()).map(|_| Vec::new()).collect();
        Ok(Self { plan, writer: writer.map_err(of_file)?, group })
    }

    pub(super) fn write(&mut self, row: &Row<'_>) -> io::Result<()> {
        for (column, value) in self.group.iter_mut().zip(values(self.plan, row)) {
            column.push(value);
        }
        if self.group[0].len() == GROUP { self.write_group().map_err(of_file) } else { Ok(()) }
    }

    pub(super) fn finish(mut self) -> io::Result<()> {
        if !self.group[0].is_empty() {
            self.write_group().map_err(of_file)?;
        }
        self.writer.close().map(drop).map_err(of_file)
    }

    fn write_group(&mut self) -> Result<(), ParquetError> {
        let mut rows = self.writer.next_row_group()?;
        for (column, values) in all(self.plan.command()).zip(&mut self.group) {
            match column.kind {
                Kind::Number => write::<DoubleType, _>(&mut rows, values, |value| match value {
                    Value::Number(number) => Some(number),
                    _ => None,
                })?,
                Kind::Whole => write::<Int64Type, _>(&mut rows, values, |value| match value {
                    Value::Whole(number) => Some(number),
                    _ => None,
                })?,
                Kind::Flag => write::<BoolType, _>(&mut rows, values, |value| match value {
                    Value::Flag(flag) => Some(flag),
                    _ => None,
                })?,
                Kind::Text => write::<ByteArrayType, _>(&mut rows, values, |value| match value {
                    Value::Text(text) => Some(ByteArray::from(text.into_bytes())),
                    _ => None,
                })?,
            }
        }
        rows.close().map(drop)
    }
}

/// Writes the next column of a group, and empties it.
fn write<T: DataType, W: Write + Send>(
    rows: &mut SerializedRowGroupWriter<'_, W>,
    values: &mut Vec<Option<Value>>,
    of: impl Fn(Value) -> Option<T::T>,
) -> Result<(), ParquetError> {
    let values: Vec<Option<T::T>> = values.drain(..).map(|value| value.and_then(&of)).collect();
    let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let values: Vec<T::T> = values.into_iter().flatten().collect();
    let mut column = rows
        .next_column()?
        .ok_or_else(|| ParquetError::General("the schema has fewer columns than the table".to_owned()))?;
    column.typed::<T>().write_batch(&values, Some(&levels), None)?;
    column.close()
}

fn field(column: &Column) -> Result<Type, ParquetError> {
    let physical = match column.kind {
        Kind::Number => Physical::DOUBLE,
        Kind::Whole => Physical::INT64,
        Kind::Flag => Physical::BOOLEAN,
        Kind::Text => Physical::BYTE_ARRAY,
    };
    let builder = Type::primitive_type_builder(column.name, physical).with_repetition(Repetition::OPTIONAL);
    match column.kind {
        Kind::Text => builder
            .with_logical_type(Some(LogicalType::String))
            .with_converted_type(ConvertedType::UTF8)
            .build(),
        _ => builder.build(),
    }
}
