//! What snapshots say that the pins do now, for each kind of play; and the courses of their heights against the simulated shafts.

use firmware_protocol::tick::Tick;
use meissner_array::pattern::Pattern;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::queues::Command;
use meissner_stream::{Line, Settings};
use meissner_test_support::patterns::{self, drive};
use meissner_test_support::rig::{Rig, last_snapshot};
use std::time::Duration;

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

/// A rig of ideal motors, and where its shafts were every 0.2 ms, µm, without the smoothing of the motor.
struct Film {
    rig: Rig,
    shots: Vec<(Tick, Vec<f64>)>,
}

impl Film {
    fn armed(seed: u64) -> Self {
        let rig = Rig::with_motors(Settings::of(Array::paper()), &SimulatedMotorsConfig::ideal(), seed);
        let mut film = Self { rig, shots: Vec::new() };
        film.rig.arm();
        film
    }

    fn shaft_um(&self, tick: Tick, motor: usize) -> f64 {
        let after = self.shots.partition_point(|(shot, _)| *shot < tick).clamp(1, self.shots.len() - 1);
        let [(from, before), (to, after)] = [&self.shots[after - 1], &self.shots[after]];
        let part = (tick.since(*from) as f64 / (*to - *from) as f64).min(1.0);
        before[motor] + part * (after[motor] - before[motor])
    }

    /// Runs on, and compares the course of every pin each 25 ms: in all its length, as who asks for the first time sees it.
    #[track_caller]
    fn run(&mut self, ms: u64, what: &str) {
        for shot in 0..5 * ms {
            self.rig.run(Duration::from_micros(200));
            self.shots.push((self.rig.mock.now(), self.rig.mock.positions_um()));
            if shot % 125 == 0 && self.shots.len() > 1300 {
                self.compare(&format!("{what}, after {} ms", shot / 5));
            }
        }
    }

    #[track_caller]
    fn compare(&mut self, what: &str) {
        let course = self.rig.heights().unwrap();
        assert_eq!(course.pulses.len(), Array::paper().motors(), "{what}");
        let age = self.rig.mock.now().since(course.tick);
        assert!((-100..5_000).contains(&age), "{what}: {age} ticks old");
        for (motor, pulses) in course.pulses.iter().enumerate() {
            for (at, &pulses) in pulses.iter().rev().enumerate() {
                let tick = Tick(course.tick.0 - Array::paper().rate().of_ms(at as u64));
                let (is, said) =
                    (self.shaft_um(tick, motor), f64::from(pulses) * Array::paper().motor().um_per_pulse);
                assert!((said - is).abs() < 1.5, "{what}, pin {motor}, {at} ms ago: {said} um, is {is}");
            }
        }
    }
}

const HELD: &str = "[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = 0.1\nhold_s = 0.2\nfall_s = 0.1\n\
                    [[ramp]]\nmotor = 10\nto_um = 90.0\nrise_s = 0.1\nhold_s = 0.2\nfall_s = 0.1\n";

#[test]
fn the_courses_of_a_drive_a_ramp_and_a_return_are_those_of_the_shafts() {
    let mut film = Film::armed(1);
    film.run(300, "rest");
    film.rig.start(&pattern(HELD), None);
    film.run(700, "ramp");
    film.rig
        .start(&patterns::pattern("one", Some(9.0), vec![drive(3, 60.0, 62.0), drive(4, 300.0, 15.0)]), None);
    film.run(500, "drive");
    film.rig.send(Command::Stop);
    film.run(400, "stop");
    for phase_ms in [60, 150, 330] {
        for order in [|| Command::Stop, || Command::Disarm] {
            film.rig.start(&pattern(HELD), None);
            film.run(phase_ms, "ramp");
            film.rig.send(order());
            film.run(400, &format!("cut after {phase_ms} ms"));
            film.rig.send(Command::Arm { assume_rest: true });
            film.run(100, "arm");
        }
    }
}

/// Rising, holding and falling; then the pins come down with `reset`, or only with `arm`.
#[test]
fn the_courses_around_an_emergency_stop_are_those_of_the_shafts() {
    for (phase_ms, keep) in
        [30, 60, 100, 200, 330, 360, 390].into_iter().flat_map(|ms| [(ms, false), (ms, true)])
    {
        let mut film = Film::armed(phase_ms);
        film.run(300, "rest");
        film.rig.start(&pattern(HELD), None);
        film.run(phase_ms, "ramp");
        film.rig.send(Command::EStop);
        let what = |step: &str| format!("e-stop after {phase_ms} ms, keep {keep}, {step}");
        film.run(400, &what("stop"));
        film.rig.send(Command::Reset { estops_seen: u64::MAX, keep });
        film.run(400, &what("reset"));
        film.rig.send(Command::Arm { assume_rest: false });
        film.run(400, &what("arm"));
        film.rig.start(&pattern(HELD), None);
        film.run(500, &what("the next play"));
    }
}
