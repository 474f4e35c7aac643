//! Plays with motions: moves to levels, in open loop and in closed loop, over good and bad lines, cut in each phase.

use firmware_protocol::array::MotorSet;
use meissner_array::pattern::Pattern;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::Line;
use meissner_stream::queues::{At, End, Play, StreamEvent};
use meissner_test_support::rig::{Rig, bad_line};

fn pattern(rest: &str) -> Pattern {
    Pattern::parse(&format!("format = 1\nname = \"test\"\n{rest}"), "test.toml").unwrap()
}

fn noise_of_all(seconds: f64) -> Pattern {
    let noise = |motor: u8| {
        format!(
            "[[noise]]\nmotor = {motor}\nlow_hz = 5.0\nhigh_hz = 50.0\nrms_um = 12.0\nduration_s = {seconds:?}\nseed = {motor}\n"
        )
    };
    pattern(&(0..24).map(noise).collect::<String>())
}

const RAMP: &str = "[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = 0.05\nhold_s = 0.5\nfall_s = 0.05\n";

const MIXED: &str = "[[tone]]\nmotor = 3\nfrequency_hz = 40.0\namplitude_um = 60.0\nduration_s = 0.5\nenvelope = \"hann\"\n\
    [[drive]]\nmotor = 4\nfrequency_hz = 60.0\namplitude_um = 80.0\nphase = 0.0\nstop_s = 0.6\n\
    [[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = 80.0\nphase = 0.0\nstart_s = 0.6\nstop_s = 0.9\n";

#[test]
fn motions_are_played_tick_for_tick_over_good_and_bad_lines() {
    for (seed, line) in [(1, Line::default()), (2, bad_line())] {
        let mut rig = Rig::armed(line, seed);
        let mixed = rig.play_exactly(&pattern(&format!("{RAMP}{MIXED}")), 1.0);
        assert_eq!(mixed.end, End::Done);
    }
    let mut rig = Rig::armed(Line::default(), 3);
    let all = rig.play_exactly(&noise_of_all(3.0), 3.0);
    let bytes = all.wire_bytes as f64 / all.bursts.planned as f64;
    assert!(bytes < 4.0, "{bytes}");
}

/// The device brings down a pin that is held for longer than its play allows, and the play's receipt is told which, when and why.
#[test]
fn a_pin_that_the_device_has_lowered_is_booked_to_its_play() {
    let (rate, mut rig) = (Array::paper().rate(), Rig::armed(Line::default(), 6));
    // A play before it has no part in it.
    rig.play_exactly(&pattern(MIXED), 1.0);
    let (hold, onset) = (Array::paper().layout().least_hold(), rig.mock.now() + 8_500);
    let change = |play: &mut Play| (play.at, play.hold) = (At::Tick(onset), hold);
    rig.start_with(&pattern(RAMP), None, change);
    rig.run_ms(1_500);
    let lowered: Vec<_> = rig
        .take_events()
        .into_iter()
        .filter_map(|event| match event {
            StreamEvent::PinsLowered { id, tick, late, held } => Some((id, tick, late, held)),
            _ => None,
        })
        .collect();
    let [(id, tick, late, held)] = lowered[..] else { panic!("{lowered:?}") };
    assert_eq!((id, late, held), (2, MotorSet::EMPTY, MotorSet::from_bits(1 << 9)));
    // The pin is up 0.05 s after the onset. Holds are looked at every 12 ms.
    let held_s = rate.ticks_to_seconds(tick - onset) - 0.05;
    assert!((0.2..0.22).contains(&held_s), "{held_s}");
}

/// The pin waits for the drivers before it comes down: that teaches position control nothing of its motor.
#[test]
fn a_pin_that_the_device_has_lowered_is_controlled_as_before() {
    let mut rig = Rig::of(&SimulatedMotorsConfig::ideal(), 7);
    rig.arm();
    let ramp = pattern("[[ramp]]\nmotor = 9\nto_um = 13.0\nrise_s = 0.1\nhold_s = 0.5\nfall_s = 0.1\n");
    let hold = Array::paper().layout().least_hold();
    rig.start_with(&ramp, None, |play| (play.open_loop, play.hold) = (false, hold));
    rig.run_ms(1_500);
    let lowered = |event: &StreamEvent| matches!(event, StreamEvent::PinsLowered { .. });
    assert!(rig.take_events().iter().any(lowered));
    let drive = pattern("[[drive]]\nmotor = 9\nfrequency_hz = 10.0\namplitude_um = 80.0\n");
    rig.start_closed(&drive, Some(0.2));
    rig.run_ms(1_000);
    let um = rig.mock.position_um(9);
    assert!(um.abs() < 1.0, "{um}");
}
