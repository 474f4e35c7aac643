//! Estimates a shaft's position and its motor's gains: a Kalman filter over the bursts played and the telemetry.
//!
//! The burst controller reports each burst with [`Estimator::begin`], compares a sample with [`Estimator::compare`], and
//! applies it with [`Estimator::update`].
//!
//! The state is the position after all past bursts, the mean gains up and down, and the travel of each burst still in the
//! moving average's window. A burst of n pulses enters with the travel `±n·g + ε`: g is the gain of its direction, ε
//! the scatter. A sample is the position plus the share of each travel that the moving average shows. All of this is
//! linear, so for Gaussian scatter the estimate is optimal, also that of the gains, which the filter learns while
//! playing. Without samples the same equations, uncorrected, are dead reckoning. The filter learns the scatter from the
//! residual travel of each burst that leaves the window.
//!
//! Invariant: numbers stay small. A burst merges into the position when the window has passed it, and each variance
//! has a floor, so nothing becomes singular in an hour.

use firmware_protocol::limits::correction;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::motor::{HalfTick, Ramp};
use meissner_array::reflected_walk::Spread;
use meissner_array::spec::MotorSpec;
use meissner_array::strokes::Burst;

/// Bursts in the window at once: those of 300 Hz in a window of up to 6.6 ms, of slower drives in longer ones. Of more, the oldest counts
/// as over, and the motor is played without feedback until it is: see [`Estimator::is_blind`].
const BURSTS: usize = 6;
const STATES: usize = 3 + BURSTS;
/// Indices into the state.
const POSITION: usize = 0;
const GAINS: [usize; 2] = [1, 2];

/// Additional scatter of a transient burst, one standard deviation.
const TRANSIENT_SD: f64 = 0.1;
/// Scatter of bursts until it is learned: the paper's Fig. 2.
const SCATTER: f64 = 0.10;
/// Weight of that initial value, in bursts, and the most bursts that the scatter is averaged over.
const SCATTER_WEIGHT: f64 = 4.0;
const SCATTER_MEMORY: f64 = 150.0;
/// The least scatter assumed: the model's own errors are of that size.
const LEAST_SCATTER: f64 = 0.002;
/// Gain of a motor without calibration, one standard deviation.
const GAIN_SD: f64 = 0.2;
/// Asymmetry of the gains up and down without calibration, one standard deviation.
pub(crate) const ASYMMETRY: f64 = 0.02;
/// Random walk of a gain per burst, one standard deviation: motors warm up.
const GAIN_WANDER: f64 = 2e-4;
/// Variance of a sample, µm²: the quantum of 0.01 µm, plus 0.01 µm for model errors.
const SAMPLE_VARIANCE: f64 = 0.01 * 0.01 / 12.0 + 0.01 * 0.01;
/// Random walk of the position per sample, µm².
const POSITION_WANDER: f64 = 1e-6;
/// Least variance of where a pin lands at the lower stop, µm²: the model's own error.
const LEAST_LANDING: f64 = 0.25;
/// Variance of a position that telemetry has not shown yet, µm².
const NOWHERE: f64 = 500.0 * 500.0;

/// Mean gains of a motor, up and down, and how well they are known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Travel per pulse over [the model's](MotorSpec::um_per_pulse), up and down.
    pub mean: [f64; 2],
    /// One standard deviation of each.
    pub sd: [f64; 2],
    /// Standard deviation of single bursts, relative.
    pub scatter: f64,
}

impl Default for Gains {
    /// A motor without calibration.
    fn default() -> Self {
        Self { mean: [1.0; 2], sd: [GAIN_SD; 2], scatter: SCATTER }
    }
}

impl Gains {
    /// Whether they come from a calibration.
    pub(crate) fn are_calibrated(&self) -> bool {
        *self != Self::default()
    }

    /// How many times as far as ordered the pulses of a play may take a pin, by the model or by these gains, whichever is farther: position
    /// control adds pulses where the gain is low; in open loop a high gain takes the pin farther.
    pub fn reach(&self, open_loop: bool) -> f64 {
        let most = 1.0 + f64::from(correction(1000)) / 1000.0;
        if open_loop { self.mean[0].max(1.0) } else { self.mean[0].recip().clamp(1.0, most) }
    }

