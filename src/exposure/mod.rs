//! Vibration exposure: how long pins have vibrated under a finger, against the limits of `[participant]`.
//!
//! [`Account::check`] decides before a play whether it fits; `began`, `played` and `ended` follow
//! the plays, and report a limit that a running play has passed. The daemon then stops it. [`Account::text`] is the file that keeps
//! the day's sum across restarts ([`FILE`]); the session record's thread writes it. Nothing here reads a clock.
//!
//! Vibration time is the time in which at least one drive of the running play moves a pin ([`Vibration`]). A pause is
//! [`ParticipantLimits::pause_s`] without vibration.
//!
//! Bounds: `PEOPLE` sums per day. Invariant: time that has been counted is never taken back within its day.

mod limits;
mod vibration;

pub use limits::{Limit, ParticipantLimits};
pub use vibration::Vibration;

use jiff::civil::Date;
use meissner_api::ParticipantStatus;
use meissner_stream::time::HostInstant;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::io;

/// The file of the day's sums, in the directory of the session record.
pub const FILE: &str = "exposure.json";
/// The most bytes of that file.
pub const MAX_FILE: u64 = 1 << 20;
/// Sums kept for a day, at most: more people than a display serves. Further ones share the sum of plays without a session.
const PEOPLE: usize = 1000;
/// What a play without end must find, s: what passes between two reports of a running play.
const LEAST_S: f64 = 0.1;
/// Sums are so exact, s: more than rounding errors add up to.
const ROUNDING_S: f64 = 1e-6;

/// When it is.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// On the host's monotonic clock.
    pub at: HostInstant,
    /// The local date.
    pub date: Date,
}

impl Now {
    /// By the system's clocks and time zone.
    #[must_use]
    pub fn read() -> Self {
        Self { at: HostInstant::now(), date: jiff::Zoned::now().date() }
    }
}

/// A play does not fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exceeded {
    /// Into what.
    pub limit: Limit,
    /// The limit, s.
    pub most_s: f64,
    /// What is used, and kept for the plays that run and wait, s.
    pub used_s: f64,
    /// What the play takes, s; `None`: it has no end.
    pub play_s: Option<f64>,
    /// How long a pause is, s.
    pub pause_s: f64,
}

impl Exceeded {
    /// The limit, what is left, and when to try again, in one line.
    #[must_use]
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
            "`participant.{}` allows {most_s} s of {what}: {left_s:.1} s are left{takes}; {again}, or raise the limit in the \
             daemon's configuration",
            limit.key()
        )
    }
}

/// A play that was accepted and has not ended.
#[derive(Debug)]
struct Live {
    vibration: Vibration,
    /// Vibration that the sums hold already, s.
    counted_s: f64,
}

/// See the module.
#[derive(Debug, Default)]
pub struct Account {
    limits: ParticipantLimits,
    /// The participant of the running session; `None`: there is none.
    participant: Option<String>,
    /// Vibration of the session, s; `None`: no session runs.
    session_s: Option<f64>,
    date: Option<Date>,
    /// Vibration of the day, s, by participant.
    days: BTreeMap<Option<String>, f64>,
    /// Vibration since the last pause, s, and when it was last counted.
    continuous_s: f64,
    last: Option<HostInstant>,
    live: HashMap<u64, Live>,
}

/// A line of the file.
#[derive(Debug, Serialize, Deserialize)]
struct Sum {
    participant: Option<String>,
    vibration_s: f64,
}

/// The file.
#[derive(Debug, Serialize, Deserialize)]
struct File {
    date: String,
    days: Vec<Sum>,
}

impl Account {
    /// An account without sums.
    #[must_use]
    pub fn new(limits: ParticipantLimits) -> Self {
        Self { limits, ..Self::default() }
    }

    /// Changes the limits.
    pub const fn set_limits(&mut self, limits: ParticipantLimits) {
        self.limits = limits;
    }

    /// The limits.
    #[must_use]
    pub const fn limits(&self) -> &ParticipantLimits {
        &self.limits
    }

    /// Takes the day's sums from the file's text.
    ///
    /// # Errors
    /// Why it cannot be read; the account stays as it is.
    pub fn restore(&mut self, text: &[u8]) -> io::Result<()> {
        let File { date, days } = serde_json::from_slice(text)?;
        let date = date.parse().map_err(io::Error::other)?;
        let good = |sum: &Sum| sum.vibration_s.is_finite() && sum.vibration_s >= 0.0;
        self.date = Some(date);
        self.days = days.into_iter().filter(good).map(|sum| (sum.participant, sum.vibration_s)).collect();
        Ok(())
    }

    /// The day's sums as the file's text.
    #[must_use]
    pub fn text(&self) -> Option<String> {
        let sum = |(participant, &vibration_s): (&Option<String>, &f64)| Sum {
            participant: participant.clone(),
            vibration_s,
        };
        let file = File { date: self.date?.to_string(), days: self.days.iter().map(sum).collect() };
        // Plain data can be written.
        serde_json::to_string(&file).ok().map(|text| text + "\n")
    }

    /// Under whose name the day's vibration is counted: once there are [`PEOPLE`] names, further ones share the sum without one.
    fn counted_for(&self) -> &Option<String> {
        let full = self.days.len() >= PEOPLE && !self.days.contains_key(&self.participant);
        if full { &None } else { &self.participant }
    }

