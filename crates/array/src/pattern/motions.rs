//! Checks the motions of a pattern together, and makes the waveform of each motor.
//!
//! Counts are checked before anything is allocated for them. Motions of a motor add up; the sum stays from 0 to the travel of the
//! motor, and does not stay at one height above rest for longer than [`MAX_HOLD_S`]. A drive of the motor leaves room for the moves,
//! which may begin a step of the coarsest grid early, and end when the pin is down from any height.
//!
//! Invariant: the waveforms are in order of their motors, one for each motor that has a motion.

use super::drive::Drive;
use super::error::{KeyError, Problem};
use super::limits::{MAX_AT_ONCE, MAX_HOLD_S, MAX_MOTIONS, MAX_PATTERN_SAMPLES};
use super::motion::{Motion, Wave};
use crate::motion::{Knot, MOST_NOISE_WORK, MotionError, SLOWEST_STEP_MS, Waveform, ns_of, s_of};
use crate::spec::Array;
use meissner_input::document::in_range;
use std::collections::BTreeMap;

/// What rounding may put a sum beyond its range, µm: a hundredth of a pulse.
const ROUNDING_UM: f64 = 0.001;

/// A motor's waveform.
pub(super) type OfMotor = (u8, Waveform);

/// A motion's place in the file.
pub(super) fn place(motions: &[Motion], index: usize) -> (&'static str, usize) {
    let table = motions[index].table();
    (table, motions[..index].iter().filter(|motion| motion.table() == table).count())
}

/// An error in the table of a motion.
fn within(motions: &[Motion], index: usize, error: KeyError) -> KeyError {
    let (table, number) = place(motions, index);
    error.within(&format!("{table}[{number}]"))
}

fn of_motion(motions: &[Motion], index: usize, problem: Problem) -> KeyError {
    within(motions, index, KeyError::whole(None, problem))
}

/// Checks the motions and makes the waveform of each motor.
pub(super) fn waveforms(
    array: Array,
    duration_s: Option<f64>,
    drives: &[Drive],
    motions: &[Motion],
) -> Result<Vec<OfMotor>, KeyError> {
    check_amount(array, motions)?;
    let mut by_motor: BTreeMap<u8, Vec<(usize, Waveform)>> = BTreeMap::new();
    for (index, motion) in motions.iter().enumerate() {
        let motor = motion.motor();
        let waveform =
            motion.waveform().map_err(|error| of_motion(motions, index, refused(motion, error)))?;
        let end_s = waveform.span_ns().map_or(0.0, |(_, end)| s_of(end));
        if let Some(duration_s) = duration_s
            && end_s > duration_s + 1e-9
        {
            let problem = Problem::EndsLate { motor, end_s, duration_s };
            return Err(of_motion(motions, index, problem));
        }
        by_motor.entry(motor).or_default().push((index, waveform));
    }
    let mut sums = Vec::with_capacity(by_motor.len());
    for (motor, mut parts) in by_motor {
        parts.sort_by_key(|(_, waveform)| waveform.span_ns());
        let of = |index: usize, problem| of_motion(motions, index, problem);
        if let Some((index, ns)) = too_many_at_once(&parts) {
            return Err(of(index, Problem::AtOnce { motor, at_s: s_of(ns) }));
        }
        if let Some((index, problem)) = crossing(array, duration_s, drives, motor, &parts) {
            return Err(of(index, problem));
        }
        let (first, waves): (Vec<usize>, Vec<Waveform>) = parts.into_iter().unzip();
        let sum = Waveform::sum(&waves)
            .map_err(|error| of(first[0], Problem::Motion { motor, error: error.into() }))?;
        if let Some((ns, um)) = leaving(&sum, array.motor().travel_um) {
            let here =
                |wave: &&Waveform| wave.span_ns().is_some_and(|(from, until)| (from..=until).contains(&ns));
            let active: Vec<usize> =
                first.iter().zip(&waves).filter(|(_, wave)| here(wave)).map(|(index, _)| *index).collect();
            return Err(of(active[0], leaves(array, motions, &active, ns, um)));
        }
        if let Some((from, until)) = long_hold(&sum) {
            let problem = Problem::LongHold { motor, from_s: s_of(from), seconds: s_of(until - from) };
            return Err(of(first[0], problem));
        }
        sums.push((motor, sum));
    }
    Ok(sums)
}

