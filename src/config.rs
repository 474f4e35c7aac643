//! The daemon's configuration: a TOML file, every key optional, and the rules for what is not in it.
//!
//! It says which device to use, where clients connect, where patterns and the logbook lie, how far ahead to feed and
//! what a site's limits are. The array itself cannot be configured yet: the motors' wiring is the controller's.
//! Nothing is opened here but the file.
//!
//! Invariant: a [`Config`] that was read is within the ranges written here; an unknown key is an error at its line.

use crate::session_record::Location;
use firmware_protocol::limits::OnTimeLimits;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::{Plant, PlantConfig, PlantError};
use meissner_client::default_socket;
use meissner_stream::Settings;
use meissner_stream::device::Spec;
use rustix::fs::OFlags;
use serde::Deserialize;
use std::env;
use std::fs::OpenOptions;
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use toml::de::DeTable;

/// Leads that make sense, ms.
pub const LEAD_MS: std::ops::RangeInclusive<f64> = 5.0..=1000.0;
/// The lease is at least the lead and so much, ms.
pub const MIN_LEASE_OVER_LEAD_MS: f64 = 50.0;
/// The lease without configuration is the lead and so much, ms.
pub const DEFAULT_LEASE_OVER_LEAD_MS: f64 = 200.0;
/// The longest lease a controller takes, ms.
pub const MAX_LEASE_MS: f64 = 10_000.0;
/// How long files of the logbook are kept if nobody says, days: a year and what it takes to write about it.
pub const LOGBOOK_DAYS: u32 = 400;
/// The longest they can be kept, days.
const MAX_LOGBOOK_DAYS: u32 = 36_500;
/// Bytes of a configuration file at the most.
const MAX_BYTES: u64 = 1 << 20;

const KEYS: [&str; 11] = [
    "device",
    "socket",
    "patterns_dir",
    "calibration",
    "logbook_dir",
    "logbook_days",
    "lead_ms",
    "lease_ms",
    "drift_warning_um",
    "limits",
    "mock",
];
const LIMIT_KEYS: [&str; 2] = ["motor_pulses_per_s", "rail_pulses_per_s"];
const MOCK_KEYS: [&str; 7] =
    ["seed", "gain_sd", "asymmetry_sd", "transient_gain", "end_stop_um", "telemetry_hz", "telemetry_age_ms"];

/// What the daemon is told.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Which device to use.
    pub device: Spec,
    /// Where clients connect.
    pub socket: PathBuf,
    /// The site's own patterns.
    pub patterns: PatternsDir,
    /// Where the calibration is kept; none: nowhere.
    pub calibration: Option<PathBuf>,
    /// Where the logbook is kept, and for how many days; none: nowhere.
    pub logbook: Option<Location>,
    /// For the streamer.
    pub settings: Settings,
    /// How the mock's motors are.
    pub mock: PlantConfig,
}

/// The directory of the site's own patterns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PatternsDir {
    /// Named by the configuration: it must be there.
    Configured(PathBuf),
    /// The user's or the service's: made when something is first stored in it.
    Default(PathBuf),
    /// There is none.
    None,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            device: Spec::default(),
            socket: default_socket(),
            calibration: beside(&default_patterns()),
            patterns: default_patterns(),
            logbook: keep(None, LOGBOOK_DAYS),
            settings: Settings::default(),
            mock: PlantConfig::default(),
        }
    }
}

/// Where a configuration comes from: a file, and what the command line says instead.
#[derive(Clone, Debug, Default)]
pub struct Source {
    /// The file; without one every key has its default.
    pub file: Option<PathBuf>,
    /// In place of its `device`.
    pub device: Option<Spec>,
    /// In place of its `socket`.
    pub socket: Option<PathBuf>,
}

impl Source {
    /// Reads it.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn read(&self) -> Result<Config, ConfigError> {
        let mut config = self.file.as_deref().map_or_else(|| Ok(Config::default()), Config::read)?;
        if let Some(device) = &self.device {
            config.device = device.clone();
        }
        if let Some(socket) = &self.socket {
            config.socket.clone_from(socket);
        }
        Ok(config)
    }
}

