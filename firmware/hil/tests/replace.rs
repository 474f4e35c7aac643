//! Frames that replace queued strokes, in every phase of the strokes that run: no stroke is cut, each new one begins at its tick,
//! each old one is played whole or not at all, and all are counted.

use crate::hand::{Hand, Verdicts};
use crate::random::uniform;
use firmware_protocol::controller::POOL;
use firmware_protocol::message::{Cause, Counters, Op, State};
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::time::{MS, TICK};
use meissner_test_support::paper::MOTORS;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Ticks for which strokes are queued ahead.
const LEAD: u64 = 2_600;
/// Ticks from now to the first stroke of a motor that has none.
const SOON: u64 = 400;
/// Ticks from the moment of sending to `base`, from too late over the horizon to far.
const AHEAD: [i64; 17] = [-500, -200, -60, 0, 30, 60, 75, 90, 100, 110, 120, 135, 160, 200, 350, 700, 1_300];
/// A base so far ahead is never too late.
const FAR: i64 = 350;
/// Ticks of the shortest period that a pattern may have: 300 Hz.
const SHORTEST: u64 = 283;
/// The golden ratio, whose multiples spread evenly over a period.
const GOLDEN: f64 = 0.618_033_988_749_895;
const ALL: u32 = (1 << MOTORS) - 1;

fn pick(random: &mut ChaCha8Rng, range: std::ops::Range<u64>) -> u64 {
    uniform(random, range.start as f64, range.end as f64) as u64
}

/// Strokes of a motor from `up` on: all alike, with a frequency, amplitude and holding time drawn for them. The way down of the first one
/// begins long enough after that of the stroke before.
fn train(
    random: &mut ChaCha8Rng,
    motor: u8,
    up: Tick,
    before: Option<&Stroke>,
    until: Tick,
    pause: u64,
) -> Vec<Stroke> {
    let pulses = pick(random, 5..90) as u16;
    let (held, pause) = (pick(random, 1..130), pick(random, 0..pause));
    let down = before.map_or(Tick(0), |before| before.down + least_apart());
    let up = up.max(Tick(down.0.saturating_sub(u64::from(pulses) + held)));
    let period = (2 * u64::from(pulses) + held + pause).max(SHORTEST);
    let ups = (0..).map(|n| up + n * period).take_while(|&up| up < until);
    let stroke = |up: Tick| {
        let down = up + u64::from(pulses) + held;
        Stroke { motor, up, up_pulses: pulses, down, down_pulses: pulses }
    };
    ups.map(stroke).collect()
}

/// Ticks from a move of a motor to the next but one.
fn least_apart() -> u64 {
    Array::paper().layout().least_apart().into()
}

/// When the next stroke of the motor may begin.
fn free(stroke: &Stroke) -> Tick {
    stroke.end().max(stroke.up + least_apart())
}

fn bits(mask: u32) -> impl Iterator<Item = u8> {
    (0..MOTORS as u8).filter(move |motor| mask >> motor & 1 == 1)
}

/// Random strokes for some motors, with random pauses up to `pause` ticks.
struct Play {
    hand: Hand,
    random: ChaCha8Rng,
    motors: u32,
    pause: u64,
    /// The motors that the last replacement came too late for: they take strokes from the next one on.
    kept: u32,
}

impl Play {
    fn new(which: &Which, host_timeout: u32, motors: u32, pause: u64) -> Self {
        let random = ChaCha8Rng::seed_from_u64(motors.into());
        Self { hand: Hand::armed(which, host_timeout), random, motors, pause, kept: 0 }
    }

    /// Appends strokes, so that each motor has some for the lead.
    fn extend(&mut self) {
        if self.kept != 0 {
            let kept = std::mem::take(&mut self.kept);
            let base = self.hand.tick() + 2 * SOON;
            self.replace(kept, base, false, false);
        }
        let now = self.hand.tick();
        let planned = self.hand.planned();
        let mut new = Vec::new();
        for motor in bits(self.motors) {
            let last = planned.iter().filter(|stroke| stroke.motor == motor).max_by_key(|stroke| stroke.up);
            let pause = pick(&mut self.random, 0..self.pause);
            let up = last.map_or(now, |last| free(last) + pause).max(now + 2 * SOON);
            new.extend(train(&mut self.random, motor, up, last, now + LEAD, self.pause));
        }
        self.hand.append(new);
        self.hand.settle();
    }

    /// Replaces, and returns what the device answers.
    fn replace(&mut self, motors: u32, base: Tick, silences: bool, at_once: bool) -> Verdicts {
        let from = self.hand.tap.events.len();
        self.send_replacement(motors, base, silences, at_once);
        self.hand.settle();
        let verdicts = self.hand.verdicts(from);
        self.kept |= verdicts.kept;
        verdicts
    }

