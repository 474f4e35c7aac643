use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::motor::Ramp;
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_array::strokes::Burst;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_paper::{
    Conditions, Partition, Play, PredictedResponse, PredictionError, Target, judge, predict_response,
};
use meissner_skin::membrane::population;
use meissner_skin::{Ramps, RampsError, Scene, simulate_ramps};
use meissner_test_support::paper::UM_PER_PULSE;
use meissner_test_support::random::Random;
use meissner_test_support::{both, oracle};

const ONSET: Tick = Tick(1_000_003);

fn spikes_of_ramps(scene: &Scene, ramps: impl IntoIterator<Item = (u8, Ramp)>) -> Vec<Vec<f64>> {
    simulate_ramps(scene, &Ramps::new(scene.array(), ramps).unwrap()).unwrap()
}

/// Among them are bursts that move nothing, or in the wrong direction.
#[test]
fn bursts_of_any_gain_give_the_spikes_of_the_oracle() {
    let mut compared = 0;
    for seed in 0..150 {
        let noise_sd = [0.0, 0.05][seed as usize % 2];
        let (theirs, ours) = both::both(oracle::random_scene(seed), noise_sd, seed);
        let mut random = Random::new(seed);
        let mut bursts = oracle::all_bursts(&theirs);
        for (_, burst) in &mut bursts {
            let gain = match random.below(20) {
                0 => 0.0,
                1 => random.between(-0.5, 0.0),
                _ => random.between(0.3, 2.0),
            };
            burst.speed = (burst.speed as f64 * gain) as i64;
        }
        let played = bursts.iter().map(|&(motor, oracle::Burst { start, end, speed })| {
            let ticks = ((end - start) / 2) as u32;
            let um_per_tick = speed as f64 / oracle::FULL as f64 * UM_PER_PULSE;
            (motor as u8, Ramp { start: Tick((start / 2) as u64), ticks, um_per_tick })
        });
        let found = spikes_of_ramps(&ours, played);
        compared += oracle::compare(&oracle::spikes_of_bursts(&theirs, &bursts), &found, 1e-9)
            .unwrap_or_else(|error| panic!("scene {seed}: {error}"));
    }
    assert!(compared > 7_000, "{compared}");
}

#[test]
fn bursts_that_no_motor_can_make_are_refused() {
    let ramp = |start, um_per_tick| Ramp { start: Tick(start), ticks: 100, um_per_tick };
    let refused = |ramps: &[(u8, Ramp)]| Ramps::new(Array::paper(), ramps.iter().copied()).unwrap_err();
    assert_eq!(refused(&[(24, ramp(0, 0.1))]), RampsError::Motor { motor: 24, array: Array::paper() });
    let order = RampsError::Order { motor: 3, start: Tick(99) };
    assert_eq!(refused(&[(3, ramp(0, 0.1)), (4, ramp(5, 0.1)), (3, ramp(99, 0.1))]), order);
    for wrong in [1.4, -1.4, f64::NAN, f64::INFINITY] {
        let line = refused(&[(3, ramp(7, wrong))]).to_string();
        assert!(
            line.starts_with("a burst of motor 3 at tick 7 moves") && line.contains("10 times"),
            "{line}"
        );
    }
    Ramps::new(Array::paper(), [(3, ramp(0, 1.3)), (3, ramp(100, -1.3)), (3, ramp(u64::MAX, 0.0))]).unwrap();
}

fn pattern(name: &str) -> Pattern {
    meissner_test_support::rig::pattern(name)
}

fn play(pattern: &Pattern, seconds: f64) -> Play<'_> {
    Play { pattern, options: StrokeOptions::lasting(seconds), onset: ONSET, observed_s: seconds }
}

/// The bursts of the pattern, from the onset.
fn designed(play: &Play<'_>) -> Vec<(u8, Ramp)> {
    let strokes = Strokes::new(play.pattern, &play.options).unwrap().map(Result::unwrap);
    let ramp = |Burst { start, direction, pulses }| {
        Ramp::new(play.onset + start.0, pulses.into(), direction, UM_PER_PULSE)
    };
    strokes.flat_map(|step| step.bursts().map(move |burst| (step.motor(), ramp(burst)))).collect()
}

/// `judge` simulates a target at rest for a second, and a moving one for one repeat.
#[test]
fn designed_rates_are_the_verdict_on_the_targets_own_population() {
    for name in ["edge-45", "braille-w", "moving-edge", "rotating-edge"] {
        let pattern = pattern(name);
        let target = Target::made_for(&pattern).unwrap();
        let observed_s = if target.moves() { target.duration_s() } else { 1.0 };
        let play = Play { observed_s, ..play(&pattern, target.duration_s()) };
        let seed = target.population_seed();
        let found = predict_response(&play, designed(&play)).unwrap();
        assert_eq!((found.seconds, found.population_seed), (observed_s, seed));
        assert_eq!(found.target.as_deref(), Some(name));
        assert_eq!(found.designed_hz, found.played_hz, "{name}");
        let (rates, conditions) = (found.designed_hz, Conditions::plain(vec![seed], seed));
        let verdict = judge(&target, pattern.drives(), &conditions).unwrap().unwrap();
        assert_eq!(rates.contrast.unwrap().to_bits(), verdict.cost_hz.to_bits(), "{name}");
        assert_eq!((rates.on, rates.off), (Some(verdict.on_hz), Some(verdict.off_hz)), "{name}");
    }
}

