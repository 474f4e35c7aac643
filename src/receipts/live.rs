//! The receipt's figures about a live play's updates: counts, and the times until they reached the pins.
//!
//! Invariant: the memory does not grow with the updates, because durations are counted in classes of a tenth of a millisecond.

use meissner_api::{LiveRecord, UpdateTimes};
use meissner_array::units::TickRate;
use meissner_stream::queues::{Applied, LiveResult, LiveUpdate};

/// Classes of a tenth of a millisecond; longer durations count in the last one.
const CLASSES: usize = 20_000;

/// Durations, by class.
#[derive(Debug, Default)]
struct Durations {
    classes: Vec<u32>,
    count: u64,
    longest_ms: f64,
}

impl Durations {
    fn add(&mut self, ms: f64) {
        // The cast saturates.
        let class = ((ms * 10.0) as usize).min(CLASSES - 1);
        if self.classes.len() <= class {
            self.classes.resize(class + 1, 0);
        }
        self.classes[class] += 1;
        self.count += 1;
        self.longest_ms = self.longest_ms.max(ms);
    }

    /// The upper end of the class in which this share of the durations is reached, ms.
    fn quantile_ms(&self, share: f64) -> f64 {
        let wanted = share * self.count as f64;
        let mut sum = 0.0;
        for (class, &count) in self.classes.iter().enumerate() {
            sum += f64::from(count);
            if sum >= wanted {
                return (((class + 1) as f64) / 10.0).min(self.longest_ms);
            }
        }
        self.longest_ms
    }

    fn times(&self) -> Option<UpdateTimes> {
        (self.count > 0).then(|| UpdateTimes {
            p50_ms: self.quantile_ms(0.5),
            p99_ms: self.quantile_ms(0.99),
            longest_ms: self.longest_ms,
        })
    }
}

/// The account of a live play's updates.
#[derive(Debug, Default)]
pub(super) struct LiveAccount {
    record: LiveRecord,
    /// Times from the message to the tick from which strokes are replaced, to the first motor's new drive, and to the last motor's.
    decided: Durations,
    first: Durations,
    last: Durations,
}

impl LiveAccount {
    /// Counts the result of an update.
    pub(super) fn add(&mut self, update: &LiveUpdate, rate: TickRate) {
        self.record.updates += 1;
        match update.result {
            LiveResult::Merged { .. } => self.record.merged += 1,
            LiveResult::Applied(Applied { received, replaced, motors, repeats, .. }) => {
                self.record.applied += 1;
                self.record.repeats += u64::from(repeats);
                let since = |tick| rate.ticks_to_ms(tick - received);
                let (first, last) = (motors.iter().flatten().min(), motors.iter().flatten().max());
                if let (Some(&first), Some(&last)) = (first, last) {
                    self.decided.add(since(replaced));
                    self.first.add(since(first));
                    self.last.add(since(last));
                }
            }
            LiveResult::Waiting | LiveResult::Over => {}
        }
    }

    pub(super) fn record(&self) -> LiveRecord {
        let times = [&self.decided, &self.first, &self.last].map(Durations::times);
        let [decided, first_motor, last_motor] = times;
        LiveRecord { decided, first_motor, last_motor, ..self.record }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::tick::Tick;
    use meissner_array::per_motor::PerMotor;
    use meissner_array::spec::Array;
    use meissner_stream::time::HostInstant;

    #[test]
    fn quantiles_are_those_of_the_updates() {
        let mut account = LiveAccount::default();
        for number in 1..=100 {
            let mut motors = PerMotor::all(Array::paper(), None);
            (motors[3], motors[4]) = (Some(Tick(1_000 + 850 * number)), Some(Tick(1_000 + 1_700 * number)));
            let applied = Applied {
                received: Tick(1_000),
                replaced: Tick(1_085),
                motors,
                repeats: u32::from(number == 7),
                refused: 0,
            };
            let update = LiveUpdate {
                result: LiveResult::Applied(applied),
                ..LiveUpdate::new(Array::paper(), 1, number, HostInstant::default())
            };
            account.add(&update, Array::paper().rate());
        }
        account.add(
            &LiveUpdate {
                result: LiveResult::Merged { into: 9 },
                ..LiveUpdate::new(Array::paper(), 1, 8, HostInstant::default())
            },
            Array::paper().rate(),
        );
        let record = account.record();
        assert_eq!((record.updates, record.applied, record.merged, record.repeats), (101, 100, 1, 1));
        let first = record.first_motor.unwrap();
        assert!((first.p50_ms - 500.0).abs() < 0.2 && (first.p99_ms - 990.0).abs() < 0.2, "{first:?}");
        assert_eq!((first.longest_ms, record.decided.unwrap().longest_ms), (1_000.0, 1.0));
        // The classes end at two seconds; the longest duration is still exact.
        assert_eq!(record.last_motor.unwrap().longest_ms, 2_000.0);
    }
}