/// A configuration that was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {source}; name a readable file with --config", .file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Not TOML, or a value of the wrong type.
    #[error("{}{}: {message}", .file.display(), line_text(.line))]
    Text {
        /// The file.
        file: PathBuf,
        /// The line, from 1.
        line: Option<usize>,
        /// What is wrong with it.
        message: String,
    },
    /// A key nobody knows.
    #[error("{}:{line}: unknown key `{key}`: did you mean `{nearest}`?", .file.display())]
    UnknownKey {
        /// The file.
        file: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// The key.
        key: String,
        /// The nearest there is.
        nearest: &'static str,
    },
    /// A number out of its range.
    #[error("{}: `{key}` is {found}: must be {range}", .file.display())]
    Range {
        /// The file.
        file: PathBuf,
        /// Its key.
        key: &'static str,
        /// What it is.
        found: f64,
        /// What it may be.
        range: String,
    },
    /// The mock's settings.
    #[error("{}: {source}", .file.display())]
    Mock {
        /// The file.
        file: PathBuf,
        /// Which and why.
        source: PlantError,
    },
}

#[expect(clippy::ref_option, reason = "as thiserror hands it over")]
fn line_text(line: &Option<usize>) -> String {
    line.map_or_else(String::new, |line| format!(":{line}"))
}

#[derive(Deserialize)]
struct File {
    device: Option<String>,
    socket: Option<PathBuf>,
    patterns_dir: Option<PathBuf>,
    calibration: Option<PathBuf>,
    logbook_dir: Option<PathBuf>,
    logbook_days: Option<u32>,
    lead_ms: Option<f64>,
    lease_ms: Option<f64>,
    drift_warning_um: Option<f64>,
    #[serde(default)]
    limits: Limits,
    #[serde(default)]
    mock: PlantConfig,
}

#[derive(Default, Deserialize)]
struct Limits {
    motor_pulses_per_s: Option<u32>,
    rail_pulses_per_s: Option<u32>,
}

impl Config {
    /// Reads a configuration file.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(file: &Path) -> Result<Self, ConfigError> {
        let wrong = |source| ConfigError::Read { file: file.to_owned(), source };
        let bytes = read_regular(file, MAX_BYTES).map_err(wrong)?;
        let text = String::from_utf8(bytes).map_err(|_| wrong(io::Error::other("not UTF-8 text")))?;
        Self::parse(&text, file)
    }

    /// Reads a configuration's text; `file` is what errors call it.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn parse(text: &str, file: &Path) -> Result<Self, ConfigError> {
        let wrong = |error: toml::de::Error| ConfigError::Text {
            file: file.to_owned(),
            line: error.span().map(|span| line_at(text, span.start)),
            message: in_words(error.message()),
        };
        let table = DeTable::parse(text).map_err(wrong)?;
        check_keys(table.get_ref(), &KEYS, text, file)?;
        for (name, known) in [("limits", &LIMIT_KEYS[..]), ("mock", &MOCK_KEYS)] {
            let Some(value) = table.get_ref().get(name) else { continue };
            let Some(section) = value.get_ref().as_table() else {
                return Err(ConfigError::Text {
                    file: file.to_owned(),
                    line: Some(line_at(text, value.span().start)),
                    message: format!("`{name}` must be a table: write [{name}] and its keys below"),
                });
            };
            check_keys(section, known, text, file)?;
        }
        toml::from_str::<File>(text).map_err(wrong)?.check(file)
    }
}

/// The file's bytes, at most so many. A pipe or a device in place of a file is refused without waiting for it.
pub(crate) fn read_regular(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut options = OpenOptions::new();
    let file = options.read(true).custom_flags(OFlags::NONBLOCK.bits().cast_signed()).open(path)?;
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("is not a regular file"));
    }
    let mut bytes = Vec::new();
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(io::Error::other(format!("more than {most} bytes")));
    }
    Ok(bytes)
}

