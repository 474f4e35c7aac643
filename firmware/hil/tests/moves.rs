//! Moves to levels on the chip: ramps, holds, rows of all motors, and what interrupts them in each of their phases.

use crate::hand::Hand;
use crate::margin::TIME;
use crate::random::uniform;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, MAX_FIRST_BATCH, Packer};
use firmware_protocol::controller::{BLOCK, HORIZON};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{Cause, Op, Report, State};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::judge::Judged;
use meissner_hil::tap::Event;
use meissner_hil::time::{MS, TICK};
use meissner_test_support::paper::{DRIVER_LEAD, MOTORS};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Ticks of a ramp's step, and of its burst at most: a third of the motors begins after the other, and a pause follows the last one.
const STEP: u64 = 300;
const THIRD: u64 = 95;
const STEPS: u64 = 8;
/// Ticks from the last step up to the first step down: the drivers go off meanwhile.
const HELD: u64 = 2_000;
/// Ticks for which the host watchdog waits.
const SILENT: u64 = 1_700;
/// Most ticks from a command on the line to the first tick that is rendered with it.
const TAKEN: u64 = 2 * 85 + (HORIZON + BLOCK) as u64;

fn chip() -> Which {
    Which::Chip(ChipOptions::new(1))
}

fn no_limits() -> PowerLimits {
    Array::paper().layout().no_limits()
}

fn all() -> MotorSet {
    MotorSet::from_bits((1 << MOTORS) - 1)
}

/// The level of a motor's ramp after so many steps.
fn level(motor: usize, steps: u64) -> u16 {
    (20 + 3 * motor as u16) * steps as u16
}

/// Rows of a third of the motors, two of each rail: each goes up in steps to a level of its own, is held there, and comes down in steps.
fn send_ramps(hand: &mut Hand, base: Tick) {
    let ups = (0..STEPS).map(|step| (step * STEP, step + 1));
    let downs = (0..STEPS).map(|step| (STEPS * STEP + HELD + step * STEP, STEPS - 1 - step));
    let thirds =
        |(after, steps): (u64, u64)| (0..3).map(move |third| (third, after + third as u64 * THIRD, steps));
    let rows: Vec<_> = ups.chain(downs).flat_map(thirds).collect();
    for (number, some) in rows.chunks(6).enumerate() {
        let mut packer = Packer::new(base + some[0].1);
        for &(third, after, steps) in some {
            let motors = || (third..MOTORS).step_by(3);
            let set = MotorSet::from_bits(motors().map(|motor| 1 << motor).sum());
            let levels: Vec<_> = motors().map(|motor| level(motor, steps)).collect();
            packer.row(base + after, set, &levels).unwrap();
        }
        hand.moves(&packer, (number == 0).then_some(0));
        hand.run(MS / 4);
    }
}

/// What ends a play.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ending {
    Stop,
    EStop,
    Silence,
    Unplug,
}

/// Ends the play, checks what the device says, and makes it ready for the next one. Returns the cycles from the event to all lines low, and
/// those to all pins at rest.
fn end(hand: &mut Hand, ending: Ending, limits: PowerLimits) -> [u64; 2] {
    let begun = hand.now();
    match ending {
        Ending::Stop => hand.control(Op::Stop),
        Ending::EStop => hand.e_stop(),
        Ending::Silence => hand.speaks = false,
        Ending::Unplug => hand.unplug(),
    }
    hand.run(60 * MS);
    let low = hand.low_since().max(begun) - begun;
    match ending {
        Ending::Stop => assert_eq!((hand.status().state, hand.status().cause), (State::Armed, Cause::Stop)),
        Ending::EStop => {
            assert_eq!((hand.status().state, hand.status().cause), (State::Faulted, Cause::EStop));
            hand.control(Op::Reset);
            hand.run(5 * MS);
        }
        Ending::Silence => {
            hand.speaks = true;
            hand.run(5 * MS);
            assert_eq!((hand.status().state, hand.status().cause), (State::Disarmed, Cause::HostTimeout));
        }
        Ending::Unplug => {
            hand.plug();
            // A return that takes longer than the host watchdog waits ends with the watchdog's cause.
            let cause = if low > SILENT * TICK { Cause::HostTimeout } else { Cause::LinkLost };
            assert_eq!((hand.status().state, hand.status().cause), (State::Disarmed, cause));
        }
    }
    let arms = hand.now();
    if ending != Ending::Stop {
        hand.arm_with(false, limits);
    }
    assert_eq!(hand.status().outstanding, 0);
    let then = hand.low_since();
    [low, low + then.saturating_sub(arms)]
}

