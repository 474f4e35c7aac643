//! Resets of the bus, unplugged cables and abandoned requests at each step of a control transfer: the next enumeration succeeds.

use crate::play::{armed, job, pattern};
use firmware_protocol::frame::{Decoder, MAX_FRAME, encode, read};
use firmware_protocol::message::{DeviceMessage, HostMessage};
use meissner_hil::bench::Function;
use meissner_hil::bench::chip::{ChipBench, ChipOptions};
use meissner_hil::time::MS;

/// What ends a control transfer besides its end.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cut {
    /// The host resets the bus.
    Reset,
    /// The cable is out for so many ms. Tests use a time of a bad contact, and one that the board sees as unplugged.
    Unplugged(u64),
    /// The host begins another transfer.
    Abandoned,
}

/// Cycles from the beginning or the end of a transaction to the cut: at once, and while the transaction or the firmware is under way.
const LATER: [u64; 3] = [0, 400, 2_000];
/// Most time until the host has configured the device: debouncing, a reset and the requests take 40 ms.
const CONFIGURED: u64 = 100 * MS;
/// Most time of a control transfer.
const ANSWERED: u64 = 20 * MS;
/// How much slower a core is that takes a request only after another can have come, 2 300 cycles later.
const SLOW: f64 = 2.5;
/// Most cycles from then on until this core has taken the request.
const TAKEN: u64 = 2_000;
/// More transactions than any enumeration or transfer has.
const MANY: usize = 100;

const DEVICE: [u8; 8] = [0x80, 6, 0, 1, 0, 0, 18, 0];
/// Descriptors of a device that knows high speed, too: the device qualifier, and the configuration at the other speed.
const QUALIFIER: [u8; 8] = [0x80, 6, 0, 6, 0, 0, 10, 0];
const OTHER_SPEED: [u8; 8] = [0x80, 6, 0, 7, 0, 0, 9, 0];
/// Later transfers: in both directions, with and without data, of one packet and of more, known and unknown.
const TRANSFERS: [(&str, [u8; 8], &[u8]); 9] = [
    ("device descriptor", DEVICE, &[]),
    ("configuration descriptor", [0x80, 6, 0, 2, 0, 0, 255, 0], &[]),
    ("BOS descriptor", [0x80, 6, 0, 15, 0, 0, 255, 0], &[]),
    ("Windows descriptors", [0xc0, b'M', 0, 0, 7, 0, 255, 0], &[]),
    ("line coding", [0x21, 0x20, 0, 0, 0, 0, 7, 0], &[0, 0xc2, 1, 0, 0, 0, 8]),
    ("lines", [0x21, 0x22, 3, 0, 0, 0, 0, 0], &[]),
    ("e-stop", [0x40, b'E', 0, 0, 0, 0, 0, 0], &[]),
    ("device qualifier", QUALIFIER, &[]),
    ("unknown", [0xc0, b'?', 0, 0, 0, 0, 4, 0], &[]),
];

/// A chip, after its first enumeration.
pub(crate) fn start() -> ChipBench {
    let mut chip = ChipBench::start(&ChipOptions::new(1)).unwrap_or_else(|error| panic!("{error}"));
    assert!(comes(&mut chip, 500 * MS), "no device");
    chip
}

/// Runs until the host has configured the device.
fn comes(chip: &mut ChipBench, within: u64) -> bool {
    let end = chip.cycle() + within;
    while !chip.configured() && chip.cycle() < end {
        chip.run(chip.cycle() + MS / 2).unwrap();
    }
    chip.configured()
}

fn replug(chip: &mut ChipBench, ms: u64) {
    chip.usb(false).unwrap();
    chip.run(chip.cycle() + ms * MS).unwrap();
    chip.usb(true).unwrap();
}

/// Runs to a step of the control transfers under way. `false` if there are fewer.
fn reach(chip: &mut ChipBench, step: usize, later: u64) -> bool {
    for _ in 0..step {
        let end = chip.cycle() + 40 * MS;
        chip.run_to_control(40 * MS).unwrap();
        if chip.cycle() >= end {
            return false;
        }
    }
    if later > 0 {
        chip.run(chip.cycle() + later).unwrap();
    }
    true
}

