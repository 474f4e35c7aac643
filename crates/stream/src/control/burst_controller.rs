//! The loop of one motor: which bursts are on their way, and the count of pulses each is given.
//!
//! A burst is settled shortly before it begins: its count becomes the one that leads from where the shaft is expected
//! to be then, by the [`Estimator`], to where it ought to be after it: the top of the stroke after the up burst, 0
//! after the down burst. Dead beat, so what is known is corrected at once. Where strokes fill their periods, a down burst
//! can be shortened but not lengthened; then the top is lowered until what scatter may add can still be taken back.
//!
//! # Stability
//! Let e_k be the error that burst k adds, and let the error of burst k be known when burst k + N is settled. The
//! estimator knows its own corrections, so each settled count undoes exactly what has become known since the last one:
//! u_k = −(e_{k−N} + δ u_{k−N}), where δ = g/ĝ − 1 is by how much the gain is wrong. So z^N = −δ: N poles of radius
//! |δ|^(1/N), all at 0 if the gain is right, and inside of the unit circle for every gain between none and twice what is
//! believed, whatever the delay. The filter's own poles are 1 − K with K its weight of a sample, in (0, 1). A count that
//! is cut off by a limit does no harm: the estimator is told what was really ordered.
//!
//! The rest error is then the sum of what the last N bursts have added: the bound of any loop with this delay.

use super::estimator::{Estimator, Gains, Travel, after_rest, side, sign};
use super::telemetry_monitor::{Seen, TelemetryMonitor};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::{MAX_DOWN_PULSES, MAX_UP_PULSES, correction};
use firmware_protocol::stroke::{Burst, Direction, Stroke};
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_array::motor::HalfTick;
use meissner_array::units::{TICKS_PER_MS, TICKS_PER_S, UM_PER_PULSE};
use std::collections::VecDeque;

/// A correction leaves when its burst is this near: later is fresher, but it must not come too late.
pub(super) const LATEST: u64 = TICKS_PER_MS * 3 / 2;
/// It is settled when it is this near: a wake-up of 1 ms comes before [`LATEST`], and half of one is to spare.
pub(crate) const DUE: u64 = LATEST + TICKS_PER_MS * 3 / 2;
/// When a correction leaves anyway, those of other motors leave with it that are due within 2 ms: a frame costs as much as
/// three corrections.
pub(crate) const EARLIEST: u64 = DUE + TICKS_PER_MS * 2;
/// Telemetry older than this steers nothing and is not waited for.
pub(crate) const LONGEST_AGE: u64 = TICKS_PER_S * 5 / 4;
/// Strokes of one motor that may begin in [`LONGEST_AGE`], at 300 Hz.
const PAST: usize = 400;
/// Where there is no room to lengthen a burst, the top is lowered by so many standard deviations of a burst's scatter.
const HEADROOM: f64 = 0.5;
/// How far gains up and down may differ by themselves, one standard deviation; for dead reckoning.
const ASYMMETRY: f64 = 0.02;

/// A stroke on its way to the device or in it.
#[derive(Clone, Copy, Debug)]
struct Queued {
    stroke: Stroke,
    /// Counts as planned.
    planned: [u16; 2],
    /// Tenths of its pulses that count in `pending`, once settled.
    counted: [i64; 2],
    accepted: bool,
    steered: bool,
    /// The end of its play: a correction must not cross it.
    until: Tick,
}

impl Queued {
    fn burst(&self, half: usize) -> Burst {
        self.stroke.bursts()[half]
    }
}

/// The loop of one motor.
#[derive(Debug)]
pub(crate) struct BurstController {
    queue: VecDeque<Queued>,
    /// Bursts of `queue`, from its front, that the estimator was told of.
    begun: usize,
    /// Bursts of `queue`, from its front, whose count is settled.
    settled: usize,
    /// Tenths of pulses, up and down, of bursts that are settled and not begun.
    pending: [i64; 2],
    /// When the last settled burst ends.
    settled_end: Option<Tick>,
    gains: Gains,
    estimator: Estimator,
    telemetry_monitor: TelemetryMonitor,
    /// Telemetry has told where the shaft is.
    anchored: bool,
    /// A move was made from where telemetry showed the shaft, µm, and is expected to shift it by so much.
    move_from: Option<(f64, f64)>,
    /// Dead reckoning: variance by scatter, µm², and the sum of amplitudes that asymmetry has worked on, µm.
    scattered: f64,
    reckoned_um: f64,
}

