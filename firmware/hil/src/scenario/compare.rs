//! Compares the same scenario on two benches.
//!
//! Onsets, causes of cuts and every tick of every line must be equal, except between a cut and the next onset: a cut may
//! differ by some ticks (the file says how many), and the return depends on it. There each bench's judge checks the lines.

use crate::judge::differences;
use crate::log::Log;
use crate::scenario::{Ran, Scenario};
use firmware_protocol::tick::Tick;

/// The differences, in words.
#[must_use]
pub fn compare(scenario: &Scenario, one: &Ran, other: &Ran) -> Vec<String> {
    let mut wrong = Vec::new();
    if one.boots.len() != other.boots.len() {
        wrong.push(format!("{} boots, {} on the other bench", one.boots.len(), other.boots.len()));
    }
    for (number, (a, b)) in one.boots.iter().zip(&other.boots).enumerate() {
        if a.expected.onsets != b.expected.onsets {
            wrong.push(format!("boot {number}: onsets {:?} and {:?}", a.expected.onsets, b.expected.onsets));
        }
        let causes = |cuts: &[crate::oracle::CutAt]| cuts.iter().map(|cut| cut.cause).collect::<Vec<_>>();
        let (cuts_a, cuts_b) = (&a.expected.cuts, &b.expected.cuts);
        if causes(cuts_a) != causes(cuts_b) {
            wrong.push(format!("boot {number}: cuts {cuts_a:?} and {cuts_b:?}"));
        }
        let death = one.deaths.get(number).zip(other.deaths.get(number));
        let death = death.and_then(|(a, b)| a.zip(*b));
        let cuts = cuts_a.iter().zip(cuts_b).map(|(a, b)| (a.at, b.at)).chain(death);
        let (mut log_a, mut log_b) = (a.log.clone(), b.log.clone());
        for (at_a, at_b) in cuts {
            let apart = at_a.since(at_b).unsigned_abs();
            if apart > scenario.slack_ticks {
                wrong.push(format!("boot {number}: a cut lies {apart} ticks apart on both benches"));
            }
            let from = Tick(at_a.min(at_b).0 - 1);
            let onset = a.expected.onsets.iter().filter(|&&onset| onset >= at_a.max(at_b)).min();
            let cut = |log: &Log| log.without(from, onset.copied().unwrap_or(Tick(u64::MAX)));
            (log_a, log_b) = (cut(&log_a), cut(&log_b));
        }
        let differ = differences(&log_b, &log_a);
        wrong.extend(differ.iter().map(|finding| format!("boot {number}, both benches: {finding}")));
    }
    wrong
}
