//! Judges one boot of a device by its pins, to the cycle.
//!
//! The first trigger gives the grid of ticks, and everything must fit that grid. A play has the pulses of its compiled strokes, tick
//! for tick, until it ends or is cut. A return moves pins down alone, and ends with each pin where it began. Nothing else moves a pin.

use crate::log::{Log, Train};
use crate::pins::{High, Pins};
use crate::tap::{Event, Tap};
use crate::time::{Grid, MS, TICK};
use firmware_protocol::controller::{DRIVER_TAIL, HORIZON};
use firmware_protocol::message::{Cut, Op, State, Trigger};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_stream::Source;
use meissner_stream::queues::{Outcome, StreamEvent};
use meissner_test_support::paper::{DRIVER_LEAD, MOTORS};

/// Most findings listed per boot.
const TOLD: usize = 12;
/// High for 20 % of a tick, and for 80 %.
const UP: u64 = TICK / 5;
const DOWN: u64 = TICK / 5 * 4;
/// Cycles for which the drivers are on before a pulse, and after it.
const LEAD: u64 = DRIVER_LEAD as u64 * TICK;
const TAIL: u64 = DRIVER_TAIL as u64 * TICK;
/// Most time from a status that says disarmed to the supply being off.
const ENABLE_OFF: u64 = (64 + 16) * TICK;
/// Most difference between the clock read from the link and that of the pins: transfer, processing and a step of the rig.
const CLOCK: std::ops::RangeInclusive<i64> = -(2 * MS as i64)..=(TICK as i64);

/// One boot of a device, from power-up or reset to the next or the end.
#[derive(Debug)]
pub struct Boot {
    /// What went over the link.
    pub tap: Tap,
    /// The recording of the pins.
    pub pins: Pins,
    /// The grid of its ticks, estimated from the link.
    pub link_grid: Grid,
    /// Cycle at which its core failed.
    pub death: Option<u64>,
    /// Its first cycle.
    pub from: u64,
    /// Its last cycle.
    pub to: u64,
}

/// A play that has begun.
struct Play {
    onset: Tick,
    /// The first tick that it does not decide.
    until: Tick,
    wanted: Log,
    trigger: Option<Trigger>,
}

/// The grid through the first trigger, which rises at the first onset; before that, the one of the link.
pub fn grid(tap: &Tap, pins: &Pins, link: Grid) -> Grid {
    let first = tap.onsets().first().copied().zip(pins.trigger.first());
    first.map_or(link, |(onset, high)| Grid::through(onset, high.from))
}

/// The outcomes of the plays that have ended.
pub fn outcomes(notices: &[StreamEvent]) -> impl Iterator<Item = &Outcome> {
    notices.iter().filter_map(|notice| match notice {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    })
}

/// What the lines have to do if all steps are played from `onset` on.
pub fn compiled(strokes: &Source, onset: Tick) -> Log {
    let mut strokes = strokes.clone();
    strokes.begin(onset);
    let trains = strokes.flatten().flat_map(|step| {
        step.bursts().map(move |burst| {
            let train = Train { start: burst.start, direction: burst.direction, pulses: burst.pulses.into() };
            (usize::from(step.motor()), train)
        })
    });
    Log::of(trains.collect())
}

impl Boot {
    /// The grid of its ticks.
    pub fn grid(&self) -> Grid {
        grid(&self.tap, &self.pins, self.link_grid)
    }

    /// Judges the boot, given what the host has said, and returns the faults found, in words.
    pub fn judge(&self, notices: &[StreamEvent]) -> Vec<String> {
        let mut judge = Judge {
            boot: self,
            pins: &self.pins,
            grid: self.grid(),
            cuts: self.tap.cuts(),
            death: None,
            wrong: Vec::new(),
        };
        judge.death = self.death.map(|cycle| judge.grid.tick(cycle).0);
        let plays = judge.plays(notices);
        let log = judge.pulses();
        judge.lines(&plays, &log);
        judge.triggers(&plays);
        judge.drivers();
        judge.off();
        let unreadable = Some(self.tap.unreadable).filter(|&frames| frames > 0);
        judge.wrong.extend(
            unreadable.map(|frames| format!("the device has sent {frames} frames that cannot be read")),
        );
        judge.wrong.truncate(TOLD);
        judge.wrong
    }
}

/// A tick as it is told.
fn told(tick: Tick) -> String {
    format!("tick BOOT+{}", tick.since(Tick::BOOT))
}

struct Judge<'a> {
    boot: &'a Boot,
    pins: &'a Pins,
    grid: Grid,
    cuts: Vec<(Tick, Cut)>,
    /// The tick in which the core failed.
    death: Option<Tick>,
    wrong: Vec<String>,
}

