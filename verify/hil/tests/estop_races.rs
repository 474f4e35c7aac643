//! E-stops that race a tick or a packet of the other pipe: the pulses counted are those on the pins, and no e-stop is missed.

use crate::play::{armed, job, pattern};
use crate::random::uniform;
use firmware_protocol::frame::PROTOCOL;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::time::{MS, TICK};
use meissner_stream::queues::{Command, StreamEvent};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// How much slower the core is on which packets of two pipes meet.
const SLOW: f64 = 2.5;
/// Most cycles of a core at its usual speed until it has looked into two packets.
const BEHIND_OTHER: f64 = 2_000.0;
/// E-stops whose pulses are counted.
const COUNTED: u64 = 60;
/// Cycles before the drivers go off in which a pulse may begin that is not counted: it has no time to move anything.
const TOO_SHORT: u64 = 60;

/// The pulses counted at an e-stop are those that had begun when the drivers went off. `late`: cycles by which the first clock of
/// the state machine comes later than in the emulator otherwise.
fn counts_of(late: u64, seed: u64) {
    let more = vec!["--pio-late".to_owned(), late.to_string()];
    let mut rig = armed(ChipOptions { more, ..ChipOptions::new(1) });
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut wrong = Vec::new();
    for number in 0..COUNTED {
        rig.notices.clear();
        let before = rig.now();
        rig.order(job(&pattern("full-load"), 5.0));
        rig.run_to(rig.now() + uniform(&mut random, 20.0 * MS as f64, 25.0 * MS as f64) as u64).unwrap();
        rig.order(Command::EStop);
        rig.run_to(rig.now() + 12 * MS).unwrap();
        let counted = rig.notices.iter().find_map(|notice| match notice {
            StreamEvent::PlayEnded { outcome, .. } => Some(outcome.pulses.played),
            _ => None,
        });
        let counted = counted.unwrap();
        let pins = &rig.chip.pins;
        let off = pins.enable.last().unwrap().to;
        let begun = |by: u64| -> u64 {
            let trains =
                pins.lines.iter().flatten().filter(|train| train.cycle >= before && train.cycle < by);
            trains.map(|train| train.pulses.min((by - train.cycle).div_ceil(TICK))).sum()
        };
        let (least, most) = (begun(off - TOO_SHORT), begun(off));
        if counted != least && counted != most {
            wrong.push(format!("e-stop {number}: {counted} counted, {least} to {most} begun"));
        }
        rig.order(Command::Reset { estops_seen: u64::MAX, keep: true });
        rig.run_to(rig.now() + 10 * MS).unwrap();
        rig.order(Command::Arm { assume_rest: false });
        rig.run_to(rig.now() + 60 * MS).unwrap();
    }
    assert!(wrong.is_empty(), "{} of {COUNTED} are wrong:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn the_pulses_counted_at_an_e_stop_are_those_on_the_pins() {
    counts_of(0, 7);
}

/// The data sheet does not say when a state machine's first clock comes.
#[test]
fn pulses_are_counted_rightly_if_the_state_machine_starts_later() {
    counts_of(60, 8);
}

/// A packet may come while the interrupt still looks into one of the other pipe. On a slower core it does so more often.
#[test]
fn an_e_stop_just_behind_a_packet_of_the_other_pipe_is_not_missed() {
    let mut rig = armed(ChipOptions { slow: SLOW, ..ChipOptions::new(1) });
    rig.requests_e_stops = false;
    let mut longest = 0;
    for before in 0..48 {
        rig.chip.e_stopped.clear();
        // What may be an e-stop up to its checksum takes the longest to look at.
        rig.stray(&[14, PROTOCOL, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0].repeat(4)).unwrap();
        rig.raw(&vec![0; before]);
        rig.order(Command::EStop);
        rig.run_to(rig.now() + 30 * MS).unwrap();
        let chip = &mut rig.chip;
        let cycles = chip.pins.led.last().unwrap().to - chip.e_stopped[0];
        longest = longest.max(cycles);
        rig.order(Command::Reset { estops_seen: u64::MAX, keep: true });
        rig.run_to(rig.now() + 30 * MS).unwrap();
        rig.order(Command::Arm { assume_rest: true });
        rig.run_to(rig.now() + 30 * MS).unwrap();
    }
    println!("e-stop behind a packet of the other pipe: at most {longest} cycles");
    // One that is missed waits for the tasks: 42 000 cycles.
    assert!(longest <= (SLOW * BEHIND_OTHER) as u64, "{longest} cycles");
}
