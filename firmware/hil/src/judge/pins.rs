//! Checks the chip's pins to the cycle: widths, the grid, trigger, driver enable and LED.

use crate::judge::{Boot, Finding};
use crate::log::{Log, Train};
use crate::oracle::{Expected, HORIZON, Soft};
use crate::pins::{High, PinTrain, Pins};
use crate::tap::Event;
use crate::time::{Grid, MS, TICK};
use firmware_protocol::message::{Op, State, Trigger};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// High for 20 % of a tick, and for 80 %.
const UP: u64 = TICK / 5;
const DOWN: u64 = TICK / 5 * 4;
/// Most time from a status that says disarmed to the supply being off.
const ENABLE_OFF: u64 = (64 + 16) * TICK;
/// Most time by which the LED may differ from the drivers' enable.
const LED_SLACK: u64 = TICK;
/// Most difference between the clock read from the link and that of the pins: transfer, processing and a step of the bench.
const CLOCK: std::ops::RangeInclusive<i64> = -(2 * MS as i64)..=(TICK as i64);

impl Boot {
    /// The pins as ticks; adds faults to `findings`.
    pub(super) fn judge_pins(
        &self,
        pins: &Pins,
        expected: &Expected,
        grid: Grid,
        findings: &mut Vec<Finding>,
    ) -> Log {
        let mut log = Log::default();
        let mut starts: Vec<_> = pins
            .lines
            .iter()
            .enumerate()
            .flat_map(|(line, trains)| trains.iter().map(move |t| (line, t)))
            .collect();
        starts.sort_by_key(|(_, train)| train.cycle);
        for (line, train) in starts {
            pulses(line, train, grid, &expected.soft, &mut log, findings);
            let on = |high: &&High| high.from <= train.cycle && train.end() <= high.to;
            if !pins.enable.iter().any(|high| on(&high)) && !is_soft(&expected.soft, grid.tick(train.end()).0)
            {
                findings.push(Finding::NotEnabled { line, cycle: train.cycle });
            }
        }
        findings.extend(pins.still_high().map(|(line, since)| Finding::Static { line, since }));
        findings.extend(pins.strays.iter().map(|&(pin, cycle)| Finding::Stray { pin, cycle }));
        let off = grid.origin - self.grid.origin;
        if pins.first().is_some() && !CLOCK.contains(&off) {
            findings.push(Finding::Clock { off });
        }
        trigger(pins, expected, grid, findings);
        self.enable(pins, grid, findings);
        log
    }

    /// Intervals in which drivers and LED must be off: from the device's status to the next command to arm.
    fn off_times(&self, grid: Grid) -> Vec<(u64, u64)> {
        let (mut times, mut from, mut epoch) = (Vec::new(), Some(self.from), None);
        for (cycle, event) in &self.tap.events {
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
                        from = from.or(Some(grid.cycle(*tick) + ENABLE_OFF));
                    }
                }
                _ => {}
            }
        }
        times.extend(from.map(|from| (from, self.to)));
        times
    }

    fn enable(&self, pins: &Pins, grid: Grid, findings: &mut Vec<Finding>) {
        for (quiet_from, quiet_to) in self.off_times(grid).into_iter().filter(|(from, to)| from < to) {
            let mut highs = pins.enable.iter().chain(&pins.led);
            let on = highs.find(|high| high.from < quiet_to && high.to > quiet_from);
            findings.extend(on.map(|on| Finding::Enabled { from: on.from, to: on.to, quiet_from, quiet_to }));
        }
        let lit = |high: &High| {
            pins.led
                .iter()
                .any(|led| led.from <= high.from + LED_SLACK && high.to <= led.to.saturating_add(LED_SLACK))
        };
        if !pins.enable.iter().all(lit) {
            findings.push(Finding::Led);
        }
    }
}

fn is_soft(soft: &[Soft], tick: Tick) -> bool {
    soft.iter().any(|soft| (soft.from..soft.to).contains(&tick))
}

fn pulses(
    line: usize,
    train: &PinTrain,
    grid: Grid,
    soft: &[Soft],
    log: &mut Log,
    findings: &mut Vec<Finding>,
) {
    let (tick, late) = grid.tick(train.cycle);
    if late != 0 {
        findings.push(Finding::OffGrid { line, cycle: train.cycle, tick, late });
    }
    // A pulse cut off has no known direction, even if it has the width of an up pulse.
    if train.pulses == 1 && train.width < DOWN && is_soft(soft, tick) {
        return;
    }
    if train.width != UP && train.width != DOWN {
        findings.push(Finding::Width { line, cycle: train.cycle, tick, width: train.width });
    }
    let direction = if train.width <= (UP + DOWN) / 2 { Direction::Up } else { Direction::Down };
    log.push(line, Train { start: tick, direction, pulses: train.pulses });
}

fn trigger(pins: &Pins, expected: &Expected, grid: Grid, findings: &mut Vec<Finding>) {
    let was_cut =
        |from: Tick, to: Tick| expected.cuts.iter().any(|cut| from <= cut.at && cut.at <= to + HORIZON);
    let wanted = highs(&expected.triggers);
    let shown: Vec<_> = pins.trigger.iter().map(|high| (grid.tick(high.from), high)).collect();
    for &Cell { begun, from, .. } in &wanted {
        if !shown.iter().any(|((tick, _), _)| *tick == from) && !was_cut(begun, from) {
            findings.push(Finding::NoTrigger { onset: from });
        }
    }
    for ((tick, late), high) in shown {
        let Some(wanted) = wanted.iter().find(|wanted| wanted.from == tick && late == 0) else {
            findings.push(Finding::Trigger { tick, late });
            continue;
        };
        let cycles = high.to - high.from;
        let whole = cycles == (wanted.to - wanted.from) * TICK;
        if !whole && high.to != u64::MAX && !was_cut(wanted.begun, grid.tick(high.to).0) {
            findings.push(Finding::TriggerLength { tick, cycles });
        }
    }
}

/// An interval in which the trigger output is high, of the trigger that began at `begun`.
struct Cell {
    begun: Tick,
    from: Tick,
    to: Tick,
}

/// When triggers are high: cell by cell as the specification says, until the next trigger begins.
fn highs(triggers: &[(Tick, Trigger)]) -> Vec<Cell> {
    let mut highs: Vec<Cell> = Vec::new();
    for (at, &(begun, trigger)) in triggers.iter().enumerate() {
        let next = triggers.get(at + 1).map_or(Tick(u64::MAX), |next| next.0);
        let cells = 1 | u16::from(trigger.code) << 1;
        for cell in (0..9u64).filter(|cell| cells >> cell & 1 == 1) {
            let width = u64::from(trigger.width);
            let (from, to) = (begun + cell * width, (begun + (cell + 1) * width).min(next));
            match highs.last_mut() {
                _ if from >= to => {}
                Some(last) if last.to == from => last.to = to,
                _ => highs.push(Cell { begun, from, to }),
            }
        }
    }
    highs
}
