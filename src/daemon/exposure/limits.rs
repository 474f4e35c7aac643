//! Refuses a play with strokes that the controller would refuse: too many at once, or too much against a lower stop.
//!
//! It knows the settings alone; what else the device cannot take, the streamer refuses.

use meissner_api::{Code, Problem};
use meissner_array::power::{Group, TooMany};
use meissner_stream::{Dense, DryRun, Overpush, Settings};

/// Refuses a play with strokes that the controller would refuse.
pub(in crate::daemon) fn check_limits(found: &DryRun, settings: &Settings) -> Result<(), Problem> {
    if let Some(Dense { at_s, most }) = found.dense {
        let detail = format!(
            "more than {most} strokes of all motors would begin within 10 ms, first after {at_s:.4} s; the controller allows no more: \
             make drives, repeats or items longer, or drive fewer motors"
        );
        return Err(Problem::new(Code::TooDense, detail));
    }
    if let Some((Overpush { motor, at_s }, stop)) = found.overpush.zip(settings.lower_stop) {
        let detail = format!(
            "motor {motor} would push the lower stop with more than {} pulses per second, from {at_s:.2} s on: play at a lower \
             frequency, or configure a smaller `surplus_um` or a larger `limits.stop_pulses_per_s`",
            stop.pulses_per_s
        );
        return Err(Problem::new(Code::PushLimit, detail));
    }
    let Some(TooMany { group, tick, at_once }) = found.too_many else { return Ok(()) };
    let at_s = settings.array.rate().ticks_to_seconds(tick);
    Err(too_many(group, &format!("{at_once} motors with pulses at once, first after {at_s:.4} s"), settings))
}

/// The problem of a rail or chip that would have too many motors with pulses at once.
pub(in crate::daemon) fn too_many(group: Group, has: &str, settings: &Settings) -> Problem {
    let (key, most) = match group {
        Group::Rail(_) => ("rail", settings.limits.rail_at_once),
        Group::Chip(_) => ("chip", settings.limits.chip_at_once),
    };
    let detail = format!(
        "{} would have {has}; `array.{key}_motors_at_once` allows {most}: play fewer motors of it, smaller amplitudes or other \
         phases (docs/board.md)",
        group.in_words(&settings.array)
    );
    Problem::new(Code::PowerLimit, detail)
}
