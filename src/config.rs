//! The daemon's configuration: a TOML file in which every key is optional.
//!
//! It names the device, the socket, the directories of patterns and session records, how far ahead the streamer feeds the
//! controller, and a site's limits. [`Config::read`] reads it; missing keys have their defaults. The controller fixes the motors'
//! wiring: it cannot be configured. This module opens no file but the configuration.
//!
//! Invariant: every value of a [`Config`] that was read is within the ranges written here; an unknown key is an error.

mod array;
mod network;

use crate::exposure::ParticipantLimits;
use crate::session_record::Location;
pub use network::Listen;

use array::RawArray;
use firmware_protocol::limits::OnTimeLimits;
use meissner_array::pattern::AMPLITUDE_UM;
use meissner_array::simulated::{LowerStop, SimulatedMotorsConfig, SimulatedMotorsError};
use meissner_client::default_socket;
use meissner_input::document::{self, DocumentError, Table, from_toml, in_range};
use meissner_input::message::quote;
use meissner_stream::Settings;
use meissner_stream::device::{Spec, SpecError};
use rustix::fs::OFlags;
use serde::Deserialize;
use std::env;
use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// The range of the lead, ms.
pub const LEAD_MS: RangeInclusive<f64> = 5.0..=1000.0;
/// The host watchdog timeout exceeds the lead at least by this, ms.
pub const MIN_LEASE_OVER_LEAD_MS: f64 = 50.0;
/// The longest host watchdog timeout that a controller takes, ms.
pub const MAX_LEASE_MS: f64 = 10_000.0;
/// How long files of the session record are kept by default, days: a year of experiments, and time to write about them.
pub const LOGBOOK_DAYS: u32 = 400;
/// The default of `session_silence_s`: an experiment that pauses between blocks still polls, and a dead one soon lets others act.
const SESSION_SILENCE_S: f64 = 120.0;
/// The longest time they can be kept, days.
const MAX_LOGBOOK_DAYS: u32 = 36_500;
/// The range of a participant's largest amplitude, um: as a pattern's.
const LIMIT_UM: RangeInclusive<f64> = 1.0..=*AMPLITUDE_UM.end();
/// The range of a participant's times, s: up to a day.
const LIMIT_S: RangeInclusive<f64> = 0.1..=86_400.0;
/// The range of a pause, s.
const PAUSE_S: RangeInclusive<f64> = 0.1..=3600.0;
/// The name of the calibration's file.
const CALIBRATION: &str = "calibration.toml";
/// The name of the file of access tokens.
const TOKENS: &str = "tokens.toml";
/// The most bytes of a configuration file.
const MAX_BYTES: u64 = 1 << 20;

/// The settings of a daemon.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Which device to use.
    pub device: Spec,
    /// Where clients connect.
    pub socket: PathBuf,
    /// Where clients connect that come over the network; `None`: nothing listens there.
    pub listen: Option<Listen>,
    /// The file of the access tokens; `None`: they end with the daemon.
    pub tokens: Option<PathBuf>,
    /// The site's own patterns.
    pub patterns: PatternsDir,
    /// The file of the calibration; `None`: it is not stored.
    pub calibration: Option<PathBuf>,
    /// Where the session record is kept, and for how long; `None`: there is no session record.
    pub logbook: Option<Location>,
    /// How long the owner of an exclusive session may be silent before others may act, s.
    pub session_silence_s: f64,
    /// What a participant may be exposed to.
    pub participant: ParticipantLimits,
    /// The settings of the streamer.
    pub settings: Settings,
    /// The simulated array.
    pub mock: SimulatedMotorsConfig,
}

/// The directory of the site's own patterns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PatternsDir {
    /// From the configuration: it must exist.
    Configured(PathBuf),
    /// The user's or the service's: made when a pattern is first stored.
    Default(PathBuf),
    /// There is none.
    None,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            device: Spec::default(),
            socket: default_socket(),
            listen: None,
            tokens: beside(&default_patterns(), TOKENS),
            calibration: beside(&default_patterns(), CALIBRATION),
            patterns: default_patterns(),
            logbook: keep(None, LOGBOOK_DAYS),
            session_silence_s: SESSION_SILENCE_S,
            participant: ParticipantLimits::default(),
            settings: Settings::default(),
            mock: SimulatedMotorsConfig::default(),
        }
    }
}