    /// Replaces from `base` on; some of the motors get no new strokes if `silences`. Each first stroke follows the last one that
    /// begins before `base`, often at once.
    fn send_replacement(&mut self, motors: u32, base: Tick, silences: bool, at_once: bool) {
        let planned = self.hand.planned();
        let now = self.hand.tick();
        let until = now + LEAD;
        let mut new = Vec::new();
        for motor in bits(motors) {
            if silences && pick(&mut self.random, 0..2) == 0 {
                continue;
            }
            let before = planned.iter().filter(|stroke| stroke.motor == motor && stroke.up < base);
            let last = before.max_by_key(|stroke| stroke.up);
            let end = last.map_or(base, free).max(base);
            let mut up = end + pick(&mut self.random, 0..3) * pick(&mut self.random, 0..100);
            if base < now && pick(&mut self.random, 0..2) == 0 {
                // In time, although the base is not.
                up = up.max(now + pick(&mut self.random, 100..400));
            }
            new.extend(train(&mut self.random, motor, up, last, until, self.pause));
        }
        self.hand.replace(motors, base, new, at_once);
    }

    /// Runs to a moment in a stroke of `motor`, or in the pause after it: `phase` is the part of the period that has passed.
    /// Returns 0 in the up burst, 1 in the hold, 2 in the down burst, 3 in the pause.
    fn run_to_phase(&mut self, motor: u8, phase: f64) -> usize {
        let soon = self.hand.tick() + 60;
        let planned = self.hand.planned();
        let mut coming = planned.iter().filter(|stroke| stroke.motor == motor && stroke.up >= soon);
        let (stroke, next) = (coming.next().unwrap(), coming.next().unwrap());
        let passed = ((next.up - stroke.up) * TICK) as f64 * phase;
        let at = self.hand.grid().cycle(stroke.up) + passed as u64;
        self.hand.run_to(at);
        let tick = self.hand.tick();
        let edges = [stroke.bursts()[0].end(), stroke.down, stroke.end()];
        edges.iter().take_while(|&&edge| tick >= edge).count()
    }
}

/// Replaces so many times, at moments that spread over the period of a running stroke, for each distance of the base.
fn sweep(which: &Which, motors: u32, pause: u64, replaced: impl Fn(&mut ChaCha8Rng) -> u32, rounds: u64) {
    sweep_with(Play::new(which, 25_500, motors, pause), replaced, rounds);
}

fn sweep_with(mut play: Play, replaced: impl Fn(&mut ChaCha8Rng) -> u32, rounds: u64) {
    let (mut phases, mut done, mut kept) = ([0; 4], 0, 0);
    for round in 0..rounds {
        play.extend();
        let mask = replaced(&mut play.random) & play.motors;
        let phase = (round as f64 * GOLDEN).fract();
        phases[play.run_to_phase(mask.trailing_zeros() as u8, phase)] += 1;
        let ahead = AHEAD[(round % AHEAD.len() as u64) as usize];
        let mut base = Tick(play.hand.tick().0.strict_add_signed(ahead));
        if round % 3 == 1 {
            // The first stroke that is withdrawn begins at the base.
            let ups = play.hand.planned().into_iter().filter(|stroke| mask >> stroke.motor & 1 == 1);
            base = ups.map(|stroke| stroke.up).filter(|&up| up >= base).min().unwrap_or(base);
        }
        let verdicts = play.replace(mask, base, round % 7 == 3, round % 5 == 0);
        assert_eq!(verdicts.kept & !mask, 0);
        if ahead >= FAR {
            assert_eq!((verdicts.kept, verdicts.late), (0, 0), "round {round}, {ahead} ticks ahead");
        }
        kept += verdicts.kept.count_ones();
        done += (mask & !verdicts.kept).count_ones();
    }
    let (_, counters) = play.hand.finish(false);
    println!(
        "{rounds} replacements in phases {phases:?}: {done} motors replaced, {kept} too late; {counters:?}"
    );
    let part = rounds / 15;
    assert!(phases.iter().all(|&phase| phase > part), "{phases:?}");
    assert!(u64::from(done) > rounds / 3 && u64::from(kept) > part && counters.replaced > 0);
}

fn one(random: &mut ChaCha8Rng) -> u32 {
    1 << pick(random, 0..MOTORS as u64)
}

