//! What motors do with the motions of a pattern, told before anything is played.
//!
//! [`Motions`] compiles the motions as the daemon does. For each motor it has the error of an ideal motor, from the waveform itself and
//! from the waveform after the motor's response, and the times at which the motor is too slow. For all of them it has the moves per
//! second and the bandwidth that the link needs.
//!
//! Of long motions the figures are those of the beginning ([`Motions::measured_s`]), as in a receipt: a pattern may last for years.
//!
//! Invariant: every figure is measured from the moves, none is promised.

use anyhow::Result;
use meissner_array::motion::{Deviation, TRIED_S};
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_array::strokes::{Followed, StrokeOptions, Strokes};
use meissner_stream::{Bandwidth, Settings};
use serde::Serialize;

/// The most times that are listed at which a motor is too slow.
const LISTED: usize = 100;

/// What the motors of a pattern do with its motions, in one run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Motions {
    /// The step of the grid on which all moves begin, ms.
    pub(super) step_ms: f64,
    /// Moves per second of all motors together, from the first motion's beginning until all pins rest.
    pub(super) moves_per_s: f64,
    /// The most moves that begin within a second, all motors together.
    pub(super) busiest_second: usize,
    /// The longest time for which a pin stays above rest between two moves, s.
    pub(super) longest_hold_s: f64,
    /// Bytes per second that the link must carry at the peak for the whole pattern, drives included, without corrections.
    pub(super) link_bytes_per_s: u32,
    /// The same with every burst corrected.
    pub(super) link_bytes_per_s_corrected: u32,
    /// How much of each motion the figures are of, from its beginning, s; null: all of it.
    pub(super) measured_s: Option<f64>,
    /// The motors that have motions, in order.
    pub(super) motors: Vec<FollowedMotor>,
}

/// How a motor follows its motions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct FollowedMotor {
    /// The motor's number.
    pub(super) motor: u8,
    /// The lowest displacement asked, µm above rest.
    pub(super) lowest_um: f64,
    /// The highest displacement asked, µm above rest.
    pub(super) highest_um: f64,
    /// The displacement against the waveform: the motor's lag and smoothing count.
    pub(super) from_asked: FollowingError,
    /// The displacement against the waveform after the motor's response: what speed, range and steps cost.
    pub(super) from_filtered: FollowingError,
    /// The largest difference from what a motor of this speed does without steps, µm.
    pub(super) step_error_um: f64,
    /// When the motor is too slow: from and until, s; the first hundred times. If it first is so after what is measured, only that instant,
    /// twice.
    pub(super) too_slow_s: Vec<[f64; 2]>,
    /// How often it is too slow.
    pub(super) too_slow_times: usize,
    /// For how long in all, s.
    pub(super) too_slow_in_all_s: f64,
    /// Moves in one run.
    pub(super) moves: usize,
    /// Moves per second.
    pub(super) moves_per_s: f64,
    /// The most moves that begin within a second.
    pub(super) busiest_second: usize,
    /// The longest time above rest between two moves, s.
    pub(super) longest_hold_s: f64,
}

/// How far a displacement is from another one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct FollowingError {
    /// Root mean square, µm.
    pub rms_um: f64,
    /// It as a share of the RMS of the reference about its mean; 0 if that does not move.
    pub share: f64,
    /// The largest difference, µm.
    pub peak_um: f64,
    /// The correlation r; null if one of both does not move.
    pub r: Option<f64>,
}

impl From<Deviation> for FollowingError {
    fn from(of: Deviation) -> Self {
        let Deviation { rms_um, share, correlation: r, peak_um } = of;
        Self { rms_um, share, peak_um, r }
    }
}

impl FollowedMotor {
    fn new(of: &Followed, measured_s: f64) -> Self {
        let Followed { motor, waveform, reached, .. } = of;
        let end_s = waveform.span_ns().map_or(0.0, |(from, _)| from as f64 / 1e9) + measured_s;
        let mut spans = reached.too_slow_s.clone();
        if spans.is_empty() {
            spans.extend(of.too_slow_from_s.filter(|from_s| *from_s >= end_s).map(|from_s| (from_s, from_s)));
        }
        let [lowest_um, highest_um] = waveform.extremes_um();
        Self {
            motor: *motor,
            lowest_um,
            highest_um,
            from_asked: reached.from_asked.into(),
            from_filtered: reached.from_filtered.into(),
            step_error_um: reached.step_error_um,
            too_slow_s: spans.iter().take(LISTED).map(|&(from, until)| [from, until]).collect(),
            too_slow_times: spans.len(),
            too_slow_in_all_s: spans.iter().fold(0.0, |sum, (from, until)| sum + until - from),
            moves: reached.moves,
            moves_per_s: reached.moves_per_s,
            busiest_second: reached.busiest_second,
            longest_hold_s: reached.longest_hold_s,
        }
    }

