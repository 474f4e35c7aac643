//! Motions as steps of a play: repeats, cuts, sequences, scale, and what drives and motions of one motor do together.

use firmware_protocol::moves::Move;
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::reflected_walk::{Bursts, ReflectedWalk, Spread};
use meissner_array::spec::Array;
use meissner_array::strokes::{AutoSurplus, Fit, Sequence, Start, Step, StrokeOptions, Strokes, Surplus};
use proptest::prelude::*;

fn pattern(rest: &str) -> Pattern {
    Pattern::parse(&format!("format = 1\nname = \"test\"\n{rest}"), "test.toml").unwrap()
}

fn steps(pattern: &Pattern, options: &StrokeOptions) -> Vec<Step> {
    Strokes::new(pattern, options).unwrap().map(Result::unwrap).collect()
}

fn moves(steps: &[Step], motor: u8) -> Vec<(u64, u16)> {
    let own = steps.iter().filter(|step| step.motor() == motor);
    own.map(|step| match step {
        Step::Move { of: Move { tick, level, .. }, .. } => (tick.0, *level),
        Step::Stroke(stroke) => panic!("{stroke:?}"),
    })
    .collect()
}

const RAMP: &str = "[[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 0.1\nhold_s = 0.2\nfall_s = 0.1\n";

#[test]
fn a_waveform_whose_ends_meet_is_repeated_without_a_seam() {
    // A whole number of periods about 60 um: the pin does not come down between the repeats.
    let text = "duration_s = 0.5\n[[tone]]\nmotor = 2\nfrequency_hz = 10.0\namplitude_um = 40.0\nabout_um = 60.0\nduration_s = 0.5\n";
    let found = moves(&steps(&pattern(text), &StrokeOptions::lasting(5.0)), 2);
    let within = found.iter().filter(|(tick, _)| (8_500..410_000).contains(tick));
    let (low, high) =
        within.fold((u16::MAX, 0), |(low, high), (_, level)| (low.min(*level), high.max(*level)));
    assert!((290..310).contains(&low) && (575..600).contains(&high), "{low} to {high}");
    assert_eq!(found.last().unwrap().1, 0);
}

#[test]
fn what_stays_below_a_burst_is_over_at_once_however_long_it_lasts() {
    let text = "duration_s = 4000.0\n[[tone]]\nmotor = 2\nfrequency_hz = 10.0\namplitude_um = 0.5\nduration_s = 4000.0\n\
                [[ramp]]\nmotor = 3\nto_um = 0.5\nrise_s = 1000.0\n";
    let strokes = Strokes::new(&pattern(text), &StrokeOptions::lasting(1e8)).unwrap();
    assert!(strokes.is_over() && strokes.work() == 0);
}

#[test]
fn slow_ramps_take_work_in_proportion_to_their_moves() {
    // Up and down in three years: a move a day, between which are ten million steps.
    let text = "[[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 4.9e7\n";
    let mut strokes = Strokes::new(&pattern(text), &StrokeOptions::default()).unwrap();
    let moves = strokes.by_ref().filter(|step| step.as_ref().unwrap().bursts().count() > 0).count();
    // 737 pulses up, seven or more at once, and down again.
    assert!((200..=210).contains(&moves), "{moves}");
    assert!(strokes.work() < 20_000, "{} steps and knots for {moves} moves", strokes.work());
}

#[test]
fn a_move_is_found_with_bounded_work() {
    // A tone below a burst for more than an hour, after one touch; it repeats for three years.
    let text = "duration_s = 4100.0\n[[tone]]\nmotor = 2\nfrequency_hz = 10.0\namplitude_um = 0.5\nduration_s = 4000.0\nstart_s = 1.0\n\
                [[ramp]]\nmotor = 2\nto_um = 100.0\nrise_s = 0.1\n";
    let mut strokes = Strokes::new(&pattern(text), &StrokeOptions::lasting(1e8)).unwrap();
    for _ in 0..5_000 {
        let before = strokes.work();
        strokes.next().unwrap().unwrap();
        assert!(strokes.work() - before < 10_000, "{before} to {}", strokes.work());
    }
}

