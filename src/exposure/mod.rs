//! Vibration exposure: how long pins have vibrated under a finger, against the limits of `[participant]`.
//!
//! Before a play, [`Account::hold`] decides by the rule in [`rule`] whether it fits, and reserves its time. `begin`, `began`,
//! `played` and `ended` follow the play; `played` reports a limit that a running play has reached, and the daemon then stops the
//! play. [`Account::text`] is the file that keeps the sums across restarts ([`FILE`], `file`). The file counts time that plays may
//! still use as used, and is written before they begin, so a kill never makes a sum smaller. The session record's thread writes it.
//! Only [`Now::read`] reads a clock.
//!
//! What vibrates follows from the compiled moves of a play ([`Vibration`]), and from the time in which pins move outside of plays
//! ([`Account::moved`]). A pause is [`ParticipantLimits::pause_s`] without vibration.
//!
//! Bounds: `DATES` dates, and `PEOPLE` sums for each. Invariant: time that has been counted is never taken back within its day.

mod file;
mod limits;
pub mod rule;
mod vibration;

pub use file::Unreadable;
pub use limits::{Limit, ParticipantLimits};
pub use rule::{Exceeded, Onset};
pub use vibration::Vibration;

use crate::clock;
use jiff::civil::Date;
use jiff::{SignedDuration, Timestamp, Zoned};
use meissner_api::ParticipantStatus;
use meissner_stream::time::{HostInstant, is_virtual, wall_set_since};
use rule::{EARLY_S, Order, Pending, SoFar, judge};
use rustix::time::{ClockId, clock_gettime};
use std::collections::BTreeMap;
use std::sync::OnceLock;
use vibration::{ROUNDING_S, STILL_S, Stretch};

/// The file of the sums, in the directory of the session record.
pub const FILE: &str = "exposure.json";
/// The most bytes of that file.
pub const MAX_FILE: u64 = 4 << 20;
/// Sums kept for a date, at most: more people than a display serves. Further ones share the sum of plays without a session.
const PEOPLE: usize = 1000;
/// Dates whose sums are kept, at most.
const DATES: usize = 4;
/// The time that the file reserves for a play without end, s: twice the time between two writings.
const AHEAD_S: f64 = 10.0;
/// Plays without an id have numbers from here on.
const HELD: u64 = 1 << 63;

/// The current time, by several clocks.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// The host's monotonic clock.
    pub at: HostInstant,
    /// The wall clock.
    pub wall: Timestamp,
    /// The local date.
    pub date: Date,
    /// The local date that the time since the program's start implies, even if the clock was set meanwhile.
    pub passed: Date,
}

impl Now {
    /// Reads the system's clocks and time zone.
    pub fn read() -> Self {
        static BEGAN: OnceLock<(SignedDuration, Zoned)> = OnceLock::new();
        let (at, wall) = clock::now();
        let now = wall.to_zoned(clock::zone());
        if is_virtual() {
            let passed = now.saturating_sub(SignedDuration::from_nanos(wall_set_since())).date();
            return Self { at, wall, date: now.date(), passed };
        }
        // This clock goes on while the machine sleeps.
        let up = clock_gettime(ClockId::Boottime);
        let up = SignedDuration::new(up.tv_sec, i32::try_from(up.tv_nsec).unwrap_or(0));
        let (up_then, then) = BEGAN.get_or_init(|| (up, now.clone()));
        let passed = then.saturating_add(up.saturating_sub(*up_then)).date();
        Self { at, wall, date: now.date(), passed }
    }

    /// The same at another instant of the monotonic clock.
    pub const fn at(self, at: HostInstant) -> Self {
        Self { at, ..self }
    }
}

/// An instant in seconds.
fn seconds(at: HostInstant) -> f64 {
    at.as_ns() as f64 / 1e9
}

impl Exceeded {
    /// The limit, what is left, and when to try again, in one line.
    pub fn text(&self) -> String {
        let Self { limit, most_s, used_s, play_s, pause_s } = self;
        let left_s = (most_s - used_s).max(0.0);
        let takes =
            play_s.map_or_else(String::new, |play_s| format!(", and the play vibrates for {play_s:.1} s"));
        let again = match limit {
            _ if play_s.is_some_and(|play_s| play_s > *most_s) => "play for less time".to_owned(),
            Limit::Continuous => format!("play again after a pause of {pause_s} s without vibration"),
            Limit::Session => "end the session, and go on in a new one".to_owned(),
            Limit::Day => "play again tomorrow, from 00:00 on".to_owned(),
        };
        let what = match limit {
            Limit::Continuous => "vibration without a pause",
            Limit::Session => "vibration in a session",
            Limit::Day => "vibration in a day",
        };
        format!(
            "limit for participants: `participant.{}` allows {most_s} s of {what}: {left_s:.1} s are left{takes}; {again}, or raise the limit in the \
             daemon's configuration",
            limit.key()
        )
    }
}

