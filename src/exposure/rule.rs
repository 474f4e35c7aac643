//! The rule: whether a play fits, by the vibration before its onset. Pure; times are seconds on one clock.
//!
//! What counts for the limit without a pause is all vibration before the onset, of the plays that run and wait too, unless a pause
//! fits before the onset. Where the order leaves open when something begins, the rule takes the time that leaves the shortest pause.
//!
//! Invariant: a play that fits passes no limit, whatever is played between the decision and its end.

use super::{Limit, ParticipantLimits, Vibration};

/// What passes between two reports of a running play, s.
pub(super) const REPORT_S: f64 = 0.1;
/// A play without end is stopped so long before a limit, s: until the next report, until the stop is done, and, should the daemon be
/// killed meanwhile, until the board's watchdog notices it by default (0.3 s).
pub(super) const EARLY_S: f64 = REPORT_S + 0.02 + 0.3;
/// What a play without end must find, s.
const LEAST_S: f64 = EARLY_S + REPORT_S;
/// Sums are so exact, s: more than rounding errors add up to.
pub(super) const ROUNDING_S: f64 = 1e-6;
/// How long a replaced play may still vibrate, and how much later than planned a play that waits may end, s.
const LATE_S: f64 = 0.1;
/// How exact an onset is, s: the device's clock is estimated.
const CLOCK_S: f64 = 0.01;

/// Vibration since the last pause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// How long pins have vibrated, s.
    pub used_s: f64,
    /// When they vibrated last, s.
    pub until_s: f64,
}

impl Default for Stretch {
    fn default() -> Self {
        Self::NONE
    }
}

impl Stretch {
    /// Nothing has vibrated yet.
    pub const NONE: Self = Self { used_s: 0.0, until_s: f64::NEG_INFINITY };

    /// Whether a pause is over at `at_s`.
    #[must_use]
    pub fn is_over(&self, at_s: f64, pause_s: f64) -> bool {
        at_s - self.until_s >= pause_s - ROUNDING_S
    }

    /// With vibration from `from_s` to `to_s`.
    #[must_use]
    pub fn with(self, from_s: f64, to_s: f64, pause_s: f64) -> Self {
        Self { used_s: self.used_at(from_s, pause_s) + to_s - from_s, until_s: self.until_s.max(to_s) }
    }

    /// What counts for vibration that begins at `at_s`, s.
    #[must_use]
    pub fn used_at(&self, at_s: f64, pause_s: f64) -> f64 {
        if self.is_over(at_s, pause_s) { 0.0 } else { self.used_s }
    }
}

/// When a play begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Onset {
    /// It has begun.
    Began(f64),
    /// Not before.
    At(f64),
    /// After the plays before it.
    Next,
}

/// A play that was accepted and has not ended.
#[derive(Clone, Copy, Debug)]
pub struct Pending<'v> {
    /// When it vibrates.
    pub vibration: &'v Vibration,
    /// When it begins.
    pub onset: Onset,
    /// So much of the play is in the sums already, s.
    pub counted_to_s: f64,
    /// When another play took its place, s.
    pub cut_s: Option<f64>,
}

/// The vibration so far.
#[derive(Clone, Debug)]
pub struct SoFar<'v> {
    /// Now.
    pub at_s: f64,
    /// Since the last pause.
    pub stretch: Stretch,
    /// In the session; `None`: none runs.
    pub session_s: Option<f64>,
    /// In the day.
    pub day_s: f64,
    /// The plays that run and wait, in their order.
    pub plays: Vec<Pending<'v>>,
}

/// A play that is ordered.
#[derive(Clone, Copy, Debug)]
pub struct Order<'v> {
    /// When it vibrates.
    pub vibration: &'v Vibration,
    /// When it begins.
    pub onset: Onset,
    /// It takes the place of those that run and wait.
    pub replace: bool,
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

/// Decides whether a play fits.
///
/// # Errors
/// The limit into which it does not fit.
pub fn judge(limits: &ParticipantLimits, so_far: &SoFar<'_>, order: &Order<'_>) -> Result<(), Exceeded> {
    let &ParticipantLimits { max_continuous_s, pause_s, max_session_s, max_day_s, .. } = limits;
    let (mut stretch, mut free_s, mut kept_s) = (so_far.stretch, so_far.at_s, 0.0);
    for &Pending { vibration, onset, counted_to_s, cut_s } in &so_far.plays {
        let freed_s = cut_s.or(order.replace.then_some(so_far.at_s));
        let cut_s = freed_s.map(|cut_s| cut_s + LATE_S);
        let (onset_s, late_s) = match onset {
            Onset::Began(at_s) => (at_s, 0.0),
            Onset::At(at_s) => (free_s.max(at_s), LATE_S),
            Onset::Next => (free_s, LATE_S),
        };
        if let (Some(cut_s), Onset::At(_) | Onset::Next) = (cut_s, onset) {
            // It may have begun since the last report.
            let from_s = onset_s - REPORT_S;
            if from_s < cut_s {
                kept_s += cut_s - from_s;
                stretch = stretch.with(from_s, cut_s, pause_s);
            }
            continue;
        }
        let to_s = match cut_s {
            Some(cut_s) => cut_s - onset_s,
            // The streamer lets no play wait behind one without end.
            None if vibration.is_endless() => so_far.at_s - onset_s,
            None => f64::INFINITY,
        };
        kept_s += (vibration.until(to_s) - vibration.until(counted_to_s)).max(0.0);
        stretch = vibration.walk(onset_s, (counted_to_s, to_s), stretch, pause_s).1;
        stretch.until_s += late_s;
        free_s = free_s.max(freed_s.unwrap_or(f64::INFINITY).min(onset_s + vibration.end().min(to_s)));
    }
    let onset_s = match order.onset {
        Onset::At(at_s) | Onset::Began(at_s) => free_s.max(at_s - CLOCK_S),
        Onset::Next => free_s,
    };
    let (most_s, _) = order.vibration.walk(onset_s, (0.0, f64::INFINITY), stretch, pause_s);
    let used_s = stretch.used_at(onset_s + order.vibration.first(), pause_s);
    let total_s = order.vibration.total();
    let finite = |seconds: f64| Some(seconds).filter(|seconds| seconds.is_finite());
    let needs = |used_s: f64| used_s + total_s.unwrap_or(LEAST_S);
    let (session_s, day_s) = (so_far.session_s.map(|used_s| used_s + kept_s), so_far.day_s + kept_s);
    for (limit, most_s, used_s, play_s, needs_s) in [
        (
            Limit::Continuous,
            max_continuous_s,
            used_s,
            finite(order.vibration.longest(pause_s)),
            finite(most_s).unwrap_or(used_s + LEAST_S),
        ),
        // Without a session, only the day has a sum.
        (Limit::Session, max_session_s, session_s.unwrap_or(0.0), total_s, session_s.map_or(0.0, needs)),
        (Limit::Day, max_day_s, day_s, total_s, needs(day_s)),
    ] {
        if needs_s > most_s + ROUNDING_S {
            return Err(Exceeded { limit, most_s, used_s, play_s, pause_s });
        }
    }
    Ok(())
}
