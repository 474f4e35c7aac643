//! Commands about stored patterns: list, show, import, remove.
//!
//! `import` checks the file before it sends it, so that errors name the file and line; the daemon checks again.

use super::arguments::ClientOptions;
use super::motions::Motions;
use super::output::give;
use super::pattern_file::{self, Found};
use super::text;
use anyhow::Result;
use meissner_api::{ImportedPattern, RemovedPattern};
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_client::escape;
use serde_json::Value;
use std::path::Path;
use std::process::ExitCode;

pub(super) fn list(options: &ClientOptions) -> Result<ExitCode> {
    let list: Value = options.client()?.get("/v1/patterns")?;
    let none = Vec::new();
    let row = |entry: &Value| {
        let duration =
            entry["duration_s"].as_f64().map_or_else(|| "endless".to_owned(), |s| format!("{s} s"));
        let from = if entry["library"] == true { "library" } else { "directory" };
        vec![
            entry["name"].as_str().unwrap_or_default().to_owned(),
            entry["array"].as_str().unwrap_or_default().to_owned(),
            duration,
            text::number(entry["compiled_ms"].as_f64(), 1),
            drives(entry),
            text::number(entry["highest_um"].as_f64(), 1),
            from.into(),
        ]
    };
    give(options.output.json, &list, || {
        let rows = list["patterns"].as_array().unwrap_or(&none).iter().map(row);
        let mut text = text::columns(
            &["name", "array", "length", "whole_strokes_ms", "drives", "highest_um", "from"],
            rows,
        );
        for line in list["errors"].as_array().unwrap_or(&none) {
            text += &format!("\nnot listed: {}", line.as_str().unwrap_or_default());
        }
        text
    })
}

/// The number of drives of a listed pattern, and how many of them give a stroke unless all do; and its motions, if it has any.
fn drives(entry: &Value) -> String {
    let [all, moving] = ["drives", "drives_moving"].map(|key| &entry[key]);
    let drives =
        if moving.is_null() || moving == all { all.to_string() } else { format!("{moving} of {all} move") };
    match entry["motions"].as_u64() {
        None | Some(0) => drives,
        Some(motions) => format!("{drives} + {motions} motions"),
    }
}

pub(super) fn show(options: &ClientOptions, name: &str) -> Result<ExitCode> {
    options.learn_array()?;
    let shown: Value = options.client()?.get(&format!("/v1/patterns/{}", escape(name)))?;
    let array = shown["pattern"]["array"].as_str().unwrap_or(Array::paper().spec().name());
    let motions = motions(&shown["pattern"])?;
    give(options.output.json, &shown, || {
        let shown = text::pattern(&shown, array);
        motions.map_or_else(|| shown.clone(), |motions| format!("{shown}\n\n{}", text::motions(&motions)))
    })
}

/// What the motors do with the motions of a pattern from the daemon; none without motions. Its array must be known.
fn motions(pattern: &Value) -> Result<Option<Motions>> {
    if !["wave", "ramp", "tone", "noise"].iter().any(|table| pattern.get(table).is_some()) {
        return Ok(None);
    }
    let name = pattern["name"].as_str().unwrap_or_default();
    let pattern = Pattern::from_keys(pattern["format"].as_i64().unwrap_or_default(), pattern.clone(), name)?;
    Motions::of(&pattern, 1.0)
}

pub(super) fn import(options: &ClientOptions, file: &Path, replace: bool) -> Result<ExitCode> {
    options.learn_array()?;
    let Found { pattern, text, was_packed } = pattern_file::of_file(file)?;
    let query = if replace { "?replace=true" } else { "" };
    let imported: ImportedPattern =
        options.client()?.put(&format!("/v1/patterns/{}{query}", escape(pattern.name())), text)?;
    give(options.output.json, &imported, || {
        let packed = if was_packed { ", packed with its sample files" } else { "" };
        let mut text = format!("imported {}{packed} (sha256 {})", imported.name, imported.sha256);
        if let Some(replaced) = &imported.replaced_sha256 {
            text += &format!("\nreplaced the one with sha256 {replaced}");
        }
        for warning in &imported.warnings {
            text += &format!("\nwarning: {warning}");
        }
        text
    })
}

pub(super) fn remove(options: &ClientOptions, name: &str) -> Result<ExitCode> {
    let removed: RemovedPattern = options.client()?.delete(&format!("/v1/patterns/{}", escape(name)))?;
    give(options.output.json, &removed, || format!("removed {} (sha256 {})", removed.name, removed.sha256))
}
