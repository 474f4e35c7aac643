//! Where a shaft is, and what its pulses do: a Kalman filter over the bursts played and the telemetry of one motor.
//!
//! The state is the position of all bursts that are over, the mean gains up and down, and the travel of each
//! burst that the moving average still holds a part of. A burst of n pulses enters with the travel `±n·g + ε`,
//! g the gain of its direction, and ε the scatter of bursts; a sample of the displacement is the position plus each
//! travel times the share of it that the moving average shows. All of that is linear, so for Gaussian scatter the
//! estimate is the best there is, also of the gains, which are learned by it while playing. Bursts that no sample
//! was seen of are dead reckoning: the same equations without the correction.
//!
//! The scatter itself is learned from what is left of each travel when its burst is over.
//!
//! Numbers stay small: positions are µm, a burst goes into the position and is forgotten when the window has
//! passed it, and each variance has a floor, so an hour in nothing has become singular.

use crate::queues::MeasuredBurst;
use firmware_protocol::stroke::{Burst, Direction};
use firmware_protocol::tick::Tick;
use meissner_array::motor::{HalfTick, Ramp, TRANSIENT_GAIN, TRANSIENT_REST_TICKS, WINDOW_HALF_TICKS};
use meissner_array::units::UM_PER_PULSE;

/// Bursts under the window at once: at 300 Hz five. With more, the oldest counts as over.
const BURSTS: usize = 6;
const STATES: usize = 3 + BURSTS;
/// Indices into the state.
const POSITION: usize = 0;
const GAINS: [usize; 2] = [1, 2];

/// How little is known of a transient burst, besides its mean gain.
const TRANSIENT_SD: f64 = 0.1;
/// What is taken for the scatter of bursts until it is learned: the paper's Fig. 2.
const SCATTER: f64 = 0.10;
/// In how many bursts' worth of evidence that is believed; and how many it is learned from at the most.
const SCATTER_WEIGHT: f64 = 4.0;
const SCATTER_MEMORY: f64 = 150.0;
/// Scatter is never taken to be less: what no model holds is of that size.
const LEAST_SCATTER: f64 = 0.002;
/// What a motor's gains may be without calibration, one standard deviation.
const GAIN_SD: f64 = 0.2;
/// By so much a gain wanders from burst to burst, one standard deviation: motors warm up.
const GAIN_WANDER: f64 = 2e-4;
/// Variance of a sample, µm²: the quantum of 0.01 µm, and 0.01 µm for what the model leaves out.
const SAMPLE_VARIANCE: f64 = 0.01 * 0.01 / 12.0 + 0.01 * 0.01;
/// By so much a position wanders from sample to sample, µm².
const POSITION_WANDER: f64 = 1e-6;
/// What is known of a position that telemetry has not told yet, µm².
const NOWHERE: f64 = 500.0 * 500.0;

/// Mean gains of a motor, up and down, and how well they are known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Travel per pulse over [`UM_PER_PULSE`], up and down.
    pub mean: [f64; 2],
    /// One standard deviation of each.
    pub sd: [f64; 2],
    /// Standard deviation of single bursts, relative.
    pub scatter: f64,
}

impl Default for Gains {
    /// A motor nobody has measured.
    fn default() -> Self {
        Self { mean: [1.0; 2], sd: [GAIN_SD; 2], scatter: SCATTER }
    }
}

/// What a burst came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Travel {
    pub(crate) burst: Burst,
    /// Travel, µm, up is positive, and its standard deviation.
    pub(super) um: f64,
    pub(super) sd_um: f64,
    /// Travel over what an ideal motor's would be.
    pub(super) gain: f64,
    /// It came after half a second of rest.
    pub(super) rested: bool,
}

impl Travel {
    /// As it is told, of which motor.
    pub(super) fn of(&self, motor: u8) -> MeasuredBurst {
        let Burst { start, direction, pulses } = self.burst;
        let (travel_um, sd_um) = (self.um as f32, self.sd_um as f32);
        MeasuredBurst { motor, start, direction, pulses, travel_um, sd_um, rested: self.rested }
    }

    /// Distance an ideal motor would go, µm.
    pub(super) fn um_ideal(&self) -> f64 {
        f64::from(self.burst.pulses) * UM_PER_PULSE
    }
}

/// A burst that the window holds.
#[derive(Clone, Copy, Debug)]
struct Moving {
    burst: Burst,
    /// A ramp from 0 to 1.
    ramp: Ramp,
    /// Signed travel of an ideal motor, µm, and what a gain of 1 is expected to make of it.
    ideal: f64,
    mean: f64,
    rested: bool,
    /// The travel expected when it began, the gain's variance then, and the travel's.
    expected: f64,
    gain_variance: f64,
    variance: f64,
}

/// The filter of one motor.
#[derive(Clone, Debug)]
pub(super) struct Estimator {
    mean: [f64; STATES],
    covariance: [[f64; STATES]; STATES],
    moving: heapless::Vec<Moving, BURSTS>,
    scatter: f64,
    evidence: f64,
    last_end: Option<Tick>,
}

