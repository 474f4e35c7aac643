//! Interrupts, the executor or the USB controller hang while the rest lives: the lines are low in time, and the rest goes on.

use crate::play::{armed, job, pattern};
use firmware_protocol::controller::{BLOCK, HORIZON};
use firmware_protocol::message::State;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::rig::Rig;
use meissner_hil::time::{MS, TICK};
use meissner_stream::queues::Command;
use meissner_test_support::paper::DRIVER_LEAD;

/// `b .`: an endless loop.
const LOOP: [u8; 2] = [0xfe, 0xe7];
/// `bx lr`: an interrupt that returns at once, with its line still high, so that it comes again for ever.
const RETURN: [u8; 2] = [0x70, 0x47];
/// Most ticks from a hang of interrupts to all outputs low: what was rendered ahead.
const RENDERED: u64 = HORIZON as u64;
/// From the hang of the executor to the beginning of the return: 10 ms without a beat, the beat before, and the block.
const EXECUTOR_SEEN: u64 = 12 * MS + (HORIZON + BLOCK) as u64 * TICK;
/// The longest return: 400 µm at 0.14 µm per pulse, after the drivers' lead.
const RETURN_TAKES: u64 = (400 * 100 / 14 + DRIVER_LEAD as u64) * TICK;

/// A rig in the middle of a play under full load.
fn playing() -> Rig {
    let mut rig = armed(ChipOptions::new(1));
    rig.order(job(&pattern("full-load"), 5.0));
    rig.run_to(rig.now() + 40 * MS).unwrap();
    rig
}

/// Ticks until all outputs are low for good.
fn low_after(rig: &mut Rig, from: u64) -> u64 {
    let pins = &rig.chip.pins;
    assert!(pins.still_high().is_none());
    let off =
        [pins.enable.last().unwrap().to, pins.led.last().unwrap().to, pins.low_since(u64::MAX).unwrap()];
    off.into_iter().max().unwrap().saturating_sub(from).div_ceil(TICK)
}

/// Asserts that all outputs are low once the hang was seen, within `seen` cycles, and the pins have returned.
fn assert_low_after_return(rig: &mut Rig, what: &str, from: u64, seen: u64) {
    let ticks = low_after(rig, from);
    println!("{what}: outputs low after {:.1} ms", (ticks * TICK) as f64 / MS as f64);
    assert!(ticks * TICK <= seen + RETURN_TAKES, "{what}: {ticks} ticks");
}

/// The watchdog restarts the chip, which then answers again.
fn restarts(rig: &mut Rig) {
    rig.run_to(rig.now() + 400 * MS).unwrap();
    assert_eq!(rig.chip.resets(), 1);
    assert_eq!(rig.tap().status().unwrap().state, State::Disarmed);
}

#[test]
fn a_hung_interrupt_leaves_the_lines_low_after_what_was_rendered() {
    let hangs = [
        ("USB interrupt, loops", "USBCTRL_IRQ", LOOP),
        ("USB interrupt, comes again", "USBCTRL_IRQ", RETURN),
        ("shell, loops", "SWI_IRQ_0", LOOP),
        ("shell, does nothing", "SWI_IRQ_0", RETURN),
    ];
    for (name, symbol, code) in hangs {
        let mut rig = playing();
        let chip = &mut rig.chip;
        // A turn of the shell that is under way would end first.
        let mut busy = None;
        while busy.replace(chip.busy_cycles()) != Some(chip.busy_cycles()) {
            chip.run(chip.cycle() + 200).unwrap();
        }
        chip.poke(symbol, &code).unwrap();
        // Brings a USB interrupt.
        chip.control([0x40, 0, 0, 0, 0, 0, 0, 0]).unwrap();
        rig.run_to(rig.now() + 20 * MS).unwrap();
        let from = rig.chip.requested[0];
        let ticks = low_after(&mut rig, from);
        println!("{name}: outputs low after {ticks} ticks, {:.2} ms", (ticks * TICK) as f64 / MS as f64);
        // The shell's hang begins up to a block before the interrupt of USB.
        assert!(ticks <= RENDERED + u64::from(BLOCK), "{name}: {ticks} ticks");
        restarts(&mut rig);
    }
}

