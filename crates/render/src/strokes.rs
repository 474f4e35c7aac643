//! Strokes of the pins that an object passes: where a descent begins for an object that moves.
//!
//! A pin is far slower than the skin under a moving object, and a slow pin leaves RA afferents silent. So pins make strokes at full speed:
//! time is cut into slots, and each pin makes one stroke in each slot. Its height is that of a bounded least squares ([`Boxed`]): the wanted
//! spikes of RA afferents in the slot, each as the height of the stroke that gives them.
//!
//! Short slots give RA afferents their spikes at the right time. Long ones move the skin further, and wake fewer PC afferents, for pins start
//! and stop less often. Which is better depends on the speed of the object, and where in a slot it passes the pins: so there are several
//! [`starts`].

use crate::field::Boxed;
use crate::levels::{Levels, Limits, STEP_S};
use crate::rates::Table;
use crate::skin::Skin;
use crate::wanted::Wanted;

/// Lengths of slots, in sixths of a stroke of the full travel: 36, 48 and 72 ms for the paper's motors.
const SIXTHS: [usize; 3] = [3, 4, 6];
/// The most steps of a slot: slower motors make strokes of less than their travel.
const MOST: usize = 30;
/// Added to the sum of squares per square of a height. More than for a press: neighbours must not do the work of a pin that is passed.
const DAMPING: f64 = 0.05;
/// A smaller stroke moves no afferent, mm.
const LEAST_MM: f64 = 0.02;

/// Strokes in slots of each length, which begin at the touch or a third or two thirds of a slot later.
pub(crate) fn starts(skin: &Skin, wanted: &Wanted, limits: Limits) -> Vec<Levels> {
    let whole = ((2.0 * limits.highest_mm / limits.step_mm) as usize + 1).clamp(6, MOST);
    let of_slot = |slot: usize| (0..3).map(move |third| graded(skin, wanted, limits, slot, third * slot / 3));
    SIXTHS.into_iter().flat_map(|sixths| of_slot(whole * sixths / 6)).collect()
}

fn graded(skin: &Skin, wanted: &Wanted, limits: Limits, slot: usize, begin: usize) -> Levels {
    let table = Table::of_ra();
    let mut levels = Levels::at_rest(wanted.skin_mm.len(), skin.motors);
    let highest_mm = limits.highest_mm.min(limits.step_mm * (slot as f64 - 1.0) / 2.0);
    let mm_per_spike = highest_mm / spikes_of_stroke(&table, limits, highest_mm);
    let boxed = Boxed::new(skin, DAMPING);
    for first in (begin..wanted.touched).step_by(slot) {
        let moments = first..(first + slot).min(wanted.touched);
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
            let (since, left) = (moment - first, first + slot - 1 - moment);
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