pub(super) const fn side(direction: Direction) -> usize {
    match direction {
        Direction::Up => 0,
        Direction::Down => 1,
    }
}

pub(super) const fn sign(direction: Direction) -> f64 {
    match direction {
        Direction::Up => 1.0,
        Direction::Down => -1.0,
    }
}

/// The mean gain of a burst that begins so long after the one before, over the motor's.
pub(super) fn after_rest(last_end: Option<Tick>, start: Tick) -> f64 {
    if last_end.is_none_or(|end| start - end >= TRANSIENT_REST_TICKS) { TRANSIENT_GAIN } else { 1.0 }
}

impl Estimator {
    /// A motor at rest at 0 whose gains are known so well.
    pub(super) fn new(gains: &Gains) -> Self {
        let mut new = Self {
            mean: [0.0; STATES],
            covariance: [[0.0; STATES]; STATES],
            moving: heapless::Vec::new(),
            scatter: gains.scatter,
            evidence: SCATTER_WEIGHT,
            last_end: None,
        };
        new.relearn(gains);
        new
    }

    /// The gains are known so well from now on; what was learned of them is forgotten.
    pub(super) fn relearn(&mut self, gains: &Gains) {
        for ((at, mean), sd) in GAINS.into_iter().zip(gains.mean).zip(gains.sd) {
            self.mean[at] = mean;
            for state in 0..STATES {
                (self.covariance[at][state], self.covariance[state][at]) = (0.0, 0.0);
            }
            self.covariance[at][at] = sd * sd;
        }
        (self.scatter, self.evidence) = (gains.scatter, SCATTER_WEIGHT);
    }

    fn states(&self) -> usize {
        3 + self.moving.len()
    }

    /// Mean gain of a direction.
    pub(super) fn gain(&self, direction: Direction) -> f64 {
        self.mean[GAINS[side(direction)]].clamp(0.4, 2.0)
    }

    /// Standard deviation of single bursts, relative.
    pub(super) fn scatter(&self) -> f64 {
        self.scatter
    }

    /// In how many bursts' worth of evidence the scatter is believed.
    pub(super) fn evidence(&self) -> f64 {
        self.evidence
    }

    /// How well the difference of both gains is known, one standard deviation.
    pub(super) fn asymmetry_sd(&self) -> f64 {
        let [up, down] = GAINS;
        let of = &self.covariance;
        (of[up][up] + of[down][down] - 2.0 * of[up][down]).max(0.0).sqrt()
    }

    /// Where the shaft comes to after all bursts that have begun, µm.
    pub(super) fn position_um(&self) -> f64 {
        self.mean[POSITION] + self.mean[3..self.states()].iter().sum::<f64>()
    }

    /// Variance of [`Self::position_um`], µm².
    pub(super) fn variance(&self) -> f64 {
        let of = || (0..self.states()).filter(|state| !GAINS.contains(state));
        of().flat_map(|row| of().map(move |column| (row, column)))
            .map(|(row, column)| self.covariance[row][column])
            .sum()
    }

    /// The shaft rests at `um`, and that is known so well.
    pub(super) fn rest_at(&mut self, um: f64, variance: f64) {
        self.moving.clear();
        self.mean[POSITION] = um;
        for state in 0..STATES {
            self.covariance[POSITION][state] = 0.0;
            self.covariance[state][POSITION] = 0.0;
        }
        self.covariance[POSITION][POSITION] = variance;
    }

    /// Where the shaft is, nobody knows: the next sample will tell.
    pub(super) fn lose_position(&mut self) {
        self.covariance[POSITION][POSITION] += NOWHERE;
    }

    /// A burst begins, after all others. Tells of the one it makes room for, if it must.
    pub(super) fn begin(&mut self, burst: Burst) -> Option<Travel> {
        let over = if self.moving.is_full() { Some(self.merge(0)) } else { None };
        let rest = after_rest(self.last_end, burst.start);
        self.last_end = Some(burst.end());
        let ideal = sign(burst.direction) * f64::from(burst.pulses) * UM_PER_PULSE;
        let gain = GAINS[side(burst.direction)];
        self.covariance[gain][gain] += GAIN_WANDER * GAIN_WANDER;
        let rested = rest < 1.0;
        let noise = self.scatter * self.scatter + if rested { TRANSIENT_SD * TRANSIENT_SD } else { 0.0 };
        let (new, mean) = (self.states(), ideal * rest);
        self.mean[new] = mean * self.mean[gain];
        for state in 0..new {
            let covariance = mean * self.covariance[gain][state];
            self.covariance[new][state] = covariance;
            self.covariance[state][new] = covariance;
        }
        let gain_variance = self.covariance[gain][gain];
        let variance = mean * mean * gain_variance + ideal * ideal * noise;
        self.covariance[new][new] = variance;
        let ramp = Ramp {
            start: burst.start,
            ticks: burst.pulses.into(),
            um_per_tick: f64::from(burst.pulses).recip(),
        };
        let expected = self.mean[new];
        let moving = Moving { burst, ramp, ideal, mean, rested, expected, gain_variance, variance };
        // There is room: it was made above.
        let _ = self.moving.push(moving);
        over
    }

