//! The waveform: PIO and DMA put a ring of words on the pins, four in each tick, and SysTick counts the ticks.
//!
//! The words of a tick: all pulsing lines high, only the down lines, no line, twice. One DMA
//! channel feeds a block of words to the PIO, another clears them, and each starts the other. So the waveform ends
//! without the CPU: words that are not rendered in time are zero, and zero is all outputs low. The shell decides what to
//! render, and when that is too late.
//!
//! `SysTick` supervises PIO and DMA in each block ([`follows`]): if they do not play what they must, it forces the pads low.
//!
//! Invariant: [`now`] is the tick on the pins, even while interrupts are delayed. An e-stop freezes it ([`freeze_low`]) until
//! the controller knows of the e-stop.

use crate::array::{self, LAYOUT};
use crate::board::{self, ARMED, ENABLED, OUTPUTS, TRIGGERED};
use crate::wake;
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::SeqCst};
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;
use embassy_rp::clocks::PllConfig;
use embassy_rp::pac;
use embassy_rp::pac::dma::vals::{DataSize, TreqSel};
use firmware_protocol::controller::{BLOCK, HORIZON, Run};
use firmware_protocol::tick::Tick;

/// The Pico's crystal.
pub(crate) const CRYSTAL_HZ: u32 = 12_000_000;
/// Makes the system clock from the crystal: a whole number of its cycles is a tick (`build.rs`).
pub(crate) const PLL: PllConfig = PllConfig {
    refdiv: 1,
    fbdiv: array::PLL_FEEDBACK,
    post_div1: array::PLL_POST1,
    post_div2: array::PLL_POST2,
};
const CYCLES_PER_TICK: u32 = array::CYCLES_PER_TICK;
const WORDS: usize = array::WORD_CYCLES.len();
const RING_TICKS: usize = HORIZON as usize;
/// The ring has 2 to the power of this many bytes.
const RING_BITS: u8 = 10;
const BLOCK_CYCLES: u32 = BLOCK * CYCLES_PER_TICK;
/// Ticks that the DMA is ahead of the pins: 8 words in the FIFO, one in the shift register and one in transfer.
pub(crate) const FETCHED: u64 = 3;
const FEED: usize = 0;
const CLEAR: usize = 1;
const CHAIN: [(usize, usize); 2] = [(FEED, CLEAR), (CLEAR, FEED)];
const BLOCK_WORDS: u32 = BLOCK * WORDS as u32;

const _: () = assert!(
    CRYSTAL_HZ as u64 * PLL.fbdiv as u64
        == LAYOUT.tick_hz() as u64 * CYCLES_PER_TICK as u64 * (PLL.post_div1 * PLL.post_div2) as u64
);
const _: () = {
    let [up, down, low, rest] = array::WORD_CYCLES;
    let (divider, tick) = (array::PIO_DIVIDER as u64, CYCLES_PER_TICK as u64);
    let down = (up + down) as u64;
    assert!((down + (low + rest) as u64) * divider == tick);
    assert!(up as u64 * divider * 1_000 == LAYOUT.id().duty_up as u64 * tick);
    assert!(down * divider * 1_000 == LAYOUT.id().duty_down as u64 * tick);
};
const _: () = assert!(RING_TICKS * WORDS * 4 == 1 << RING_BITS);
// `AHEAD_WORDS` and the times of interrupts were measured with so many cycles in a tick (`clock.rs`).
const _: () = assert!(CYCLES_PER_TICK >= 1_500);
const _: () = assert!(Tick::BOOT.0.is_multiple_of(BLOCK as u64));

/// The DMA reads it while the CPU writes. The address must be a multiple of the size.
#[repr(C, align(1024))]
struct Ring(UnsafeCell<[[u32; WORDS]; RING_TICKS]>);
// SAFETY: only `write` touches it, from one interrupt, and through volatile writes of single words.
unsafe impl Sync for Ring {}
static RING: Ring = Ring(UnsafeCell::new([[0; WORDS]; RING_TICKS]));
static ZERO: AtomicU32 = AtomicU32::new(0);

