//! Plays with motions: moves to levels, in open loop and in closed loop, over good and bad lines, cut in each phase.

use firmware_protocol::array::MotorSet;
use meissner_array::pattern::Pattern;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::Line;
use meissner_stream::queues::{At, Command, End, Play, StreamEvent};
use meissner_test_support::rig::{Rig, assert_closed, bad_line, bursts_on_the_lines};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);

fn pattern(rest: &str) -> Pattern {
    Pattern::parse(&format!("format = 2\nname = \"test\"\n{rest}"), "test.toml").unwrap()
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

/// A minute of a sine of 10 Hz and 100 um: with telemetry the pin is near its level all the time, without it drifts.
#[test]
fn closed_loop_follows_a_sine_for_a_minute() {
    let sine = pattern(
        "[[tone]]\nmotor = 9\nfrequency_hz = 10.0\namplitude_um = 100.0\nabout_um = 60.0\nduration_s = 60.0\n\
         envelope = { attack_s = 0.1, release_s = 0.1 }\n",
    );
    let farthest_um = |closed: bool| {
        let mut rig = Rig::armed(Line::default(), 4);
        rig.start_with(&sine, None, |play| play.open_loop = !closed);
        rig.run_ms(1_000);
        let (mut low_um, mut high_um) = (f64::MAX, f64::MIN);
        for _ in 0..58_000 {
            rig.run(MS);
            let um = rig.mock.position_um(9);
            (low_um, high_um) = (low_um.min(um), high_um.max(um));
        }
        rig.run_ms(2_000);
        let outcome = rig.outcomes().remove(0);
        assert_eq!((outcome.end, outcome.bursts.played), (End::Done, outcome.bursts.planned));
        assert_closed(&outcome);
        (10.0 - low_um).max(high_um - 110.0)
    };
    // A burst takes the pin by 30 um at most, and scatters by 10 %.
    let (closed, open) = (farthest_um(true), farthest_um(false));
    assert!(closed < 15.0 && open > 2.0 * closed, "{closed} um with telemetry, {open} um without");
}

/// A cut in each phase of a ramp and a hold: lines are low within the time of the return, and the pins are where they began.
#[test]
fn whatever_cuts_a_ramp_or_a_hold_brings_the_pin_down() {
    #[derive(Clone, Copy, Debug)]
    enum By {
        Stop,
        Disarm,
        EStop,
        Cable,
    }
    for by in [By::Stop, By::Disarm, By::EStop, By::Cable] {
        // Rising, held, falling.
        for ms in [110, 125, 149, 160, 400, 649, 660, 675, 690] {
            let what = format!("{by:?} {ms} ms after the order");
            let mut rig = Rig::armed(Line::default(), 5);
            rig.mock.take_trace();
            let onset = rig.mock.now() + 8_500;
            rig.start_with(&pattern(RAMP), None, |play| play.at = At::Tick(onset));
            rig.run_ms(ms);
            let before = bursts_on_the_lines(&rig.mock.take_trace());
            match by {
                By::Stop => _ = rig.send(Command::Stop),
                By::Disarm => _ = rig.send(Command::Disarm),
                By::EStop => _ = rig.send(Command::EStop),
                By::Cable => rig.unplug(),
            }
            rig.run(5 * MS);
            let cut = bursts_on_the_lines(&rig.mock.take_trace());
            // From 200 um a pin is down in 17.4 ms.
            rig.run(20 * MS);
            let mut net = before.net[9] + cut.net[9] + bursts_on_the_lines(&rig.mock.take_trace()).net[9];
            if matches!(by, By::EStop) {
                assert_eq!(i64::from(rig.mock.controller().outstanding(9)), net, "{what}");
                rig.send(Command::Reset { estops_seen: u64::MAX, keep: true });
                rig.run_ms(20);
                rig.send(Command::Arm { assume_rest: false });
                rig.run_ms(50);
                let back = bursts_on_the_lines(&rig.mock.take_trace());
                net += back.net[9];
                assert!(back.net.iter().all(|&net| net <= 0), "{what}");
            }
            assert_eq!(net, 0, "{what}");
            rig.run_ms(300);
            assert_eq!(bursts_on_the_lines(&rig.mock.take_trace()).count, 0, "{what}");
            let outcome = rig.outcomes().remove(0);
            assert_closed(&outcome);
            assert_eq!(outcome.end, End::Stopped, "{what}");
        }
    }
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
