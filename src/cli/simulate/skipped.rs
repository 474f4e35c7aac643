//! Lists the work that a simulation skipped, and why the result does not change.
//!
//! Invariant: each count above 0 has a reason; counts of 0 are left out.

use meissner_skin::Skipped;
use meissner_skin::membrane::MIN_WEIGHT;
use serde::Serialize;
use std::borrow::Cow;

/// Work that was skipped.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Reason {
    /// The name of the count, a key of documents.
    pub(super) what: &'static str,
    /// The number of motors or afferents.
    pub(super) count: u64,
    /// Why the answer does not change.
    pub(super) why: Cow<'static, str>,
}

/// The work that was skipped, with the reasons.
pub(super) fn reasons(skipped: &Skipped) -> Vec<Reason> {
    let Skipped { motors_at_rest, motors_out_of_reach, afferents_out_of_reach, afferents_below_threshold } =
        *skipped;
    let all = [
        (
            "motors_at_rest",
            motors_at_rest.into(),
            "a motor without a stroke does not move, so its input is 0".into(),
        ),
        (
            "motors_out_of_reach",
            motors_out_of_reach.into(),
            format!("the motor's weight is below {MIN_WEIGHT:e} at every afferent, which counts as 0").into(),
        ),
        (
            "receptors_out_of_reach",
            afferents_out_of_reach,
            "no moving motor has a weight there, so the membrane stays at rest".into(),
        ),
        (
            "receptors_below_threshold",
            afferents_below_threshold,
            "even if no input cancelled another, the membrane would stay below its first threshold".into(),
        ),
    ];
    let reason = |(what, count, why)| Reason { what, count, why };
    all.into_iter().map(reason).filter(|reason| reason.count > 0).collect()
}
