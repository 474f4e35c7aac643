//! Arguments that several commands share, and the types of their values.

use super::session_token;
use crate::array::{find, shown};
use anyhow::{Result, bail};
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use meissner_api::{ArrayDetails, LatePolicy, TriggerRequest, TriggerShape};
use meissner_array::spec::Array;
use meissner_client::{Client, Endpoint};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The options of every command that asks a daemon.
#[derive(Debug, Args)]
pub(super) struct ClientOptions {
    /// Connect to the daemon at PATH [default: $MEISSNER_URL, else $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and
    /// /run/meissner/meissner.sock at which a daemon listens]
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
    /// Connect to a daemon on the network, such as http://lab-pc:8765, with the access token in $MEISSNER_TOKEN
    #[arg(long, value_name = "URL", conflicts_with = "socket")]
    connect: Option<String>,
    #[command(flatten)]
    pub(super) output: Output,
}

#[derive(Clone, Copy, Debug, Args)]
pub(super) struct Output {
    /// Print one JSON document on stdout and nothing else
    #[arg(long)]
    pub(super) json: bool,
}

impl ClientOptions {
    /// A client. It has the owner's token if this terminal has started a session.
    pub(super) fn client(&self) -> Result<Client> {
        let mut client = Client::at(self.endpoint())?;
        client.set_token(session_token::find());
        Ok(client)
    }

    /// Makes the name of the daemon's array known here, if a daemon answers: then files that name it can be read.
    pub(super) fn learn_array(&self) -> Result<()> {
        if let Ok(details) = self.client()?.get::<ArrayDetails>("/v1/array") {
            shown(&details)?;
        }
        Ok(())
    }

    pub(super) fn endpoint(&self) -> Endpoint {
        match (&self.socket, &self.connect) {
            (Some(socket), _) => Endpoint::at(socket),
            (None, Some(url)) => Endpoint::on_network(url),
            (None, None) => Endpoint::find(),
        }
    }
}

/// The options of every command that starts a play.
#[derive(Debug, Args)]
pub(super) struct PlayOptions {
    /// Choose what happens to late strokes
    #[arg(long, default_value = "drop", value_parser = choice::<LatePolicy>(&[("drop", "Drop them whole and go on"), ("abort", "End the play")]))]
    pub(super) late: LatePolicy,
    /// Stop the running play and clear the queue first
    #[arg(long)]
    pub(super) replace: bool,
    /// Play without corrections from telemetry
    #[arg(long)]
    pub(super) open_loop: bool,
    /// Refuse the play unless the session with this id runs [default: the session that this terminal has started]
    #[arg(long, value_name = "ID")]
    session: Option<String>,
    /// Record the play as trial N
    #[arg(long, value_name = "N")]
    pub(super) trial: Option<u64>,
    /// Record the play with a label; up to 16 of them
    #[arg(long = "label", value_name = "KEY=VALUE", value_parser = label)]
    labels: Vec<(String, String)>,
    /// Multiply the amplitude of every drive by X, 0 to 1
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = positive)]
    pub(super) scale: Option<f64>,
    #[command(flatten)]
    pub(super) trigger: TriggerOptions,
}

impl PlayOptions {
    pub(super) fn named_session(&self) -> Option<String> {
        self.session.clone()
    }

    pub(super) fn labels(&self) -> BTreeMap<String, String> {
        self.labels.iter().cloned().collect()
    }
}

/// The choices of `--fit`.
pub(super) const FITS: &[(&str, &str)] = &[
    ("whole", "Those that have ended by then: a little shorter than asked for"),
    ("cover", "Those that begin before: a little longer"),
];

/// What the trigger output gives at the onset; without an option one pulse of 10 ms.
#[derive(Debug, Args)]
pub(super) struct TriggerOptions {
    /// Give the code N, 1 to 255, on the trigger output instead of one pulse
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    code: Option<u8>,
    /// Make the trigger's pulse, or each of a code's ten cells, MS milliseconds wide
    #[arg(long, value_name = "MS", allow_negative_numbers = true, value_parser = positive)]
    trigger_ms: Option<f64>,
    /// Give nothing on the trigger output
    #[arg(long, conflicts_with_all = ["code", "trigger_ms"])]
    no_trigger: bool,
}

impl TriggerOptions {
    pub(super) fn request(&self) -> Option<TriggerRequest> {
        let Self { code, trigger_ms: width_ms, no_trigger } = *self;
        let shape = TriggerShape { width_ms, code };
        let asked = shape != TriggerShape::default();
        if no_trigger { Some(TriggerRequest::Off) } else { asked.then_some(TriggerRequest::On(shape)) }
    }
}

/// What a search may choose, by `--setting`.
pub(super) const SETTINGS: &[(&str, &str)] = &[
    ("default", "Motors may be off; 5 to 150 Hz"),
    ("always_on", "All motors vibrate, as in the paper; 5 to 300 Hz"),
];

/// A finite number, 0 or more. The daemon checks the upper bound.
pub(super) fn positive(text: &str) -> Result<f64, &'static str> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or("must be a number, 0 or more")
}

