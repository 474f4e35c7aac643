//! The command line: what is asked for, and where the answer goes.
//!
//! Each command is a function that prints its answer on stdout: with `--json` one document and nothing else. Logs
//! and bars go to stderr. A command that fails prints one line, `meissner: what, where, what to do`, and exits
//! with 1; one that cannot be understood exits with 2. Nothing is decided here that a script could not decide
//! through the API.
//!
//! Invariant: names and flags are stable; a command that is not built does not exist.

mod calibrate;
mod control;
mod demo;
mod doctor;
mod files;
mod library;
mod optimise;
mod progress;
mod report;
mod simulate;
mod text;
mod tradeoff;
mod watch;

use crate::config::Source;
use crate::daemon::{self, Daemon, DaemonError, Exit, Signals};
use crate::log;
use anyhow::{Result, anyhow};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, CommandFactory, Parser, Subcommand};
use meissner_api::LatePolicy;
use meissner_client::{Client, Endpoint};
use meissner_stream::device::Spec;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{self, BufWriter, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::Duration;
use tracing::Level;

/// Real-time driver daemon for piezo pin-array tactile displays.
#[derive(Debug, Parser)]
#[command(name = "meissner", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Daemon, simulated device and client in one process: plays a shipped edge and sums it up
    Demo {
        /// How long it plays
        #[arg(long, value_name = "S", default_value_t = 5.0, allow_negative_numbers = true, value_parser = positive)]
        seconds: f64,
        /// No corrections from telemetry
        #[arg(long)]
        open_loop: bool,
        #[command(flatten)]
        output: Output,
    },
    /// Drive a device for the clients of a socket, until SIGTERM
    Daemon {
        /// Configuration file (TOML)
        #[arg(long, value_name = "F")]
        config: Option<PathBuf>,
        /// Only say whether the configuration is good; exit 1 if it is not
        #[arg(long)]
        check_config: bool,
        /// auto, mock, pty, serial[:PATH|:SERIAL|:VID:PID[:SERIAL]] or usb[:SERIAL] [default: the configuration's, else auto]
        #[arg(long, value_name = "DEVICE")]
        device: Option<Spec>,
        /// Where clients connect [default: the configuration's, else $MEISSNER_SOCKET, else
        /// $XDG_RUNTIME_DIR/meissner.sock, else /run/meissner/meissner.sock]
        #[arg(long, value_name = "PATH")]
        socket: Option<PathBuf>,
    },
    /// Play a pattern, behind what is queued
    Play(Play),
    /// End the running play and clear the queue; stays armed
    Stop(Plain),
    /// All lines off at once, latched until `reset`
    Estop(Plain),
    /// Leave an emergency stop or fault: disarmed
    Reset(Plain),
    /// Take strokes from now on
    Arm {
        /// Take every pin as being at rest: only after looking
        #[arg(long)]
        assume_rest: bool,
        #[command(flatten)]
        plain: Plain,
    },
    /// Return pins, motors off
    Disarm(Plain),
    /// Move pins to where they ought to rest, between plays
    Home(Plain),
    /// Measure what each motor really does: plays bursts for a minute, open loop, and stores the gains; motors must be armed
    Calibrate(calibrate::Calibrate),
    /// All patterns
    List(Plain),
    /// A pattern: its motors, drives and warnings
    Show {
        /// Its name
        name: String,
        #[command(flatten)]
        plain: Plain,
    },
    /// Store a pattern file with the daemon, under the name in it
    Import {
        /// The file (TOML)
        file: PathBuf,
        #[command(flatten)]
        plain: Plain,
    },
    /// Show how everything stands
    Status {
        /// Again at every change
        #[arg(long)]
        watch: bool,
        #[command(flatten)]
        plain: Plain,
    },
    /// What happens, as it happens; with --json one document per line
    Events(Plain),
    /// What came of a play
    Receipt {
        /// Its id; without it, the last one
        id: Option<u64>,
        #[command(flatten)]
        plain: Plain,
    },
    /// What a drive comes to in the steady state, by the motor model
    Motor {
        /// Its frequency
        #[arg(long, value_name = "F", allow_negative_numbers = true)]
        frequency_hz: f64,
        /// Its amplitude, peak to peak
        #[arg(long, value_name = "A", allow_negative_numbers = true)]
        amplitude_um: f64,
        #[command(flatten)]
        output: Output,
    },
    /// What the skin's receptors make of a scene: spikes and rates
    Simulate(simulate::Simulate),
    /// The pattern that makes a target felt
    Optimise(optimise::Optimise),
    /// Time and error of every way to simulate a scene, measured on this machine; or what the streamer's lead is worth
    #[command(name = "tradeoff")]
    MethodTradeoff(tradeoff::MethodTradeoff),
    /// Figures of the models and of patterns, as SVG and CSV, and a page that shows them
    Report(report::Report),
    /// Look for what could keep this machine or its device from playing; exit 0 only if nothing does
    Doctor {
        /// Which device, as for `daemon`; without it, the daemon's, else the first board
        #[arg(long, value_name = "DEVICE")]
        device: Option<Spec>,
        /// How long wake-ups are measured, 0.1 to 3600: the longer, the rarer the stalls it sees
        #[arg(long, value_name = "S", default_value_t = 5.0, allow_negative_numbers = true, value_parser = measured)]
        seconds: f64,
        #[command(flatten)]
        plain: Plain,
    },
}

