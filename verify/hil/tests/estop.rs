//! An e-stop turns all lines off within its promised time, at any phase, at any place in a packet, and behind a flood.
//!
//! The example `estop` runs the same over more tries.

use crate::play::{armed, job, pattern};
use crate::random::uniform;
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::{HostMessage, Op, State};
use firmware_protocol::urgent::{Urgent, Watch};
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::rig::Rig;
use meissner_hil::time::MS;
use meissner_stream::queues::Command;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Most cycles from the request's SETUP packet to all lines low, whatever else is on the line.
pub(crate) const BY_REQUEST: u64 = 1_000;
/// Most cycles from the packet in which the frame ends, if the frame is alone in its packet.
pub(crate) const BY_FRAME: u64 = 1_750;
/// The same, if it shares its packet.
pub(crate) const BY_FRAME_SHARED: u64 = 3_300;
/// The promises hold on a core that is slower by so much, too.
const SLOW: f64 = 1.1;
/// Tries of each test.
#[cfg(test)]
const TRIES: u64 = 12;

/// What is on the line besides the play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Traffic {
    /// Nothing.
    Quiet,
    /// Before the e-stop up to 200 bytes of pings, so that its frame ends anywhere in a packet.
    Shared,
    /// So many bytes of garbage per second.
    Flood(u64),
    /// Before the e-stop, in its packet, bytes that are made to take long to look into.
    Contrived,
}

/// How the e-stop comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Channel {
    /// As a frame only.
    Frame,
    /// As a control request, and as a frame.
    Request,
}

/// Cycles of one e-stop to all lines low: from the SETUP packet of the request or, for a frame, from the packet in which it ends.
fn latency(rig: &mut Rig, name: &str, traffic: Traffic, channel: Channel, random: &mut ChaCha8Rng) -> u64 {
    rig.order(job(&pattern(name), 5.0));
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
    let chip = &mut rig.chip;
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
    let mut old = 0;
    if traffic == Traffic::Contrived {
        let bytes = contrived(random);
        let mut watch = Watch::new();
        old = bytes.iter().filter(|&&byte| matches!(watch.look(&[byte]), Some(Urgent::EStop(_)))).count();
        rig.raw(&bytes);
    }
    rig.order(Command::EStop);
    let end = rig.now() + 12 * MS;
    while rig.now() < end {
        garbage(rig, random);
        rig.run_to(rig.now() + MS / 2).unwrap();
    }
    let chip = &mut rig.chip;
    let mut wait = 0;
    while chip.e_stopped.len() <= old {
        // Its frame is still behind the flood.
        wait += 1;
        assert!(wait < 2_000, "{name}: the frame of the e-stop was not taken");
        chip.run(chip.cycle() + MS / 2).unwrap();
    }
    rig.run_to(rig.now() + wait * MS / 2 + 10 * MS).unwrap();
    let chip = &mut rig.chip;
    // Later packets repeat it.
    let from = match channel {
        Channel::Frame => chip.e_stopped[old],
        Channel::Request => {
            assert_eq!(chip.requested.len(), 1, "{name}: the host asks once");
            chip.requested[0]
        }
    };
    let low = chip.pins.low_since(u64::MAX).unwrap();
    // High until the e-stop, even between bursts. The drivers' enable is forced low before it.
    let off = chip.pins.led.last().unwrap().to;
    assert!(from < off && off < from + 100 * MS, "{name}: LED off at {off}, packet at {from}");
    assert!(chip.pins.still_high().is_none(), "{name}: lines go on long after the e-stop was sent");
    rig.order(Command::Reset { estops_seen: u64::MAX, keep: true });
    reach(rig, State::Disarmed);
    rig.order(Command::Arm { assume_rest: true });
    reach(rig, State::Armed);
    off.max(low) - from
}

/// Most bytes of an e-stop's frame here: the epochs are small.
const E_STOP: usize = 12;
/// An epoch that is new to the device.
const NEW: u16 = 10_000;
/// A bulk packet.
const PACKET: usize = 64;