    /// By how much a sample differs from what is expected, µm; how far it may by the filter's own lights, one standard
    /// deviation; and the travel under way that it shows, µm.
    pub(super) fn compare(&self, tick: Tick, um: f64) -> Sample {
        let at = HalfTick::from(tick);
        let mut shares = [0.0; BURSTS];
        let mut expected = self.mean[POSITION];
        let mut shown = 0.0;
        for (index, moving) in self.moving.iter().enumerate() {
            let share = moving.ramp.share_um(at);
            shares[index] = share;
            expected += share * self.mean[3 + index];
            shown += share * moving.ideal.abs();
        }
        let states = self.states();
        let mut gain = [0.0; STATES];
        for (state, gain) in gain[..states].iter_mut().enumerate() {
            let row = &self.covariance[state];
            *gain =
                shares.iter().zip(&row[3..states]).fold(row[POSITION], |sum, (share, of)| sum + share * of);
        }
        let moved = shares.iter().zip(&gain[3..states]).map(|(share, of)| share * of).sum::<f64>();
        let variance = gain[POSITION] + moved + SAMPLE_VARIANCE + POSITION_WANDER;
        Sample { at, surprise_um: um - expected, variance, shown_um: shown, gain }
    }

    /// Takes a sample in. Tells of bursts that are over.
    pub(super) fn update(&mut self, sample: &Sample, mut over: impl FnMut(Travel)) {
        let states = self.states();
        let weight = sample.variance.recip();
        for row in 0..states {
            let share = sample.gain[row] * weight;
            self.mean[row] += share * sample.surprise_um;
            for column in 0..=row {
                let less = self.covariance[row][column] - share * sample.gain[column];
                self.covariance[row][column] = less;
                self.covariance[column][row] = less;
            }
        }
        for state in 0..states {
            let floor = if GAINS.contains(&state) { 1e-10 } else { 1e-8 };
            self.covariance[state][state] = self.covariance[state][state].max(floor);
        }
        self.covariance[POSITION][POSITION] += POSITION_WANDER;
        self.forget(sample.at, &mut over);
    }

    /// Time has passed to `at`: bursts that the window has passed are over.
    pub(super) fn forget(&mut self, at: HalfTick, mut over: impl FnMut(Travel)) {
        while let Some(first) = self.moving.first()
            && HalfTick::from(first.burst.end()).0 + WINDOW_HALF_TICKS <= at.0
        {
            over(self.merge(0));
        }
    }

    /// A burst's travel becomes part of the position.
    fn merge(&mut self, index: usize) -> Travel {
        let (states, at) = (self.states(), 3 + index);
        let moving = self.moving.remove(index);
        let (travel, variance) = (self.mean[at], self.covariance[at][at]);
        self.learn(&moving, travel, variance);
        self.mean[POSITION] += travel;
        for state in 0..states {
            self.covariance[POSITION][state] += self.covariance[at][state];
        }
        for state in 0..states {
            self.covariance[state][POSITION] += self.covariance[state][at];
        }
        self.mean.copy_within(at + 1..states, at);
        for row in &mut self.covariance[..states] {
            row.copy_within(at + 1..states, at);
        }
        self.covariance.copy_within(at + 1..states, at);
        Travel {
            burst: moving.burst,
            um: travel,
            sd_um: variance.max(0.0).sqrt(),
            gain: travel / moving.mean,
            rested: moving.rested,
        }
    }

    /// Learns the scatter: the share of a burst's surprise that is not the gain's, as far as telemetry has seen it.
    fn learn(&mut self, moving: &Moving, travel: f64, variance: f64) {
        if moving.rested {
            return;
        }
        let now = self.scatter * self.scatter;
        let own = now / (now + moving.gain_variance);
        let seen = (1.0 - variance / moving.variance).clamp(0.0, 1.0);
        // Beyond its own length it is no scatter: a correction that the line has lost looks so.
        let surprise = ((travel - moving.expected).powi(2) + variance) / (moving.ideal * moving.ideal);
        let surprise = surprise.min(1.0);
        let weight = own * seen;
        self.evidence = (self.evidence + weight).min(SCATTER_MEMORY);
        let learned = now + weight / self.evidence * (own * surprise - now);
        self.scatter = learned.max(LEAST_SCATTER * LEAST_SCATTER).sqrt();
    }
}

/// A sample compared with what the filter expects.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    at: HalfTick,
    /// Measured less expected, µm.
    pub(super) surprise_um: f64,
    /// What the square of it is on the mean, µm².
    pub(super) variance: f64,
    /// Ideal travel of bursts under the window that it shows, µm, all counted positive.
    pub(super) shown_um: f64,
    /// Covariance of the sample with each state.
    gain: [f64; STATES],
}
