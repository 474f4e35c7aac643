//! The self-test of the board: lines, waveform, memory and speed, while the drivers are off.
//!
//! The shell calls [`Run::step`] once a turn while the controller wants a test. A step takes some microseconds, and in between
//! everything else goes on. Only within a step of the lines do pads differ from the waveform.
//!
//! Invariant: the driver enable stays driven low. An e-stop that comes within a step forces all outputs low, and the step
//! changes nothing after it ([`wave::override_pads`]).

use crate::array::LAYOUT;
use crate::board::{self, DRIVEN, ENABLE};
use crate::wave;
use core::ptr;
use embassy_rp::pac;
use firmware_protocol::batch;
use firmware_protocol::board::{LineTest, RamTest, SelfTest, WaveTest};
use firmware_protocol::frame::{self, Decoder, MAX_FRAME};
use firmware_protocol::message::HostMessage;
use firmware_protocol::tick::Tick;

/// How long a pad may take to come to its level, cycles: 5 µs, which 10 kΩ and the capacitance of a cable need.
const SETTLE: u32 = 640;
/// How long the waveform is watched, µs.
const WATCH_US: u32 = 100_000;
/// Words of memory in a step.
const CHUNK: usize = 128;
/// Times that the longest frame is read.
const TRIES: u32 = 4;

/// Overrides of a pad that otherwise follows the waveform.
const UNDRIVEN: u32 = wave::PAD | 2 << 12;
const LOW: u32 = wave::PAD | 2 << 8;
const HIGH: u32 = wave::PAD | 3 << 8;

unsafe extern "C" {
    /// The end of what the linker has placed, from cortex-m-rt.
    static __sheap: u32;
}
/// The end of the memory that the linker may use (`memory.x`).
const RAM_END: usize = 0x2004_0000;

/// What is done next.
#[derive(Clone, Copy)]
enum Next {
    Line(usize),
    Watch { from_us: u32, from: Tick, at: u32, words: u32 },
    Ram { at: usize },
    Work { tries: u32 },
    Over,
}

/// What the outputs did, as words of GPIOs.
#[derive(Clone, Copy, Default)]
struct Lines {
    stuck_high: u32,
    stuck_low: u32,
    shorted: u32,
    pair: Option<(u8, u8)>,
}

impl Lines {
    fn named(&self) -> LineTest {
        LineTest {
            stuck_high: board::outputs(self.stuck_high),
            stuck_low: board::outputs(self.stuck_low),
            shorted: board::outputs(self.shorted),
            pair: self.pair.map(|(a, b)| (board::output(a), board::output(b))),
        }
    }
}

/// A test under way.
pub(crate) struct Run {
    next: Next,
    lines: Lines,
    result: SelfTest,
    frame: [u8; MAX_FRAME],
    len: usize,
}

impl Run {
    pub(crate) const fn new() -> Self {
        Self {
            next: Next::Line(0),
            lines: Lines { stuck_high: 0, stuck_low: 0, shorted: 0, pair: None },
            result: SelfTest { lines: None, wave: None, ram: None, work_us: None },
            frame: [0; MAX_FRAME],
            len: 0,
        }
    }

    /// Does the next step. Returns the result when all are done.
    #[inline(never)]
    pub(crate) fn step(&mut self) -> Option<SelfTest> {
        self.next = match self.next {
            Next::Line(at) if at < DRIVEN => Next::Line(at + usize::from(self.line(at))),
            Next::Line(_) => {
                self.result.lines = Some(self.lines.named());
                Next::Watch { from_us: now_us(), from: wave::now(), at: wave::fetched(), words: 0 }
            }
            Next::Watch { from_us, from, at, words } => self.watch(from_us, from, at, words),
            Next::Ram { at } => self.ram(at),
            Next::Work { tries } => self.work(tries),
            Next::Over => return Some(self.result),
        };
        None
    }

