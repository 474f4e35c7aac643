//! Tests random sequences of orders, with stops, restarts, kills and changed clocks, against a plain
//! sum of the lines' vibration.
//!
//! The simulated lab has a device that plays the compiled moves of one play after the other and
//! brings pins down after a cut, a disk, and an [`Account`]. It notes every move. At the end, plain
//! sums over these notes must be within the limits. `CASES=1000000` runs a million sequences.

use super::super::rule::REPORT_S;
use super::super::*;
use firmware_protocol::stroke::Direction;
use jiff::civil::date;
use meissner_array::pattern::Pattern;
use meissner_array::strokes::{Step, StrokeOptions, Strokes};
use meissner_stream::{Settings, dry_run};
use meissner_test_support::at_length;

/// Sequences of a run.
const CASES: u64 = 5_000;
/// The time that a stop takes, s.
const STOP_S: f64 = 0.02;
/// How long the board plays on after a kill, s: its host watchdog by default.
const LEASE_S: f64 = 0.3;
const DAY_S: f64 = 86_400.0;
/// A burst of 60 um, s: what may be beyond a limit.
const STROKE_S: f64 = 0.005;

const LIMITS: ParticipantLimits = ParticipantLimits {
    max_amplitude_um: 200.0,
    max_continuous_s: 2.0,
    pause_s: 1.0,
    max_session_s: 5.0,
    max_day_s: 7.0,
};

/// Random numbers.
struct Random(u64);

impl Random {
    fn below(&mut self, n: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) % n
    }

    fn upto(&mut self, most: f64) -> f64 {
        self.below(10_001) as f64 / 1e4 * most
    }
}

/// The pulses of a pin in one direction, of a play or of the lab: from and to, s, and its levels before and after.
#[derive(Clone, Copy, Debug)]
struct Move {
    from_s: f64,
    to_s: f64,
    motor: u8,
    levels: [u16; 2],
}

impl Move {
    /// The move as far as it is between two times.
    fn between(self, from_s: f64, to_s: f64) -> Option<Self> {
        let (from_s, to_s) = (from_s.max(self.from_s), to_s.min(self.to_s));
        let levels = [from_s, to_s].map(|at_s| self.level_at(at_s));
        (from_s < to_s).then_some(Self { from_s, to_s, levels, ..self })
    }

    /// The level at a time, pulses above rest.
    fn level_at(&self, at_s: f64) -> u16 {
        let [before, after] = self.levels.map(f64::from);
        let share = ((at_s - self.from_s) / (self.to_s - self.from_s)).clamp(0.0, 1.0);
        (before + share * (after - before)).round() as u16
    }
}

/// A play that may be ordered, as the daemon judges it and as it moves the pins.
struct Kind {
    vibration: Vibration,
    end_s: f64,
    /// In order of time, as far as a play may get.
    moves: Vec<Move>,
}

/// How long plays without end are known, s; they are stopped before.
const KNOWN_S: f64 = 120.0;
const KNOWN_MOVES: usize = 20_000;

