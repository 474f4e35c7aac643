//! Tests random sequences of orders, with restarts, kills and changed clocks, against a plain sum of the lines' vibration.
//!
//! The simulated lab has a device that plays one play after the other, a disk, and an [`Account`]. It notes when lines vibrated. At
//! the end, plain sums over these notes must be within the limits. `CASES=1000000` runs a million sequences.

use super::rule::REPORT_S;
use super::*;
use jiff::civil::date;
use meissner_array::pattern::{Drive, Pattern};
use meissner_test_support::at_length;

/// Sequences of a run.
const CASES: u64 = 20_000;
/// The time that a stop takes, s.
const STOP_S: f64 = 0.02;
/// How long the board plays on after a kill, s: its host watchdog by default.
const LEASE_S: f64 = 0.3;
const DAY_S: f64 = 86_400.0;

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

/// A play on the device.
struct Playing {
    id: u64,
    /// The spans in which it vibrates, and the repeat, as chosen at random.
    spans: Vec<(f64, f64)>,
    repeat_s: f64,
    end_s: f64,
    requested_s: Option<f64>,
    began_s: Option<f64>,
}

/// Lines that vibrated: from, to, on which date by the wall clock, and in which session.
struct Vibrated {
    from_s: f64,
    to_s: f64,
    date: i64,
    session: u64,
}

struct Lab {
    random: Random,
    account: Account,
    now_s: f64,
    /// The wall clock's offset from `now_s`, and the wall clock at the daemon's start.
    wall_s: f64,
    wall_at_start_s: f64,
    disk: String,
    /// A text that was written, but may not yet be on the disk.
    on_the_way: Option<String>,
    queue: Vec<Playing>,
    saved_s: f64,
    reported_s: f64,
    lines: Vec<Vibrated>,
    session: u64,
    last_id: u64,
}

