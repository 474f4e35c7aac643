//! The mock in wall time: each run takes it up to now.
//!
//! It has no thread: its time passes only when its owner calls it with the host's instant. [`WallMock::like_a_board`] has no telemetry,
//! and a line between it and its owner that takes the time of USB.

use crate::device::error::DeviceError;
use crate::device::mock::{Mock, TruePositions};
use crate::faulty::{Direction, Liar, Line};
use crate::link::LineRate;
use crate::queues::{At, CommandError};
use crate::time::{HostInstant, random};
use firmware_protocol::controller::Run;
use firmware_protocol::message::Cause;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_array::units::TickRate;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A mock whose clock follows the host's.
#[derive(Debug)]
pub struct WallMock {
    /// Of its clock.
    rate: TickRate,
    mock: Mock,
    /// When its clock stood at [`Tick::BOOT`].
    started: HostInstant,
    /// The line to it and from it; `None`: bytes take no time.
    usb: Option<Usb>,
    /// What a bench does to it and its line.
    faults: Option<Arc<Mutex<Faults>>>,
}

/// What a bench does to a mock and its line, and sees of its pins.
#[derive(Debug, Default)]
pub struct Faults {
    /// The line towards the device.
    pub to_device: Direction,
    /// The line towards the host.
    pub to_host: Direction,
    /// Changes what the device says.
    pub liar: Option<Liar>,
    /// The device does nothing, and its lines are low.
    pub hangs: bool,
    /// The cable is out.
    pub is_unplugged: bool,
    /// The device finds a fault of its own.
    pub fault: Option<Cause>,
    /// The pulses that it has played since this was emptied.
    pub played: Vec<(Tick, Run)>,
    /// Where its pins come to rest, µm.
    pub heights_um: Vec<f64>,
    inbox: VecDeque<u8>,
    now: HostInstant,
    /// The device knows that its cable is out.
    is_out: bool,
}

/// Bytes that one way of the line holds: as a kernel does for a serial port.
const HELD: usize = 4096;

/// How far ahead an edge may be asked for.
const FARTHEST_EDGE: Duration = Duration::from_secs(3600);

/// A line of USB, both ways. It has its memory from the start.
#[derive(Debug)]
struct Usb {
    /// Until when bytes have been carried.
    carried: HostInstant,
    to_device: VecDeque<u8>,
    /// What the device has sent, of which the first `arrived` bytes are here.
    to_host: VecDeque<u8>,
    arrived: usize,
}

impl Usb {
    fn new(now: HostInstant) -> Self {
        let held = || VecDeque::with_capacity(HELD);
        Self { carried: now, to_device: held(), to_host: held(), arrived: 0 }
    }

    /// How many bytes either way carries up to now.
    fn carries(&mut self, now: HostInstant) -> usize {
        let per_s = u128::from(LineRate::USB_FULL_SPEED.0);
        let bytes = now.since(self.carried).as_nanos() * per_s / 1_000_000_000;
        // The rest of a byte counts the next time.
        self.carried = self.carried + Duration::from_nanos((bytes * 1_000_000_000).div_ceil(per_s) as u64);
        usize::try_from(bytes).unwrap_or(usize::MAX)
    }
}

impl WallMock {
    /// A mock of this array that boots at `now`.
    ///
    /// # Errors
    /// If the settings of the simulated motors are out of range.
    pub fn new(array: Array, motors: &SimulatedMotorsConfig, now: HostInstant) -> Result<Self, DeviceError> {
        let mut boot = [0; 4];
        // Without random numbers another boot may look the same.
        let _ = random(&mut boot);
        let mock = Mock::new(array, *motors, u32::from_le_bytes(boot))?;
        Ok(Self { rate: array.rate(), mock, started: now, usb: None, faults: None })
    }

