//! Predicted responses to simulated plays: with position control and without, cut, and unmeasured.

use meissner::receipts::{NoPrediction, PlayedPattern};
use meissner_array::pattern::Pattern;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_array::strokes::StrokeOptions;
use meissner_paper::{MOST_OBSERVED_S, Play, predict_response};
use meissner_stream::{Settings, SimulatedPlay, simulate_play};
use meissner_test_support::paper::TICK_HZ;
use meissner_test_support::played::by_simulated_motors;
use meissner_test_support::rig::pattern;
use std::collections::HashSet;

fn played(pattern: &Pattern, seconds: f64, motors: &SimulatedMotorsConfig, open_loop: bool) -> SimulatedPlay {
    simulate_play(pattern, Some(seconds), motors, Settings::of(Array::paper()), open_loop).unwrap()
}

fn measured_play<'p>(pattern: &'p Pattern, seconds: f64, played: &SimulatedPlay) -> PlayedPattern<'p> {
    let onset = played.outcome.onset.unwrap().actual;
    PlayedPattern {
        pattern,
        options: StrokeOptions::lasting(seconds),
        onset,
        cut: false,
        unplayed: HashSet::new(),
    }
}

/// A minute of a shipped edge. In open loop, pins drift to their end stops and go on vibrating there. Afferents respond to
/// velocity, so the contrast falls no more than by the corrections of position control.
#[test]
fn an_edge_keeps_nearly_its_designed_contrast_with_and_without_position_control() {
    let edge = pattern("edge-45-paper");
    let motors = SimulatedMotorsConfig::default();
    let [closed, open] = [false, true].map(|open_loop| {
        let played = played(&edge, MOST_OBSERVED_S, &motors, open_loop);
        assert_eq!(played.outcome.bursts.played, played.outcome.bursts.planned);
        let found = measured_play(&edge, MOST_OBSERVED_S, &played).response(&played.measured_bursts).unwrap();
        assert_eq!((found.unmeasured, found.seconds), (0, MOST_OBSERVED_S));
        (found, played.rest.max_abs_um, played.outcome.onset.unwrap().actual)
    });
    let contrast = |contrast: Option<f64>| contrast.unwrap();
    let (designed, with, without) = (
        contrast(closed.0.designed_hz.contrast),
        contrast(closed.0.played_hz.contrast),
        contrast(open.0.played_hz.contrast),
    );
    println!("designed {designed:.2}, with the loop {with:.2}, without {without:.2} impulses/s");
    assert_eq!(closed.0.designed_hz, open.0.designed_hz);
    assert!(designed > 150.0 && (with / designed - 1.0).abs() < 0.03, "{designed} {with}");
    assert!((without / designed - 1.0).abs() < 0.1, "{designed} {without}");
    // The estimator ignores end stops, so it reports a little too much travel for bursts that meet one.
    let options = StrokeOptions::lasting(MOST_OBSERVED_S);
    let play = Play { pattern: &edge, options, onset: open.2, observed_s: MOST_OBSERVED_S, by_class: false };
    let truth = contrast(
        predict_response(&play, by_simulated_motors(motors, &play, u16::MAX)).unwrap().played_hz.contrast,
    );
    println!("in truth without {truth:.2}");
    assert!((without - truth).abs() < 2.0, "{without} {truth}");
    // The pins did drift.
    assert!(closed.1 < 100.0 && open.1 > 300.0, "{} {}", closed.1, open.1);
}

#[test]
fn ideal_motors_give_the_designed_response() {
    let edge = pattern("edge-45-paper");
    let played = played(&edge, 2.0, &SimulatedMotorsConfig::ideal(), true);
    let found = measured_play(&edge, 2.0, &played).response(&played.measured_bursts).unwrap();
    let [designed, played] = [found.designed_hz, found.played_hz].map(|rates| rates.contrast.unwrap());
    // Telemetry has a quantum of 0.01 um.
    assert!((designed - played).abs() < 0.1, "{designed} {played}");
    let classes: Vec<_> = found.afferents.iter().map(|of| of.class.name()).collect();
    assert_eq!(classes, ["SA1", "RA", "PC"]);
    let [designed, played] = [found.afferents[1].designed_hz, found.afferents[1].played_hz];
    let [designed, played] = [designed, played].map(|rates| rates.contrast.unwrap());
    assert!(designed > 5.0 && (designed - played).abs() < 0.1, "{designed} {played}");
}

#[test]
fn unmeasured_bursts_are_counted_and_too_many_prevent_a_prediction() {
    let edge = pattern("edge-45-paper");
    let played = played(&edge, 2.0, &SimulatedMotorsConfig::default(), false);
    let bursts = played.outcome.bursts.played;
    let mut play = measured_play(&edge, 2.0, &played);
    let without = |one_in: usize| -> Vec<_> {
        let some = played.measured_bursts.iter().enumerate().filter(|(n, _)| n % one_in > 0);
        some.map(|(_, travel)| *travel).collect()
    };
    let found = play.response(&without(200)).unwrap();
    assert_eq!(found.unmeasured, bursts.div_ceil(200));
    let missing = bursts.div_ceil(50);
    assert_eq!(play.response(&without(50)), Err(NoPrediction::Unmeasured { missing, bursts }));
    assert_eq!(play.response(&[]), Err(NoPrediction::Unmeasured { missing: bursts, bursts }));
    // The streamer's own estimate does not count as a measurement.
    let mut reckoned = played.measured_bursts.clone();
    reckoned.iter_mut().for_each(|travel| travel.sd_um = 0.1 * travel.travel_um.abs());
    assert_eq!(play.response(&reckoned), Err(NoPrediction::Unmeasured { missing: bursts, bursts }));
    // Late strokes have nothing to measure.
    let late: Vec<_> =
        played.measured_bursts.iter().filter(|travel| travel.travel_um > 0.0).step_by(20).collect();
    play.unplayed = late.iter().map(|travel| (travel.motor, travel.start)).collect();
    let gone = |travel: &&meissner_stream::queues::MeasuredBurst| {
        !play.unplayed.contains(&(travel.motor, travel.start))
    };
    let left: Vec<_> = played.measured_bursts.iter().filter(gone).copied().collect();
    // Their down bursts are measured here, but not needed.
    let less = play.response(&left).unwrap();
    assert_eq!(less.unmeasured, 0);
    assert!(less.played_hz.all < found.played_hz.all, "{less:?}");
}

#[test]
fn a_cut_play_counts_up_to_its_cut() {
    let edge = pattern("edge-45-paper");
    let played = played(&edge, 2.0, &SimulatedMotorsConfig::default(), false);
    let mut play = measured_play(&edge, 60.0, &played);
    play.cut = true;
    let found = play.response(&played.measured_bursts).unwrap();
    assert!(found.seconds > 1.9 && found.seconds < 2.0, "{found:?}");
    assert_eq!(found.unmeasured, 0);
    let early: Vec<_> = played
        .measured_bursts
        .iter()
        .filter(|travel| travel.start - play.onset < u64::from(TICK_HZ) / 100)
        .copied()
        .collect();
    assert!(!early.is_empty());
    assert_eq!(play.response(&early), Err(NoPrediction::Cut));
    assert_eq!(play.response(&[]), Err(NoPrediction::Cut));
}