    fn day_s(&self, date: Date) -> f64 {
        let today = self.date == Some(date);
        self.days.get(self.counted_for()).copied().filter(|_| today).unwrap_or(0.0)
    }

    fn continuous_s(&self, at: HostInstant) -> f64 {
        let paused = self.last.is_none_or(|last| at.since(last).as_secs_f64() >= self.limits.pause_s);
        if paused && !self.live.values().any(|live| live.counted_s > 0.0) { 0.0 } else { self.continuous_s }
    }

    /// Checks whether a play fits behind those that run and wait, or `instead` of them. A play that begins `later` at a tick of its
    /// own is checked for the time without a pause when it comes to it.
    ///
    /// # Errors
    /// The limit into which it does not fit.
    pub fn check(&self, now: Now, play: &Vibration, instead: bool, later: bool) -> Result<(), Exceeded> {
        let waiting = |live: &Live| live.vibration.total().map_or(0.0, |total| total - live.counted_s);
        let kept_s: f64 = if instead { 0.0 } else { self.live.values().map(waiting).sum() };
        let ParticipantLimits { max_continuous_s, pause_s, max_session_s, max_day_s, .. } = self.limits;
        let continuous_s = if later { 0.0 } else { self.continuous_s(now.at) + kept_s };
        let in_session_s = play.total().filter(|_| self.session_s.is_some());
        let longest_s = Some(play.longest(pause_s)).filter(|longest| longest.is_finite());
        for (limit, most_s, used_s, play_s) in [
            (Limit::Continuous, max_continuous_s, continuous_s, longest_s),
            // Without a session, only the day has a sum.
            (
                Limit::Session,
                max_session_s,
                self.session_s.map_or(0.0, |used_s| used_s + kept_s),
                in_session_s,
            ),
            (Limit::Day, max_day_s, self.day_s(now.date) + kept_s, play.total()),
        ] {
            if used_s + play_s.unwrap_or(LEAST_S) > most_s + ROUNDING_S {
                return Err(Exceeded { limit, most_s, used_s, play_s, pause_s });
            }
        }
        Ok(())
    }

    /// A play was sent to the streamer.
    pub fn add(&mut self, id: u64, vibration: Vibration) {
        self.live.insert(id, Live { vibration, counted_s: 0.0 });
    }

    /// A play was not accepted.
    pub fn forget(&mut self, id: u64) {
        self.live.remove(&id);
    }

    /// A running play has played for so long. Returns the limit that it has passed.
    pub fn played(&mut self, id: u64, played_s: f64, now: Now) -> Option<Limit> {
        let live = self.live.get_mut(&id)?;
        let vibrated_s = live.vibration.until(played_s);
        let new_s = (vibrated_s - live.counted_s).max(0.0);
        live.counted_s += new_s;
        if new_s > 0.0 {
            // The time since the last count has vibration and rest in it.
            let rested_s = self.last.map_or(f64::INFINITY, |last| now.at.since(last).as_secs_f64() - new_s);
            if rested_s >= self.limits.pause_s {
                self.continuous_s = 0.0;
            }
            self.continuous_s += new_s;
            self.last = Some(now.at);
            if self.date != Some(now.date) {
                (self.date, self.days) = (Some(now.date), BTreeMap::new());
            }
            let name = self.counted_for().clone();
            *self.days.entry(name).or_default() += new_s;
            self.session_s = self.session_s.map(|used_s| used_s + new_s);
        }
        let passed = |used_s: f64, most_s: f64| used_s > most_s + ROUNDING_S;
        let ParticipantLimits { max_continuous_s, max_session_s, max_day_s, .. } = self.limits;
        [
            (Limit::Continuous, passed(self.continuous_s, max_continuous_s)),
            (Limit::Session, self.session_s.is_some_and(|used_s| passed(used_s, max_session_s))),
            (Limit::Day, passed(self.day_s(now.date), max_day_s)),
        ]
        .into_iter()
        .find_map(|(limit, passed)| passed.then_some(limit))
    }

    /// A play has ended after so long; 0 if it never began.
    pub fn ended(&mut self, id: u64, played_s: f64, now: Now) {
        self.played(id, played_s, now);
        self.live.remove(&id);
    }

    /// A session of this participant has begun.
    pub fn start_session(&mut self, participant: &str) {
        (self.participant, self.session_s) = (Some(participant.to_owned()), Some(0.0));
    }

    /// The session has ended. Returns how long it vibrated, s.
    pub fn end_session(&mut self) -> f64 {
        self.participant = None;
        self.session_s.take().unwrap_or(0.0)
    }

    /// How long the running session has vibrated, s.
    #[must_use]
    pub fn session_s(&self) -> f64 {
        self.session_s.unwrap_or(0.0)
    }

    /// The plays that run and wait.
    pub fn live(&self) -> impl Iterator<Item = u64> {
        self.live.keys().copied()
    }

    /// Limits, and what is used and left.
    #[must_use]
    pub fn status(&self, now: Now) -> ParticipantStatus {
        let ParticipantLimits { max_amplitude_um, max_continuous_s, pause_s, max_session_s, max_day_s } =
            self.limits;
        let (continuous_used_s, day_used_s) = (self.continuous_s(now.at), self.day_s(now.date));
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