/// Number of blocks that have begun, low and high half. Only `SysTick` writes it. The bench reads it by this name and
/// compares it with the pins.
#[unsafe(no_mangle)]
static BLOCKS: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];
/// Whether all outputs are forced low.
static FORCED: AtomicBool = AtomicBool::new(false);
/// Whether PIO, DMA or their clock have failed. Stays until the chip restarts. The bench reads it by this name.
#[unsafe(no_mangle)]
static FAILED: AtomicBool = AtomicBool::new(false);
/// The blocks that had begun when the waveform was last seen to follow, low half.
static FOLLOWED: AtomicU32 = AtomicU32::new(0);
/// Whether the controller's clock is frozen at `FROZEN_AT`, until the controller knows of an e-stop.
static FROZEN: AtomicBool = AtomicBool::new(false);
static FROZEN_AT: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

/// Sets up and starts PIO, DMA and clock. The ring is empty, so all outputs are low.
pub(crate) fn start(syst: &mut SYST) {
    for (at, &cycles) in array::WORD_CYCLES.iter().enumerate() {
        // Takes a cycle and so many more.
        let code = OUT_PINS | u16::from(cycles - 1) << 8;
        pac::PIO0.instr_mem(at).write(|w| w.set_instr_mem(code));
        PROGRAM[at].store(code.into(), SeqCst);
    }
    let machine = pac::PIO0.sm(0);
    machine.clkdiv().write(|w| w.set_int(array::PIO_DIVIDER));
    machine.execctrl().write(|w| {
        w.set_wrap_bottom(0);
        w.set_wrap_top(WORDS as u8 - 1);
    });
    machine.shiftctrl().write(|w| {
        w.set_autopull(true);
        w.set_pull_thresh(0); // 32
        w.set_out_shiftdir(true);
        w.set_fjoin_tx(true);
    });
    for pin in OUTPUTS {
        // First low, then an output, then connected to the PIO.
        machine.pinctrl().write(|w| {
            w.set_set_base(pin);
            w.set_set_count(1);
        });
        machine.instr().write(|w| w.set_instr(0xe000)); // set pins, 0
        machine.instr().write(|w| w.set_instr(0xe081)); // set pindirs, 1
        pac::PADS_BANK0.gpio(pin.into()).modify(|w| w.set_od(false));
        pac::IO_BANK0.gpio(pin.into()).ctrl().write(|w| w.set_funcsel(PIO_FUNCTION));
    }
    // From GPIO 0 to the last output. Pins in between that are not outputs are not connected to the PIO.
    let last = OUTPUTS.into_iter().max().unwrap_or(0);
    machine.pinctrl().write(|w| w.set_out_count(last + 1));
    for (kept, setting) in SETTINGS.iter().zip(settings()) {
        kept.store(setting, SeqCst);
    }

    let ring = RING.0.get() as u32;
    let feed = pac::DMA.ch(FEED);
    feed.read_addr().write_value(ring);
    feed.write_addr().write_value(pac::PIO0.txf(0).as_ptr() as u32);
    let clear = pac::DMA.ch(CLEAR);
    clear.read_addr().write_value(ZERO.as_ptr() as u32);
    clear.write_addr().write_value(ring);
    for (channel, other) in CHAIN {
        pac::DMA.ch(channel).trans_count().write_value(BLOCK_WORDS);
        pac::DMA.ch(channel).al1_ctrl().write_value(control(channel, other));
    }
    // The CPU must not delay the waveform.
    pac::BUSCTRL.bus_priority().write(|w| {
        w.set_dma_r(true);
        w.set_dma_w(true);
    });
    pac::DMA.multi_chan_trigger().write(|w| w.0 = 1 << FEED);

    pac::PIO0.fdebug().write_value(pac::pio::regs::Fdebug(STALLED));
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(BLOCK_CYCLES - 1);
    syst.clear_current();
    syst.enable_interrupt();
    // The clock is some cycles ahead of the pins, so that no pin is high when a tick begins. Then forcing the pins low cuts
    // only pulses of the tick in which it is booked.
    cortex_m::interrupt::free(|_| {
        syst.enable_counter();
        pac::PIO0.ctrl().write(|w| {
            w.set_sm_enable(1);
            w.set_clkdiv_restart(1);
        });
    });
}

