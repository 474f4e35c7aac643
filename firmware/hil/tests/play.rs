//! Plays one pattern on the chip from arming to its end, and judges it.

use firmware_protocol::controller::BLOCK;
use firmware_protocol::tick::Tick;
use meissner_array::pattern::Pattern;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::judge::{Judged, differences};
use meissner_hil::rig::{Rig, RigOptions};
use meissner_hil::scenario::compiled;
use meissner_hil::time::{Grid, MS};
use meissner_stream::queues::{Command, Outcome, StreamEvent};

pub(crate) struct Play {
    pub(crate) pattern: Pattern,
    pub(crate) seconds: f64,
    pub(crate) seed: u64,
    pub(crate) slow: f64,
    /// Another firmware than the one under test.
    pub(crate) elf: Option<std::path::PathBuf>,
}

impl Play {
    pub(crate) fn new(pattern: Pattern, seconds: f64) -> Self {
        Self { pattern, seconds, seed: 1, slow: 1.0, elf: None }
    }
}

/// Most cycles until a block that has begun is counted: an interrupt and what may delay it.
const CLOCK_LATE: u64 = 750;
/// Most cycles by which a block may be counted early: clock and pins start one after the other.
const CLOCK_EARLY: u64 = 150;

pub(crate) struct Played {
    pub(crate) outcome: Outcome,
    pub(crate) judged: Judged,
    /// Differences to the compiled strokes, in words.
    pub(crate) against_strokes: Vec<String>,
    /// Differences between the device's clock and that of the pins.
    pub(crate) clock: Vec<String>,
    pub(crate) pulses: u64,
    /// Share of the cycles of the play in which the core did not sleep.
    pub(crate) load: f64,
    /// The least slack of a block, in ticks.
    pub(crate) slack: u64,
}

/// A rig that is armed.
pub(crate) fn armed(options: ChipOptions) -> Rig {
    armed_with(options, RigOptions::default())
}

pub(crate) fn armed_with(chip: ChipOptions, options: RigOptions) -> Rig {
    let mut rig = Rig::new(&Which::Chip(chip), options).unwrap_or_else(|error| panic!("{error}"));
    rig.run_to_greeting(3_000).unwrap();
    rig.run_to(rig.now() + 100 * MS).unwrap();
    rig.order(Command::Arm { assume_rest: true });
    rig.run_to(rig.now() + 50 * MS).unwrap();
    rig
}

pub(crate) fn job(pattern: &Pattern, seconds: f64) -> Command {
    job_of(Strokes::new(pattern, &StrokeOptions::lasting(seconds)).unwrap())
}

/// An order to play these strokes in open loop, as play 1.
pub(crate) fn job_of(strokes: Strokes) -> Command {
    let play = meissner_stream::queues::Play::new(1, strokes);
    Command::Play(Box::new(meissner_stream::queues::Play { open_loop: true, ..play }))
}

pub(crate) fn play(play: &Play) -> Played {
    let options = ChipOptions { slow: play.slow, ..ChipOptions::new(play.seed) };
    let elf = play.elf.clone().unwrap_or_else(|| options.elf.clone());
    let mut rig = armed(ChipOptions { elf, ..options });
    let busy = |rig: &mut Rig| rig.chip().map_or(0, |chip| chip.busy_cycles());
    let (from, busy_before) = (rig.now(), busy(&mut rig));
    rig.order(job(&play.pattern, play.seconds));
    rig.run_to_end(1, (play.seconds * 1000.0) as u64 + 2_000).unwrap();
    let load = (busy(&mut rig) - busy_before) as f64 / (rig.now() - from) as f64;
    let slack = rig.chip().and_then(|chip| chip.read("SLACK_MIN", 4).ok()).unwrap_or(0);
    let counted = counts(&mut rig);
    let (boots, notices) = rig.finish();
    let outcome = notices.into_iter().find_map(|notice| match notice {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    let outcome = outcome.unwrap();
    let judged = boots.last().unwrap().judge();
    let onset = outcome.onset.map(|onset| onset.actual);
    let wanted = onset.map(|onset| compiled(&outcome.play.strokes, onset)).unwrap_or_default();
    let against_strokes = differences(&judged.log, &wanted).iter().map(ToString::to_string).collect();
    let clock =
        counted.iter().filter_map(|&(cycle, blocks)| against_pins(judged.grid, cycle, blocks)).collect();
    let pulses = judged.log.pulses();
    Played { outcome, judged, against_strokes, clock, pulses, load, slack }
}

/// Cycles, and the blocks that the device had counted by then, at all phases of a block.
fn counts(rig: &mut Rig) -> Vec<(u64, u64)> {
    let steps = 0..32;
    let count = steps.map(|_| {
        rig.run_to(rig.now() + MS / 2).unwrap();
        (rig.now(), rig.chip().unwrap().read("BLOCKS", 4).unwrap())
    });
    count.collect()
}

/// Checks that a block is counted soon after its first tick is on the pins.
fn against_pins(grid: Grid, cycle: u64, blocks: u64) -> Option<String> {
    let begun = grid.cycle(Tick::BOOT + blocks * u64::from(BLOCK));
    let next = grid.cycle(Tick::BOOT + (blocks + 1) * u64::from(BLOCK));
    (!(begun - CLOCK_EARLY..next + CLOCK_LATE).contains(&cycle)).then(|| {
        format!(
            "at cycle {cycle} its clock is in block {blocks}, which is on the pins from {begun} to {next}"
        )
    })
}

impl Played {
    /// All faults, in words.
    pub(crate) fn wrong(&self) -> Vec<String> {
        let findings = self.judged.findings.iter().map(ToString::to_string);
        findings.chain(self.against_strokes.iter().chain(&self.clock).cloned()).collect()
    }

    pub(crate) fn assert_whole(&self) {
        let name = self.outcome.play.id;
        assert!(self.wrong().is_empty(), "play {name}:\n{}", self.wrong().join("\n"));
        let bursts = self.outcome.bursts;
        assert_eq!(bursts.played, bursts.planned, "{bursts:?}");
        assert!(bursts.planned > 0 && self.pulses > 0, "{bursts:?}");
    }
}
