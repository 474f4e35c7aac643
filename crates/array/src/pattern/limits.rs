//! The version of the pattern format, and the ranges of its values.

use meissner_input::document::Size;
use std::ops::RangeInclusive;

/// The version of the file format.
pub const FORMAT: u8 = 1;
/// The most drives of one pattern: 64 one after the other on each of 64 motors.
pub const MAX_DRIVES: usize = 4096;
/// The most motions of one pattern.
pub const MAX_MOTIONS: usize = 4096;
/// The most motions of one motor at once.
pub const MAX_AT_ONCE: usize = 16;
/// The most samples of one pattern, those that tones and noise are made of included: 24 motors for 11 minutes at 1 kHz, 64 MiB.
pub const MAX_PATTERN_SAMPLES: usize = 16 << 20;
/// The most bytes that tell what a wave was made from.
pub const MAX_SOURCE: usize = 512;
/// The longest time for which a pin may stay at one height, s. The device allows 60; moves begin on a grid.
pub const MAX_HOLD_S: f64 = 59.0;
/// The most bytes of a pattern file without packed samples; [`MAX_DRIVES`] written out take less.
pub const MAX_FILE_BYTES: usize = 1 << 20;
/// The most bytes of a pattern file with packed samples: four bytes of text for three of samples.
pub const MAX_PACKED_BYTES: usize = MAX_FILE_BYTES + MAX_PATTERN_SAMPLES / 3 * 16 + 4 * MAX_MOTIONS;
/// The most bytes of a file that a wave names.
pub const MAX_SAMPLE_FILE_BYTES: usize = crate::samples::MAX_FILE_BYTES;
/// Most keys and list items of a provenance; `meissner optimise` writes at most 12 000.
pub const MAX_PROVENANCE_VALUES: usize = 1 << 14;
/// Most tables of a provenance.
pub const MAX_PROVENANCE_TABLES: usize = 1 << 11;
/// Most bytes of a provenance's keys and strings.
pub const MAX_PROVENANCE_TEXT: usize = 1 << 17;
/// Largest nesting depth of tables and lists in a provenance. JSON readers stop at 128.
pub const MAX_PROVENANCE_DEPTH: usize = 16;
/// The most that is read of a pattern file: [`MAX_DRIVES`] with every key, a full provenance, and comments.
pub(super) const MAX_SIZE: Size =
    Size { tokens: 1 << 19, tables: 2 * MAX_DRIVES, values: 6 * MAX_DRIVES + MAX_PROVENANCE_VALUES + 4 };
/// As [`MAX_SIZE`], of a file with motions: each may have an envelope, and lists of samples fill the file.
pub(super) const MAX_SIZE_OF_MOTIONS: Size =
    Size { tokens: 1 << 20, tables: MAX_SIZE.tables + 2 * MAX_MOTIONS, values: 1 << 18 };
/// The latest time in a pattern, s: three years, far below where `f64` seconds no longer distinguish ticks.
pub const MAX_SECONDS: f64 = 1e8;
/// Frequencies of a drive, Hz: the paper's motors vibrate up to 300 Hz. The controller takes no more than 1 000 strokes a second.
pub const FREQUENCY_HZ: RangeInclusive<f64> = 0.1..=300.0;