impl Lab {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        (0..4).for_each(|_| {
            let _ = random.below(2);
        });
        // Midnight may be near.
        let wall_s = 5.0 * DAY_S - random.upto(30.0);
        Self {
            random,
            account: Account::new(LIMITS),
            now_s: 1000.0,
            wall_s,
            wall_at_start_s: wall_s,
            disk: String::new(),
            on_the_way: None,
            queue: Vec::new(),
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

    /// Notes the vibration of the running play between two times.
    fn vibrate(&mut self, from_s: f64, to_s: f64) {
        let [date, _] = self.days();
        let Some(play) = self.queue.first() else { return };
        let Some(began_s) = play.began_s else { return };
        let to_s = to_s.min(began_s + play.end_s);
        let mut repeat = ((from_s - began_s) / play.repeat_s).floor().max(0.0);
        while began_s + repeat * play.repeat_s < to_s {
            for (start, stop) in &play.spans {
                let by = began_s + repeat * play.repeat_s;
                let (start, stop) = ((by + start).max(from_s), (by + stop).min(to_s));
                if start < stop {
                    self.lines.push(Vibrated { from_s: start, to_s: stop, date, session: self.session });
                }
            }
            repeat += 1.0;
            if !repeat.is_finite() || !play.repeat_s.is_finite() {
                break;
            }
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
            let (from_s, end_s) = (self.now_s, began_s + play.end_s);
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
                    self.stop();
                } else if self.now_s - self.saved_s > AHEAD_S / 2.0 {
                    self.save(true);
                }
            }
        }
    }

    /// Ends all plays; the lines stop a little later.
    fn stop(&mut self) {
        let late_s = self.random.upto(STOP_S);
        self.vibrate(self.now_s, self.now_s + late_s);
        self.now_s += late_s;
        for play in std::mem::take(&mut self.queue) {
            let played_s = play.began_s.map_or(0.0, |began_s| (self.now_s - began_s).min(play.end_s));
            if let Some(began_s) = play.began_s {
                self.account.began(play.id, HostInstant::from_ns((began_s * 1e9) as u64));
            }
            let now = self.now();
            self.account.ended(play.id, Some(played_s), now);
        }
        self.save(false);
    }

    /// Orders a play, a sequence or a live play.
    fn order(&mut self) {
        let random = &mut self.random;
        let (mut spans, mut repeat_s, mut end_s) = (Vec::new(), f64::INFINITY, f64::INFINITY);
        let vibration = match random.below(6) {
            0 => {
                spans.push((0.0, f64::INFINITY));
                Vibration::without_end()
            }
            1 => {
                let mut at_s = random.upto(0.5);
                for _ in 0..=random.below(4) {
                    let stop_s = at_s + 0.05 + random.upto(1.2);
                    spans.push((at_s, stop_s));
                    at_s = stop_s + random.upto(1.6);
                }
                end_s = spans.last().map_or(0.0, |last| last.1);
                Vibration::of_spans(spans.clone())
            }
            kind => {
                repeat_s = 0.1 + random.upto(2.5);
                let (start_s, stop_s) =
                    (random.upto(repeat_s / 2.0), repeat_s / 2.0 + 0.01 + random.upto(repeat_s / 2.0 - 0.01));
                let whole = kind == 2;
                spans.push(if whole { (0.0, repeat_s) } else { (start_s, stop_s) });
                if random.below(5) > 0 {
                    end_s = 0.1 + random.upto(4.0);
                }
                let drive = Drive {
                    motor: 3,
                    frequency_hz: 60.0,
                    amplitude_um: 80.0,
                    phase: 0.0,
                    start_s: (!whole).then_some(start_s),
                    stop_s: (!whole).then_some(stop_s),
                };
                let pattern = Pattern::new(
                    meissner_array::spec::Array::paper(),
                    "random",
                    Some(repeat_s),
                    vec![drive],
                    toml::Table::new(),
                )
                .unwrap();
                Vibration::of(&pattern, Some(end_s).filter(|end_s| end_s.is_finite()))
            }
        };
        let replaces = random.below(4) == 0;
        let requested_s = match random.below(4) {
            0 => Some(self.now_s + 0.015),
            1 => Some(self.now_s + random.upto(6.0)),
            _ => None,
        };
        let onset = requested_s.map_or(Onset::Next, Onset::At);
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
            play.began_s.or(play.requested_s).unwrap_or(free_s) + play.end_s
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
            self.stop();
        }
        let requested_s = requested_s.map(|at_s| at_s.max(self.now_s));
        self.queue.push(Playing { id, spans, repeat_s, end_s, requested_s, began_s: None });
    }

    /// The daemon ends, or is killed, and starts again.
    fn restart(&mut self, killed: bool) {
        if killed {
            // The board notices the silence.
            let late_s = self.random.upto(LEASE_S);
            self.vibrate(self.now_s, self.now_s + late_s);
            self.now_s += late_s;
            self.queue.clear();
        } else {
            self.stop();
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
            11 => self.stop(),
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
    for case in from..from + cases {
        let mut lab = Lab::new(case + 1);
        lab.begin_session();
        (0..24).for_each(|_| lab.step());
        lab.pass(10.0);
        let lines = &lab.lines;
        let found = [
            longest(lines) - LIMITS.max_continuous_s,
            largest(lines, |line| line.session) - LIMITS.max_session_s,
            largest(lines, |line| line.date) - LIMITS.max_day_s,
        ];
        for (past, found) in past_s.iter_mut().zip(found) {
            *past = past.max(found);
        }
        vibrated_s += lines.iter().map(|line| line.to_s - line.from_s).sum::<f64>();
        let within = found.iter().all(|found| *found <= 1e-3);
        assert!(within, "case {case}: {found:?} s beyond the limits");
    }
    println!("{cases} sequences, {vibrated_s:.0} s of vibration, {past_s:.3?} s beyond the limits");
    assert!(vibrated_s > 0.5 * cases as f64, "the orders play something");
}
