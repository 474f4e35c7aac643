//! The rig of the streaming tests: a virtual-time simulation of the paper's array that records every line of the device.
//!
//! A test arms a [`Rig`], sends commands, advances time, and compares the recorded lines with the compiled strokes.

use crate::paper::MOTORS;
use crate::statistics::rms;
use firmware_protocol::controller::Run;
use firmware_protocol::stroke::{Direction, Line as Pulse, Lines};
use firmware_protocol::tick::Tick;
use meissner_array::motor::SquareWave;
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_array::strokes::{Burst, Step};
use meissner_array::strokes::{LiveStrokes, StrokeOptions, Strokes, Surplus};
use meissner_stream::queues::{Command, CommandError, Outcome, Play, Snapshot, StreamEvent};
use meissner_stream::{Bandwidth, Gains, Line, Settings, Simulation, Source};

use std::ops::{Deref, DerefMut};
use std::time::Duration;

pub const OFF: Lines = Lines::OFF;

/// A line that loses, repeats, delays, reorders and damages.
pub fn bad_line() -> Line {
    Line {
        loss: 0.05,
        repeat: 0.05,
        corrupt: 0.05,
        byte_loss: 0.0,
        delay: Duration::from_micros(300),
        jitter: Duration::from_millis(2),
        bytes_per_s: 0,
        holds: false,
    }
}

/// A pattern of the repository.
pub fn pattern(name: &str) -> Pattern {
    let folder = if name.ends_with("-paper") { "paper" } else { "" };
    patterns_in(folder).into_iter().find(|pattern| pattern.name() == name).unwrap()
}