#[derive(Debug, Args)]
struct Play {
    /// Which pattern
    name: String,
    /// Cuts it, or repeats it if it has a duration
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = positive)]
    seconds: Option<f64>,
    /// A tick of the device's clock, or so many ms after the order
    #[arg(long, value_name = "TICK|+MS")]
    at: Option<Onset>,
    /// What to do when strokes come late
    #[arg(long, default_value = "drop", value_parser = choice::<LatePolicy>(&[("drop", "Drop them whole and go on"), ("abort", "End the play")]))]
    late: LatePolicy,
    /// Stop what runs and clear the queue first
    #[arg(long)]
    replace: bool,
    /// No corrections from telemetry
    #[arg(long)]
    open_loop: bool,
    /// Wait for its end and sum it up; exit 1 if not all was played. Ctrl-C ends the waiting (exit 130), not the play
    #[arg(long)]
    wait: bool,
    #[command(flatten)]
    plain: Plain,
}

/// What a client command needs.
#[derive(Debug, Args)]
struct Plain {
    /// The daemon's socket [default: $MEISSNER_SOCKET, else the first of $XDG_RUNTIME_DIR/meissner.sock and
    /// /run/meissner/meissner.sock at which a daemon listens]
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
    #[command(flatten)]
    output: Output,
}

#[derive(Clone, Copy, Debug, Args)]
struct Output {
    /// One JSON document on stdout and nothing else
    #[arg(long)]
    json: bool,
}

impl Plain {
    fn client(&self) -> Result<Client> {
        Ok(Client::at(self.endpoint())?)
    }

    fn endpoint(&self) -> Endpoint {
        self.socket.as_deref().map_or_else(Endpoint::find, Endpoint::at)
    }
}

/// A finite number, not negative. How much is too much, the daemon says.
fn positive(text: &str) -> Result<f64, &'static str> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or("a number is wanted, 0 or more")
}

/// How long something is measured, s.
fn measured(text: &str) -> Result<f64, &'static str> {
    let number = text.parse().ok().filter(|number| (0.1..=3600.0).contains(number));
    number.ok_or("a number is wanted, 0.1 to 3600")
}

/// `--at`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Onset {
    Tick(u64),
    AfterMs(f64),
}

impl FromStr for Onset {
    type Err = &'static str;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.strip_prefix('+') {
            Some(ms) => {
                let wrong = "after the + a number of milliseconds is wanted, 0 or more";
                positive(ms).map(Self::AfterMs).map_err(|_| wrong)
            }
            None => {
                text.parse().map(Self::Tick).map_err(|_| "a tick (a whole number), or + and milliseconds")
            }
        }
    }
}

/// Values of a flag, each with what it means, as the type `T` that serde reads from the value's name.
fn choice<T: DeserializeOwned + Clone + Send + Sync + 'static>(
    values: &'static [(&'static str, &'static str)],
) -> impl TypedValueParser<Value = T> {
    let values = values.iter().map(|(name, help)| PossibleValue::new(name).help(help));
    PossibleValuesParser::new(values).try_map(|name| serde_json::from_value(name.into()))
}

/// All commands and their flags, as clap knows them: what manual pages and shell completions are made from.
#[must_use]
pub fn command() -> clap::Command {
    Cli::command()
}

/// Runs the program.
#[must_use]
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let level = if matches!(cli.command, Command::Daemon { .. }) { Level::INFO } else { Level::WARN };
    log::start(level);
    match run(cli.command) {
        Ok(code) => code,
        // Whoever read the output has seen enough.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // If stderr is gone too, nobody is left to tell.
            let _ = writeln!(io::stderr(), "meissner: {error}");
            ExitCode::FAILURE
        }
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

