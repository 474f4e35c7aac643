//! Joins the rows of all runs: a table, a page, and the best patterns.
//!
//! 1. [`Index::read`] finds where the row of each cell is. If two runs have computed a cell, both have the same row: the first
//!    counts.
//! 2. [`merge`] goes through the cells in order and gives each row to `table` (CSV and Parquet) and `summary`.
//! 3. `summary` makes the page, and names the best patterns, whose files are then written.
//!
//! Rows stream from the files of runs into the tables: memory holds 16 bytes per cell, a row group, and the data of the page.
//!
//! Invariant: the files depend only on the plan and the rows, not on the runs that have computed them.

mod index;
mod summary;
mod table;

pub(crate) use index::Index;

use crate::axis::Value;
use crate::command::{Column, Kind, columns};
use crate::directory::{Directory, SweepError, failed};
use crate::plan::{Cell, Plan};
use serde::Serialize;
use std::fs;
use std::io::Write;
use std::path::Path;
use summary::Summary;
use table::{Csv, Parquet};

/// The result of a merge.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Merged {
    /// Cells of the plan.
    pub cells: u64,
    /// Those with a row.
    pub done: u64,
    /// Those that failed.
    pub failed: u64,
    /// Those that no run has computed.
    pub missing: u64,
    /// Lines that could not be read.
    pub damaged: u64,
    /// The files, in the directory.
    pub files: Vec<String>,
}

/// A row of the table.
#[derive(Debug)]
pub(crate) struct Row<'a> {
    pub(crate) cell: &'a Cell,
    /// The command's results; none of a cell that failed.
    pub(crate) results: Vec<Option<Value>>,
    pub(crate) error: Option<String>,
}

/// `results.json`, which describes the tables.
#[derive(Debug, Serialize)]
struct About<'a> {
    format: u32,
    command: &'a str,
    plan_sha256: &'a str,
    program: &'a crate::plan::Program,
    models: &'a [String],
    #[serde(flatten)]
    merged: &'a Merged,
    columns: Vec<AboutColumn>,
}

#[derive(Debug, Serialize)]
struct AboutColumn {
    name: &'static str,
    kind: &'static str,
    about: &'static str,
}

/// Joins the rows computed so far.
///
/// # Errors
/// If files cannot be read or written.
pub fn merge(directory: &Directory, plan: &Plan) -> Result<Merged, SweepError> {
    let index = Index::read(directory, plan.cells())?;
    let mut summary = Summary::new(plan);
    let mut reader = index.reader();
    let mut failures = 0;
    let models: Vec<String> = plan.models().into_iter().map(str::to_owned).collect();
    let (csv, parquet) = ("results.csv", "results.parquet");
    let [csv_path, parquet_path] = [csv, parquet].map(|name| directory.path().join(name));
    directory.write(csv, |csv_file| {
        directory.write(parquet, |parquet_file| {
            let mut csv = Csv::new(plan, csv_file).map_err(failed(&csv_path, "written"))?;
            let facts = [
                ("meissner.command", plan.command().name().to_owned()),
                ("meissner.plan_sha256", directory.plan_sha256().to_owned()),
                ("meissner.version", plan.program().version.clone()),
                ("meissner.model_version", plan.program().model.to_string()),
                ("meissner.models", models.join(" ")),
            ];
            let mut parquet =
                Parquet::new(plan, parquet_file, facts).map_err(failed(&parquet_path, "written"))?;
            for number in 0..plan.cells() {
                let Some(line) = reader.line(number)? else { continue };
                let cell = plan.cell(number);
                failures += u64::from(line.error.is_some());
                let results = values(line.row, columns(plan.command()));
                let row = Row { cell: &cell, results, error: line.error };
                csv.write(&row).map_err(failed(&csv_path, "written"))?;
                parquet.write(&row).map_err(failed(&parquet_path, "written"))?;
                summary.take(&row);
            }
            csv.finish().map_err(failed(&csv_path, "written"))?;
            parquet.finish().map_err(failed(&parquet_path, "written"))
        })
    })?;
    let best = summary.best_cells();
    let mut files = vec![csv.to_owned(), parquet.to_owned()];
    if !best.is_empty() {
        let dir = directory.path().join("best");
        fs::create_dir_all(&dir).map_err(failed(&dir, "made"))?;
        remove_patterns(&dir)?;
        for &number in &best {
            let text = reader.line(number)?.and_then(|line| line.pattern).unwrap_or_default();
            let name = summary::file(plan, number);
            let path = directory.path().join(&name);
            directory
                .write(&name, |file| file.write_all(text.as_bytes()).map_err(failed(&path, "written")))?;
            files.push(name);
        }
    }
    let mut merged = Merged {
        cells: plan.cells(),
        done: index.done() - failures,
        failed: failures,
        missing: plan.cells() - index.done(),
        damaged: index.damaged(),
        files,
    };
    let (page, about) = ("page.html", "results.json");
    merged.files.extend([page.to_owned(), about.to_owned()]);
    let html = summary.page(directory, &merged, &models);
    let path = directory.path().join(page);
    directory.write(page, |file| file.write_all(html.as_bytes()).map_err(failed(&path, "written")))?;
    let document = About {
        format: 1,
        command: plan.command().name(),
        plan_sha256: directory.plan_sha256(),
        program: plan.program(),
        models: &models,
        merged: &merged,
        columns: table::all(plan.command())
            .map(|Column { name, kind, about }| AboutColumn {
                name,
                kind: match kind {
                    Kind::Number => "number",
                    Kind::Whole => "whole",
                    Kind::Flag => "flag",
                    Kind::Text => "text",
                },
                about,
            })
            .collect(),
    };
    let path = directory.path().join(about);
    directory.write(about, |file| {
        let written = serde_json::to_writer_pretty(&mut *file, &document).map_err(Into::into);
        written.and_then(|()| file.write_all(b"\n")).map_err(failed(&path, "written"))
    })?;
    Ok(merged)
}

/// The text of the pattern that a cell has found.
///
/// # Errors
/// If files cannot be read.
pub fn pattern(directory: &Directory, plan: &Plan, cell: u64) -> Result<Option<String>, SweepError> {
    let index = Index::read(directory, plan.cells())?;
    Ok(index.reader().line(cell)?.and_then(|line| line.pattern))
}

/// Removes the patterns of an earlier merge, which may no longer be the best.
fn remove_patterns(dir: &Path) -> Result<(), SweepError> {
    for entry in fs::read_dir(dir).map_err(failed(dir, "read"))? {
        let path = entry.map_err(failed(dir, "read"))?.path();
        if path.extension().is_some_and(|extension| extension == "toml") {
            fs::remove_file(&path).map_err(failed(&path, "removed"))?;
        }
    }
    Ok(())
}

/// The values of a row, by the types of its columns.
fn values(row: Option<Vec<serde_json::Value>>, columns: &[Column]) -> Vec<Option<Value>> {
    let mut row = row.unwrap_or_default().into_iter();
    let value = |column: &Column| {
        let value = row.next()?;
        match column.kind {
            Kind::Number => value.as_f64().map(Value::Number),
            Kind::Whole => value.as_i64().map(Value::Whole),
            Kind::Flag => value.as_bool().map(Value::Flag),
            Kind::Text => value.as_str().map(|text| Value::Text(text.to_owned())),
        }
    };
    columns.iter().map(value).collect()
}
