//! A board's own USB interface: found, opened and claimed by `rusb`, then read and written by threads of its own.
//!
//! Opening blocks and is done here; what the streamer calls ([`UsbPort::read`], [`UsbPort::write`]) only moves bytes
//! in and out of rings (`pipe`) and never blocks or allocates. The interface is vendor-specific, so that no driver of
//! the kernel holds it, and is claimed for this process alone.

mod pipe;
mod watch;

use crate::device::DeviceError;
use crate::device::find::BoardQuery;
use crate::link::LineRate;
use pipe::Pipe;
use rusb::{Context, DeviceHandle, Direction, TransferType, UsbContext};
use rustix::fd::BorrowedFd;
use std::io;
pub use watch::watch;

/// What a full-speed device takes in bulk transfers.
pub(super) const FULL_SPEED: LineRate = LineRate(800_000);
/// The interface's class.
const VENDOR_SPECIFIC: u8 = 0xff;

/// The interface's number and its bulk endpoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Interface {
    number: u8,
    input: u8,
    output: u8,
}

/// An open board.
#[derive(Debug)]
pub struct UsbPort {
    pipe: Pipe,
    serial: String,
}

impl UsbPort {
    /// Opens the first board that is wanted, for this process alone.
    ///
    /// # Errors
    /// If there is none, it is not ours, or in use.
    pub fn open(wanted: &BoardQuery) -> Result<Self, DeviceError> {
        let none = || DeviceError::NoUsb(wanted.to_string());
        // A system without USB has no boards either.
        let devices = Context::new().and_then(|context| context.devices()).map_err(|_| none())?;
        let mut denied = None;
        for device in devices.iter() {
            let Ok(descriptor) = device.device_descriptor() else { continue };
            let ids = (descriptor.vendor_id(), descriptor.product_id());
            if ids != wanted.ids {
                continue;
            }
            let place = format!("{:03}/{:03}", device.bus_number(), device.address());
            let handle = match device.open() {
                Ok(handle) => handle,
                // It may be another's: only if none is found it matters.
                Err(rusb::Error::Access) => {
                    denied = Some(DeviceError::UsbDenied(place));
                    continue;
                }
                Err(_) => continue,
            };
            let product = handle.read_product_string_ascii(&descriptor).ok();
            let serial = handle.read_serial_number_string_ascii(&descriptor).ok();
            if wanted.matches(ids, product.as_deref(), serial.as_deref()) {
                return Self::claim(handle, place, serial.unwrap_or_default());
            }
        }
        Err(denied.unwrap_or_else(none))
    }

    fn claim(handle: DeviceHandle<Context>, place: String, serial: String) -> Result<Self, DeviceError> {
        let failed = |error| match error {
            rusb::Error::Busy => DeviceError::UsbInUse(place.clone()),
            rusb::Error::Access => DeviceError::UsbDenied(place.clone()),
            other => DeviceError::Usb(place.clone(), other),
        };
        let interface = interface(&handle).map_err(failed)?;
        let interface = interface.ok_or_else(|| DeviceError::UsbInterface(place.clone()))?;
        handle.claim_interface(interface.number).map_err(failed)?;
        let pipe = Pipe::spawn(handle, interface).map_err(|error| DeviceError::UsbThreads(place, error))?;
        Ok(Self { pipe, serial })
    }

    /// Its serial number; empty if it has none.
    #[must_use]
    pub fn serial(&self) -> &str {
        &self.serial
    }

    pub(super) fn rate(&self) -> LineRate {
        FULL_SPEED
    }

    /// Readable when there are bytes, when the board is gone, and when there is room again after a short write.
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

/// The first vendor-specific interface with a bulk endpoint each way.
fn interface(handle: &DeviceHandle<Context>) -> Result<Option<Interface>, rusb::Error> {
    let config = handle.device().active_config_descriptor()?;
    for setting in config.interfaces().flat_map(|interface| interface.descriptors()) {
        if setting.class_code() != VENDOR_SPECIFIC || setting.setting_number() != 0 {
            continue;
        }
        let bulk = |direction| {
            let mut all = setting.endpoint_descriptors();
            all.find(|end| end.transfer_type() == TransferType::Bulk && end.direction() == direction)
        };
        if let (Some(input), Some(output)) = (bulk(Direction::In), bulk(Direction::Out)) {
            return Ok(Some(Interface {
                number: setting.interface_number(),
                input: input.address(),
                output: output.address(),
            }));
        }
    }
    Ok(None)
}