/// Whole frames before an e-stop that are made to take long to look into, so that the e-stop still ends in the same packet: of one kind,
/// or mixed; sometimes with a frame that began in the packet before.
fn contrived(random: &mut ChaCha8Rng) -> Vec<u8> {
    let pick = |random: &mut ChaCha8Rng, most: u64| random.next_u64() % most;
    let encoded = |message: &HostMessage<'_>| {
        let mut frame = [0; MAX_FRAME];
        let len = encode(message, &mut frame).unwrap();
        frame[..len].to_vec()
    };
    // Their epochs are old, or their CRC is wrong: no e-stop but the last counts.
    let piece = |random: &mut ChaCha8Rng, kind: u64| match kind {
        0 => vec![0],
        1 => vec![7, 0],
        2 => [vec![9; 1 + pick(random, 12) as usize], vec![0]].concat(),
        3 => {
            let mut frame = encoded(&HostMessage::Control { epoch: NEW, seen: 1, op: Op::EStop });
            // The last byte of the CRC, which must not become a zero.
            let at = frame.len() - 2;
            frame[at] = if frame[at] == 1 { 2 } else { 1 };
            frame
        }
        4 => encoded(&HostMessage::Control { epoch: 0, seen: 0, op: Op::EStop }),
        5 => {
            let mut frame = encoded(&HostMessage::Hello { session: 1 + pick(random, 100) as u32 });
            let at = frame.len() - 2;
            frame[at] = if frame[at] == 1 { 2 } else { 1 };
            frame
        }
        6 => encoded(&HostMessage::Ping { token: 1 + pick(random, 60_000) as u16, seen: 0 }),
        7 => encoded(&HostMessage::Control { epoch: 1, seen: 1, op: Op::Stop }),
        _ => [vec![4; 1 + pick(random, 51) as usize], vec![0]].concat(),
    };
    let kinds = 9;
    let only = pick(random, 2 * kinds);
    let mut bytes = Vec::new();
    loop {
        let kind = if only < kinds { only } else { pick(random, kinds) };
        let next = piece(random, kind);
        if bytes.len() + next.len() + E_STOP > PACKET {
            break;
        }
        bytes.extend(next);
    }
    // The room that is left is filled, so that the packet is full. One in four is split: then a frame begins in the packet
    // before.
    let room = PACKET - E_STOP - bytes.len();
    bytes.splice(0..0, vec![0; room]);
    if pick(random, 4) == 0 {
        let before = 4 + pick(random, 9) as usize;
        bytes.splice(0..0, [vec![0; PACKET - before], vec![5; before]].concat());
    }
    bytes
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
pub(crate) fn sweep(name: &str, traffic: Traffic, channel: Channel, tries: u64, seed: u64) -> u64 {
    let mut rig = armed(ChipOptions { slow: SLOW, ..ChipOptions::new(1) });
    rig.requests_e_stops = channel == Channel::Request;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut cycles: Vec<_> =
        (0..tries).map(|_| latency(&mut rig, name, traffic, channel, &mut random)).collect();
    cycles.sort_unstable();
    let (least, median, most) = (cycles[0], cycles[cycles.len() / 2], cycles[cycles.len() - 1]);
    println!(
        "{name}, {traffic:?}: e-stop by {channel:?} to all lines low: {least} / {median} / {most} cycles (least, median, most of {tries})"
    );
    assert_eq!(rig.chip.read("STALLS", 4).unwrap(), 0, "the executor counts as hung");
    let (boots, notices) = rig.finish();
    assert_eq!(boots.len(), 1, "the chip has restarted");
    // The judge knows no bytes beside the host's.
    if traffic == Traffic::Quiet {
        let wrong = boots[0].judge(&notices);
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }
    most
}

#[test]
fn lines_are_low_soon_after_a_frame() {
    assert!(sweep("edge-45-paper", Traffic::Quiet, Channel::Frame, TRIES, 1) <= BY_FRAME);
}

#[test]
fn lines_are_low_soon_after_a_frame_under_full_load() {
    assert!(sweep("full-load", Traffic::Quiet, Channel::Frame, TRIES, 2) <= BY_FRAME);
}

#[test]
fn lines_are_low_soon_after_a_frame_anywhere_in_a_packet() {
    assert!(sweep("full-load", Traffic::Shared, Channel::Frame, TRIES, 3) <= BY_FRAME_SHARED);
}

/// Kinds of contrived packets, and their mixtures, several times each.
#[cfg(test)]
const CONTRIVED: u64 = 100;

#[test]
fn lines_are_low_soon_after_a_frame_behind_anything_in_its_packet() {
    assert!(sweep("edge-45-paper", Traffic::Contrived, Channel::Frame, CONTRIVED, 6) <= BY_FRAME_SHARED);
}

/// Speeds of the core at which a request races a packet.
#[cfg(test)]
const SPEEDS: u32 = 15;

#[test]
fn lines_are_low_soon_after_a_request_right_behind_anything_in_a_packet() {
    use firmware_protocol::urgent::e_stop_request;
    use meissner_hil::bench::Function;

    let mut random = ChaCha8Rng::seed_from_u64(8);
    let mut fake = [0; MAX_FRAME];
    let len = encode(&HostMessage::Control { epoch: NEW, seen: 1, op: Op::EStop }, &mut fake).unwrap();
    fake[len - 2] ^= 0x55;
    let fakes = fake[..len].repeat(PACKET / len);
    let mut longest = 0.0_f64;
    // A slower core moves the request over everything that the interrupt does with the packet.
    for step in 0..SPEEDS {
        let slow = 1.0 + f64::from(step) / 25.0;
        // As many CRCs as a packet can ask for.
        let mut packets = vec![fakes.clone()];
        packets.extend((0..2).map(|_| contrived(&mut random)));
        for (phase, bytes) in packets.into_iter().enumerate() {
            let mut rig = armed(ChipOptions { slow, ..ChipOptions::new(1) });
            rig.order(job(&pattern("full-load"), 1.0));
            rig.run_to(rig.now() + 40 * MS + phase as u64 * 1_733).unwrap();
            let epoch = rig.tap().epoch().wrapping_add(1);
            let chip = &mut rig.chip;
            // The request's SETUP packet follows the packet without a pause.
            chip.write(Function::Cdc, &bytes).unwrap();
            chip.control(e_stop_request(epoch)).unwrap();
            chip.run(chip.cycle() + 2 * MS).unwrap();
            let off = chip.pins.led.last().unwrap().to;
            let low = chip.pins.low_since(u64::MAX).unwrap().max(off);
            let requested = chip.requested[0];
            assert!(chip.pins.still_high().is_none() && low > requested);
            let cycles = (low - requested) as f64 / slow;
            longest = longest.max(cycles);
            assert!(
                cycles <= BY_REQUEST as f64,
                "{cycles:.0} cycles behind {bytes:02x?}, {slow:.2} times slower"
            );
        }
    }
    println!("request right behind a packet: at most {longest:.0} cycles");
}

#[test]
fn lines_are_low_soon_after_a_request() {
    assert!(sweep("full-load", Traffic::Quiet, Channel::Request, TRIES, 4) <= BY_REQUEST);
}

#[test]
fn lines_are_low_soon_after_a_request_behind_a_flood() {
    assert!(sweep("full-load", Traffic::Flood(120_000), Channel::Request, TRIES, 5) <= BY_REQUEST);
}