    /// Drives one output high and low, and reads all. First nothing drives them: what is high then is stuck. Returns whether
    /// nothing forced the outputs low meanwhile.
    fn line(&mut self, driven: usize) -> bool {
        let gpio = board::driven(driven);
        let one = 1 << gpio;
        let rest = |at: u8| if at == ENABLE { LOW } else { UNDRIVEN };
        let levels = |state: &dyn Fn(u8) -> u32| {
            let done = wave::override_pads(state);
            cortex_m::asm::delay(SETTLE);
            done.then(|| pac::SIO.gpio_in(0).read() & board::READ)
        };
        let undriven = levels(&rest);
        let high = levels(&|at| if at == gpio { HIGH } else { rest(at) });
        let low = levels(&|_| LOW);
        wave::override_pads(|_| wave::PAD);
        let (Some(undriven), Some(high), Some(low)) = (undriven, high, low) else { return false };
        self.lines.stuck_high |= undriven | low;
        let with = high & !one & !undriven;
        if high & one == 0 {
            self.lines.stuck_low |= one;
        }
        if with != 0 {
            self.lines.shorted |= with | one;
            let other = (0..DRIVEN).map(board::driven).find(|&at| with >> at & 1 == 1).unwrap_or(ENABLE);
            self.lines.pair.get_or_insert((gpio, other));
        }
        true
    }

    /// Counts ticks and the words that the DMA has fetched. The ring is longer than what passes between two turns.
    fn watch(&mut self, from_us: u32, from: Tick, at: u32, words: u32) -> Next {
        let (us, tick, now) = (now_us().wrapping_sub(from_us), wave::now(), wave::fetched());
        let words = words + wave::words_between(at, now);
        if us < WATCH_US {
            return Next::Watch { from_us, from, at: now, words };
        }
        self.result.wave = Some(WaveTest { timer_us: us, ticks: (tick - from) as u32, words });
        Next::Ram { at: ram_start() }
    }

    /// Writes two patterns to a piece of free memory and reads them back.
    fn ram(&mut self, at: usize) -> Next {
        let begin = ram_start();
        let end = (at + 4 * CHUNK).min(RAM_END);
        let mut bad = None;
        for pattern in [0xaaaa_5555_u32, 0x5555_aaaa] {
            for address in (at..end).step_by(4) {
                // SAFETY: the linker has placed nothing there, and the stack is below.
                unsafe {
                    ptr::with_exposed_provenance_mut::<u32>(address).write_volatile(pattern ^ address as u32);
                }
            }
            for address in (at..end).step_by(4) {
                // SAFETY: as above.
                let kept = unsafe { ptr::with_exposed_provenance::<u32>(address).read_volatile() };
                if kept != pattern ^ address as u32 {
                    bad = bad.or(Some(address as u32));
                }
            }
        }
        if end < RAM_END && bad.is_none() {
            return Next::Ram { at: end };
        }
        self.result.ram = Some(RamTest { bytes: (end - begin) as u32, bad });
        self.len = batch::longest_frame(&LAYOUT, &mut self.frame);
        Next::Work { tries: 0 }
    }

    /// Reads the longest frame, as the controller does.
    fn work(&mut self, tries: u32) -> Next {
        let begun = now_us();
        let mut decoder = Decoder::new();
        let mut pulses = 0_u32;
        if let Some(body) = decoder.next(&mut &self.frame[..self.len])
            && let Ok(HostMessage::Moves { base, batch, .. }) = frame::read(body)
            && let Ok(moves) = batch::moves(base.near(Tick(0)), batch)
        {
            pulses = moves.iter().map(|to| u32::from(to.of.level)).sum();
        }
        core::hint::black_box(pulses);
        let took = now_us().wrapping_sub(begun);
        self.result.work_us = Some(self.result.work_us.map_or(took, |longest| longest.max(took)));
        if tries + 1 < TRIES { Next::Work { tries: tries + 1 } } else { Next::Over }
    }
}

fn now_us() -> u32 {
    pac::TIMER.timerawl().read()
}

fn ram_start() -> usize {
    (&raw const __sheap) as usize
}
