//! Moves to levels on the chip: rows of all motors, and moves at random.

use crate::hand::Hand;
use crate::margin::TIME;
use crate::random::uniform;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::controller::BLOCK;
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{Cause, Op};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::judge::Judged;
use meissner_hil::time::{MS, TICK};
use meissner_test_support::paper::MOTORS;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn chip() -> Which {
    Which::Chip(ChipOptions::new(1))
}

fn no_limits() -> PowerLimits {
    Array::paper().layout().no_limits()
}

fn all() -> MotorSet {
    MotorSet::from_bits((1 << MOTORS) - 1)
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
    Random::play(&chip(), 60, PowerLimits { rail_at_once: 4, chip_at_once: 1, ..no_limits() });
}
