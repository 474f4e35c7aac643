//! The file of the sums ([`super::FILE`]), which survives a restart and a kill.
//!
//! The file counts time that accepted plays may still use as used. `date` and `days` are for today, in the form of older versions;
//! `other_dates` has further dates, and `stretch` the vibration since the last pause.
//!
//! Invariant: a file that cannot be true never counts as sums of 0; the account is then unknown until a good file is read.

use super::vibration::{STILL_S, Stretch};
use super::{Account, FILE, Live, Now, Sums, add, key, seconds};
use jiff::civil::Date;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Display;

/// The largest possible sum, s: a day with a change of the clock, and the time that plays had reserved.
const MOST_S: f64 = 2.0 * 86_400.0;

/// Why the file cannot be used, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unreadable(pub String);

/// A person's sum.
#[derive(Debug, Serialize, Deserialize)]
struct Sum {
    participant: Option<String>,
    vibration_s: f64,
}

/// The sums of a date.
#[derive(Debug, Serialize, Deserialize)]
struct Day {
    date: String,
    days: Vec<Sum>,
}

/// Vibration since the last pause.
#[derive(Debug, Serialize, Deserialize)]
struct Since {
    vibration_s: f64,
    /// When pins last vibrated, by both clocks; `None`: plays run or wait, or pins are left up.
    until: Option<(String, u64)>,
}

/// The file.
#[derive(Debug, Serialize, Deserialize)]
struct File {
    #[serde(flatten)]
    today: Day,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    other_dates: Vec<Day>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    stretch: Option<Since>,
}

fn checked(what: impl Display, vibration_s: f64) -> Result<f64, String> {
    if (0.0..=MOST_S).contains(&vibration_s) {
        return Ok(vibration_s);
    }
    Err(format!("{what} has {vibration_s} s of vibration, which cannot be"))
}

fn sums(Day { date, days }: Day) -> Result<(Date, Sums), String> {
    let date: Date = date.parse().map_err(|error: jiff::Error| error.to_string())?;
    let mut sums = Sums::new();
    for Sum { participant, vibration_s } in days {
        let what =
            participant.as_ref().map_or_else(|| date.to_string(), |name| format!("{name:?} on {date}"));
        add(&mut sums, participant.as_deref().map(key), checked(what, vibration_s)?);
    }
    Ok((date, sums))
}

impl Account {
    /// Takes the sums from the file's text.
    ///
    /// # Errors
    /// Why the text cannot be true. Then the account is unknown, and the day counts as used up.
    pub fn restore(&mut self, text: &[u8], now: Now) -> Result<(), Unreadable> {
        self.try_restore(text, now).map_err(|why| self.lose(&why))
    }

    /// Starts from 0, because there is no file. `vanished`: the date, if plays of that day must have been in it.
    pub fn restore_none(&mut self, vanished: Option<Date>) {
        (self.unknown, self.vanished) = (None, vanished);
    }

    /// Notes that the sums are unknown. Returns why, and what to do.
    pub fn lose(&mut self, why: &str) -> Unreadable {
        let text = format!(
            "`{FILE}`: {why}: today's vibration is not known and counts as all that `participant.max_day_s` allows; look at the file \
             beside the session record, correct or remove it, and start the daemon again"
        );
        self.unknown = Some(text.clone());
        Unreadable(text)
    }

    fn try_restore(&mut self, text: &[u8], now: Now) -> Result<(), String> {
        let File { today, other_dates, stretch } =
            serde_json::from_slice(text).map_err(|error| error.to_string())?;
        let mut dates: BTreeMap<Date, Sums> = BTreeMap::new();
        for day in std::iter::once(today).chain(other_dates) {
            let (date, sums) = sums(day)?;
            let of_date = dates.entry(date).or_default();
            sums.into_iter().for_each(|(person, sum_s)| add(of_date, person, sum_s));
        }
        let stretch = match stretch {
            None => Stretch::NONE,
            // The plays of a killed daemon ended at an unknown time; assume that they end now, and leave pins up.
            Some(Since { vibration_s, until: None }) => {
                let used_s = checked("the stretch without a pause", vibration_s)?;
                Stretch { used_s, until_s: seconds(now.at) + STILL_S }
            }
            Some(Since { vibration_s, until: Some((until, monotonic_ns)) }) => {
                let used_s = checked("the stretch without a pause", vibration_s)?;
                let until: Timestamp = until.parse().map_err(|error: jiff::Error| error.to_string())?;
                // Take the clock by which less time has passed.
                let by_wall_s = now.wall.duration_since(until).as_secs_f64();
                let by_host_s = (now.at.as_ns() as f64 - monotonic_ns as f64) / 1e9;
                // The monotonic clock restarts with the machine. Pins that stand vibrate for a while yet.
                let rested_s = if by_host_s >= -STILL_S { by_wall_s.min(by_host_s) } else { by_wall_s };
                let rested_s = rested_s.max(-STILL_S);
                // By the other clock the time before the next movement may be longer, and count.
                let longer_s = (by_wall_s.max(by_host_s) - rested_s).clamp(0.0, STILL_S);
                Stretch { used_s: used_s + longer_s, until_s: seconds(now.at) - rested_s }
            }
        };
        (self.dates, self.stretch, self.unknown, self.vanished) = (dates, stretch, None, None);
        self.keep_few_dates();
        Ok(())
    }

    /// The sums as the file's text, including the time that plays may still use; none while the sums are unknown.
    pub fn text(&self, now: Now) -> Option<String> {
        if self.unknown.is_some() {
            return None;
        }
        let (at_s, mut kept_s) = (seconds(now.at), self.stands_s);
        kept_s += self.live.iter().map(Live::left_s).sum::<f64>();
        let is_still = self.live.is_empty() && self.stands_s <= 0.0;
        if !is_still {
            // A killed daemon does not know when the pins were still again, nor so how long before the next play.
            kept_s += STILL_S;
        }
        let mut dates = self.dates.clone();
        for date in [now.date, now.passed] {
            dates.entry(date).or_default();
        }
        for (date, sums) in &mut dates {
            if kept_s > 0.0 && (*date == now.date || *date == now.passed) {
                add(sums, self.person(), kept_s);
            }
        }
        let list = |sums: Sums| {
            sums.into_iter().map(|(participant, vibration_s)| Sum { participant, vibration_s }).collect()
        };
        let today =
            Day { date: now.date.to_string(), days: list(dates.remove(&now.date).unwrap_or_default()) };
        let other_dates = dates.into_iter().filter(|(_, sums)| !sums.is_empty());
        let other_dates =
            other_dates.map(|(date, sums)| Day { date: date.to_string(), days: list(sums) }).collect();
        let stretch = self.stretch(now);
        let used_s = kept_s + stretch.used_at(at_s, self.limits.pause_s);
        let stretch = (used_s > 0.0).then(|| {
            let rested = SignedDuration::try_from_secs_f64(at_s - stretch.until_s).unwrap_or_default();
            let wall = now.wall.saturating_sub(rested).unwrap_or(now.wall);
            let until = (wall.to_string(), (stretch.until_s.max(0.0) * 1e9) as u64);
            Since { vibration_s: used_s, until: Some(until).filter(|_| is_still) }
        });
        // Plain data can be written.
        serde_json::to_string(&File { today, other_dates, stretch }).ok().map(|text| text + "\n")
    }
}