impl BurstController {
    pub(crate) fn new(gains: &Gains) -> Self {
        let nothing = Stroke { motor: 0, up: Tick(0), up_pulses: 0, down: Tick(0), down_pulses: 0 };
        let empty = Queued {
            stroke: nothing,
            planned: [0; 2],
            counted: [0; 2],
            accepted: false,
            steered: false,
            until: Tick(0),
        };
        let mut queue = VecDeque::with_capacity(POOL + PAST);
        // Touched once: memory is locked page by page, and the first touch must not fall into a play.
        queue.resize(queue.capacity(), empty);
        queue.clear();
        Self {
            queue,
            begun: 0,
            settled: 0,
            pending: [0; 2],
            settled_end: None,
            gains: *gains,
            estimator: Estimator::new(gains),
            telemetry_monitor: TelemetryMonitor::default(),
            anchored: false,
            move_from: None,
            scattered: 0.0,
            reckoned_um: 0.0,
        }
    }

    /// A stroke of a play that ends at `until` was sent. Strokes come in order.
    pub(crate) fn sent(&mut self, stroke: &Stroke, steered: bool, until: Tick) {
        // Without telemetry the past is forgotten here: the queue is as bounded as the device's pool.
        if self.queue.len() == self.queue.capacity()
            && let Some(first) = self.queue.front()
        {
            self.follow(first.stroke.end() + 1, true, |_| (), |_| ());
        }
        let planned = [stroke.up_pulses, stroke.down_pulses];
        let (counted, accepted) = ([0; 2], false);
        self.queue.push_back(Queued { stroke: *stroke, planned, counted, accepted, steered, until });
    }

    fn find(&self, up: Tick) -> Option<usize> {
        self.queue.binary_search_by_key(&up, |queued| queued.stroke.up).ok()
    }

    /// The device has it.
    pub(crate) fn accepted(&mut self, up: Tick) {
        if let Some(at) = self.find(up) {
            self.queue[at].accepted = true;
        }
    }

    /// The device will not play it.
    pub(crate) fn withdrawn(&mut self, up: Tick) {
        let Some(at) = self.find(up) else { return };
        if self.begun > 2 * at {
            // The estimator took it for played: telemetry must tell anew where the shaft is.
            self.queue[at].steered = false;
            self.estimator.lose_position();
            return;
        }
        self.remove(at);
    }

    /// Takes a stroke out that the estimator was not told of.
    fn remove(&mut self, at: usize) {
        let settled = self.settled.saturating_sub(2 * at).min(2);
        for half in 0..settled {
            self.pending[half] -= self.queue[at].counted[half];
        }
        self.settled -= settled;
        self.queue.remove(at);
    }

    /// Nothing sent with an up tick from `onset` on was taken.
    pub(crate) fn withdraw_from(&mut self, onset: Tick) {
        while let Some(up) = self.queue.back().map(|last| last.stroke.up).filter(|&up| up >= onset) {
            let before = self.queue.len();
            self.withdrawn(up);
            if self.queue.len() == before {
                break;
            }
        }
    }

    /// What was queued is flushed, and the pin is being returned.
    pub(crate) fn cut(&mut self) {
        let rest_um = self.rest_um();
        // A stroke that was cut has scattered like any other.
        let unsure = self
            .queue
            .front()
            .map_or(0.0, |first| self.estimator.scatter() * f64::from(first.planned[0]) * UM_PER_PULSE);
        self.queue.clear();
        (self.begun, self.settled, self.pending) = (0, 0, [0; 2]);
        self.estimator.rest_at(rest_um, self.estimator.variance() + 2.0 * unsure * unsure);
        self.scattered += 2.0 * unsure * unsure;
        (self.anchored, self.move_from) = (false, None);
    }

    /// A person says that the pin is at rest.
    pub(crate) fn assume_rest(&mut self) {
        self.estimator.rest_at(0.0, 1.0);
        (self.scattered, self.reckoned_um) = (0.0, 0.0);
    }

    /// Telemetry is believed again; what was learned from it before is not.
    pub(crate) fn clear_faults(&mut self) {
        if self.telemetry_monitor.lost().is_some() {
            self.estimator.relearn(&self.gains);
        }
        self.telemetry_monitor = TelemetryMonitor::default();
    }

    /// The motor has been calibrated.
    pub(crate) fn calibrate(&mut self, gains: &Gains) {
        self.gains = *gains;
        self.estimator.relearn(gains);
    }

    /// A move, between plays, shifts where the pin rests.
    pub(crate) fn moved(&mut self, direction: Direction, pulses: u16) {
        let um = f64::from(pulses) * UM_PER_PULSE * self.estimator.gain(direction);
        let (shift, scatter) = (sign(direction) * um, self.estimator.scatter() * um);
        let before = self.estimator.position_um();
        self.move_from = self.anchored.then_some((before, shift));
        self.estimator.rest_at(before + shift, self.estimator.variance() + scatter * scatter);
        self.scattered += scatter * scatter;
        self.anchored = false;
    }

