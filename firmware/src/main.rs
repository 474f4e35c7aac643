//! The firmware of the board: the lines of an array on an RP2040, driven by the controller of `firmware_protocol`.
//!
//! ```text
//!  USB interrupt (usb) ── e-stop (estop) ─▶ pins low at once
//!  USB tasks (usb) ─ packets ▶ shell (an interrupt): the controller ─ blocks ▶ ring (wave) ─ DMA ▶ PIO ▶ pins
//!                  ◀─ frames ─                                                  │ cleared behind it
//!  SysTick (wave): the tick count, wakes the shell at each block ◀──────────────┘
//!  edge of the trigger input (edge): its tick, for the shell
//!  watchdog (fault): fed while shell and tasks live
//!  hangs: the shell finds one of the tasks (beat), a task finds one of the USB controller (revive)
//! ```
//! Priorities: clock and USB interrupts above that of edges, that above the shell, the shell above the tasks. Modules use only those below them:
//! `fault`, `shell`, `self_test`, `usb`, `setup` (takes each request), `control` (ends given-up control transfers), `cable` (whether 5 V
//! are there), `estop`, `revive`, `edge`, `wave`, `wake`, `beat`, `counters`, `board` and `array`. The documentation of `firmware_protocol` is the
//! specification; nothing here decides what a line does.

#![no_std]
#![no_main]

mod array;
mod beat;
mod board;
mod cable;
mod control;
mod counters;
mod edge;
mod estop;
mod fault;
mod revive;
mod self_test;
mod setup;
mod shell;
mod usb;
mod wake;
mod wave;

use cortex_m::peripheral::SCB;
use embassy_executor::Spawner;
use embassy_futures::join::join;
use embassy_rp::clocks::{ClockConfig, CoreVoltage, RoscRng};
use embassy_rp::config::Config;
use embassy_rp::flash::{Blocking, Flash};
use embassy_rp::gpio::{Level, Output};
use embassy_rp::interrupt;
use embassy_rp::interrupt::{InterruptExt, Priority};
use embassy_rp::pac;
use embassy_time::Timer;
use firmware_protocol::controller::Identity;
use firmware_protocol::message::DeviceHello;
use static_cell::StaticCell;

// The second boot stage takes this for the vector table. It copies the code to RAM (see `memory.x`) and then continues at the
// real reset handler.
core::arch::global_asm!(
    ".section .entry,\"a\"",
    ".word _stack_start",
    ".word copy",
    ".thumb_func",
    "copy:",
    "ldr r0, =__image_start",
    "ldr r1, =__image_end",
    "ldr r2, =__image_load",
    "b 2f",
    "1: ldmia r2!, {{r3, r4, r5, r6}}",
    "stmia r0!, {{r3, r4, r5, r6}}",
    "2: cmp r0, r1",
    "blo 1b",
    "ldr r0, =__vector_table",
    "ldr r1, =0xe000ed08", // VTOR
    "str r0, [r1]",
    "ldr r0, [r0, #4]",
    "bx r0",
);

/// How long the crystal may take to start, in units of about 1 ms. A Pico's is specified to need one; the Pico SDK waits for
/// six, so that a slow one starts, too. Meanwhile pull-downs hold the pins.
const CRYSTAL_START: u32 = 6;
/// RP2040-E5: earlier chips (B0 and B1, revision 1) may not come out of a USB reset beside other traffic. The known workaround
/// takes GP15, which drives a motor.
const LEAST_REVISION: u8 = 2;

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let mut clocks = ClockConfig::manual_pll(wave::CRYSTAL_HZ, wave::PLL, CoreVoltage::V1_10);
    if let Some(crystal) = &mut clocks.xosc {
        crystal.delay_multiplier = CRYSTAL_START;
    }
    let chip = embassy_rp::init(Config::new(clocks));
    if pac::SYSINFO.chip_id().read().revision() < LEAST_REVISION {
        refuse(Output::new(chip.PIN_25, Level::Low)).await;
    }
    let (watchdog, cause) = fault::watchdog(chip.WATCHDOG);
    counters::started(cause);
    counters::look_at_outputs();
    let mut core = cortex_m::Peripherals::take().expect("taken once");
    vectors_to_ram(&mut core.SCB);

    interrupt::TIMER_IRQ_0.set_priority(Priority::P3);
    interrupt::USBCTRL_IRQ.set_priority(Priority::P0);

    let serial_number = serial_number(chip.FLASH);
    let (usb, ports) = usb::new(chip.USB, serial_number);
    // Before the shell, which listens to it.
    edge::start();
    shell::start(identity(serial_number), cause, ports);
    wave::start(&mut core.SYST);
    join(usb.run(), fault::feed(watchdog)).await;
}

/// Moves the interrupt vectors to RAM, where the handlers are.
fn vectors_to_ram(scb: &mut SCB) {
    #[repr(C, align(256))]
    struct Vectors([u32; 48]);
    static VECTORS: StaticCell<Vectors> = StaticCell::new();
    // SAFETY: the table in use has 16 exceptions and 32 interrupts.
    let table = unsafe { (scb.vtor.read() as *const [u32; 48]).read() };
    let copy = VECTORS.init(Vectors(table));
    copy.0[edge::VECTOR] = edge::came as *const () as u32;
    // SAFETY: the copy has all entries and the alignment that VTOR needs, and is static.
    unsafe { scb.vtor.write(copy.0.as_ptr() as u32) };
}

/// Blinks twice a second for ever: this chip is too old. No other output is driven, and USB stays off.
async fn refuse(mut led: Output<'static>) -> ! {
    loop {
        led.toggle();
        Timer::after_millis(250).await;
    }
}

fn identity(serial_number: &str) -> Identity {
    let version =
        [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR"), env!("CARGO_PKG_VERSION_PATCH")];
    let build: u32 = env!("BUILD_HASH").parse().unwrap_or(0);
    Identity {
        firmware: version.map(|part| part.parse().unwrap_or(0)),
        build: build.to_be_bytes(),
        boot: boot_id(serial_number),
        features: if board::TRIGGER_INPUT.is_some() { DeviceHello::TRIGGER_INPUT } else { 0 }
            | if board::TRIGGERED == 0 { DeviceHello::NO_TRIGGER_OUTPUT } else { 0 },
    }
}

/// A number that differs at each start and on each board. A bit of the ring oscillator is biased and depends on the one before,
/// so this is a hash of many bits and of the serial number.
fn boot_id(serial_number: &str) -> u32 {
    let mut samples = [0; 1024];
    RoscRng.fill_bytes(&mut samples);
    // FNV-1a, then the last steps of MurmurHash3, so that each bit depends on all: not for security.
    let bytes = serial_number.bytes().chain(samples);
    let mut hash =
        bytes.fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

/// The chip's serial number, which is that of its flash: 16 hex digits.
fn serial_number(flash: embassy_rp::Peri<'static, embassy_rp::peripherals::FLASH>) -> &'static str {
    static TEXT: StaticCell<[u8; 16]> = StaticCell::new();
    let mut number = [0; 8];
    // All zeros on failure: the board works without a number.
    let _ = Flash::<_, Blocking, { 2 << 20 }>::new_blocking(flash).blocking_unique_id(&mut number);
    let text = TEXT.init([0; 16]);
    for (digits, byte) in text.chunks_exact_mut(2).zip(number) {
        for (digit, half) in digits.iter_mut().zip([byte >> 4, byte & 15]) {
            *digit = b"0123456789ABCDEF"[usize::from(half)];
        }
    }
    str::from_utf8(text).unwrap_or_default()
}
