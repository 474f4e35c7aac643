//! The firmware in the emulated RP2040: a child process, in lock-step over its standard input and output.
//!
//! This module passes on and records. The process ends with the bench.

use crate::bench::answer::{Answer, AnswerError, hex};
use crate::bench::{BenchError, CpuEvent, Function, Heard};
use crate::pins::Pins;
use firmware_protocol::urgent::{Urgent, Watch};
use std::collections::VecDeque;
use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// How to run the chip.
#[derive(Clone, Debug)]
pub struct ChipOptions {
    /// The firmware's ELF file.
    pub elf: PathBuf,
    /// Seed of the emulated ring oscillator, from which boot ids come.
    pub seed: u64,
    /// Factor by which the core is slower than the real one.
    pub slow: f64,
    /// Further options of the emulator.
    pub more: Vec<String>,
}

impl ChipOptions {
    /// The firmware that `MEISSNER_FIRMWARE_ELF` names, or the one built beside this crate.
    pub fn new(seed: u64) -> Self {
        let built = "../../firmware/target/thumbv6m-none-eabi/release/meissner-firmware";
        Self { elf: from_env("MEISSNER_FIRMWARE_ELF", built), seed, slow: 1.0, more: Vec::new() }
    }
}

/// A path from the environment, or one relative to this crate.
fn from_env(name: &str, default: &str) -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join(default);
    std::env::var_os(name).map_or_else(beside, PathBuf::from)
}

/// The chip.
#[derive(Debug)]
pub struct ChipBench {
    process: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    last: Answer,
    heard: Heard,
    /// The pins since the last reset.
    pub pins: Pins,
    /// Bytes written and taken so far.
    written: u64,
    taken: u64,
    /// Finds e-stops in the bytes written.
    watch: Watch,
    /// Positions, in the bytes written, of the ends of e-stops that the chip has not taken.
    e_stops: VecDeque<u64>,
    /// Cycles at which the chip took the packets in which e-stops end.
    pub e_stopped: Vec<u64>,
    /// Cycles at which the chip took SETUP packets of [`Self::control`].
    pub requested: Vec<u64>,
    /// What came of the transfers of [`Self::transfer`]: the bytes from the chip, or `None` if it refused.
    pub transfers: Vec<Option<Vec<u8>>>,
}

impl ChipBench {
    /// Powers the chip up.
    ///
    /// # Errors
    /// If something is missing, with one line that says what to build.
    pub fn start(options: &ChipOptions) -> Result<Self, BenchError> {
        let emulator = from_env("MEISSNER_EMULATOR", "../emulator/bench.mjs");
        if !options.elf.is_file() {
            return Err(BenchError::NoFirmware(options.elf.clone()));
        }
        let modules = emulator.parent().map(|folder| folder.join("node_modules"));
        if !emulator.is_file() || !modules.is_some_and(|modules| modules.is_dir()) {
            return Err(BenchError::NoEmulator(emulator));
        }
        let mut command = Command::new("node");
        command.arg(&emulator).arg(&options.elf);
        command.args(["--seed", &options.seed.to_string(), "--slow", &options.slow.to_string()]);
        command.args(&options.more);
        let pipes = command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = pipes.spawn().map_err(BenchError::NoNode)?;
        let (Some(to), Some(from)) = (process.stdin.take(), process.stdout.take()) else {
            return Err(BenchError::NoNode(std::io::ErrorKind::BrokenPipe.into()));
        };
        let (last, heard, pins) = (Answer::default(), Heard::default(), Pins::default());
        let from = BufReader::with_capacity(1 << 16, from);
        Ok(Self {
            process,
            to,
            from,
            last,
            heard,
            pins,
            written: 0,
            taken: 0,
            watch: Watch::new(),
            e_stops: VecDeque::new(),
            e_stopped: Vec::new(),
            requested: Vec::new(),
            transfers: Vec::new(),
        })
    }

    /// The emulator's clock.
    pub fn cycle(&self) -> u64 {
        self.last.cycle
    }

    /// Whether it has been enumerated since its last reset or plug.
    pub fn configured(&self) -> bool {
        self.last.configured
    }

    /// Resets since power-up.
    pub fn resets(&self) -> u64 {
        self.last.resets
    }

    /// The cycles since power-up in which the core did not sleep.
    pub fn busy_cycles(&self) -> u64 {
        self.last.cycle - self.last.asleep
    }

    /// The bytes it has sent since the last call.
    pub fn take_heard(&mut self) -> Heard {
        std::mem::take(&mut self.heard)
    }

    /// Sends bytes to one of its USB functions.
    ///
    /// # Errors
    /// If the emulator is gone or refuses.
    pub fn write(&mut self, function: Function, bytes: &[u8]) -> Result<(), BenchError> {
        if bytes.is_empty() {
            return Ok(());
        }
        for byte in bytes {
            self.written += 1;
            if let Some(Urgent::EStop(_)) = self.watch.look(&[*byte]) {
                self.e_stops.push_back(self.written);
            }
        }
        let name = function.name();
        self.ask(&serde_json::json!({ name: hex(bytes) }))
    }

    /// Runs up to a cycle; an instruction may end a few cycles after it.
    ///
    /// # Errors
    /// If the emulator is gone or refuses.
    pub fn run(&mut self, to: u64) -> Result<(), BenchError> {
        let cycles = to.saturating_sub(self.last.cycle);
        if cycles == 0 { Ok(()) } else { self.ask(&serde_json::json!({ "run": cycles, "until": null })) }
    }