    /// A mock as a board is: it has no telemetry, whatever the settings say, and its bytes take the time of full-speed USB.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn like_a_board(
        array: Array,
        motors: &SimulatedMotorsConfig,
        now: HostInstant,
    ) -> Result<Self, DeviceError> {
        let blind = SimulatedMotorsConfig { telemetry_hz: 0, ..*motors };
        Ok(Self { usb: Some(Usb::new(now)), ..Self::new(array, &blind, now)? })
    }

    /// The same mock behind a line that is good until its owner changes that.
    pub fn with_faults(mut self, seed: u64) -> (Self, Arc<Mutex<Faults>>) {
        self.mock.record();
        let line = |seed| Direction::new(Line::default(), seed);
        let faults = Faults { to_device: line(seed), to_host: line(!seed), ..Faults::default() };
        let faults = Arc::new(Mutex::new(faults));
        self.faults = Some(Arc::clone(&faults));
        (self, faults)
    }

    /// Whether a bench has pulled its cable.
    pub(super) fn is_unplugged(&self) -> bool {
        self.faults().is_some_and(|faults| faults.is_unplugged)
    }

    fn faults(&self) -> Option<MutexGuard<'_, Faults>> {
        Some(self.faults.as_ref()?.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Runs it up to `now`, as its faults let it.
    fn run_with(&mut self, faults: &mut Faults, now: HostInstant) {
        let until = Tick::BOOT + self.rate.duration_to_ticks(now.since(self.started));
        faults.now = now;
        let was_out = std::mem::replace(&mut faults.is_out, faults.is_unplugged);
        if faults.is_unplugged && !was_out {
            self.mock.unplug();
            faults.to_device.clear();
            faults.to_host.clear();
            faults.inbox.clear();
        }
        let bytes = faults.to_device.arrived(now);
        if faults.hangs {
            return;
        }
        self.mock.write(&bytes);
        if let Some(cause) = faults.fault.take() {
            self.mock.fault(cause);
        }
        self.mock.run(until);
        let mut bytes = [0; HELD];
        while let len @ 1.. = self.mock.read(&mut bytes) {
            match &mut faults.liar {
                Some(liar) => liar.change(&bytes[..len], |frame| faults.to_host.send(now, frame)),
                None => faults.to_host.send(now, &bytes[..len]),
            }
        }
        if faults.is_unplugged {
            faults.to_host.clear();
        }
        faults.inbox.extend(faults.to_host.arrived(now));
        let pulses = |(_, run): &(Tick, Run)| run.drivers && !run.lines.pulsing().is_empty();
        faults.played.extend(self.mock.take_trace().into_iter().filter(pulses));
        faults.heights_um = self.mock.positions_um();
    }

    /// Whether it is [`Self::like_a_board`].
    pub fn is_like_a_board(&self) -> bool {
        self.usb.is_some()
    }

    /// The mock itself.
    pub fn mock(&mut self) -> &mut Mock {
        &mut self.mock
    }

    /// Which simulated array it is: see [`SimulatedMotorsConfig::identity`].
    pub fn identity(&self) -> String {
        self.mock.identity()
    }

    /// Where its pins really are.
    pub fn true_positions(&self) -> Arc<TruePositions> {
        self.mock.true_positions()
    }

    /// An edge of its trigger input comes: now, at a tick, or after some time.
    pub(super) fn edge(&mut self, now: HostInstant, at: At, by: u64) -> Result<(), CommandError> {
        self.run(now);
        let present = self.mock.now();
        let tick = match at {
            At::Tick(tick) => tick,
            At::After(ns) => present + self.rate.duration_to_ticks(Duration::from_nanos(ns)),
            At::Next | At::Monotonic(_) | At::Edge(_) => Tick(present.0 - 1),
        };
        // An edge by a wrong tick may not keep its place for years.
        if tick > present + self.rate.duration_to_ticks(FARTHEST_EDGE) {
            return Err(CommandError::TooFar { most_min: (FARTHEST_EDGE.as_secs() / 60) as u32 });
        }
        self.mock.edge_at(tick, by).then_some(()).ok_or(CommandError::TooManyEdges)
    }

    /// Forgets the edges to come that this client has ordered.
    pub(super) fn withdraw_edges(&mut self, by: u64) {
        self.mock.withdraw_edges(by);
    }

    /// Takes in the bytes that were written, and runs up to `now`.
    pub(super) fn run(&mut self, now: HostInstant) {
        if let Some(faults) = self.faults.clone() {
            return self.run_with(&mut faults.lock().unwrap_or_else(PoisonError::into_inner), now);
        }
        let carries = self.usb.as_mut().map_or(0, |usb| usb.carries(now));
        if let Some(Usb { to_device, .. }) = &mut self.usb {
            let bytes = to_device.make_contiguous();
            let taken = self.mock.write(&bytes[..carries.min(bytes.len())]);
            to_device.drain(..taken);
        }
        self.mock.run(Tick::BOOT + self.rate.duration_to_ticks(now.since(self.started)));
        if let Some(Usb { to_host, arrived, .. }) = &mut self.usb {
            *arrived = (*arrived + carries).min(to_host.len());
            let mut bytes = [0; HELD];
            let room = HELD - to_host.len();
            let len = self.mock.read(&mut bytes[..room]);
            to_host.extend(&bytes[..len]);
        }
    }

    /// Writes bytes to it, and returns how many it has taken.
    pub(super) fn write(&mut self, bytes: &[u8]) -> usize {
        if let Some(mut faults) = self.faults() {
            let now = faults.now;
            faults.to_device.send(now, bytes);
            return bytes.len();
        }
        let Some(Usb { to_device, .. }) = &mut self.usb else { return self.mock.write(bytes) };
        let len = bytes.len().min(HELD - to_device.len());
        to_device.extend(&bytes[..len]);
        len
    }

    /// Reads the bytes that have come from it, and returns how many.
    pub(super) fn read(&mut self, bytes: &mut [u8]) -> usize {
        if let Some(mut faults) = self.faults() {
            let len = bytes.len().min(faults.inbox.len());
            bytes.iter_mut().zip(faults.inbox.drain(..len)).for_each(|(to, from)| *to = from);
            return len;
        }
        let Some(Usb { to_host, arrived, .. }) = &mut self.usb else { return self.mock.read(bytes) };
        let len = bytes.len().min(*arrived);
        for (to, from) in bytes.iter_mut().zip(to_host.drain(..len)) {
            *to = from;
        }
        *arrived -= len;
        len
    }
}