/// Ends ramps in each of their phases.
fn ends(which: &Which, ending: Ending, rail_at_once: u8) {
    let limits = PowerLimits { rail_at_once, ..no_limits() };
    let mut hand = Hand::armed(which, SILENT as u32);
    hand.control(Op::Disarm(Cause::Request));
    hand.run(MS);
    hand.arm_with(false, limits);
    let down = STEPS * STEP + HELD;
    let phases = [
        ("a step up", 3 * STEP + 15),
        ("a pause on the way up", 4 * STEP - 3),
        ("the last step up", 7 * STEP + 60),
        ("the hold", STEPS * STEP + HELD / 2),
        ("the end of the hold", down - 20),
        ("a step down", down + 3 * STEP + 15),
        ("a pause on the way down", down + 4 * STEP - 3),
    ];
    for (phase, after) in phases {
        let base = hand.tick() + 3_000;
        send_ramps(&mut hand, base);
        let at = hand.grid().cycle(base + after);
        hand.run_to(at);
        let cycles = end(&mut hand, ending, limits);
        let [low, rest] = cycles.map(|cycles| cycles.div_ceil(TICK));
        println!(
            "{ending:?} in {phase}, {rail_at_once} of a rail at once: lines low after {low} ticks, pins at rest after {rest}"
        );
        let turns = u64::from(Array::paper().layout().turns(&limits));
        let highest = u64::from(level(MOTORS - 1, STEPS));
        let begins = match ending {
            Ending::Stop => TAKEN,
            Ending::EStop => 3,
            Ending::Silence => SILENT + TAKEN,
            // The firmware sees that the cable has no 5 V.
            Ending::Unplug => 900 + TAKEN,
        };
        let returns = u64::from(DRIVER_LEAD) + turns * highest;
        assert!(
            low <= if ending == Ending::EStop { begins } else { begins + returns },
            "{ending:?} in {phase}: {low}"
        );
        assert!(rest <= begins + returns + TAKEN, "{ending:?} in {phase}: {rest}");
    }
    at_rest(&hand.finish(true).0);
}

/// All pins are where they began, or where a pulse that an e-stop cut off has left them.
fn at_rest(judged: &Judged) {
    let cut_off = judged.expected.cuts.iter().filter(|cut| cut.return_ticks.is_none()).count() as i64;
    for line in &judged.log.lines {
        let sign = |direction| if direction == firmware_protocol::stroke::Direction::Up { 1 } else { -1 };
        let net: i64 = line.iter().map(|train| sign(train.direction) * train.pulses as i64).sum();
        assert!(net.abs() <= cut_off, "{net}");
    }
}

#[test]
fn stops_in_each_phase_of_a_ramp() {
    ends(&chip(), Ending::Stop, 6);
    ends(&chip(), Ending::Stop, 2);
}

#[test]
fn e_stops_in_each_phase_of_a_ramp() {
    ends(&chip(), Ending::EStop, 6);
    ends(&chip(), Ending::EStop, 2);
}

#[test]
fn silence_in_each_phase_of_a_ramp() {
    ends(&chip(), Ending::Silence, 6);
}

#[test]
fn unplugs_in_each_phase_of_a_ramp() {
    ends(&chip(), Ending::Unplug, 6);
}

#[test]
fn endings_in_each_phase_of_a_ramp_on_the_mock() {
    for ending in [Ending::Stop, Ending::EStop, Ending::Silence, Ending::Unplug] {
        ends(&Which::Mock(1), ending, 6);
        ends(&Which::Mock(1), ending, 2);
    }
}

/// A pin is held for as long as the play says, at least 0.2 s, and then comes down by itself.
#[test]
fn a_hold_ends() {
    let mut hand = Hand::armed(&chip(), 85_000);
    for (hold, longest) in [(0, 17_000), (20_000, 20_000)] {
        let base = hand.tick() + 1_000;
        let mut packer = Packer::new(base);
        for (motor, level) in [(3, 400), (9, 90)] {
            packer.moves(&Move { motor, tick: base, level, surplus: 0 }).unwrap();
        }
        // A move to the level that the pin has moves nothing: the hold goes on.
        packer.moves(&Move { motor: 3, tick: base + 9_000, level: 400, surplus: 0 }).unwrap();
        hand.moves(&packer, Some(hold));
        let until = hand.grid().cycle(base + longest + 2_500);
        hand.run_to(until);
        let report = hand.tap.events.iter().rev().find_map(|(_, event)| match event {
            Event::Report(Report::Lowered { tick, held, .. }) => Some((hand.tap.tick(*tick), *held)),
            _ => None,
        });
        let (tick, held_pins) = report.unwrap();
        let held = tick - (base + 400);
        println!("held for {held} ticks, {hold} asked");
        assert!(held_pins.contains(3) && (longest..longest + 1_100).contains(&held), "{held}");
    }
    at_rest(&hand.finish(false).0);
}