    /// In one line, why the pin does not follow; `None` if it does.
    pub(super) fn problem(&self, array: Array) -> Option<String> {
        let Self { motor, highest_um, .. } = *self;
        let spec = array.motor();
        let most_um = f64::from(spec.most_pulses) * spec.um_per_pulse;
        if let Some([from_s, until_s]) = self.too_slow_s.first() {
            let mm_per_s = spec.um_per_pulse * f64::from(array.rate().hz()) / 1000.0;
            let more = match self.too_slow_times {
                1 => String::new(),
                times => format!(" ({times} times, {:.3} s in all)", self.too_slow_in_all_s),
            };
            let until = if until_s > from_s { format!("to {until_s:.4} s{more}") } else { "s on".to_owned() };
            return Some(format!(
                "motor {motor} is too slow for its motion from {from_s:.4} {until}: it moves {mm_per_s:.1} mm/s at most; \
                 make the motion slower or smaller"
            ));
        }
        // Rounding to whole pulses.
        (highest_um > most_um + spec.um_per_pulse / 2.0).then(|| {
            format!("motor {motor} is saturated: its motion goes to {highest_um:.1} um, and it reaches {most_um:.1} um; make the motion smaller")
        })
    }
}

impl Motions {
    /// What the motors of a pattern do that is played `scale` times as high; `None` without motions. Takes some ms per second of each motion.
    ///
    /// # Errors
    /// If an option is out of its range.
    pub(super) fn of(pattern: &Pattern, scale: f64) -> Result<Option<Self>> {
        let array = pattern.array();
        let stroke_options = StrokeOptions { scale, ..StrokeOptions::lasting(pattern.motions_rest_s()) };
        let strokes = Strokes::new(pattern, &stroke_options)?;
        let motors = strokes.followed();
        let Some(Followed { grid, .. }) = motors.first() else { return Ok(None) };
        let measured_s = measured_s(&motors);
        let end_s = measured_s.unwrap_or(f64::INFINITY);
        let followed: Vec<_> = motors.iter().map(|of| FollowedMotor::new(of, end_s)).collect();
        let Bandwidth { open, closed } = Bandwidth::of(&strokes, &Settings::of(array));
        let (moves_per_s, busiest_second) = together(array, &motors);
        Ok(Some(Self {
            step_ms: array.rate().ticks_to_ms(grid.step_ticks.into()),
            moves_per_s,
            busiest_second,
            longest_hold_s: followed.iter().map(|of| of.longest_hold_s).fold(0.0, f64::max),
            link_bytes_per_s: open.rate,
            link_bytes_per_s_corrected: closed.rate,
            measured_s,
            motors: followed,
        }))
    }

    /// A line for each motor that does not follow its motion.
    pub(super) fn problems(&self, array: Array) -> Vec<String> {
        self.motors.iter().filter_map(|of| of.problem(array)).collect()
    }
}

/// How much of each motion is measured, s; `None`: all of it. The motors share [`TRIED_S`].
fn measured_s(motors: &[Followed]) -> Option<f64> {
    let most = (TRIED_S * 1e9) as u64 / motors.len().max(1) as u64;
    let is_longer = |of: &Followed| of.waveform.span_ns().is_some_and(|(from, until)| until - from > most);
    motors.iter().any(is_longer).then_some(most as f64 / 1e9)
}

