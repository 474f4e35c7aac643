//! Days of use in virtual time: `DAYS=30 cargo bench -p meissner-benches --bench days`.
//!
//! The streamer plays patterns of the library in random order on the simulated array, in open and closed loop, with pauses of up to
//! an hour. Two plays of three run undisturbed. The third is stopped or cut by an e-stop, or meets a bad line, a host that stalls,
//! an unplugged cable or a device that restarts. The burst counts of every play must add up. They must equal the device's count,
//! except where the play may have ended the session (the last three). In an undisturbed play every burst must be played, from the
//! requested tick on. The benchmark prints the sums, and the memory after the first day and at the end. It ends with an error at
//! the first wrong count.

use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::queues::{Command, Outcome};
use meissner_stream::{Line, Settings, Simulation};
use meissner_test_support::random::Random;
use meissner_test_support::rig;
use std::error::Error;
use std::time::{Duration, Instant};

const MS: Duration = Duration::from_millis(1);
const DAY: Duration = Duration::from_secs(86_400);

/// What happens to a play, and how often it did.
const FATES: [&str; 7] =
    ["good", "stopped", "cut by an e-stop", "on a bad line", "host stalls", "unplugged", "device restarts"];

#[derive(Default)]
struct Sums {
    plays: [u64; FATES.len()],
    played: u64,
    lost: u64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let days = std::env::var("DAYS").ok().map_or(Ok(1), |days| days.parse::<u32>())?;
    let seed = std::env::var("SEED").ok().map_or(Ok(1), |seed| seed.parse::<u64>())?;
    let (begun, mut random, mut sums) = (Instant::now(), Random::new(seed), Sums::default());
    let motors = SimulatedMotorsConfig::default();
    let settings = Settings { drift_limit_um: f32::INFINITY, ..Settings::of(Array::paper()) };
    let mut simulation = Simulation::new(&motors, settings, Line::default(), seed)?;
    let (started, patterns) = (simulation.now(), rig::shipped());
    let (mut id, mut memory, mut day) = (0, 0, 0);
    simulation.run(500 * MS);
    while simulation.now().since(started) < days * DAY {
        let good_as_new = simulation.send(Command::Arm { assume_rest: true });
        simulation.run(100 * MS);
        let answered = rig::answer(&simulation.take_events(), good_as_new);
        if !matches!(answered, Some(Ok(()))) {
            return Err(format!("it does not arm after play {id}: {answered:?}").into());
        }
        for _ in 0..random.below(20) {
            id += 1;
            let pattern = &patterns[random.below(patterns.len())];
            let fate = if random.below(3) > 0 { 0 } else { 1 + random.below(FATES.len() - 1) };
            let seconds = random.between(0.1, 2.0);
            let mut play = rig::play(id, pattern, Some(seconds));
            play.open_loop = random.below(2) == 0;
            let before = simulation.mock.controller().counters();
            simulation.send(Command::Play(Box::new(play)));
            let ends_session = suffer(&mut simulation, fate, &motors, &mut random, seconds, id as u32)?;
            let outcome =
                ended(&mut simulation, id, seconds).ok_or_else(|| format!("play {id} does not end"))?;
            let after = simulation.mock.controller().counters();
            rig::assert_closed(&outcome);
            let counted = after.played.wrapping_sub(before.played);
            // A lost device cannot say what it has played since.
            let same = if ends_session { true } else { counted == outcome.bursts.played };
            let on_time = fate != 0
                || (outcome.bursts.played == outcome.bursts.planned
                    && outcome.onset.is_some_and(|onset| onset.actual == onset.requested));
            if !same || !on_time {
                return Err(
                    format!("play {id}, {}: the device played {counted}: {outcome:?}", FATES[fate]).into()
                );
            }
            sums.plays[fate] += 1;
            sums.played += outcome.bursts.played;
            sums.lost += outcome.bursts.planned - outcome.bursts.played;
            if fate > 1 {
                break;
            }
        }
        recover(&mut simulation);
        simulation.idle(Duration::from_secs_f64(random.between(1.0, 3_600.0)));
        let today = simulation.now().since(started).as_secs() / DAY.as_secs();
        if today > day {
            day = today;
            memory = if day == 1 { resident_kb() } else { memory };
            println!("day {day}: {} plays, {} kB, {:.0} s", id, resident_kb(), begun.elapsed().as_secs_f64());
        }
    }
    let wraps = (simulation.now().since(started).as_secs() * Array::paper().rate().per_s()) >> 32;
    println!("{} days, {wraps} wraps of the 32-bit tick, in {:.0} s", days, begun.elapsed().as_secs_f64());
    for (fate, plays) in FATES.iter().zip(sums.plays) {
        println!("  {plays} plays: {fate}");
    }
    println!("  {} bursts played, {} lost to faults, all counted", sums.played, sums.lost);
    println!("  memory: {memory} kB after the first day, {} kB at the end", resident_kb());
    Ok(())
}

/// Disturbs a play as `fate` says. Returns whether its session ended.
fn suffer(
    simulation: &mut Simulation,
    fate: usize,
    motors: &SimulatedMotorsConfig,
    random: &mut Random,
    seconds: f64,
    boot: u32,
) -> Result<bool, Box<dyn Error>> {
    let during = Duration::from_secs_f64(random.between(0.0, seconds));
    match fate {
        1 | 2 => {
            simulation.run(during);
            simulation.send(if fate == 1 { Command::Stop } else { Command::EStop });
        }
        3 => {
            simulation.set_line(rig::bad_line());
            simulation.run(Duration::from_secs_f64(seconds) + 500 * MS);
            simulation.set_line(Line::default());
        }
        4 => {
            simulation.run(during);
            simulation.stall(Duration::from_secs_f64(random.between(0.01, 5.0)));
            simulation.wake();
        }
        5 => {
            simulation.run(during);
            simulation.unplug();
            simulation.stall(Duration::from_secs_f64(random.between(0.1, 60.0)));
            simulation.connect();
        }
        6 => {
            simulation.run(during);
            simulation.restart(motors, boot)?;
        }
        _ => {}
    }
    Ok(fate >= 4)
}

fn ended(simulation: &mut Simulation, id: u64, seconds: f64) -> Option<Outcome> {
    let outcome = simulation.run_to_end(id, Duration::from_secs_f64(seconds) + 5_000 * MS);
    // Late reports, and the return.
    simulation.run(100 * MS);
    simulation.take_events();
    outcome
}

/// Resets and disarms, as a person does before a pause.
fn recover(simulation: &mut Simulation) {
    for command in [Command::Reset { estops_seen: u64::MAX, keep: true }, Command::Disarm] {
        simulation.send(command);
        simulation.run(300 * MS);
    }
    simulation.take_events();
}

fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}