    /// Mean gain of a direction.
    pub(crate) fn gain(&self, direction: Direction) -> f64 {
        self.estimator.gain(direction)
    }

    /// Whether its gains were measured.
    pub(crate) fn is_calibrated(&self) -> bool {
        self.gains != Gains::default()
    }

    /// Whether telemetry has told where it is, and can be believed.
    pub(crate) fn is_measured(&self) -> bool {
        self.anchored && self.telemetry_monitor.lost().is_none()
    }

    /// Why its telemetry is not believed.
    pub(crate) fn fault(&self) -> Option<SensorFault> {
        self.telemetry_monitor.lost()
    }

    /// Strokes that are in the device.
    pub(crate) fn in_device(&self) -> impl Iterator<Item = Stroke> {
        self.queue.iter().filter(|queued| queued.accepted).map(|queued| queued.stroke)
    }

    /// Settles a burst with the count it has.
    fn settle(&mut self) {
        let (at, half) = (self.settled / 2, self.settled % 2);
        let burst = self.queue[at].burst(half);
        let tenths = if after_rest(self.settled_end, burst.start) < 1.0 { 8 } else { 10 };
        let counted = i64::from(burst.pulses) * tenths;
        self.queue[at].counted[half] = counted;
        self.pending[half] += counted;
        self.settled_end = Some(burst.end());
        self.settled += 1;
    }

    /// Time has passed to `tick`: bursts that have begun are taken for played, strokes that are over are forgotten. Strokes that
    /// the device has not answered for yet may be played or not: there it stops and says so, or gives them up.
    pub(crate) fn follow(
        &mut self,
        tick: Tick,
        give_up: bool,
        mut over: impl FnMut(Travel),
        mut gone: impl FnMut(&Stroke),
    ) -> bool {
        let mut known = true;
        while let Some(next) = self.queue.get(self.begun / 2).copied() {
            let half = self.begun % 2;
            let burst = next.burst(half);
            if burst.start >= tick {
                break;
            }
            if !next.accepted && half == 0 {
                if !give_up {
                    known = false;
                    break;
                }
                self.remove(self.begun / 2);
                continue;
            }
            if self.settled == self.begun {
                self.settle();
            }
            self.pending[half] -= self.queue[self.begun / 2].counted[half];
            self.estimator.forget(HalfTick::from(burst.start), &mut over);
            if let Some(travel) = self.estimator.begin(burst) {
                over(travel);
            }
            self.begun += 1;
            if half == 1 {
                let um = f64::from(next.planned[0]) * UM_PER_PULSE;
                self.scattered += 2.0 * (self.estimator.scatter() * um).powi(2);
                self.reckoned_um += um;
            }
        }
        while self.begun >= 2
            && let Some(first) = self.queue.front().filter(|first| first.stroke.end() <= tick)
        {
            gone(&first.stroke);
            self.queue.pop_front();
            self.begun -= 2;
            self.settled -= 2;
        }
        known
    }

    /// Takes a sample of the displacement, µm; bursts before it have been followed.
    pub(crate) fn telemetry(&mut self, tick: Tick, um: f64, mut over: impl FnMut(Travel)) {
        if self.telemetry_monitor.lost().is_some() {
            return;
        }
        if !self.anchored {
            if let Some((from, expected)) = self.move_from.take() {
                self.telemetry_monitor.moved(um - from, expected);
            }
            self.estimator.lose_position();
            self.anchored = true;
        }
        let mut sample = self.estimator.compare(tick, um);
        match self.telemetry_monitor.sample(tick, &sample) {
            Seen::Odd => return,
            Seen::Moved => {
                self.estimator.lose_position();
                sample = self.estimator.compare(tick, um);
            }
            Seen::Good => {}
        }
        let (telemetry_monitor, gains) = (&mut self.telemetry_monitor, &self.gains);
        let mut travels = heapless::Vec::<Travel, 8>::new();
        self.estimator.update(&sample, |travel| {
            let _ = travels.push(travel);
        });
        for travel in travels {
            telemetry_monitor.travel(&travel, gains.mean[side(travel.burst.direction)], &self.estimator);
            over(travel);
        }
        (self.scattered, self.reckoned_um) = (0.0, 0.0);
        if self.telemetry_monitor.lost().is_some() {
            // What it has taught is not to be kept.
            self.estimator.relearn(&self.gains);
        }
    }

    /// Where the shaft is expected to be after all bursts that are settled, µm.
    fn position_um(&self) -> f64 {
        let pending = |direction| {
            let tenths = self.pending[side(direction)] as f64;
            sign(direction) * tenths / 10.0 * UM_PER_PULSE * self.estimator.gain(direction)
        };
        self.estimator.position_um() + pending(Direction::Up) + pending(Direction::Down)
    }