/// Where a configuration comes from: a file, and options of the command line.
#[derive(Clone, Debug, Default)]
pub struct Source {
    /// The file; without one every key has its default.
    pub file: Option<PathBuf>,
    /// Replaces the `device` of the file.
    pub device: Option<Spec>,
    /// Replaces the `socket` of the file.
    pub socket: Option<PathBuf>,
    /// Replaces the `listen` of the file.
    pub listen: Option<SocketAddr>,
    /// Keep no session record.
    pub no_record: bool,
}

impl Source {
    /// Reads the configuration.
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
        if let Some(address) = self.listen {
            config.listen =
                Some(config.listen.take().map_or(Listen::at(address), |listen| Listen { address, ..listen }));
        }
        if self.no_record {
            config.logbook = None;
        }
        Ok(config)
    }
}

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {source}; name a readable file with --config", .file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Its text is refused.
    #[error(transparent)]
    Refused(#[from] DocumentError<Problem>),
}

/// A problem of one key, besides those that all documents share.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("is {found}: {source}")]
    Device { found: String, source: SpecError },
    #[error("is empty: name one, or leave the key out")]
    EmptyPath,
    #[error("holds a control character: name a path without one")]
    ControlCharacter,
    #[error("is {found}: must be an address and a port, as \"127.0.0.1:8765\", or \"none\"")]
    Listen { found: String },
    #[error("is {found}: must be a host's name, without port and path")]
    Host { found: String },
    #[error("is {found}: must be \"remote\" or \"always\"")]
    ListenToken { found: String },
    #[error("is {found}: must be a number of um, or \"auto\"")]
    Surplus { found: String },
}

type KeyError = document::KeyError<Problem>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawConfig {
    device: Option<String>,
    socket: Option<PathBuf>,
    listen: Option<String>,
    listen_hosts: Option<Vec<String>>,
    listen_token: Option<String>,
    tokens: Option<PathBuf>,
    patterns_dir: Option<PathBuf>,
    calibration: Option<PathBuf>,
    logbook_dir: Option<PathBuf>,
    logbook_days: Option<u32>,
    lead_ms: Option<f64>,
    lease_ms: Option<f64>,
    drift_warning_um: Option<f64>,
    drift_limit_um: Option<f64>,
    end_stop_um: Option<f64>,
    session_silence_s: Option<f64>,
    participant: Option<Table<RawParticipant>>,
    array: Option<Table<RawArray>>,
    limits: Option<Table<RawLimits>>,
    mock: Option<Table<SimulatedMotorsConfig>>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawParticipant {
    max_amplitude_um: Option<f64>,
    max_continuous_s: Option<f64>,
    pause_s: Option<f64>,
    max_session_s: Option<f64>,
    max_day_s: Option<f64>,
}

impl RawParticipant {
    fn check(self) -> Result<ParticipantLimits, KeyError> {
        let default = ParticipantLimits::default();
        let limit = |key: &str, found: Option<f64>, default: f64, range: RangeInclusive<f64>, unit: &str| {
            let found = found.unwrap_or(default);
            let text = format!("{} to {} {unit}", range.start(), range.end());
            in_range(&format!("participant.{key}"), found, range.contains(&found), text).map(|()| found)
        };
        let seconds = |key, found, default| limit(key, found, default, LIMIT_S, "s");
        Ok(ParticipantLimits {
            max_amplitude_um: limit(
                "max_amplitude_um",
                self.max_amplitude_um,
                default.max_amplitude_um,
                LIMIT_UM,
                "um",
            )?,
            max_continuous_s: seconds("max_continuous_s", self.max_continuous_s, default.max_continuous_s)?,
            pause_s: limit("pause_s", self.pause_s, default.pause_s, PAUSE_S, "s")?,
            max_session_s: seconds("max_session_s", self.max_session_s, default.max_session_s)?,
            max_day_s: seconds("max_day_s", self.max_day_s, default.max_day_s)?,
        })
    }
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLimits {
    motor_pulses_per_s: Option<u32>,
    rail_pulses_per_s: Option<u32>,
    stop_pulses_per_s: Option<u32>,
}

impl Config {
    /// Reads a configuration file.
    ///
    /// # Errors
    /// The first problem, in one line.
    pub fn read(file: &Path) -> Result<Self, ConfigError> {
        let wrong = |source| ConfigError::Read { file: file.to_owned(), source };
        let bytes = read_regular(file, MAX_BYTES).map_err(wrong)?;
        let text = String::from_utf8(bytes).map_err(|_| wrong(io::Error::other("not UTF-8 text")))?;
        Self::parse(&text, file)
    }

    /// Reads the text of a configuration; `file` is its name in errors.
    ///
    /// # Errors
    /// The first problem, in one line.
    pub fn parse(text: &str, file: &Path) -> Result<Self, ConfigError> {
        // Every key may be left out.
        let wanted = |_: &str| "it";
        let config = from_toml(text, wanted).and_then(|Table(raw): Table<RawConfig>| raw.check());
        Ok(config
            .map_err(|fault: KeyError| fault.in_text(text).in_file(Some(&file.display().to_string())))?)
    }
}

/// Opens a file for reading. Refuses a pipe or a device without waiting for it.
pub(crate) fn open_regular(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    let file = options.read(true).custom_flags(OFlags::NONBLOCK.bits().cast_signed()).open(path)?;
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("is not a regular file"));
    }
    Ok(file)
}