pub fn outcomes(events: &[StreamEvent]) -> Vec<&Outcome> {
    let ended = events.iter().filter_map(|event| match event {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    ended.collect()
}

pub fn into_outcomes(events: Vec<StreamEvent>) -> Vec<Outcome> {
    let ended = events.into_iter().filter_map(|event| match event {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    ended.collect()
}

/// The answers to a request.
pub fn answers(events: &[StreamEvent], of: u64) -> impl Iterator<Item = Result<(), CommandError>> {
    events.iter().filter_map(move |event| match event {
        StreamEvent::Answer { ticket, result } if *ticket == of => Some(*result),
        _ => None,
    })
}

/// The first answer to a request.
pub fn answer(events: &[StreamEvent], of: u64) -> Option<Result<(), CommandError>> {
    answers(events, of).next()
}

pub fn last_snapshot(events: &[StreamEvent]) -> Snapshot {
    let snapshot = events.iter().rev().find_map(|event| match event {
        StreamEvent::Snapshot(snapshot) => Some(*snapshot),
        _ => None,
    });
    snapshot.expect("there are snapshots")
}

/// Every planned burst has exactly one fate.
pub fn assert_closed(outcome: &Outcome) {
    let bursts = outcome.bursts;
    let sum = bursts.played + bursts.late + bursts.dropped + bursts.refused + bursts.replaced;
    assert_eq!(bursts.planned, sum, "{outcome:?}");
}

/// The pulses on the lines.
#[derive(Debug, Default)]
pub struct OnTheLines {
    /// Trains of pulses of one direction.
    pub count: u64,
    pub pulses: u64,
    /// Up less down, per motor.
    pub net: [i64; MOTORS],
}

pub fn bursts_on_the_lines(trace: &[(Tick, Run)]) -> OnTheLines {
    let mut sum = OnTheLines::default();
    let mut last = [Pulse::Off; MOTORS];
    for (_, run) in trace {
        for (motor, last) in (0u8..).zip(&mut last) {
            let line = run.lines.line(motor);
            if let Pulse::Pulse(direction) = line {
                sum.count += u64::from(line != *last);
                sum.pulses += u64::from(run.ticks);
                let sign = if direction == Direction::Up { 1 } else { -1 };
                sum.net[usize::from(motor)] += sign * i64::from(run.ticks);
            }
            *last = line;
        }
    }
    sum
}

/// The patterns of the repository's library, without those of the paper's setting.
pub fn shipped() -> Vec<Pattern> {
    patterns_in("")
}

fn patterns_in(folder: &str) -> Vec<Pattern> {
    let folder =
        std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../library/patterns")).join(folder);
    let entries = std::fs::read_dir(folder).unwrap();
    let mut files: Vec<_> =
        entries.map(|entry| entry.unwrap().path()).filter(|path| path.is_file()).collect();
    files.sort();
    let read = |path: std::path::PathBuf| {
        Pattern::parse(&std::fs::read_to_string(&path).unwrap(), &path.to_string_lossy()).unwrap()
    };
    files.into_iter().map(read).collect()
}

pub struct Rig {
    simulation: Simulation,
    surplus: Surplus,
    plays: u64,
}

impl Deref for Rig {
    type Target = Simulation;
    fn deref(&self) -> &Simulation {
        &self.simulation
    }
}

impl DerefMut for Rig {
    fn deref_mut(&mut self) -> &mut Simulation {
        &mut self.simulation
    }
}

impl Rig {
    pub fn new(line: Line, seed: u64) -> Self {
        Self::with(Settings::of(Array::paper()), line, seed)
    }

    /// A rig with these simulated motors, whose end stops it knows; records no lines. No drift limit ends a play.
    pub fn of(motors: &SimulatedMotorsConfig, seed: u64) -> Self {
        let settings = Settings {
            end_stop_um: motors.end_stop_um as f32,
            drift_limit_um: f32::INFINITY,
            ..Settings::of(Array::paper())
        };
        Self::with_motors(settings, motors, seed)
    }

    /// A rig with these settings and simulated motors; plays have the surplus of uncalibrated motors. Records no lines.
    pub fn with_motors(settings: Settings, motors: &SimulatedMotorsConfig, seed: u64) -> Self {
        let simulation = Simulation::new(motors, settings, Line::default(), seed).unwrap();
        Self {
            simulation,
            surplus: settings.surplus(&PerMotor::all(settings.array, Gains::default())),
            plays: 0,
        }
    }

    /// A rig that records lines. No drift limit ends a play, so that a bad line or sensor does not.
    pub fn with(settings: Settings, line: Line, seed: u64) -> Self {
        let settings = Settings { drift_limit_um: f32::INFINITY, ..settings };
        let mut simulation =
            Simulation::new(&SimulatedMotorsConfig::default(), settings, line, seed).unwrap();
        simulation.mock.record();
        Self { simulation, surplus: Surplus::None, plays: 0 }
    }

    /// An armed rig.
    pub fn armed(line: Line, seed: u64) -> Self {
        let mut rig = Self::new(line, seed);
        rig.arm();
        rig
    }

    pub fn arm(&mut self) {
        self.run_ms(500);
        let ticket = self.send(Command::Arm { assume_rest: true });
        self.run_ms(100);
        let events = self.take_events();
        assert_eq!(answer(&events, ticket), Some(Ok(())), "{events:?}");
    }

    pub fn run_ms(&mut self, ms: u64) {
        self.run(Duration::from_millis(ms));
    }

    /// The outcomes of the plays that have ended since the last call.
    pub fn outcomes(&mut self) -> Vec<Outcome> {
        into_outcomes(self.take_events())
    }

    /// The pins' distances from rest, µm, root mean square.
    pub fn rest_rms_um(&self) -> f64 {
        rms((0..MOTORS as u8).map(|motor| self.mock.position_um(motor)))
    }

    /// Sends a play in open loop; returns its ticket.
    pub fn start(&mut self, pattern: &Pattern, seconds: Option<f64>) -> u64 {
        self.start_with(pattern, seconds, |_| ())
    }

    /// Sends a play in closed loop; returns its ticket.
    pub fn start_closed(&mut self, pattern: &Pattern, seconds: Option<f64>) -> u64 {
        self.start_with(pattern, seconds, |play| play.open_loop = false)
    }

    /// Sends a changed play; returns its ticket.
    pub fn start_with(
        &mut self,
        pattern: &Pattern,
        seconds: Option<f64>,
        change: impl FnOnce(&mut Play),
    ) -> u64 {
        let mut play = self.play(pattern, seconds);
        change(&mut play);
        self.send(Command::Play(Box::new(play)))
    }

    /// A play in open loop, with the next id.
    pub fn play(&mut self, pattern: &Pattern, seconds: Option<f64>) -> Play {
        self.plays += 1;
        let options = StrokeOptions { surplus: self.surplus.clone(), ..StrokeOptions::lasting(seconds) };
        play_of(self.plays, Strokes::new(pattern, &options).unwrap())
    }

    /// Starts a live play of these drives in open loop; returns its id.
    pub fn start_live(&mut self, waves: PerMotor<SquareWave>, timeout: Duration) -> u64 {
        self.plays += 1;
        let strokes = Source::Live(Box::new(LiveStrokes::new(waves)));
        let play = Play { open_loop: true, live: Some(timeout), ..Play::new(self.plays, strokes) };
        self.send(Command::Play(Box::new(play)));
        self.plays
    }

    /// Plays open loop to the end and compares every tick of every line with the compiled strokes.
    pub fn play_exactly(&mut self, pattern: &Pattern, seconds: f64) -> Outcome {
        let play = self.play(pattern, Some(seconds));
        let id = play.id;
        let mut compiled = play.strokes.clone();
        self.mock.take_trace();
        self.send(Command::Play(Box::new(play)));
        let outcome = self.run_to_end(id, Duration::from_secs_f64(seconds + 2.0)).expect("it ends");
        assert_eq!(outcome.bursts.played, outcome.bursts.planned, "{}: {outcome:?}", pattern.name());
        assert_closed(&outcome);
        compiled.begin(outcome.onset.expect("it began").actual);
        let strokes: Vec<_> = compiled.map(Result::unwrap).collect();
        assert_lines(&self.mock.take_trace(), &strokes);
        assert_eq!(self.contradictions(), 0, "a true device was doubted: {:?}", self.take_events());
        outcome
    }
}

/// A play in open loop.
pub fn play(id: u64, pattern: &Pattern, seconds: Option<f64>) -> Play {
    play_of(id, Strokes::new(pattern, &StrokeOptions::lasting(seconds)).unwrap())
}

fn play_of(id: u64, strokes: Strokes) -> Play {
    let bandwidth = Bandwidth::of(&strokes, &Settings::of(strokes.array()));
    Play { open_loop: true, bandwidth, ..Play::new(id, strokes) }
}

/// Asserts that each line is as the steps plan it in every tick, and off elsewhere.
///
/// Compares the bursts (trains of equal ticks) of each line, in order: the same as tick by tick, and much faster.
pub fn assert_lines(trace: &[(Tick, Run)], steps: &[impl Into<Step> + Copy]) {
    let mut wanted: [Vec<Burst>; MOTORS] = Default::default();
    for &step in steps {
        let step: Step = step.into();
        let wanted = &mut wanted[usize::from(step.motor())];
        for burst in step.bursts() {
            // Bursts that follow each other without a pause are one train.
            match wanted.last_mut() {
                Some(last) if last.end() == burst.start && last.direction == burst.direction => {
                    last.pulses += burst.pulses;
                }
                _ => wanted.push(burst),
            }
        }
    }
    for ((motor, wanted), played) in wanted.iter().enumerate().zip(bursts_by_line(trace)) {
        let first = wanted.iter().zip(&played).position(|(wanted, played)| wanted != played);
        let at = first.unwrap_or(wanted.len().min(played.len()));
        assert_eq!(played.get(at), wanted.get(at), "motor {motor}, burst {at}");
    }
}

/// Whether the motor's line has a pulse at `tick`.
pub fn is_driven(trace: &[(Tick, Run)], motor: u8, tick: Tick) -> bool {
    let after = trace.partition_point(|&(start, _)| start <= tick);
    after.checked_sub(1).is_some_and(|at| matches!(trace[at].1.lines.line(motor), Pulse::Pulse(_)))
}

/// The bursts on each line.
fn bursts_by_line(trace: &[(Tick, Run)]) -> [Vec<Burst>; MOTORS] {
    let mut bursts: [Vec<Burst>; MOTORS] = Default::default();
    let mut next = trace.first().expect("something was recorded").0;
    let mut last = Lines::OFF;
    for &(start, run) in trace {
        assert_eq!(start, next, "the trace has a gap");
        next = start + u64::from(run.ticks);
        for (motor, bursts) in (0u8..).zip(&mut bursts) {
            let Pulse::Pulse(direction) = run.lines.line(motor) else { continue };
            if last.line(motor) != run.lines.line(motor) {
                bursts.push(Burst { start, direction, pulses: 0 });
            }
            let burst = bursts.last_mut().expect("one was pushed when the line changed");
            burst.pulses += u16::try_from(run.ticks).expect("a burst has few pulses");
        }
        last = run.lines;
    }
    bursts
}
