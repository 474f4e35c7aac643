//! Plays with motions: moves to levels, in open loop and in closed loop, over good and bad lines, cut in each phase.

use firmware_protocol::array::MotorSet;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_array::strokes::{Step, StrokeOptions, Strokes};
use meissner_stream::queues::{At, Command, End, Play, StreamEvent};
use meissner_stream::{Line, rest_bound_um};
use meissner_test_support::rig::{Rig, assert_closed, bad_line, bursts_on_the_lines};
use meissner_test_support::statistics::rms;
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
    println!("24 motors, noise 5 to 50 Hz, 3 s: {} moves, {bytes:.2} bytes each", all.bursts.planned);
    assert!(bytes < 4.0, "{bytes}");
}

/// The level that a motor's steps plan at each tick, in order of time.
struct Planned {
    steps: Vec<Step>,
    next: usize,
    level: f64,
}

impl Planned {
    fn of(pattern: &Pattern, motor: u8, onset: Tick) -> Self {
        let mut strokes = Strokes::new(pattern, &StrokeOptions::default()).unwrap();
        strokes.begin(onset);
        let steps = strokes.map(Result::unwrap).filter(|step| step.motor() == motor).collect();
        Self { steps, next: 0, level: 0.0 }
    }

    fn at(&mut self, tick: Tick) -> f64 {
        while let Some(step) = self.steps.get(self.next).filter(|step| step.end() <= tick) {
            self.level = step.level().into();
            self.next += 1;
        }
        let running = self.steps.get(self.next).filter(|step| step.begin() < tick);
        let burst = running.and_then(|step| step.bursts().next());
        self.level
            + burst.map_or(0.0, |burst| {
                let passed = (tick - burst.start) as f64;
                if burst.direction == Direction::Up { passed } else { -passed }
            })
    }
}

/// A minute of a sine of 10 Hz and 100 um: with telemetry the pin follows it as closely as any loop with this delay can.
#[test]
fn closed_loop_follows_a_sine_for_a_minute() {
    let seconds = 60.0;
    let text = format!(
        "[[tone]]\nmotor = 9\nfrequency_hz = 10.0\namplitude_um = 100.0\nabout_um = 60.0\nduration_s = {seconds:?}\n\
         envelope = {{ attack_s = 0.1, release_s = 0.1 }}\n"
    );
    let sine = pattern(&text);
    let um_per_pulse = Array::paper().motor().um_per_pulse;
    let follow = |closed: bool| {
        let mut rig = Rig::armed(Line::default(), 4);
        rig.start_with(&sine, None, |play| play.open_loop = !closed);
        let mut errors = Vec::new();
        let mut planned = None;
        for _ in 0..(seconds * 1000.0) as u64 + 500 {
            rig.run(MS);
            let now = rig.mock.now();
            if planned.is_none() {
                let started = rig.take_events().iter().find_map(|event| match event {
                    StreamEvent::PlayStarted { onset, .. } => Some(onset.actual),
                    _ => None,
                });
                planned = started.map(|onset| (onset, Planned::of(&sine, 9, onset)));
            }
            if let Some((onset, planned)) = &mut planned {
                let at = now - *onset;
                let wanted = planned.at(now);
                if (85_000..(seconds as u64 - 1) * 85_000).contains(&at) {
                    errors.push(rig.mock.position_um(9) - wanted * um_per_pulse);
                }
            }
        }
        let outcome = rig.outcomes().remove(0);
        assert_eq!((outcome.end, outcome.bursts.played), (End::Done, outcome.bursts.planned));
        assert_closed(&outcome);
        assert!(errors.len() > 50_000, "{}", errors.len());
        (rms(errors), outcome.bursts)
    };
    let ((open, _), (closed, bursts)) = (follow(false), follow(true));
    // Each burst of a sine travels another way: the bound is that of their RMS.
    let moves = Planned::of(&sine, 9, Tick(0)).steps;
    let travels: Vec<f64> = moves.iter().map(|step| f64::from(step.pulses()) * um_per_pulse).collect();
    let per_s = moves.len() as f64 / seconds;
    let bound = rest_bound_um(Array::paper(), per_s / 2.0, rms(travels), 0.1, 5.5, 1000.0);
    println!(
        "10 Hz, 100 um, {seconds} s: error {closed:.2} um rms with telemetry, {open:.1} without; bound {bound:.2}; {bursts:?}"
    );
    assert!(closed <= 1.2 * bound, "{closed} um where the bound is {bound}");
    assert!(open > 3.0 * closed, "{open}");
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
