//! The waveform: PIO and DMA put a ring of words on the pins at 85 kHz, and SysTick counts the ticks.
//!
//! A tick is four words: all lines high, only the down lines (from 20 % on), no line (from 80 % on, twice). One
//! DMA channel feeds a block of them to the PIO, another clears what was fed, and each starts the other: no CPU
//! has to live for the waveform to end. Words that are not rendered in time are zero, and zero is all outputs low.
//! What is to be rendered, and when that is late, is the shell's business.
//!
//! Invariant: [`now`] is the tick on the pins, also while the drivers of both are held up. An e-stop stops it
//! ([`freeze_low`]) until the controller knows of it.

use crate::board::{self, ENABLED, OUTPUTS, TRIGGERED};
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::SeqCst};
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;
use embassy_rp::clocks::PllConfig;
use embassy_rp::pac;
use embassy_rp::pac::dma::vals::{DataSize, TreqSel};
use embassy_rp::pio::program::pio_asm;
use firmware_protocol::controller::{BLOCK, HORIZON, Run};
use firmware_protocol::tick::{TICK_HZ, Tick};

/// The Pico's crystal.
pub(crate) const CRYSTAL_HZ: u32 = 12_000_000;
/// Makes [`SYSTEM_HZ`] of it, by way of 1020 MHz.
pub(crate) const PLL: PllConfig = PllConfig { refdiv: 1, fbdiv: 85, post_div1: 4, post_div2: 2 };
/// 85 kHz are 1500 cycles of it, exactly.
const SYSTEM_HZ: u32 = 127_500_000;
const CYCLES_PER_TICK: u32 = SYSTEM_HZ / TICK_HZ;
/// System cycles per cycle of the PIO: a tick has 25, the lines fall after 5 or 20.
const PIO_DIVIDER: u16 = 60;
const WORDS: usize = 4;
const RING_TICKS: usize = HORIZON as usize;
/// The ring's size in bytes is 2 to this.
const RING_BITS: u8 = 10;
const BLOCK_CYCLES: u32 = BLOCK * CYCLES_PER_TICK;
/// The DMA is ahead of the pins: 8 words in the FIFO, one being shifted out and one on its way.
pub(crate) const FETCHED: u64 = 3;
const FEED: usize = 0;
const CLEAR: usize = 1;

const _: () = assert!(CRYSTAL_HZ * PLL.fbdiv as u32 / (PLL.post_div1 * PLL.post_div2) as u32 == SYSTEM_HZ);
const _: () = assert!(SYSTEM_HZ.is_multiple_of(TICK_HZ) && CYCLES_PER_TICK == 25 * PIO_DIVIDER as u32);
const _: () = assert!(RING_TICKS * WORDS * 4 == 1 << RING_BITS);
const _: () = assert!(Tick::BOOT.0.is_multiple_of(BLOCK as u64));

/// Read by the DMA while the CPU writes; the ring's address must be a multiple of its size.
#[repr(C, align(1024))]
struct Ring(UnsafeCell<[[u32; WORDS]; RING_TICKS]>);
// SAFETY: only `write` touches it, from one interrupt, and through volatile writes of single words.
unsafe impl Sync for Ring {}
static RING: Ring = Ring(UnsafeCell::new([[0; WORDS]; RING_TICKS]));
static ZERO: AtomicU32 = AtomicU32::new(0);

/// Blocks that have begun, low and high half: written by `SysTick` alone. The bench holds it against the pins.
#[unsafe(no_mangle)]
static BLOCKS: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];
/// All outputs are forced low.
static FORCED: AtomicBool = AtomicBool::new(false);
/// Time stands still for the controller, at this tick, until it has been told of an e-stop.
static FROZEN: AtomicBool = AtomicBool::new(false);
static FROZEN_AT: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

