//! Converts a search's settings from the API's types to those of the design crate.

use crate::rendering::Way;
use meissner_api::{RenderMethod, SearchModel, SearchObjective, SearchSetting, SearchVerdict};
use meissner_design::{Goal, Models, Setting, Verdict};
use meissner_render::Method;

pub(crate) const fn goal(of: SearchObjective) -> Goal {
    match of {
        SearchObjective::Contrast => Goal::Contrast,
        SearchObjective::OffRms => Goal::OffRms,
        SearchObjective::OffRmsTwice => Goal::OffRmsTwice,
        SearchObjective::NearOff => Goal::NearOff,
        SearchObjective::Auc => Goal::Auc,
        SearchObjective::Correlation => Goal::Correlation,
        SearchObjective::Rivals => Goal::Rivals,
    }
}

pub(crate) const fn models(of: SearchModel) -> Models {
    match of {
        SearchModel::Both => Models::Both,
        SearchModel::Membrane => Models::Membrane,
        SearchModel::Afferents => Models::Afferents,
    }
}

pub(crate) const fn setting(of: SearchSetting) -> Setting {
    match of {
        SearchSetting::Default => Setting::Default,
        SearchSetting::AlwaysOn => Setting::AlwaysOn,
    }
}

pub(super) const fn way(of: RenderMethod) -> Way {
    match of {
        RenderMethod::Auto => Way::Touch(Method::Auto),
        RenderMethod::Rate => Way::Touch(Method::Rate),
        RenderMethod::Field => Way::Touch(Method::Field),
        RenderMethod::Rule => Way::Touch(Method::Rule),
        RenderMethod::Trace => Way::Trace,
    }
}

pub(super) const fn verdict(of: &Verdict) -> SearchVerdict {
    let Verdict { on_hz, off_hz, cost_hz, auc } = *of;
    SearchVerdict { on: on_hz, off: off_hz, contrast: cost_hz, auc }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_design::GOALS;
    use serde_json::{from_value, to_value};

    #[test]
    fn a_search_has_the_names_of_the_command() {
        for of in GOALS {
            let objective = from_value(to_value(of.name()).unwrap()).unwrap();
            assert_eq!(goal(objective), of);
        }
        for of in [Models::Both, Models::Membrane, Models::Afferents] {
            assert_eq!(models(from_value(to_value(of).unwrap()).unwrap()), of);
        }
        for of in [Setting::Default, Setting::AlwaysOn] {
            assert_eq!(setting(from_value(to_value(of).unwrap()).unwrap()), of);
        }
        for of in ["auto", "rate", "field", "rule", "trace"] {
            let method = from_value(of.into()).unwrap();
            assert_eq!(to_value(way(method)).unwrap(), of);
        }
        assert_eq!(
            (Goal::default(), goal(SearchObjective::default())),
            (Goal::OffRmsTwice, Goal::OffRmsTwice)
        );
        assert_eq!(
            (models(SearchModel::default()), setting(SearchSetting::default())),
            (Models::Both, Setting::Default)
        );
    }
}