impl Kind {
    /// A pattern of drives of 0.1 to 300 Hz, for as short as a stroke, short ramps, tones and noise.
    fn random(random: &mut Random) -> Option<Self> {
        let longest_s = [0.1, 2.5][random.below(2) as usize];
        let repeat_s = 0.02 + random.upto(longest_s);
        let mut text = "format = 1\nname = \"random\"\n".to_owned();
        let has_end = random.below(4) > 0;
        if has_end {
            text += &format!("duration_s = {repeat_s}\n");
        }
        for motor in 0..=random.below(3) {
            let (start_s, um) = (random.upto(repeat_s / 2.0), 0.5 + random.upto(60.0));
            let hz = 10f64.powf(random.upto(3.47) - 1.0);
            let lasts_s = random.upto(repeat_s - start_s);
            text += &match random.below(6) {
                0 => format!(
                    "[[ramp]]\nmotor = {motor}\nstart_s = {start_s}\nto_um = {um}\nrise_s = {0}\nfall_s = {0}\nhold_s = {1}\n",
                    lasts_s / 20.0,
                    lasts_s * 0.8
                ),
                1 => format!(
                    "[[ramp]]\nmotor = {motor}\nstart_s = {start_s}\nto_um = 5.0\nrise_s = 0.0005\nfall_s = 0.0005\n"
                ),
                2 => format!(
                    "[[tone]]\nmotor = {motor}\nstart_s = {start_s}\nduration_s = {lasts_s}\nfrequency_hz = {}\namplitude_um = {}\n",
                    hz.min(100.0),
                    um / 2.0
                ),
                3 => format!(
                    "[[noise]]\nmotor = {motor}\nstart_s = {start_s}\nduration_s = {lasts_s}\nlow_hz = 5.0\nhigh_hz = 50.0\nrms_um = 3.0\nseed = 1\n"
                ),
                4 => format!(
                    "[[drive]]\nmotor = {motor}\nfrequency_hz = {hz}\namplitude_um = {um}\nstart_s = {start_s}\nstop_s = {}\n",
                    start_s + lasts_s
                ),
                _ => format!("[[drive]]\nmotor = {motor}\nfrequency_hz = {hz}\namplitude_um = {um}\n"),
            };
        }
        let pattern = Pattern::parse(&text, "random").ok()?;
        let seconds = has_end.then(|| 0.05 + random.upto(4.0));
        let strokes = Strokes::new(&pattern, &StrokeOptions::lasting(seconds)).ok()?;
        let end_s = strokes.end().map_or(f64::INFINITY, |end| pattern.array().rate().ticks_to_seconds(end));
        let vibration = Vibration::of(&dry_run(&strokes, &settings()).hold, strokes.end(), &settings());
        let moves = moves(strokes.map(Result::unwrap));
        (!moves.is_empty()).then_some(Self { vibration, end_s, moves })
    }

    /// A live play whose levels come and go.
    fn live(random: &mut Random) -> Self {
        let (mut at_s, mut level, mut moves) = (random.upto(0.1), 0, Vec::new());
        while at_s < 8.0 {
            let next = random.below(700) as u16;
            let to_s = at_s + f64::from(next.abs_diff(level)) / 85_000.0;
            moves.push(Move { from_s: at_s, to_s, motor: 0, levels: [level, next] });
            let rests_s = [0.05, 0.7][random.below(2) as usize];
            (at_s, level) = (to_s + random.upto(rests_s), next);
        }
        Self { vibration: Vibration::without_end(&settings()), end_s: f64::INFINITY, moves }
    }

    /// The moves that are under way from one time to another.
    fn between(&self, from_s: f64, to_s: f64) -> impl Iterator<Item = Move> {
        let first = self.moves.partition_point(|of| of.from_s < from_s - 0.05);
        let under_way = self.moves[first..].iter().take_while(move |of| of.from_s < to_s);
        under_way.filter_map(move |of| of.between(from_s, to_s))
    }

    /// The pins that stand above rest, with their levels.
    fn standing(&self, at_s: f64) -> Vec<(u8, u16)> {
        let last = |motor| self.moves.iter().rfind(|of| of.motor == motor && of.from_s < at_s);
        let levels = (0..4).filter_map(|motor| Some((motor, last(motor)?.level_at(at_s))));
        levels.filter(|(_, level)| *level > 0).collect()
    }
}

fn settings() -> Settings {
    Settings::of(meissner_array::spec::Array::paper())
}

/// The moves of compiled steps, in order of time.
fn moves(steps: impl Iterator<Item = Step>) -> Vec<Move> {
    let (mut moves, mut levels) = (Vec::new(), [0; 4]);
    for step in steps.take_while(|step| step.begin().0 < (KNOWN_S * 85_000.0) as u64).take(KNOWN_MOVES) {
        let before = &mut levels[usize::from(step.motor())];
        for burst in step.bursts() {
            let after = match burst.direction {
                Direction::Up => *before + burst.pulses,
                Direction::Down => before.saturating_sub(burst.pulses),
            };
            let [from_s, to_s] = [burst.start, burst.end()].map(|tick| tick.0 as f64 / 85_000.0);
            moves.push(Move { from_s, to_s, motor: step.motor(), levels: [*before, after] });
            *before = after;
        }
    }
    moves.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    moves
}

