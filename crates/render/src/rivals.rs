//! The plain answers that a rendered pattern has to beat: pins near the object vibrate at 60 Hz.

use crate::levels::STEP_S;
use crate::rule::beyond_mm;
use meissner_array::pattern::{Drive, Pattern, PatternError};
use meissner_array::spec::Array;
use meissner_touch::{Contact, Touch};
use serde::Serialize;

/// The frequency and the amplitude of the vibration: what shipped patterns have.
const HZ: f64 = 60.0;
const UM: f64 = 80.0;
/// How near a pin must be to the object to vibrate, mm.
const REACH_MM: f64 = 1.5;

/// Which pins vibrate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rival {
    /// All within 1.5 mm of the object.
    WithinReach,
    /// The pin that is nearest to each piece of the object.
    Nearest,
}

impl Rival {
    /// Both.
    pub const ALL: [Self; 2] = [Self::WithinReach, Self::Nearest];

    /// Its pattern: each pin vibrates while the object touches the finger near it.
    ///
    /// # Errors
    /// If the touch is longer than a pattern.
    pub fn pattern(self, array: Array, contact: &Contact, touch: &Touch) -> Result<Pattern, PatternError> {
        let moments = (touch.duration_s() / STEP_S).ceil() as usize;
        let mut on = vec![Vec::with_capacity(moments); array.motors()];
        let mut before = None;
        let mut pins = vec![false; array.motors()];
        for moment in 0..moments {
            let pose = touch.pose(moment as f64 * STEP_S);
            if before != Some(pose) {
                pins = self.pins(array, contact, &pose);
                before = Some(pose);
            }
            on.iter_mut().zip(&pins).for_each(|(on, pin)| on.push(*pin));
        }
        let mut drives = Vec::new();
        for (motor, on) in array.numbers().zip(&on) {
            let mut moment = 0;
            for run in on.chunk_by(|a, b| a == b) {
                let (start_s, stop_s) = (moment as f64 * STEP_S, (moment + run.len()) as f64 * STEP_S);
                moment += run.len();
                if run[0] {
                    let (start_s, stop_s) = (Some(start_s), Some(stop_s));
                    let vibration =
                        Drive { motor, frequency_hz: HZ, amplitude_um: UM, phase: 0.0, start_s, stop_s };
                    drives.push(vibration);
                }
            }
        }
        let duration_s = (moments as f64 * STEP_S).max(STEP_S);
        Pattern::new(array, "rival", Some(duration_s), drives, toml::Table::new())
    }

    fn pins(self, array: Array, contact: &Contact, pose: &meissner_touch::Pose) -> Vec<bool> {
        let pins = array.positions_mm();
        match self {
            Self::WithinReach => pins.iter().map(|pin| beyond_mm(contact, pose, *pin) <= REACH_MM).collect(),
            Self::Nearest => {
                let mut near = vec![false; pins.len()];
                for grain in crate::rule::touching(contact, pose) {
                    let squared =
                        |[x, y]: &[f64; 2]| (x - grain[0]) * (x - grain[0]) + (y - grain[1]) * (y - grain[1]);
                    let nearest =
                        (0..pins.len()).min_by(|&a, &b| squared(&pins[a]).total_cmp(&squared(&pins[b])));
                    nearest.into_iter().for_each(|pin| near[pin] = true);
                }
                near
            }
        }
    }
}
