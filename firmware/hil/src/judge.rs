//! Judges one boot of a device: compares its lines with what they had to do, and on the chip checks every pin to the cycle.
//!
//! The chip's first pulse gives the grid of ticks; everything after it must fit that grid.

mod drivers;
mod pins;

use crate::bench::Played;
use crate::log::{Log, Train};
use crate::oracle::{self, Expected};
use crate::tap::{Event, Tap};
use crate::time::Grid;
use firmware_protocol::message::Op;
use firmware_protocol::tick::Tick;
use std::fmt;

/// Most differences listed per boot.
const TOLD: usize = 12;

/// A time from which all lines must be low, until the next `arm` or onset.
#[derive(Clone, Copy, Debug)]
pub struct Quiet {
    /// The time.
    pub cycle: u64,
}

/// One boot of a device, from power-up or reset to the next or the end.
#[derive(Debug)]
pub struct Boot {
    /// What went over the link.
    pub tap: Tap,
    /// The recording of the lines.
    pub played: Played,
    /// The grid of its ticks: exact on the mock, estimated from the link on the chip.
    pub grid: Grid,
    /// Cycle at which its core failed.
    pub death: Option<u64>,
    /// Times from which lines had to be low.
    pub quiets: Vec<Quiet>,
    /// Its first cycle.
    pub from: u64,
    /// Its last cycle.
    pub to: u64,
}

/// A fault of a boot.
#[expect(missing_docs, reason = "the fields are what the text says")]
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// A pulse of neither width.
    Width { line: usize, cycle: u64, tick: Tick, width: u64 },
    /// A pulse that does not rise where a tick begins.
    OffGrid { line: usize, cycle: u64, tick: Tick, late: u64 },
    /// A line's first difference from what it had to do.
    Differs { line: usize, expected: Option<Train>, found: Option<Train> },
    /// Pulses at the edge of a cut that were not planned.
    NotPlanned { from: Tick, to: Tick },
    /// A pulse while all lines had to be low.
    NotLow { since: u64, pulse: u64 },
    /// A line that stays high.
    Static { line: usize, since: u64 },
    /// The trigger did not rise at an onset, or in a cell of its code.
    NoTrigger { onset: Tick },
    /// The trigger rose where it should be low.
    Trigger { tick: Tick, late: u64 },
    /// A trigger, or a cell of its code, has the wrong length.
    TriggerLength { tick: Tick, cycles: u64 },
    /// The drivers or the LED were on while disarmed.
    Enabled { from: u64, to: u64, quiet_from: u64, quiet_to: u64 },
    /// A pulse while the drivers were off.
    NotEnabled { line: usize, cycle: u64 },
    /// The first pulse after the drivers' enable came too early.
    Lead { enabled: u64, pulse: u64 },
    /// The drivers were enabled for too long without a pulse on any line.
    Idle { from: u64, to: u64 },
    /// The drivers were enabled while the LED was off.
    Led,
    /// A pin rose that is not an output.
    Stray { pin: usize, cycle: u64 },
    /// The device's clock differs from that of its pins.
    Clock { off: i64 },
    /// The device contradicts itself.
    Contradiction(String),
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = |tick: &Tick| format!("tick BOOT+{}", tick.since(Tick::BOOT));
        let train = |train: &Option<Train>| train.map_or("nothing".to_owned(), |train| train.to_string());
        match self {
            Self::Width { line, cycle, tick, width } => {
                write!(out, "line {line}: a pulse of {width} cycles at cycle {cycle}, {}", at(tick))
            }
            Self::OffGrid { line, cycle, tick, late } => {
                write!(out, "line {line}: a pulse {late} cycles into {} (cycle {cycle})", at(tick))
            }
            Self::Differs { line, expected, found } => {
                write!(out, "line {line}: expected {}, found {}", train(expected), train(found))
            }
            Self::NotPlanned { from, to } => {
                write!(out, "pulses that were not planned between {} and {}", at(from), at(to))
            }
            Self::NotLow { since, pulse } => {
                write!(out, "lines had to be low from cycle {since} on, and one is high at cycle {pulse}")
            }
            Self::Static { line, since } => write!(out, "line {line}: high since cycle {since}"),
            Self::NoTrigger { onset } => write!(out, "no trigger at the onset at {}", at(onset)),
            Self::Trigger { tick, late } => {
                write!(out, "a trigger {late} cycles into {}, where nothing begins", at(tick))
            }
            Self::TriggerLength { tick, cycles } => {
                write!(out, "the trigger at {} lasts {cycles} cycles", at(tick))
            }
            Self::Enabled { from, to, quiet_from, quiet_to } => {
                write!(out, "drivers on in cycles {from}..{to} and to be off in {quiet_from}..{quiet_to}")
            }
            Self::NotEnabled { line, cycle } => {
                write!(out, "line {line}: a pulse at cycle {cycle} with the drivers off")
            }
            Self::Lead { enabled, pulse } => {
                write!(out, "drivers enabled at cycle {enabled}, and a pulse at {pulse}: the lead is missing")
            }
            Self::Idle { from, to } => {
                write!(out, "drivers enabled without a pulse on any line in cycles {from}..{to}")
            }
            Self::Led => out.write_str("the drivers are enabled while the LED is off"),
            Self::Stray { pin, cycle } => write!(out, "GP{pin} rises at cycle {cycle}"),
            Self::Clock { off } => {
                write!(out, "the pins are {off} cycles behind the clock that the device tells")
            }
            Self::Contradiction(text) => out.write_str(text),
        }
    }
}