impl Judge<'_> {
    /// When a pulse may be cut off or missing: in the ticks around an e-stop, and what was rendered when the core failed.
    fn is_soft(&self, tick: Tick) -> bool {
        let cut = |at: Tick| (at.0 - 1..=at.0 + 1).contains(&tick.0);
        let died = |at: Tick| (at.0 - 1..at.0 + u64::from(HORIZON)).contains(&tick.0);
        self.cuts.iter().any(|(at, by)| by.return_ticks.is_none() && cut(*at)) || self.death.is_some_and(died)
    }

    /// The first tick from `from` on in which something ended what was playing.
    fn cut_after(&self, from: Tick) -> Option<Tick> {
        let cuts = self.cuts.iter().map(|&(at, _)| at).chain(self.death);
        cuts.filter(|&at| at >= from).min()
    }

    fn plays(&self, notices: &[StreamEvent]) -> Vec<Play> {
        let onsets = self.boot.tap.onsets();
        let begun = outcomes(notices).filter_map(|outcome| {
            let onset = outcome.onset?.actual;
            let end = onset + outcome.play.strokes.end()?;
            let cut = self.cut_after(onset).map_or(end, |at| Tick(at.0 - 1));
            let (until, wanted) = (end.min(cut), compiled(&outcome.play.strokes, onset));
            let trigger = outcome.play.items.first().and_then(|item| item.trigger);
            onsets.contains(&onset).then_some(Play { onset, until, wanted, trigger })
        });
        begun.collect()
    }

    /// The pulses in ticks: each has one of two widths and rises as a tick begins, with the drivers on.
    fn pulses(&mut self) -> Log {
        let mut trains = Vec::new();
        for (line, pulses) in self.pins.lines.iter().enumerate() {
            for train in pulses {
                let (tick, late) = self.grid.tick(train.cycle);
                if late != 0 {
                    self.wrong.push(format!("line {line}: a pulse {late} cycles into {}", told(tick)));
                }
                let is_soft = self.is_soft(tick + (train.pulses - 1));
                // A pulse cut off has no known direction, even if it has the width of an up pulse.
                if train.pulses == 1 && train.width < DOWN && is_soft {
                    continue;
                }
                if train.width != UP && train.width != DOWN {
                    self.wrong.push(format!(
                        "line {line}: a pulse of {} cycles in {}",
                        train.width,
                        told(tick)
                    ));
                }
                let is_on = |high: &High| high.from <= train.cycle && train.end() <= high.to;
                if !is_soft && !self.pins.enable.iter().any(is_on) {
                    self.wrong.push(format!("line {line}: a pulse in {} with the drivers off", told(tick)));
                }
                let direction = if train.width <= (UP + DOWN) / 2 { Direction::Up } else { Direction::Down };
                trains.push((line, Train { start: tick, direction, pulses: train.pulses }));
            }
        }
        let high = self.pins.still_high();
        self.wrong.extend(high.map(|(line, since)| format!("line {line}: high since cycle {since}")));
        let strays = self.pins.strays.iter();
        self.wrong.extend(strays.map(|(pin, cycle)| format!("GP{pin} rises at cycle {cycle}")));
        let off = self.grid.origin - self.boot.link_grid.origin;
        if self.pins.first().is_some() && !CLOCK.contains(&off) {
            self.wrong.push(format!("the pins are {off} cycles behind the clock that the device tells"));
        }
        Log::of(trains)
    }

    fn lines(&mut self, plays: &[Play], log: &Log) {
        let mut rest = log.clone();
        for play in plays {
            let of = |log: &Log| log.within(play.onset, play.until);
            for (line, (found, wanted)) in of(log).lines.iter().zip(&of(&play.wanted).lines).enumerate() {
                let first = found.iter().zip(wanted).take_while(|(found, wanted)| found == wanted).count();
                if found.len() != wanted.len() || first < found.len() {
                    let [wanted, found] = [wanted.get(first), found.get(first)]
                        .map(|train| train.map_or("nothing".to_owned(), ToString::to_string));
                    self.wrong.push(format!("line {line}: expected {wanted}, found {found}"));
                }
            }
            rest = rest.without(play.onset, play.until);
        }
        for (at, cut) in self.cuts.clone() {
            let before = Tick(at.0 - 1);
            let to = at + cut.return_ticks.map_or(1, u64::from);
            // An e-stop may cut a pulse off that the plan had.
            let planned = |log: &Log| plays.iter().any(|play| log.is_part_of(&play.wanted));
            let around = rest.within(before, to);
            if cut.return_ticks.is_none() && around.first().is_some() && !planned(&around) {
                self.wrong.push(format!("pulses that were not planned around {}", told(at)));
            }
            if cut.return_ticks.is_some() {
                let mut trains = rest.within(at, to).lines.into_iter().flatten();
                if let Some(up) = trains.find(|train| train.direction == Direction::Up) {
                    self.wrong.push(format!("a return moves a pin up: {up}"));
                }
                self.is_at_rest(log, to);
            }
            rest = rest.without(before, to);
        }
        if let Some(death) = self.death {
            let (from, to) = (Tick(death.0 - 1), death + u64::from(HORIZON));
            let rendered = rest.within(from, to);
            if rendered.first().is_some() && !plays.iter().any(|play| rendered.is_part_of(&play.wanted)) {
                self.wrong.push(format!("pulses that were not planned after {}", told(death)));
            }
            rest = rest.without(from, to);
        }
        if let Some(tick) = rest.first() {
            self.wrong.push(format!("a pulse in {}, where nothing is played", told(tick)));
        }
    }

    /// Each pin is where it was when it last counted as at rest, but for pulses that e-stops have cut off.
    fn is_at_rest(&mut self, log: &Log, at: Tick) {
        let arms = self.boot.tap.events.iter().filter_map(|(cycle, event)| match event {
            Event::Control(_, Op::Arm { assume_rest: true, .. }) => Some(self.grid.tick(*cycle).0),
            _ => None,
        });
        let from = arms.filter(|&armed| armed < at).max().unwrap_or(Tick(0));
        let within = |cut: Tick| from < cut && cut < at;
        let e_stops = self.cuts.iter().filter(|(cut, by)| by.return_ticks.is_none() && within(*cut)).count();
        let mut net = [0_i64; MOTORS];
        for (net, line) in net.iter_mut().zip(log.within(from, at).lines) {
            *net = line.iter().map(Train::signed).sum();
        }
        if net.iter().any(|net| net.unsigned_abs() > e_stops as u64) {
            self.wrong.push(format!("after the return at {} pins are off by pulses: {net:?}", told(at)));
        }
    }

    fn triggers(&mut self, plays: &[Play]) {
        let wanted = plays.iter().filter_map(|play| Some((play.onset, u64::from(play.trigger?.width))));
        for (onset, width) in wanted.clone() {
            let from = self.grid.cycle(onset);
            let Some(high) = self.pins.trigger.iter().find(|high| high.from == from) else {
                self.wrong.push(format!("no trigger at the onset in {}", told(onset)));
                continue;
            };
            let is_cut = self.cut_after(onset).is_some_and(|at| at <= onset + width);
            if high.to != from + width * TICK && !is_cut {
                self.wrong.push(format!("the trigger in {} lasts {} cycles", told(onset), high.to - from));
            }
        }
        for high in &self.pins.trigger {
            if wanted.clone().all(|(onset, _)| self.grid.cycle(onset) != high.from) {
                self.wrong.push(format!("a trigger at cycle {}, where nothing begins", high.from));
            }
        }
    }

    /// The drivers are on from the lead before a pulse to the tail after it: an enabled driver without pulses has DC on its piezo.
    fn drivers(&mut self) {
        let mut trains: Vec<_> = self.pins.lines.iter().flatten().collect();
        trains.sort_unstable_by_key(|train| train.cycle);
        let mut wanted: Vec<High> = Vec::new();
        for train in trains {
            let to = train.cycle + train.pulses * TICK + TAIL;
            match wanted.last_mut() {
                Some(last) if train.cycle - LEAD <= last.to => last.to = last.to.max(to),
                _ => wanted.push(High { from: train.cycle - LEAD, to }),
            }
        }
        for high in self.pins.enable.iter().filter(|high| !wanted.contains(high)) {
            let is_early = wanted.iter().any(|pulses| {
                pulses.from < high.from && (high.from..high.to).contains(&(pulses.from + LEAD))
            });
            // What ends a play may find the drivers on for a pulse that then does not come.
            let (from, to) = (self.grid.tick(high.from).0, self.grid.tick(high.to.min(self.boot.to)).0);
            let is_cut = self.cut_after(from).is_some_and(|at| at <= to + u64::from(HORIZON));
            if is_early {
                self.wrong.push(format!("drivers enabled at cycle {}: the lead is missing", high.from));
            } else if !is_cut {
                self.wrong.push(format!("drivers enabled without a pulse within {}..{}", high.from, high.to));
            }
        }
    }

    /// Drivers and LED are off from the device's status to the next command to arm, and the LED is lit while the drivers are on.
    fn off(&mut self) {
        let (mut times, mut from, mut epoch) = (Vec::new(), Some(self.boot.from), None);
        for (cycle, event) in &self.boot.tap.events {
            match event {
                Event::Opened(_) => epoch = None,
                Event::Control(begun, op) => {
                    epoch = Some(*begun);
                    if matches!(op, Op::Arm { .. }) {
                        times.extend(from.take().map(|from| (from, *cycle)));
                    }
                }
                // Skip a status from before the last command.
                Event::Status(status, tick) if epoch.is_none_or(|epoch| epoch == status.epoch) => {
                    if matches!(status.state, State::Disarmed | State::Faulted) {
                        from = from.or(Some(self.grid.cycle(*tick) + ENABLE_OFF));
                    }
                }
                _ => {}
            }
        }
        times.extend(from.map(|from| (from, self.boot.to)));
        for (from, to) in times.into_iter().filter(|(from, to)| from < to) {
            let mut highs = self.pins.enable.iter().chain(&self.pins.led);
            let on = highs.find(|high| high.from < to && high.to > from);
            self.wrong.extend(on.map(|on| {
                format!("drivers on in cycles {}..{}, and to be off in {from}..{to}", on.from, on.to)
            }));
        }
        let lit = |high: &High| {
            let led = |led: &High| led.from <= high.from + TICK && high.to <= led.to.saturating_add(TICK);
            self.pins.led.iter().any(led)
        };
        if !self.pins.enable.iter().all(lit) {
            self.wrong.push("the drivers are enabled while the LED is off".to_owned());
        }
    }
}
