//! An e-stop turns all lines off within its promised time, at any phase, at any place in a packet, and behind a flood.
//!
//! The example `estop` runs the same over more tries.

use crate::play::{armed, job};
use crate::random::uniform;
#[cfg(test)]
use firmware_protocol::frame::PROTOCOL;
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::{HostMessage, State};
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::rig::Rig;
use meissner_hil::scenario::pattern;
use meissner_hil::time::{MS, TICK};
use meissner_stream::queues::Command;
#[cfg(test)]
use meissner_stream::queues::StreamEvent;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Most cycles from the request's SETUP packet to all lines low, whatever else is on the line.
pub(crate) const BY_REQUEST: u64 = TICK / 2;
/// Most cycles from the packet in which the frame ends, if it is in it alone.
pub(crate) const BY_FRAME: u64 = 1_750;
/// The same, if it shares its packet.
pub(crate) const BY_FRAME_SHARED: u64 = 2 * TICK;
/// Tries of each test.
#[cfg(test)]
const TRIES: u64 = 12;
/// How much slower the core is on which packets of two pipes meet.
#[cfg(test)]
const SLOW: f64 = 1.5;
/// Most cycles of a core at its usual speed until it has looked into two packets.
#[cfg(test)]
const BEHIND_OTHER: f64 = 4_500.0;
/// E-stops whose pulses are counted.
#[cfg(test)]
const COUNTED: u64 = 60;

/// What is on the line besides the play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Traffic {
    /// Nothing.
    Quiet,
    /// Before the e-stop up to 200 bytes of pings, so that its frame ends anywhere in a packet.
    Shared,
    /// So many bytes of garbage per second.
    Flood(u64),
}

/// How the e-stop comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Way {
    /// As a frame only.
    Frame,
    /// As a control request, and as a frame.
    Request,
}

/// One of each: to all lines low, from the SETUP packet of the request, or else the packet in which the frame ends.
fn latency(rig: &mut Rig, name: &str, traffic: Traffic, way: Way, random: &mut ChaCha8Rng) -> u64 {
    rig.order(job(&pattern(name).unwrap(), 5.0));
    let garbage = |rig: &mut Rig, random: &mut ChaCha8Rng| {
        if let Traffic::Flood(bytes_per_s) = traffic {
            let mut bytes: Vec<u8> = (0..bytes_per_s / 2_000).map(|_| random.next_u32() as u8).collect();
            // The host's next frame is whole.
            bytes.push(0);
            rig.raw(&bytes);
        }
    };
    let at = rig.now() + uniform(random, 20.0 * MS as f64, 25.0 * MS as f64) as u64;
    while rig.now() < at {
        garbage(rig, random);
        rig.run_to((rig.now() + MS / 2).min(at)).unwrap();
    }
    let chip = rig.chip().unwrap();
    chip.e_stopped.clear();
    chip.requested.clear();
    if traffic == Traffic::Shared {
        let mut frame = [0; MAX_FRAME];
        let len = encode(&HostMessage::Ping { token: 0, seen: 0 }, &mut frame).unwrap();
        let before = uniform(random, 0.0, 200.0) as usize;
        rig.raw(&frame[..len].repeat(1 + before / len)[..before]);
        // The end of a ping that was cut.
        rig.raw(&[0]);
    }
    rig.order(Command::EStop);
    let end = rig.now() + 12 * MS;
    while rig.now() < end {
        garbage(rig, random);
        rig.run_to(rig.now() + MS / 2).unwrap();
    }
    let chip = rig.chip().unwrap();
    let mut wait = 0;
    while chip.e_stopped.is_empty() {
        // Its frame is still behind the flood.
        wait += 1;
        assert!(wait < 2_000, "{name}: the frame of the e-stop was not taken");
        chip.run(chip.cycle() + MS / 2).unwrap();
    }
    rig.run_to(rig.now() + wait * MS / 2 + 10 * MS).unwrap();
    let chip = rig.chip().unwrap();
    // Later packets repeat it.
    let from = match way {
        Way::Frame => chip.e_stopped[0],
        Way::Request => {
            assert_eq!(chip.requested.len(), 1, "{name}: the host asks once");
            chip.requested[0]
        }
    };
    let low = chip.pins.low_since(u64::MAX).unwrap();
    // High until the e-stop, even between bursts. The drivers' enable is forced low before it.
    let off = chip.pins.led.last().unwrap().to;
    assert!(from < off && off < from + 100 * MS, "{name}: LED off at {off}, packet at {from}");
    assert!(chip.pins.still_high().is_none(), "{name}: lines go on long after the e-stop was sent");
    rig.order(Command::Reset { estops_seen: u64::MAX });
    reach(rig, State::Disarmed);
    rig.order(Command::Arm { assume_rest: true });
    reach(rig, State::Armed);
    off.max(low) - from
}

