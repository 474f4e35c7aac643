//! The controller in a shell like the firmware's, and what a skeptic would watch on its outputs.
//!
//! The shell renders blocks ahead, takes frames in pieces, and holds the lines low while the controller says so. An event reaches the
//! controller in the tick `now`, whose lines are already out. [`Shell::tick`] is the only thing that moves time.

use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::{BLOCK, Controller, DRIVER_TAIL, HORIZON, Identity, Run};
use firmware_protocol::message::State;
use firmware_protocol::stroke::{Direction, Lines};
use meissner_array::strokes::Stroke;
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
    /// A pulse that no stroke, move or return asks for.
    Unasked,
    /// A motor's strokes were replaced in part.
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
    /// A stroke without a verdict, with two, or with a wrong one.
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
    /// Strokes that may be played, as the host sent them.
    asked: Vec<Stroke>,
    /// Moves that may be played.
    moves: Vec<(u8, Direction)>,
    /// Nothing may be high after this tick, until the controller is armed again.
    pub off_since: Option<u64>,
    /// Up and down pulses seen per motor.
    pub seen: [[u32; 2]; USED],
    /// When strokes have begun, by motor.
    begun: Vec<(u8, u64)>,
    last: Lines,
    /// Ticks for which the drivers have been enabled, and for how many of them without a pulse.
    enabled: u32,
    idle: u32,
    /// Bursts that were withdrawn or refused: the drivers may be on for them.
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
            moves,
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
        (now, asked, moves, off_since, seen, begun, last).hash(hasher);
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
            moves: Vec::new(),
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

    /// A stroke that the host sends from now on.
    pub fn ask(&mut self, stroke: Stroke) {
        self.asked.push(stroke);
    }

    /// Strokes that may still be played, of these motors, from this tick on.
    #[must_use]
    pub fn asked_from(&self, motors: u32, from: u64) -> Vec<Stroke> {
        let of = |stroke: &&Stroke| motors >> stroke.motor & 1 == 1 && stroke.up.0 >= from;
        self.asked.iter().filter(of).copied().collect()
    }

    /// Strokes that the host has taken back: none of them may be played.
    pub fn take_back(&mut self, strokes: &[Stroke]) {
        self.asked.retain(|stroke| !strokes.contains(stroke));
    }

    /// Whether a stroke of this motor has begun from `from` on, before `until`.
    #[must_use]
    pub fn has_begun(&self, motor: u8, from: u64, until: u64) -> bool {
        self.begun.iter().any(|&(of, tick)| of == motor && (from..until).contains(&tick))
    }

    /// A move that the host asks for.
    pub fn ask_move(&mut self, motor: u8, direction: Direction) {
        self.moves.push((motor, direction));
    }

    fn fill(&mut self) {
        let to = Tick(self.now + u64::from(HORIZON));
        while self.device.rendered() < to {
            let run = self.device.render((to - self.device.rendered()) as u32);
            let counters = self.device.counters();
            let taken_back = counters.refused + counters.replaced;
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
            self.asked.retain(|stroke| stroke.end().0 + 1 >= now);
        }
        self.play();
        more
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
        self.last = lines;
        if lines == Lines::OFF {
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
            for (direction, mask) in [(Direction::Up, lines.up), (Direction::Down, lines.down)] {
                if mask.contains(motor as u8) {
                    self.seen[motor][direction as usize] += 1;
                    if !self.is_asked(motor as u8, direction, returns) {
                        self.breaks(Broken::Unasked);
                    }
                }
            }
        }
    }

    /// Whether the host asked for this pulse in this tick, perhaps with an amendment by one pulse.
    fn is_asked(&self, motor: u8, direction: Direction, returns: bool) -> bool {
        let of_stroke = self.asked.iter().filter(|stroke| stroke.motor == motor).any(|stroke| {
            let burst = stroke.bursts()[direction as usize];
            (burst.start.0..=burst.end().0).contains(&self.now)
        });
        of_stroke || (returns && direction == Direction::Down) || self.moves.contains(&(motor, direction))
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
        let bursts =
            self.asked.iter().flat_map(|stroke| stroke.bursts().map(|burst| [burst.start.0, burst.end().0]));
        let changes = blocks.into_iter().chain(bursts.flatten());
        let times = changes.flat_map(|at| [at.saturating_sub(1), at, at + 1]).filter(|&at| at > self.now);
        times.min().unwrap_or(self.now + 1)
    }

    /// Whether the lines and drivers are off in all ticks that are rendered, with nothing to come.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        self.ahead.iter().all(|(run, _)| run.lines == Lines::OFF && !run.drivers)
    }
}
