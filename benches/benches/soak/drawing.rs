//! The samples as a table and as a drawing.

use crate::{Counts, Done, Sample};
use meissner_report::chart::{Axis, Chart, Dot, Point, Scale, Series, stacked};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

type Figure = fn(&Sample) -> f64;

/// The height of a figure, px.
const HEIGHT: u16 = 220;

/// Writes both to a folder.
pub(crate) fn keep(out: &Path, samples: &[Sample], bounds: &[(f64, &str)]) -> Done {
    fs::write(out.join("soak.csv"), csv(samples, bounds))?;
    Ok(fs::write(out.join("soak.svg"), drawn(samples, bounds))?)
}

fn csv(samples: &[Sample], bounds: &[(f64, &str)]) -> String {
    let mut text = "minute,load,plays,bursts_planned,bursts_late,bursts_lost,plays_broken,estops,memory_mb,descriptors,threads,\
                    processor_s,stall_ms,clock_error_us,clock_allowed_us\n"
        .to_owned();
    for sample in samples {
        let load = bounds.iter().rev().find(|(from, _)| *from <= sample.minute).map_or("", |(_, name)| name);
        let Counts {
            plays, planned, late, lost, broken, estops, clock_error_us, allowed_us, stall_ms, ..
        } = sample.counts;
        let _ = writeln!(
            text,
            "{:.2},{load},{plays},{planned},{late},{lost},{broken},{estops},{:.1},{},{},{:.2},{stall_ms:.1},{clock_error_us:.1},{allowed_us:.1}",
            sample.minute, sample.memory_mb, sample.descriptors, sample.threads, sample.processor_s
        );
    }
    text
}

/// Draws the samples, one figure above the other; a ring where each phase begins.
fn drawn(samples: &[Sample], bounds: &[(f64, &str)]) -> String {
    let figures: [(&str, Figure); 6] = [
        ("longest stall of the machine in this phase so far, ms", |sample| sample.counts.stall_ms),
        ("bursts late or lost, of all plays so far", |sample| {
            (sample.counts.late + sample.counts.lost) as f64
        }),
        ("memory of the daemon, MB", |sample| sample.memory_mb),
        ("descriptors of the daemon", |sample| sample.descriptors as f64),
        ("error of the clock model at the last onset, µs", |sample| sample.counts.clock_error_us),
        ("error that the receipt allows for, µs", |sample| sample.counts.allowed_us),
    ];
    let end = samples.last().map_or(1.0, |sample| sample.minute);
    let charts = figures.map(|(name, of)| {
        let values = || samples.iter().map(of);
        let (low, high) =
            values().fold((0.0, 1.0), |(low, high): (f64, f64), value| (low.min(value), high.max(value)));
        let phases = Series {
            points: bounds.iter().map(|&(x, _)| Point { x, y: high * 1.1, sd: 0.0 }).collect(),
            labels: bounds.iter().map(|(_, load)| (*load).to_owned()).collect(),
            dot: Dot::Ring,
            ..Series::line("phase", Vec::new())
        };
        let measured = samples.iter().map(|sample| (sample.minute, of(sample))).collect();
        Chart {
            title: Some(name),
            x: Axis { name: "minutes", scale: Scale::linear(0.0, end) },
            y: Axis { name: "", scale: Scale::linear(low * 1.1, high * 1.1) },
            series: vec![phases, Series::line("measured", measured)],
        }
    });
    stacked(&charts, HEIGHT)
}