/// The kinds of plays of so many cases.
fn kinds(seed: u64) -> Vec<Kind> {
    let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
    let patterns: Vec<_> = (0..96).filter_map(|_| Kind::random(&mut random)).collect();
    let live = (0..8).map(|_| Kind::live(&mut random));
    patterns.into_iter().chain(live).collect()
}

/// A play on the device.
struct Playing<'k> {
    id: u64,
    kind: &'k Kind,
    requested_s: Option<f64>,
    began_s: Option<f64>,
}

/// A move on the lines: on which date by the wall clock, and in which session.
struct Moved {
    of: Move,
    date: i64,
    session: u64,
}

/// Lines that vibrated: from, to, on which date by the wall clock, and in which session.
struct Vibrated {
    from_s: f64,
    to_s: f64,
    date: i64,
    session: u64,
}

/// The rule, in plain words: what moves vibrates; less than half a second between two moves is no pause; and if a pin then stands above
/// rest, it vibrates for half a second more.
fn vibrated(mut moved: Vec<Moved>) -> Vec<Vibrated> {
    moved.sort_by(|a, b| a.of.from_s.total_cmp(&b.of.from_s));
    let (mut lines, mut last, mut stands) = (Vec::new(), None::<&Moved>, [false; 4]);
    let mut until_s = f64::NEG_INFINITY;
    for now in &moved {
        let Move { from_s, to_s, motor, levels } = now.of;
        let mut push = |from_s: f64, to_s: f64, of: &Moved| {
            if from_s < to_s {
                lines.push(Vibrated { from_s, to_s, date: of.date, session: of.session });
            }
        };
        if from_s - until_s < 0.5 {
            push(until_s, from_s, now);
        } else if let Some(last) = last.filter(|_| stands.contains(&true)) {
            push(until_s, until_s + 0.5, last);
        }
        push(from_s.max(until_s), to_s, now);
        stands[usize::from(motor)] = levels[1] > 0;
        (until_s, last) = (until_s.max(to_s), Some(now));
    }
    lines
}

struct Lab<'k> {
    random: Random,
    kinds: &'k [Kind],
    account: Account,
    now_s: f64,
    /// The wall clock's offset from `now_s`, and the wall clock at the daemon's start.
    wall_s: f64,
    wall_at_start_s: f64,
    disk: String,
    /// A text that was written, but may not yet be on the disk.
    on_the_way: Option<String>,
    queue: Vec<Playing<'k>>,
    /// Pins that an emergency stop has left up, with their levels.
    standing: Vec<(u8, u16)>,
    /// Emergency stops with pins up.
    estops: u32,
    saved_s: f64,
    reported_s: f64,
    lines: Vec<Moved>,
    session: u64,
    last_id: u64,
}

