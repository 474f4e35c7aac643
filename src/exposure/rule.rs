//! The rule that decides whether a play fits, from the vibration before its onset. It is pure; times are seconds on one clock.
//!
//! For the limit without a pause, all vibration before the onset counts, including that of plays that run and wait, unless a pause
//! fits before the onset. If a start time is not fixed, the rule assumes the one that leaves the shortest pause. A play that may begin
//! less than half a second after the vibration before it keeps that time, too: it is one vibration then.
//!
//! Invariant: a play that fits exceeds no limit, whatever else is played between the decision and its end.

use super::limits::{Limit, ParticipantLimits};
use super::vibration::{ROUNDING_S, STILL_S, Stretch, Vibration};

/// The time between two reports of a running play, s.
pub(super) const REPORT_S: f64 = 0.1;
/// A play without end is stopped this long before a limit, s, and its way back before that. It covers the time to the next report, the
/// time of the stop, and, if the daemon is killed meanwhile, the default timeout of the board's watchdog (0.3 s).
pub(super) const EARLY_S: f64 = REPORT_S + 0.02 + 0.3;
/// The least remaining time for a play without end, s.
const LEAST_S: f64 = EARLY_S + REPORT_S;
/// How long a replaced play may still vibrate, and how much later than planned a play that waits may end, s.
const LATE_S: f64 = 0.1;
/// The uncertainty of an onset, s, because the device's clock is estimated.
const CLOCK_S: f64 = 0.01;

/// When a play begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Onset {
    /// The play has begun at this time.
    Began(f64),
    /// The play begins at this time or later.
    At(f64),
    /// The play begins after the plays before it.
    Next,
}

/// A play that was accepted and has not ended.
#[derive(Clone, Copy, Debug)]
pub struct Pending<'v> {
    /// When it vibrates.
    pub vibration: &'v Vibration,
    /// When it begins.
    pub onset: Onset,
    /// The part of the play that is already in the sums, s.
    pub counted_to_s: f64,
    /// What the time before its first movement may count, s.
    pub gap_s: f64,
    /// When another play replaced it, s.
    pub cut_s: Option<f64>,
}

/// The vibration so far.
#[derive(Clone, Debug)]
pub struct SoFar<'v> {
    /// The current time.
    pub at_s: f64,
    /// Vibration since the last pause.
    pub stretch: Stretch,
    /// Vibration in the session; `None`: no session runs.
    pub session_s: Option<f64>,
    /// Vibration today.
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
    /// Whether it replaces the plays that run and wait.
    pub replace: bool,
}

/// A play that does not fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exceeded {
    /// The limit that the play would exceed.
    pub limit: Limit,
    /// The limit, s.
    pub most_s: f64,
    /// The vibration used, and reserved for the plays that run and wait, s.
    pub used_s: f64,
    /// The vibration of the play, s; `None`: it has no end.
    pub play_s: Option<f64>,
    /// How long a pause is, s.
    pub pause_s: f64,
}

/// Decides whether a play fits. Returns what the time before its first movement may count, s.
///
/// # Errors
/// The limit that the play would exceed.
pub fn judge(limits: &ParticipantLimits, so_far: &SoFar<'_>, order: &Order<'_>) -> Result<f64, Exceeded> {
    let &ParticipantLimits { max_continuous_s, pause_s, max_session_s, max_day_s, .. } = limits;
    let (mut stretch, mut free_s, mut kept_s) = (so_far.stretch, so_far.at_s, 0.0);
    for &Pending { vibration, onset, counted_to_s, gap_s, cut_s } in &so_far.plays {
        kept_s += gap_s;
        stretch.used_s += gap_s;
        let freed_s = cut_s.or(order.replace.then_some(so_far.at_s));
        let cut_s = freed_s.map(|cut_s| cut_s + LATE_S);
        // A cut play's way back.
        let back_s = if cut_s.is_some() { vibration.return_s() } else { 0.0 };
        let (onset_s, late_s) = match onset {
            Onset::Began(at_s) => (at_s, 0.0),
            Onset::At(at_s) => (free_s.max(at_s), LATE_S),
            Onset::Next => (free_s, LATE_S),
        };
        if let (Some(cut_s), Onset::At(_) | Onset::Next) = (cut_s, onset) {
            // The play may have begun since the last report.
            let from_s = onset_s - REPORT_S;
            if from_s < cut_s {
                kept_s += cut_s + back_s - from_s;
                stretch = stretch.with(from_s, cut_s + back_s, pause_s);
            }
            continue;
        }
        let to_s = match cut_s {
            Some(cut_s) => cut_s - onset_s,
            // The streamer does not queue a play after one without end.
            None if vibration.is_endless() => so_far.at_s - onset_s,
            None => f64::INFINITY,
        };
        kept_s += vibration.within(counted_to_s, to_s);
        stretch = vibration.walk(onset_s, (counted_to_s, to_s), stretch, pause_s).1;
        if let Some(cut_s) = cut_s.filter(|_| back_s > 0.0) {
            kept_s += back_s;
            // It may come earlier, or nothing stands.
            let used_s = stretch.used_at(cut_s - LATE_S, pause_s) + back_s;
            stretch = Stretch { used_s, until_s: stretch.until_s.max(cut_s + back_s) };
        }
        stretch.until_s += late_s;
        free_s = free_s.max(freed_s.unwrap_or(f64::INFINITY).min(onset_s + vibration.end().min(to_s)));
    }
    let onset_s = match order.onset {
        Onset::At(at_s) | Onset::Began(at_s) => free_s.max(at_s - CLOCK_S),
        Onset::Next => free_s,
    };
    let first_s = onset_s + order.vibration.first();
    // The movement before may end later than planned, and this play may begin later.
    let gap_s = if first_s - stretch.until_s < STILL_S + LATE_S { STILL_S } else { 0.0 };
    kept_s += gap_s;
    stretch.used_s += gap_s;
    let (most_s, _) = order.vibration.walk(onset_s, (0.0, f64::INFINITY), stretch, pause_s);
    let used_s = stretch.used_at(first_s, pause_s);
    let total_s = order.vibration.total();
    let finite = |seconds: f64| Some(seconds).filter(|seconds| seconds.is_finite());
    let least_s = LEAST_S + order.vibration.return_s();
    let needs = |used_s: f64| used_s + total_s.unwrap_or(least_s);
    let (session_s, day_s) = (so_far.session_s.map(|used_s| used_s + kept_s), so_far.day_s + kept_s);
    for (limit, most_s, used_s, play_s, needs_s) in [
        (
            Limit::Continuous,
            max_continuous_s,
            used_s,
            finite(order.vibration.longest(pause_s)),
            finite(most_s).unwrap_or(used_s + least_s),
        ),
        // Without a session only the day has a sum.
        (Limit::Session, max_session_s, session_s.unwrap_or(0.0), total_s, session_s.map_or(0.0, needs)),
        (Limit::Day, max_day_s, day_s, total_s, needs(day_s)),
    ] {
        if needs_s > most_s + ROUNDING_S {
            return Err(Exceeded { limit, most_s, used_s, play_s, pause_s });
        }
    }
    Ok(gap_s)
}