/// In two and a half repeats the first frames occur three times, the last ones twice.
#[test]
fn each_frame_counts_in_every_repeat_in_which_it_was_observed_whole() {
    let pattern = pattern("moving-edge");
    let target = Target::made_for(&pattern).unwrap();
    let play = play(&pattern, 2.5);
    let mut random = Random::new(1);
    let mut bursts = designed(&play);
    bursts.iter_mut().for_each(|(_, ramp)| ramp.um_per_tick *= random.between(0.7, 1.3));
    let found = predict_response(&play, bursts.iter().copied()).unwrap();

    let afferents = population(target.population_seed());
    let scene =
        Scene::new(Array::paper(), 2.5, target.population_seed(), vec![], afferents.clone(), *target.model())
            .unwrap();
    let from_onset = bursts.iter().map(|&(m, ramp)| (m, Ramp { start: Tick(ramp.start - ONSET), ..ramp }));
    let spikes = spikes_of_ramps(&scene, from_onset);
    let mut sum = 0.0;
    for frame in target.frames() {
        let (start_s, stop_s) = (frame.start_s.unwrap(), frame.stop_s.unwrap());
        let repeats: Vec<f64> = [0.0, 1.0, 2.0].into_iter().filter(|repeat| repeat + stop_s <= 2.5).collect();
        assert!(repeats.len() == if stop_s <= 0.5 { 3 } else { 2 });
        let in_frame = |t: &&f64| repeats.iter().any(|repeat| (start_s..stop_s).contains(&(**t - repeat)));
        let rate = |train: &Vec<f64>| {
            train.iter().filter(in_frame).count() as f64 / repeats.len() as f64 / (stop_s - start_s)
        };
        let rates: Vec<f64> = spikes.iter().map(rate).collect();
        sum += Partition::of(&frame.shape, target.reach_mm(), &afferents).cost_hz(&rates).unwrap();
    }
    let contrast = found.played_hz.contrast.unwrap();
    assert!((contrast - sum / target.frames().len() as f64).abs() < 1e-9, "{contrast} {sum}");
    assert_ne!(found.played_hz, found.designed_hz);
    // No frame was observed whole.
    let short = predict_response(&Play { observed_s: 0.05, ..play }, bursts.iter().copied()).unwrap();
    assert_eq!((short.played_hz.contrast, short.target.as_deref()), (None, Some("moving-edge")));
}

#[test]
fn without_a_target_only_the_mean_of_all_afferents_is_known() {
    let pattern = pattern("pin-60");
    let play = play(&pattern, 1.0);
    let mut bursts = designed(&play);
    let found = predict_response(&play, bursts.iter().copied()).unwrap();
    assert_eq!(found.designed_hz, found.played_hz);
    assert_eq!((found.target.as_ref(), found.population_seed), (None, 0));
    assert_eq!((found.played_hz.on, found.played_hz.off, found.played_hz.contrast), (None, None, None));
    bursts.iter_mut().for_each(|(_, ramp)| ramp.um_per_tick *= 0.5);
    let less = predict_response(&play, bursts.iter().copied()).unwrap();
    assert!(less.played_hz.all > 0.0 && less.played_hz.all < found.played_hz.all, "{less:?}");
    let json = serde_json::to_value(&less).unwrap();
    assert!(json["designed_hz"]["contrast"].is_null() && json["played_hz"]["all"].is_f64(), "{json}");
    assert_eq!(serde_json::from_value::<PredictedResponse>(json).unwrap(), less);
}

#[test]
fn only_the_observed_time_counts() {
    let pattern = pattern("edge-45-paper");
    let play = play(&pattern, 1.0);
    for nothing in [0.0, -1.0, f64::NAN] {
        let found = predict_response(&Play { observed_s: nothing, ..play.clone() }, []);
        assert!(matches!(found, Err(PredictionError::Nothing { .. })), "{nothing}: {found:?}");
    }
    // No burst was played.
    let silent = predict_response(&play, []).unwrap();
    assert_eq!((silent.played_hz.all, silent.played_hz.contrast), (0.0, Some(0.0)));
    assert!(silent.designed_hz.contrast.unwrap() > 150.0);
    // Bursts before the onset and after the observed time.
    let at = |tick| (6, Ramp::new(Tick(tick), 500, Direction::Up, UM_PER_PULSE));
    let bursts = [at(ONSET.0 - 600)].into_iter().chain(designed(&play)).chain([at(ONSET.0 + 90_000)]);
    let found = predict_response(&play, bursts).unwrap();
    assert_eq!(found.played_hz, found.designed_hz);
    // Longer than requested, and longer than a minute.
    assert_eq!(predict_response(&Play { observed_s: 9.0, ..play.clone() }, []).unwrap().seconds, 1.0);
    let long = Play { options: StrokeOptions::lasting(70.0), observed_s: 65.0, ..play };
    assert_eq!(predict_response(&long, []).unwrap().seconds, 60.0);
}