/// The bytes of a regular file, refused if there are more than `most`.
pub(crate) fn read_regular(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_regular(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(io::Error::other(format!("more than {most} bytes")));
    }
    Ok(bytes)
}

impl RawConfig {
    fn check(self) -> Result<Config, KeyError> {
        let device = self.device.as_deref().map_or(Ok(Spec::Auto), |found| {
            let problem = |source| Problem::Device { found: quote(found), source };
            found.parse().map_err(|source| KeyError::key("device", problem(source)))
        })?;
        check_path("socket", self.socket.as_deref())?;
        check_path("tokens", self.tokens.as_deref())?;
        let listen = network::check(self.listen.as_deref(), self.listen_hosts, self.listen_token.as_deref())?;
        check_path("patterns_dir", self.patterns_dir.as_deref())?;
        check_path("calibration", self.calibration.as_deref())?;
        check_path("logbook_dir", self.logbook_dir.as_deref())?;
        let logbook_days = self.logbook_days.unwrap_or(LOGBOOK_DAYS);
        let good = logbook_days <= MAX_LOGBOOK_DAYS;
        in_range("logbook_days", logbook_days.into(), good, format!("0 to {MAX_LOGBOOK_DAYS} days"))?;
        let lead_ms = self.lead_ms.unwrap_or(Settings::default().lead_ms);
        let range = format!("{} to {} ms", LEAD_MS.start(), LEAD_MS.end());
        in_range("lead_ms", lead_ms, LEAD_MS.contains(&lead_ms), range)?;
        let lease_ms = self.lease_ms.unwrap_or(Settings::for_lead(lead_ms).lease_ms);
        let least = lead_ms + MIN_LEASE_OVER_LEAD_MS;
        let range = format!("{least} to {MAX_LEASE_MS} ms, at least lead_ms + {MIN_LEASE_OVER_LEAD_MS}");
        in_range("lease_ms", lease_ms, (least..=MAX_LEASE_MS).contains(&lease_ms), range)?;
        let drift_warning_um = self.drift_warning_um.unwrap_or(Settings::default().drift_warning_um.into());
        let good = (1.0..=10_000.0).contains(&drift_warning_um);
        in_range("drift_warning_um", drift_warning_um, good, "1 to 10000 um")?;
        let drift_warning_um = drift_warning_um as f32;
        let drift_limit_um = self.drift_limit_um.unwrap_or(Settings::default().drift_limit_um.into());
        let good = (1.0..=10_000.0).contains(&drift_limit_um);
        in_range("drift_limit_um", drift_limit_um, good, "1 to 10000 um")?;
        let drift_limit_um = drift_limit_um as f32;
        let Table(limits) = self.limits.unwrap_or(Table(RawLimits::default()));
        let none = OnTimeLimits::NONE;
        let limit = |key: &str, found: Option<u32>, most: u32| {
            let found = found.unwrap_or(most);
            let good = (1..=most).contains(&found);
            in_range(key, found.into(), good, format!("1 to {most} pulses/s")).map(|()| found)
        };
        let motor = limit("limits.motor_pulses_per_s", limits.motor_pulses_per_s, none.motor)?;
        let rail = limit("limits.rail_pulses_per_s", limits.rail_pulses_per_s, none.rail)?;
        let session_silence_s = self.session_silence_s.unwrap_or(SESSION_SILENCE_S);
        let good = (0.1..=3600.0).contains(&session_silence_s);
        in_range("session_silence_s", session_silence_s, good, "0.1 to 3600 s")?;
        let Table(participant) = self.participant.unwrap_or(Table(RawParticipant::default()));
        let participant = participant.check()?;
        let Table(mut mock) = self.mock.unwrap_or(Table(SimulatedMotorsConfig::default()));
        if let Err(SimulatedMotorsError { key, found, most }) = mock.check() {
            in_range(&format!("mock.{key}"), found, false, format!("0 to {most}"))?;
        }
        // The simulated array's own, unless the file knows those of the motors.
        let end_stop_um = self.end_stop_um.unwrap_or(mock.end_stop_um);
        let good = (0.0..=10_000.0).contains(&end_stop_um);
        in_range("end_stop_um", end_stop_um, good, "0 to 10000 um")?;
        let stop_pulses_per_s = limits.stop_pulses_per_s;
        let limits = OnTimeLimits { motor, rail };
        let end_stop_um = end_stop_um as f32;
        let settings = Settings {
            lead_ms,
            lease_ms,
            limits,
            drift_warning_um,
            drift_limit_um,
            end_stop_um,
            lower_stop: None,
        };
        let Table(array) = self.array.unwrap_or(Table(RawArray::default()));
        let lower_stop = array.check(stop_pulses_per_s, &settings)?;
        if lower_stop.is_some() {
            // The simulated array is like the site's.
            mock.lower_stop = LowerStop::AtRest;
        }
        let patterns = self.patterns_dir.map_or_else(default_patterns, PatternsDir::Configured);
        Ok(Config {
            device,
            socket: self.socket.unwrap_or_else(default_socket),
            listen,
            tokens: self.tokens.or_else(|| beside(&patterns, TOKENS)),
            calibration: self.calibration.or_else(|| beside(&patterns, CALIBRATION)),
            patterns,
            logbook: keep(self.logbook_dir, logbook_days),
            session_silence_s,
            participant,
            settings: Settings { lower_stop, ..settings },
            mock,
        })
    }
}

