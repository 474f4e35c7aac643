//! Where the pin rests: what cuts, moves, gains and the operator change, and how far off it may be without telemetry.
//!
//! Invariant: with a lower stop no pin is taken for lower than rest.

use super::reckoned::Reckoned;
use super::{BurstController, Passed};
use crate::control::estimator::{ASYMMETRY, Gains, after_rest, gain_index, sign};
use crate::control::queued::Queued;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::reflected_walk::{Bursts, ReflectedWalk, Spread};
use meissner_array::strokes::Burst;

impl BurstController {
    /// The device has flushed the queue at `tick` and returns the pin.
    pub(crate) fn cut(&mut self, tick: Tick) {
        let rest_um = self.cut_rest_um(tick);
        let begun = self.queue.iter().rev().find(|queued| queued.burst.start < tick);
        if let Some(end) = begun.map(|last| last.burst.end().min(tick)) {
            self.estimator.moved(end);
        }
        // What is cut scatters like any other excursion.
        let um_per_pulse = self.um_per_pulse();
        let highest = self.queue.front().map_or(0, |first| first.level).max(self.trail.level());
        let unsure = self.estimator.scatter() * f64::from(highest) * um_per_pulse;
        // A bad line may have lost the corrections of bursts that no sample has shown.
        let unseen = self.queue.iter().skip(self.begun).take_while(|queued| queued.burst.start < tick);
        let corrections =
            unseen.map(|Queued { burst, planned, .. }| f64::from(burst.pulses.abs_diff(*planned)));
        let corrected = corrections.map(|pulses| (pulses * um_per_pulse).powi(2)).sum::<f64>();
        let variance = 2.0 * unsure * unsure + corrected;
        let begun = self.queue.drain(..).take_while(|queued| queued.burst.start < tick);
        for Queued { burst, level, .. } in begun.filter(|queued| queued.accepted) {
            self.trail.passed(Passed { burst, from: self.trail.level(), to: level });
        }
        self.trail.cut(tick);
        (self.begun, self.finalised, self.pending) = (0, 0, [0; 2]);
        self.bursts = Bursts::default();
        if let Some([mean, variance]) = self.landing {
            // The return ends at the stop, too.
            self.estimator.rest_at(mean, variance);
        } else {
            self.estimator.rest_at(rest_um, self.estimator.variance() + variance);
            self.reckoned.scatter(variance);
        }
        (self.anchored, self.move_from) = (false, None);
    }

    /// Expected rest position if the queue is cut at `tick`, µm: of the burst under way counts what was played.
    fn cut_rest_um(&self, tick: Tick) -> f64 {
        let position = self.estimator.position_um();
        let Some(last) = self.begun.checked_sub(1).map(|last| self.queue[last]) else {
            return position - f64::from(self.trail.level()) * self.um_per_pulse();
        };
        let Queued { burst: Burst { direction, pulses, .. }, counted, .. } = last;
        let left = ((last.burst.end() - tick) as f64 / f64::from(pulses.max(1))).min(1.0);
        let unplayed = sign(direction) * left * counted as f64 / 10.0 * self.estimator.gain(direction);
        position - (unplayed + f64::from(last.level_at(tick))) * self.um_per_pulse()
    }

    /// The device has brought the pin down by so many pulses of its height, in one burst until `tick`: not by the whole height, if its
    /// gain is low or it has rested. A lower stop brings it to rest all the same.
    fn came_down(&mut self, pulses: u16, tick: Tick) {
        if pulses == 0 || self.has_lower_stop() {
            return;
        }
        let ideal_um = f64::from(pulses) * self.um_per_pulse();
        let rest = self.return_rest(pulses, tick);
        self.estimator.shift(ideal_um * (1.0 - rest * self.estimator.gain(Direction::Down)));
        self.reckoned.travel(Direction::Down, rest * ideal_um);
        self.estimator.moved(tick);
    }

    /// How far above its rest a return by so many pulses, until `tick`, leaves the pin, µm. A lower stop takes that.
    pub(crate) fn short_um(&self, pulses: u16, tick: Tick) -> f64 {
        let ideal_um = f64::from(pulses) * self.um_per_pulse();
        let gain = self.return_rest(pulses, tick) * self.estimator.gain(Direction::Down);
        if self.has_lower_stop() { 0.0 } else { ideal_um * (1.0 - gain) }
    }

    /// Mean gain, relative to the motor's, of a return by so many pulses until `tick`.
    fn return_rest(&self, pulses: u16, tick: Tick) -> f64 {
        let start = Tick(tick.0.saturating_sub(pulses.into()));
        after_rest(self.estimator.motor(), self.estimator.last_end(), start)
    }

    /// The pin is at rest at `tick`, after a cut: it has come down by so many pulses.
    pub(crate) fn returned(&mut self, pulses: u16, tick: Tick) {
        self.came_down(pulses, tick);
        self.last_cut.returned(tick);
    }

