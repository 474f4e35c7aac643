//! Live plays in virtual time: what the streamer acknowledges is what the lines carry, tick for tick.

use firmware_protocol::tick::Tick;
use meissner_array::motor::SquareWave;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use meissner_array::strokes::{LiveMotion, LiveStrokes};
use meissner_stream::queues::{
    Applied, Command, CommandError, End, LiveResult, LiveUpdate, Outcome, Play, StreamEvent,
};
use meissner_stream::{Line, Source};
use meissner_test_support::at_length;
use meissner_test_support::paper::{MOTORS, RATE};
use meissner_test_support::random::Random;
use meissner_test_support::rig::{
    self, Rig, answer, assert_closed, assert_lines, bad_line, bursts_on_the_lines, into_outcomes, is_driven,
    last_snapshot,
};
use std::collections::HashSet;
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);
const TIMEOUT: Duration = Duration::from_millis(500);

fn wave(frequency_hz: f64, amplitude_um: f64, phase: f64) -> SquareWave {
    SquareWave::new(Array::paper(), frequency_hz, amplitude_um, phase).unwrap()
}

/// The same for every motor.
fn all<T: Copy>(value: T) -> PerMotor<T> {
    PerMotor::all(Array::paper(), value)
}

fn steady() -> PerMotor<SquareWave> {
    all(wave(60.0, 80.0, 0.0))
}

/// A live play, and what is known of it.
struct LivePlay {
    rig: Rig,
    id: u64,
    number: u64,
    initial: PerMotor<SquareWave>,
    sent: Vec<PerMotor<Option<SquareWave>>>,
    events: Vec<StreamEvent>,
}

impl LivePlay {
    fn start(line: Line, seed: u64, initial: PerMotor<SquareWave>) -> Self {
        Self::of(Rig::armed(Line::default(), seed), line, initial)
    }

    fn of(mut rig: Rig, line: Line, initial: PerMotor<SquareWave>) -> Self {
        rig.set_line(line);
        rig.mock.take_trace();
        let id = rig.start_live(initial, TIMEOUT);
        rig.run_ms(50);
        Self { rig, id, number: 0, initial, sent: vec![all(None)], events: vec![] }
    }

    fn update(&mut self, waves: PerMotor<Option<SquareWave>>) {
        self.sent.push(waves);
        self.send(waves.map(|wave| wave.map(Into::into)));
    }

    fn send(&mut self, motions: PerMotor<Option<LiveMotion>>) {
        self.number += 1;
        let update =
            LiveUpdate { motions, ..LiveUpdate::new(Array::paper(), self.id, self.number, self.rig.now()) };
        self.rig.send(Command::UpdateLive(Box::new(update)));
    }

    fn run(&mut self, time: Duration) {
        self.rig.run(time);
        let events = self.rig.take_events();
        self.events.extend(events);
    }

    /// What became of each update, by its number.
    fn results(&self) -> Vec<(u64, LiveResult)> {
        let of = |event: &StreamEvent| match event {
            StreamEvent::LiveUpdated(update) => Some((update.number, update.result)),
            _ => None,
        };
        self.events.iter().filter_map(of).collect()
    }

    fn applied(&self) -> Vec<(u64, Applied)> {
        let of = |(number, result)| match result {
            LiveResult::Applied(applied) => Some((number, applied)),
            _ => None,
        };
        self.results().into_iter().filter_map(of).collect()
    }