/// Sets up PIO, DMA and clock, and starts them. The ring is empty: all outputs are low.
pub(crate) fn start(syst: &mut SYST) {
    let program = pio_asm!(
        ".wrap_target",
        "out pins, 32 [4]",
        "out pins, 32 [14]",
        "out pins, 32 [2]",
        "out pins, 32 [1]",
        ".wrap",
    )
    .program;
    for (at, &code) in program.code.iter().enumerate() {
        pac::PIO0.instr_mem(at).write(|w| w.set_instr_mem(code));
    }
    let machine = pac::PIO0.sm(0);
    machine.clkdiv().write(|w| w.set_int(PIO_DIVIDER));
    machine.execctrl().write(|w| {
        w.set_wrap_bottom(program.wrap.target);
        w.set_wrap_top(program.wrap.source);
    });
    machine.shiftctrl().write(|w| {
        w.set_autopull(true);
        w.set_pull_thresh(0); // 32
        w.set_out_shiftdir(true);
        w.set_fjoin_tx(true);
    });
    for pin in OUTPUTS {
        // Low before it is an output, and an output before it follows the PIO.
        machine.pinctrl().write(|w| {
            w.set_set_base(pin);
            w.set_set_count(1);
        });
        machine.instr().write(|w| w.set_instr(0xe000)); // set pins, 0
        machine.instr().write(|w| w.set_instr(0xe081)); // set pindirs, 1
        pac::PADS_BANK0.gpio(pin.into()).modify(|w| w.set_od(false));
        pac::IO_BANK0.gpio(pin.into()).ctrl().write(|w| w.set_funcsel(PIO_FUNCTION));
    }
    // From GPIO 0 to the last; those in between that are not outputs are not the PIO's, and do not change.
    let last = OUTPUTS.into_iter().max().unwrap_or(0);
    machine.pinctrl().write(|w| w.set_out_count(last + 1));

    let ring = RING.0.get() as u32;
    let feed = pac::DMA.ch(FEED);
    feed.read_addr().write_value(ring);
    feed.write_addr().write_value(pac::PIO0.txf(0).as_ptr() as u32);
    let clear = pac::DMA.ch(CLEAR);
    clear.read_addr().write_value(ZERO.as_ptr() as u32);
    clear.write_addr().write_value(ring);
    for (channel, other) in [(FEED, CLEAR), (CLEAR, FEED)] {
        let feeds = channel == FEED;
        pac::DMA.ch(channel).trans_count().write_value(BLOCK * WORDS as u32);
        let mut ctrl = pac::dma::regs::CtrlTrig(0);
        ctrl.set_en(true);
        ctrl.set_high_priority(true);
        ctrl.set_data_size(DataSize::SIZE_WORD);
        ctrl.set_incr_read(feeds);
        ctrl.set_incr_write(!feeds);
        ctrl.set_ring_size(RING_BITS);
        ctrl.set_ring_sel(!feeds);
        ctrl.set_chain_to(other as u8);
        ctrl.set_treq_sel(if feeds { TreqSel::PIO0_TX0 } else { TreqSel::PERMANENT });
        ctrl.set_irq_quiet(true);
        pac::DMA.ch(channel).al1_ctrl().write_value(ctrl.0);
    }
    // The CPU must not hold up the waveform.
    pac::BUSCTRL.bus_priority().write(|w| {
        w.set_dma_r(true);
        w.set_dma_w(true);
    });
    pac::DMA.multi_chan_trigger().write(|w| w.0 = 1 << FEED);

    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(BLOCK_CYCLES - 1);
    syst.clear_current();
    syst.enable_interrupt();
    // The clock is ahead of the pins by some cycles, so that none is high as a tick begins: a force that comes just
    // then cuts pulses of the tick that it is booked in.
    cortex_m::interrupt::free(|_| {
        syst.enable_counter();
        pac::PIO0.ctrl().write(|w| {
            w.set_sm_enable(1);
            w.set_clkdiv_restart(1);
        });
    });
}

const PIO_FUNCTION: u8 = 6;

#[exception]
fn SysTick() {
    let low = BLOCKS[0].load(SeqCst).wrapping_add(1);
    BLOCKS[0].store(low, SeqCst);
    if low == 0 {
        BLOCKS[1].store(BLOCKS[1].load(SeqCst).wrapping_add(1), SeqCst);
    }
    crate::shell::wake();
}

/// The tick on the pins, or the one at which an e-stop was seen that the controller has not been told of.
pub(crate) fn now() -> Tick {
    if FROZEN.load(SeqCst) { Tick(join(&FROZEN_AT)) } else { running() }
}

/// The tick on the pins. From any context.
fn running() -> Tick {
    loop {
        let blocks = join(&BLOCKS);
        let pending = SCB::is_pendst_pending();
        let left = SYST::get_current();
        // Nothing has happened in between: the three belong together.
        if pending == SCB::is_pendst_pending() && blocks == join(&BLOCKS) {
            return tick(blocks + u64::from(pending), left, 0);
        }
    }
}

