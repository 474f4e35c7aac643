//! The rig of the streaming tests: a simulation whose lines are recorded and compared with compiled strokes.

use firmware_protocol::controller::Run;
use firmware_protocol::stroke::{Direction, Line as Pulse, Lines, MOTORS, Stroke};
use firmware_protocol::tick::Tick;
use meissner_api::LatePolicy;
use meissner_array::pattern::Pattern;
use meissner_array::simulated::PlantConfig;
use meissner_array::strokes::Strokes;
use meissner_stream::queues::{At, Command, Outcome, Play, StreamEvent};
use meissner_stream::{Bandwidth, Line, Settings, Simulation};
use std::ops::{Deref, DerefMut};
use std::time::Duration;

pub const OFF: Lines = Lines::OFF;

/// A line that loses, repeats, delays, reorders and damages.
pub fn bad_line() -> Line {
    Line {
        loss: 0.05,
        repeat: 0.05,
        corrupt: 0.05,
        delay: Duration::from_micros(300),
        jitter: Duration::from_millis(2),
        bytes_per_s: 0,
    }
}

/// A pattern of the repository.
pub fn pattern(name: &str) -> Pattern {
    shipped().into_iter().find(|pattern| pattern.name() == name).unwrap()
}

pub fn outcomes(notices: &[StreamEvent]) -> Vec<&Outcome> {
    let ended = notices.iter().filter_map(|notice| match notice {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    ended.collect()
}

pub fn into_outcomes(notices: Vec<StreamEvent>) -> Vec<Outcome> {
    let ended = notices.into_iter().filter_map(|notice| match notice {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    ended.collect()
}

/// Every planned burst has exactly one fate.
pub fn assert_closed(outcome: &Outcome) {
    let bursts = outcome.bursts;
    assert_eq!(bursts.planned, bursts.played + bursts.late + bursts.dropped + bursts.refused, "{outcome:?}");
}

/// What the lines carried.
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

/// All patterns of the repository.
pub fn shipped() -> Vec<Pattern> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../patterns");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let read = |path: std::path::PathBuf| {
        Pattern::parse(&std::fs::read_to_string(&path).unwrap(), &path.to_string_lossy()).unwrap()
    };
    files.into_iter().map(read).collect()
}

pub struct Rig {
    simulation: Simulation,
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
        Self::with(Settings::default(), line, seed)
    }

    /// With motors that are not the default's.
    pub fn plant(plant: &PlantConfig, seed: u64) -> Self {
        Self {
            simulation: Simulation::new(plant, Settings::default(), Line::default(), seed).unwrap(),
            plays: 0,
        }
    }

    pub fn with(settings: Settings, line: Line, seed: u64) -> Self {
        let mut simulation = Simulation::new(&PlantConfig::default(), settings, line, seed).unwrap();
        simulation.mock.record();
        Self { simulation, plays: 0 }
    }

    pub fn arm(&mut self) {
        self.run(Duration::from_millis(500));
        let ticket = self.send(Command::Arm { assume_rest: true });
        self.run(Duration::from_millis(100));
        let answered = |notice: &StreamEvent| matches!(notice, StreamEvent::Answer { ticket: t, result: Ok(()) } if *t == ticket);
        let notices = self.take_events();
        assert!(notices.iter().any(answered), "{notices:?}");
    }

    pub fn play(&mut self, pattern: &Pattern, seconds: Option<f64>) -> Play {
        self.plays += 1;
        let strokes = Strokes::new(pattern, seconds).unwrap();
        let late = LatePolicy::Drop;
        let bandwidth = Bandwidth::of(&strokes, &Settings::default());
        Play { id: self.plays, strokes, at: At::Next, late, replace: false, open_loop: true, bandwidth }
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
        compiled.begin(outcome.onset.expect("it began").actual);
        let strokes: Vec<_> = compiled.map(Result::unwrap).collect();
        assert_lines(&self.mock.take_trace(), &strokes);
        outcome
    }
}

/// Every tick of every line is what the strokes say, and off where they say nothing.
pub fn assert_lines(trace: &[(Tick, Run)], strokes: &[Stroke]) {
    let mut lanes: [Vec<&Stroke>; MOTORS] = Default::default();
    for stroke in strokes {
        lanes[usize::from(stroke.motor)].push(stroke);
    }
    let from = trace.first().expect("something was recorded").0;
    let length = trace.iter().map(|(_, run)| u64::from(run.ticks)).sum::<u64>() as usize;
    for (motor, lane) in (0u8..).zip(lanes) {
        let mut wanted = vec![Pulse::Off; length];
        for (tick, line) in lane.into_iter().flat_map(Stroke::ticks) {
            wanted[(tick - from) as usize] = line;
        }
        let mut wanted = wanted.into_iter();
        for (start, run) in trace {
            for (i, wanted) in wanted.by_ref().take(run.ticks as usize).enumerate() {
                let line = run.lines.line(motor);
                assert_eq!(line, wanted, "motor {motor}, {} ticks from the start", *start - from + i as u64);
            }
        }
    }
}