/// Whether the device answers a request and a hello.
fn answers(chip: &mut ChipBench) -> bool {
    chip.transfers.clear();
    chip.transfer(DEVICE, &[]).unwrap();
    let end = chip.cycle() + ANSWERED;
    while chip.transfers.is_empty() && chip.cycle() < end {
        chip.run(chip.cycle() + MS / 2).unwrap();
    }
    let Some(Some(device)) = chip.transfers.first() else { return false };
    // As the emulated host reads it at each enumeration.
    if device.len() != 18 || device[..2] != [18, 1] || device[8..12] != [0x09, 0x12, 1, 0] {
        return false;
    }
    chip.take_heard();
    let mut frame = [0; MAX_FRAME];
    let len = encode(&HostMessage::Hello { session: 5 }, &mut frame).unwrap();
    chip.write(Function::Bulk, &frame[..len]).unwrap();
    chip.run(chip.cycle() + 5 * MS).unwrap();
    let heard = chip.take_heard().bulk;
    let (mut heard, mut decoder) = (&heard[..], Decoder::new());
    while let Some(body) = decoder.next(&mut heard) {
        if let Ok(DeviceMessage::Hello(_)) = read(body) {
            return true;
        }
    }
    false
}

/// Makes the cut, and returns whether the device is there afterwards, in the same boot and without having set USB up again.
fn survives(chip: &mut ChipBench, cut: Cut) -> bool {
    match cut {
        Cut::Reset => chip.bus("reset").unwrap(),
        Cut::Unplugged(ms) => replug(chip, ms),
        Cut::Abandoned => chip.bus("abandon").unwrap(),
    }
    comes(chip, CONFIGURED)
        && answers(chip)
        && chip.resets() == 0
        && chip.read("USB_RECOVERIES", 4).unwrap() == 0
}

/// Counts cuts, and takes another chip after each that has hung one.
#[derive(Default)]
struct Tally {
    chip: Option<ChipBench>,
    cuts: u64,
    hung: Vec<String>,
}

impl Tally {
    fn chip(&mut self) -> &mut ChipBench {
        self.chip.get_or_insert_with(start)
    }

    fn cut(&mut self, cut: Cut, what: &str, step: usize, later: u64) {
        self.cuts += 1;
        if !survives(self.chip(), cut) {
            self.hung.push(format!("{cut:?}, {what}, step {step}, {later} cycles later"));
            self.chip = None;
        }
        assert!(self.hung.len() < 20, "{} of {}:\n{}", self.hung.len(), self.cuts, self.hung.join("\n"));
    }

    fn judge(self, what: &str) {
        println!("{what}: {} of {} interruptions hang the device", self.hung.len(), self.cuts);
        assert!(self.cuts > 50, "{}", self.cuts);
        assert!(self.hung.is_empty(), "{}", self.hung.join("\n"));
    }
}

#[test]
fn an_enumeration_that_is_cut_anywhere_is_followed_by_one_that_succeeds() {
    let mut tally = Tally::default();
    for cut in [Cut::Reset, Cut::Unplugged(1), Cut::Unplugged(40)] {
        for later in LATER {
            for step in 1..MANY {
                let chip = tally.chip();
                replug(chip, 5);
                if !reach(chip, step, later) || chip.configured() {
                    assert!(step > 40, "an enumeration has {step} steps");
                    break;
                }
                tally.cut(cut, "enumeration", step, later);
            }
        }
    }
    tally.judge("enumeration");
}

#[test]
fn a_control_transfer_that_is_cut_anywhere_leaves_a_device_that_answers() {
    let mut tally = Tally::default();
    for cut in [Cut::Reset, Cut::Unplugged(1), Cut::Unplugged(40), Cut::Abandoned] {
        for (name, setup, data) in TRANSFERS {
            for (at, later) in LATER.into_iter().enumerate() {
                for step in 1..MANY {
                    let chip = tally.chip();
                    chip.transfers.clear();
                    chip.transfer(setup, data).unwrap();
                    if !reach(chip, step, later) || !chip.transfers.is_empty() {
                        assert!(step > 2 || at > 0, "{name} has {step} steps");
                        break;
                    }
                    tally.cut(cut, name, step, later);
                }
            }
        }
    }
    tally.judge("control transfers");
}