/// A play that was accepted and has not ended, or whose order is pending.
#[derive(Debug)]
struct Live {
    id: u64,
    vibration: Vibration,
    onset: Onset,
    /// The part of the play that is in the sums, s from its onset.
    counted_to_s: f64,
    /// What the time before its first movement may count, s, until that is in the sums.
    gap_s: f64,
    /// The play that replaced it, and when, s.
    cut: Option<(u64, f64)>,
    replaces: bool,
}

impl Live {
    /// How long it may still vibrate, s.
    fn left_s(&self) -> f64 {
        let Self { vibration, counted_to_s, gap_s, .. } = self;
        let most_s =
            if vibration.is_endless() { AHEAD_S } else { vibration.within(*counted_to_s, f64::INFINITY) };
        gap_s + most_s
    }
}

/// The sums of a date, s, by participant.
type Sums = BTreeMap<Option<String>, f64>;

/// See the module.
#[derive(Debug, Default)]
pub struct Account {
    limits: ParticipantLimits,
    /// The participant of the running session; `None`: there is none.
    participant: Option<String>,
    /// Vibration of the session, s; `None`: no session runs.
    session_s: Option<f64>,
    dates: BTreeMap<Date, Sums>,
    stretch: Stretch,
    /// The plays that run and wait, in order.
    live: Vec<Live>,
    /// Pins were cut and left up: how long they take to come down, s.
    stands_s: f64,
    last_held: u64,
    /// Why the sums are unknown: the daemon plays nothing until a person has checked the file.
    unknown: Option<String>,
    /// The date on which there was no file, although there had been plays.
    vanished: Option<Date>,
}