/// The tick of so many cycles (of less than a block) ago, when so many blocks had begun and `left` was on the counter.
fn tick(blocks: u64, left: u32, ago: u32) -> Tick {
    // The exception comes as the counter reaches 0, one cycle before it is reloaded.
    let cycles = if left == 0 { 0 } else { BLOCK_CYCLES - left };
    let (blocks, cycles) = if cycles >= ago {
        (blocks, cycles - ago)
    } else {
        (blocks.saturating_sub(1), cycles + BLOCK_CYCLES - ago)
    };
    // cycles / 1500, exact below 24 000.
    Tick::BOOT + (blocks * u64::from(BLOCK) + u64::from((cycles * 11_185) >> 24))
}

fn join([low, high]: &[AtomicU32; 2]) -> u64 {
    u64::from(high.load(SeqCst)) << 32 | u64::from(low.load(SeqCst))
}

/// Puts the run that begins at `tick` into the ring.
pub(crate) fn write(tick: Tick, run: &Run, enabled: bool) {
    let (up, down) = (board::gpios(run.lines.up), board::gpios(run.lines.down));
    let held = if enabled { ENABLED } else { 0 } | if run.trigger { TRIGGERED } else { 0 };
    let words = [held | up | down, held | down, held, held];
    let first = (tick.0 - Tick::BOOT.0) as usize % RING_TICKS;
    for at in first..first + run.ticks as usize {
        let place = RING.0.get().cast::<[u32; WORDS]>().wrapping_add(at % RING_TICKS).cast::<u32>();
        for (i, word) in words.into_iter().enumerate() {
            // SAFETY: the index is within the ring; the DMA may read the word at any time.
            unsafe { place.wrapping_add(i).write_volatile(word) };
        }
    }
}

/// Forces all outputs low at the pads, whatever PIO and DMA do. From any context.
#[inline(always)]
pub(crate) fn force_low() {
    let mut low = pac::io::regs::GpioCtrl(0);
    low.set_funcsel(PIO_FUNCTION);
    low.set_outover(pac::io::vals::Outover::LOW);
    for control in &CONTROLS {
        // SAFETY: these registers are always there; nothing else of them is in use.
        unsafe { (*control as *mut u32).write_volatile(low.0) };
    }
    FORCED.store(true, SeqCst);
}

/// The control registers of all outputs. An e-stop has no time to work them out.
static CONTROLS: [usize; OUTPUTS.len()] = {
    let mut registers = [0; OUTPUTS.len()];
    let mut at = 0;
    while at < OUTPUTS.len() {
        // IO_BANK0: a status and a control register for each pin.
        registers[at] = 0x4001_4004 + 8 * OUTPUTS[at] as usize;
        at += 1;
    }
    registers
};

/// Cycles by which the clock is ahead of the pins, as `start` starts them (66, measured in the emulator), and some.
const AHEAD: u32 = 75;

/// Forces all outputs low and stops time for the controller, until [`go_on`]. From the USB interrupt, which `SysTick`
/// does not preempt.
pub(crate) fn freeze_low() {
    force_low();
    // Pulses of this tick and of no later one have begun, if only for the time that forcing takes.
    let left = SYST::get_current();
    let pending = SCB::is_pendst_pending();
    // It may have begun another block since.
    let since = left != 0 && SYST::get_current() > left;
    let at = tick((join(&BLOCKS) + u64::from(pending)).saturating_sub(since.into()), left, AHEAD);
    FROZEN_AT[0].store(at.0 as u32, SeqCst);
    FROZEN_AT[1].store((at.0 >> 32) as u32, SeqCst);
    FROZEN.store(true, SeqCst);
}

/// The controller has been told: time goes on.
pub(crate) fn go_on() {
    FROZEN.store(false, SeqCst);
}

/// Lets the outputs follow the waveform again, unless an e-stop has come meanwhile.
pub(crate) fn release() {
    // The e-stop's interrupt must not come in between, or some pins would be let go after it.
    critical_section::with(|_| {
        if FORCED.load(SeqCst) && !FROZEN.load(SeqCst) {
            for control in &CONTROLS {
                // SAFETY: as in `force_low`.
                unsafe { (*control as *mut u32).write_volatile(PIO_FUNCTION.into()) };
            }
            FORCED.store(false, SeqCst);
        }
    });
}