    /// The pin stands so many pulses lower than known so far, at `tick`. If it had rested, its height was known, and this is a part of a
    /// return; otherwise it may have been a bound. `goes_on`: the rest of the return follows at once.
    pub(crate) fn lowered(&mut self, pulses: u16, tick: Tick, goes_on: bool) {
        if self.return_rest(pulses, tick) < 1.0 {
            let last_end = self.estimator.last_end();
            self.came_down(pulses, tick);
            if goes_on {
                self.estimator.ended(last_end);
            }
        }
    }

    /// The operator says that the pin is at rest.
    pub(crate) fn assume_rest(&mut self) {
        self.estimator.rest_at(0.0, 1.0);
        self.landing = self.landing.map(|_| [0.0; 2]);
        self.reckoned = Reckoned::default();
    }

    /// The pin may be anywhere up to `um` from rest, one standard deviation.
    pub(crate) fn lose_rest(&mut self, um: f64) {
        self.estimator.rest_at(0.0, um * um);
        self.landing = self.landing.map(|_| [0.0, um * um]);
        self.reckoned = Reckoned::default();
        self.reckoned.scatter(um * um);
    }

    /// The pin stands so many pulses above rest, and counts as at rest from here on.
    pub(crate) fn stay_up(&mut self, pulses: u16) {
        if pulses == 0 {
            return;
        }
        let um = f64::from(pulses) * self.um_per_pulse();
        let (up, unsure) = (self.rest_um() + um, (self.estimator.scatter() * um).powi(2));
        self.estimator.rest_at(up, self.estimator.variance() + unsure);
        self.landing = self.landing.map(|[mean, variance]| [mean + um, variance]);
        self.reckoned.scatter(unsure);
    }

    /// Uses the gains of a calibration, also for what was reckoned so far: the offset that they explain is known from now on, and
    /// less is uncertain. The estimated scatter of past bursts stays.
    pub(crate) fn set_gains(&mut self, gains: &Gains) {
        let before = [Direction::Up, Direction::Down].map(|direction| self.estimator.gain(direction));
        self.gains = *gains;
        self.estimator.relearn(gains);
        let explained = [Direction::Up, Direction::Down].into_iter().zip(before).zip(self.reckoned.um());
        let explained = explained.map(|((direction, before), um)| {
            sign(direction) * (self.estimator.gain(direction) - before) * um
        });
        self.estimator.shift(explained.sum());
    }

    /// Travel per pulse of the ideal motor, µm.
    pub(super) const fn um_per_pulse(&self) -> f64 {
        self.estimator.motor().um_per_pulse
    }

    /// Mean gain of a move that begins at `start`: that of transients after a rest.
    pub(crate) fn move_gain(&self, direction: Direction, start: Tick) -> f64 {
        self.estimator.gain(direction) * after_rest(self.estimator.motor(), self.estimator.last_end(), start)
    }

    /// A move between plays, which begins at `start`, shifts the rest position: down to a lower stop and no further.
    pub(crate) fn moved(&mut self, direction: Direction, pulses: u16, start: Tick) {
        let rest = after_rest(self.estimator.motor(), self.estimator.last_end(), start);
        let um = f64::from(pulses) * self.um_per_pulse() * self.move_gain(direction, start);
        self.estimator.moved(start + u64::from(pulses));
        let (shift, scatter) = (sign(direction) * um, self.estimator.scatter() * um);
        let before = self.estimator.position_um();
        let (mut after, variance) = (before + shift, self.estimator.variance() + scatter * scatter);
        if let Some(landing) = &mut self.landing {
            after = after.max(0.0);
            *landing = [after, variance];
        }
        self.move_from = self.anchored.then_some((before, after - before));
        self.estimator.rest_at(after, variance);
        // A move goes one way only, so the whole uncertainty of its gain counts.
        let ideal_um = rest * f64::from(pulses) * self.um_per_pulse();
        let unsure = self.gains.sd[gain_index(direction)] * ideal_um;
        self.reckoned.scatter(scatter * scatter + unsure * unsure);
        self.reckoned.travel(direction, ideal_um);
        self.anchored = false;
    }

    /// Expected position after all finalised bursts, µm.
    pub(super) fn position_um(&self) -> f64 {
        let pending = |direction| {
            let tenths = self.pending[gain_index(direction)] as f64;
            sign(direction) * tenths / 10.0 * self.um_per_pulse() * self.estimator.gain(direction)
        };
        self.estimator.position_um() + pending(Direction::Up) + pending(Direction::Down)
    }

    /// Expected rest position, µm: without the height that the last finalised burst has given the pin. Of an up burst of a stroke that is
    /// what it has moved, corrected or not, because its down burst is to undo that; of a move it is the level.
    pub(crate) fn rest_um(&self) -> f64 {
        let last = self.finalised.checked_sub(1).map(|last| self.queue[last]);
        let is_up = self.queue.get(self.finalised).is_some_and(|next| next.joined);
        let height = match last {
            Some(up) if is_up => up.counted as f64 / 10.0 * self.estimator.gain(Direction::Up),
            last => f64::from(last.map_or_else(|| self.trail.level(), |last| last.level)),
        };
        self.position_um() - height * self.um_per_pulse()
    }