    /// How much bursts of these gains differ, on an array of so many motors.
    pub(crate) fn spread(&self, motors: usize) -> Spread {
        if self.are_calibrated() {
            Spread::measured(self.scatter, self.mean, self.sd, motors)
        } else {
            Spread::uncalibrated(self.scatter, ASYMMETRY, motors)
        }
    }
}

/// A burst as telemetry has measured it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredBurst {
    /// Its motor.
    pub motor: u8,
    /// Its first tick.
    pub start: Tick,
    /// Its direction.
    pub direction: Direction,
    /// Its pulses, as corrected.
    pub pulses: u16,
    /// Travel of the shaft, µm; up is positive.
    pub travel_um: f32,
    /// One standard deviation of that, µm.
    pub sd_um: f32,
    /// It came after a rest: a transient, as in the paper's Fig. 2.
    pub rested: bool,
}

/// A burst of one motor, as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Travel {
    pub(crate) burst: Burst,
    /// Travel, µm, up is positive, and its standard deviation.
    pub(super) um: f64,
    pub(super) sd_um: f64,
    /// Travel over what an ideal motor's would be.
    pub(super) gain: f64,
    /// Distance of an ideal motor, µm.
    pub(super) ideal_um: f64,
    /// It came after a rest: a transient.
    pub(super) rested: bool,
    /// The lower stop ended it.
    pub(super) stopped: bool,
}

impl Travel {
    /// As an event of `motor`.
    pub(super) fn of(&self, motor: u8) -> MeasuredBurst {
        let Burst { start, direction, pulses } = self.burst;
        let (travel_um, sd_um) = (self.um as f32, self.sd_um as f32);
        MeasuredBurst { motor, start, direction, pulses, travel_um, sd_um, rested: self.rested }
    }
}

/// A burst in the moving average's window.
#[derive(Clone, Copy, Debug)]
struct WindowedBurst {
    burst: Burst,
    /// A ramp from 0 to 1.
    ramp: Ramp,
    /// Signed travel of an ideal motor, µm, and the mean travel at gain 1 (less after rest).
    ideal: f64,
    mean: f64,
    rested: bool,
    /// The lower stop ends its travel, so it shows nothing of the motor.
    stopped: bool,
    /// At its beginning: the expected travel, the gain's variance, the travel's variance.
    expected: f64,
    gain_variance: f64,
    variance: f64,
}

/// The filter of one motor.
#[derive(Clone, Debug)]
pub(super) struct Estimator {
    motor: MotorSpec,
    mean: [f64; STATES],
    covariance: [[f64; STATES]; STATES],
    window: heapless::Vec<WindowedBurst, BURSTS>,
    scatter: f64,
    evidence: f64,
    last_end: Option<Tick>,
    /// Until then samples show a burst that had to make room.
    blind_until: HalfTick,
}

