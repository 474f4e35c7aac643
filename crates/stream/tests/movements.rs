//! What snapshots say that the pins do now, for each kind of play.

use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_stream::Line;
use meissner_stream::queues::Command;
use meissner_test_support::patterns::{self, drive};
use meissner_test_support::rig::{Rig, last_snapshot};

/// Height, swing and strokes per second of each motor in the last snapshot.
fn now(rig: &mut Rig) -> Vec<(f64, f64, f64)> {
    let snapshot = last_snapshot(&rig.take_events());
    let um = |pulses: u16| f64::from(pulses) * Array::paper().motor().um_per_pulse;
    let of = |pin: &meissner_stream::queues::Movement| {
        let (low, high) = (um(pin.low), um(pin.high));
        (f64::midpoint(low, high), high - low, f64::from(pin.hz))
    };
    snapshot.pins.movements.iter().map(of).collect()
}

#[track_caller]
fn assert_near((height, swing, hz): (f64, f64, f64), wanted: (f64, f64, f64)) {
    let off = [height - wanted.0, swing - wanted.1, hz - wanted.2];
    assert!(off.iter().all(|off| off.abs() < 0.3), "{:?} instead of {wanted:?}", (height, swing, hz));
}

#[track_caller]
fn assert_still(rig: &mut Rig) {
    for pin in now(rig) {
        assert_eq!(pin, (0.0, 0.0, 0.0));
    }
}

fn pattern(rest: &str) -> Pattern {
    Pattern::parse(&format!("format = 1\nname = \"test\"\n{rest}"), "test.toml").unwrap()
}

/// In open loop and in closed loop; the latter changes the pulses and not what was ordered.
#[test]
fn drives_show_their_amplitude_and_frequency_and_after_the_play_nothing() {
    let drives = [drive(3, 60.0, 62.0), drive(4, 300.0, 15.0), drive(5, 12.0, 100.0), drive(6, 3.0, 50.0)];
    let drives = patterns::pattern("four", Some(1.5), drives);
    for open_loop in [true, false] {
        let mut rig = Rig::armed(Line::default(), 1);
        rig.run_ms(1_100);
        assert_still(&mut rig);
        rig.start_with(&drives, None, |play| play.open_loop = open_loop);
        rig.run_ms(1_000);
        let pins = now(&mut rig);
        assert_near(pins[3], (31.0, 62.0, 60.0));
        assert_near(pins[4], (7.5, 15.0, 300.0));
        assert_near(pins[5], (50.0, 100.0, 12.0));
        // Strokes of 3 Hz are longer than what is looked at: one or two changes of direction.
        assert_near((pins[6].0, pins[6].1, 0.0), (25.0, 50.0, 0.0));
        assert!([2.5, 5.0].contains(&pins[6].2), "{:?}", pins[6]);
        assert_eq!(pins[7], (0.0, 0.0, 0.0));
        rig.run_ms(1_300);
        assert_still(&mut rig);
    }
}

/// A stop while one pin is up and the others move.
#[test]
fn after_the_return_of_a_stopped_play_all_are_at_rest() {
    let play = pattern(
        "[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = 0.05\nhold_s = 9.0\nfall_s = 0.05\n\
         [[drive]]\nmotor = 4\nfrequency_hz = 60.0\namplitude_um = 80.0\nphase = 0.0\nstop_s = 9.0\n",
    );
    for stop in [|| Command::Stop, || Command::Disarm] {
        let mut rig = Rig::armed(Line::default(), 3);
        rig.start(&play, None);
        rig.run_ms(1_000);
        rig.send(stop());
        rig.run_ms(110);
        let pins = now(&mut rig);
        assert_near(pins[9], (100.0, 200.0, 2.5));
        assert_near((pins[4].0, pins[4].1, 0.0), (40.0, 80.0, 0.0));
        rig.run_ms(400);
        assert_still(&mut rig);
    }
}
