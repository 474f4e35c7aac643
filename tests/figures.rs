use crate::harness::{document, offline};
use meissner_array::motor::SteadyState;
use meissner_array::spec::Array;
use serde_json::Value;
use std::sync::LazyLock;

/// The measurements of the paper's array.
static SIMULATED: LazyLock<Value> =
    LazyLock::new(|| document(offline().args(["motor", "--simulated", "--json"])));

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

fn rows(value: &Value) -> &[Value] {
    value.as_array().unwrap_or_else(|| panic!("{value}"))
}

#[test]
fn the_displacement_follows_the_pulses_as_in_the_paper() {
    let found = &SIMULATED["pulses"];
    assert_eq!((&SIMULATED["array"], &found["motor"]), (&"tula35-6x4".into(), &9.into()));
    // 20 groups of ten strokes; no fit uses the first stroke of a group.
    let bursts = rows(&found["bursts"]);
    assert_eq!((bursts.len(), &found["up"]["blocks"]), (20 * 10 * 2, &180.into()));
    let (all, slope) = (&found["all"], 0.95 / 7.0);
    assert_eq!((number(&found["model_um_per_pulse"]), &all["blocks"]), (slope, &(24 * 360).into()));
    let [slope_um, se_um, offset_um, sd] =
        ["slope_um_per_pulse", "slope_se_um_per_pulse", "offset_um", "relative_sd"]
            .map(|key| number(&all[key]));
    assert!((slope_um - slope).abs() < 4.0 * se_um, "{all}");
    assert!(se_um < 0.002 * slope && offset_um.abs() < 0.03, "{all}");
    // The bound is four standard errors; the expected value combines the paper's 10 % and the asymmetry's 1 % as squares.
    assert!((sd - 0.1005).abs() < 4.0 * 0.1 / (2.0 * 8640.0_f64).sqrt(), "{all}");
    // First bursts, 24 × 20 of them.
    assert!((number(&found["transient_gain"]) - 0.8).abs() < 4.0 * 0.1 / 480_f64.sqrt());
}

#[test]
fn the_amplitude_is_the_model_s_and_simulated_motors_scatter_around_it() {
    let found = &SIMULATED["amplitude"];
    let measured = rows(&found["measured"]);
    assert_eq!(measured.len(), 23 * 6);
    let mut ratios = Vec::new();
    for row in measured {
        let [hz, um, model_um, measured_um, sd_um] =
            ["frequency_hz", "amplitude_um", "model_um", "measured_um", "sd_um"].map(|key| number(&row[key]));
        assert_eq!(model_um, SteadyState::of(Array::paper(), hz, um).unwrap().peak_to_peak_um);
        // This is the mean of 80 cycles, so half a standard deviation is more than four standard errors.
        assert!((measured_um - model_um).abs() < 0.5 * sd_um && row["cycles"] == 80, "{row}");
        if hz <= 10.0 {
            // A cycle is the mean of an up and a down burst, each off by 10 %.
            assert!((sd_um / um - 0.1 / 2_f64.sqrt()).abs() < 0.025, "{row}");
        }
        // Even where the model's amplitude is 0, motors vibrate because of their scatter.
        assert!(sd_um > 0.02 * model_um && sd_um > 0.1, "{row}");
        ratios.extend((model_um >= 5.0).then_some(measured_um / model_um));
    }
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    assert!((mean - 1.0).abs() < 0.01 && ratios.iter().all(|ratio| (ratio - 1.0).abs() < 0.05), "{ratios:?}");
    let model = rows(&found["model"]);
    // 160 points and the null, of each amplitude.
    assert_eq!(model.len(), 161 * 6);
    let null = model.iter().find(|row| row["amplitude_um"] == 80.0 && number(&row["model_um"]) < 1e-6);
    assert!((number(&null.unwrap()["frequency_hz"]) - 233.3).abs() < 1.0, "{null:?}");
}

#[test]
fn a_search_tells_its_start_and_its_way() {
    let asked = ["optimise", "dot", "--setting", "always_on", "--budget", "60", "--json"];
    let found = document(offline().args(asked));
    let trace = rows(&found["trace"]);
    assert_eq!((&trace[0]["evaluations"], &trace[0]["frame"]), (&1.into(), &0.into()));
    for of in trace {
        let [on_hz, off_hz, cost_hz] = ["on_hz", "off_hz", "cost_hz"].map(|key| number(&of[key]));
        assert!((on_hz - off_hz - cost_hz).abs() < 1e-9, "{of}");
    }
    let better = |two: &[Value]| {
        two[0]["duration_s"] != two[1]["duration_s"]
            || number(&two[0]["cost_hz"]) < number(&two[1]["cost_hz"])
    };
    assert!(trace.len() > 1 && trace.windows(2).all(better), "{trace:?}");
}

#[test]
fn a_finger_is_told_under_the_object_and_under_the_pattern() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("dot.toml");
    let made = document(offline().args(["render", "dot", "--method", "rule", "--json", "-o"]).arg(&file));
    let found = document(offline().args(["judge", "--object", "dot", "--fingers", "1", "--json"]).arg(&file));
    let felt = &found["felt"];
    assert_eq!((&felt["finger"], &felt["pattern"]), (&found["fingers"][0], &"dot".into()));
    assert!(number(&felt["seconds"]) >= number(&made["duration_s"]));
    let spikes = |key: &str, class: &str| -> usize {
        let of = rows(&felt["afferents"]).iter().zip(rows(&felt[key]));
        of.filter(|(of, _)| of["class"] == class).map(|(_, train)| rows(train).len()).sum()
    };
    let line = rows(&found["lines"]).iter().find(|line| line["name"] == "dot").unwrap();
    for (index, class) in ["SA1", "RA", "PC"].into_iter().enumerate() {
        let ratio = spikes("pattern_spikes_s", class) as f64 / spikes("object_spikes_s", class) as f64;
        assert!((ratio - number(&line["spikes"][index])).abs() < 1e-9, "{class}: {ratio} {line}");
    }
}