#[test]
fn a_step_has_few_knots_whatever_the_pattern() {
    // All that fits into 4 ms, the shortest pattern, 16 at once: long ramps, and in the rest of the time short ones.
    let mut text = String::from("duration_s = 0.004\n");
    let mut ramp = |start_s: f64, rise_s: f64| {
        text += &format!(
            "[[ramp]]\nmotor = 9\nto_um = 5.0\nstart_s = {start_s:?}\nrise_s = {rise_s:?}\nshape = \"cosine\"\n"
        );
    };
    for number in 0..4096 {
        ramp(f64::from(number / 16) * 15e-6, 7e-6);
    }
    let pattern = pattern(&text);
    let knots = pattern.waveforms()[0].1.knots().count();
    assert!(knots <= 3 * 4096, "{knots}");
    // The work is that of the knots of each step, over and over.
    let mut strokes = Strokes::new(&pattern, &StrokeOptions::lasting(10.0)).unwrap();
    while let Some(Ok(_)) = strokes.next() {}
    let repeats = 10.0 / 0.004;
    assert!((strokes.work() as f64) < 1.1 * repeats * knots as f64 + 4.0 * 10_000.0, "{}", strokes.work());
}

#[test]
fn a_pattern_is_tried_once_for_all_its_scales() {
    let text =
        "[[noise]]\nmotor = 3\nlow_hz = 5.0\nhigh_hz = 50.0\nrms_um = 10.0\nduration_s = 2.0\nseed = 4\n";
    let pattern = pattern(text);
    let mut sequence = Sequence::new(Array::paper());
    for scale in [1.0, 0.5] {
        let run = sequence.compile(&pattern, &StrokeOptions { scale, ..StrokeOptions::default() }).unwrap();
        sequence.add(run, None, Start::Gap(10.0)).unwrap();
    }
    let strokes = sequence.strokes().unwrap();
    let onset = strokes.onsets().nth(1).unwrap().0;
    let found: Vec<Step> = strokes.map(Result::unwrap).collect();
    let half = steps(&pattern, &StrokeOptions { scale: 0.5, ..StrokeOptions::default() });
    let second = moves(&found, 3).into_iter().filter(|(tick, _)| *tick >= onset);
    assert_eq!(second.map(|(tick, level)| (tick - onset, level)).collect::<Vec<_>>(), moves(&half, 3));
}

#[test]
fn with_a_lower_stop_moves_to_rest_push_by_their_surplus() {
    let options = StrokeOptions { surplus: Surplus::Fixed(5.0), ..StrokeOptions::default() };
    let found = steps(&pattern(RAMP), &options);
    let surplus: Vec<u16> = found.iter().map(Step::surplus).collect();
    let (last, before) = surplus.split_last().unwrap();
    assert!(*last == 37 && before.iter().all(|surplus| *surplus == 0), "{surplus:?}");
}

/// Each burst of an excursion scatters on its own, so the surplus of noise is far from that of one burst as long as all its ways up.
#[test]
fn the_surplus_after_noise_is_that_of_its_bursts() {
    let array = Array::paper();
    let text = "[[noise]]\nmotor = 3\nlow_hz = 5.0\nhigh_hz = 50.0\nrms_um = 10.0\nabout_um = 60.0\nduration_s = 0.8\nseed = 4\n\
                envelope = { attack_s = 0.1, release_s = 0.1 }\n";
    let surplus = |asymmetry: f64| {
        let spread = PerMotor::all(array, Spread { scatter: 0.1, asymmetry });
        let surplus = Surplus::Auto(Box::new(AutoSurplus { spread, rest_error_um: 5.0 }));
        let found = steps(&pattern(text), &StrokeOptions { surplus, ..StrokeOptions::default() });
        let mut bursts = Bursts::default();
        let mut up_um = 0.0;
        for step in &found {
            let Step::Move { of, from } = step else { panic!("{step:?}") };
            let um = (f64::from(of.level) - f64::from(*from)) * array.motor().um_per_pulse;
            bursts.add(um);
            up_um += um.max(0.0);
        }
        let surplus_um = f64::from(found.last().unwrap().surplus()) * array.motor().um_per_pulse;
        let rms = |surplus_um| {
            ReflectedWalk::of_bursts(&bursts, surplus_um, Spread { scatter: 0.1, asymmetry }).rms_um()
        };
        assert!(rms(surplus_um) <= 5.0 && rms(surplus_um - 0.2) > 5.0, "{surplus_um}: {}", rms(surplus_um));
        (surplus_um, up_um)
    };
    let ((even, up_um), (uneven, _)) = (surplus(0.0), surplus(0.05));
    println!("{up_um:.0} um up: surplus {even:.1} um, with an asymmetry of 5 % {uneven:.1} um");
    // Some hundred bursts of some um; the asymmetry is that of all of them.
    assert!(up_um > 300.0 && even < 0.05 * up_um, "{even} of {up_um}");
    assert!((uneven - even - 0.05 * up_um).abs() < 0.02 * up_um, "{even} {uneven} of {up_um}");
}

