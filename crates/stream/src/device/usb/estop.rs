//! E-stops past the pipe: a thread sends the board a control request, which does not wait for the bytes before it.
//!
//! The request needs no interface, so a board on a serial port takes it as well. A board that does not know it refuses it, and one that
//! does not answer costs the thread [`ANSWER`]: the frame in the pipe stands in for both.
//!
//! Bound: one request waits at most; a newer one replaces it. Invariant: [`EStopLine::request`] never blocks.

use crate::device::find::BoardQuery;
use crate::device::priority;
use firmware_protocol::urgent::e_stop_request;
use rusb::{Context, DeviceHandle};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::{Builder, JoinHandle, park};
use std::time::Duration;

/// Time for the board's answer.
const ANSWER: Duration = Duration::from_millis(100);
/// A request waits; its epoch is in the low half.
const WAITS: u32 = 1 << 16;

#[derive(Debug, Default)]
struct Shared {
    /// [`WAITS`] and the epoch, or 0.
    request: AtomicU32,
    end: AtomicBool,
}

/// See the module.
#[derive(Debug)]
pub(in crate::device) struct EStopLine {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl EStopLine {
    /// A line to an open board.
    pub(super) fn spawn(handle: Arc<DeviceHandle<Context>>) -> io::Result<Self> {
        let shared = Arc::<Shared>::default();
        let of_thread = Arc::clone(&shared);
        let run = move || {
            let _ = priority::fifo(priority::FIFO_PRIORITY);
            while !of_thread.end.load(Ordering::Acquire) {
                match of_thread.request.swap(0, Ordering::AcqRel) {
                    0 => park(),
                    request => send(&handle, request as u16),
                }
            }
        };
        let thread = Builder::new().name("usb-estop".into()).spawn(run)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// A line to the board with this serial number, beside the driver that holds its serial port. `None` if this user may not
    /// open the USB device.
    pub(in crate::device) fn beside(serial: &str) -> Option<Self> {
        let (handle, ..) = super::find(&BoardQuery::serial(serial)).ok()?;
        Self::spawn(Arc::new(handle)).ok()
    }

    /// Sends the e-stop that begins this epoch.
    pub(in crate::device) fn request(&self, epoch: u16) {
        self.shared.request.store(WAITS | u32::from(epoch), Ordering::Release);
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }
}

fn send(handle: &DeviceHandle<Context>, epoch: u16) {
    let [kind, request, ..] = e_stop_request(epoch);
    // Its frame follows in any case.
    let _ = handle.write_control(kind, request, epoch, 0, &[], ANSWER);
}

impl Drop for EStopLine {
    fn drop(&mut self) {
        self.shared.end.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // It ends within [`ANSWER`].
            let _ = thread.join();
        }
    }
}