/// The array of a command whose pattern, scene or target can name it.
#[derive(Debug, Args)]
pub(super) struct ArrayOption {
    /// Use the array ARRAY: a name, or the file of a description [default: that of the pattern, scene or target, else tula35-6x4]
    #[arg(long, value_name = "ARRAY")]
    array: Option<String>,
}

impl ArrayOption {
    /// The array, if the command line names one. From now on its name is known.
    pub(super) fn find(&self) -> Result<Option<Array>> {
        self.array.as_deref().map(array).transpose()
    }

    /// Refuses a file of another array than the command line names.
    pub(super) fn check(&self, file: &str, its: Array) -> Result<()> {
        match self.find()? {
            Some(asked) if asked != its => bail!(
                "{file}: is for the array {}, and --array names {}: leave --array out, or name a file for that array",
                its.name(),
                asked.name()
            ),
            _ => Ok(()),
        }
    }
}

/// The array of a command that takes the paper's if the command line names none.
#[derive(Debug, Args)]
pub(super) struct PaperArrayOption {
    /// Use the array ARRAY: a name, or the file of a description [default: tula35-6x4]
    #[arg(long, value_name = "ARRAY")]
    array: Option<String>,
}

impl PaperArrayOption {
    /// The array. From now on its name is known.
    pub(super) fn find(&self) -> Result<Array> {
        Ok(self.array.as_deref().map(array).transpose()?.unwrap_or_default())
    }
}

/// The array of this name, or of the description in this file.
pub(super) fn array(text: &str) -> Result<Array> {
    Ok(find(text, Path::new(""))?)
}

/// How long to measure, s.
pub(super) fn measured(text: &str) -> Result<f64, &'static str> {
    let number = text.parse().ok().filter(|number| (0.1..=3600.0).contains(number));
    number.ok_or("must be a number, 0.1 to 3600")
}

/// A label.
pub(super) fn label(text: &str) -> Result<(String, String), &'static str> {
    let (key, value) = text.split_once('=').ok_or("must be KEY=VALUE")?;
    Ok((key.to_owned(), value.to_owned()))
}

/// A part of a day, h.
pub(super) fn hours(text: &str) -> Result<f64, &'static str> {
    let number = text.parse().ok().filter(|number| (0.0..=24.0).contains(number));
    number.ok_or("must be a number, 0 to 24")
}

/// When a play begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Onset {
    Tick(u64),
    AfterMs(f64),
    MonotonicNs(u64),
}

impl Onset {
    /// The values of the keys `at_tick`, `at_ms` and `at_monotonic_ns` of a request.
    pub(super) const fn keys(at: Option<Self>) -> (Option<u64>, Option<f64>, Option<u64>) {
        match at {
            None => (None, None, None),
            Some(Self::Tick(tick)) => (Some(tick), None, None),
            Some(Self::AfterMs(ms)) => (None, Some(ms), None),
            Some(Self::MonotonicNs(ns)) => (None, None, Some(ns)),
        }
    }
}

impl FromStr for Onset {
    type Err = &'static str;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if let Some(ns) = text.strip_prefix('@') {
            let ns = ns.parse().map(Self::MonotonicNs);
            return ns
                .map_err(|_| "after the @ there must be nanoseconds of CLOCK_MONOTONIC, a whole number");
        }
        match text.strip_prefix('+') {
            Some(ms) => positive(ms)
                .map(Self::AfterMs)
                .map_err(|_| "after the + there must be a number of milliseconds, 0 or more"),
            None => text
                .parse()
                .map(Self::Tick)
                .map_err(|_| "must be a tick (a whole number), + and milliseconds, or @ and nanoseconds"),
        }
    }
}

/// How edges of the trigger input start and stop a play.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct EdgeOptions {
    /// Begin MS milliseconds after an edge of the device's trigger input, exact to the tick: the first edge after the plays before are over
    #[arg(long, value_name = "MS", conflicts_with = "at", allow_negative_numbers = true, value_parser = positive)]
    pub(super) on_edge: Option<f64>,
    /// Stop at the first edge of the trigger input after the onset, and clear the queue
    #[arg(long)]
    pub(super) stop_on_edge: bool,
}

/// Parses one of `values`, each with its help, as the type `T` that serde reads from the value's name.
pub(super) fn choice<T: DeserializeOwned + Clone + Send + Sync + 'static>(
    values: &'static [(&'static str, &'static str)],
) -> impl TypedValueParser<Value = T> {
    let values = values.iter().map(|(name, help)| PossibleValue::new(name).help(help));
    PossibleValuesParser::new(values).try_map(|name| serde_json::from_value(name.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_onset_is_a_tick_a_delay_or_an_instant() {
        assert_eq!("4294967296".parse(), Ok(Onset::Tick(1 << 32)));
        assert_eq!("+12.5".parse(), Ok(Onset::AfterMs(12.5)));
        assert_eq!("@75793647058823".parse(), Ok(Onset::MonotonicNs(75_793_647_058_823)));
        for text in ["soon", "+", "-3", "+-3", "+nan", "+inf", "@", "@-3", "@1.5"] {
            assert!(text.parse::<Onset>().is_err(), "{text}");
        }
    }
}
