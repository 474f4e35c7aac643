//! The samples as a table.

use crate::{Counts, Done, Sample};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Writes it to a folder.
pub(crate) fn keep(out: &Path, samples: &[Sample], bounds: &[(f64, &str)]) -> Done {
    Ok(fs::write(out.join("soak.csv"), csv(samples, bounds))?)
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