#[test]
fn a_request_that_comes_while_the_firmware_takes_another_is_answered() {
    let options = ChipOptions { slow: SLOW, ..ChipOptions::new(1) };
    let mut chip = ChipBench::start(&options).unwrap();
    assert!(comes(&mut chip, 500 * MS));
    let (name, setup, data) = TRANSFERS[4];
    for later in 0..TAKEN {
        chip.transfer(setup, data).unwrap();
        assert!(reach(&mut chip, 1, later));
        chip.bus("abandon").unwrap();
        assert!(answers(&mut chip), "a request is lost, {later} cycles after that of {name}");
    }
}

#[test]
fn a_device_of_full_speed_alone_refuses_the_descriptors_of_high_speed() {
    let mut chip = start();
    for (setup, answered) in [(QUALIFIER, false), (OTHER_SPEED, false), (DEVICE, true)] {
        chip.transfers.clear();
        chip.transfer(setup, &[]).unwrap();
        chip.run(chip.cycle() + ANSWERED).unwrap();
        let answers: Vec<_> = chip.transfers.iter().map(Option::is_some).collect();
        assert_eq!(answers, [answered], "{setup:02x?}");
    }
    assert!(answers(&mut chip));
}

#[test]
fn a_play_is_whole_after_cut_transfers() {
    let mut rig = armed(ChipOptions::new(1));
    for cut in [Cut::Reset, Cut::Unplugged(1), Cut::Unplugged(40)] {
        let chip = &mut rig.chip;
        chip.transfer(TRANSFERS[1].1, &[]).unwrap();
        assert!(reach(chip, 3, 400));
        assert!(survives(chip, cut), "{cut:?}");
    }
    let now = rig.chip.cycle();
    rig.disconnect("cut");
    rig.run_to(now + 200 * MS).unwrap();
    rig.order(meissner_stream::queues::Command::Arm { assume_rest: true });
    rig.run_to(rig.now() + 50 * MS).unwrap();
    rig.order(job(&pattern("full-load"), 0.1));
    let bursts = rig.run_to_end(1, 2_000).unwrap().bursts;
    assert!(bursts.planned > 0 && bursts.played == bursts.planned, "{bursts:?}");
}

/// Most time until the firmware has seen that the cable's 5 V are gone, and that they are back.
const SENSED: u64 = 40 * MS;
const VBUS: u32 = 1 << 24;

#[test]
fn a_board_with_a_supply_of_its_own_leaves_the_bus_while_there_are_no_5_v() {
    let mut chip = start();
    // They are gone, and the host could still see the device.
    chip.wiring(0, VBUS, &[]).unwrap();
    chip.run(chip.cycle() + SENSED).unwrap();
    assert!(!chip.configured(), "the pull-up is on without 5 V");
    chip.run(chip.cycle() + 300 * MS).unwrap();
    assert!(!chip.configured(), "it came back without 5 V");
    chip.wiring(0, 0, &[]).unwrap();
    assert!(comes(&mut chip, SENSED + CONFIGURED) && answers(&mut chip), "it does not come back");
    // A bad contact.
    chip.wiring(0, VBUS, &[]).unwrap();
    chip.run(chip.cycle() + 9 * MS).unwrap();
    chip.wiring(0, 0, &[]).unwrap();
    chip.run(chip.cycle() + SENSED).unwrap();
    assert!(chip.configured(), "9 ms without 5 V count as unplugged");
    assert_eq!((chip.resets(), chip.read("USB_RECOVERIES", 4).unwrap()), (0, 0));
}

#[test]
fn a_board_that_does_not_sense_the_cables_5_v_works_without() {
    let more = vec!["--vbus-sense".to_owned(), "no".to_owned()];
    let options = ChipOptions { more, ..ChipOptions::new(1) };
    let mut chip = ChipBench::start(&options).unwrap();
    assert!(comes(&mut chip, 500 * MS) && answers(&mut chip));
    replug(&mut chip, 100);
    assert!(comes(&mut chip, CONFIGURED) && answers(&mut chip));
    assert_eq!((chip.resets(), chip.read("USB_RECOVERIES", 4).unwrap()), (0, 0));
}
