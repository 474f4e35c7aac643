//! Strokes of the pins that an object passes: where a descent begins for an object that moves.
//!
//! A pin is far slower than the skin under a moving object, and a slow pin leaves RA afferents silent. So pins make strokes at full speed:
//! time is cut into slots, in which a stroke of the full travel just fits at the paper's speed, and each pin makes one stroke in each slot.
//! Its height is that of a bounded least squares ([`Boxed`]): the wanted spikes of RA afferents in the slot, each as the height of the stroke that
//! gives them.

use crate::STEP_S;
use crate::field::Boxed;
use crate::levels::{Levels, Limits};
use crate::rates::Table;
use crate::skin::Skin;
use crate::wanted::Wanted;

/// Steps of a slot: 36 ms.
const SLOT: usize = 9;
/// Added to the sum of squares per square of a height. More than for a press: neighbours must not do the work of a pin that is passed.
const DAMPING: f64 = 0.05;
/// A smaller stroke moves no afferent, mm.
const LEAST_MM: f64 = 0.02;

/// The strokes.
pub(crate) fn graded(skin: &Skin, wanted: &Wanted, limits: Limits) -> Levels {
    let table = Table::of_ra();
    let mut levels = Levels::at_rest(wanted.moments(), skin.motors);
    let highest_mm = limits.highest_mm.min(limits.step_mm * (SLOT as f64 - 1.0) / 2.0);
    let mm_per_spike = highest_mm / spikes_of_stroke(&table, limits, highest_mm);
    let boxed = Boxed::new(skin, DAMPING);
    for first in (0..wanted.touched).step_by(SLOT) {
        let moments = first..(first + SLOT).min(wanted.touched);
        let mut need_mm = vec![0.0; skin.places()];
        for moment in moments.clone().filter(|&moment| moment > 0) {
            let pairs = wanted.skin_mm[moment].iter().zip(&wanted.skin_mm[moment - 1]);
            for (need_mm, (now, before)) in need_mm.iter_mut().zip(pairs) {
                *need_mm += mm_per_spike * table.at((now - before).abs() / STEP_S).0;
            }
        }
        need_mm.iter_mut().for_each(|mm| *mm = mm.min(2.0 * highest_mm));
        let mut tops_mm = vec![0.0; skin.motors];
        boxed.solve(&need_mm, highest_mm, &mut tops_mm);
        for moment in moments {
            let (since, left) = (moment - first, first + SLOT - 1 - moment);
            let tent_mm = since.min(left) as f64 * limits.step_mm;
            for (height, top_mm) in levels.heights_mm[moment].iter_mut().zip(&tops_mm) {
                *height = if *top_mm < LEAST_MM { 0.0 } else { tent_mm.min(*top_mm) };
            }
        }
    }
    levels
}

/// The spikes that a stroke of this height gives to an RA afferent beside its pin, where the skin goes half as far.
fn spikes_of_stroke(table: &Table, limits: Limits, height_mm: f64) -> f64 {
    2.0 * height_mm / limits.step_mm * table.at(limits.step_mm / STEP_S / 2.0).0
}