/// How a channel of the DMA is set up, which starts `other` when it has done a block.
#[inline(always)]
fn control(channel: usize, other: usize) -> u32 {
    let feeds = channel == FEED;
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
    ctrl.0
}

const PIO_FUNCTION: u8 = 6;
/// The PIO's instruction `out pins, 32`.
const OUT_PINS: u16 = 0x6000;

#[exception]
fn SysTick() {
    let low = BLOCKS[0].load(SeqCst).wrapping_add(1);
    BLOCKS[0].store(low, SeqCst);
    if low == 0 {
        BLOCKS[1].store(BLOCKS[1].load(SeqCst).wrapping_add(1), SeqCst);
    }
    if !FAILED.load(SeqCst) {
        if follows(low) {
            FOLLOWED.store(low, SeqCst);
        } else {
            FAILED.store(true, SeqCst);
            force_low();
        }
    }
    wake::shell();
}

/// Words by which the DMA is ahead of the block that begins when [`SysTick`] looks: 8 in the FIFO, one in the shift register,
/// one in transfer, and those of the ticks by which this interrupt may be delayed: less than 4 by that of USB, which may have to
/// look into a packet of each pipe, and 2 to spare. The ticks are of 1 500 cycles; longer ones are fewer.
const AHEAD_WORDS: core::ops::RangeInclusive<u32> = 6..=34;
/// State machine 0 has found its FIFO empty.
const STALLED: u32 = 1 << 24;

/// The program, and the settings of its state machine.
static PROGRAM: [AtomicU32; WORDS] = [const { AtomicU32::new(0) }; WORDS];
static SETTINGS: [AtomicU32; 4] = [const { AtomicU32::new(0) }; 4];
/// A state machine that never runs: it shows the program, whose memory cannot be read.
const READER: usize = 1;

/// The registers of the state machine that stay as they were set: divider, wrap, shifts, pins.
#[inline(always)]
fn settings() -> [u32; 4] {
    let machine = pac::PIO0.sm(0);
    [
        machine.clkdiv().read().0,
        machine.execctrl().read().0,
        machine.shiftctrl().read().0,
        machine.pinctrl().read().0,
    ]
}

/// Whether the program is as it was written. A state machine shows the instruction at its place, and a jump moves it.
#[inline(always)]
fn program_is_whole() -> bool {
    let shown = pac::PIO0.sm(READER).instr();
    PROGRAM.iter().enumerate().all(|(at, code)| {
        shown.write(|w| w.0 = at as u32); // jmp at
        shown.read().0 == code.load(SeqCst)
    })
}

/// A channel that is at work says so in its control register.
const BUSY: u32 = 1 << 24;

/// Whether the DMA plays the block that has just begun and clears the ones before: each register is as it was set up, or where it must be. How
/// far the one channel is follows from the words left, and the other has come to the block.
#[inline(always)]
fn dma_follows(blocks: u32) -> bool {
    let block = RING.0.get() as u32 + (blocks * BLOCK_WORDS) % (RING_TICKS * WORDS) as u32 * 4;
    let [feed, clear] = [FEED, CLEAR].map(|channel| pac::DMA.ch(channel));
    let feeds = || {
        let (at, left) = (feed.read_addr().read(), feed.trans_count().read());
        let ahead = BLOCK_WORDS.wrapping_sub(left);
        AHEAD_WORDS.contains(&ahead) && at == block + 4 * ahead
    };
    // A word may be fetched between the two readings.
    (feeds() || feeds())
        && feed.write_addr().read() == pac::PIO0.txf(0).as_ptr() as u32
        && clear.read_addr().read() == ZERO.as_ptr() as u32
        && clear.write_addr().read() == block
        && CHAIN.into_iter().all(|(channel, other)| {
            let (of, busy) = (pac::DMA.ch(channel), if channel == FEED { BUSY } else { 0 });
            of.al1_ctrl().read() == control(channel, other) | busy && of.dbg_tcr().read() == BLOCK_WORDS
        })
}

