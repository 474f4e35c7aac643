use meissner_array::pattern::Pattern;
use meissner_paper::{
    Conditions, MODEL, Rule, Target, judge, populations, pulses_per_s, robustness, shipped, shipped_names,
};
use std::path::{Path, PathBuf};
use std::{env, fs};
use toml::Table;

/// The first lines of a pattern that the rule made.
const BY_RULE: &str = "# By the rule of thumb: the pins within reach of the shape vibrate at 60 Hz, in phase.\n\
    # `MEISSNER_WRITE=1 cargo test -p meissner-paper rule_of_thumb` writes it again.\n";

/// The file of a pattern in a folder of the library.
fn path(folder: &str, name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../library").join(folder).join(format!("{name}.toml"))
}

fn file(name: &str) -> String {
    fs::read_to_string(path("patterns/paper", name)).unwrap()
}

/// A pattern of the library, and its target.
fn made(name: &str) -> (Pattern, Target) {
    let pattern = meissner_test_support::rig::pattern(name);
    let target = Target::made_for(&pattern).unwrap();
    (pattern, target)
}

#[test]
fn every_target_has_a_pattern_of_the_paper_with_the_right_figures() {
    for name in shipped_names().iter().map(|name| format!("{name}-paper")) {
        let (pattern, target) = made(&name);
        assert!(target == shipped(target.name()).unwrap(), "{name}: made for another target");
        assert_eq!(pattern.to_toml(), file(&name));
        let provenance = pattern.provenance();
        let stored = |key: &str| provenance[key].as_float().unwrap();
        assert_eq!(provenance["robust"].as_bool(), Some(true));
        let made_for = Conditions::plain(populations(&target, true), target.population_seed());
        let verdict = judge(&target, pattern.drives(), &made_for).unwrap().unwrap();
        let found = [verdict.cost_hz, verdict.on_hz, verdict.off_hz, verdict.auc];
        assert_eq!(found, ["cost", "on_hz", "off_hz", "auc"].map(stored), "{name}");
        assert_eq!(pulses_per_s(&pattern).unwrap(), stored("pulses_per_s"), "{name}");
        let held_out = provenance["robustness"]["held_out_hz"].as_array().unwrap();
        let mean = held_out.iter().map(|cost| cost.as_float().unwrap()).sum::<f64>() / held_out.len() as f64;
        assert_eq!(held_out.len(), 20, "{name}");
        assert!(mean >= 0.9 * found[0], "{name}: {mean} of {}", found[0]);
        assert!(found[0] > 70.0 && found[3] > 0.75, "{name}: {found:?}");
    }
}

#[test]
fn the_library_has_the_rule_of_thumb_for_every_target() {
    for name in shipped_names() {
        let target = shipped(name).unwrap();
        let provenance = Table::from_iter([
            ("target".to_owned(), name.into()),
            ("method".to_owned(), Rule::Reach.name().into()),
            ("model".to_owned(), MODEL.into()),
            ("definition".to_owned(), target.definition().into()),
        ]);
        let drives = Rule::Reach.drives(&target);
        let made_for = Conditions::plain(populations(&target, true), target.population_seed());
        let verdict = judge(&target, &drives, &made_for).unwrap().unwrap();
        assert!(verdict.cost_hz > 70.0 && verdict.auc > 0.75, "{name}: {verdict:?}");
        let made = Pattern::new(target.array(), name, Some(target.duration_s()), drives, provenance);
        let (made, path) = (format!("{BY_RULE}{}", made.unwrap().to_toml()), path("patterns", name));
        if env::var_os("MEISSNER_WRITE").is_some() {
            fs::write(&path, &made).unwrap();
        }
        assert!(
            made == fs::read_to_string(path).unwrap(),
            "{name}: its first lines say how to write it again"
        );
    }
}

#[test]
fn robustness_is_as_stored() {
    let (pattern, target) = made("two-dots-paper");
    let made_for = Conditions::plain(populations(&target, true), target.population_seed());
    let found = robustness(&target, pattern.drives(), &made_for).unwrap();
    assert_eq!(toml::Value::try_from(&found).unwrap(), pattern.provenance()["robustness"]);
    // The pattern was made for half-rectifying afferents. More travel gives more spikes.
    assert_eq!(found.half_hz, pattern.provenance()["cost"].as_float().unwrap());
    assert!(found.gain_90_percent_hz < found.half_hz && found.half_hz < found.gain_110_percent_hz);
    // A shift lowers the mean contrast; in one direction the pattern may meet more afferents.
    assert!(found.shifted_1_mm_hz.iter().all(|&cost| cost > 0.0));
    assert!(found.shifted_1_mm_hz.iter().sum::<f64>() / 8.0 < found.half_hz);
}
