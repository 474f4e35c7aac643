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
    /// The amount.
    pub(super) count: Count,
    /// Why the answer does not change.
    pub(super) why: Cow<'static, str>,
}

/// A number of motors or afferents, or of afferent-seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub(super) enum Count {
    /// Motors or afferents.
    Number(u64),
    /// Afferent-seconds.
    Seconds(f64),
}

impl Count {
    fn is_nothing(self) -> bool {
        matches!(self, Self::Number(0)) || self == Self::Seconds(0.0)
    }
}

/// The work that was skipped, with the reasons.
pub(super) fn reasons(skipped: &Skipped) -> Vec<Reason> {
    let Skipped {
        motors_at_rest,
        motors_out_of_reach,
        afferents_out_of_reach,
        afferents_below_threshold,
        repeated_afferent_s,
        afferents_reused,
    } = *skipped;
    let all = [
        (
            "motors_at_rest",
            Count::Number(motors_at_rest.into()),
            "a motor without a stroke does not move, so its input is 0".into(),
        ),
        (
            "motors_out_of_reach",
            Count::Number(motors_out_of_reach.into()),
            format!("the motor's weight is below {MIN_WEIGHT:e} at every afferent, which counts as 0").into(),
        ),
        (
            "receptors_out_of_reach",
            Count::Number(afferents_out_of_reach),
            "no moving motor has a weight there, so the membrane stays at rest".into(),
        ),
        (
            "receptors_below_threshold",
            Count::Number(afferents_below_threshold),
            "even if no input cancelled another, the membrane would stay below its first threshold".into(),
        ),
        (
            "repeated_receptor_s",
            Count::Seconds(repeated_afferent_s),
            "the state was bit by bit an earlier one, one or more periods before, so the spikes repeat"
                .into(),
        ),
        (
            "receptors_reused",
            Count::Number(afferents_reused),
            "no motor that changed reaches the afferent, so its answer is the last one".into(),
        ),
    ];
    let reason = |(what, count, why)| Reason { what, count, why };
    all.into_iter().map(reason).filter(|reason| !reason.count.is_nothing()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_skipped_work_is_named() {
        assert_eq!(reasons(&Skipped::default()), []);
        let found = reasons(&Skipped { motors_at_rest: 3, repeated_afferent_s: 1.5, ..Skipped::default() });
        let found = serde_json::to_value(found).unwrap();
        assert_eq!((&found[0]["what"], &found[0]["count"]), (&json!("motors_at_rest"), &json!(3)));
        assert_eq!((&found[1]["what"], &found[1]["count"]), (&json!("repeated_receptor_s"), &json!(1.5)));
        assert_eq!(found.as_array().unwrap().len(), 2);
        let found = reasons(&Skipped { motors_out_of_reach: 1, ..Skipped::default() });
        assert!(found[0].why.contains("below 1e-10 at every afferent"), "{}", found[0].why);
    }
}