/// Refuses what would take too much memory or time, before anything is made.
fn check_amount(array: Array, motions: &[Motion]) -> Result<(), KeyError> {
    if motions.len() > MAX_MOTIONS {
        let problem = Problem::TooManyMotions { count: motions.len() };
        return Err(KeyError::whole(None, problem));
    }
    let (mut samples, mut work) = (0, 0.0);
    for (index, motion) in motions.iter().enumerate() {
        let motor = motion.motor();
        in_range("motor", motor.into(), array.has(motor), array.motor_range())
            .map_err(|error| within(motions, index, error))?;
        let refused = |error| of_motion(motions, index, refused(motion, error));
        samples += motion.samples().map_err(refused)?;
        if samples > MAX_PATTERN_SAMPLES {
            return Err(of_motion(motions, index, Problem::TooManySamples));
        }
        if let Motion::Noise(noise) = motion {
            if noise.rms_um.is_some() == noise.peak_um.is_some() {
                return Err(of_motion(motions, index, Problem::Strength));
            }
            work += noise.work().map_err(refused)?;
            if i64::try_from(noise.seed).is_err() {
                return Err(within(
                    motions,
                    index,
                    KeyError::key("seed", Problem::Seed { found: noise.seed }),
                ));
            }
        }
        if work > MOST_NOISE_WORK {
            return Err(of_motion(motions, index, Problem::MuchNoise));
        }
        if !motion.has_short_source() {
            return Err(within(motions, index, KeyError::key("source", Problem::LongSource)));
        }
    }
    Ok(())
}

/// What is wrong with a motion's own values. A sample's time is told.
fn refused(motion: &Motion, error: MotionError) -> Problem {
    let motor = motion.motor();
    match (motion, error) {
        (Motion::Wave(Wave { start_s, rate_hz, .. }), MotionError::Sample { number, um }) => {
            Problem::Sample { motor, number, at_s: start_s + number as f64 / rate_hz, um }
        }
        _ => Problem::Motion { motor, error: error.into() },
    }
}

/// The first motion that makes too many at once, and when. The parts are in order of their beginnings.
fn too_many_at_once(parts: &[(usize, Waveform)]) -> Option<(usize, u64)> {
    let mut ends = Vec::new();
    parts.iter().find_map(|(index, waveform)| {
        let (from, until) = waveform.span_ns()?;
        ends.retain(|end| *end > from);
        ends.push(until);
        (ends.len() > MAX_AT_ONCE).then_some((*index, from))
    })
}

/// A motion that a drive of the motor leaves no room for.
fn crossing(
    array: Array,
    duration_s: Option<f64>,
    drives: &[Drive],
    motor: u8,
    parts: &[(usize, Waveform)],
) -> Option<(usize, Problem)> {
    let step_s = SLOWEST_STEP_MS as f64 / 1000.0;
    let spec = array.motor();
    let down_s = spec.travel_um / (spec.um_per_pulse * f64::from(array.rate().hz()));
    let own = || drives.iter().enumerate().filter(|(_, drive)| drive.motor == motor);
    parts.iter().find_map(|(index, waveform)| {
        let (from_ns, until_ns) = waveform.span_ns()?;
        let (from_s, until_s) = ((s_of(from_ns) - step_s).max(0.0), s_of(until_ns) + step_s + down_s);
        let (drive, _) = own().find(|(_, drive)| {
            drive.start() < until_s && drive.stop_s.or(duration_s).is_none_or(|stop_s| stop_s > from_s)
        })?;
        Some((*index, Problem::Crosses { motor, drive: drive + 1, from_s, until_s }))
    })
}

/// The first knot beyond the range of the pin, with its height.
fn leaving(waveform: &Waveform, travel_um: f64) -> Option<(u64, f64)> {
    let range = -ROUNDING_UM..=travel_um + ROUNDING_UM;
    waveform.knots().find(|knot| !range.contains(&knot.um)).map(|knot| (knot.ns, knot.um))
}

/// Says where a motor's sum leaves its range: the sample if it is one wave's, else the summands.
fn leaves(array: Array, motions: &[Motion], active: &[usize], ns: u64, um: f64) -> Problem {
    let (motor, at_s, most_um) = (motions[active[0]].motor(), s_of(ns), array.motor().travel_um);
    let of = match (active, &motions[active[0]]) {
        ([_], Motion::Wave(wave)) => {
            let after_s = s_of(ns.saturating_sub(ns_of(wave.start_s)));
            format!(", sample {}", (after_s * wave.rate_hz).round() as usize)
        }
        ([_], _) => String::new(),
        (more, _) => {
            let names = more.iter().map(|index| place(motions, *index));
            let names: Vec<_> = names.map(|(table, number)| format!("{table} {}", number + 1)).collect();
            format!(", as the sum of {}", names.join(", "))
        }
    };
    Problem::Leaves { motor, um, at_s, of: of.into(), most_um }
}

/// From and until when a waveform stays at one height above rest for too long, ns.
fn long_hold(waveform: &Waveform) -> Option<(u64, u64)> {
    let most = ns_of(MAX_HOLD_S);
    let (mut from, mut last) = (0, Knot { ns: 0, um: 0.0 });
    // The last knot is at rest, so every hold ends with another height.
    for knot in waveform.knots() {
        if knot.um != last.um {
            if last.um > ROUNDING_UM && last.ns - from > most {
                return Some((from, last.ns));
            }
            from = knot.ns;
        }
        last = knot;
    }
    None
}