impl<'k> Lab<'k> {
    fn new(seed: u64, kinds: &'k [Kind]) -> Self {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        (0..4).for_each(|_| {
            let _ = random.below(2);
        });
        // Midnight may be near.
        let wall_s = 5.0 * DAY_S - random.upto(30.0);
        Self {
            random,
            kinds,
            account: Account::new(LIMITS),
            now_s: 1000.0,
            wall_s,
            wall_at_start_s: wall_s,
            disk: String::new(),
            on_the_way: None,
            queue: Vec::new(),
            standing: Vec::new(),
            estops: 0,
            saved_s: 0.0,
            reported_s: 0.0,
            lines: Vec::new(),
            session: 0,
            last_id: 0,
        }
    }

    /// Days of the wall clock, and of the time passed.
    fn days(&self) -> [i64; 2] {
        [self.wall_s, self.wall_at_start_s].map(|wall_s| ((wall_s + self.now_s) / DAY_S).floor() as i64)
    }

    fn now(&self) -> Now {
        let [date, passed] = self.days().map(|day| date(2026, 1, 1) + jiff::Span::new().days(day));
        let wall = Timestamp::from_nanosecond(
            ((self.wall_s + self.now_s) * 1e9) as i128 + 1_767_225_600_000_000_000,
        );
        let at = HostInstant::from_ns((self.now_s * 1e9) as u64);
        Now { at, wall: wall.unwrap(), date, passed }
    }

    /// Saves the sums; they are on the disk at once if `waits`, else perhaps later.
    fn save(&mut self, waits: bool) {
        self.saved_s = self.now_s;
        let text = self.account.text(self.now());
        match text {
            Some(text) if waits => (self.disk, self.on_the_way) = (text, None),
            text => self.on_the_way = text.or(self.on_the_way.take()),
        }
    }

    /// Notes the moves of the running play between two times.
    fn vibrate(&mut self, from_s: f64, to_s: f64) {
        let ([date, _], session) = (self.days(), self.session);
        let Some(&Playing { kind, began_s: Some(began_s), .. }) = self.queue.first() else { return };
        let to_s = to_s.min(began_s + kind.end_s);
        let known = kind.moves.last().filter(|_| kind.moves.len() >= KNOWN_MOVES);
        assert!(to_s - began_s < known.map_or(KNOWN_S, |last| last.to_s), "it plays longer than is known");
        let moves = kind.between(from_s - began_s, to_s - began_s);
        let moved = moves.map(|of| Move { from_s: began_s + of.from_s, to_s: began_s + of.to_s, ..of });
        self.lines.extend(moved.map(|of| Moved { of, date, session }));
    }

    /// Pins go down to rest from these levels; returns how long that takes, s.
    fn go_down(&mut self, standing: Vec<(u8, u16)>) -> f64 {
        let ([date, _], session, now_s) = (self.days(), self.session, self.now_s);
        let mut longest_s = 0.0_f64;
        for (motor, level) in standing {
            let to_s = now_s + f64::from(level) / 85_000.0;
            let of = Move { from_s: now_s, to_s, motor, levels: [level, 0] };
            self.lines.push(Moved { of, date, session });
            longest_s = longest_s.max(to_s - now_s);
        }
        longest_s
    }

    /// What stands now.
    fn now_standing(&self) -> Vec<(u8, u16)> {
        match self.queue.first() {
            Some(Playing { kind, began_s: Some(began_s), .. }) if self.now_s < began_s + kind.end_s => {
                kind.standing(self.now_s - began_s)
            }
            _ => Vec::new(),
        }
    }

    /// Lets time pass.
    fn pass(&mut self, seconds: f64) {
        let until_s = self.now_s + seconds;
        while self.now_s < until_s {
            let late_s = self.random.upto(0.05);
            let Some(play) = self.queue.first_mut() else {
                self.now_s = until_s;
                return;
            };
            let id = play.id;
            let Some(began_s) = play.began_s else {
                let onset_s = play.requested_s.unwrap_or(self.now_s + late_s).max(self.now_s);
                if onset_s > until_s {
                    self.now_s = until_s;
                    return;
                }
                play.began_s = Some(onset_s);
                (self.now_s, self.reported_s) = (onset_s, onset_s);
                // The report of a begin may be lost.
                if self.random.below(10) > 0 {
                    self.account.began(id, self.now().at);
                }
                continue;
            };
            let (from_s, end_s) = (self.now_s, began_s + play.kind.end_s);
            let to_s = end_s.min(until_s).min(self.reported_s + REPORT_S).max(from_s);
            self.vibrate(from_s, to_s);
            self.now_s = to_s;
            if to_s >= end_s {
                self.queue.remove(0);
                let now = self.now();
                self.account.began(id, HostInstant::from_ns((began_s * 1e9) as u64));
                self.account.ended(id, None, now);
                self.save(false);
                continue;
            }
            if to_s >= self.reported_s + REPORT_S {
                self.reported_s = to_s;
                let now = self.now();
                if self.account.played(id, to_s - began_s, now).is_some() {
                    self.stop(false);
                } else if self.now_s - self.saved_s > AHEAD_S / 2.0 {
                    self.save(true);
                }
            }
        }
    }

    /// Ends all plays; the lines stop a little later. The pins come down, but after an emergency stop only once somebody arms.
    fn stop(&mut self, is_estop: bool) {
        let late_s = self.random.upto(STOP_S);
        self.vibrate(self.now_s, self.now_s + late_s);
        self.now_s += late_s;
        let standing = self.now_standing();
        let back_s = if is_estop { 0.0 } else { self.go_down(standing.clone()) };
        for play in std::mem::take(&mut self.queue) {
            let played_s = play.began_s.map_or(0.0, |began_s| (self.now_s - began_s).min(play.kind.end_s));
            if let Some(began_s) = play.began_s {
                self.account.began(play.id, HostInstant::from_ns((began_s * 1e9) as u64));
            }
            let now = self.now();
            let return_s = self.account.return_s(play.id);
            self.account.ended(play.id, Some(played_s), now);
            if back_s > 0.0 && play.began_s.is_some() {
                self.account.moved(now.at, back_s, now);
            } else if is_estop && play.began_s.is_some() {
                self.account.left_up(now.at, return_s, now);
            }
        }
        if is_estop {
            self.estops += u32::from(!standing.is_empty());
            self.standing.extend(standing);
        }
        self.now_s += back_s;
        self.save(false);
    }

    /// Arms: what stands comes down.
    fn arm(&mut self) {
        let standing = std::mem::take(&mut self.standing);
        let down_s = self.go_down(standing);
        if self.account.come_down(self.now()) {
            self.save(false);
        }
        self.now_s += down_s;
    }

    /// Orders a play, a sequence or a live play.
    fn order(&mut self) {
        if !self.standing.is_empty() {
            self.arm();
        }
        let random = &mut self.random;
        let kind = &self.kinds[random.below(self.kinds.len() as u64) as usize];
        let replaces = random.below(4) == 0;
        let requested_s = match random.below(4) {
            0 => Some(self.now_s + 0.015),
            1 => Some(self.now_s + random.upto(6.0)),
            _ => None,
        };
        let onset = requested_s.map_or(Onset::Next, Onset::At);
        let vibration = kind.vibration.clone();
        let Ok(held) = self.account.hold(self.now(), vibration, onset, replaces) else { return };
        self.save(true);
        // The disk takes its time, and other orders wait.
        let waited_s = self.random.upto(0.03);
        self.pass(waited_s);
        self.last_id += 1;
        let id = self.last_id;
        self.account.begin(held, id, self.now());
        let before = self.queue.iter().filter(|_| !replaces);
        let free_s = before.clone().fold(self.now_s, |free_s, play| {
            play.began_s.or(play.requested_s).unwrap_or(free_s) + play.kind.end_s
        });
        let refused = !free_s.is_finite()
            || requested_s.is_some_and(|at_s| at_s < free_s)
            || before.count() > 16
            || self.random.below(20) == 0;
        if refused {
            self.account.forget(id);
            self.save(false);
            return;
        }
        if replaces {
            // Like a stop, but only of the plays before it.
            self.stop(false);
        }
        let requested_s = requested_s.map(|at_s| at_s.max(self.now_s));
        self.queue.push(Playing { id, kind, requested_s, began_s: None });
    }

    /// The daemon ends, or is killed, and starts again.
    fn restart(&mut self, killed: bool) {
        if killed {
            // The board notices the silence.
            let late_s = self.random.upto(LEASE_S);
            self.vibrate(self.now_s, self.now_s + late_s);
            self.now_s += late_s;
            let standing = self.now_standing();
            self.queue.clear();
            self.now_s += self.go_down(standing);
        } else {
            self.stop(false);
        }
        let arrives = !killed || self.random.below(2) == 0;
        if let Some(text) = self.on_the_way.take().filter(|_| arrives) {
            self.disk = text;
        }
        self.now_s += self.random.upto(0.5);
        if self.random.below(3) == 0 {
            self.set_clock();
        }
        self.wall_at_start_s = self.wall_s;
        self.account = Account::new(LIMITS);
        if !self.disk.is_empty() {
            let now = self.now();
            self.account.restore(self.disk.as_bytes(), now).unwrap();
        }
        // The device says that it is faulted, and no more.
        self.account.stand(if self.standing.is_empty() { 0.0 } else { 0.035 });
        self.begin_session();
    }

    /// There is only one participant, because another one would have another finger.
    fn begin_session(&mut self) {
        self.account.end_session();
        self.account.start_session("P1");
        self.session += 1;
    }

    fn set_clock(&mut self) {
        let days = [-1.0, 1.0, 1.0, 2.0, -0.001, 0.001][self.random.below(6) as usize];
        self.wall_s = (self.wall_s + days * DAY_S).max(DAY_S);
    }

    fn step(&mut self) {
        match self.random.below(16) {
            0..8 => self.order(),
            8..11 => {
                let seconds = self.random.upto(4.0);
                self.pass(seconds);
            }
            11 => {
                let is_estop = self.random.below(3) == 0;
                self.stop(is_estop);
            }
            12 => self.restart(true),
            13 => self.restart(false),
            14 => self.set_clock(),
            _ => {
                if self.queue.is_empty() {
                    self.begin_session();
                }
            }
        }
    }
}