fn run(command: Command) -> Result<ExitCode> {
    match command {
        Command::Demo { seconds, open_loop, output } => demo::run(seconds, open_loop, output.json),
        Command::Daemon { config, check_config: check, device, socket } => {
            let source = Source { file: config, device, socket };
            if check { check_config(&source) } else { serve(source) }
        }
        Command::Play(play) => control::play(&play),
        Command::Stop(plain) => control::command(&plain, "stop"),
        Command::Estop(plain) => control::estop(&plain),
        Command::Reset(plain) => control::command(&plain, "reset"),
        Command::Arm { assume_rest, plain } => control::arm(&plain, assume_rest),
        Command::Disarm(plain) => control::command(&plain, "disarm"),
        Command::Home(plain) => control::home(&plain),
        Command::Calibrate(asked) => calibrate::run(&asked),
        Command::List(plain) => library::list(&plain),
        Command::Show { name, plain } => library::show(&plain, &name),
        Command::Import { file, plain } => library::import(&plain, &file),
        Command::Status { watch, plain } => watch::status(&plain, watch),
        Command::Events(plain) => watch::events(&plain),
        Command::Receipt { id, plain } => watch::receipt(&plain, id),
        Command::Motor { frequency_hz, amplitude_um, output } => {
            library::motor(frequency_hz, amplitude_um, output.json)
        }
        Command::Simulate(asked) => simulate::run(&asked),
        Command::Optimise(asked) => optimise::run(&asked),
        Command::MethodTradeoff(asked) => tradeoff::run(&asked),
        Command::Report(asked) => report::run(&asked),
        Command::Doctor { device, seconds, plain } => {
            doctor::run(device, Duration::from_secs_f64(seconds), &plain)
        }
    }
}

/// How a daemon ends that wants to be started again, as the unit knows (`RestartForceExitStatus=`): EX_TEMPFAIL.
const START_AGAIN: u8 = 75;

fn serve(source: Source) -> Result<ExitCode> {
    let config = source.read()?;
    let runtime = daemon::runtime()?;
    let ended = runtime.block_on(async {
        let signals = Signals::new()?;
        let daemon = Daemon::start(&config).map_err(|error| named(&source, error))?;
        anyhow::Ok(daemon.run(signals, Some(source)).await?)
    });
    // What hangs in a disk is not waited for.
    runtime.shutdown_background();
    Ok(match ended? {
        Exit::Requested => ExitCode::SUCCESS,
        Exit::Replaced => ExitCode::from(START_AGAIN),
    })
}

/// What a daemon would refuse of the configuration, or complain of.
fn check_config(source: &Source) -> Result<ExitCode> {
    let config = source.read()?;
    daemon::check(&config).map_err(|error| named(source, error))?;
    match &source.file {
        Some(file) => say(&format!("{}: good", file.display()))?,
        None => say("no file was named with --config: every key has its default, which is good")?,
    }
    Ok(ExitCode::SUCCESS)
}

/// With the file in which it has to be mended.
fn named(source: &Source, error: DaemonError) -> anyhow::Error {
    match (&source.file, error) {
        (Some(file), error @ (DaemonError::Store(_) | DaemonError::SessionRecord { .. })) => {
            anyhow!("{}: {error}", file.display())
        }
        (_, error) => error.into(),
    }
}

/// Prints a line, or many.
fn say(text: &str) -> Result<()> {
    Ok(writeln!(io::stdout(), "{text}")?)
}

/// Prints the answer: as a document, or as text. Whether it was good does not depend on who has read it.
fn give(json: bool, document: &impl Serialize, text: impl FnOnce() -> String) -> Result<()> {
    match if json { say_json(document) } else { say(&text()) } {
        Err(error) if is_broken_pipe(&error) => Ok(()),
        said => said,
    }
}

/// Prints the document of `--json`, on one line, while it is made: it may be as large as a simulation's spikes.
fn say_json(document: &impl Serialize) -> Result<()> {
    let mut out = BufWriter::new(io::stdout().lock());
    serde_json::to_writer(&mut out, document).map_err(io::Error::from)?;
    out.write_all(b"\n")?;
    Ok(out.flush()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
    }

    #[test]
    fn an_onset_is_a_tick_or_a_delay() {
        assert_eq!("4294967296".parse(), Ok(Onset::Tick(1 << 32)));
        assert_eq!("+12.5".parse(), Ok(Onset::AfterMs(12.5)));
        assert!(
            "soon".parse::<Onset>().is_err()
                && "+".parse::<Onset>().is_err()
                && "-3".parse::<Onset>().is_err()
                && "+-3".parse::<Onset>().is_err()
                && "+nan".parse::<Onset>().is_err()
                && "+inf".parse::<Onset>().is_err()
        );
    }
}
