//! Follows the one rule tick by tick, for all pins at once.
//!
//! In a tick each motor, in order of number: ends its burst, begins its move, and comes down if it is above its goal and may.

use crate::log::{Log, Train};
use crate::oracle::expected::{CutAt, Expected, Soft};
use crate::oracle::plan::{Live, Plan, Step};
use firmware_protocol::controller::{BLOCK, DRIVER_TAIL};
use firmware_protocol::limits::{PowerLimits, Refusal, correction};
use firmware_protocol::message::Cause;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_test_support::paper::{DRIVER_LEAD, MOTORS, MOTORS_PER_CHIP, MOTORS_PER_RAIL, WHOLE_TRAVEL};

/// Ticks before an e-stop's cut in which a planned pulse may be missing, and ticks after it in which one may still begin: the
/// tick being played counts as played, whether it was cut off or not.
const FORCE: (u64, u64) = (1, 1);
const LEAD: u64 = DRIVER_LEAD as u64;
/// Most ticks by which a pin may be held for longer than a play says: so often the device looks, and the drivers start up.
const HOLD_SLACK: u64 = 1_024 + BLOCK as u64 + LEAD;

#[derive(Clone, Copy, Debug)]
struct Burst {
    direction: Direction,
    start: Tick,
    pulses: u16,
    /// The last ones, which push against the lower stop.
    pushes: u16,
    /// The heights before and after it.
    from: u16,
    to: u16,
}

impl Burst {
    fn end(&self) -> Tick {
        self.start + u64::from(self.pulses)
    }

