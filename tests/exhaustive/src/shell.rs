//! The controller in a shell like the firmware's, and what a skeptic would watch on its outputs.
//!
//! The shell renders blocks ahead, takes frames in pieces, and holds the lines low while the controller says so. An event reaches the
//! controller in the tick `now`, whose lines are already out. [`Shell::tick`] is the only thing that moves time.

use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::{BLOCK, Controller, DRIVER_TAIL, HORIZON, Identity, Run};
use firmware_protocol::message::State;
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::{Direction, Lines};
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use std::collections::VecDeque;
use std::hash::{Hash, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The motors that are used: enough for two that share a frame and a trigger.
pub const USED: usize = 2;

/// What must never happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Broken {
    /// A line was high later than one period after an e-stop or a fault.
    HighAfterStop,
    /// A line was high while the controller was disarmed.
    HighDisarmed,
    /// A pulse that no move, shift or return asks for: up without a move that begins in its tick, or down to no level.
    Unasked,
    /// A pin is above its goal, or below it, and nothing moves it.
    Forgotten,
    /// A return takes too long, or is over while a pin is up.
    Return,
    /// A motor's moves were replaced in part.
    InPart,
    /// A pulse without the drivers' lead, or drivers enabled without a burst.
    Drivers,
    /// At rest the counts do not add up to what was sent, or to the pulses on the lines.
    Counts,
    /// At rest a pin is not where the controller says it is.
    Position,
    /// A silent host was not noticed in time.
    Watchdog,
    /// From this state no commands lead to a play.
    NoWayOut,
    /// Host and device do not come to agree on a good line.
    Disagree,
    /// A stroke without a verdict, with two verdicts, or with a wrong one.
    Verdict,
    /// Both motors, which share a rail, had pulses in a tick although the limit allows one.
    AtOnce,
    /// The code panicked.
    Panic,
}

/// The property of a model that this never happens.
macro_rules! never {
    ($broken:ident, $says:literal) => {
        Property::always($says, |_, state: &Self::State| state.shell.broken != Some(Broken::$broken))
    };
}
pub(crate) use never;

/// The state after a step that can be, with what the step or the judgement of its end has broken. A panic breaks it, too.
pub(crate) fn after<S: Clone>(
    before: &S,
    shell: fn(&mut S) -> &mut Shell,
    apply: impl FnOnce(&mut S) -> Option<()>,
    judge: fn(&mut S) -> Option<Broken>,
) -> Option<S> {
    let mut next = before.clone();
    match catch_unwind(AssertUnwindSafe(|| apply(&mut next))) {
        Ok(done) => done?,
        Err(_) => {
            next = before.clone();
            shell(&mut next).breaks(Broken::Panic);
        }
    }
    let broken = catch_unwind(AssertUnwindSafe(|| judge(&mut next))).unwrap_or(Some(Broken::Panic));
    broken.into_iter().for_each(|broken| shell(&mut next).breaks(broken));
    Some(next)
}

/// A move that may be played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Asked {
    /// As the host sent it.
    pub of: Move,
    /// When it begins, or the first move of its stroke.
    pub first: u64,
    /// When the pin is there, if it follows the move before.
    end: u64,
}