    /// Ends the play, when all motors have been silent for longer than the lead, and compares every line with what was
    /// acknowledged; strokes reported as late are missing.
    fn check(mut self) -> (Outcome, Vec<(u64, Applied)>) {
        self.update(all(Some(wave(60.0, 0.0, 0.0))));
        self.run(400 * MS);
        self.rig.send(Command::EndLive(self.id));
        self.run(400 * MS);
        let applied = self.applied();
        assert_eq!(self.results().len() as u64, self.number, "each update comes back once");
        let late: HashSet<(u8, Tick)> = self
            .events
            .iter()
            .filter_map(|event| match event {
                StreamEvent::StrokeLate { motor, up, .. } => Some((*motor, *up)),
                _ => None,
            })
            .collect();
        let outcome = into_outcomes(self.events).pop().expect("it ended");
        assert_closed(&outcome);
        assert_eq!((outcome.end, outcome.bursts.dropped, outcome.bursts.refused), (End::Stopped, 0, 0));
        let trace = self.rig.mock.take_trace();
        for &(motor, up) in &late {
            assert!(
                !is_driven(&trace, motor, up),
                "motor {motor} plays a stroke at {up:?}, which was reported as late"
            );
        }
        let mut live = LiveStrokes::new(self.initial);
        live.begin(outcome.onset.expect("it began").actual);
        // One for each motor, because the others' strokes are returned, too.
        let mut lives = vec![live; MOTORS];
        let mut strokes: Vec<Stroke> = Vec::new();
        // Updates that were merged into this one may have brought it.
        let waves = |number: u64, motor: usize| {
            self.sent[..=number as usize].iter().rev().find_map(|sent| sent[motor])
        };
        for (number, applied) in &applied {
            assert!(applied.replaced >= applied.received, "update {number}: {applied:?}");
            for (motor, from) in applied.motors.iter().enumerate() {
                let Some(from) = *from else { continue };
                let motor = motor as u8;
                let live = &mut lives[usize::from(motor)];
                let wave = waves(*number, usize::from(motor)).expect("it was sent");
                let begin = match boundaries(live, motor, wave, applied, from)[..] {
                    [begin] => begin,
                    // Both are as acknowledged; the account counts which it was.
                    [early, late] if is_driven(&trace, motor, early) => late,
                    [early, _] => early,
                    _ => panic!("update {number}, motor {motor}: {from:?} is on no grid"),
                };
                while live.next_up(motor).is_some_and(|up| up < begin) {
                    strokes.extend(
                        live.map(|step| step.unwrap().stroke().unwrap()).find(|stroke| stroke.motor == motor),
                    );
                }
                live.replace(motor, wave.into(), begin);
            }
        }
        strokes.retain(|stroke| !late.contains(&(stroke.motor, stroke.up)));
        strokes.sort_by_key(|stroke| stroke.up);
        assert_lines(&trace, &strokes);
        assert_eq!(outcome.bursts.played, 2 * strokes.len() as u64);
        assert_eq!(outcome.bursts.late, 2 * late.len() as u64);
        (outcome, applied)
    }
}

/// The beginnings of the motor's periods from which its new drive may have begun, with the first stroke at `from`. It is the first
/// period after the tick named; of a repeated update, a frame before the last may have brought it.
///
/// `from` alone does not tell the period. With a phase of almost a whole turn, a drive that begins in one period waits for a
/// turn, and in the next one it begins at once: both give the same first stroke. Then the old drive's stroke of the first period
/// is replaced, or played.
fn boundaries(live: &LiveStrokes, motor: u8, wave: SquareWave, applied: &Applied, from: Tick) -> Vec<Tick> {
    let period = |tick| live.clone().replace(motor, live.motion(motor), tick);
    let first = if applied.repeats == 0 { applied.replaced } else { applied.received };
    let periods = std::iter::successors(Some(period(first)), |begin| Some(period(*begin + 1)));
    let until = period(applied.replaced);
    let brings = |begin: &Tick| live.clone().replace(motor, wave.into(), *begin) == from;
    periods.take_while(|begin| *begin <= until).filter(brings).collect()
}

/// Some motors' random drives.
fn random_waves(random: &mut Random) -> PerMotor<Option<SquareWave>> {
    let share = random.between(0.0, 1.0);
    PerMotor::from_fn(Array::paper(), |_| {
        random.chance(share).then(|| {
            let hz = if random.chance(0.5) { 60.0 } else { random.between(5.0, 300.0) };
            let um = if random.chance(0.2) { 0.0 } else { random.between(5.0, 150.0) };
            wave(hz, um, if random.chance(0.7) { 0.0 } else { random.between(0.0, 1.0) })
        })
    })
}

