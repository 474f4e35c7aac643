//! Reads height maps from the bytes of PNG and NPY files.
//!
//! A level is a step of grey of a PNG, or 1 in an NPY file. The first row of the image is the furthest along y, as on a screen.
//!
//! Invariant: nothing is allocated before the size is known to be within its limit.

use super::error::{MAX_PIXELS, Problem};
use super::surface::HeightMap;
use meissner_input::message::cut;
use png::{BitDepth, ColorType, Decoder, DecodingError, Limits};
use std::io::Cursor;

/// The levels of an image: columns and rows, and the values row by row.
type Levels = ([usize; 2], Vec<f32>);

/// The height map of an image file. Its name says the format.
pub(super) fn read(
    name: &str,
    bytes: &[u8],
    pixel_mm: f64,
    um_per_level: Option<f64>,
) -> Result<HeightMap, Problem> {
    let end = name.rsplit_once('.').map_or("", |(_, end)| end).to_ascii_lowercase();
    let ((size, mut levels), um_per_level) = match end.as_str() {
        "png" => (png(bytes)?, um_per_level.ok_or(Problem::NoScale)?),
        "npy" => (npy(bytes)?, um_per_level.unwrap_or(1.0)),
        _ => return Err(Problem::ImageKind),
    };
    levels.iter_mut().for_each(|level| *level *= (um_per_level / 1000.0) as f32);
    if let Some(index) = levels.iter().position(|height_mm| !height_mm.is_finite()) {
        return Err(Problem::Pixel { column: index % size[0], row: index / size[0] });
    }
    Ok(HeightMap::new(size, [pixel_mm; 2], levels).expect("the pixels were checked"))
}

fn check(size: [usize; 2]) -> Result<[usize; 2], Problem> {
    let is_good = size.iter().all(|pixels| (1..=MAX_PIXELS).contains(pixels));
    if is_good { Ok(size) } else { Err(Problem::Pixels { columns: size[0], rows: size[1] }) }
}

fn png(bytes: &[u8]) -> Result<Levels, Problem> {
    let limits = Limits { bytes: 4 * MAX_PIXELS * MAX_PIXELS };
    let mut reader = Decoder::new_with_limits(Cursor::new(bytes), limits).read_info().map_err(broken)?;
    let info = reader.info();
    let size = check([info.width as usize, info.height as usize])?;
    let bytes_of = match (info.color_type, info.bit_depth) {
        (ColorType::Grayscale, BitDepth::Eight) => 1,
        (ColorType::Grayscale, BitDepth::Sixteen) => 2,
        (ColorType::Grayscale, depth) => return Err(Problem::Depth { bits: depth as u8 }),
        (color, _) => {
            let found = match color {
                ColorType::GrayscaleAlpha => "grey with transparency",
                ColorType::Indexed => "a palette of colours",
                _ => "colour",
            };
            return Err(Problem::Colour { found });
        }
    };
    let mut data = vec![0; size[0] * size[1] * bytes_of];
    reader.next_frame(&mut data).map_err(broken)?;
    let level = |bytes: &[u8]| bytes.iter().fold(0.0, |level, &byte| 256.0 * level + f32::from(byte));
    Ok((size, data.chunks_exact(bytes_of).map(level).collect()))
}

fn broken(error: DecodingError) -> Problem {
    match error {
        DecodingError::IoError(_) => Problem::Png { message: "it is truncated".to_owned() },
        error => Problem::Png { message: cut(&error.to_string(), 200) },
    }
}

fn npy(bytes: &[u8]) -> Result<Levels, Problem> {
    let ([rows, columns], values) = meissner_array::samples::read_table(bytes)?;
    if columns == 1 && rows > 1 {
        return Err(Problem::Profile);
    }
    Ok((check([columns, rows])?, values.into_iter().map(|value| value as f32).collect()))
}
