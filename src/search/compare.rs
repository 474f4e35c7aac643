//! Compares the drives of a live target with the result of a search without a deadline.

use super::convert;
use meissner_api::{LiveContrast, LiveRequest, ReachedContrast, SearchModel, SearchObjective, SearchSetting};
use meissner_design::{Compared, Limit, LiveBrief, LiveComparison, LiveSample, Target, compare_live};
use meissner_skin::ModelName;
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

/// How long the search at a pose may take; it usually converges sooner.
const POSE: Duration = Duration::from_secs(20);

/// Samples of a live play, and how their drives were searched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Compare {
    objective: SearchObjective,
    model: SearchModel,
    setting: SearchSetting,
    samples: Vec<LiveSample>,
}

impl Compare {
    /// Compares these samples of a live play.
    #[must_use]
    pub fn new(request: &LiveRequest, samples: Vec<LiveSample>) -> Self {
        let LiveRequest { objective, model, setting, .. } = *request;
        Self { objective, model, setting, samples }
    }

    /// Searches pose by pose. Calls `tell` with the contrast at the poses so far, until `tell` returns false.
    pub(super) fn carry_out(
        &self,
        target: &Target,
        tell: impl FnMut(LiveContrast) -> bool,
    ) -> Result<LiveContrast, String> {
        self.within(|| Limit::Until(Instant::now() + POSE), target, tell)
    }

    /// The same with a limit for each pose.
    fn within(
        &self,
        limit: impl Fn() -> Limit,
        target: &Target,
        mut tell: impl FnMut(LiveContrast) -> bool,
    ) -> Result<LiveContrast, String> {
        let brief = live_brief(self.objective, self.model, self.setting);
        let mut compared = Vec::new();
        for sample in &self.samples {
            let found = compare_live(target, brief, std::slice::from_ref(sample), limit());
            compared.extend(found.map_err(|error| error.to_string())?);
            if !tell(contrast(&compared)) {
                break;
            }
        }
        Ok(contrast(&compared))
    }
}

/// How the drives of a live target are searched, up to the highest frequency of the setting.
#[must_use]
pub fn live_brief(objective: SearchObjective, model: SearchModel, setting: SearchSetting) -> LiveBrief {
    LiveBrief {
        models: convert::models(model),
        goal: convert::goal(objective),
        setting: convert::setting(setting),
        ..LiveBrief::default()
    }
}

fn contrast(of: &[LiveComparison]) -> LiveContrast {
    let under = |model: ModelName| {
        let of_model =
            |of: &LiveComparison| of.contrast_hz.iter().find(|(of, _)| *of == model).map(|(_, of)| *of);
        let figures: Vec<Compared> = of.iter().filter_map(of_model).collect();
        let mean = |of: fn(&Compared) -> f64| figures.iter().map(of).sum::<f64>() / figures.len() as f64;
        let shares =
            figures.iter().filter(|of| of.converged > 0.0).map(|of| of.reached.max(0.0) / of.converged);
        (!figures.is_empty()).then(|| ReachedContrast {
            reached: mean(|of| of.reached),
            searched: mean(|of| of.converged),
            rule: mean(|of| of.rule),
            least_share: shares.min_by(f64::total_cmp),
        })
    };
    LiveContrast {
        poses: of.len() as u64,
        converged: of.iter().filter(|of| of.converged).count() as u64,
        membrane: under(ModelName::Membrane),
        afferents: under(ModelName::Afferents),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_design::{Pose, Rule, shipped};

    #[test]
    fn the_drives_of_a_rule_reach_what_the_rule_does() {
        let target = shipped("edge-45").unwrap();
        let drives = Rule::Reach.drives(&target);
        let far = Pose { x_mm: 24.0, ..Pose::default() };
        let poses = [Pose::default(), far].map(|pose| LiveSample { pose, drives: drives.clone() });
        let request = LiveRequest { model: SearchModel::Membrane, ..LiveRequest::default() };
        let compare = Compare::new(&request, poses.to_vec());
        let json = serde_json::to_string(&compare).unwrap();
        assert_eq!(serde_json::from_str::<Compare>(&json).unwrap(), compare);
        let mut told = Vec::new();
        let tell = |contrast: LiveContrast| {
            told.push(contrast.poses);
            true
        };
        let LiveContrast { poses, converged, membrane, afferents } =
            compare.within(|| Limit::Evaluations(u64::MAX), &target, tell).unwrap();
        // Beyond the finger there is nothing to compare.
        assert_eq!((poses, converged, afferents, told), (1, 1, None, vec![1, 1]));
        let ReachedContrast { reached, searched, rule, least_share } = membrane.unwrap();
        assert_eq!(reached, rule);
        assert!(rule > 0.0 && searched > rule, "{searched} {rule}");
        assert_eq!(least_share, Some(reached / searched));
    }
}