#[test]
fn what_is_acknowledged_is_on_the_lines_tick_for_tick() {
    for seed in 0..4 {
        let mut random = Random::new(seed);
        let mut live = LivePlay::start(Line::default(), seed, steady());
        for _ in 0..1_000 {
            let waves = random_waves(&mut random);
            live.update(waves);
            live.run(Duration::from_secs_f64(random.between(0.001, 0.02)));
        }
        let (outcome, applied) = live.check();
        assert_eq!(outcome.bursts.late, 0);
        assert!(applied.len() > 900 && outcome.bursts.replaced > 10_000, "{} {outcome:?}", applied.len());
        assert_eq!(applied.iter().map(|(_, applied)| applied.repeats).sum::<u32>(), 0);
    }
}

#[test]
fn a_lossy_line_delays_updates_and_loses_no_count() {
    // The later seeds have: a stroke of an undecided update too late to be sent (9, 13), an update while the window is full and
    // what is sent is over (21), a new drive's first stroke where two of the motor's periods may have brought it (5, 137).
    for seed in (0..at_length(1, 6)).chain([9, 13, 21, 137]) {
        let mut random = Random::new(seed);
        let mut live = LivePlay::start(bad_line(), seed, steady());
        for _ in 0..1_000 {
            let waves = random_waves(&mut random);
            live.update(waves);
            live.run(Duration::from_secs_f64(random.between(0.001, 0.03)));
        }
        let (_, applied) = live.check();
        let repeats: u32 = applied.iter().map(|(_, applied)| applied.repeats).sum();
        // Updates that come too fast are merged.
        let merged = 1_001 - applied.len();
        assert!(repeats > 0 && applied.len() > 300 && merged > 20, "{repeats} repeats, {merged} merged");
    }
}

/// The rest of a running stroke is at most a period; what comes before it is the way to the device.
#[test]
fn on_a_good_line_an_update_is_decided_within_three_milliseconds() {
    let mut random = Random::new(5);
    let mut live = LivePlay::start(Line::default(), 5, steady());
    for _ in 0..2_000 {
        let um = random.between(20.0, 100.0);
        live.update(all(Some(wave(60.0, um, 0.0))));
        live.run(10 * MS);
    }
    let (outcome, applied) = live.check();
    assert_eq!((outcome.bursts.late, applied.len()), (0, 2_001));
    for (number, Applied { received, replaced, motors, .. }) in &applied {
        let decided = RATE.ticks_to_ms(*replaced - *received);
        assert!(decided <= 3.0, "update {number}: {decided} ms");
        assert!(motors.iter().flatten().all(|from| *from - *replaced <= 1_417));
    }
}

#[test]
fn a_stop_or_an_e_stop_in_the_middle_of_an_update_ends_it_at_once() {
    for command in [|| Command::Stop, || Command::EStop, || Command::Disarm] {
        for wait in 0..12 {
            let mut live = LivePlay::start(Line { delay: 2 * MS, ..Line::default() }, wait, steady());
            live.update(all(Some(wave(150.0, 40.0, 0.0))));
            live.run(Duration::from_micros(500) * wait as u32);
            live.rig.send(command());
            live.run(800 * MS);
            assert_eq!(live.results().len(), 1, "each update comes back once");
            let outcome = into_outcomes(live.events).pop().expect("it ended");
            assert_closed(&outcome);
            let counters = live.rig.mock.controller().counters();
            let (played, replaced) = (outcome.bursts.played, outcome.bursts.replaced);
            assert_eq!((counters.played, counters.replaced), (played, replaced), "{wait}");
        }
    }
}

#[test]
fn a_live_play_is_not_queued() {
    let mut rig = Rig::armed(Line::default(), 8);
    rig.start(&rig::pattern("pin-60"), Some(1.0));
    rig.run_ms(100);
    let strokes = Source::Live(Box::new(LiveStrokes::new(steady())));
    let play = Play { live: Some(TIMEOUT), ..Play::new(9, strokes) };
    let ticket = rig.send(Command::Play(Box::new(play)));
    assert_eq!(answer(&rig.take_events(), ticket), Some(Err(CommandError::Playing)));
    rig.run_ms(2_000);
    assert_eq!(rig.outcomes()[0].end, End::Done);
}

