//! The daemon's configuration: a TOML file in which every key is optional.
//!
//! It names the device, the socket, the directories of patterns and session records, how far ahead the streamer feeds the
//! controller, and a site's limits. [`Config::read`] reads it; missing keys have their defaults. The motors' wiring is in the
//! description of the array, which it names. This module opens no file but the configuration.
//!
//! Invariant: every value of a [`Config`] that was read is within the ranges written here; an unknown key is an error.

mod array;
mod network;
mod problem;

pub use network::Listen;
pub use problem::{ConfigError, Problem};

use crate::exposure::ParticipantLimits;
use crate::file::{dir_of, read_regular};
use crate::record::Location;
use array::RawArray;
use firmware_protocol::limits::PowerLimits;
use meissner_api::request::SILENCE_S;
use meissner_array::simulated::{LowerStop, SimulatedMotorsConfig, SimulatedMotorsError};
use meissner_array::spec::{Array, MAX_MOTORS, TICK_HZ};
use meissner_client::default_socket;
use meissner_input::document::{Table, from_toml, in_range};
use meissner_input::message::quote;
use meissner_stream::device::Spec;
use meissner_stream::{LowerStopSettings, Settings};
use problem::{KeyError, checked};
use serde::Deserialize;
use std::env;
use std::io;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// The range of the lead, ms.
pub const LEAD_MS: RangeInclusive<f64> = 5.0..=1000.0;
/// The host watchdog timeout must exceed the lead by at least this, ms.
pub const MIN_LEASE_OVER_LEAD_MS: f64 = 50.0;
/// The longest host watchdog timeout that a controller takes, ms.
pub const MAX_LEASE_MS: f64 = 10_000.0;
/// The default of `session_silence_s`. An experiment that pauses between blocks still polls; after a dead one, others may soon act.
const SESSION_SILENCE_S: f64 = 120.0;
/// The default of `armed_silence_s`: longer than a break between blocks of an experiment, since older clients cannot say how long they are silent.
const ARMED_SILENCE_S: f64 = 600.0;
/// The range of the errors of dead reckoning at which the daemon warns, and refuses plays, um.
const DRIFT_UM: RangeInclusive<f64> = 1.0..=10_000.0;
/// The range of the end stops' distance from rest, um.
const END_STOP_UM: RangeInclusive<f64> = 0.0..=10_000.0;
/// The largest amplitude that a participant's limit can have, µm: that of any array.
const MAX_AMPLITUDE_UM: f64 = 5_000.0;
/// The range of a participant's times, s: up to a day.
const LIMIT_S: RangeInclusive<f64> = 0.1..=86_400.0;
/// The range of a pause, s.
const PAUSE_S: RangeInclusive<f64> = 0.5..=3600.0;
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
    /// Where network clients connect; `None`: nothing listens there.
    pub listen: Option<Listen>,
    /// The file of the access tokens; `None`: tokens are lost when the daemon ends.
    pub tokens: Option<PathBuf>,
    /// The site's own patterns.
    pub patterns: PatternsDir,
    /// The file of the calibration; `None`: it is not stored.
    pub calibration: Option<PathBuf>,
    /// Where the session record is kept; `None`: there is no session record.
    pub logbook: Option<Location>,
    /// How long the owner of an exclusive session may be silent before others may act, s.
    pub session_silence_s: f64,
    /// How long a client that has armed without `silence_s` may be silent, s.
    pub armed_silence_s: f64,
    /// The exposure limits for a participant.
    pub participant: ParticipantLimits,
    /// The settings of the streamer.
    pub settings: Settings,
    /// The simulated array.
    pub mock: SimulatedMotorsConfig,
}

