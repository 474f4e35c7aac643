//! The library's mock as a board: two USB functions in front of one controller, a cable, a watchdog.
//!
//! It adds what the mock leaves to its owner: which USB function has the session, and that the watchdog resets a board whose
//! core fails, with a new boot id.

use crate::bench::device::{BenchError, Function, Heard};
use crate::log::Log;
use crate::time::{Grid, MS, TICK};
use firmware_protocol::frame::{self, Decoder};
use firmware_protocol::message::HostMessage;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::device::mock::Mock;

/// Time from a core's failure to the first tick of the next boot.
const WATCHDOG: u64 = 100 * MS;
/// Time from the plug, or the boot, to a configured device.
const ENUMERATION: u64 = 20 * MS;

/// The mock on a bench.
#[derive(Debug)]
pub struct MockBench {
    mock: Mock,
    seed: u64,
    cycle: u64,
    /// Cycle at which the present boot's clock began.
    origin: u64,
    resets: u64,
    plugged: bool,
    configured_from: u64,
    dtr: bool,
    /// The function that has the session: the last one with a valid `Hello`.
    function: Function,
    listeners: [Decoder; 2],
    heard: Heard,
    /// The lines since the last reset.
    pub log: Log,
}

fn mock(boot: u64) -> Result<Mock, BenchError> {
    let mut mock = Mock::new(Array::paper(), SimulatedMotorsConfig::default(), boot as u32)?;
    mock.record();
    Ok(mock)
}

impl MockBench {
    /// Powers it up.
    ///
    /// # Errors
    /// Never with the default motors.
    pub fn start(seed: u64) -> Result<Self, BenchError> {
        Ok(Self {
            mock: mock(seed)?,
            seed,
            cycle: 0,
            origin: 0,
            resets: 0,
            plugged: true,
            configured_from: ENUMERATION,
            dtr: false,
            function: Function::Cdc,
            listeners: Default::default(),
            heard: Heard::default(),
            log: Log::default(),
        })
    }

    /// Its clock.
    #[must_use]
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// Whether a host could talk to it.
    #[must_use]
    pub fn configured(&self) -> bool {
        self.plugged && self.cycle >= self.configured_from
    }

    /// Resets since power-up.
    #[must_use]
    pub fn resets(&self) -> u64 {
        self.resets
    }

    /// The grid of its ticks.
    #[must_use]
    pub fn grid(&self) -> Grid {
        Grid { origin: self.origin.cast_signed() }
    }

    /// The bytes it has sent since the last call.
    pub fn take_heard(&mut self) -> Heard {
        std::mem::take(&mut self.heard)
    }

    /// Sends bytes to one of its functions. A function without the session only looks for a `Hello`.
    pub fn write(&mut self, function: Function, mut bytes: &[u8]) {
        if !self.configured() || (function == Function::Cdc && !self.dtr) {
            return;
        }
        if function == self.function {
            self.mock.write(bytes);
            return;
        }
        let all = bytes;
        let decoder = &mut self.listeners[function as usize];
        while let Some(body) = decoder.next(&mut bytes) {
            if matches!(frame::read(body), Ok(HostMessage::Hello { .. })) {
                self.function = function;
                // Ends a frame that the previous host may have begun.
                self.mock.write(&[0]);
                self.mock.write(all);
                return;
            }
        }
    }

    /// Runs up to a cycle.
    pub fn run(&mut self, to: u64) {
        self.cycle = self.cycle.max(to);
        if self.cycle < self.origin {
            return;
        }
        self.mock.run(Tick::BOOT + (self.cycle - self.origin) / TICK);
        self.log.extend(&self.mock.take_trace());
        let mut bytes = [0; 4096];
        loop {
            let len = self.mock.read(&mut bytes);
            if len == 0 {
                break;
            }
            if self.configured() && (self.function == Function::Bulk || self.dtr) {
                let to =
                    if self.function == Function::Cdc { &mut self.heard.cdc } else { &mut self.heard.bulk };
                to.extend(&bytes[..len]);
            }
        }
    }

    /// Opens or closes the tty. A closed tty is a lost link.
    pub fn dtr(&mut self, open: bool) {
        if self.dtr && !open && self.function == Function::Cdc {
            self.mock.unplug();
        }
        self.dtr = open;
    }

    /// Plugs the cable in or out.
    pub fn usb(&mut self, plugged: bool) {
        if self.plugged && !plugged {
            self.mock.unplug();
            (self.dtr, self.function) = (false, Function::Cdc);
        }
        if plugged && !self.plugged {
            self.configured_from = self.cycle + ENUMERATION;
        }
        self.plugged = plugged;
    }

    /// Makes the core fail: lines low, and the watchdog restarts it.
    ///
    /// # Errors
    /// Never with the default motors.
    pub fn fail(&mut self) -> Result<(), BenchError> {
        self.resets += 1;
        self.mock = mock(self.seed.wrapping_add(self.resets << 16))?;
        self.origin = self.cycle + WATCHDOG;
        self.configured_from = self.origin + ENUMERATION;
        (self.dtr, self.function) = (false, Function::Cdc);
        Ok(())
    }
}
