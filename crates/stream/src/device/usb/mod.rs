//! A board's own USB interface: `rusb` finds, opens and claims it; threads of its own read and write it.
//!
//! [`UsbPort::open`] blocks. The streamer calls [`UsbPort::read`] and [`UsbPort::write`], which only move bytes in and out
//! of ring buffers (`pipe`, `hand_over`) and never block or allocate. The interface is vendor-specific, so no kernel driver holds it,
//! and it is claimed for this process alone. `watch` reports boards that are plugged in.

mod estop;
mod hand_over;
mod interface;
mod newest;
mod pipe;
mod watch;

use crate::device::error::DeviceError;
use crate::device::find::BoardQuery;
use crate::link::LineRate;
pub(super) use estop::EStopLine;
use interface::Interface;
use meissner_input::message::escape;
use pipe::Pipe;
use rusb::{Context, DeviceHandle, UsbContext};
use rustix::fd::BorrowedFd;
use std::io;
use std::sync::Arc;
pub use watch::watch;

/// An open board.
#[derive(Debug)]
pub struct UsbPort {
    pipe: Pipe,
    e_stop: EStopLine,
    serial: String,
}

impl UsbPort {
    /// Opens the first matching board, for this process alone.
    ///
    /// # Errors
    /// If no board matches, or the board is closed to this user or in use.
    pub fn open(query: &BoardQuery) -> Result<Self, DeviceError> {
        let (handle, place, serial) = find(query)?;
        Self::claim(handle, place, escape(&serial))
    }

    fn claim(handle: DeviceHandle<Context>, place: String, serial: String) -> Result<Self, DeviceError> {
        let failed = |error| match error {
            rusb::Error::Busy => DeviceError::UsbInUse(place.clone()),
            rusb::Error::Access => DeviceError::UsbDenied(place.clone()),
            other => DeviceError::Usb(place.clone(), other),
        };
        let interface = Interface::of(&handle).map_err(failed)?;
        let interface = interface.ok_or_else(|| DeviceError::UsbInterface(place.clone()))?;
        handle.claim_interface(interface.number).map_err(failed)?;
        let handle = Arc::new(handle);
        let failed = |error| DeviceError::UsbThreads(place.clone(), error);
        let e_stop = EStopLine::spawn(Arc::clone(&handle)).map_err(failed)?;
        let pipe = Pipe::spawn(handle, interface).map_err(failed)?;
        Ok(Self { pipe, e_stop, serial })
    }

    pub(super) fn e_stop(&self, epoch: u16) {
        self.e_stop.request(epoch);
    }

    /// Its serial number; empty if it has none.
    pub fn serial(&self) -> &str {
        &self.serial
    }

    pub(super) fn rate(&self) -> LineRate {
        LineRate::USB_FULL_SPEED
    }

    /// Readable when bytes wait, when the board is gone, and when there is room again after a short write.
    pub(super) fn wake(&self) -> BorrowedFd<'_> {
        self.pipe.wake()
    }

    pub(super) fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.pipe.read(bytes)
    }

    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.pipe.write(bytes)
    }
}

/// Opens the first matching board, with its place on the bus and its serial number. It claims nothing.
fn find(query: &BoardQuery) -> Result<(DeviceHandle<Context>, String, String), DeviceError> {
    let none = || DeviceError::NoUsb(query.to_string());
    // A system without USB has no boards.
    let devices = Context::new().and_then(|context| context.devices()).map_err(|_| none())?;
    let mut denied = None;
    for device in devices.iter() {
        let Ok(descriptor) = device.device_descriptor() else { continue };
        let ids = (descriptor.vendor_id(), descriptor.product_id());
        if ids != query.ids {
            continue;
        }
        let place = format!("{:03}/{:03}", device.bus_number(), device.address());
        let handle = match device.open() {
            Ok(handle) => handle,
            // It may be another device with the same ids: report it only if no board is found.
            Err(rusb::Error::Access) => {
                denied = Some(DeviceError::UsbDenied(place));
                continue;
            }
            Err(_) => continue,
        };
        let product = handle.read_product_string_ascii(&descriptor).ok();
        let serial = handle.read_serial_number_string_ascii(&descriptor).ok();
        if query.matches(ids, product.as_deref(), serial.as_deref()) {
            return Ok((handle, place, serial.unwrap_or_default()));
        }
    }
    Err(denied.unwrap_or_else(none))
}