fn table() -> impl Strategy<Value = (u8, String)> {
    let ramp = (0.0..0.3f64, 1.0..300.0f64, 0.0..0.1f64, 0.0..0.3f64).prop_map(|(start, um, rise, hold)| {
        format!("[[ramp]]\nto_um = {um:?}\nstart_s = {start:?}\nrise_s = {rise:?}\nhold_s = {hold:?}\nfall_s = {rise:?}\n")
    });
    let tone = (0.0..0.3f64, 1.0..100.0f64, 1.0..200.0f64, 0.05..0.6f64).prop_map(|(start, um, hz, lasts)| {
        format!("[[tone]]\namplitude_um = {um:?}\nabout_um = {um:?}\nstart_s = {start:?}\nfrequency_hz = {hz:?}\nduration_s = {lasts:?}\n")
    });
    let drive = (0.0..0.3f64, 1.0..100.0f64, 10.0..200.0f64, 0.05..0.6f64).prop_map(|(start, um, hz, lasts)| {
        format!("[[drive]]\namplitude_um = {um:?}\nstart_s = {start:?}\nfrequency_hz = {hz:?}\nphase = 0.0\nstop_s = {:?}\n", start + lasts)
    });
    (0u8..4, prop_oneof![ramp, tone, drive])
}

proptest! {
    /// Whatever a pattern has, is cut to and repeated: levels are in range, steps in order and not too fast, and the pins end at rest in time.
    #[test]
    fn steps_are_in_order_in_range_and_end_at_rest(
        tables in prop::collection::vec(table(), 1..5),
        duration_s in prop::option::of(1.0..1.5f64),
        seconds in prop::option::of(0.0..4.0f64),
        scale in 0.0..1.0f64,
        fit in prop_oneof![Just(Fit::Whole), Just(Fit::Cover)],
        surplus in prop_oneof![Just(Surplus::None), (0.0..20.0f64).prop_map(Surplus::Fixed)],
    ) {
        let mut text = duration_s.map_or(String::new(), |seconds| format!("duration_s = {seconds:?}\n"));
        for (motor, table) in tables {
            let (head, rest) = table.split_once('\n').unwrap();
            text += &format!("{head}\nmotor = {motor}\n{rest}");
        }
        let text = format!("format = 1\nname = \"test\"\n{text}");
        // Drives and motions of one motor may overlap.
        let Ok(pattern) = Pattern::parse(&text, "test.toml") else { return Ok(()) };
        let options = StrokeOptions { seconds, scale, fit, surplus, ..StrokeOptions::default() };
        let mut strokes = Strokes::new(&pattern, &options).unwrap();
        let (mut levels, mut busy, mut last) = ([0u16; 24], [0u64; 24], 0);
        let steps = strokes.by_ref();
        for step in steps {
            let step = step.unwrap();
            let motor = usize::from(step.motor());
            prop_assert!(step.begin().0 >= busy[motor] && step.begin().0 >= last);
            if let Step::Move { of, from } = step {
                prop_assert_eq!(from, levels[motor]);
                prop_assert!(of.level <= 3_000);
            } else {
                prop_assert_eq!(levels[motor], 0);
            }
            (levels[motor], last) = (step.level(), step.begin().0);
            busy[motor] = step.end().0 - u64::from(step.surplus());
        }
        prop_assert_eq!(levels, [0; 24]);
        if let Some(end) = strokes.end() {
            prop_assert!(busy.iter().all(|busy| *busy <= end), "{:?} after {}", busy, end);
        }
    }
}
