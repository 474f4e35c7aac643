//! `live`: a live play that follows its source: lines of stdin, or an input device.
//!
//! In the order of the data path: a source ([`lines`], or [`device`] with [`follower`], which turns events into poses) gives
//! messages, [`pace`] decides what to send when, and [`following`] is the loop around all of them. This module reads the arguments,
//! starts the play, and prints how it ended.
//!
//! Invariant: the loop that reads the source also sends the signs of life, so if it hangs, the daemon ends the play.

mod device;
mod follower;
mod following;
mod lines;
mod pace;
mod signals;

use super::arguments::{ClientOptions, PlayOptions, positive};
use super::output::{give, is_broken_pipe, say};
use super::{files, text};
use crate::receipts::end_text;
use anyhow::{Result, anyhow, bail};
use clap::Args;
use clap::error::ErrorKind;
use device::{Input, Opened};
use following::{End, Following, Source};
use lines::{Give, Lines};
use meissner_api::{
    ArrayDetails, EndCause, LIVE_TIMEOUT_MS, LIVE_UPDATES_HZ, LiveMessage, LiveRequest, PlayState, Receipt,
};
use meissner_array::units::TickRate;
use meissner_client::Client;
use meissner_touch::{Object, no_files};
use pace::Pace;
use serde_json::Value;
use signals::Signals;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::time::Duration;

/// How long the daemon waits for the receipt of a play that has just ended, s.
const RECEIPT_S: u8 = 2;

#[derive(Debug, Args)]
pub(super) struct Live {
    /// Press and move this object: a file (TOML with kind = "object") without files of its own, or the name of a shipped one. Without it the
    /// lines of stdin give drives
    #[arg(long)]
    object: Option<String>,
    /// Follow this source: stdin (a line: X_MM Y_MM [DEGREES [DEPTH_UM]], levels, or a JSON object), mouse (the first one), or an input device
    #[arg(long, value_name = "stdin|mouse|evdev:PATH")]
    follow: Follow,
    /// Have the pins of these motors follow levels: each line of stdin has one for each, in this order, um above rest
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', conflicts_with = "object")]
    levels: Vec<u8>,
    /// Let pins take MS milliseconds to get to a level; 0: at full speed [default: 20]
    #[arg(long, value_name = "MS", requires = "levels", allow_negative_numbers = true, value_parser = glide)]
    glide_ms: Option<f64>,
    /// Shift the shape by X mm for each count of a mouse
    #[arg(long, value_name = "X", default_value_t = 0.02, allow_negative_numbers = true, value_parser = positive)]
    mm_per_count: f64,
    /// Send at most F updates a second, each the newest state of the source; lines of a file are sent one by one [default: 50]
    #[arg(long, value_name = "F", allow_negative_numbers = true, value_parser = positive)]
    updates_hz: Option<f64>,
    /// End the play when the daemon hears nothing for MS milliseconds [default: 500]
    #[arg(long, value_name = "MS", allow_negative_numbers = true, value_parser = positive)]
    timeout_ms: Option<f64>,
    /// Go on while stdin is silent. Without it only a line of a pipe or terminal shows that the source works
    #[arg(long)]
    keep_alive: bool,
    /// Allow frequencies up to F Hz [default: the highest of the first line, at least 60]
    #[arg(long, value_name = "F", allow_negative_numbers = true, value_parser = positive)]
    max_frequency_hz: Option<f64>,
    #[command(flatten)]
    play: PlayOptions,
    #[command(flatten)]
    options: ClientOptions,
}

/// `--follow`.
#[derive(Clone, Debug, PartialEq)]
enum Follow {
    Stdin,
    Mouse,
    Device(PathBuf),
}

impl FromStr for Follow {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match (text, text.strip_prefix("evdev:")) {
            ("stdin", _) => Ok(Self::Stdin),
            ("mouse", _) => Ok(Self::Mouse),
            (_, Some(path)) if !path.is_empty() => Ok(Self::Device(path.into())),
            _ => Err("must be stdin, mouse, or evdev: and the path of a device, as evdev:/dev/input/event3"),
        }
    }
}

