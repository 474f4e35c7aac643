//! Bulk transfers as a pipe of bytes: a reading and a writing thread, a ring buffer each, and events to wake the other side.
//!
//! The two threads run the transfers (for which libusb allocates). The streamer's side takes bytes from one ring and puts
//! bytes into the other, without waiting. A reading transfer is many packets long: with one packet each, the board's bytes
//! would queue up while the next transfer is being requested. The board ends a transfer with a short or an empty packet
//! when it has nothing more to send, so no frame waits there for later bytes.
//!
//! Bounds: [`UNSENT`] bytes towards the board, the transfer under way included, so an e-stop waits for no more;
//! [`UNREAD`] bytes from it: a full ring makes the reader wait, and the board with it.
//! Invariant: when the board is gone, the next read or write returns an error.

use crate::device::priority;
use crate::device::usb::interface::Interface;
use rtrb::{Consumer, Producer, RingBuffer};
use rusb::{Context, DeviceHandle};
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{Builder, JoinHandle, sleep};
use std::time::Duration;

/// Bytes that may wait to be sent: 2 ms of full-speed bulk, as many as the link leaves unacknowledged.
const UNSENT: usize = 1600;
/// Bytes that may wait to be read: several hundred statuses.
const UNREAD: usize = 1 << 16;
/// Bytes of a reading transfer. Whole packets: else the board could send more than the transfer has room for.
const READ: usize = 1024;
const _: () = assert!(READ.is_multiple_of(MAX_PACKET) && READ <= UNREAD);
/// The longest packet of a bulk endpoint (high speed). 64 bytes, that of full speed, divides it.
const MAX_PACKET: usize = 512;
/// How often a thread that waits for the board checks whether to end.
const END_CHECK: Duration = Duration::from_millis(100);
/// A board that takes no bytes for so long is gone.
const STUCK: Duration = Duration::from_millis(500);
/// How often the reader checks a full ring for room.
const ROOM_CHECK: Duration = Duration::from_millis(1);

/// What the streamer's side and the threads share.
#[derive(Debug)]
struct Shared {
    /// Bytes that `write` took and the writer has not sent.
    unsent: AtomicUsize,
    /// The streamer found no room, and waits for it.
    wants_room: AtomicBool,
    gone: AtomicBool,
    end: AtomicBool,
    /// Wakes the streamer.
    streamer_event: OwnedFd,
    /// Wakes the writer.
    writer_event: OwnedFd,
}

fn set(event: &OwnedFd) {
    // Its counter overflows only after 2^64 sets.
    let _ = rustix::io::write(event, &1u64.to_ne_bytes());
}

fn clear(event: &OwnedFd) {
    let _ = rustix::io::read(event, &mut [0; 8]);
}

/// The streamer's side.
#[derive(Debug)]
pub(super) struct Pipe {
    shared: Arc<Shared>,
    incoming: Consumer<u8>,
    outgoing: Producer<u8>,
    threads: [Option<JoinHandle<()>>; 2],
}

impl Pipe {
    pub(super) fn spawn(handle: Arc<DeviceHandle<Context>>, interface: Interface) -> io::Result<Self> {
        let flags = EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK;
        let shared = Arc::new(Shared {
            unsent: AtomicUsize::new(0),
            wants_room: AtomicBool::new(false),
            gone: AtomicBool::new(false),
            end: AtomicBool::new(false),
            streamer_event: eventfd(0, flags)?,
            writer_event: eventfd(0, flags)?,
        });
        let (filled, incoming) = RingBuffer::new(UNREAD);
        let (outgoing, emptied) = RingBuffer::new(UNSENT);
        let reader = {
            let (handle, shared) = (Arc::clone(&handle), Arc::clone(&shared));
            let run = move || {
                let _ = priority::fifo(priority::FIFO_PRIORITY);
                fill(&handle, interface, &shared, filled);
            };
            Builder::new().name("usb-in".into()).spawn(run)?
        };
        let mut pipe = Self { shared, incoming, outgoing, threads: [Some(reader), None] };
        let shared = Arc::clone(&pipe.shared);
        let run = move || {
            let _ = priority::fifo(priority::FIFO_PRIORITY);
            empty(&handle, interface, &shared, emptied);
        };
        pipe.threads[1] = Some(Builder::new().name("usb-out".into()).spawn(run)?);
        Ok(pipe)
    }