/// A play of one frame, with as many moves as a first frame may have: each motor goes up and comes down.
fn one_frame(which: &Which) {
    let mut hand = Hand::armed(which, 85_000);
    let base = hand.tick() + 1_000;
    let mut packer = Packer::new(base);
    for number in 0..MAX_FIRST_BATCH as u64 {
        let (round, motor) = (number / MOTORS as u64, (number % MOTORS as u64) as u8);
        let level = if round == 0 { 9 + u16::from(motor) } else { 0 };
        packer.moves(&Move { motor, tick: base + round * GRID, level, surplus: 0 }).unwrap();
    }
    hand.moves(&packer, Some(0));
    hand.run(50 * MS);
    let (judged, counters) = hand.finish(false);
    assert_eq!((counters.played, counters.late, counters.refused), (MAX_FIRST_BATCH as u64, 0, 0));
    assert_eq!(judged.expected.onsets, [base]);
    at_rest(&judged);
}

#[test]
fn a_play_of_one_full_frame() {
    one_frame(&chip());
}

#[test]
fn a_play_of_one_full_frame_on_the_mock() {
    one_frame(&Which::Mock(1));
}

/// Ticks of the grid of 500 moves a second.
const GRID: u64 = 170;

/// Rows of all motors, 500 a second, with levels that change with each row: 12 000 moves a second. Prints the load and the least time left
/// to render, and returns the latter.
fn rows(slow: f64, most: u64) -> u64 {
    let mut hand = Hand::armed(&Which::Chip(ChipOptions { slow, ..ChipOptions::new(1) }), 25_500);
    let base = hand.tick() + 3_000;
    let mut random = ChaCha8Rng::seed_from_u64(most);
    let (mut from, mut busy) = (0, 0);
    hand.slack();
    for pair in 0..150 {
        let tick = base + 2 * pair * GRID;
        let mut packer = Packer::<BATCH_BYTES>::new(tick);
        for row in 0..2 {
            let levels: Vec<_> = (0..MOTORS).map(|_| pick(&mut random, 0..most) as u16).collect();
            packer.row(tick + row * GRID, all(), &levels).unwrap();
        }
        // The first frame of the play has as many moves as it may.
        hand.moves(&packer, (pair == 0).then_some(0));
        if pair == 10 {
            (from, busy) = (hand.now(), hand.chip().busy_cycles());
        }
        hand.run(2 * GRID * TICK);
    }
    let load = (hand.chip().busy_cycles() - busy) as f64 / (hand.now() - from) as f64;
    let left = u64::from(hand.slack().unwrap());
    hand.run(250 * MS);
    let (_, counters) = hand.finish(false);
    println!(
        "core at {:.0} %, 24 motors x 500 moves/s in rows, levels below {most}: {:.1} % busy, of {TIME} ticks {left} are left at least; {} played, {} \
         shortened",
        100.0 / slow,
        100.0 * load,
        counters.played,
        counters.shortened
    );
    left
}

#[test]
fn half_of_the_time_is_left_while_all_motors_follow_rows() {
    // Bursts that end before the next row, and bursts that each row cuts.
    for most in [150, 700] {
        assert!(2 * rows(1.0, most) >= TIME);
        assert!(rows(1.1, most) >= u64::from(BLOCK));
    }
}

fn pick(random: &mut ChaCha8Rng, range: std::ops::Range<u64>) -> u64 {
    uniform(random, range.start as f64, range.end as f64) as u64
}

/// A play of moves, rows, strokes and late moves, all at random: levels are reached or shortened, held or passed.
struct Random {
    hand: Hand,
    random: ChaCha8Rng,
    /// The ticks of each motor's last two moves.
    last: [[Tick; 2]; MOTORS],
}

impl Random {
    /// A tick at which a motor's next move may begin, behind its others and in time.
    fn next(&mut self, motor: usize, within: u64) -> Tick {
        let soon = self.hand.tick() + 500;
        let [last, before] = self.last[motor];
        let first = soon.max(last + 1).max(before + 85);
        first + pick(&mut self.random, 0..within)
    }

