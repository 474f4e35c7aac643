//! Refuses a play with strokes that the controller would refuse: too many at once, or too much against a lower stop.
//!
//! It knows the settings alone; what else the device cannot take, the streamer refuses.

use meissner_api::{Code, Problem};
use meissner_array::power::{Group, TooMany};
use meissner_array::strokes::Strokes;
use meissner_stream::{Dense, Overpush, Settings, find_dense, find_overpush, find_too_many};

/// Refuses a play with strokes that the controller would refuse.
pub(in crate::daemon) fn check_limits(strokes: &Strokes, settings: &Settings) -> Result<(), Problem> {
    check_density(strokes)?;
    check_pushing(strokes, settings)?;
    check_at_once(strokes, settings)
}

fn check_density(strokes: &Strokes) -> Result<(), Problem> {
    let Some(Dense { at_s, most }) = find_dense(strokes) else { return Ok(()) };
    let detail = format!(
        "more than {most} strokes of all motors would begin within 10 ms, first after {at_s:.4} s; the controller allows no more: \
         make drives, repeats or items longer, or drive fewer motors"
    );
    Err(Problem::new(Code::TooDense, detail))
}

/// Refuses a play that would push the lower stop more than the controller allows.
fn check_pushing(strokes: &Strokes, settings: &Settings) -> Result<(), Problem> {
    let Some(limit) = settings.lower_stop.map(|stop| stop.pulses_per_s) else { return Ok(()) };
    let Some(Overpush { motor, at_s }) = find_overpush(strokes, limit) else { return Ok(()) };
    let detail = format!(
        "motor {motor} would push the lower stop with more than {limit} pulses per second, from {at_s:.2} s on: play at a lower \
         frequency, or configure a smaller `surplus_um` or a larger `limits.stop_pulses_per_s`"
    );
    Err(Problem::new(Code::PushLimit, detail))
}

/// Refuses a play in which more motors would have pulses at once than the limits allow.
fn check_at_once(strokes: &Strokes, settings: &Settings) -> Result<(), Problem> {
    let Some(TooMany { group, tick, at_once }) = find_too_many(strokes, settings.limits) else {
        return Ok(());
    };
    let at_s = strokes.array().rate().ticks_to_seconds(tick);
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