/// The directory of the site's own patterns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PatternsDir {
    /// Named by the configuration: it must exist.
    Configured(PathBuf),
    /// The default of the user or the service: it is made when a pattern is first stored.
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
            logbook: keep(None),
            session_silence_s: SESSION_SILENCE_S,
            armed_silence_s: ARMED_SILENCE_S,
            participant: ParticipantLimits::default(),
            settings: Settings::of(Array::default()),
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
    /// Replaces the array of the file.
    pub array: Option<Array>,
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
        let file = self.file.as_deref();
        let text = file.map_or_else(|| Ok(String::new()), read_text)?;
        let mut config = parse(&text, file.unwrap_or(Path::new("")), self.listen, self.array)?;
        if let Some(device) = &self.device {
            config.device = device.clone();
        }
        if let Some(socket) = &self.socket {
            config.socket.clone_from(socket);
        }
        if self.no_record {
            config.logbook = None;
        }
        if config.device == (Spec::MockBoard { lower_stop: true }) {
            config.add_lower_stop();
        }
        Ok(config)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawConfig {
    device: Option<String>,
    socket: Option<PathBuf>,
    listen: Option<String>,
    listen_hosts: Option<Vec<String>>,
    listen_origins: Option<Vec<String>>,
    listen_token: Option<String>,
    tokens: Option<PathBuf>,
    patterns_dir: Option<PathBuf>,
    calibration: Option<PathBuf>,
    logbook_dir: Option<PathBuf>,
    lead_ms: Option<f64>,
    lease_ms: Option<f64>,
    drift_warning_um: Option<f64>,
    drift_limit_um: Option<f64>,
    end_stop_um: Option<f64>,
    session_silence_s: Option<f64>,
    armed_silence_s: Option<f64>,
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
    fn check(self, array: Array) -> Result<ParticipantLimits, KeyError> {
        let (default, travel_um) = (ParticipantLimits::default(), array.motor().travel_um);
        let seconds =
            |key, found, default| checked(&format!("participant.{key}"), found, default, LIMIT_S, "s");
        let (um, pause) = ("participant.max_amplitude_um", "participant.pause_s");
        Ok(ParticipantLimits {
            max_amplitude_um: checked(
                um,
                self.max_amplitude_um,
                default.max_amplitude_um,
                1.0..=MAX_AMPLITUDE_UM,
                "um",
            )?
            .min(travel_um),
            max_continuous_s: seconds("max_continuous_s", self.max_continuous_s, default.max_continuous_s)?,
            pause_s: checked(pause, self.pause_s, default.pause_s, PAUSE_S, "s")?,
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
    /// Simulates an array with a lower stop, and makes use of it.
    pub fn add_lower_stop(&mut self) {
        self.settings.lower_stop.get_or_insert(LowerStopSettings::of(self.settings.array));
        self.mock.lower_stop = LowerStop::AtRest;
    }

    /// Reads a configuration file.
    ///
    /// # Errors
    /// The first problem, in one line.
    pub fn read(file: &Path) -> Result<Self, ConfigError> {
        parse(&read_text(file)?, file, None, None)
    }

    /// Reads the text of a configuration; `file` is its name in errors.
    ///
    /// # Errors
    /// The first problem, in one line.
    pub fn parse(text: &str, file: &Path) -> Result<Self, ConfigError> {
        parse(text, file, None, None)
    }
}

impl RawConfig {
    /// `folder` is where paths of descriptions begin.
    fn check(self, array: Option<Array>, folder: &Path) -> Result<Config, KeyError> {
        let Table(raw_array) = self.array.unwrap_or(Table(RawArray::default()));
        let array = array.map_or_else(|| raw_array.description(folder), Ok)?;
        let device = self.device.as_deref().map_or(Ok(Spec::Auto), |found| {
            let problem = |source| Problem::Device { found: quote(found), source };
            found.parse().map_err(|source| KeyError::key("device", problem(source)))
        })?;
        check_path("socket", self.socket.as_deref())?;
        check_path("tokens", self.tokens.as_deref())?;
        let [address, token] = [self.listen.as_deref(), self.listen_token.as_deref()];
        let listen = network::check(address, self.listen_hosts, self.listen_origins, token)?;
        check_path("patterns_dir", self.patterns_dir.as_deref())?;
        check_path("calibration", self.calibration.as_deref())?;
        check_path("logbook_dir", self.logbook_dir.as_deref())?;
        let default = Settings::of(array);
        let lead_ms = checked("lead_ms", self.lead_ms, default.lead_ms, LEAD_MS, "ms")?;
        let lease_ms = self.lease_ms.unwrap_or(Settings::for_lead(array, lead_ms).lease_ms);
        let least = lead_ms + MIN_LEASE_OVER_LEAD_MS;
        let range = format!("{least} to {MAX_LEASE_MS} ms, at least lead_ms + {MIN_LEASE_OVER_LEAD_MS}");
        in_range("lease_ms", lease_ms, (least..=MAX_LEASE_MS).contains(&lease_ms), range)?;
        let drift = |key, found, default: f32| {
            checked(key, found, default.into(), DRIFT_UM, "um").map(|um| um as f32)
        };
        let drift_warning_um = drift("drift_warning_um", self.drift_warning_um, default.drift_warning_um)?;
        let drift_limit_um = drift("drift_limit_um", self.drift_limit_um, default.drift_limit_um)?;
        let Table(limits) = self.limits.unwrap_or(Table(RawLimits::default()));
        // Every motor may begin a pulse in every tick.
        let hz = array.rate().hz();
        let most = PowerLimits {
            motor: hz,
            rail: hz * array.rails().largest() as u32,
            rail_at_once: array.rails().largest() as u8,
            chip_at_once: array.chips().largest() as u8,
        };
        // A limit above what the array can reach limits nothing: the same file serves other arrays.
        let limit = |key, found: Option<u32>, of_array: u32, most: u32| {
            let range = 1.0..=f64::from(most);
            let found = checked(key, found.map(f64::from), of_array.into(), range, "pulses/s");
            found.map(|found| (found as u32).min(of_array))
        };
        let most_hz = *TICK_HZ.end();
        let motor = limit("limits.motor_pulses_per_s", limits.motor_pulses_per_s, most.motor, most_hz)?;
        let (key, most_of_rail) = ("limits.rail_pulses_per_s", MAX_MOTORS as u32 * most_hz);
        let rail = limit(key, limits.rail_pulses_per_s, most.rail, most_of_rail)?;
        let (silence, range) = (self.session_silence_s, 0.1..=3600.0);
        let session_silence_s = checked("session_silence_s", silence, SESSION_SILENCE_S, range, "s")?;
        let silence = self.armed_silence_s;
        let armed_silence_s = checked("armed_silence_s", silence, ARMED_SILENCE_S, SILENCE_S, "s")?;
        let Table(participant) = self.participant.unwrap_or(Table(RawParticipant::default()));
        let participant = participant.check(array)?;
        let Table(mut mock) = self.mock.unwrap_or(Table(SimulatedMotorsConfig::default()));
        if let Err(SimulatedMotorsError { key, found, most }) = mock.check() {
            in_range(&format!("mock.{key}"), found, false, format!("0 to {most}"))?;
        }
        // The simulated array's own end stops, unless the file names those of the motors.
        let end_stop_um = checked("end_stop_um", self.end_stop_um, mock.end_stop_um, END_STOP_UM, "um")?;
        let stop_pulses_per_s = limits.stop_pulses_per_s;
        let limits = raw_array.limits(PowerLimits { motor, rail, ..most })?;
        let end_stop_um = end_stop_um as f32;
        let settings = Settings {
            array,
            lead_ms,
            lease_ms,
            limits,
            drift_warning_um,
            drift_limit_um,
            end_stop_um,
            lower_stop: None,
        };
        let lower_stop = raw_array.check(stop_pulses_per_s, &settings)?;
        if lower_stop.is_some() {
            // Simulate an array like the site's.
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
            logbook: keep(self.logbook_dir),
            session_silence_s,
            armed_silence_s,
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

/// Where the session record is kept: the given directory, else the service's state directory, else the user's.
fn keep(dir: Option<PathBuf>) -> Option<Location> {
    let user = || {
        let state =
            variable("XDG_STATE_HOME").or_else(|| variable("HOME").map(|dir| dir.join(".local/state")));
        state.map(|dir| (dir.join("meissner/logbook"), true))
    };
    let known = dir.or_else(|| state_dir().map(|dir| dir.join("logbook"))).map(|dir| (dir, false));
    let (dir, make_parents) = known.or_else(user)?;
    Some(Location { dir, make_parents })
}

/// The default place of a file that the daemon writes: beside the site's own patterns.
fn beside(patterns: &PatternsDir, file: &str) -> Option<PathBuf> {
    let (PatternsDir::Configured(dir) | PatternsDir::Default(dir)) = patterns else { return None };
    Some(dir.parent().unwrap_or(Path::new("")).join(file))
}

fn read_text(file: &Path) -> Result<String, ConfigError> {
    let wrong = |source| ConfigError::Read { file: file.to_owned(), source };
    let bytes = read_regular(file, MAX_BYTES).map_err(wrong)?;
    String::from_utf8(bytes).map_err(|_| wrong(io::Error::other("not UTF-8 text")))
}

/// Reads the text of a configuration; `listen` replaces its address, and `array` its array. The keys beside them apply to both.
fn parse(
    text: &str,
    file: &Path,
    listen: Option<SocketAddr>,
    array: Option<Array>,
) -> Result<Config, ConfigError> {
    // Every key may be left out.
    let wanted = |_: &str| "it";
    let config = from_toml(text, wanted).and_then(|Table(mut raw): Table<RawConfig>| {
        raw.listen = listen.map(|address| address.to_string()).or(raw.listen);
        raw.check(array, dir_of(file))
    });
    Ok(config.map_err(|fault: KeyError| fault.in_text(text).in_file(Some(&file.display().to_string())))?)
}

#[cfg(test)]
mod tests;