    fn level(&mut self) -> u16 {
        let most = [1, 40, 300, 700][pick(&mut self.random, 0..4) as usize];
        pick(&mut self.random, 0..most) as u16
    }

    fn begins(&mut self, motor: usize, tick: Tick) {
        self.last[motor] = [tick, self.last[motor][0]];
    }

    fn send(&mut self, mut moves: Vec<Move>) {
        moves.sort_by_key(|to| to.tick);
        for part in moves.chunks(20) {
            let mut packer = Packer::<BATCH_BYTES>::new(part[0].tick);
            part.iter().for_each(|to| packer.moves(to).unwrap());
            self.hand.moves(&packer, None);
        }
    }

    /// Some moves of each motor: single ones, in rows, in strokes, and late.
    fn round(&mut self) {
        let mut moves = Vec::new();
        for motor in 0..8 {
            for _ in 0..pick(&mut self.random, 0..4) {
                let (tick, level) = (self.next(motor, 300), self.level());
                self.begins(motor, tick);
                moves.push(Move { motor: motor as u8, tick, level, surplus: 0 });
            }
        }
        self.send(moves);
        let mut tick = (8..16).map(|motor| self.next(motor, 1)).max().unwrap();
        let mut packer = Packer::<BATCH_BYTES>::new(tick);
        for _ in 0..3 {
            let levels: Vec<_> = (8..16).map(|_| self.level()).collect();
            packer.row(tick, MotorSet::from_bits(0xff00), &levels).unwrap();
            (8..16).for_each(|motor| self.begins(motor, tick));
            tick = tick + 85 + pick(&mut self.random, 0..200);
        }
        self.hand.moves(&packer, None);
        let strokes = (16..20).map(|motor| {
            let (up, up_pulses) = (self.next(motor, 300), 1 + self.level());
            // The way down is at least 1 ms after that of the stroke before.
            let down = up + u64::from(up_pulses) + 85 + pick(&mut self.random, 0..200);
            self.begins(motor, up);
            self.begins(motor, down);
            Stroke { motor: motor as u8, up, up_pulses, down, down_pulses: up_pulses }
        });
        let strokes = strokes.collect();
        self.hand.append(strokes);
        let mut moves = Vec::new();
        for motor in 20..MOTORS {
            let now = self.hand.tick();
            let is_late = self.last[motor][0] < now && pick(&mut self.random, 0..2) == 0;
            let tick =
                if is_late { Tick(now.0 + 30).max(self.last[motor][0] + 1) } else { self.next(motor, 300) };
            if !is_late {
                self.begins(motor, tick);
            }
            moves.push(Move { motor: motor as u8, tick, level: self.level(), surplus: 0 });
        }
        self.send(moves);
        self.hand.settle();
    }

    fn play(which: &Which, rounds: u64, limits: PowerLimits) {
        let mut hand = Hand::armed(which, 25_500);
        hand.control(Op::Disarm(Cause::Request));
        hand.run(MS);
        hand.arm_with(false, limits);
        let mut play = Self { hand, random: ChaCha8Rng::seed_from_u64(7), last: [[Tick::BOOT; 2]; MOTORS] };
        for number in 0..rounds {
            play.round();
            let pause = if number % 16 == 15 { 250 * MS } else { pick(&mut play.random, 1..20) * MS / 2 };
            play.hand.run(pause);
        }
        play.hand.run(250 * MS);
        let is_limited = Array::paper().layout().takes_turns(&limits);
        let (judged, counters) = play.hand.finish(is_limited);
        println!("{counters:?}, {} cuts", judged.expected.cuts.len());
        assert!(
            counters.played > 20 * rounds && counters.late > rounds && counters.shortened > rounds,
            "{counters:?}"
        );
        assert_eq!(counters.refused > rounds, is_limited, "{counters:?}");
        at_rest(&judged);
    }
}

#[test]
fn moves_at_random_on_the_mock() {
    Random::play(&Which::Mock(1), 200, no_limits());
    Random::play(&Which::Mock(1), 60, PowerLimits { rail_at_once: 4, chip_at_once: 1, ..no_limits() });
}

#[test]
fn moves_at_random() {
    Random::play(&chip(), 60, no_limits());
}

#[test]
fn moves_at_random_under_limits_on_motors_at_once() {
    Random::play(&chip(), 60, PowerLimits { rail_at_once: 4, chip_at_once: 1, ..no_limits() });
}
