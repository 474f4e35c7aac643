//! One plain rule of what the lines do, which knows nothing of bursts, blocks and searches.
//!
//! [`Rule::render`] judges each tick as it is rendered: a pin goes up only by a move that begins in its tick, it comes down
//! whenever it is above its goal, and nothing else moves it. What the device takes of a frame, [`Rule::take`] judges by the tick
//! from which moves are in time; it believes refusals, and why a motor is kept.

use crate::bench::Bench;
use firmware_protocol::array::{Layout, MotorSet};
use firmware_protocol::batch::MAX_FIRST_BATCH;
use firmware_protocol::controller::{BLOCK, DRIVER_TAIL, Run};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{DeviceMessage, Mark, MarkKind, Report, Withdraw};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::{Direction, Line, Lines};
use std::collections::VecDeque;

/// After how many ticks at the latest the device looks for pins that are held for too long.
const LATEST_CHECK: u64 = 1_024 + 2 * BLOCK as u64;

/// A move of a frame, and whether it is the second of a stroke.
pub(crate) type Sent = (Move, bool);

/// One pin at the rendered end.
#[derive(Clone, Default)]
struct Pin {
    height: u16,
    goal: u16,
    /// A move takes it up.
    rises: bool,
    /// Moves that have not begun.
    queue: VecDeque<Sent>,
    /// When its last move began, and the last that is no second one of a stroke.
    begun: [u64; 2],
    still_since: u64,
    /// For how many ticks it has been above its goal without a pulse, and for how many although nothing was in its way.
    waits: u64,
    idles: u64,
    /// It has been held for so long that the device may lower it.
    may_fall: bool,
    /// Its height in the ticks that were played.
    shown: u16,
}

pub(crate) struct Rule {
    layout: Layout,
    limits: PowerLimits,
    pins: Vec<Pin>,
    /// Marks of plays that are not rendered, with what they say of holds.
    marks: Vec<(u64, u32)>,
    /// For how long pins may be held, now and at the least by what was said before and may still count.
    hold: [u64; 2],
    /// When it changed.
    hold_since: u64,
    /// For how many ticks the drivers have been enabled.
    enabled: u64,
    /// The lines of the tick before.
    before: Lines,
    kept: MotorSet,
    /// When moves began.
    begins: Vec<u64>,
    /// Moves refused as they began.
    pub(crate) refused: u64,
}

/// What a frame says.
#[derive(Clone)]
pub(crate) struct Frame {
    pub(crate) seq: u16,
    pub(crate) mark: Option<Mark>,
    pub(crate) withdraw: Option<Withdraw>,
    pub(crate) base: u64,
    pub(crate) moves: Vec<Sent>,
}

impl Rule {
    pub(crate) fn new(layout: Layout, limits: PowerLimits) -> Self {
        Self {
            limits,
            pins: vec![Pin::default(); layout.motors()],
            marks: Vec::new(),
            hold: [layout.least_hold().into(); 2],
            hold_since: 0,
            enabled: 0,
            before: Lines::OFF,
            kept: MotorSet::EMPTY,
            begins: Vec::new(),
            refused: 0,
            layout,
        }
    }

    /// More moves have begun lately than may.
    fn is_dense(&self, now: u64) -> bool {
        let recent = now - u64::from(self.layout.dense_ticks() + BLOCK);
        self.begins.iter().rev().take_while(|&&tick| tick >= recent).count() > self.layout.max_dense().into()
    }

    /// The motors that share a rail or a chip with `motor`, where so many of them may have pulses at once.
    fn groups(&self, motor: usize) -> [(u8, MotorSet); 2] {
        let (layout, limits) = (&self.layout, &self.limits);
        let others = |is_one: &dyn Fn(usize) -> bool| {
            let mut others = MotorSet::EMPTY;
            (0..self.pins.len())
                .filter(|&other| other != motor && is_one(other))
                .for_each(|other| others.insert(other as u8));
            others
        };
        [
            (limits.rail_at_once, others(&|other| layout.rail(other) == layout.rail(motor))),
            (limits.chip_at_once, others(&|other| layout.chip(other) == layout.chip(motor))),
        ]
    }

    /// As many others of a group have pulses in these lines as may.
    fn is_full(&self, motor: usize, pulses: MotorSet) -> bool {
        self.groups(motor).into_iter().any(|(limit, others)| (others & pulses).len() >= limit.into())
    }

    /// Another pin of a group that motors take turns in is above its goal; `since`: it was so without a pulse in the tick before.
    fn waits_beside(&self, motor: usize, lines: Lines, since: bool) -> bool {
        self.groups(motor).into_iter().any(|(limit, others)| {
            u32::from(limit) <= others.len()
                && others.without(lines.pulsing()).iter().any(|other| {
                    let pin = &self.pins[usize::from(other)];
                    pin.height > pin.goal && (!since || pin.waits > 0)
                })
        })
    }