/// A controller with its outputs, and what was seen on them.
#[derive(Clone, Debug)]
pub struct Shell {
    /// The controller.
    pub device: Box<Controller>,
    /// Rendered and not played, with whether pins were being returned then.
    ahead: VecDeque<(Run, bool)>,
    /// The tick whose lines are out.
    pub now: u64,
    start: u64,
    /// Only one motor of a rail may have pulses at once.
    pub one_at_once: bool,
    /// Moves that may be played, as the host sent them.
    asked: Vec<Asked>,
    /// Shifts of rest that may be played.
    shifts: Vec<(u8, Direction)>,
    /// Corrections and shifts by one pulse that the host has asked for: a pin may be so much higher than the controller counts.
    beside: u16,
    /// The highest level asked for.
    highest: u16,
    /// Up to which level each pin goes, while it goes up.
    rising: [u16; USED],
    /// Since when the controller returns.
    returns_since: Option<u64>,
    /// Nothing may be high after this tick, until the controller is armed again.
    pub off_since: Option<u64>,
    /// Up and down pulses seen per motor.
    pub seen: [[u32; 2]; USED],
    /// When pins began to go up, by motor.
    begun: Vec<(u8, u64)>,
    last: Lines,
    /// Ticks for which the drivers have been enabled, and for how many of them without a pulse.
    enabled: u32,
    idle: u32,
    /// Moves that were withdrawn or refused, or have begun where their pin was: the drivers may be on for them.
    taken_back: u64,
    /// The first thing that must not happen.
    pub broken: Option<Broken>,
}

impl Hash for Shell {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Self {
            device,
            ahead,
            now,
            start: _,
            one_at_once: _,
            asked,
            shifts,
            beside,
            highest,
            rising,
            returns_since,
            off_since,
            seen,
            begun,
            last,
            enabled,
            idle,
            taken_back,
            broken,
        } = self;
        device.fingerprint(hasher);
        for (run, returns) in ahead {
            (run.lines, run.trigger, run.drivers, run.ticks, returns).hash(hasher);
        }
        (now, asked, shifts, beside, highest, rising, returns_since).hash(hasher);
        (off_since, seen, begun, last).hash(hasher);
        ((*enabled).min(Array::paper().layout().driver_lead() + 1), idle, taken_back, broken).hash(hasher);
    }
}

impl Shell {
    /// A controller that has just been switched on. Its clock begins shortly before the 32-bit wrap.
    #[must_use]
    pub fn new(boot: u32) -> Self {
        Self::starting_at(boot, (1 << 32) - 5 * u64::from(BLOCK))
    }

    /// The same with another start of the clock.
    #[must_use]
    pub fn starting_at(boot: u32, start: u64) -> Self {
        let identity = Identity { boot, ..Identity::NONE };
        let mut shell = Self {
            device: Box::new(Controller::starting_at(identity, *Array::paper().layout(), Tick(start))),
            ahead: VecDeque::with_capacity(2 * HORIZON as usize),
            now: start,
            start,
            one_at_once: false,
            asked: Vec::new(),
            shifts: Vec::new(),
            beside: 0,
            highest: 0,
            rising: [0; USED],
            returns_since: None,
            off_since: None,
            seen: [[0; 2]; USED],
            begun: Vec::new(),
            last: Lines::OFF,
            enabled: 0,
            idle: 0,
            taken_back: 0,
            broken: None,
        };
        shell.fill();
        shell.play();
        shell
    }

    /// Notes that this is broken, unless something already is.
    pub fn breaks(&mut self, how: Broken) {
        self.broken = self.broken.or(Some(how));
    }

    /// A move that the host sends from now on, or the two of a stroke.
    pub fn ask(&mut self, moves: &[Move]) {
        let Some(first) = moves.first().map(|to| to.tick.0) else { return };
        for &of in moves {
            let before = self.asked.iter().rev().find(|before| before.of.motor == of.motor);
            let from = before.map_or(0, |before| before.of.level);
            let end = of.tick.0 + u64::from(from.abs_diff(of.level) + of.surplus);
            self.asked.push(Asked { of, first, end });
            self.highest = self.highest.max(of.level);
        }
    }

    /// Moves that may still be played, of these motors, from this tick on. A stroke is played whole.
    #[must_use]
    pub fn asked_from(&self, motors: u32, from: u64) -> Vec<Asked> {
        let of = |asked: &&Asked| motors >> asked.of.motor & 1 == 1 && asked.first >= from;
        self.asked.iter().filter(of).copied().collect()
    }