#[test]
fn a_hung_executor_returns_the_pins_before_the_watchdog_restarts_the_chip() {
    let mut rig = playing();
    rig.chip.poke("executor_beats", &LOOP).unwrap();
    let from = rig.now();
    rig.run_to(from + 60 * MS).unwrap();
    assert_low_after_return(&mut rig, "executor", from, EXECUTOR_SEEN);
    let chip = &mut rig.chip;
    assert_eq!((chip.resets(), chip.read("STALLS", 4).unwrap()), (0, 1));
    // Whole pulses only, and every pin is back: a pulse down is four times as long as one up.
    for (line, trains) in chip.pins.lines.iter().enumerate() {
        let sum = |width| -> u64 {
            trains.iter().filter(|train| train.width == width).map(|train| train.pulses).sum()
        };
        assert!(trains.iter().all(|train| matches!(train.width, 300 | 1200)), "line {line}");
        assert!(sum(300) > 0 && sum(300) == sum(1200), "line {line}: {} up, {} down", sum(300), sum(1200));
    }
    restarts(&mut rig);
}

#[test]
fn the_executor_is_not_taken_for_hung_under_a_flood() {
    let mut rig = playing();
    for _ in 0..200 {
        rig.raw(&[0x55; 400]);
        rig.raw(&[0]);
        rig.run_to(rig.now() + MS / 2).unwrap();
    }
    let chip = &mut rig.chip;
    assert_eq!((chip.resets(), chip.read("STALLS", 4).unwrap()), (0, 0));
}

/// From the hang of the USB controller to the beginning of the return: 100 ms without a frame, and the looks.
const USB_SEEN: u64 = 115 * MS;

#[test]
fn a_hung_usb_controller_is_set_up_again() {
    let mut rig = playing();
    rig.chip.bus("hang").unwrap();
    let from = rig.now();
    rig.run_to(from + 400 * MS).unwrap();
    assert_low_after_return(&mut rig, "USB", from, USB_SEEN);
    let chip = &mut rig.chip;
    assert_eq!((chip.resets(), chip.read("USB_RECOVERIES", 4).unwrap()), (0, 1));
    assert!(chip.configured(), "the host has not found the device again");
    // The same boot, with the position: no assumption is needed.
    let status = rig.tap().status().unwrap();
    assert_eq!((status.state, status.position_known, status.outstanding), (State::Disarmed, true, 0));
    rig.order(Command::Arm { assume_rest: false });
    rig.run_to(rig.now() + 50 * MS).unwrap();
    assert!(rig.run_to_end(1, 100).unwrap().bursts.dropped > 0);
    rig.notices.clear();
    rig.order(job(&pattern("full-load"), 0.1));
    let bursts = rig.run_to_end(1, 2_000).unwrap().bursts;
    assert!(bursts.planned > 0 && bursts.played == bursts.planned, "{bursts:?}");
}

#[test]
fn a_suspended_or_silent_bus_is_not_taken_for_hung() {
    let mut rig = armed(ChipOptions::new(1));
    rig.chip.bus("suspend").unwrap();
    rig.run_to(rig.now() + 300 * MS).unwrap();
    rig.chip.bus("resume").unwrap();
    rig.run_to(rig.now() + 300 * MS).unwrap();
    rig.plug(false).unwrap();
    rig.run_to(rig.now() + 300 * MS).unwrap();
    rig.plug(true).unwrap();
    rig.run_to(rig.now() + 300 * MS).unwrap();
    let chip = &mut rig.chip;
    assert_eq!((chip.resets(), chip.read("USB_RECOVERIES", 4).unwrap()), (0, 0));
    assert!(chip.configured());
}
