//! The command line: parses arguments, runs the command, prints its answer.
//!
//! Each command is a function that prints its answer on stdout; with `--json`, one document and nothing else. Logs and progress
//! bars go to stderr. A command that fails prints one line, `meissner: what, where, what to do`, and exits with 1; a command line
//! that cannot be understood exits with 2. Commands use the API like any client.
//!
//! Invariant: names and flags are stable; there are no placeholders for future commands.

mod answer;
mod arguments;
mod array;
mod calibrate;
mod control;
mod demo;
mod displacement;
mod doctor;
mod ending;
pub(crate) mod export;
mod files;
mod gate;
mod judge;
mod library;
mod manual;
mod motions;
mod motor;
mod object;
mod optimise;
mod output;
mod pattern;
mod pattern_file;
mod plan;
mod progress;
mod render;
mod session;
mod session_token;
mod simulate;
mod text;
mod token;
mod tradeoff;
mod validate;
mod watch;

use crate::config::Source;
use crate::daemon::{self, Daemon, DaemonError, Signals};
use crate::{log, render_process};
use anyhow::{Result, anyhow};
use arguments::{ClientOptions, Output, PaperArrayOption, measured, positive};
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
use meissner_api::ArmRequest;
use meissner_stream::device::Spec;
use output::{is_broken_pipe, say, tell};
use rustix::fs::Mode;
use rustix::process::umask;
use std::env;
use std::ffi::OsString;
use std::net::SocketAddr;
use std::os::unix::process::ExitStatusExt;
use std::panic::{self, AssertUnwindSafe};
use std::path::PathBuf;
use std::process::{self, ExitCode, ExitStatus};
use std::time::Duration;
use tracing::Level;