    /// Moves that the host has taken back: none of them may be played.
    pub fn take_back(&mut self, moves: &[Asked]) {
        self.asked.retain(|of| !moves.contains(of));
    }

    /// Whether a pin has begun to go up from `from` on, before `until`.
    #[must_use]
    pub fn has_begun(&self, motor: u8, from: u64, until: u64) -> bool {
        self.begun.iter().any(|&(of, tick)| of == motor && (from..until).contains(&tick))
    }

    /// A shift by one pulse that the host asks for.
    pub fn ask_shift(&mut self, motor: u8, direction: Direction) {
        self.shifts.push((motor, direction));
        self.beside += 1;
    }

    /// An amendment by one pulse that the host asks for.
    pub fn ask_amendment(&mut self) {
        self.beside += 1;
    }

    fn fill(&mut self) {
        let to = Tick(self.now + u64::from(HORIZON));
        while self.device.rendered() < to {
            let run = self.device.render((to - self.device.rendered()) as u32);
            let counters = self.device.counters();
            let taken_back = counters.refused + counters.replaced + counters.dropped + counters.played;
            if std::mem::replace(&mut self.taken_back, taken_back) != taken_back {
                // The drivers were on for a burst that does not come.
                self.idle = 0;
            }
            let returns = self.device.state() == State::Returning;
            self.ahead.push_back((run, returns));
        }
    }

    /// Lets one tick pass. Returns whether the device may have more to take.
    pub fn tick(&mut self) -> bool {
        let mut more = true;
        self.now += 1;
        if (self.now - self.start).is_multiple_of(u64::from(BLOCK)) {
            more = self.device.advance(Tick(self.now));
            self.fill();
            let now = self.now;
            // A way down may wait for the drivers and for other motors.
            let waits = |of: &Asked| if of.of.level < self.highest { self.return_ticks() } else { 1 };
            let asked = self.asked.iter().filter(|of| of.end + waits(of) >= now).copied().collect();
            self.asked = asked;
        }
        self.play();
        self.watch_return();
        if !self.device.is_consistent() {
            self.breaks(Broken::Forgotten);
        }
        more
    }

    /// The longest time in which the pins come down.
    fn return_ticks(&self) -> u64 {
        let lead = Array::paper().layout().driver_lead();
        u64::from(HORIZON + lead + 2 * BLOCK + 2 * u32::from(self.highest + self.beside))
    }

    /// A return is over in time, and then all pins are down. To be called when the controller has heard something.
    pub fn watch_return(&mut self) {
        let state = self.device.state();
        if state == State::Returning {
            let since = *self.returns_since.get_or_insert(self.now);
            if self.now > since + self.return_ticks() {
                self.breaks(Broken::Return);
            }
        } else if self.returns_since.take().is_some()
            && state != State::Faulted
            && (0..USED)
                .any(|motor| self.device.outstanding(motor as u8) > 0 || self.net(motor) > self.beside)
        {
            self.breaks(Broken::Return);
        }
    }

    /// Pulses up less pulses down.
    fn net(&self, motor: usize) -> u16 {
        let [up, down] = self.seen[motor];
        up.saturating_sub(down) as u16
    }

