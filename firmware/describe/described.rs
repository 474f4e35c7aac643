//! What the firmware takes from the description of an array.
//!
//! This is a stand-in: once the array crate reads descriptions (`ArraySpec`), [`read`] asks it.

use serde::Deserialize;
use std::path::Path;

/// The numbers of an array that its firmware needs.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Described {
    /// 1 to 32 of a-z, 0-9 and -.
    pub(crate) name: String,
    /// The carrier, Hz.
    pub(crate) tick_hz: u32,
    /// Duties of an up and of a down pulse, in 1/1000 of a tick.
    pub(crate) duty: [u16; 2],
    /// For each motor the number of its rail.
    pub(crate) rails: Vec<u8>,
    /// For each motor the number of its driver chip.
    pub(crate) chips: Vec<u8>,
    /// Most up pulses of a stroke.
    pub(crate) most_pulses: u16,
    /// Most pulses of a seek of the lower stop.
    pub(crate) seek_pulses: u16,
    /// Tells descriptions apart.
    pub(crate) hash: u64,
}

/// Reads the description at `path`; without one, gives the paper's array.
///
/// # Errors
/// One line that says what is wrong.
pub(crate) fn read(path: Option<&Path>) -> Result<Described, String> {
    let Some(path) = path else { return Ok(paper()) };
    let named = |problem: &str| format!("{}: {}", path.display(), problem.lines().next().unwrap_or_default());
    let text = std::fs::read_to_string(path).map_err(|error| named(&error.to_string()))?;
    parse(&text).map_err(|problem| named(&problem))
}

/// The paper's array.
fn paper() -> Described {
    Described {
        name: "tula35-6x4".to_owned(),
        tick_hz: 85_000,
        duty: [200, 800],
        rails: (0..24).map(|motor| motor / 6).collect(),
        chips: (0..24).map(|motor| motor / 2).collect(),
        most_pulses: 3_000,
        seek_pulses: 17_000,
        hash: 0,
    }
}

#[derive(Deserialize)]
struct Raw {
    name: String,
    pins: Pins,
    tick_hz: u32,
    duty: Duty,
    rails: Option<Vec<Vec<u8>>>,
    chips: Option<Vec<Vec<u8>>>,
    motor: Motor,
}

#[derive(Deserialize)]
struct Pins {
    rows: Option<u8>,
    columns: Option<u8>,
    positions_mm: Option<Vec<[f64; 2]>>,
}

#[derive(Deserialize)]
struct Duty {
    up: f64,
    down: f64,
}

#[derive(Deserialize)]
struct Motor {
    most_pulses: u16,
    seek_pulses: u16,
}

fn parse(text: &str) -> Result<Described, String> {
    let Raw { name, pins, tick_hz, duty, rails, chips, motor } =
        toml::from_str(text).map_err(|error: toml::de::Error| error.message().to_owned())?;
    let motors = match pins {
        Pins { rows: Some(rows), columns: Some(columns), .. } => usize::from(rows) * usize::from(columns),
        Pins { positions_mm, .. } => positions_mm.map_or(0, |places| places.len()),
    };
    if !(1..=64).contains(&motors) {
        return Err(format!("`pins` has {motors} motors: must be 1 to 64"));
    }
    let thousandths = |key: &str, share: f64| {
        let whole = (share * 1e3).round();
        let exact = (whole - share * 1e3).abs() < 1e-6 && (1.0..1e3).contains(&whole);
        if exact {
            Ok(whole as u16)
        } else {
            Err(format!("`duty.{key}` is {share}: must be whole thousandths"))
        }
    };
    let rails = rails.unwrap_or_else(|| vec![(0..motors as u8).collect()]);
    let chips = chips.unwrap_or_else(|| (0..motors as u8).map(|motor| vec![motor]).collect());
    // FNV-1a.
    let hash = text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    Ok(Described {
        name,
        tick_hz,
        duty: [thousandths("up", duty.up)?, thousandths("down", duty.down)?],
        rails: numbers("rails", &rails, motors)?,
        chips: numbers("chips", &chips, motors)?,
        most_pulses: motor.most_pulses,
        seek_pulses: motor.seek_pulses,
        hash,
    })
}

/// For each motor the number of its group.
fn numbers(key: &str, groups: &[Vec<u8>], motors: usize) -> Result<Vec<u8>, String> {
    let mut of = vec![None; motors];
    for (group, members) in groups.iter().enumerate() {
        for &motor in members {
            let place = of
                .get_mut(usize::from(motor))
                .ok_or(format!("`{key}` names motor {motor}: there are {motors}"))?;
            if place.replace(group as u8).is_some() {
                return Err(format!("`{key}` names motor {motor} twice"));
            }
        }
    }
    let named =
        of.iter().position(Option::is_none).map(|motor| format!("`{key}` does not name motor {motor}"));
    named.map_or_else(|| Ok(of.into_iter().flatten().collect()), Err)
}