/// The longest vibration without a pause in an ordered list.
fn longest(lines: &[Vibrated]) -> f64 {
    let (mut most, mut used_s, mut until_s) = (0.0_f64, 0.0, f64::NEG_INFINITY);
    for line in lines {
        if line.from_s - until_s >= LIMITS.pause_s - ROUNDING_S {
            used_s = 0.0;
        }
        used_s += line.to_s - line.from_s;
        (most, until_s) = (most.max(used_s), line.to_s);
    }
    most
}

/// The largest sum of vibration over the groups that `of` defines.
fn largest<K: Ord>(lines: &[Vibrated], of: impl Fn(&Vibrated) -> K) -> f64 {
    let mut sums = BTreeMap::new();
    for line in lines {
        *sums.entry(of(line)).or_insert(0.0) += line.to_s - line.from_s;
    }
    sums.into_values().fold(0.0, f64::max)
}

#[test]
fn no_order_makes_the_lines_vibrate_longer_than_the_limits() {
    let cases = std::env::var("CASES")
        .ok()
        .and_then(|cases| cases.parse().ok())
        .unwrap_or_else(|| at_length(CASES / 5, CASES));
    let from = std::env::var("FROM").ok().and_then(|from| from.parse().ok()).unwrap_or(0);
    let (mut vibrated_s, mut past_s) = (0.0, [0.0_f64; 3]);
    let mut of_cases = Vec::new();
    for case in from..from + cases {
        if case == from || case.is_multiple_of(500) {
            of_cases = kinds(case / 500 + 1);
        }
        let mut lab = Lab::new(case + 1, &of_cases);
        lab.begin_session();
        (0..24).for_each(|_| lab.step());
        lab.pass(10.0);
        let lines = &vibrated(lab.lines);
        let found = [
            longest(lines) - LIMITS.max_continuous_s,
            largest(lines, |line| line.session) - LIMITS.max_session_s,
            largest(lines, |line| line.date) - LIMITS.max_day_s,
        ];
        for (past, found) in past_s.iter_mut().zip(found) {
            *past = past.max(found);
        }
        vibrated_s += lines.iter().map(|line| line.to_s - line.from_s).sum::<f64>();
        // After an emergency stop pins count for a while that stand.
        let most_s = STROKE_S + if lab.estops > 0 { 0.5 } else { 0.0 };
        let within = found.iter().all(|found| *found <= most_s);
        assert!(within, "case {case}: {found:?} s beyond the limits");
    }
    println!("{cases} sequences, {vibrated_s:.0} s of vibration, {past_s:.3?} s beyond the limits");
    assert!(vibrated_s > 0.5 * cases as f64, "the orders play something");
}