fn check_path(key: &str, path: Option<&Path>) -> Result<(), KeyError> {
    let Some(path) = path else { return Ok(()) };
    if path.as_os_str().is_empty() {
        return Err(KeyError::key(key, Problem::EmptyPath));
    }
    if path.to_str().is_some_and(|path| path.contains(char::is_control)) {
        return Err(KeyError::key(key, Problem::ControlCharacter));
    }
    Ok(())
}

/// A variable of the environment, if it is set and not empty.
fn variable(name: &str) -> Option<PathBuf> {
    env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from)
}

/// `$STATE_DIRECTORY` of systemd: it lists the directories of a unit with colons in between, the outermost first.
fn state_dir() -> Option<PathBuf> {
    variable("STATE_DIRECTORY").and_then(|dirs| env::split_paths(&dirs).next())
}

/// The default directory of patterns: the service's state directory, else the user's data directory.
fn default_patterns() -> PatternsDir {
    state_dir()
        .map(|dir| dir.join("patterns"))
        .or_else(|| variable("XDG_DATA_HOME").map(|dir| dir.join("meissner/patterns")))
        .or_else(|| variable("HOME").map(|dir| dir.join(".local/share/meissner/patterns")))
        .map_or(PatternsDir::None, PatternsDir::Default)
}