    pub(super) fn wake(&self) -> BorrowedFd<'_> {
        self.shared.streamer_event.as_fd()
    }

    /// Returns all bytes that the board has sent before it reports that the board is gone.
    pub(super) fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if self.incoming.is_empty() {
            let gone = self.shared.gone.load(Ordering::Acquire);
            // Clear the event before checking again: bytes that come in between set it again.
            clear(&self.shared.streamer_event);
            if self.incoming.is_empty() {
                return if gone { Err(io::ErrorKind::BrokenPipe.into()) } else { Ok(0) };
            }
        }
        let (read, _) = self.incoming.pop_partial_slice(bytes);
        Ok(read.len())
    }

    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.shared.gone.load(Ordering::Acquire) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        // Ask for room before checking for it: the writer then reports room that it makes in between.
        self.shared.wants_room.store(true, Ordering::SeqCst);
        let room = UNSENT.saturating_sub(self.shared.unsent.load(Ordering::SeqCst));
        let taken = bytes.len().min(room);
        if taken == bytes.len() {
            self.shared.wants_room.store(false, Ordering::SeqCst);
        }
        if taken > 0 {
            // Count before the writer can send. The ring has a place for every counted byte.
            self.shared.unsent.fetch_add(taken, Ordering::SeqCst);
            let _ = self.outgoing.push_entire_slice(&bytes[..taken]);
            set(&self.shared.writer_event);
        }
        Ok(taken)
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        self.shared.end.store(true, Ordering::Release);
        set(&self.shared.writer_event);
        for thread in self.threads.iter_mut().filter_map(Option::take) {
            // The reader ends within `END_CHECK`, the writer within `STUCK`. The last handle releases the interface.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lose(&self) {
        self.gone.store(true, Ordering::Release);
        set(&self.streamer_event);
    }

    fn goes_on(&self) -> bool {
        !self.end.load(Ordering::Acquire) && !self.gone.load(Ordering::Acquire)
    }
}

fn fill(handle: &DeviceHandle<Context>, interface: Interface, shared: &Shared, mut ring_in: Producer<u8>) {
    let mut bytes = [0; READ];
    while shared.goes_on() {
        if ring_in.slots() < READ {
            sleep(ROOM_CHECK);
            continue;
        }
        // Bytes that came before a timeout are returned like those of a finished transfer.
        match handle.read_bulk(interface.input, &mut bytes, END_CHECK) {
            // The empty packet after a full one.
            Ok(0) => {}
            Ok(len) => {
                let _ = ring_in.push_entire_slice(&bytes[..len]);
                set(&shared.streamer_event);
            }
            Err(rusb::Error::Timeout | rusb::Error::Interrupted) => {}
            // A board pulled out in mid-transfer gives a generic error, else `NoDevice`.
            Err(_) => shared.lose(),
        }
    }
}

fn empty(handle: &DeviceHandle<Context>, interface: Interface, shared: &Shared, mut ring_out: Consumer<u8>) {
    let mut bytes = [0; UNSENT];
    while shared.goes_on() {
        clear(&shared.writer_event);
        let (taken, _) = ring_out.pop_partial_slice(&mut bytes);
        if taken.is_empty() {
            let timeout = Timespec { tv_sec: 1, tv_nsec: 0 };
            let _ = poll(&mut [PollFd::new(&shared.writer_event, PollFlags::IN)], Some(&timeout));
            continue;
        }
        let taken = taken.len();
        match handle.write_bulk(interface.output, &bytes[..taken], STUCK) {
            // A transfer that a signal or the timeout cut short leaves half a frame: the link retransmits it.
            Ok(_) | Err(rusb::Error::Interrupted) => {}
            Err(_) => shared.lose(),
        }
        shared.unsent.fetch_sub(taken, Ordering::SeqCst);
        if shared.wants_room.swap(false, Ordering::SeqCst) {
            set(&shared.streamer_event);
        }
    }
}