impl Live {
    fn request(&self) -> Result<LiveRequest> {
        let request = LiveRequest {
            drives: Vec::new(),
            object: self.object.as_deref().map(object).transpose()?,
            scale: self.play.scale,
            timeout_ms: self.timeout_ms,
            max_frequency_hz: self.max_frequency_hz,
            updates_hz: self.updates_hz,
            levels: !self.levels.is_empty(),
            late: self.play.late,
            replace: self.play.replace,
            open_loop: self.play.open_loop,
            session: self.play.session(),
            trial: self.play.trial,
            labels: self.play.labels(),
            trigger: self.play.trigger.request(),
        };
        // The source's first line may come after minutes, so refuse a bad option before.
        Ok(LiveRequest::parse(&serde_json::to_vec(&request)?)?)
    }

    /// Opens the input device, if it is to follow one.
    fn device(&self) -> Result<Option<Opened>> {
        if self.object.is_none() && self.follow != Follow::Stdin {
            let message = "name an --object: an input device moves it. Only the lines of stdin can give drives or levels\n";
            return Err(clap::Error::raw(ErrorKind::MissingRequiredArgument, message).into());
        }
        match &self.follow {
            Follow::Stdin => Ok(None),
            Follow::Mouse => Input::mouse().map(Some),
            Follow::Device(path) => Input::open(path).map(Some),
        }
    }

    fn source(&self, device: Option<Opened>, array: &ArrayDetails) -> Result<Source> {
        let Some(device) = device else { return Ok(Source::Lines(Lines::stdin(self.give(array)?)?)) };
        // To the outermost pins.
        let most = |axis: usize| array.positions_mm.iter().map(|place| place[axis].abs()).fold(0.0, f64::max);
        Ok(Source::Input(Input::new(device, self.mm_per_count, [most(0), most(1)])?.into()))
    }

    /// What lines give.
    fn give(&self, array: &ArrayDetails) -> Result<Give> {
        let motors = self.levels.clone();
        for (at, motor) in motors.iter().enumerate() {
            if motors[..at].contains(motor) {
                bail!("--levels has motor {motor} twice: leave one out");
            }
            if usize::from(*motor) >= array.positions_mm.len() {
                bail!(
                    "--levels has motor {motor}: the array has motors 0 to {}",
                    array.positions_mm.len() - 1
                );
            }
        }
        Ok(match self.object {
            Some(_) => Give::Poses,
            None if motors.is_empty() => Give::Drives,
            None => Give::Levels { motors, glide_ms: self.glide_ms },
        })
    }

    fn timeout_ms(&self) -> f64 {
        self.timeout_ms.unwrap_or(LIVE_TIMEOUT_MS)
    }
}

/// The value of `--glide-ms`.
fn glide(text: &str) -> Result<f64, &'static str> {
    let ms = text.parse().ok().filter(|ms| (0.0..=1000.0).contains(ms));
    ms.ok_or("must be 0 to 1000 ms")
}

/// An object's name, or the document in an object file.
fn object(argument: &str) -> Result<Value> {
    if !files::is_file(argument) {
        return Ok(argument.into());
    }
    let text = files::text(Path::new(argument), meissner_touch::MAX_FILE_BYTES as u64, "object")?;
    // Check it here, because this reader's errors name the line of the file.
    Object::read(&text, argument, &mut no_files)?;
    Ok(toml::from_str(&text)?)
}

