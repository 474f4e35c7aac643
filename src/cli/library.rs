//! Commands about patterns and motors: list, show, import, motor.
//!
//! `import` checks the file itself first, so that a mistake is named by file and line; the daemon checks again.
//! `motor` asks no daemon.
//!
//! Invariant: a file that is too large or not a file is not read into memory.

use super::{Plain, give, say, say_json, text};
use crate::api::Imported;
use crate::client::escape;
use crate::config;
use crate::motor::SteadyState;
use crate::pattern::{MAX_FILE_BYTES, Pattern};
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::ExitCode;

pub(super) fn list(plain: &Plain) -> Result<ExitCode> {
    let list: Value = plain.client()?.get("/v1/patterns")?;
    if plain.output.json {
        say_json(&list)?;
        return Ok(ExitCode::SUCCESS);
    }
    let none = Vec::new();
    let row = |entry: &Value| {
        let duration =
            entry["duration_s"].as_f64().map_or_else(|| "endless".to_owned(), |s| format!("{s} s"));
        let from = if entry["library"] == true { "library" } else { "directory" };
        vec![
            entry["name"].as_str().unwrap_or_default().to_owned(),
            duration,
            entry["drives"].to_string(),
            from.into(),
        ]
    };
    let rows = list["patterns"].as_array().unwrap_or(&none).iter().map(row);
    say(&text::columns(&["name", "length", "drives", "from"], rows))?;
    for line in list["errors"].as_array().unwrap_or(&none) {
        say(&format!("not listed: {}", line.as_str().unwrap_or_default()))?;
    }
    Ok(ExitCode::SUCCESS)
}

pub(super) fn show(plain: &Plain, name: &str) -> Result<ExitCode> {
    let shown: Value = plain.client()?.get(&format!("/v1/patterns/{}", escape(name)))?;
    give(plain.output.json, &shown, || text::pattern(&shown))?;
    Ok(ExitCode::SUCCESS)
}

/// Reads a pattern file: the pattern, and its text.
pub(super) fn read(file: &Path) -> Result<(Pattern, String)> {
    let place = file.display();
    let found = fs::metadata(file).with_context(|| format!("{place}: cannot be read; name a pattern file"));
    let found = found.map_err(flat)?;
    if !found.is_file() {
        bail!("{place}: is not a regular file: name a pattern file");
    }
    if found.len() > MAX_FILE_BYTES as u64 {
        bail!("{place}: {} bytes are too many: a pattern file has at most {MAX_FILE_BYTES}", found.len());
    }
    let text = config::read_regular(file, MAX_FILE_BYTES as u64)
        .with_context(|| format!("{place}: cannot be read; see that you may"));
    let Ok(text) = String::from_utf8(text.map_err(flat)?) else {
        bail!("{place}: not UTF-8 text: write patterns as TOML in UTF-8");
    };
    Ok((Pattern::parse(&text, &place.to_string())?, text))
}

pub(super) fn import(plain: &Plain, file: &Path) -> Result<ExitCode> {
    let (pattern, text) = read(file)?;
    let imported: Imported =
        plain.client()?.put(&format!("/v1/patterns/{}", escape(pattern.name())), text)?;
    if plain.output.json {
        say_json(&imported)?;
        return Ok(ExitCode::SUCCESS);
    }
    say(&format!("imported {} (sha256 {})", imported.name, imported.sha256))?;
    for warning in imported.warnings {
        say(&format!("warning: {warning}"))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// An error and its cause on one line.
fn flat(error: anyhow::Error) -> anyhow::Error {
    anyhow::anyhow!("{error} ({})", error.root_cause())
}

pub(super) fn motor(frequency_hz: f64, amplitude_um: f64, json: bool) -> Result<ExitCode> {
    let steady = SteadyState::of(frequency_hz, amplitude_um)?;
    if json {
        say_json(&steady)?;
        return Ok(ExitCode::SUCCESS);
    }
    let saturated = if steady.saturated { ", saturated: the frequency leaves room for no more" } else { "" };
    say(&text::pairs(&[
        ("peak to peak", format!("{:.2} um (ideal)", steady.peak_to_peak_um)),
        ("as played", format!("{:.2} um", steady.played_peak_to_peak_um)),
        ("pulses", format!("{} each way{saturated}", steady.pulses)),
    ]))?;
    Ok(ExitCode::SUCCESS)
}
