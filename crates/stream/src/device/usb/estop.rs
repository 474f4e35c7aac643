//! E-stops past the pipe: a thread sends the board a control request, which does not wait for the bytes before it.
//!
//! The request needs no interface, so a board on a serial port takes it as well. A board that does not know it refuses it, and one that
//! does not answer costs the thread [`ANSWER`]: the frame in the pipe stands in for both.
//!
//! Bound: one request waits at most; a newer one replaces it. Invariant: [`EStopLine::request`] never blocks.

use crate::device::find::BoardQuery;
use crate::device::priority;
use crate::device::usb::newest::Newest;
use crate::sync::{Builder, JoinHandle};
use firmware_protocol::urgent::e_stop_request;
use rusb::{Context, DeviceHandle};
use std::io;
use std::sync::Arc;
use std::time::Duration;

/// Time for the board's answer.
const ANSWER: Duration = Duration::from_millis(100);

/// See the module.
#[derive(Debug)]
pub(in crate::device) struct EStopLine {
    newest: Arc<Newest>,
    thread: Option<JoinHandle<()>>,
}

impl EStopLine {
    /// A line to an open board.
    pub(super) fn spawn(handle: Arc<DeviceHandle<Context>>) -> io::Result<Self> {
        let newest = Arc::<Newest>::default();
        let of_thread = Arc::clone(&newest);
        let run = move || {
            let _ = priority::fifo(priority::FIFO_PRIORITY);
            of_thread.serve(|epoch| send(&handle, epoch));
        };
        let thread = Builder::new().name("usb-estop".into()).spawn(run)?;
        Ok(Self { newest, thread: Some(thread) })
    }

    /// A line to the board with this serial number, beside the driver that holds its serial port. `None` if this user may not
    /// open the USB device.
    pub(in crate::device) fn beside(serial: &str) -> Option<Self> {
        let (handle, ..) = super::find(&BoardQuery::serial(serial)).ok()?;
        Self::spawn(Arc::new(handle)).ok()
    }

    /// Sends the e-stop that begins this epoch.
    pub(in crate::device) fn request(&self, epoch: u16) {
        if let Some(thread) = &self.thread {
            self.newest.set(epoch, thread.thread());
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
        if let Some(thread) = self.thread.take() {
            self.newest.end(thread.thread());
            // It ends within [`ANSWER`].
            let _ = thread.join();
        }
    }
}