    /// Sends a control request without data, besides what waits in the pipes.
    ///
    /// # Errors
    /// If the emulator is gone or refuses.
    pub fn control(&mut self, setup: [u8; 8]) -> Result<(), BenchError> {
        self.ask(&serde_json::json!({ "control": hex(&setup) }))
    }

    /// Begins a control transfer, with the data that go to the chip, if any.
    ///
    /// # Errors
    /// If the emulator is gone or refuses, or the chip is not configured.
    pub fn transfer(&mut self, setup: [u8; 8], data: &[u8]) -> Result<(), BenchError> {
        let data = if data.is_empty() { serde_json::Value::Null } else { hex(data).into() };
        self.ask(&serde_json::json!({ "transfer": hex(&setup), "data": data }))
    }

    /// Runs to where the next transaction of a control transfer begins or ends, for so many cycles at most.
    ///
    /// # Errors
    /// If the emulator is gone or refuses.
    pub fn run_to_control(&mut self, cycles: u64) -> Result<(), BenchError> {
        self.ask(&serde_json::json!({ "run": cycles, "until": "control" }))
    }

    /// Opens or closes the tty.
    ///
    /// # Errors
    /// If the emulator is gone or refuses.
    pub fn dtr(&mut self, open: bool) -> Result<(), BenchError> {
        self.ask(&serde_json::json!({ "dtr": open }))
    }

    /// Plugs the cable in or out.
    ///
    /// # Errors
    /// If the emulator is gone or refuses.
    pub fn usb(&mut self, plugged: bool) -> Result<(), BenchError> {
        self.bus(if plugged { "plug" } else { "unplug" })
    }

    /// Does something else to the bus, by the emulator's name for it: `reset`, `abandon`, `suspend`, `resume`, `hang`.
    ///
    /// # Errors
    /// If the emulator is gone or refuses.
    pub fn bus(&mut self, event: &str) -> Result<(), BenchError> {
        self.ask(&serde_json::json!({ "usb": event }))
    }

    /// Makes the core fail.
    ///
    /// # Errors
    /// If the emulator is gone or refuses.
    pub fn cpu(&mut self, event: CpuEvent) -> Result<(), BenchError> {
        self.ask(&serde_json::json!({ "cpu": event }))
    }

    /// A little-endian number of up to eight bytes at a symbol of the firmware.
    ///
    /// # Errors
    /// If the emulator is gone or knows no such symbol.
    pub fn read(&mut self, symbol: &str, bytes: usize) -> Result<u64, BenchError> {
        self.ask(&serde_json::json!({ "read": symbol, "bytes": bytes }))?;
        Ok(self.last.memory.iter().take(8).rev().fold(0, |sum, &byte| sum << 8 | u64::from(byte)))
    }

    /// So many bytes from a symbol of the firmware on.
    ///
    /// # Errors
    /// If the emulator is gone or knows no such symbol.
    pub fn memory(&mut self, symbol: &str, bytes: usize) -> Result<Vec<u8>, BenchError> {
        self.ask(&serde_json::json!({ "read": symbol, "bytes": bytes }))?;
        Ok(std::mem::take(&mut self.last.memory))
    }

    /// Writes the firmware's memory at a symbol.
    ///
    /// # Errors
    /// If the emulator is gone or knows no such symbol.
    pub fn poke(&mut self, symbol: &str, bytes: &[u8]) -> Result<(), BenchError> {
        self.ask(&serde_json::json!({ "poke": symbol, "hex": hex(bytes) }))
    }

    /// Writes a peripheral's register, as a core gone astray would.
    ///
    /// # Errors
    /// If the emulator is gone or has nothing at this address.
    pub fn register(&mut self, address: u32, to: u32) -> Result<(), BenchError> {
        self.ask(&serde_json::json!({ "register": address, "to": to }))
    }

    /// Plants faults of the wiring, by GPIO: pads held high or low, and connected pairs.
    ///
    /// # Errors
    /// If the emulator is gone.
    pub fn wiring(&mut self, high: u32, low: u32, shorts: &[[u8; 2]]) -> Result<(), BenchError> {
        self.ask(&serde_json::json!({ "wiring": { "high": high, "low": low, "shorts": shorts } }))
    }

    fn ask(&mut self, request: &serde_json::Value) -> Result<(), BenchError> {
        writeln!(self.to, "{request}").and_then(|()| self.to.flush()).map_err(AnswerError::from)?;
        let mut answer = Answer::read(&mut self.from)?;
        for (cycle, levels) in answer.levels.drain(..) {
            self.pins.change(cycle, levels);
        }
        for (pipe, cycle, bytes) in answer.packets.drain(..) {
            if pipe == "control" {
                self.requested.push(cycle);
                continue;
            }
            self.taken += bytes;
            while self.e_stops.front().is_some_and(|&end| end <= self.taken) {
                self.e_stops.pop_front();
                self.e_stopped.push(cycle);
            }
        }
        self.transfers.append(&mut answer.transfers);
        self.heard.cdc.append(&mut answer.cdc);
        self.heard.bulk.append(&mut answer.bulk);
        self.last = answer;
        Ok(())
    }
}

impl Drop for ChipBench {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