/// The name under which a participant's vibration is counted. It ignores spaces at the ends, repeated spaces, case and the width of
/// letters.
fn key(participant: &str) -> String {
    let narrow = |c: char| match u32::from(c) {
        wide @ 0xff01..=0xff5e => char::from_u32(wide - 0xfee0).unwrap_or(c),
        _ => c,
    };
    let name: String = participant.chars().map(narrow).flat_map(char::to_lowercase).collect();
    name.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Adds to a person's sum. Once there are [`PEOPLE`] names, further people share the sum without a name.
fn add(sums: &mut Sums, person: Option<String>, vibration_s: f64) {
    let full = sums.len() >= PEOPLE && !sums.contains_key(&person);
    *sums.entry(person.filter(|_| !full)).or_default() += vibration_s;
}

impl Account {
    /// An account without sums.
    pub fn new(limits: ParticipantLimits) -> Self {
        Self { limits, ..Self::default() }
    }

    /// The limits.
    pub const fn limits(&self) -> &ParticipantLimits {
        &self.limits
    }

    /// The person whose vibration is counted.
    fn person(&self) -> Option<String> {
        self.participant.as_deref().map(key)
    }

    /// The largest sum of today and of later dates, which were today before the clock was set back.
    fn day_s(&self, now: Now) -> f64 {
        if self.unknown.is_some() {
            return self.limits.max_day_s;
        }
        let person = self.person();
        let of = |sums: &Sums| {
            let shared = sums.len() >= PEOPLE && !sums.contains_key(&person);
            sums.get(if shared { &None } else { &person }).copied().unwrap_or(0.0)
        };
        self.dates.range(now.date.min(now.passed)..).map(|(_, sums)| of(sums)).fold(0.0, f64::max)
    }

    /// Adds vibration to today's sum, and to that of the date that it would be if the clock had not been set.
    fn count(&mut self, new_s: f64, now: Now) {
        let person = self.person();
        add(self.dates.entry(now.date).or_default(), person.clone(), new_s);
        if now.passed != now.date {
            add(self.dates.entry(now.passed).or_default(), person, new_s);
        }
        self.keep_few_dates();
        self.session_s = self.session_s.map(|used_s| used_s + new_s);
    }

    /// Drops the oldest dates. The next date takes over the larger sums, so that they still count if the clock is set back.
    fn keep_few_dates(&mut self) {
        while self.dates.len() > DATES
            && let Some((_, oldest)) = self.dates.pop_first()
            && let Some(mut next) = self.dates.first_entry()
        {
            for (person, sum_s) in oldest {
                let more_s = sum_s - next.get().get(&person).copied().unwrap_or(0.0);
                add(next.get_mut(), person, more_s.max(0.0));
            }
        }
    }

    /// The vibration since the last pause, including that of the running play so far.
    fn stretch(&self, now: Now) -> Stretch {
        let at_s = seconds(now.at);
        self.live.iter().fold(self.stretch, |stretch, live| match live.onset {
            Onset::Began(onset_s) => {
                let span = (live.counted_to_s, at_s - onset_s);
                live.vibration.walk(onset_s, span, stretch, self.limits.pause_s).1
            }
            Onset::At(_) | Onset::Next => stretch,
        })
    }

    /// Checks whether a play fits after those that run and wait, or instead of them, and reserves its time. Returns its number
    /// until it has an id.
    ///
    /// # Errors
    /// The limit that the play would exceed.
    pub fn hold(
        &mut self,
        now: Now,
        vibration: Vibration,
        onset: Onset,
        replaces: bool,
    ) -> Result<u64, Exceeded> {
        let plays = self.live.iter().map(|live| {
            let &Live { ref vibration, onset, counted_to_s, gap_s, cut, .. } = live;
            Pending { vibration, onset, counted_to_s, gap_s, cut_s: cut.map(|(_, at_s)| at_s) }
        });
        let so_far = SoFar {
            at_s: seconds(now.at),
            stretch: self.stretch,
            session_s: self.session_s,
            day_s: self.day_s(now),
            plays: plays.collect(),
        };
        let gap_s = judge(&self.limits, &so_far, &Order { vibration: &vibration, onset, replace: replaces })?;
        self.last_held += 1;
        let id = HELD + self.last_held;
        self.live.push(Live { id, vibration, onset, counted_to_s: 0.0, gap_s, cut: None, replaces });
        Ok(id)
    }

    /// Notes that a held play was sent to the streamer under its id.
    pub fn begin(&mut self, held: u64, id: u64, now: Now) {
        let Some(at) = self.live.iter().position(|live| live.id == held) else { return };
        self.live[at].id = id;
        if self.live[at].replaces {
            for live in &mut self.live[..at] {
                live.cut = live.cut.or(Some((id, seconds(now.at))));
            }
        }
    }

    /// Forgets a play that was not accepted. Returns whether it was known.
    pub fn forget(&mut self, id: u64) -> bool {
        let before = self.live.len();
        self.live.retain(|live| live.id != id);
        for live in &mut self.live {
            live.cut.take_if(|(by, _)| *by == id);
        }
        self.live.len() < before
    }

    /// Notes that a play has begun.
    pub fn began(&mut self, id: u64, onset: HostInstant) {
        if let Some(live) = self.live.iter_mut().find(|live| live.id == id) {
            live.onset = Onset::Began(seconds(onset));
        }
    }

    /// Notes how long a running play has played. Returns the limit that must stop it now; a play without end is stopped before it
    /// exceeds the limit.
    pub fn played(&mut self, id: u64, played_s: f64, now: Now) -> Option<Limit> {
        let pause_s = self.limits.pause_s;
        let live = self.live.iter_mut().find(|live| live.id == id)?;
        let onset_s = match live.onset {
            Onset::Began(onset_s) => onset_s,
            // The report of its start is lost.
            Onset::At(_) | Onset::Next => seconds(now.at) - played_s.min(live.vibration.end()),
        };
        live.onset = Onset::Began(onset_s);
        let early_s = if live.vibration.is_endless() { EARLY_S + live.vibration.return_s() } else { 0.0 };
        let mut new_s = live.vibration.within(live.counted_to_s, played_s);
        if new_s > 0.0 {
            let first_s = live.vibration.first();
            if live.counted_to_s <= first_s {
                let gap_s = self.stretch.gap_s(onset_s + first_s);
                new_s += gap_s;
                self.stretch.used_s += gap_s;
                live.gap_s = 0.0;
            }
            self.stretch =
                live.vibration.walk(onset_s, (live.counted_to_s, played_s), self.stretch, pause_s).1;
            live.counted_to_s = played_s;
            self.count(new_s, now);
        }
        let passed = |used_s: f64, most_s: f64| used_s > most_s - early_s + ROUNDING_S;
        let ParticipantLimits { max_continuous_s, max_session_s, max_day_s, .. } = self.limits;
        // The play may not have vibrated yet, and the stretch before it may be over.
        let continuous_s = self.stretch.used_at(onset_s + played_s, pause_s);
        [
            (Limit::Continuous, passed(continuous_s, max_continuous_s)),
            (Limit::Session, self.session_s.is_some_and(|used_s| passed(used_s, max_session_s))),
            (Limit::Day, passed(self.day_s(now), max_day_s)),
        ]
        .into_iter()
        .find_map(|(limit, passed)| passed.then_some(limit))
    }

    /// Notes that a play has ended after `played_s`, or as planned (`None`).
    pub fn ended(&mut self, id: u64, played_s: Option<f64>, now: Now) {
        let Some(live) = self.live.iter().find(|live| live.id == id) else { return };
        let until_now_s = match live.onset {
            Onset::Began(onset_s) => seconds(now.at) - onset_s,
            Onset::At(_) | Onset::Next => 0.0,
        };
        let played_s =
            played_s.unwrap_or(if live.vibration.is_endless() { until_now_s } else { f64::INFINITY });
        if played_s > 0.0 {
            self.played(id, played_s, now);
        }
        self.live.retain(|live| live.id != id);
    }

    /// Counts a movement outside of a play's plan: the way back of one that was cut.
    pub fn moved(&mut self, from: HostInstant, for_s: f64, now: Now) {
        let from_s = seconds(from);
        let gap_s = self.stretch.gap_s(from_s);
        self.stretch.used_s += gap_s;
        self.stretch = self.stretch.with(from_s, from_s + for_s, self.limits.pause_s);
        self.count(gap_s + for_s, now);
    }

    /// Counts pins that were cut and left up: they vibrate for half a second more.
    pub fn left_up(&mut self, from: HostInstant, return_s: f64, now: Now) {
        self.moved(from, STILL_S, now);
        self.stand(return_s);
    }

    /// Notes that pins may stand, which take so long to come down.
    pub const fn stand(&mut self, return_s: f64) {
        self.stands_s = self.stands_s.max(return_s);
    }

    /// Counts that the pins come down that were left up. Returns whether there may be any.
    pub fn come_down(&mut self, now: Now) -> bool {
        let stands_s = std::mem::take(&mut self.stands_s);
        if stands_s > 0.0 {
            self.moved(now.at, stands_s, now);
        }
        stands_s > 0.0
    }

    /// How long the pins of a play take to come down if it is cut, s.
    pub fn return_s(&self, id: u64) -> f64 {
        self.live.iter().find(|live| live.id == id).map_or(0.0, |live| live.vibration.return_s())
    }

    /// Starts a session of this participant.
    pub fn start_session(&mut self, participant: &str) {
        (self.participant, self.session_s) = (Some(participant.to_owned()), Some(0.0));
    }

    /// Ends the session. Returns how long it vibrated, s.
    pub fn end_session(&mut self) -> f64 {
        self.participant = None;
        self.session_s.take().unwrap_or(0.0)
    }

    /// How long the running session has vibrated, s.
    pub fn session_s(&self) -> f64 {
        self.session_s.unwrap_or(0.0)
    }

    /// The plays that run and wait.
    pub fn live(&self) -> impl Iterator<Item = u64> {
        self.live.iter().map(|live| live.id)
    }

    /// The problem with the sums, and what to do; none if there is none.
    pub fn problem(&self, now: Now) -> Option<String> {
        let later = || {
            let (date, _) =
                self.dates.last_key_value().filter(|(date, _)| **date > now.date.max(now.passed))?;
            Some(format!(
                "`{FILE}` has vibration of {date}, which is later than today: it counts until then; set the clock right, or correct \
                 the file and start the daemon again"
            ))
        };
        let vanished = || {
            self.vanished.filter(|date| *date == now.date)?;
            Some(format!(
                "`{FILE}` is missing, but the session record has plays of today: their vibration is not in today's sums, which began \
                 at 0 with this daemon; add it by hand before a participant goes on"
            ))
        };
        self.unknown.clone().or_else(vanished).or_else(later)
    }

    /// Why the sums are not known.
    pub fn unknown(&self) -> Option<&str> {
        self.unknown.as_deref()
    }

    /// Limits, and what is used and left.
    pub fn status(&self, now: Now) -> ParticipantStatus {
        let ParticipantLimits { max_amplitude_um, max_continuous_s, pause_s, max_session_s, max_day_s } =
            self.limits;
        let continuous_used_s = self.stretch(now).used_at(seconds(now.at), pause_s);
        let day_used_s = self.day_s(now);
        ParticipantStatus {
            participant: self.participant.clone(),
            max_amplitude_um,
            max_continuous_s,
            pause_s,
            continuous_used_s,
            continuous_left_s: (max_continuous_s - continuous_used_s).max(0.0),
            max_session_s,
            session_used_s: self.session_s,
            session_left_s: self.session_s.map(|used_s| (max_session_s - used_s).max(0.0)),
            max_day_s,
            day_used_s,
            day_left_s: (max_day_s - day_used_s).max(0.0),
        }
    }
}

#[cfg(test)]
mod tests;
