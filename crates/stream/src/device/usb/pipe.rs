//! Bulk transfers as a pipe of bytes: a thread that reads, a thread that writes, a ring each, and one bell.
//!
//! The transfers themselves (and what libusb allocates for them) happen on the two threads. The streamer's side takes
//! from one ring and puts into the other, without waiting. A reader transfer is many packets long: one packet each would
//! let what the board says queue up behind the time that a transfer takes to be asked for. It ends with a short or an
//! empty packet, which the board sends when it has nothing more to say, so no frame lies there until more comes.
//!
//! Bounds: [`UNSENT`] bytes towards the board, transfer under way included, so an e-stop waits for no more;
//! [`UNREAD`] from it: a full ring makes the reader wait, and the board with it.
//! Invariant: when the board is gone, the next read or write says so by an error.

use super::Interface;
use crate::device::priority;
use rtrb::{Consumer, Producer, RingBuffer};
use rusb::{Context, DeviceHandle};
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{Builder, JoinHandle, sleep};
use std::time::Duration;

/// Bytes that may wait to be sent: 2 ms of full-speed bulk, what the link may have on its way.
const UNSENT: usize = 1600;
/// Bytes that may wait to be read: several hundred statuses.
const UNREAD: usize = 1 << 16;
/// Bytes of a reading transfer: whole packets, or the board could send more than there is room for.
const READ: usize = 1024;
const _: () = assert!(READ.is_multiple_of(MAX_PACKET) && READ <= UNREAD);
/// The longest packet of a bulk endpoint (high speed); the others (64 bytes at full speed) are parts of it.
const MAX_PACKET: usize = 512;
/// How often a thread that waits for the board looks whether it shall end.
const LOOK: Duration = Duration::from_millis(100);
/// A board that takes nothing for so long is gone.
const STUCK: Duration = Duration::from_millis(500);
/// How long the reader waits for room in its ring.
const NO_ROOM: Duration = Duration::from_millis(1);

/// What both sides see.
#[derive(Debug)]
struct Shared {
    /// Bytes taken by `write` and not sent.
    unsent: AtomicUsize,
    /// The streamer was refused bytes and wants to hear of room.
    wants_room: AtomicBool,
    gone: AtomicBool,
    end: AtomicBool,
    /// Rung for the streamer, and for the writer.
    bell: OwnedFd,
    writers_bell: OwnedFd,
}

fn ring(bell: &OwnedFd) {
    // It can only be full after 2^64 rings.
    let _ = rustix::io::write(bell, &1u64.to_ne_bytes());
}

fn silence(bell: &OwnedFd) {
    let _ = rustix::io::read(bell, &mut [0; 8]);
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
    pub(super) fn spawn(handle: DeviceHandle<Context>, interface: Interface) -> io::Result<Self> {
        let handle = Arc::new(handle);
        let flags = EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK;
        let shared = Arc::new(Shared {
            unsent: AtomicUsize::new(0),
            wants_room: AtomicBool::new(false),
            gone: AtomicBool::new(false),
            end: AtomicBool::new(false),
            bell: eventfd(0, flags)?,
            writers_bell: eventfd(0, flags)?,
        });
        let (filled, incoming) = RingBuffer::new(UNREAD);
        let (outgoing, emptied) = RingBuffer::new(UNSENT);
        let reader = {
            let (handle, shared) = (Arc::clone(&handle), Arc::clone(&shared));
            let run = move || {
                let _ = priority::fifo();
                fill(&handle, interface, &shared, filled);
            };
            Builder::new().name("usb-in".into()).spawn(run)?
        };
        let mut pipe = Self { shared, incoming, outgoing, threads: [Some(reader), None] };
        let shared = Arc::clone(&pipe.shared);
        let run = move || {
            let _ = priority::fifo();
            empty(&handle, interface, &shared, emptied);
        };
        pipe.threads[1] = Some(Builder::new().name("usb-out".into()).spawn(run)?);
        Ok(pipe)
    }

    pub(super) fn wake(&self) -> BorrowedFd<'_> {
        self.shared.bell.as_fd()
    }

    /// What the board has sent is read to the end before it is said that it is gone.
    pub(super) fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if self.incoming.is_empty() {
            let gone = self.shared.gone.load(Ordering::Acquire);
            // Silenced before it is looked at again: what comes in between rings again.
            silence(&self.shared.bell);
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
        // Asked for before the room is looked at: room that is made in between is told.
        self.shared.wants_room.store(true, Ordering::SeqCst);
        let room = UNSENT.saturating_sub(self.shared.unsent.load(Ordering::SeqCst));
        let taken = bytes.len().min(room);
        if taken == bytes.len() {
            self.shared.wants_room.store(false, Ordering::SeqCst);
        }
        if taken > 0 {
            // Counted before the writer can have sent it. The ring has a place for every byte that is counted.
            self.shared.unsent.fetch_add(taken, Ordering::SeqCst);
            let _ = self.outgoing.push_entire_slice(&bytes[..taken]);
            ring(&self.shared.writers_bell);
        }
        Ok(taken)
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        self.shared.end.store(true, Ordering::Release);
        ring(&self.shared.writers_bell);
        for thread in self.threads.iter_mut().filter_map(Option::take) {
            // The reader ends within `LOOK`, the writer within `STUCK`; the interface is released with the last handle.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lose(&self) {
        self.gone.store(true, Ordering::Release);
        ring(&self.bell);
    }

    fn goes_on(&self) -> bool {
        !self.end.load(Ordering::Acquire) && !self.gone.load(Ordering::Acquire)
    }
}

fn fill(handle: &DeviceHandle<Context>, interface: Interface, shared: &Shared, mut ring_in: Producer<u8>) {
    let mut bytes = [0; READ];
    while shared.goes_on() {
        if ring_in.slots() < READ {
            sleep(NO_ROOM);
            continue;
        }
        // What came before the time was up is given back like a transfer that was ended.
        match handle.read_bulk(interface.input, &mut bytes, LOOK) {
            // An empty packet behind a full one.
            Ok(0) => {}
            Ok(len) => {
                let _ = ring_in.push_entire_slice(&bytes[..len]);
                ring(&shared.bell);
            }
            Err(rusb::Error::Timeout | rusb::Error::Interrupted) => {}
            // Pulled out in mid-transfer it is a generic error, else `NoDevice`.
            Err(_) => shared.lose(),
        }
    }
}

fn empty(handle: &DeviceHandle<Context>, interface: Interface, shared: &Shared, mut ring_out: Consumer<u8>) {
    let mut bytes = [0; UNSENT];
    while shared.goes_on() {
        silence(&shared.writers_bell);
        let (taken, _) = ring_out.pop_partial_slice(&mut bytes);
        if taken.is_empty() {
            let timeout = Timespec { tv_sec: 1, tv_nsec: 0 };
            let _ = poll(&mut [PollFd::new(&shared.writers_bell, PollFlags::IN)], Some(&timeout));
            continue;
        }
        let taken = taken.len();
        match handle.write_bulk(interface.output, &bytes[..taken], STUCK) {
            // Cut short by a signal or by time, the rest would be half a frame: the link sends it again.
            Ok(_) | Err(rusb::Error::Interrupted) => {}
            Err(_) => shared.lose(),
        }
        shared.unsent.fetch_sub(taken, Ordering::SeqCst);
        if shared.wants_room.swap(false, Ordering::SeqCst) {
            ring(&shared.bell);
        }
    }
}