fn some(random: &mut ChaCha8Rng) -> u32 {
    let mask = pick(random, 1..1 << MOTORS) as u32 & pick(random, 1..1 << MOTORS) as u32;
    if mask == 0 { 1 } else { mask }
}

fn chip() -> Which {
    Which::Chip(ChipOptions::new(1))
}

#[test]
fn one_motor_is_replaced_in_every_phase_on_the_mock() {
    sweep(&Which::Mock(1), ALL, 130, one, 680);
}

#[test]
fn all_motors_are_replaced_in_every_phase_on_the_mock() {
    sweep(&Which::Mock(1), ALL, 130, |_| ALL, 340);
}

#[test]
fn one_motor_is_replaced_in_every_phase() {
    sweep(&chip(), ALL, 130, one, 340);
}

#[test]
fn some_motors_are_replaced_in_every_phase() {
    sweep(&chip(), ALL, 130, some, 170);
}

#[test]
fn all_motors_are_replaced_in_every_phase() {
    sweep(&chip(), ALL, 130, |_| ALL, 170);
}

/// Of each two frames the second comes first, so the device buffers it.
#[test]
fn frames_that_replace_may_come_out_of_order() {
    let mut play = Play::new(&chip(), 25_500, ALL, 130);
    play.hand.swaps = true;
    sweep_with(play, |_| ALL, 170);
}

/// With the drivers off between the strokes.
#[test]
fn few_motors_with_long_pauses_are_replaced_in_every_phase() {
    sweep(&chip(), 0b10_0001, 500, |random| 0b10_0001 >> (5 * pick(random, 0..2)), 340);
}

fn counted(counters: &Counters) -> u64 {
    let Counters { played, late, dropped, refused, replaced, .. } = *counters;
    played + late + dropped + refused + replaced
}

/// An e-stop comes before the device has taken a replacement, between any two pieces of it, or after it.
#[test]
fn an_e_stop_in_the_middle_of_a_replacement_leaves_nothing_uncounted() {
    const TRIES: u64 = 48;
    let mut play = Play::new(&chip(), 25_500, ALL, 130);
    let mut within = 0;
    for number in 0..TRIES {
        // Nothing is queued, so all strokes taken so far are counted.
        let before = counted(&play.hand.status().counters);
        let sent = play.hand.sent;
        play.extend();
        let taken = before + play.hand.sent - sent;
        let sent = play.hand.sent;
        play.run_to_phase(0, (number as f64 * GOLDEN).fract());
        let base = play.hand.tick() + FAR as u64;
        play.send_replacement(ALL, base, false, number % 2 == 0);
        play.hand.run(number * 5 * MS / 2 / TRIES);
        play.hand.e_stop();
        play.hand.run(20 * MS);
        let status = play.hand.status();
        assert_eq!((status.state, status.cause), (State::Faulted, Cause::EStop), "e-stop {number}");
        assert_eq!(usize::from(status.credits), POOL, "e-stop {number}");
        let after = counted(&status.counters);
        let all = taken + play.hand.sent - sent;
        assert!((taken..=all).contains(&after), "e-stop {number}: {after} of {taken} to {all} bursts");
        within += u64::from(after > taken && after < all);
        play.hand.control(Op::Reset);
        play.hand.run(10 * MS);
        play.hand.arm(false);
    }
    assert!(within > TRIES / 4, "{within} of {TRIES} came in the middle");
    play.hand.finish(true);
}

/// The host falls silent when it has sent a replacement: the device plays it until the host watchdog times out, then returns the
/// pins.
#[test]
fn a_silent_host_after_a_replacement_returns_the_pins() {
    // 10 ms, which the lead exceeds.
    let mut play = Play::new(&chip(), 850, ALL, 130);
    for number in 0..12 {
        play.extend();
        play.run_to_phase(0, (f64::from(number) * GOLDEN).fract());
        let base = play.hand.tick() + FAR as u64;
        play.send_replacement(ALL, base, false, number % 2 == 0);
        let replaced = play.hand.status().counters.replaced;
        play.hand.speaks = false;
        play.hand.run(60 * MS);
        play.hand.speaks = true;
        play.hand.run(20 * MS);
        let status = play.hand.status();
        assert_eq!((status.state, status.cause), (State::Disarmed, Cause::HostTimeout), "try {number}");
        assert_eq!((usize::from(status.credits), status.outstanding), (POOL, 0), "try {number}");
        assert!(status.counters.replaced > replaced && status.counters.dropped > 0, "{status:?}");
        play.hand.arm(false);
    }
    let sent = play.hand.sent;
    let (_, counters) = play.hand.finish(true);
    assert_eq!(counted(&counters), sent, "{counters:?}");
}