/// What serde and TOML say, on one line and without the names of our types.
fn in_words(message: &str) -> String {
    let line = message.lines().collect::<Vec<_>>().join("; ").replace("expected f64", "expected a number");
    let line = line.replace("expected path string", "expected a path in quotes");
    let line = line.replace("expected u32", &format!("expected a whole number from 0 to {}", u32::MAX));
    line.replace("expected u64", &format!("expected a whole number from 0 to {}", i64::MAX))
}

fn line_at(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

fn check_keys(
    table: &DeTable<'_>,
    known: &[&'static str],
    text: &str,
    file: &Path,
) -> Result<(), ConfigError> {
    let unknown = table.keys().filter(|key| !known.contains(&key.get_ref().as_ref()));
    let Some(key) = unknown.min_by_key(|key| key.span().start) else { return Ok(()) };
    let piece: String = key.get_ref().chars().take(64).collect();
    let nearest = known.iter().min_by_key(|known| strsim::damerau_levenshtein(known, &piece));
    Err(ConfigError::UnknownKey {
        file: file.to_owned(),
        line: line_at(text, key.span().start),
        key: piece.escape_debug().to_string(),
        nearest: nearest.copied().unwrap_or_default(),
    })
}

impl File {
    fn check(self, file: &Path) -> Result<Config, ConfigError> {
        let range = |key, found, good: bool, range: &dyn Fn() -> String| {
            if good {
                Ok(())
            } else {
                Err(ConfigError::Range { file: file.to_owned(), key, found, range: range() })
            }
        };
        let asked = self.device.as_deref().unwrap_or("auto");
        let device = match asked.parse::<Spec>() {
            Ok(device) => device,
            Err(error) => {
                let message = format!("device `{}`: {error}", asked.escape_debug());
                return Err(ConfigError::Text { file: file.to_owned(), line: None, message });
            }
        };
        let paths = [
            ("socket", &self.socket),
            ("patterns_dir", &self.patterns_dir),
            ("calibration", &self.calibration),
            ("logbook_dir", &self.logbook_dir),
        ];
        for (key, path) in paths {
            let odd = path
                .as_ref()
                .and_then(|path| path.to_str())
                .is_some_and(|path| path.contains(char::is_control));
            if odd {
                let message = format!("`{key}` holds a control character: name a path without");
                return Err(ConfigError::Text { file: file.to_owned(), line: None, message });
            }
            if path.as_ref().is_some_and(|path| path.as_os_str().is_empty()) {
                let message = format!("`{key}` is empty: name one, or leave the key out");
                return Err(ConfigError::Text { file: file.to_owned(), line: None, message });
            }
        }
        let logbook_days = self.logbook_days.unwrap_or(LOGBOOK_DAYS);
        let days_range = || format!("0 to {MAX_LOGBOOK_DAYS} days");
        range("logbook_days", logbook_days.into(), logbook_days <= MAX_LOGBOOK_DAYS, &days_range)?;
        let lead_ms = self.lead_ms.unwrap_or(Settings::default().lead_ms);
        let lead_range = || format!("{} to {} ms", LEAD_MS.start(), LEAD_MS.end());
        range("lead_ms", lead_ms, LEAD_MS.contains(&lead_ms), &lead_range)?;
        let lease_ms = self.lease_ms.unwrap_or(lead_ms + DEFAULT_LEASE_OVER_LEAD_MS);
        let least = lead_ms + MIN_LEASE_OVER_LEAD_MS;
        let lease_range =
            || format!("{least} to {MAX_LEASE_MS} ms, at least lead_ms + {MIN_LEASE_OVER_LEAD_MS}");
        range("lease_ms", lease_ms, (least..=MAX_LEASE_MS).contains(&lease_ms), &lease_range)?;
        let drift_warning_um = self.drift_warning_um.unwrap_or(Settings::default().drift_warning_um.into());
        let (key, most) = ("drift_warning_um", 10_000.0);
        let good = (1.0..=most).contains(&drift_warning_um);
        range(key, drift_warning_um, good, &|| format!("1 to {most} um"))?;
        let drift_warning_um = drift_warning_um as f32;
        let none = OnTimeLimits::NONE;
        let motor = self.limits.motor_pulses_per_s.unwrap_or(none.motor);
        let rail = self.limits.rail_pulses_per_s.unwrap_or(none.rail);
        for (key, found, most) in
            [("limits.motor_pulses_per_s", motor, none.motor), ("limits.rail_pulses_per_s", rail, none.rail)]
        {
            range(key, found.into(), (1..=most).contains(&found), &|| format!("1 to {most} pulses/s"))?;
        }
        Plant::new(self.mock, Tick(0))
            .map_err(|source| ConfigError::Mock { file: file.to_owned(), source })?;
        let patterns = self.patterns_dir.map_or_else(default_patterns, PatternsDir::Configured);
        Ok(Config {
            device,
            socket: self.socket.unwrap_or_else(default_socket),
            calibration: self.calibration.or_else(|| beside(&patterns)),
            patterns,
            logbook: keep(self.logbook_dir, logbook_days),
            settings: Settings { lead_ms, lease_ms, limits: OnTimeLimits { motor, rail }, drift_warning_um },
            mock: self.mock,
        })
    }
}

/// A variable that is set and not empty.
fn variable(name: &str) -> Option<PathBuf> {
    env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from)
}

/// `$STATE_DIRECTORY`: systemd's, which names all that a unit has, the outermost first, with colons in between.
fn state_dir() -> Option<PathBuf> {
    variable("STATE_DIRECTORY").and_then(|dirs| env::split_paths(&dirs).next())
}

/// systemd's `$STATE_DIRECTORY` for the service, else the user's data directory.
fn default_patterns() -> PatternsDir {
    state_dir()
        .map(|dir| dir.join("patterns"))
        .or_else(|| variable("XDG_DATA_HOME").map(|dir| dir.join("meissner/patterns")))
        .or_else(|| variable("HOME").map(|dir| dir.join(".local/share/meissner/patterns")))
        .map_or(PatternsDir::None, PatternsDir::Default)
}

/// Where the logbook is kept: without a directory in the service's; a person who tries something out leaves no record of it.
fn keep(dir: Option<PathBuf>, days: u32) -> Option<Location> {
    let dir = dir.or_else(|| state_dir().map(|dir| dir.join("logbook")))?;
    (days > 0).then_some(Location { dir, days })
}

/// Where the calibration is kept if nobody says: beside the site's own patterns.
fn beside(patterns: &PatternsDir) -> Option<PathBuf> {
    let (PatternsDir::Configured(dir) | PatternsDir::Default(dir)) = patterns else { return None };
    Some(dir.parent().unwrap_or(Path::new("")).join("calibration.toml"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Config, String> {
        Config::parse(text, Path::new("m.toml")).map_err(|error| error.to_string())
    }

    #[test]
    fn an_empty_file_is_the_default() {
        assert_eq!(parse("").unwrap(), Config::default());
        assert_eq!(Config::default().settings.lease_ms, 300.0);
    }

    #[test]
    fn every_key_is_read() {
        let text = "device = \"pty\"\nsocket = \"/s\"\npatterns_dir = \"/s/p\"\nlead_ms = 50\nlease_ms = 100.0\ndrift_warning_um = 30\n\
                    [limits]\nmotor_pulses_per_s = 40000\nrail_pulses_per_s = 90000\n[mock]\nseed = 3\ngain_sd = 0.0\n";
        let config = parse(text).unwrap();
        assert_eq!((config.device, config.socket), (Spec::Pty, "/s".into()));
        assert_eq!(config.patterns, PatternsDir::Configured("/s/p".into()));
        assert_eq!(config.calibration, Some("/s/calibration.toml".into()));
        assert_eq!(parse("calibration = \"/c\"").unwrap().calibration, Some("/c".into()));
        let kept = parse("logbook_dir = \"/l\"\nlogbook_days = 0").unwrap();
        assert_eq!(kept.logbook, None);
        let kept = parse("logbook_dir = \"/l\"\nlogbook_days = 30").unwrap();
        assert_eq!(kept.logbook, Some(Location { dir: "/l".into(), days: 30 }));
        let kept = parse("logbook_dir = \"/l\"").unwrap();
        assert_eq!(kept.logbook, Some(Location { dir: "/l".into(), days: LOGBOOK_DAYS }));
        let limits = OnTimeLimits { motor: 40_000, rail: 90_000 };
        assert_eq!(
            config.settings,
            Settings { lead_ms: 50.0, lease_ms: 100.0, limits, drift_warning_um: 30.0 }
        );
        assert_eq!(config.mock, PlantConfig { seed: 3, gain_sd: 0.0, ..PlantConfig::default() });
        assert_eq!(parse("lead_ms = 50").unwrap().settings.lease_ms, 250.0);
    }

    #[test]
    fn what_is_wrong_is_one_line_with_its_place() {
        for (text, says) in [
            ("\nlaed_ms = 5", "m.toml:2: unknown key `laed_ms`: did you mean `lead_ms`?"),
            ("[mock]\nsede = 1", "m.toml:2: unknown key `sede`: did you mean `seed`?"),
            ("[limits]\n\nmotor = 1", "m.toml:3: unknown key `motor`: did you mean `motor_pulses_per_s`?"),
            ("lead_ms = 4", "`lead_ms` is 4: must be 5 to 1000 ms"),
            ("lead_ms = nan", "`lead_ms` is NaN"),
            ("drift_warning_um = 0.5", "`drift_warning_um` is 0.5: must be 1 to 10000 um"),
            ("lease_ms = 149", "`lease_ms` is 149: must be 150 to"),
            ("limits.rail_pulses_per_s = 0", "`limits.rail_pulses_per_s` is 0"),
            ("limits = 3", "m.toml:1: `limits` must be a table"),
            ("\nmock = []", "m.toml:2: `mock` must be a table"),
            ("lead_ms = \"5\"", "m.toml:1: invalid type: string \"5\", expected a number"),
            ("limits.motor_pulses_per_s = -1", "expected a whole number from 0 to 4294967295"),
            ("mock.seed = -1", "expected a whole number from 0 to 9223372036854775807"),
            ("socket = 1", "expected a path in quotes"),
            ("patterns_dir = \"\"", "m.toml: `patterns_dir` is empty"),
            ("socket = \"\"", "m.toml: `socket` is empty"),
            ("calibration = \"\"", "m.toml: `calibration` is empty"),
            ("logbook_dir = \"\"", "m.toml: `logbook_dir` is empty"),
            ("logbook_days = 36501", "`logbook_days` is 36501: must be 0 to 36500 days"),
            ("logbook_days = -1", "expected a whole number from 0 to 4294967295"),
            ("mock.gain_sd = -1.0", "mock.gain_sd is -1"),
            ("device = \"uart\"", "device `uart`: not one of"),
            ("device = 3", "m.toml:1: invalid type"),
            ("lead_ms = ", "m.toml:1: "),
        ] {
            let line = parse(text).unwrap_err();
            assert!(line.contains(says) && !line.contains('\n'), "{text}: {line}");
        }
        for (file, says) in [
            ("/dev/zero", "is not a regular file"),
            ("/", "is not a regular file"),
            ("/proc/self/exe", "more than"),
        ] {
            let line = Config::read(Path::new(file)).unwrap_err().to_string();
            assert!(line.contains(says) && !line.contains('\n'), "{line}");
        }
        assert!(
            Config::read(Path::new("/nonexistent/m.toml")).unwrap_err().to_string().contains("/nonexistent")
        );
    }
}