/// Runs until the device says that it is in this state: behind a flood that takes a while.
fn reach(rig: &mut Rig, state: State) {
    let by = rig.now() + 500 * MS;
    while rig.tap().status().is_none_or(|status| status.state != state) {
        assert!(rig.now() < by, "{state:?} is not reached");
        rig.run_to(rig.now() + 10 * MS).unwrap();
    }
}

/// Stops a play so many times, prints the cycles and returns the most.
pub(crate) fn sweep(name: &str, traffic: Traffic, way: Way, tries: u64, seed: u64) -> u64 {
    let mut rig = armed(ChipOptions::new(1));
    rig.requests_e_stops = way == Way::Request;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut cycles: Vec<_> = (0..tries).map(|_| latency(&mut rig, name, traffic, way, &mut random)).collect();
    cycles.sort_unstable();
    let (least, median, most) = (cycles[0], cycles[cycles.len() / 2], cycles[cycles.len() - 1]);
    println!(
        "{name}, {traffic:?}: e-stop by {way:?} to all lines low: {least} / {median} / {most} cycles (least, median, most of {tries})"
    );
    assert_eq!(rig.chip().unwrap().read("STALLS", 4).unwrap(), 0, "the executor counts as hung");
    let (boots, _) = rig.finish();
    assert_eq!(boots.len(), 1, "the chip has restarted");
    // The judge knows no bytes beside the host's.
    if traffic == Traffic::Quiet {
        for boot in boots {
            let findings: Vec<_> = boot.judge().findings.iter().map(ToString::to_string).collect();
            assert!(findings.is_empty(), "{}", findings.join("\n"));
        }
    }
    most
}

#[test]
fn lines_are_low_soon_after_a_frame() {
    assert!(sweep("edge-45-paper", Traffic::Quiet, Way::Frame, TRIES, 1) <= BY_FRAME);
}

#[test]
fn lines_are_low_soon_after_a_frame_under_full_load() {
    assert!(sweep("full-load", Traffic::Quiet, Way::Frame, TRIES, 2) <= BY_FRAME);
}

#[test]
fn lines_are_low_within_two_pulse_periods_of_a_frame_anywhere_in_a_packet() {
    assert!(sweep("full-load", Traffic::Shared, Way::Frame, TRIES, 3) <= BY_FRAME_SHARED);
}

#[test]
fn lines_are_low_within_half_a_pulse_period_of_a_request() {
    assert!(sweep("full-load", Traffic::Quiet, Way::Request, TRIES, 4) <= BY_REQUEST);
}

#[test]
fn lines_are_low_within_half_a_pulse_period_of_a_request_behind_a_flood() {
    assert!(sweep("full-load", Traffic::Flood(120_000), Way::Request, TRIES, 5) <= BY_REQUEST);
}

/// Cycles before the drivers go off in which a pulse may begin that is not counted: it has no time to move anything.
#[cfg(test)]
const TOO_SHORT: u64 = 60;

/// The pulses counted at an e-stop are those that had begun when the drivers went off. `late`: cycles by which the first clock of
/// the state machine comes later than in the emulator otherwise.
#[cfg(test)]
fn counts_of(late: u64, seed: u64) {
    let more = vec!["--pio-late".to_owned(), late.to_string()];
    let mut rig = armed(ChipOptions { more, ..ChipOptions::new(1) });
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut wrong = Vec::new();
    for number in 0..COUNTED {
        rig.notices.clear();
        let before = rig.now();
        rig.order(job(&pattern("full-load").unwrap(), 5.0));
        rig.run_to(rig.now() + uniform(&mut random, 20.0 * MS as f64, 25.0 * MS as f64) as u64).unwrap();
        rig.order(Command::EStop);
        rig.run_to(rig.now() + 12 * MS).unwrap();
        let counted = rig.notices.iter().find_map(|notice| match notice {
            StreamEvent::PlayEnded { outcome, .. } => Some(outcome.pulses.played),
            _ => None,
        });
        let counted = counted.unwrap();
        let pins = &rig.chip().unwrap().pins;
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
        rig.order(Command::Reset { estops_seen: u64::MAX });
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
        rig.chip().unwrap().e_stopped.clear();
        // What may be an e-stop up to its checksum takes the longest to look at.
        rig.stray(&[14, PROTOCOL, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0].repeat(4)).unwrap();
        rig.raw(&vec![0; before]);
        rig.order(Command::EStop);
        rig.run_to(rig.now() + 30 * MS).unwrap();
        let chip = rig.chip().unwrap();
        let cycles = chip.pins.led.last().unwrap().to - chip.e_stopped[0];
        longest = longest.max(cycles);
        rig.order(Command::Reset { estops_seen: u64::MAX });
        rig.run_to(rig.now() + 30 * MS).unwrap();
        rig.order(Command::Arm { assume_rest: true });
        rig.run_to(rig.now() + 30 * MS).unwrap();
    }
    println!("e-stop behind a packet of the other pipe: at most {longest} cycles");
    // One that is missed waits for the tasks: 15 000 to 21 000 cycles.
    assert!(longest <= (SLOW * BEHIND_OTHER) as u64, "{longest} cycles");
}