/// Whether PIO and DMA play the block that has just begun: the DMA is where it must be, and the PIO is on, never had to wait
/// for a word, and has its program and its settings, the clock divider among them.
fn follows(blocks: u32) -> bool {
    dma_follows(blocks)
        && pac::PIO0.fdebug().read().0 & STALLED == 0
        && settings().iter().zip(&SETTINGS).all(|(setting, kept)| *setting == kept.load(SeqCst))
        && program_is_whole()
        && pac::PIO0.ctrl().read().sm_enable() & 1 == 1
}

/// The word of the ring that the DMA fetches next.
#[inline(always)]
pub(crate) fn fetched() -> u32 {
    pac::DMA.ch(FEED).read_addr().read().wrapping_sub(RING.0.get() as u32) / 4
}

/// Words of the ring from one place to another, if they are fewer than the ring has.
#[inline(always)]
pub(crate) fn words_between(from: u32, to: u32) -> u32 {
    to.wrapping_sub(from) % (RING_TICKS * WORDS) as u32
}

/// If the waveform has failed: the first tick that may not have been on the pins.
pub(crate) fn failed() -> Option<Tick> {
    FAILED.load(SeqCst).then(|| {
        let (begun, followed) = (join(&BLOCKS), FOLLOWED.load(SeqCst));
        let since = (begun as u32).wrapping_sub(followed);
        Tick::BOOT + (begun - u64::from(since)) * u64::from(BLOCK)
    })
}

/// The tick on the pins, or the tick of an e-stop that the controller does not know of yet.
pub(crate) fn now() -> Tick {
    // The clock is read first: an e-stop may come meanwhile, and the clock is then later than the tick at which it froze.
    let running = running();
    if FROZEN.load(SeqCst) { Tick(join(&FROZEN_AT)) } else { running }
}

/// The tick on the pins, also while the controller's clock is frozen. From any context.
pub(crate) fn running() -> Tick {
    loop {
        let blocks = join(&BLOCKS);
        let pending = SCB::is_pendst_pending();
        let left = SYST::get_current();
        // Nothing changed in between: the three values belong together.
        if pending == SCB::is_pendst_pending() && blocks == join(&BLOCKS) {
            return tick(blocks + u64::from(pending), left);
        }
    }
}

/// The tick when `blocks` had begun and the counter showed `left`.
fn tick(blocks: u64, left: u32) -> Tick {
    // The exception comes when the counter reaches 0, one cycle before it is reloaded.
    let cycles = if left == 0 { 0 } else { BLOCK_CYCLES - left };
    Tick::BOOT + (blocks * u64::from(BLOCK) + u64::from((cycles * RECIPROCAL) >> SHIFT))
}

/// Divides the cycles of a block by those of a tick with a multiplication: the chip's core has no division.
const RECIPROCAL: u32 = (1_u32 << SHIFT).div_ceil(CYCLES_PER_TICK);
const SHIFT: u32 = 31 - BLOCK.ilog2();
const _: () = {
    // A quotient grows only at a multiple of the divisor, so it is exact if it is right there and just before.
    let mut ticks = 1;
    while ticks <= BLOCK {
        let begin = ticks * CYCLES_PER_TICK;
        assert!(begin.checked_mul(RECIPROCAL).is_some(), "the product has 32 bits");
        assert!((begin * RECIPROCAL) >> SHIFT == ticks && ((begin - 1) * RECIPROCAL) >> SHIFT == ticks - 1);
        ticks += 1;
    }
};

