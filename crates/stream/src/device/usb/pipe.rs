//! Bulk transfers as a pipe of bytes: a reading and a writing thread, each with a side of the [`hand_over`].
//!
//! The two threads run the transfers (for which libusb allocates). The streamer's side takes bytes from one ring and puts
//! bytes into the other, without waiting. A reading transfer is many packets long: with one packet each, the board's bytes
//! would queue up while the next transfer is being requested. The board ends a transfer with a short or an empty packet
//! when it has nothing more to send, so no frame waits there for later bytes.
//!
//! Bounds: those of the hand-over, so an e-stop waits for no more bytes; a full ring makes the reader wait, and the board with it.
//! Invariant: when the board is gone, the next read or write returns an error.

use crate::device::priority;
use crate::device::usb::hand_over::{Near, hand_over};
use crate::device::usb::interface::Interface;
use rusb::{Context, DeviceHandle};
use rustix::fd::{AsFd, BorrowedFd};
use std::io;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

/// How often a thread that waits for the board checks whether to end.
const END_CHECK: Duration = Duration::from_millis(100);
/// A board that takes no bytes for so long is gone.
const STUCK: Duration = Duration::from_millis(500);

/// The streamer's side, and the threads.
#[derive(Debug)]
pub(super) struct Pipe {
    near: Near,
    threads: [Option<JoinHandle<()>>; 2],
}

impl Pipe {
    pub(super) fn spawn(handle: Arc<DeviceHandle<Context>>, interface: Interface) -> io::Result<Self> {
        let (near, incoming, outgoing) = hand_over()?;
        let reader = {
            let handle = Arc::clone(&handle);
            let run = move || {
                let _ = priority::fifo(priority::FIFO_PRIORITY);
                // Bytes that came before a timeout are returned like those of a finished transfer.
                incoming.run(|bytes| handle.read_bulk(interface.input, bytes, END_CHECK));
            };
            Builder::new().name("usb-in".into()).spawn(run)?
        };
        let mut pipe = Self { near, threads: [Some(reader), None] };
        let run = move || {
            let _ = priority::fifo(priority::FIFO_PRIORITY);
            outgoing.run(|bytes| handle.write_bulk(interface.output, bytes, STUCK));
        };
        pipe.threads[1] = Some(Builder::new().name("usb-out".into()).spawn(run)?);
        Ok(pipe)
    }

    pub(super) fn wake(&self) -> BorrowedFd<'_> {
        self.near.bell().as_fd()
    }

    pub(super) fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.near.read(bytes)
    }

    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.near.write(bytes)
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        self.near.end();
        for thread in self.threads.iter_mut().filter_map(Option::take) {
            // The reader ends within `END_CHECK`, the writer within `STUCK`. The last handle releases the interface.
            let _ = thread.join();
        }
    }
}