pub(super) const fn gain_index(direction: Direction) -> usize {
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

/// Mean gain of a burst, relative to the motor's: that of transients if the motor has rested since `last_end`.
pub(super) fn after_rest(motor: &MotorSpec, last_end: Option<Tick>, start: Tick) -> f64 {
    if motor.is_rested(last_end, start) { motor.transient_gain } else { 1.0 }
}

impl Estimator {
    /// Such a motor, at rest at 0, with these gains.
    pub(super) fn new(motor: &MotorSpec, gains: &Gains) -> Self {
        let mut new = Self {
            motor: *motor,
            mean: [0.0; STATES],
            covariance: [[0.0; STATES]; STATES],
            window: heapless::Vec::new(),
            scatter: gains.scatter,
            evidence: SCATTER_WEIGHT,
            last_end: None,
            blind_until: HalfTick(0),
        };
        new.relearn(gains);
        new
    }

    /// Restarts from these gains and forgets the learned ones.
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

    /// The model of the motor.
    pub(super) const fn motor(&self) -> &MotorSpec {
        &self.motor
    }

    fn states(&self) -> usize {
        3 + self.window.len()
    }

    /// Mean gain of a direction.
    pub(super) fn gain(&self, direction: Direction) -> f64 {
        self.mean[GAINS[gain_index(direction)]].clamp(0.4, 2.0)
    }

    /// Standard deviation of single bursts, relative.
    pub(super) fn scatter(&self) -> f64 {
        self.scatter
    }

    /// Weight of the scatter's estimate, in bursts.
    pub(super) fn evidence(&self) -> f64 {
        self.evidence
    }

    /// One standard deviation of the difference of both gains.
    pub(super) fn asymmetry_sd(&self) -> f64 {
        let [up, down] = GAINS;
        let of = &self.covariance;
        (of[up][up] + of[down][down] - 2.0 * of[up][down]).max(0.0).sqrt()
    }

    /// Position after all bursts that have begun, µm.
    pub(super) fn position_um(&self) -> f64 {
        self.mean[POSITION] + self.mean[3..self.states()].iter().sum::<f64>()
    }

    /// A move ends at `tick`.
    pub(super) fn moved(&mut self, tick: Tick) {
        self.last_end = self.last_end.max(Some(tick));
    }

    /// The last burst ended then; `None`: the motor counts as rested.
    pub(super) fn ended(&mut self, last_end: Option<Tick>) {
        self.last_end = last_end;
    }

    /// When the last burst ends that has begun.
    pub(super) fn last_end(&self) -> Option<Tick> {
        self.last_end
    }

    /// Variance of [`Self::position_um`], µm².
    pub(super) fn variance(&self) -> f64 {
        let of = || (0..self.states()).filter(|state| !GAINS.contains(state));
        of().flat_map(|row| of().map(move |column| (row, column)))
            .map(|(row, column)| self.covariance[row][column])
            .sum()
    }

    /// Sets the rest position and its variance, µm and µm².
    pub(super) fn rest_at(&mut self, um: f64, variance: f64) {
        self.window.clear();
        self.blind_until = HalfTick(0);
        self.mean[POSITION] = um;
        for state in 0..STATES {
            self.covariance[POSITION][state] = 0.0;
            self.covariance[state][POSITION] = 0.0;
        }
        self.covariance[POSITION][POSITION] = variance;
    }

    /// Shifts the position by so much, µm, because its past is now known better.
    pub(super) fn shift(&mut self, um: f64) {
        self.mean[POSITION] += um;
    }

    /// The position is unknown: the next sample sets it.
    pub(super) fn lose_position(&mut self) {
        self.covariance[POSITION][POSITION] += NOWHERE;
    }

    /// The device plays this burst of its own, and begins it up to `later` ticks later. Samples until it is over teach nothing.
    pub(super) fn plays_of_its_own(&mut self, burst: &Burst, later: u64) {
        self.lose_position();
        self.blind_until.0 = self.blind_until.0.max(self.settles_at(burst).0 + 2 * later);
    }

    /// Adds a burst, later than all others. Returns the oldest one if it had to make room.
    pub(super) fn begin(&mut self, burst: Burst) -> Option<Travel> {
        let over = if self.window.is_full() {
            self.blind_until.0 = self.blind_until.0.max(self.settles_at(&self.window[0].burst).0);
            Some(self.merge(0))
        } else {
            None
        };
        let rested = self.motor.is_rested(self.last_end, burst.start);
        let rest = if rested { self.motor.transient_gain } else { 1.0 };
        self.last_end = Some(burst.end());
        let ideal = sign(burst.direction) * f64::from(burst.pulses) * self.motor.um_per_pulse;
        let gain = GAINS[gain_index(burst.direction)];
        self.covariance[gain][gain] += GAIN_WANDER * GAIN_WANDER;
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
        let stopped = false;
        let windowed =
            WindowedBurst { burst, ramp, ideal, mean, rested, stopped, expected, gain_variance, variance };
        // Cannot fail: there is room now.
        let _ = self.window.push(windowed);
        over
    }

    /// Adds a down burst that drives the pin against the lower stop, where it lands with this mean, µm, and variance, µm².
    /// Returns the oldest burst if it had to make room.
    pub(super) fn begin_stopped(&mut self, burst: Burst, [mean, variance]: [f64; 2]) -> Option<Travel> {
        let over = self.begin(burst);
        let (new, before) = (self.states() - 1, self.states() - 1);
        // The travel takes back whatever the position was: their sum is where the pin lands.
        let others = || (0..before).filter(|state| !GAINS.contains(state));
        self.mean[new] = mean - others().map(|state| self.mean[state]).sum::<f64>();
        let mut back = [0.0; STATES];
        for (state, back) in back[..before].iter_mut().enumerate() {
            *back = -others().map(|other| self.covariance[other][state]).sum::<f64>();
        }
        let of_position: f64 = others().map(|state| -back[state]).sum();
        for (state, &back) in back[..before].iter().enumerate() {
            (self.covariance[new][state], self.covariance[state][new]) = (back, back);
        }
        self.covariance[new][new] = of_position + variance.max(LEAST_LANDING);
        if let Some(windowed) = self.window.last_mut() {
            windowed.stopped = true;
        }
        over
    }

    /// Whether a burst that the lower stop ends is under way at `tick`, or the moving average still shows its motion. No
    /// signal shows when the pin stops, so such samples fit no ramp.
    pub(super) fn is_stopping(&self, tick: Tick) -> bool {
        let at = HalfTick::from(tick);
        self.window.iter().any(|it| it.stopped && self.settles_at(&it.burst) > at)
    }

    /// Whether a sample at `tick` shows a burst that had to make room for later ones: the motor settles so slowly, and is driven so
    /// fast, that more than [`BURSTS`] are under way. The filter does not explain such a sample.
    pub(super) fn is_blind(&self, tick: Tick) -> bool {
        HalfTick::from(tick) < self.blind_until
    }

    /// From when on the moving average shows nothing of a burst's motion.
    fn settles_at(&self, burst: &Burst) -> HalfTick {
        HalfTick(HalfTick::from(burst.end()).0 + self.motor.window_half_ticks)
    }

    /// Compares a sample, µm, with the prediction.
    pub(super) fn compare(&self, tick: Tick, um: f64) -> Sample {
        let at = HalfTick::from(tick);
        let mut shares = [0.0; BURSTS];
        let mut expected = self.mean[POSITION];
        let mut shown = 0.0;
        for (index, windowed) in self.window.iter().enumerate() {
            let share = windowed.ramp.share_um(at, &self.motor);
            shares[index] = share;
            expected += share * self.mean[3 + index];
            shown += share * windowed.ideal.abs();
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
        Sample { at, innovation_um: um - expected, variance, shown_um: shown, gain }
    }

    /// Updates the state from a sample. Calls `over` with each burst that has left the window.
    pub(super) fn update(&mut self, sample: &Sample, mut over: impl FnMut(Travel)) {
        let states = self.states();
        let weight = sample.variance.recip();
        for row in 0..states {
            let share = sample.gain[row] * weight;
            self.mean[row] += share * sample.innovation_um;
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

    /// Merges bursts that have left the window at `at`, calling `over` with each.
    pub(super) fn forget(&mut self, at: HalfTick, mut over: impl FnMut(Travel)) {
        while let Some(first) = self.window.first()
            && self.settles_at(&first.burst) <= at
        {
            over(self.merge(0));
        }
    }

    /// Merges a burst's travel into the position.
    fn merge(&mut self, index: usize) -> Travel {
        let (states, at) = (self.states(), 3 + index);
        let windowed = self.window.remove(index);
        let (travel, variance) = (self.mean[at], self.covariance[at][at]);
        self.learn(&windowed, travel, variance);
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
            burst: windowed.burst,
            um: travel,
            sd_um: variance.max(0.0).sqrt(),
            gain: travel / windowed.mean,
            ideal_um: windowed.ideal.abs(),
            rested: windowed.rested,
            stopped: windowed.stopped,
        }
    }

    /// Learns the scatter: the share of a burst's innovation that is not the gain's, as far as telemetry shows it.
    fn learn(&mut self, windowed: &WindowedBurst, travel: f64, variance: f64) {
        if windowed.rested || windowed.stopped {
            return;
        }
        let now = self.scatter * self.scatter;
        let own = now / (now + windowed.gain_variance);
        let seen = (1.0 - variance / windowed.variance).clamp(0.0, 1.0);
        // More than the burst's own length is no scatter: a correction that the link has lost looks like that.
        let innovation =
            ((travel - windowed.expected).powi(2) + variance) / (windowed.ideal * windowed.ideal);
        let innovation = innovation.min(1.0);
        let weight = own * seen;
        self.evidence = (self.evidence + weight).min(SCATTER_MEMORY);
        let learned = now + weight / self.evidence * (own * innovation - now);
        self.scatter = learned.max(LEAST_SCATTER * LEAST_SCATTER).sqrt();
    }
}

/// A sample compared with the filter's prediction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    at: HalfTick,
    /// Innovation: measured minus predicted, µm.
    pub(super) innovation_um: f64,
    /// Variance of the innovation, µm².
    pub(super) variance: f64,
    /// Ideal travel of bursts in the window that the sample shows, µm, all positive.
    pub(super) shown_um: f64,
    /// Covariance of the sample with each state.
    gain: [f64; STATES],
}
