//! The samples as a table and as a drawing.

use crate::{Counts, Done, Sample};
use plotters::prelude::*;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

type Figure = fn(&Sample) -> f64;

/// Writes both to a folder.
pub(crate) fn keep(out: &Path, samples: &[Sample], bounds: &[(f64, &str)]) -> Done {
    fs::write(out.join("soak.csv"), csv(samples, bounds))?;
    draw(&out.join("soak.svg"), samples, bounds)
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

/// Draws the samples, one figure above the other; a line where each phase begins.
fn draw(path: &Path, samples: &[Sample], bounds: &[(f64, &str)]) -> Done {
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
    let whole = SVGBackend::new(path, (960, 170 * figures.len() as u32)).into_drawing_area();
    whole.fill(&WHITE)?;
    for ((name, of), area) in figures.iter().zip(whole.split_evenly((figures.len(), 1))) {
        let values = || samples.iter().map(of);
        let (low, high) =
            values().fold((0.0, 1.0), |(low, high): (f64, f64), value| (low.min(value), high.max(value)));
        let mut chart = ChartBuilder::on(&area)
            .caption(name, ("sans-serif", 14))
            .margin(8)
            .x_label_area_size(32)
            .y_label_area_size(50)
            .build_cartesian_2d(0.0..end, low * 1.1..high * 1.1)?;
        chart.configure_mesh().x_desc("minutes").max_light_lines(0).x_labels(13).y_labels(4).draw()?;
        for (at, load) in bounds {
            chart.draw_series([PathElement::new(
                [(*at, low * 1.1), (*at, high * 1.1)],
                RGBColor(200, 200, 200),
            )])?;
            let text = Text::new((*load).to_owned(), (*at, high * 1.08), ("sans-serif", 9).into_font());
            chart.draw_series([text])?;
        }
        chart.draw_series(LineSeries::new(samples.iter().map(|sample| (sample.minute, of(sample))), BLUE))?;
    }
    Ok(whole.present()?)
}
