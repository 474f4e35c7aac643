//! Finds the description of an array by its name or in a file, and shows it as the API does.

use crate::file::read_regular;
use meissner_api::{ArrayDetails, ArrayDuty, ArrayGrid, ArrayMotor};
use meissner_array::spec::{Array, ArrayError, ArraySpec, Problem, UnknownArray};
use std::path::{Path, PathBuf};

/// The most bytes of a description that are read.
const MAX_BYTES: u64 = 1 << 20;

/// Why there is no such array.
#[derive(Debug, thiserror::Error)]
pub enum FindError {
    /// No known description has this name.
    #[error(transparent)]
    Unknown(#[from] UnknownArray),
    /// The file cannot be read.
    #[error("{}: cannot be read ({source}); give the file of an array's description, or a name", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The file is no valid description.
    #[error(transparent)]
    Description(#[from] ArrayError),
    /// Another description has its name.
    #[error("{}: `name` {problem}", file.display())]
    Name {
        /// The file.
        file: PathBuf,
        /// Which one.
        problem: Problem,
    },
}

/// The array that a text names: a file if it ends with `.toml` or has a `/`, else the name of a known description. A path that is not
/// absolute begins at `folder`.
///
/// # Errors
/// In one line.
pub fn find(text: &str, folder: &Path) -> Result<Array, FindError> {
    if !text.ends_with(".toml") && !text.contains('/') {
        return Ok(Array::named(text)?);
    }
    let file = folder.join(text);
    let read = read_regular(&file, MAX_BYTES).and_then(|bytes| {
        String::from_utf8(bytes).map_err(|error| std::io::Error::new(std::io::ErrorKind::InvalidData, error))
    });
    let text = read.map_err(|source| FindError::Read { file: file.clone(), source })?;
    let spec = ArraySpec::parse(&text, &file.display().to_string())?;
    Array::known(spec).map_err(|problem| FindError::Name { file, problem })
}

/// The array that a daemon has shown.
///
/// # Errors
/// If its description is not valid here, as that of a newer daemon may be.
pub fn shown(details: &ArrayDetails) -> Result<Array, FindError> {
    let file = "the daemon's array";
    let spec = ArraySpec::parse(&details.toml, file)?;
    Array::known(spec).map_err(|problem| FindError::Name { file: file.into(), problem })
}

/// The array as the API shows it.
pub fn details(array: Array) -> ArrayDetails {
    let motor = array.motor();
    ArrayDetails {
        name: array.name().to_owned(),
        hash: format!("{:016x}", array.hash()),
        positions_mm: array.positions_mm().to_vec(),
        grid: array.grid().map(|grid| ArrayGrid {
            rows: grid.rows,
            columns: grid.columns,
            pitch_mm: grid.pitch_mm,
        }),
        pitch_mm: array.pitch_mm(),
        pin_radius_mm: array.pin_radius_mm(),
        tick_hz: array.rate().hz(),
        duty: ArrayDuty { up: array.duty().up, down: array.duty().down },
        rails: array.rails().members().to_vec(),
        chips: array.chips().members().to_vec(),
        motor: ArrayMotor {
            um_per_pulse: motor.um_per_pulse,
            window_ms: array.rate().ticks_to_ms(1) * motor.window_ticks(),
            speed_mm_s: motor.um_per_pulse * f64::from(array.rate().hz()) / 1000.0,
            travel_um: motor.travel_um,
            least_pulses: motor.least_pulses,
            most_pulses: motor.most_pulses,
        },
        toml: array.text().to_owned(),
    }
}