pub(super) fn run(asked: &Live) -> Result<ExitCode> {
    asked.options.learn_array()?;
    let mut request = asked.request()?;
    let device = asked.device()?;
    let signals = Signals::listen()?;
    let mut client = asked.options.client()?;
    // Fail before waiting for the source's first line if there is no daemon.
    let array: ArrayDetails = client.get("/v1/array")?;
    let mut source = asked.source(device, &array)?;
    let first = match source.first(&signals)? {
        Ok(first) => first,
        Err(signal) => return Ok(exit_code(signal)),
    };
    let rest = begin_with(&mut request, first);
    let mut play = client.live(&request)?;
    let id = play.id();
    let json = asked.options.output.json;
    if !json {
        let what = asked.object.as_ref().map_or("the array", String::as_str);
        let said = say(&format!("play {id}: {what} follows {}; Ctrl-C ends it", source.shown()));
        // The reader of stdout has closed it; the play goes on, and its result counts.
        said.or_else(|error| if is_broken_pipe(&error) { Ok(()) } else { Err(error) })?;
    }
    let timeout = Duration::from_secs_f64(asked.timeout_ms() / 1e3);
    let keep_alive = asked.keep_alive || !source.must_speak();
    let mut pace = Pace::new(request.updates_hz.unwrap_or(LIVE_UPDATES_HZ), timeout, keep_alive);
    pace.hear(rest);
    let mut following = Following::new(&mut play, source, pace, &signals, TickRate::new(array.tick_hz));
    let end = following.run();
    let refused = following.summary();
    // Closing the connection ends the play, if it runs.
    drop(play);
    let receipt: Result<Receipt, _> = receipt(&mut client, id);
    if let Ok(receipt) = &receipt {
        give(json, receipt, || text::receipt(receipt))?;
    }
    match end {
        End::Signal(signal) => Ok(exit_code(signal)),
        End::Source => {
            let receipt = receipt?;
            if receipt.cause != Some(EndCause::Stop) {
                return Err(ended_by_daemon(asked, id, None, Some(&receipt)));
            }
            // Strokes that the end of the play has cut count as dropped.
            let is_whole = receipt.bursts.is_some_and(|bursts| bursts.late + bursts.refused == 0);
            Ok(if is_whole && refused == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
        }
        End::Daemon(cause) => Err(ended_by_daemon(asked, id, cause, receipt.ok().as_ref())),
        End::Failed(error) => Err(error),
    }
}

/// The exit code that shells use for a program ended by a signal.
fn exit_code(signal: u8) -> ExitCode {
    ExitCode::from(128 + signal)
}

/// Lets the play begin with the source's first state; returns what of it is sent when the play has begun: levels, and all of an object.
fn begin_with(request: &mut LiveRequest, first: LiveMessage) -> LiveMessage {
    if request.object.is_some() {
        return first;
    }
    let LiveMessage { drives, um, glide_ms, scale, .. } = first;
    request.drives = drives.unwrap_or_default();
    request.scale = scale.or(request.scale);
    LiveMessage { um, glide_ms, ..LiveMessage::default() }
}

fn receipt(client: &mut Client, id: u64) -> Result<Receipt> {
    let timeout = Duration::from_secs(u64::from(RECEIPT_S) + 3);
    Ok(client.get_within(timeout, &format!("/v1/plays/{id}?wait={RECEIPT_S}"))?)
}

/// Why the daemon ended a play, and what to do.
fn ended_by_daemon(
    asked: &Live,
    id: u64,
    cause: Option<EndCause>,
    receipt: Option<&Receipt>,
) -> anyhow::Error {
    let cause = receipt.and_then(|receipt| receipt.cause.clone()).or(cause);
    let why = match cause.as_ref() {
        None if receipt
            .is_some_and(|receipt| matches!(receipt.state, PlayState::Queued | PlayState::Running)) =>
        {
            return anyhow!("play {id} was to end, and has not yet: `meissner stop` ends it");
        }
        None => return anyhow!("the daemon ended while play {id} was running: see its log"),
        Some(EndCause::Stop) => "another client stopped it".to_owned(),
        Some(EndCause::EStop) => "an emergency stop; find out why, then `meissner reset`".to_owned(),
        Some(EndCause::ClientSilent) if asked.follow == Follow::Stdin && !asked.keep_alive => format!(
            "stdin was silent for longer than {} ms; --timeout-ms allows more, --keep-alive any time",
            asked.timeout_ms()
        ),
        Some(EndCause::ClientSilent) => {
            format!(
                "the daemon heard nothing for {} ms; was this machine busy, or the command suspended?",
                asked.timeout_ms()
            )
        }
        Some(cause) => {
            let cut_after_ms = receipt.and_then(|receipt| receipt.cut_after_ms);
            format!("{}; see `meissner status`", end_text("stopped", Some(cause), cut_after_ms))
        }
    };
    anyhow!("play {id} was ended: {why}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_is_stdin_a_mouse_or_a_device() {
        assert_eq!("stdin".parse(), Ok(Follow::Stdin));
        assert_eq!("mouse".parse(), Ok(Follow::Mouse));
        assert_eq!("evdev:/dev/input/event3".parse(), Ok(Follow::Device("/dev/input/event3".into())));
        for text in ["", "-", "evdev:", "evdev", "keyboard"] {
            assert!(text.parse::<Follow>().is_err(), "{text}");
        }
    }
}