/// A judged boot.
#[derive(Debug)]
pub struct Judged {
    /// The faults found.
    pub findings: Vec<Finding>,
    /// The lines as recorded, in ticks.
    pub log: Log,
    /// The lines as expected.
    pub expected: Expected,
    /// The grid of ticks.
    pub grid: Grid,
}

impl Boot {
    /// Judges the boot.
    #[must_use]
    pub fn judge(&self) -> Judged {
        let death = |grid: Grid| self.death.map(|cycle| grid.tick(cycle).0);
        let mut findings = Vec::new();
        let (log, expected, grid) = match &self.played {
            Played::Ticks(log) => {
                let expected = oracle::expect(&self.tap, death(self.grid));
                ((**log).clone(), expected, self.grid)
            }
            Played::Pins(pins) => {
                let first = oracle::expect(&self.tap, None).log.first();
                let grid = match (first, pins.first()) {
                    (Some(tick), Some(cycle)) => Grid::through(tick, cycle),
                    _ => self.grid,
                };
                let expected = oracle::expect(&self.tap, death(grid));
                let log = self.judge_pins(pins, &expected, grid, &mut findings);
                (log, expected, grid)
            }
        };
        self.judge_drivers(&log, &expected, grid, &mut findings);
        compare(&log, &expected, &mut findings);
        self.judge_quiet(&log, &expected.onsets, grid, &mut findings);
        findings.extend(expected.contradictions.iter().cloned().map(Finding::Contradiction));
        findings.truncate(TOLD);
        Judged { findings, log, expected, grid }
    }

    /// The cycles of the commands to arm.
    fn arms(&self) -> impl Iterator<Item = u64> {
        self.tap
            .events
            .iter()
            .filter_map(|(cycle, event)| matches!(event, Event::Control(_, Op::Arm { .. })).then_some(*cycle))
    }

    fn judge_quiet(&self, log: &Log, onsets: &[Tick], grid: Grid, findings: &mut Vec<Finding>) {
        for quiet in &self.quiets {
            let onsets = onsets.iter().map(|&onset| grid.cycle(onset));
            let ends = self.arms().chain(onsets).filter(|&end| end >= quiet.cycle);
            let until = ends.min().unwrap_or(self.to);
            let (from, to) = (grid.tick(quiet.cycle + crate::time::TICK - 1).0, grid.tick(until).0);
            let pulse = match &self.played {
                Played::Ticks(_) => log.within(from, to).first().map(|tick| grid.cycle(tick)),
                Played::Pins(pins) => pins.low_since(until).filter(|&low| low > quiet.cycle),
            };
            if let Some(pulse) = pulse {
                findings.push(Finding::NotLow { since: quiet.cycle, pulse });
            }
        }
    }
}

/// Compares the lines outside of soft intervals, and finds pulses inside them that were not planned.
fn compare(found: &Log, expected: &Expected, findings: &mut Vec<Finding>) {
    let (mut outside, mut wanted) = (found.clone(), expected.log.clone());
    for soft in &expected.soft {
        if !found.within(soft.from, soft.to).is_part_of(&soft.planned) {
            findings.push(Finding::NotPlanned { from: soft.from, to: soft.to });
        }
        outside = outside.without(soft.from, soft.to);
        wanted = wanted.without(soft.from, soft.to);
    }
    findings.extend(differences(&outside, &wanted));
}

/// The first difference of each line.
#[must_use]
pub fn differences(found: &Log, expected: &Log) -> Vec<Finding> {
    let lines = found.lines.iter().zip(&expected.lines).enumerate();
    let first = lines.filter_map(|(line, (found, expected))| {
        let same = found.iter().zip(expected).take_while(|(found, expected)| found == expected).count();
        let (found, expected) = (found.get(same).copied(), expected.get(same).copied());
        (found != expected).then_some(Finding::Differs { line, expected, found })
    });
    first.collect()
}

#[cfg(test)]
mod tests;