    /// Distance from rest to expect by dead reckoning, root mean square, µm: the expected offset and what is uncertain. 0 if
    /// nothing was reckoned since the last sample.
    pub(crate) fn dead_reckoning_um(&self) -> f64 {
        match self.reckoned.sd_um(ASYMMETRY.min(self.estimator.asymmetry_sd())) {
            0.0 => 0.0,
            sd => sd.hypot(self.rest_um()),
        }
    }

    /// The rest error of excursions of the bursts since the last rest, with this surplus, from one to the next.
    pub(super) fn walk(&self, surplus: u16) -> ReflectedWalk {
        let surplus = f64::from(surplus) * self.um_per_pulse();
        let Gains { mean, scatter, .. } = self.gains;
        let spread = if self.is_calibrated() {
            Spread::measured(scatter, mean, [0.0; 2], 1)
        } else {
            Spread { scatter, asymmetry: ASYMMETRY }
        };
        ReflectedWalk::of_bursts(&self.bursts, surplus, spread)
    }

    /// With a lower stop: root mean square of the rest error to expect, µm.
    pub(crate) fn landing_rms_um(&self) -> Option<f64> {
        self.landing.map(|[mean, variance]| (mean * mean + variance).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::moves::Move;
    use meissner_array::spec::Array;
    use meissner_array::strokes::Step;

    /// A bad line delivers a correction or loses it: the pin is by so much elsewhere.
    #[test]
    fn a_cut_counts_corrections_that_no_sample_has_shown() {
        let second = |n: u64| Tick(n * 85_000);
        let mut pin = BurstController::new(Array::paper(), &Gains::default());
        pin.assume_rest();
        pin.telemetry(second(1), 0.0, |_| ());
        let up = Move { motor: 0, tick: second(2), level: 500, surplus: 0 };
        pin.sent(&Step::Move { of: up, from: 0 }, true, second(9));
        pin.accepted(up.tick);
        let mut more = 0;
        let amend = |_, pulses: u16| {
            more = pulses - up.level;
            true
        };
        pin.correct(Tick(up.tick.0 - 200), || second(9), true, true, amend);
        assert!(more > 100, "after a rest it is longer: {more}");
        pin.cut(second(3));
        let (said_um, more_um) = (pin.dead_reckoning_um(), f64::from(more) * pin.um_per_pulse());
        assert!(said_um >= more_um, "{said_um} um, and {more_um} um may be lost");
    }

    /// The device says that it cuts before it says what it has refused.
    #[test]
    fn what_was_refused_before_a_cut_was_not_played_although_the_report_comes_after_it() {
        let tick = |n: u64| Tick(85_000 + n);
        for (cut, refused, over) in [
            (2_000, [true, true], None),
            (2_000, [false, true], Some(500)),
            (1_100, [false, true], Some(500)),
        ] {
            let mut pin = BurstController::new(Array::paper(), &Gains::default());
            pin.assume_rest();
            let moves = [(0, 0, 500), (1_000, 500, 900)];
            for (start, from, level) in moves {
                let of = Move { motor: 0, tick: tick(start), level, surplus: 0 };
                pin.sent(&Step::Move { of, from }, false, tick(90_000));
                pin.accepted(of.tick);
            }
            pin.remember(tick(cut));
            pin.cut(tick(cut));
            for ((start, ..), _) in moves.into_iter().zip(refused).rev().filter(|(_, refused)| *refused) {
                pin.withdrawn(tick(start));
            }
            assert_eq!(
                pin.over_at(tick(0), tick(90_000), None),
                Ok(over.map(tick)),
                "cut after {cut}, {refused:?}"
            );
            let levels =
                pin.trail().movement([].into_iter(), [tick(0), tick(cut + 1_500)], Array::paper().rate());
            assert_eq!(levels.high, if over.is_some() { 500 } else { 0 }, "cut after {cut}, {refused:?}");
        }
    }

    #[test]
    fn a_move_down_ends_at_the_lower_stop() {
        let second = |n: u64| Tick(n * 85_000);
        for lower_stop in [false, true] {
            let mut pin = BurstController::new(Array::paper(), &Gains::default());
            pin.set_lower_stop(lower_stop);
            pin.assume_rest();
            pin.moved(Direction::Up, 100, second(1));
            let up_um = pin.rest_um();
            assert!((10.0..12.0).contains(&up_um), "{up_um} um");
            // Twice as far down: the stop takes what is too much.
            pin.moved(Direction::Down, 200, second(2));
            let expected_um = if lower_stop { 0.0 } else { -up_um };
            assert!((pin.rest_um() - expected_um).abs() < 1e-9, "{} um", pin.rest_um());
            pin.moved(Direction::Up, 100, second(3));
            assert!((pin.rest_um() - expected_um - up_um).abs() < 1e-9, "{} um", pin.rest_um());
            let estimate_um =
                if lower_stop { pin.landing_rms_um().unwrap() } else { pin.dead_reckoning_um() };
            assert!(estimate_um >= pin.rest_um(), "{estimate_um} um");
        }
    }
}
