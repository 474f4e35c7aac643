//! Checks the results of a scenario's plays: the host's account against the file and the compiled strokes.

use crate::judge::{Judged, differences};
use crate::log::{Log, Train};
use crate::scenario::{Scenario, Share};
use firmware_protocol::tick::Tick;
use meissner_stream::Source;
use meissner_stream::end_cause;
use meissner_stream::queues::{End, Outcome, StreamEvent};

/// What the lines have to do if all steps are played from `onset` on.
#[must_use]
pub fn compiled(strokes: &Source, onset: Tick) -> Log {
    let mut strokes = strokes.clone();
    strokes.begin(onset);
    let trains = strokes.flatten().flat_map(|step| {
        step.bursts().map(move |burst| {
            let train = Train { start: burst.start, direction: burst.direction, pulses: burst.pulses.into() };
            (usize::from(step.motor()), train)
        })
    });
    Log::of(trains.collect())
}

pub(super) fn check(
    scenario: &Scenario,
    plays: &[u64],
    notices: Vec<StreamEvent>,
    boots: &[Judged],
    wrong: &mut Vec<String>,
) {
    let ended: Vec<_> = notices
        .into_iter()
        .filter_map(|notice| match notice {
            StreamEvent::PlayEnded { id, outcome } => Some((id, outcome)),
            _ => None,
        })
        .collect();
    for (&id, expected) in plays.iter().zip(&scenario.plays) {
        let Some((_, outcome)) = ended.iter().find(|(ended, _)| *ended == id) else {
            wrong.push(format!("play {id} has not ended"));
            continue;
        };
        let bursts = outcome.bursts;
        let share = match bursts.played {
            0 => Share::None,
            played if played == bursts.planned => Share::All,
            _ => Share::Some,
        };
        let found = (outcome.end, share, bursts.late > 0, bursts.amended);
        if found != (expected.end, expected.played, expected.late, expected.amended) {
            wrong.push(format!("play {id} came to {found:?}, expected {expected:?}: {bursts:?}"));
        }
        if bursts.planned != bursts.played + bursts.late + bursts.dropped + bursts.refused {
            wrong.push(format!("play {id}: the account does not close: {bursts:?}"));
        }
        against_strokes(id, outcome, boots, wrong);
    }
    if scenario.plays.len() != plays.len() {
        wrong.push(format!("{} plays were ordered, {} are expected", plays.len(), scenario.plays.len()));
    }
    let cuts: Vec<_> = boots
        .iter()
        .flat_map(|boot| &boot.expected.cuts)
        .map(|cut| end_cause(cut.cause).to_string())
        .collect();
    if cuts != scenario.cuts {
        wrong.push(format!("cuts {cuts:?}, expected {:?}", scenario.cuts));
    }
}

/// Checks a play that ended as planned against its compiled strokes, whatever went over the link.
fn against_strokes(id: u64, outcome: &Outcome, boots: &[Judged], wrong: &mut Vec<String>) {
    let (Some(onset), Some(length)) = (outcome.onset.map(|onset| onset.actual), outcome.play.strokes.end())
    else {
        return;
    };
    if outcome.end != End::Done
        || outcome.bursts.amended > 0
        || outcome.bursts.played != outcome.bursts.planned
    {
        return;
    }
    let wanted = compiled(&outcome.play.strokes, onset);
    let onsets = |boot: &&Judged| boot.expected.onsets.contains(&onset);
    let Some(boot) = boots.iter().find(onsets) else {
        wrong.push(format!("play {id}: its onset is not among the device's reports"));
        return;
    };
    let found = boot.log.within(onset, onset + length);
    for difference in differences(&found, &wanted) {
        wrong.push(format!("play {id}, against its strokes: {difference}"));
    }
}
