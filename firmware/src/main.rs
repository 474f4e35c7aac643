//! The firmware of the board: 24 lines at 85 kHz on an RP2040, driven by the controller of `firmware_protocol`.
//!
//! ```text
//!  USB interrupt (usb) ── e-stop (estop) ─▶ pins low at once
//!  USB tasks (usb) ─ packets ▶ shell (an interrupt): the controller ─ blocks ▶ ring (wave) ─ DMA ▶ PIO ▶ pins
//!                  ◀─ frames ─                                                  │ cleared behind it
//!  SysTick (wave): the tick count, wakes the shell at each block ◀──────────────┘
//!  watchdog (fault): fed while shell and tasks live
//! ```
//! Priorities: clock and USB interrupts above the shell, the shell above the tasks. Modules use only those below them:
//! `fault`, `shell`, `usb`, `estop`, `wave`, `wake` and `board`. The documentation of `firmware_protocol` is the
//! specification; nothing here decides what a line does.

#![no_std]
#![no_main]

mod board;
mod estop;
mod fault;
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
use embassy_rp::interrupt;
use embassy_rp::interrupt::{InterruptExt, Priority};
use firmware_protocol::controller::Identity;
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
    "1: ldmia r2!, {{r3}}",
    "stmia r0!, {{r3}}",
    "2: cmp r0, r1",
    "blo 1b",
    "ldr r0, =__vector_table",
    "ldr r1, =0xe000ed08", // VTOR
    "str r0, [r1]",
    "ldr r0, [r0, #4]",
    "bx r0",
);

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let clocks = ClockConfig::manual_pll(wave::CRYSTAL_HZ, wave::PLL, CoreVoltage::V1_10);
    let chip = embassy_rp::init(Config::new(clocks));
    let (watchdog, cause) = fault::watchdog(chip.WATCHDOG);
    let mut core = cortex_m::Peripherals::take().expect("taken once");
    vectors_to_ram(&mut core.SCB);

    interrupt::TIMER_IRQ_0.set_priority(Priority::P3);
    interrupt::USBCTRL_IRQ.set_priority(Priority::P0);

    let (usb, ports) = usb::new(chip.USB, serial_number(chip.FLASH));
    shell::start(identity(), cause, ports);
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
    // SAFETY: the copy has all entries and the alignment that VTOR needs, and is static.
    unsafe { scb.vtor.write(copy.0.as_ptr() as u32) };
}

fn identity() -> Identity {
    let version =
        [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR"), env!("CARGO_PKG_VERSION_PATCH")];
    let build: u32 = env!("BUILD_HASH").parse().unwrap_or(0);
    Identity {
        firmware: version.map(|part| part.parse().unwrap_or(0)),
        build: build.to_be_bytes(),
        boot: RoscRng.next_u32(),
        features: 0,
    }
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