/// Levels at 60 Hz over good and bad lines, and of all pins as often as clients may send them, evenly and in bunches: the device refuses no
/// move, each pin is at the last level that it was given, glides in between, and is at rest at the end. A client that falls silent has its
/// pins brought down.
#[test]
fn pins_follow_levels_and_come_down() {
    let array = Array::paper();
    for (seed, line, (every_ms, updates, share, most), glides) in [
        (1, Line::default(), (16.667, 10, 0.3, 2_000.0), [0, 1_417]),
        (3, bad_line(), (16.667, 10, 0.3, 2_000.0), [0, 1_417]),
        (4, bad_line(), (16.667, 10, 0.3, 2_000.0), [0, 1_417]),
        (1, Line::default(), (2.0, 125, 1.0, 700.0), [0, 0]),
        (1, Line::default(), (2.0, 125, 1.0, 700.0), [425, 425]),
        (1, Line::default(), (2.0, 125, 1.0, 700.0), [1_700, 1_700]),
    ] {
        for ends in [true, false] {
            let mut live = LivePlay::start(line, seed, all(wave(60.0, 0.0, 0.0)));
            let (mut random, mut net, mut wanted) = (Random::new(seed), [0_i64; MOTORS], [0_u16; MOTORS]);
            let add = |live: &mut LivePlay, net: &mut [i64; MOTORS]| {
                let more = bursts_on_the_lines(&live.rig.mock.take_trace()).net;
                net.iter_mut().zip(more).for_each(|(net, more)| *net += more);
            };
            for round in 0..4 {
                for _ in 0..updates {
                    let motions = PerMotor::from_fn(array, |motor| {
                        random.chance(share).then(|| {
                            let pulses =
                                if random.chance(0.2) { 0.0 } else { random.between(0.0, most) } as u16;
                            wanted[usize::from(motor)] = pulses;
                            LiveMotion::Level { array, pulses, glide_ticks: glides[random.below(2)] }
                        })
                    });
                    live.send(motions);
                    let wait_ms = if round % 2 == 0 { every_ms } else { random.between(0.0, 2.0 * every_ms) };
                    live.run(Duration::from_micros((wait_ms * 1e3) as u64));
                }
                // Until the last glide is over.
                live.run(100 * MS);
                add(&mut live, &mut net);
                assert_eq!(net, wanted.map(i64::from), "seed {seed}, round {round}, glides {glides:?}");
            }
            if ends {
                live.rig.send(Command::EndLive(live.id));
            }
            live.run(TIMEOUT + 500 * MS);
            add(&mut live, &mut net);
            assert_eq!(net, [0; MOTORS], "seed {seed}");
            let outcome = into_outcomes(live.events).pop().expect("it ended");
            assert_closed(&outcome);
            assert_eq!((outcome.end, outcome.bursts.refused, outcome.bursts.late), (End::Stopped, 0, 0));
        }
    }
}

/// A level that is not changed for a minute: the pin comes down by itself, its client is still there, and the next level is reached.
#[test]
fn a_pin_that_is_held_for_too_long_comes_down_and_follows_the_next_level() {
    let array = Array::paper();
    let mut live = LivePlay::start(Line::default(), 6, all(wave(60.0, 0.0, 0.0)));
    let level = |live: &mut LivePlay, pulses| {
        let mut motions = all(None);
        motions[4] = Some(LiveMotion::Level { array, pulses, glide_ticks: 1_700 });
        live.send(motions);
        live.run(100 * MS);
    };
    level(&mut live, 700);
    let mut down_at = None;
    for tenth in 0..620 {
        live.update(all(None));
        live.run(100 * MS);
        if down_at.is_none() && live.rig.mock.controller().outstanding(4) == 0 {
            down_at = Some(tenth);
        }
    }
    assert!(down_at.is_some_and(|tenth| (595..=605).contains(&tenth)), "{down_at:?}");
    level(&mut live, 300);
    assert_eq!(bursts_on_the_lines(&live.rig.mock.take_trace()).net[4], 300);
    live.rig.send(Command::EndLive(live.id));
    // Until a status says that the pins are still.
    live.run(2_000 * MS);
    assert_eq!(bursts_on_the_lines(&live.rig.mock.take_trace()).net[4], -300);
    let (known, is) = (f64::from(last_snapshot(&live.events).pins.rest.um[4]), live.rig.mock.position_um(4));
    assert_closed(&into_outcomes(live.events).pop().expect("it ended"));
    assert!((known - is).abs() < 2.0, "{known} um where the pin is at {is} um");
}