    /// Where it is expected to rest, µm: without an up burst whose down burst is not settled.
    pub(crate) fn rest_um(&self) -> f64 {
        let half = if self.settled % 2 == 1 {
            let up = self.queue[self.settled / 2].counted[0] as f64 / 10.0;
            up * UM_PER_PULSE * self.estimator.gain(Direction::Up)
        } else {
            0.0
        };
        self.position_um() - half
    }

    /// Error of the rest position by dead reckoning, one standard deviation, µm.
    pub(crate) fn reckoned_um(&self) -> f64 {
        let drift = ASYMMETRY.min(self.estimator.asymmetry_sd()) * self.reckoned_um;
        (self.scattered + drift * drift).sqrt()
    }

    /// The count that leads the next burst to be settled to where the plan wants the shaft; and if that is at a limit, by how far it
    /// corrects the shaft, µm. No stroke that is not queued begins before `free`; bursts may get longer than planned if `longer`.
    fn wanted(&self, free: impl Fn() -> Tick, longer: bool) -> (u16, Option<f64>) {
        let (at, half) = (self.settled / 2, self.settled % 2);
        let Queued { stroke, planned, until, .. } = self.queue[at];
        let next = self.queue.get(at + 1).map_or_else(free, |next| next.stroke.up).min(until);
        let most = |half: usize, room: u64, limit: u16| {
            let more = if longer { correction(planned[half]) } else { 0 };
            let most = planned[half].saturating_add(more).min(limit);
            most.min(u16::try_from(room).unwrap_or(u16::MAX))
        };
        let up_most = most(0, stroke.down - stroke.up, MAX_UP_PULSES);
        let down_most = most(1, next - stroke.down, MAX_DOWN_PULSES).max(planned[1]);
        let burst = stroke.bursts()[half];
        let gain = self.estimator.gain(burst.direction) * after_rest(self.settled_end, burst.start);
        let position = self.position_um() / UM_PER_PULSE;
        let (way, most) = match burst.direction {
            Direction::Up => {
                let down = f64::from(down_most) * self.estimator.gain(Direction::Down);
                let top = down / (1.0 + HEADROOM * self.estimator.scatter());
                (top.min(planned[0].into()) - position, up_most)
            }
            Direction::Down => (position, down_most),
        };
        let least = planned[half].saturating_sub(correction(planned[half])).max(1);
        let ideal = (way / gain).round().clamp(0.0, 65_535.0) as u16;
        let count = ideal.min(most).max(least);
        let more = f64::from(count) - f64::from(planned[half]);
        (count, (count != ideal).then_some(sign(burst.direction) * more * gain * UM_PER_PULSE))
    }

    /// When the next burst begins whose count is not settled.
    pub(crate) fn next(&self) -> Option<Tick> {
        self.queue.get(self.settled / 2).map(|queued| queued.burst(self.settled % 2).start)
    }

    /// Settles the counts of bursts that are due, or at least of one that begins within [`EARLIEST`], telling those that
    /// change: the stroke's up tick, the direction, the count. `amend` says whether it could be told. No stroke that is not queued begins before `free`. `fresh`:
    /// telemetry is not too old to go by. `longer`: bursts may get longer than planned.
    pub(crate) fn correct(
        &mut self,
        now: Tick,
        free: impl Fn() -> Tick,
        fresh: bool,
        longer: bool,
        mut amend: impl FnMut(Tick, Direction, u16) -> bool,
    ) {
        let mut within = EARLIEST;
        while let Some(queued) = self.queue.get(self.settled / 2).copied() {
            let half = self.settled % 2;
            let burst = queued.burst(half);
            if burst.start > now + within {
                break;
            }
            within = DUE;
            let measured = fresh && self.anchored && self.telemetry_monitor.steers(now);
            // Gains that were measured lead home without telemetry too, apart from the scatter.
            let reckoned = !fresh && self.is_calibrated() && self.telemetry_monitor.lost().is_none();
            if (measured || reckoned) && queued.steered && queued.accepted && burst.start >= now + LATEST {
                let (pulses, limited) = self.wanted(&free, longer);
                self.telemetry_monitor.limit(limited, self.rest_um());
                if pulses != burst.pulses && amend(queued.stroke.up, burst.direction, pulses) {
                    let stroke = &mut self.queue[self.settled / 2].stroke;
                    match burst.direction {
                        Direction::Up => stroke.up_pulses = pulses,
                        Direction::Down => stroke.down_pulses = pulses,
                    }
                }
            }
            self.settle();
        }
    }
}