/// Real-time driver daemon for piezo pin-array tactile displays.
#[derive(Debug, Parser)]
#[command(name = "meissner", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Play a shipped edge on a simulated array and print a summary: daemon, device and client in one process
    Demo {
        /// Play for S seconds
        #[arg(long, value_name = "S", default_value_t = 5.0, allow_negative_numbers = true, value_parser = positive)]
        seconds: f64,
        #[command(flatten)]
        array: PaperArrayOption,
        /// Play without corrections from telemetry
        #[arg(long)]
        open_loop: bool,
        /// Simulate an array without telemetry that has a lower stop, as a board may
        #[arg(long, conflicts_with = "open_loop")]
        sensorless: bool,
        /// Serve the page on this machine, and go on after the plays until Ctrl-C
        #[arg(long, conflicts_with = "json")]
        page: bool,
        #[command(flatten)]
        output: Output,
    },
    /// Drive a device for the clients of a socket, until SIGTERM
    Daemon {
        /// Read the configuration from file F (TOML)
        #[arg(long, value_name = "F")]
        config: Option<PathBuf>,
        /// Check the configuration and end; exit 1 if it is not valid
        #[arg(long)]
        check_config: bool,
        /// Use this device: auto, mock, mock:board[,lower-stop], pty, serial[:PATH|:SERIAL|:VID:PID[:SERIAL]] or usb[:SERIAL] [default: the
        /// configuration's, else auto]
        #[arg(long, value_name = "DEVICE")]
        device: Option<Spec>,
        /// Drive the array ARRAY: a name, or the file of a description [default: the configuration's, else the paper's]
        #[arg(long, value_name = "ARRAY")]
        array: Option<String>,
        /// Listen for clients at PATH [default: the configuration's, else $MEISSNER_SOCKET, else
        /// $XDG_RUNTIME_DIR/meissner.sock, else a folder of the user's own, else /run/meissner/meissner.sock]
        #[arg(long, value_name = "PATH")]
        socket: Option<PathBuf>,
        /// Serve the page and the API over TCP, too, at ADDRESS, or without ADDRESS at 127.0.0.1:8765 [default: the configuration's, else
        /// not]
        #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
        listen: Option<SocketAddr>,
        /// Keep no session record
        #[arg(long)]
        no_record: bool,
    },
    /// Play a pattern, or many with exact times as one play, after the queued ones
    Play(control::Play),
    /// End the running play and clear the queue; the motors stay armed
    Stop {
        /// Only take the waiting play ID out of the queue
        #[arg(long, value_name = "ID")]
        play: Option<u64>,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Turn all lines off at once; they stay off until `reset`
    Estop(ClientOptions),
    /// Leave an emergency stop or a fault: pins that stand above rest return to it, and the motors are disarmed
    Reset {
        /// Reset although another terminal has ordered an emergency stop since the last reset
        #[arg(long)]
        force: bool,
        /// Leave pins where they stand, until `arm`
        #[arg(long)]
        keep: bool,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Enable the motors
    Arm {
        /// State that all pins are at rest: look at them first
        #[arg(long)]
        assume_rest: bool,
        /// Say who has looked at the pins and found them level: needed after they may have drifted; on a terminal the command asks
        #[arg(long, value_name = "NAME", requires = "assume_rest")]
        checked: Option<String>,
        /// Disarm after S seconds in which neither the program that armed nor the last one that moved pins has sent anything, 1 to 86400
        /// [default: `armed_silence_s` of the daemon's configuration]
        #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = positive)]
        silence: Option<f64>,
        /// Let the motors stay armed however long nobody asks the daemon
        #[arg(long, conflicts_with = "silence")]
        unattended: bool,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Return the pins and switch the motors off
    Disarm(ClientOptions),
    /// Move the pins to their rest position, between plays
    Home(ClientOptions),
    /// Make an edge at the trigger input of a simulated array, as a pulse would at a board's
    Edge {
        /// Make it at TICK of the device's clock, or MS milliseconds after the request [default: at once]
        #[arg(long, value_name = "TICK|+MS")]
        at: Option<arguments::Onset>,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Measure the gains of the motors and store them: by telemetry, in a minute of bursts, or play the bursts for a laser (--plan)
    Calibrate(calibrate::Calibrate),
    /// List all patterns
    List(ClientOptions),
    /// Show the motors, drives and warnings of a pattern
    Show {
        /// Show the pattern of this name
        name: String,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Store a pattern file with the daemon, under the name in it
    Import {
        /// Read the pattern from this file (TOML)
        file: PathBuf,
        /// Replace a stored pattern of that name
        #[arg(long)]
        replace: bool,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Remove a pattern from the daemon's pattern directory
    Remove {
        /// Remove the pattern of this name
        name: String,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Show the state of the daemon, its device and its queue
    Status {
        /// Show it again at every change
        #[arg(long)]
        watch: bool,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Print events as they happen, one JSON document per line
    Events(ClientOptions),
    /// Show the result of a play
    Receipt {
        /// Show the play with this id [default: the last one]
        id: Option<u64>,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Record a participant's answer to a play of the running session
    Answer(answer::Answer),
    /// Start, end, show and export sessions: plays of one participant that are recorded together
    #[command(subcommand)]
    Session(session::Session),
    /// Create, list and revoke access tokens of clients that come over the network
    #[command(subcommand)]
    Token(token::Token),
    /// Compute the steady state of a drive by the motor model, and its daily exposure
    Motor(motor::Motor),
    /// Pack a pattern with its sample files; compute what motors will do with its motions
    #[command(subcommand)]
    Pattern(pattern::Pattern),
    /// Sample how far a pattern moves each pin, by the motor model, as CSV
    Displacement(displacement::Displacement),
    /// Simulate afferent spikes for a scene
    Simulate(simulate::Simulate),
    /// Find a pattern for a target shape
    Optimise(optimise::Optimise),
    /// Make a pattern that gives a finger the response that a real object gives
    Render(render::Render),
    /// Compare what fingers feel of a pattern with what they feel of the real object
    Judge(judge::Judge),
    /// Compare simulation methods on this machine: time against error
    Tradeoff(tradeoff::Tradeoff),
    /// Compare both models of skin and afferents with published figures
    Validate,
    /// Write the man pages, the completions of three shells and the OpenAPI document to a folder
    Manual {
        /// The folder
        folder: PathBuf,
    },
    /// Draw an array, or write the description of a new one
    #[command(subcommand)]
    Array(array::Array),
    /// Check what could keep this machine or its device from playing; exit 0 only if nothing does
    Doctor {
        /// Check this device, named as for `daemon` [default: the daemon's, else the first board]
        #[arg(long, value_name = "DEVICE")]
        device: Option<Spec>,
        #[command(flatten)]
        array: PaperArrayOption,
        /// Have the board test itself: lines, waveform, memory, speed. The drivers stay off
        #[arg(long)]
        board: bool,
        /// Measure wake-ups for S seconds, 0.1 to 3600: the longer, the rarer the stalls it sees
        #[arg(long, value_name = "S", default_value_t = 5.0, allow_negative_numbers = true, value_parser = measured)]
        seconds: f64,
        #[command(flatten)]
        options: ClientOptions,
    },
}

/// All commands and their flags, as clap describes them: the source of manual pages and shell completions.
pub fn command() -> clap::Command {
    Cli::command()
}

/// Runs the program.
pub fn main() -> ExitCode {
    if render_process::is_asked(env::args_os().next().as_deref()) {
        return render_process::work();
    }
    render_process::is_program();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(error),
    };
    let level = if matches!(cli.command, Command::Daemon { .. }) { Level::INFO } else { Level::WARN };
    log::start(level);
    exit_code(run(cli.command))
}

/// Runs a command on this thread, for tests: exit code and output as of a process. The arguments begin with the program's name.
#[doc(hidden)]
pub fn answered(arguments: &[OsString]) -> process::Output {
    let run = || Cli::try_parse_from(arguments).map_or_else(usage, |cli| exit_code(run(cli.command)));
    let (code, [stdout, stderr]) = output::held(run);
    let number = (0..=u8::MAX).find(|&number| ExitCode::from(number) == code).unwrap_or(u8::MAX);
    process::Output { status: ExitStatus::from_raw(i32::from(number) << 8), stdout, stderr }
}

fn exit_code(ended: Result<ExitCode>) -> ExitCode {
    match ended {
        Ok(code) => code,
        // The reader of the output has closed it.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => match error.downcast::<clap::Error>() {
            Ok(error) => usage(error),
            Err(error) => {
                let hint = session_token::hint(&error);
                tell(&format!("meissner: {error}{hint}"));
                ExitCode::FAILURE
            }
        },
    }
}

/// Says on one line what is wrong with the command line. Help and version, which clap also calls errors, are printed as they are.
fn usage(error: clap::Error) -> ExitCode {
    if !error.use_stderr() || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        // If the output is closed, no one can read it.
        let _ = error.print();
        return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
    }
    let text = error.to_string();
    let (said, rest) = text.split_once("\nUsage: ").unwrap_or((&text, ""));
    let said = said.split("\nFor more information").next().unwrap_or_default().trim_start_matches("error: ");
    let line = said.split_whitespace().collect::<Vec<_>>().join(" ").replace(" tip: ", "; tip: ");
    // What comes before the first argument is the name of the command.
    let is_name = |word: &&str| !word.starts_with(['<', '[', '-', '.']);
    let name: Vec<_> = rest.split_whitespace().take_while(is_name).collect();
    let hint = if name.is_empty() { String::new() } else { format!("; see `{} --help`", name.join(" ")) };
    tell(&format!("meissner: {line}{hint}"));
    ExitCode::from(2)
}

fn run(command: Command) -> Result<ExitCode> {
    match command {
        Command::Demo { seconds, array, open_loop, sensorless, page, output } => {
            let array = array.find()?;
            demo::run(&demo::Asked { seconds, array, open_loop, sensorless, page, json: output.json })
        }
        Command::Daemon { config, check_config: check, device, array, socket, listen, no_record } => {
            let array = array.as_deref().map(arguments::array).transpose()?;
            let source = Source { file: config, device, array, socket, listen, no_record };
            if check { check_config(&source) } else { serve(&source) }
        }
        Command::Play(play) => control::play(&play),
        Command::Stop { play: Some(id), options } => control::withdraw(&options, id),
        Command::Stop { play: None, options } => control::command(&options, "stop"),
        Command::Estop(options) => control::estop(&options),
        Command::Reset { force, keep, options } => control::reset(&options, force, keep),
        Command::Arm { assume_rest, checked, silence: silence_s, unattended, options } => {
            control::arm(&options, ArmRequest { assume_rest, checked, silence_s, unattended })
        }
        Command::Disarm(options) => control::command(&options, "disarm"),
        Command::Home(options) => control::home(&options),
        Command::Edge { at, options } => control::edge(&options, at),
        Command::Calibrate(asked) => calibrate::run(&asked),
        Command::List(options) => library::list(&options),
        Command::Show { name, options } => library::show(&options, &name),
        Command::Import { file, replace, options } => library::import(&options, &file, replace),
        Command::Remove { name, options } => library::remove(&options, &name),
        Command::Status { watch, options } => watch::status(&options, watch),
        Command::Events(options) => watch::events(&options),
        Command::Receipt { id, options } => watch::receipt(&options, id),
        Command::Answer(asked) => answer::run(asked),
        Command::Session(asked) => session::run(&asked),
        Command::Token(asked) => token::run(&asked),
        Command::Motor(asked) => motor::run(&asked),
        Command::Array(asked) => array::run(asked),
        Command::Pattern(asked) => pattern::run(&asked),
        Command::Displacement(asked) => displacement::run(&asked),
        Command::Simulate(asked) => simulate::run(&asked),
        Command::Optimise(asked) => optimise::run(&asked),
        Command::Render(asked) => render::run(&asked),
        Command::Judge(asked) => judge::run(&asked),
        Command::Tradeoff(asked) => tradeoff::run(&asked),
        Command::Validate => validate::run(),
        Command::Manual { folder } => manual::manual(&Cli::command(), &folder).map(|()| ExitCode::SUCCESS),
        Command::Doctor { device, array, board, seconds, options } => {
            doctor::run(device, array.find()?, board, Duration::from_secs_f64(seconds), &options)
        }
    }
}

fn serve(source: &Source) -> Result<ExitCode> {
    // Extend the umask, so that only this user can change files that the daemon makes.
    umask(umask(Mode::empty()) | Mode::WGRP | Mode::WOTH);
    daemon::check_memory()?;
    daemon::end_on_panic();
    let config = source.read()?;
    let runtime = daemon::runtime()?;
    let work = async {
        let signals = Signals::new()?;
        let daemon = Daemon::start(&config).map_err(|error| named(source, error))?;
        anyhow::Ok(daemon.run(signals).await?)
    };
    let ended = panic::catch_unwind(AssertUnwindSafe(|| runtime.block_on(work)));
    // Do not wait for threads that are blocked by a disk.
    runtime.shutdown_background();
    // The panic has already printed its own line.
    ended.unwrap_or_else(|_| Err(DaemonError::Panicked.into()))?;
    Ok(ExitCode::SUCCESS)
}

/// Checks the configuration as a daemon does at its start.
fn check_config(source: &Source) -> Result<ExitCode> {
    let config = source.read()?;
    daemon::check(&config).map_err(|error| named(source, error))?;
    match &source.file {
        Some(file) => say(&format!("{}: valid", file.display()))?,
        None => say("no file was named with --config: every key has its default, which is valid")?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Adds the file in which the error must be corrected.
fn named(source: &Source, error: DaemonError) -> anyhow::Error {
    match (&source.file, error) {
        (Some(file), error @ (DaemonError::Store(_) | DaemonError::Record { .. })) => {
            anyhow!("{}: {error}", file.display())
        }
        (_, error) => error.into(),
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_command_line_is_consistent() {
        super::command().debug_assert();
    }

    /// A terminal of 100 columns breaks no line of any help.
    #[test]
    fn every_help_fits_100_columns() {
        fn check(command: &mut clap::Command) {
            for help in [command.render_help(), command.render_long_help()].map(|help| help.to_string()) {
                for line in help.lines() {
                    assert!(line.chars().count() <= 100, "{}: {line}", command.get_name());
                }
            }
            command.get_subcommands_mut().for_each(check);
        }
        let mut command = super::command();
        command.build();
        check(&mut command);
    }
}