    fn set_hold(&mut self, ticks: u32, now: u64) {
        let [hold, before] = self.hold;
        let ticks = ticks.clamp(self.layout.least_hold(), self.layout.longest_hold());
        // The device takes what a mark says when it looks for pins that are held.
        let before = if now > self.hold_since + LATEST_CHECK { hold } else { hold.min(before) };
        (self.hold, self.hold_since) = ([ticks.into(), before], now);
    }

    /// The outputs of the tick `now`, when they are rendered.
    pub(crate) fn render(&mut self, now: u64, run: Run) {
        self.enabled = if run.drivers { self.enabled + 1 } else { 0 };
        // A frame's mark may come before that of the frame before.
        while let Some(next) = self.marks.iter().position(|(at, _)| *at <= now) {
            let (_, hold) = self.marks.remove(next);
            self.set_hold(hold, now);
        }
        for motor in 0..self.pins.len() {
            while self.pins[motor].queue.front().is_some_and(|(to, _)| to.tick.0 <= now) {
                self.begin(motor, now, run.lines);
            }
        }
        let ([hold, before], since) = (self.hold, self.hold_since);
        let is_ready = self.enabled > self.layout.driver_lead().into();
        let takes_turns = self.layout.takes_turns(&self.limits);
        let longest = u64::from(self.layout.driver_lead() + DRIVER_TAIL + 2 * BLOCK)
            + if takes_turns { 64 * 3_000 } else { 0 };
        for motor in 0..self.pins.len() {
            let at = || format!("motor {motor} at {now}");
            let has_room = is_ready && !(takes_turns && self.is_full(motor, run.lines.pulsing()));
            let pin = &mut self.pins[motor];
            match run.lines.line(motor as u8) {
                Line::Pulse(Direction::Up) => {
                    assert!(pin.rises && pin.height < pin.goal, "nothing takes it up: {}", at());
                    pin.height += 1;
                    (pin.still_since, pin.may_fall) = (now + 1, false);
                }
                Line::Pulse(Direction::Down) => {
                    if pin.height == pin.goal && pin.may_fall {
                        pin.goal = 0;
                    }
                    assert!(pin.height > pin.goal, "it is not above its goal, {}: {}", pin.goal, at());
                    pin.height -= 1;
                    (pin.still_since, pin.waits, pin.idles) = (now + 1, 0, 0);
                }
                Line::Off if pin.height > pin.goal => {
                    pin.waits += 1;
                    pin.idles = if has_room { pin.idles + 1 } else { 0 };
                    // The device sees in the next tick that another's burst has ended early.
                    assert!(pin.idles <= takes_turns.into(), "it waits for nothing: {}", at());
                    assert!(pin.waits <= longest, "it waits for too long: {}", at());
                }
                Line::Off => {
                    assert!(pin.height == pin.goal, "it is not at its goal, {}: {}", pin.goal, at());
                    (pin.waits, pin.idles) = (0, 0);
                    let still = now - pin.still_since;
                    pin.may_fall |= pin.goal > 0 && still > hold.min(before);
                    if pin.goal > 0 && now > (pin.still_since + hold).max(since) + LATEST_CHECK {
                        pin.goal = 0;
                    }
                }
            }
            pin.rises &= pin.height < pin.goal;
        }
        self.before = run.lines;
    }

    /// The next move of a motor begins.
    fn begin(&mut self, motor: usize, now: u64, lines: Lines) {
        let pin = &mut self.pins[motor];
        let Some((to, joined)) = pin.queue.pop_front() else { return };
        assert_eq!(to.tick.0, now, "motor {motor}: a move was forgotten");
        pin.begun = [now, if joined { pin.begun[1] } else { now }];
        self.begins.push(now);
        if to.level == pin.goal {
            return;
        }
        let before = std::mem::replace(&mut pin.goal, to.level);
        (pin.rises, pin.may_fall) = (false, false);
        if to.level <= pin.height {
            return;
        }
        if lines.up.contains(motor as u8) {
            pin.rises = true;
            assert!(
                !self.waits_beside(motor, lines, true),
                "motor {motor} at {now}: another comes down first"
            );
            return;
        }
        // A limit refuses it.
        pin.goal = before.min(pin.height);
        let second = pin.queue.pop_front_if(|(_, joined)| *joined);
        self.refused += 1 + u64::from(second.is_some());
        let none = self.layout.no_limits();
        let has_on_time = self.limits.motor < none.motor || self.limits.rail < none.rail;
        let pulses = lines.pulsing() | self.before.pulsing();
        assert!(
            has_on_time
                || self.is_dense(now)
                || self.is_full(motor, pulses)
                || self.waits_beside(motor, Lines::OFF, false),
            "motor {motor} at {now}: no limit refuses"
        );
    }

