//! What the pins really did, from the pulses on the simulated array's lines.

use crate::clock;
use firmware_protocol::controller::Run;
use firmware_protocol::tick::Tick;
use jiff::SignedDuration;
use jiff::civil::Date;
use meissner_array::spec::Array;
use meissner_stream::time::wall_set_since;
use std::collections::BTreeMap;
use std::time::Duration;

/// Pins that stand vibrate for so long yet, s.
const STILL_S: f64 = 0.5;
/// So long without vibration is a pause, s: that of the configuration.
const PAUSE_S: f64 = 1.0;

/// See the module. Times are those of the machine's clock, s.
#[derive(Default)]
pub(super) struct Truth {
    /// When the array was switched on.
    pub(super) began: Duration,
    /// Who sits at the display; none without a session.
    pub(super) person: Option<String>,
    /// When each motor had its last pulse.
    pub(super) pulsed_s: [f64; 24],
    /// The end of the last pulse.
    pub(super) last_s: f64,
    /// Vibration since the last pause.
    pub(super) stretch_s: f64,
    /// Vibration by person, and the date that the wall clock showed.
    pub(super) days: BTreeMap<(Option<String>, Date), f64>,
    /// The same by the date that would be if nobody had set the clock since the daemon began.
    pub(super) passed: BTreeMap<(Option<String>, Date), f64>,
}

impl Truth {
    /// Adds the pulses since the last call.
    pub(super) fn see(&mut self, played: &[(Tick, Run)]) {
        if played.is_empty() {
            return;
        }
        let (rate, (now, wall)) = (Array::paper().rate(), clock::now());
        let at_s = |tick: Tick| self.began.as_secs_f64() + rate.ticks_to_seconds(tick - Tick::BOOT);
        let ago_s = now.as_ns() as f64 / 1e9 - at_s(played[0].0);
        let began = wall - SignedDuration::from_secs_f64(ago_s);
        let mut new_s = 0.0;
        for (tick, run) in played {
            let (from_s, to_s) = (at_s(*tick), at_s(*tick + u64::from(run.ticks)));
            let gap_s = from_s - self.last_s;
            if gap_s >= PAUSE_S {
                self.stretch_s = 0.0;
            }
            let vibrates_s = to_s - from_s + if gap_s < STILL_S { gap_s } else { 0.0 };
            self.stretch_s += vibrates_s;
            new_s += vibrates_s;
            self.last_s = to_s;
            for (motor, pulsed_s) in self.pulsed_s.iter_mut().enumerate() {
                if run.lines.pulsing().contains(motor as u8) {
                    *pulsed_s = to_s;
                }
            }
        }
        let unset = began - SignedDuration::from_nanos(wall_set_since());
        for (days, at) in [(&mut self.days, began), (&mut self.passed, unset)] {
            let date = at.to_zoned(clock::zone()).date();
            *days.entry((self.person.clone(), date)).or_default() += new_s;
        }
    }
}