    /// Within a burst the height counts pulses and stays between both levels.
    fn height(&self, now: Tick) -> u16 {
        let played = (now - self.start).min(u16::MAX.into()) as u16;
        match self.direction {
            _ if now >= self.end() => self.to,
            Direction::Up => self.from.saturating_add(played).min(self.to),
            Direction::Down => self.from.saturating_sub(played).max(self.to),
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Pin {
    height: u16,
    goal: u16,
    burst: Option<Burst>,
    /// For the way down that begins next: the pulses that an amendment adds, and the surplus.
    correction: i32,
    surplus: u16,
    /// Net pulses up that corrections have added since it was at rest, and its highest level since.
    beside: i32,
    highest: u16,
    still_since: Tick,
    begun: Tick,
    /// When its last burst was cut short, and when its goal was set.
    cut: Tick,
    told: Tick,
}

impl Pin {
    fn height(&self, now: Tick) -> u16 {
        self.burst.map_or(self.height, |burst| burst.height(now))
    }

    fn is_to_descend(&self) -> bool {
        self.burst.is_none() && (self.height > self.goal || self.surplus > 0)
    }

    /// Pulses until it is down, if nothing but its way down is to come.
    fn left(&self, now: Tick) -> u64 {
        let running = self.burst.map_or(0, |burst| burst.end() - now);
        let then = self.burst.map_or(self.height, |burst| burst.to);
        running + u64::from(then) + u64::from(self.surplus) + u64::from(self.correction.unsigned_abs())
    }

    fn end(&mut self, now: Tick) {
        let Some(burst) = self.burst else { return };
        if now < burst.end() {
            self.cut = now;
        }
        let height = burst.height(now);
        let moving = i64::from(burst.pulses - burst.pushes).min((now - burst.start) as i64) as i32;
        let moved = i32::from(height) - i32::from(burst.from);
        self.beside += if burst.direction == Direction::Up { moving } else { -moving } - moved;
        (self.burst, self.height, self.still_since) = (None, height, now);
        if height == 0 {
            (self.beside, self.highest) = (0, 0);
        }
    }

    fn set_goal(&mut self, level: u16) {
        (self.goal, self.correction, self.surplus) = (level, 0, 0);
    }

    /// Whether it has pulses in this tick, or had a burst that was cut short in it.
    fn is_busy(&self, now: Tick, with_cut: bool) -> bool {
        self.burst.is_some_and(|burst| burst.end() > now) || with_cut && self.cut == now
    }

    /// As much of a correction as leaves the pin within a correction of its highest level.
    fn bounded(&self, wanted: i32) -> i32 {
        let bound = i32::from(correction(self.highest.max(self.goal)));
        let sign = if self.goal > self.height { 1 } else { -1 };
        let mut some = wanted;
        while some != 0 && (self.beside + sign * some).abs() > bound {
            some -= some.signum();
        }
        some
    }

    fn begin(&mut self, now: Tick, direction: Direction, pulses: u16, pushes: u16) {
        self.highest = self.highest.max(self.goal);
        self.burst = Some(Burst { direction, start: now, pulses, pushes, from: self.height, to: self.goal });
    }
}

#[derive(Clone, Debug)]
struct Pins<'a> {
    moves: &'a [Live],
    holds: &'a [(Tick, u32)],
    pins: [Pin; MOTORS],
    /// The queued moves of each motor, and how many have passed.
    queues: [(Vec<usize>, usize); MOTORS],
    /// When the drivers were enabled, and when the tail of the last pulse ends.
    on_since: Option<Tick>,
    tail_end: Tick,
    limits: PowerLimits,
    seeks: bool,
    /// The return under way.
    returns: Option<CutAt>,
    /// What was flushed is not: to see what a tick would have had.
    flushes_nothing: bool,
    out: Expected,
}

/// Plays a plan.
pub(super) fn play(mut plan: Plan) -> Expected {
    let queues = std::array::from_fn(|motor| (plan.queue(motor as u8), 0));
    let (out, steps) = (std::mem::take(&mut plan.out), std::mem::take(&mut plan.steps));
    let limits = Array::paper().layout().no_limits();
    let (mut out, moves) = (out, &plan.moves);
    let flushed =
        moves.iter().filter(|live| live.is_queued()).filter_map(|live| Some((live.to.tick, live.flushed?)));
    out.silent.extend(flushed.map(|(tick, at)| (Tick(tick.0 - LEAD), at.min(tick))));
    let mut pins = Pins {
        moves: &plan.moves,
        holds: &plan.holds,
        pins: [Pin::default(); MOTORS],
        queues,
        on_since: None,
        tail_end: Tick(0),
        limits,
        seeks: false,
        returns: None,
        flushes_nothing: false,
        out,
    };
    let mut steps = steps.into_iter().peekable();
    let mut now = Tick(0);
    loop {
        while let Some((_, step)) = steps.next_if(|(tick, _)| *tick <= now) {
            pins.step(now, step);
        }
        pins.tick(now);
        let is_busy =
            pins.on_since.is_some() || pins.pins.iter().any(|pin| pin.burst.is_some() || pin.is_to_descend());
        let next = [
            steps.peek().map(|&(tick, _)| tick),
            pins.next_move(),
            pins.next_change(now).map(|at| Tick(at.0 - LEAD)),
        ];
        now = match next.into_iter().flatten().min() {
            _ if is_busy => now + 1,
            Some(next) => next.max(now + 1),
            None => break,
        };
    }
    pins.out
}

impl<'a> Pins<'a> {
    fn wrong(&mut self, now: Tick, text: &str) {
        self.out.contradictions.push(format!("tick BOOT+{}: {text}", now.since(Tick::BOOT)));
    }

    fn step(&mut self, now: Tick, step: Step) {
        match step {
            Step::Arm(limits, assume_rest) => {
                self.limits = Array::paper().layout().no_limits().min(limits);
                if assume_rest {
                    self.pins = self.pins.map(|pin| Pin { still_since: pin.still_since, ..Pin::default() });
                }
            }
            Step::Lower { late, held, order } => {
                late.iter().for_each(|motor| self.lower(now, motor.into(), order, true));
                held.iter().for_each(|motor| self.lower(now, motor.into(), order, false));
            }
            Step::Cut(cut @ CutAt { return_ticks: Some(_), .. }, seek) => self.bring_down(now, cut, seek),
            Step::Cut(cut, _) => self.turn_off(now, cut),
        }
    }

    /// The device has lowered a goal: by a late move to a lower level, or because the pin was held for too long.
    fn lower(&mut self, now: Tick, motor: usize, order: usize, by_late: bool) {
        let Pin { goal, begun, still_since, .. } = self.pins[motor];
        let late = self.moves.iter().filter(|live| live.late && !live.of_stroke && live.order < order);
        let late = late
            .filter(|live| usize::from(live.to.motor) == motor && live.to.tick > begun && live.to.tick < now);
        let level = late.map(|live| live.to.level).filter(|&level| level < goal).min().filter(|_| by_late);
        if level.is_none() && (by_late || now - still_since <= self.hold(now)) {
            self.wrong(now, &format!("motor {motor} is lowered without a reason"));
        }
        let pin = &mut self.pins[motor];
        pin.end(now);
        pin.told = now;
        pin.set_goal(level.unwrap_or(0).min(pin.height));
    }

    /// For how long pins may be held at a tick, by the last play that has begun.
    fn hold(&self, now: Tick) -> u64 {
        let last = self.holds.iter().rev().find(|&&(from, _)| from <= now);
        last.map_or(Array::paper().layout().least_hold(), |&(_, hold)| hold).into()
    }

    fn bring_down(&mut self, now: Tick, cut: CutAt, seek: Option<(u16, bool)>) {
        let array = Array::paper();
        let layout = array.layout();
        if let Some((pulses, known)) = seek {
            let highest = self.pins.iter().map(|pin| pin.height).max().unwrap_or(0);
            let least = if known { layout.least_seek(highest) } else { WHOLE_TRAVEL };
            if pulses < least {
                self.wrong(
                    now,
                    &format!("a seek of {pulses} pulses, where {least} are needed to reach the lower stop"),
                );
            }
            self.pins = self.pins.map(|pin| Pin { height: pulses, ..pin });
            self.seeks = true;
        }
        for motor in 0..MOTORS {
            if cut.cause != Cause::Request {
                self.check_held(motor, now);
            }
            let pin = &mut self.pins[motor];
            (pin.still_since, pin.told) = (now, now);
            if pin.goal > 0 || pin.burst.is_some_and(|burst| burst.direction == Direction::Up) {
                pin.end(now);
                pin.set_goal(0);
            }
        }
        self.check_outstanding(now, cut);
        let longest = self.pins.iter().map(|pin| pin.left(now)).max().unwrap_or(0);
        let turns = u64::from(layout.turns(&self.limits));
        let most = if longest > 0 { self.ready(now) - now + turns * longest } else { 0 };
        if cut.return_ticks.is_some_and(|ticks| u64::from(ticks) > most) {
            self.wrong(now, &format!("{cut:?}, and a return takes at most {most} ticks"));
        }
        self.returns = Some(cut);
    }

    fn check_outstanding(&mut self, now: Tick, cut: CutAt) {
        let found: u32 = self.pins.iter().map(|pin| u32::from(pin.height(now))).sum();
        if found != cut.outstanding {
            self.wrong(now, &format!("{cut:?}, and the moves give {found} outstanding return pulses"));
        }
    }

    fn turn_off(&mut self, now: Tick, cut: CutAt) {
        let (from, to) = (Tick(now.0 - FORCE.0), now + FORCE.1);
        let log = std::mem::take(&mut self.out.log);
        let mut ahead = Self { flushes_nothing: true, ..self.clone() };
        ahead.tick(now);
        let planned = log.within(from, now).lines.into_iter().zip(ahead.out.log.lines).enumerate();
        let planned = planned
            .flat_map(|(line, (played, next))| played.into_iter().chain(next).map(move |of| (line, of)));
        self.out.soft.push(Soft { from, to, planned: Log::of(planned.collect()) });
        self.out.log = log;
        for pin in &mut self.pins {
            pin.end(now);
            pin.set_goal(pin.height);
            if self.seeks {
                (pin.height, pin.goal) = (0, 0);
            }
        }
        self.check_outstanding(now, cut);
        (self.on_since, self.tail_end, self.returns, self.seeks) = (None, now, None, false);
    }

    fn tick(&mut self, now: Tick) {
        for motor in 0..MOTORS {
            if self.pins[motor].burst.is_some_and(|burst| burst.end() <= now) {
                self.pins[motor].end(now);
            }
            if let Some(live) = self.due(motor, now) {
                self.begin(motor, now, live);
            }
            if self.pins[motor].is_to_descend() && self.ready(now) <= now && self.has_turn(motor, now) {
                self.descend(motor, now);
            }
            if let Some(Burst { direction, .. }) = self.pins[motor].burst {
                self.out.log.push(motor, Train { start: now, direction, pulses: 1 });
            }
        }
        self.drive(now);
        let is_over = self.pins.iter().all(|pin| pin.burst.is_none() && !pin.is_to_descend());
        if let (true, Some(cut)) = (is_over, self.returns) {
            (self.returns, self.seeks) = (None, false);
            if now - cut.at > cut.return_ticks.unwrap_or(0).into() {
                self.wrong(now, &format!("{cut:?}, and the return is over only now"));
            }
        }
    }

    /// The drivers are on from the lead before a pulse to the tail after it.
    fn drive(&mut self, now: Tick) {
        let waits = self.pins.iter().any(Pin::is_to_descend);
        if self.pins.iter().any(|pin| pin.burst.is_some()) {
            self.tail_end = now + 1 + u64::from(DRIVER_TAIL);
        } else if !waits && now >= self.tail_end && self.next_change(now).is_none_or(|next| next > now + LEAD)
        {
            self.on_since = None;
            return;
        }
        self.on_since = self.on_since.or(Some(now));
    }

    /// The first tick from now on in which a pin may come down.
    fn ready(&self, now: Tick) -> Tick {
        now.max(self.on_since.unwrap_or(now) + LEAD)
    }

    fn is_flushed(&self, live: &Live, now: Tick) -> bool {
        !self.flushes_nothing && live.flushed.is_some_and(|at| at <= now)
    }

    /// The move that begins now.
    fn due(&mut self, motor: usize, now: Tick) -> Option<&'a Live> {
        let moves = self.moves;
        while let Some(&at) =
            self.queues[motor].0.get(self.queues[motor].1).filter(|&&at| moves[at].to.tick <= now)
        {
            self.queues[motor].1 += 1;
            if moves[at].to.tick == now && !self.is_flushed(&moves[at], now) {
                return Some(&moves[at]);
            }
        }
        None
    }

    /// When the next move begins, flushed or not.
    fn next_move(&self) -> Option<Tick> {
        let first = self.queues.iter().filter_map(|(queue, passed)| queue.get(*passed));
        first.map(|&at| self.moves[at].to.tick).min()
    }

    /// When the next move begins for which the drivers are enabled. One to the level before it needs none.
    fn next_change(&self, now: Tick) -> Option<Tick> {
        let firsts = self.queues.iter().filter_map(|(queue, passed)| {
            let coming = queue[*passed..].iter().map(|&at| &self.moves[at]);
            coming.filter(|live| live.drives && !self.is_flushed(live, now)).map(|live| live.to.tick).next()
        });
        firsts.min()
    }

    fn begin(&mut self, motor: usize, now: Tick, live: &Live) {
        if live.to.level > self.pins[motor].height(now) {
            self.check_held(motor, now);
        }
        let full = self.full(motor, now, true, false);
        let pin = &mut self.pins[motor];
        pin.end(now);
        let (before, height, level) = (pin.goal, pin.height, live.to.level);
        pin.set_goal(level);
        (pin.begun, pin.told) = (now, now);
        // A correction is for the distance that was planned.
        let amended = live.amended.filter(|_| height == live.from);
        let wanted = amended.map_or(0, |pulses| i32::from(pulses) - i32::from(level.abs_diff(height)));
        pin.correction = pin.bounded(wanted);
        pin.surplus = live.to.surplus;
        match live.refused {
            Some(reason) => {
                pin.set_goal(before.min(height));
                let at_once = matches!(reason, Refusal::RailAtOnce | Refusal::ChipAtOnce);
                if level <= height || at_once && full != Some(reason) {
                    self.wrong(
                        now,
                        &format!("motor {motor}: {reason:?} is no reason to refuse {:?}", live.to),
                    );
                }
            }
            None if level > height => {
                let pulses = i32::from(level - height) + std::mem::take(&mut pin.correction);
                pin.begin(now, Direction::Up, pulses as u16, 0);
                if let Some(reason) = full {
                    self.wrong(now, &format!("motor {motor} goes up in spite of {reason:?}"));
                }
            }
            None => {}
        }
        if self.pins[motor].burst.is_none() && !self.pins[motor].is_to_descend() {
            self.out.silent.push((Tick(now.0 - LEAD), now));
        }
    }

    fn descend(&mut self, motor: usize, now: Tick) {
        self.check_held(motor, now);
        let pin = &mut self.pins[motor];
        let distance = i32::from(pin.height - pin.goal);
        let (correction, surplus) = (std::mem::take(&mut pin.correction), std::mem::take(&mut pin.surplus));
        let pulses = (distance + correction).max(distance.min(1)) as u16;
        pin.begin(now, Direction::Down, pulses + surplus, surplus);
    }

    /// Whether a pin may come down. If there is room only because a burst has just been cut short, it may do so a tick later.
    fn has_turn(&self, motor: usize, now: Tick) -> bool {
        let first = motor / MOTORS_PER_RAIL * MOTORS_PER_RAIL;
        let mut rail = self.pins[first..first + MOTORS_PER_RAIL].iter();
        let looks = self.pins[motor].told == now
            || rail.any(|pin| pin.still_since == now && pin.cut != now || pin.cut + 1 == now);
        self.full(motor, now, false, !looks).is_none()
    }

    /// Which group of the motor has as many others with pulses as may. For a way up it is also full while one waits to come down.
    fn full(&self, motor: usize, now: Tick, is_up: bool, with_cut: bool) -> Option<Refusal> {
        let PowerLimits { rail_at_once, chip_at_once, .. } = self.limits;
        let groups = [
            (MOTORS_PER_RAIL, rail_at_once, Refusal::RailAtOnce),
            (MOTORS_PER_CHIP, chip_at_once, Refusal::ChipAtOnce),
        ];
        let full = groups.into_iter().find(|&(size, most, _)| {
            let first = motor / size * size;
            let others =
                || (first..first + size).filter(|&other| other != motor).map(|other| &self.pins[other]);
            let busy = others().filter(|pin| pin.is_busy(now, with_cut)).count();
            usize::from(most) < size && (busy >= most.into() || is_up && others().any(Pin::is_to_descend))
        });
        full.map(|(.., reason)| reason)
    }

    /// Whether a pin was held for longer than any play has said.
    fn check_held(&mut self, motor: usize, now: Tick) {
        let Pin { height, goal, burst, still_since, told, .. } = self.pins[motor];
        let holds = self.holds.iter().map(|&(_, hold)| u64::from(hold));
        let longest = holds.max().unwrap_or(0).max(self.hold(Tick(0))) + HOLD_SLACK;
        // One that waits for its turn is held no longer.
        let until = if goal < height { told } else { now };
        if height > 0 && burst.is_none() && until - still_since > longest {
            self.wrong(
                now,
                &format!("motor {motor} was held since {still_since:?}, for more than {longest} ticks"),
            );
        }
    }
}