    /// A frame that was next in order has been taken; `new` is what the device has sent since.
    pub(crate) fn take(&mut self, frame: &Frame, bench: &Bench, armed: bool, new: &[DeviceMessage]) {
        let &Frame { seq, mark, withdraw, base, ref moves } = frame;
        let ready = bench.device.ready().0;
        let begins_play = mark.is_some_and(|mark| mark.kind == MarkKind::Play);
        let fits = base >= ready && (!begins_play || moves.len() <= MAX_FIRST_BATCH);
        let reports = || {
            new.iter().filter_map(|message| match message {
                DeviceMessage::Report { report, .. } => Some(report),
                _ => None,
            })
        };
        if armed && let Some(mark) = mark {
            let is_refused =
                reports().any(|of| matches!(of, Report::OnsetRefused { seq: of, .. } if *of == seq));
            assert_eq!(is_refused, !fits, "an onset at {base}, ready at {ready}");
            if begins_play {
                if !fits {
                    return;
                }
                self.marks.push((base, mark.hold));
                self.kept = MotorSet::EMPTY;
            }
        }
        let verdict = reports().find_map(|of| match *of {
            Report::Verdict { seq: of, late, refused, kept, .. } if of == seq => Some((late, refused, kept)),
            _ => None,
        });
        let (late, refused, kept) = verdict.unwrap_or_default();
        let withdraw =
            withdraw.filter(|_| !begins_play).map_or(MotorSet::EMPTY, |of| of.motors) & self.layout.all();
        for motor in withdraw.iter() {
            let pin = &mut self.pins[usize::from(motor)];
            let mut first = moves.iter().zip(0..).filter(|((to, _), _)| to.motor == motor);
            if kept.contains(motor) {
                self.kept.insert(motor);
                assert!(
                    !armed || pin.begun[1] >= base || first.next().is_some(),
                    "motor {motor} is kept for nothing"
                );
                continue;
            }
            assert!(armed && pin.begun[1] < base, "motor {motor}: a move from {base} on had begun");
            assert!(
                first.next().is_none_or(|((to, _), _)| to.tick.0 >= ready),
                "motor {motor}: the new move is late"
            );
            self.kept.remove(motor);
            let stays = pin.queue.iter().position(|(to, joined)| to.tick.0 >= base && !joined);
            pin.queue.truncate(stays.unwrap_or(pin.queue.len()));
        }
        let mut at = 0;
        while let Some(&(first, _)) = moves.get(at) {
            let both = moves.get(at + 1).is_some_and(|(_, joined)| *joined);
            let all = &moves[at..=at + usize::from(both)];
            let bit = 1 << at;
            let is = |bits: u64| bits & bit != 0;
            at += all.len();
            assert!(armed || is(refused), "a move was taken while not armed");
            if is(refused) {
                continue;
            }
            let is_kept = self.kept.contains(first.motor);
            let is_late = all.iter().any(|(to, _)| to.tick.0 < ready);
            assert_eq!(is(late), is_late || is_kept, "{first:?}, ready at {ready}");
            let Some(pin) = self.pins.get_mut(usize::from(first.motor)) else {
                panic!("there is no {first:?}")
            };
            if is_late && !is_kept && !both && pin.begun[0] < first.tick.0 && pin.goal > first.level {
                (pin.goal, pin.rises) = (first.level.min(pin.height), false);
            }
            let (from, joined) =
                pin.queue.back().map_or((pin.goal, false), |&(to, joined)| (to.level, joined));
            // Moves to rest of a pin at rest are over at once.
            if !is(late) && (from > 0 || joined || all.iter().any(|(to, _)| to.level > 0)) {
                pin.queue.extend(all);
            }
        }
    }

    fn clear(&mut self) {
        self.marks.clear();
        self.pins.iter_mut().for_each(|pin| pin.queue.clear());
    }

    /// A command or a new session begins an epoch.
    pub(crate) fn new_epoch(&mut self) {
        self.kept = MotorSet::EMPTY;
    }

    /// All pins come down: a cut, or an `arm`.
    pub(crate) fn come_down(&mut self, assume_rest: bool) {
        self.clear();
        self.hold = [self.layout.least_hold().into(); 2];
        for pin in &mut self.pins {
            if assume_rest {
                (pin.height, pin.shown) = (0, 0);
            }
            (pin.goal, pin.rises, pin.may_fall) = (0, false, false);
        }
    }

    /// The lines of a tick were played.
    pub(crate) fn play(&mut self, lines: Lines) {
        for (motor, pin) in (0..).zip(&mut self.pins) {
            match lines.line(motor) {
                Line::Pulse(Direction::Up) => pin.shown += 1,
                Line::Pulse(Direction::Down) => pin.shown -= 1,
                Line::Off => {}
            }
        }
    }

    /// All lines have gone off: pins stay where they are.
    pub(crate) fn turn_off(&mut self) {
        self.clear();
        (self.hold, self.enabled, self.before) = ([u64::MAX / 2; 2], 0, Lines::OFF);
        for pin in &mut self.pins {
            (pin.height, pin.goal, pin.rises, pin.may_fall) = (pin.shown, pin.shown, false, false);
            // It waits for the drivers anew when the device is armed again, perhaps in this tick.
            (pin.waits, pin.idles) = (0, 0);
        }
    }

    /// The device counts each pin as high as it is, at the rendered end.
    pub(crate) fn check(&self, bench: &Bench) {
        for (motor, pin) in (0..).zip(&self.pins) {
            assert_eq!(
                bench.device.outstanding(motor),
                pin.height,
                "height of motor {motor} at {}",
                bench.now
            );
        }
    }
}