fn join([low, high]: &[AtomicU32; 2]) -> u64 {
    u64::from(high.load(SeqCst)) << 32 | u64::from(low.load(SeqCst))
}

/// Puts the run that begins at `tick` into the ring. Unless `armed`, the drivers are off.
pub(crate) fn write(tick: Tick, run: &Run, armed: bool) {
    let (up, down) = (board::gpios(run.lines.up.bits() as u32), board::gpios(run.lines.down.bits() as u32));
    let drivers = if run.drivers { ARMED | ENABLED } else { ARMED };
    let held = if armed { drivers } else { 0 } | if run.trigger { TRIGGERED } else { 0 };
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

/// The control registers of all outputs, worked out at compile time: an e-stop has no time for it.
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

/// Forces all outputs low and freezes the controller's clock until [`unfreeze`], at the tick that is on the pins. From the USB
/// interrupt, which `SysTick` does not preempt.
pub(crate) fn freeze_low() {
    // The word is read first: a tick may begin while the outputs are forced, one after the other.
    let word = word_on_pins();
    force_low();
    let now = running();
    // Pins and clock began some cycles after each other, and forcing took some: so the tick is this one or one of the last two.
    let since = ((now.0 - Tick::BOOT.0) as u32).wrapping_sub(word / WORDS as u32) % RING_TICKS as u32;
    // The place of a DMA that has failed means nothing; the supervision finds that failure.
    let at = if since <= MOST_SINCE { Tick(now.0 - u64::from(since)) } else { now };
    FROZEN_AT[0].store(at.0 as u32, SeqCst);
    FROZEN_AT[1].store((at.0 >> 32) as u32, SeqCst);
    FROZEN.store(true, SeqCst);
}

/// Most ticks by which the clock, read after the outputs were forced, is ahead of the pins.
const MOST_SINCE: u32 = 2;

/// The word of the ring that is on the pins, by what DMA and PIO have taken: it lies before the one in the shift register. The
/// shift register is filled again only at the PIO's next cycle. Until then a new word counts as not there: less than a fifth of a
/// pulse.
fn word_on_pins() -> u32 {
    let taken = || fetched().wrapping_sub(u32::from(pac::PIO0.flevel().read().tx0()));
    let mut words = taken();
    // For some cycles a word on its way from DMA to PIO counts in neither. Two equal readings show that there is none; four
    // readings do not all differ.
    for _ in 0..4 {
        let again = taken();
        if again == words {
            break;
        }
        words = again;
    }
    words.wrapping_sub(2) % (RING_TICKS * WORDS) as u32
}

/// Lets the controller's clock run again.
pub(crate) fn unfreeze() {
    FROZEN.store(false, SeqCst);
}

/// Lets the outputs follow the waveform again, unless an e-stop came meanwhile or the waveform has failed.
pub(crate) fn release() {
    // An e-stop's interrupt must not come in between: some pins would be released after it.
    critical_section::with(|_| {
        if FORCED.load(SeqCst) && !FROZEN.load(SeqCst) && !FAILED.load(SeqCst) {
            for control in &CONTROLS {
                // SAFETY: as in `force_low`.
                unsafe { (*control as *mut u32).write_volatile(PIO_FUNCTION.into()) };
            }
            FORCED.store(false, SeqCst);
        }
    });
}

/// The control register of an output's pad that follows the waveform.
pub(crate) const PAD: u32 = PIO_FUNCTION as u32;

/// Sets the control register of each output for the self-test, unless they are forced low. Returns whether it did.
pub(crate) fn override_pads(of: impl Fn(u8) -> u32) -> bool {
    // As in `release`: nothing may be undone that an e-stop has forced.
    critical_section::with(|_| {
        let free = !FORCED.load(SeqCst);
        if free {
            for (control, gpio) in CONTROLS.iter().zip(OUTPUTS) {
                // SAFETY: as in `force_low`.
                unsafe { (*control as *mut u32).write_volatile(of(gpio)) };
            }
        }
        free
    })
}
