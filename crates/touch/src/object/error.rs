//! Limits of object files, and their errors: one line that says what is wrong, where, and what to do.
//!
//! Invariant: the text of an [`ObjectError`] has no line break.

use crate::touch::TouchError;
use meissner_array::samples::SamplesError;
use meissner_input::document;

/// The largest object file, bytes.
pub const MAX_FILE_BYTES: usize = 256 << 10;
/// The most points of a polygon, dots, or dots of a Braille text.
pub const MAX_POINTS: usize = 4096;
/// The most columns and rows of a height map.
pub const MAX_PIXELS: usize = 4096;
/// The largest length and width of a height map, mm.
pub const MAX_SIDE_MM: f64 = 100.0;

/// The error of a refused object.
pub type ObjectError = document::DocumentError<Problem>;

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: an object file has at most {MAX_FILE_BYTES}")]
    TooLarge { bytes: usize },
    #[error("is {found}: must be \"object\"")]
    Kind { found: String },
    #[error("is {found}: must be 1 to 64 of a-z, 0-9 and -")]
    Name { found: String },
    #[error("is a key of shape = {of}, and this is a {shape}: leave it out, or change `shape`")]
    Foreign { of: String, shape: &'static str },
    #[error("is a list of {count}: must be {wanted}")]
    Count { count: usize, wanted: &'static str },
    #[error("has {count} points in all: must be {wanted}")]
    Points { count: usize, wanted: &'static str },
    #[error("is a profile, an array of one column: take shape = \"texture\", or save rows and columns")]
    Profile,
    #[error(
        "holds {found}: must be letters a to z, six-dot Braille characters, U+2800 to U+283F, and spaces"
    )]
    Character { found: String },
    #[error("is {found}: must be one character; write a word as text = \"...\"")]
    OneCharacter { found: String },
    #[error("is there beside `text`: leave one out")]
    TwoTexts,
    #[error("is {shape}, in which a search finds no line: draw it as {wanted}")]
    NotDrawn { shape: &'static str, wanted: String },
    #[error("has no dot: the object never touches; write a letter")]
    NoDots,
    #[error("needs one of press, scan and path: it has {count}")]
    Touches { count: usize },
    #[error("needs duration_s or distance_mm, one of them")]
    ScanEnd,
    #[error("needs file or poses, one of them")]
    PathSource,
    #[error("{0}")]
    Touch(Box<TouchError>),
    #[error("is not readable: {message}")]
    File { message: String },
    #[error(transparent)]
    Samples(#[from] SamplesError),
    #[error("is of another kind: the name must end in .png or .npy")]
    ImageKind,
    #[error("is not a PNG file: {message}")]
    Png { message: String },
    #[error(
        "holds {found}: save it in grey with 8 or 16 bits, as by `magick in.png -alpha off -colorspace Gray out.png`"
    )]
    Colour { found: &'static str },
    #[error("has {bits} bits of grey: save it with 8 or 16 bits")]
    Depth { bits: u8 },
    #[error("has {columns} × {rows} pixels: must be 1 to {MAX_PIXELS} each")]
    Pixels { columns: usize, rows: usize },
    #[error("has no number at column {column} of row {row}: NaN and infinity are no heights")]
    Pixel { column: usize, row: usize },
    #[error("is missing: add um_per_level, the height of a step of grey, um")]
    NoScale,
    #[error(
        "is too large: the map has {width_mm:.1} × {length_mm:.1} mm, and may have {MAX_SIDE_MM} mm each"
    )]
    Side { width_mm: f64, length_mm: f64 },
}

/// A problem whose place is not yet known.
pub(super) type KeyError = document::KeyError<Problem>;