/// Moves per second of all motors, and the most within a second: from the first beginning of a waveform until the last pin rests, or for
/// as long as is measured.
fn together(array: Array, motors: &[Followed]) -> (f64, usize) {
    let rate = array.rate();
    let spans = || motors.iter().filter_map(|of| of.waveform.span_ns());
    let from_s = spans().map(|(from, _)| from).min().unwrap_or(0) as f64 / 1e9;
    let until_s = spans().map(|(_, until)| until).max().unwrap_or(0) as f64 / 1e9;
    let mut ticks: Vec<u64> = motors.iter().flat_map(|of| &of.moves).map(|of| of.tick.0).collect();
    ticks.sort_unstable();
    let settled_s = if let Some(measured_s) = measured_s(motors) {
        let end = rate.seconds_to_ticks(from_s + measured_s);
        ticks.truncate(ticks.partition_point(|&tick| tick < end));
        from_s + measured_s
    } else {
        rate.ticks_to_seconds(ticks.last().copied().unwrap_or(0)).max(until_s)
            + rate.ticks_to_seconds(array.motor().settled_ticks())
    };
    let mut first = 0;
    let busiest = ticks.iter().enumerate().map(|(last, tick)| {
        while tick - ticks[first] >= rate.per_s() {
            first += 1;
        }
        last + 1 - first
    });
    let busiest = busiest.max().unwrap_or(0);
    (ticks.len() as f64 / (settled_s - from_s).max(1e-9), busiest)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(tables: &str) -> Pattern {
        Pattern::parse(&format!("format = 1\nname = \"test\"\n{tables}"), "test.toml").unwrap()
    }

    fn of(tables: &str) -> Motions {
        Motions::of(&pattern(tables), 1.0).unwrap().unwrap()
    }

    const RAMP: &str = "[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = 0.05\nhold_s = 0.5\n";

    #[test]
    fn each_motor_has_its_error_and_a_pattern_its_moves_and_bytes() {
        let found = of(&format!(
            "{RAMP}[[tone]]\nmotor = 3\nduration_s = 1.0\nfrequency_hz = 40.0\namplitude_um = 40.0\nphase = 0.75\nenvelope = \"hann\"\n"
        ));
        let [tone, ramp] = &found.motors[..] else { panic!("{found:?}") };
        assert_eq!((tone.motor, ramp.motor), (3, 9));
        // The lag of 2.15 ms in a ramp of 4 mm/s is 8.6 um; without it there are only steps.
        assert!(ramp.from_asked.peak_um > 7.5 && ramp.from_filtered.peak_um < 0.95, "{ramp:?}");
        assert!((0.49..0.51).contains(&ramp.longest_hold_s) && found.longest_hold_s == ramp.longest_hold_s);
        assert!(tone.lowest_um >= 0.0 && (38.0..40.1).contains(&tone.highest_um), "{tone:?}");
        assert!(found.problems(Array::paper()).is_empty(), "{found:?}");
        let moves = tone.moves + ramp.moves;
        assert!(found.busiest_second >= tone.busiest_second && moves >= found.busiest_second);
        assert!(found.link_bytes_per_s > 1000 && found.link_bytes_per_s_corrected > found.link_bytes_per_s);
        // Half as high, half the error of the lag.
        let half = Motions::of(&pattern(RAMP), 0.5).unwrap().unwrap();
        assert!((half.motors[0].from_asked.rms_um / ramp.from_asked.rms_um - 0.5).abs() < 0.05, "{half:?}");
    }

    #[test]
    fn a_motor_that_is_too_slow_is_named_with_its_times() {
        let found = of("[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = 0.0\nhold_s = 0.5\n");
        let [line] = &found.problems(Array::paper())[..] else { panic!("{found:?}") };
        assert!(
            line.starts_with("motor 9 is too slow for its motion from 0.0000 to 0.017")
                && line.contains("(2 times, 0.03"),
            "{line}"
        );
    }

    /// A year at rest but for its ends, and a tone of an hour: as much is measured of both as of a tone of two minutes.
    #[test]
    fn of_motions_of_years_the_beginning_is_measured() {
        let tone = |seconds: f64| {
            format!("[[tone]]\nmotor = 3\nduration_s = {seconds}\nfrequency_hz = 10.0\namplitude_um = 40.0\n")
        };
        let years = "[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = 5e7\nfall_s = 0.0\n";
        // Both have two motors, and the same grid.
        let slow = "[[ramp]]\nmotor = 9\nto_um = 10.0\nrise_s = 50.0\n";
        let (long, short) = (of(&format!("{}{years}", tone(3600.0))), of(&format!("{}{slow}", tone(120.0))));
        let [sine, ramp] = &long.motors[..] else { panic!("{long:?}") };
        assert_eq!((long.measured_s, short.measured_s, ramp.moves), (Some(120.0), None, 0));
        // The pin does not come down where the measuring ends.
        let whole = &short.motors[0];
        assert!((1..3).contains(&(whole.moves - sine.moves)), "{} and {}", whole.moves, sine.moves);
        assert!((sine.from_asked.rms_um / whole.from_asked.rms_um - 1.0).abs() < 0.01, "{sine:?} {whole:?}");
        assert!((long.moves_per_s / sine.moves_per_s - 1.0).abs() < 1e-3, "{long:?}");
        // The fall after years is still told.
        assert_eq!((ramp.highest_um, &ramp.too_slow_s[..]), (200.0, &[[5e7; 2]][..]));
        let line = &long.problems(Array::paper())[1];
        assert!(line.starts_with("motor 9 is too slow for its motion from 50000000.0000 s on: it"), "{line}");
    }
}