    /// Puts out the lines of the tick `now`.
    fn play(&mut self) {
        let Some((run, returns)) = self.ahead.front_mut() else { return };
        let (rendered, returns) = (Run { ticks: 1, ..*run }, *returns);
        run.ticks -= 1;
        if run.ticks == 0 {
            self.ahead.pop_front();
        }
        let forced = self.device.forced_off(Tick(self.now));
        let (lines, drivers) = if forced { (Lines::OFF, false) } else { (rendered.lines, rendered.drivers) };
        self.watch_drivers(lines != Lines::OFF, drivers);
        let risen = lines.up.without(self.last.up);
        self.begun
            .extend((0..USED as u8).filter(|&motor| risen.contains(motor)).map(|motor| (motor, self.now)));
        let last = std::mem::replace(&mut self.last, lines);
        if lines == Lines::OFF {
            self.rising = [0; USED];
            return;
        }
        if self.off_since.is_some_and(|since| self.now > since) {
            self.breaks(Broken::HighAfterStop);
        }
        if self.device.state() == State::Disarmed {
            self.breaks(Broken::HighDisarmed);
        }
        if !(lines.up & lines.down).is_empty() || !lines.pulsing().without(MotorSet::first(USED)).is_empty() {
            self.breaks(Broken::Unasked);
        }
        if self.one_at_once && lines.pulsing().len() > 1 {
            self.breaks(Broken::AtOnce);
        }
        for motor in 0..USED {
            let number = motor as u8;
            let goes_on = last.up.contains(number);
            let asks =
                self.asked.iter().filter(|asked| asked.of.motor == number && asked.of.tick.0 == self.now);
            let highest = asks
                .map(|asked| asked.of.level)
                .chain([self.rising[motor]].into_iter().filter(|_| goes_on))
                .max();
            self.rising[motor] = highest.filter(|_| lines.up.contains(number)).unwrap_or(0);
            for (direction, mask) in [(Direction::Up, lines.up), (Direction::Down, lines.down)] {
                if mask.contains(number) {
                    if !self.is_asked(motor, direction, returns) {
                        self.breaks(Broken::Unasked);
                    }
                    self.seen[motor][direction as usize] += 1;
                }
            }
            let [up, down] = self.seen[motor];
            if up < down {
                self.breaks(Broken::Unasked);
            }
        }
    }

    /// Whether the host asked for this pulse in this tick.
    fn is_asked(&self, motor: usize, direction: Direction, returns: bool) -> bool {
        let (height, number) = (self.net(motor), motor as u8);
        let of_move = match direction {
            // A move that is not asked for adds nothing to what corrections do.
            Direction::Up => self.rising[motor] > 0 && height < self.rising[motor] + self.beside,
            Direction::Down => {
                let mut begun =
                    self.asked.iter().filter(|asked| asked.of.motor == number && asked.of.tick.0 <= self.now);
                returns || begun.any(|asked| asked.of.level < height)
            }
        };
        of_move || self.shifts.contains(&(number, direction))
    }

    fn watch_drivers(&mut self, pulse: bool, enabled: bool) {
        if !enabled {
            if pulse {
                self.breaks(Broken::Drivers);
            }
            (self.enabled, self.idle) = (0, 0);
            return;
        }
        self.enabled += 1;
        self.idle = if pulse { 0 } else { self.idle + 1 };
        let lead = Array::paper().layout().driver_lead();
        if (pulse && self.enabled <= lead) || self.idle > lead + DRIVER_TAIL + HORIZON {
            self.breaks(Broken::Drivers);
        }
    }

    /// The lines have gone off: the drivers, too.
    pub fn drivers_off(&mut self) {
        (self.enabled, self.idle) = (0, 0);
    }

    /// When its clock started.
    #[must_use]
    pub fn start(&self) -> u64 {
        self.start
    }

    /// The next tick that comes just before, with or just after a change: a block that is rendered, the begin or end of a burst.
    #[must_use]
    pub fn next_change(&self) -> u64 {
        let block = u64::from(BLOCK);
        let since = self.now - self.start;
        let blocks =
            [since / block, since / block + 1, since / block + 2].map(|blocks| self.start + blocks * block);
        let bursts = self.asked.iter().flat_map(|asked| [asked.of.tick.0, asked.end]);
        let changes = blocks.into_iter().chain(bursts);
        let times = changes.flat_map(|at| [at.saturating_sub(1), at, at + 1]).filter(|&at| at > self.now);
        times.min().unwrap_or(self.now + 1)
    }

    /// Whether the lines and drivers are off in all ticks that are rendered, with nothing to come.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        self.ahead.iter().all(|(run, _)| run.lines == Lines::OFF && !run.drivers)
    }
}