/// Where the session record is kept: by default in the service's state directory, else in the user's.
fn keep(dir: Option<PathBuf>, days: u32) -> Option<Location> {
    let user = || {
        let state =
            variable("XDG_STATE_HOME").or_else(|| variable("HOME").map(|dir| dir.join(".local/state")));
        state.map(|dir| (dir.join("meissner/logbook"), true))
    };
    let known = dir.or_else(|| state_dir().map(|dir| dir.join("logbook"))).map(|dir| (dir, false));
    let (dir, make_parents) = known.or_else(user)?;
    (days > 0).then_some(Location { dir, days, make_parents })
}

/// The default place of a file that the daemon writes: beside the site's own patterns.
fn beside(patterns: &PatternsDir, file: &str) -> Option<PathBuf> {
    let (PatternsDir::Configured(dir) | PatternsDir::Default(dir)) = patterns else { return None };
    Some(dir.parent().unwrap_or(Path::new("")).join(file))
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_stream::LowerStopSettings;

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
                    drift_limit_um = 60\nend_stop_um = 250\n\
                    [limits]\nmotor_pulses_per_s = 40000\nrail_pulses_per_s = 90000\n[mock]\nseed = 3\ngain_sd = 0.0\n";
        let config = parse(text).unwrap();
        assert_eq!((config.device, config.socket), (Spec::Pty, "/s".into()));
        assert_eq!(config.patterns, PatternsDir::Configured("/s/p".into()));
        assert_eq!(config.calibration, Some("/s/calibration.toml".into()));
        assert_eq!(parse("calibration = \"/c\"").unwrap().calibration, Some("/c".into()));
        let kept = parse("logbook_dir = \"/l\"\nlogbook_days = 0").unwrap();
        assert_eq!(kept.logbook, None);
        let kept = parse("logbook_dir = \"/l\"\nlogbook_days = 30").unwrap();
        assert_eq!(kept.logbook, Some(Location { dir: "/l".into(), days: 30, make_parents: false }));
        let kept = parse("logbook_dir = \"/l\"").unwrap();
        assert_eq!(
            kept.logbook,
            Some(Location { dir: "/l".into(), days: LOGBOOK_DAYS, make_parents: false })
        );
        let limits = OnTimeLimits { motor: 40_000, rail: 90_000 };
        assert_eq!(
            config.settings,
            Settings {
                lead_ms: 50.0,
                lease_ms: 100.0,
                limits,
                drift_warning_um: 30.0,
                drift_limit_um: 60.0,
                end_stop_um: 250.0,
                lower_stop: None
            }
        );
        let stop = "array = {lower_stop = \"at_rest\", surplus_um = 12.5, rest_error_um = 4}\nlimits.stop_pulses_per_s = 9000";
        let with_stop = parse(stop).unwrap();
        let lower_stop = LowerStopSettings { surplus_um: Some(12.5), rest_error_um: 4.0, pulses_per_s: 9000 };
        assert_eq!(with_stop.settings.lower_stop, Some(lower_stop));
        assert_eq!(with_stop.mock.lower_stop, LowerStop::AtRest);
        let auto = parse("[array]\nlower_stop = \"at_rest\"\nsurplus_um = \"auto\"").unwrap();
        assert_eq!(auto.settings.lower_stop, Some(LowerStopSettings::default()));
        // Without it, the simulated array's.
        assert_eq!(parse("mock.end_stop_um = 90").unwrap().settings.end_stop_um, 90.0);
        assert_eq!(
            config.mock,
            SimulatedMotorsConfig { seed: 3, gain_sd: 0.0, ..SimulatedMotorsConfig::default() }
        );
        let text = "[participant]\nmax_amplitude_um = 90\nmax_continuous_s = 60\npause_s = 5\nmax_session_s = 900\nmax_day_s = 1800\n";
        let limits = ParticipantLimits {
            max_amplitude_um: 90.0,
            max_continuous_s: 60.0,
            pause_s: 5.0,
            max_session_s: 900.0,
            max_day_s: 1800.0,
        };
        assert_eq!(parse(text).unwrap().participant, limits);
        assert_eq!(parse("lead_ms = 50").unwrap().settings.lease_ms, 250.0);
    }

    #[test]
    fn an_error_is_one_line_with_its_place() {
        for (text, says) in [
            ("\nlaed_ms = 5", "m.toml:2: unknown key `laed_ms`: did you mean `lead_ms`?"),
            ("[mock]\nsede = 1", "m.toml:2: `mock`: unknown key `sede`: did you mean `seed`?"),
            (
                "[limits]\n\nmotor = 1",
                "m.toml:3: `limits`: unknown key `motor`: did you mean `motor_pulses_per_s`?",
            ),
            ("lead_ms = 4", "m.toml:1: `lead_ms` is 4: must be 5 to 1000 ms"),
            ("lead_ms = nan", "`lead_ms` is NaN"),
            ("drift_warning_um = 0.5", "`drift_warning_um` is 0.5: must be 1 to 10000 um"),
            ("end_stop_um = -1", "`end_stop_um` is -1: must be 0 to 10000 um"),
            ("lease_ms = 149", "`lease_ms` is 149: must be 150 to"),
            ("limits.rail_pulses_per_s = 0", "`limits.rail_pulses_per_s` is 0"),
            (
                "[participant]\nmax_amplitude = 3",
                "m.toml:2: `participant`: unknown key `max_amplitude`: did you mean `max_amplitude_um`?",
            ),
            (
                "participant.max_amplitude_um = 401",
                "`participant.max_amplitude_um` is 401: must be 1 to 400 um",
            ),
            ("participant.max_day_s = 0", "`participant.max_day_s` is 0: must be 0.1 to 86400 s"),
            ("participant.max_continuous_s = inf", "`participant.max_continuous_s` is inf"),
            ("participant.pause_s = -1", "`participant.pause_s` is -1: must be 0.1 to 3600 s"),
            ("session_silence_s = 0", "`session_silence_s` is 0: must be 0.1 to 3600 s"),
            ("limits = 3", "m.toml:1: `limits` is integer `3`: must be a table"),
            ("\nmock = []", "m.toml:2: `mock` is sequence: must be a table"),
            ("lead_ms = \"5\"", "m.toml:1: `lead_ms` is string \"5\": must be a number"),
            ("limits.motor_pulses_per_s = -1", "integer `-1`: must be a whole number, 0 to 4294967295"),
            ("mock.seed = -1", "`mock.seed` is integer `-1`: must be a whole number, 0 or more"),
            ("socket = 1", "must be a path in quotes"),
            ("patterns_dir = \"\"", "m.toml:1: `patterns_dir` is empty"),
            ("socket = \"\"", "m.toml:1: `socket` is empty"),
            ("calibration = \"\"", "m.toml:1: `calibration` is empty"),
            ("logbook_dir = \"\"", "m.toml:1: `logbook_dir` is empty"),
            ("logbook_days = 36501", "`logbook_days` is 36501: must be 0 to 36500 days"),
            ("logbook_days = -1", "integer `-1`: must be a whole number, 0 to 4294967295"),
            ("array.lower_stop = \"below\"", "unknown variant `below`"),
            (
                "array.surplus_um = \"much\"",
                "`array.surplus_um` is `much`: must be a number of um, or \"auto\"",
            ),
            ("array.surplus_um = 0", "`array.surplus_um` is 0: must be 1 to 120 um, or \"auto\""),
            ("array.surplus_um = []", "must be a number, or \"auto\""),
            ("array.rest_error_um = 0", "`array.rest_error_um` is 0: must be 0.5 to 100 um"),
            ("limits.stop_pulses_per_s = 0", "`limits.stop_pulses_per_s` is 0"),
            (
                "array.lower_stop = \"at_rest\"\nlimits.stop_pulses_per_s = 7000",
                "m.toml:2: `limits.stop_pulses_per_s` is 7000: must be 7369 to 25500 pulses/s",
            ),
            ("end_stop_um = 2000\narray.lower_stop = \"at_rest\"", "`end_stop_um` is 2000: must be at most"),
            ("mock.gain_sd = -1.0", "m.toml:1: `mock.gain_sd` is -1: must be 0 to 1"),
            ("device = \"uart\"", "m.toml:1: `device` is `uart`: not one of"),
            ("device = 3", "m.toml:1: `device` is integer `3`: must be a string"),
            ("lead_ms = ", "m.toml:1: not TOML: "),
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
