//! The bytes between the streamer and the threads that run the transfers: a ring buffer each way, and doorbells.
//!
//! [`Near`] is the streamer's side and never waits. [`Incoming`] and [`Outgoing`] are the sides of the reading and the writing thread;
//! the transfer itself is a closure. `verify/races` explores the interleavings of the three.
//!
//! Bounds: [`UNSENT`] bytes towards the board, the transfer under way included; [`UNREAD`] bytes from it.
//! Invariants: when the board is gone, the next read or write returns an error, after all bytes that came before. Bytes that wait, and
//! room that the streamer waits for, ring its doorbell.

use crate::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use crate::sync::ring::{Consumer, Producer, RingBuffer};
use crate::sync::{Doorbell, sleep};
use std::io;
use std::sync::Arc;
use std::time::Duration;

/// Bytes that may wait to be sent: 2 ms of full-speed bulk, as many as the link leaves unacknowledged.
const UNSENT: usize = if cfg!(loom) { 2 } else { 1600 };
/// Bytes that may wait to be read: several hundred statuses.
const UNREAD: usize = if cfg!(loom) { 4 } else { 1 << 16 };
/// Bytes of a reading transfer. Whole packets: else the board could send more than the transfer has room for.
const READ: usize = if cfg!(loom) { 2 } else { 1024 };
const _: () = assert!(cfg!(loom) || READ.is_multiple_of(MAX_PACKET) && READ <= UNREAD);
/// The longest packet of a bulk endpoint (high speed). 64 bytes, that of full speed, divides it.
const MAX_PACKET: usize = 512;
/// How often the reader checks a full ring for room.
const ROOM_CHECK: Duration = Duration::from_millis(1);
/// How often the writer looks whether to end, should nobody ring.
const IDLE_CHECK: Duration = Duration::from_secs(1);

/// What the streamer's side and the threads share.
#[derive(Debug)]
struct Shared {
    /// Bytes that `write` took and the writer has not sent.
    unsent: AtomicUsize,
    /// The streamer found no room, and waits for it.
    wants_room: AtomicBool,
    gone: AtomicBool,
    end: AtomicBool,
    streamer_bell: Doorbell,
    writer_bell: Doorbell,
}

/// The streamer's side.
#[derive(Debug)]
pub(super) struct Near {
    shared: Arc<Shared>,
    incoming: Consumer<u8>,
    outgoing: Producer<u8>,
}

/// The reading thread's side.
#[derive(Debug)]
pub(super) struct Incoming {
    shared: Arc<Shared>,
    ring: Producer<u8>,
}

/// The writing thread's side.
#[derive(Debug)]
pub(super) struct Outgoing {
    shared: Arc<Shared>,
    ring: Consumer<u8>,
}

/// Makes the three sides.
pub(super) fn hand_over() -> io::Result<(Near, Incoming, Outgoing)> {
    let shared = Arc::new(Shared {
        unsent: AtomicUsize::new(0),
        wants_room: AtomicBool::new(false),
        gone: AtomicBool::new(false),
        end: AtomicBool::new(false),
        streamer_bell: Doorbell::new()?,
        writer_bell: Doorbell::new()?,
    });
    let (filled, incoming) = RingBuffer::new(UNREAD);
    let (outgoing, emptied) = RingBuffer::new(UNSENT);
    let near = Near { shared: Arc::clone(&shared), incoming, outgoing };
    let from = Incoming { shared: Arc::clone(&shared), ring: filled };
    Ok((near, from, Outgoing { shared, ring: emptied }))
}

impl Near {
    /// Rung when bytes wait, when the board is gone, and when there is room again after a short write.
    pub(super) fn bell(&self) -> &Doorbell {
        &self.shared.streamer_bell
    }

    /// Returns all bytes that the board has sent before it reports that the board is gone.
    pub(super) fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if self.incoming.is_empty() {
            // Clear the bell before checking again: what comes in between rings it again.
            self.shared.streamer_bell.clear();
            // Before the last look at the ring: a board that is gone has pushed all its bytes.
            let gone = self.shared.gone.load(Ordering::Acquire);
            if self.incoming.is_empty() {
                return if gone { Err(io::ErrorKind::BrokenPipe.into()) } else { Ok(0) };
            }
            // These bytes rang before the clear, and the caller may leave some of them for its next round.
            self.shared.streamer_bell.ring();
        }
        let (read, _) = self.incoming.pop_partial_slice(bytes);
        Ok(read.len())
    }

    /// Takes as many bytes as there is room for.
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
            self.shared.writer_bell.ring();
        }
        Ok(taken)
    }

    /// Ends both threads, each after its transfer.
    pub(super) fn end(&self) {
        self.shared.end.store(true, Ordering::Release);
        self.shared.writer_bell.ring();
    }
}

impl Shared {
    fn lose(&self) {
        self.gone.store(true, Ordering::Release);
        self.streamer_bell.ring();
    }

    fn goes_on(&self) -> bool {
        !self.end.load(Ordering::Acquire) && !self.gone.load(Ordering::Acquire)
    }
}

impl Incoming {
    /// Runs transfers until the end. `receive` fills the buffer and returns how many bytes came, none if it waited in vain; an error
    /// means that the board is gone.
    pub(super) fn run(mut self, mut receive: impl FnMut(&mut [u8]) -> Result<usize, rusb::Error>) {
        let mut bytes = [0; READ];
        while self.shared.goes_on() {
            if self.ring.slots() < READ {
                sleep(ROOM_CHECK);
                continue;
            }
            match receive(&mut bytes) {
                // Also the empty packet after a full one.
                Ok(0) | Err(rusb::Error::Timeout | rusb::Error::Interrupted) => {}
                Ok(len) => {
                    let _ = self.ring.push_entire_slice(&bytes[..len]);
                    self.shared.streamer_bell.ring();
                }
                // A board pulled out in mid-transfer gives a generic error, else `NoDevice`.
                Err(_) => self.shared.lose(),
            }
        }
    }
}

impl Outgoing {
    /// Runs transfers until the end. An error of `send` means that the board is gone.
    pub(super) fn run(mut self, mut send: impl FnMut(&[u8]) -> Result<usize, rusb::Error>) {
        let mut bytes = [0; UNSENT];
        loop {
            // Clear the bell before looking for the end and for bytes: what comes in between rings it again.
            self.shared.writer_bell.clear();
            if !self.shared.goes_on() {
                return;
            }
            let (taken, _) = self.ring.pop_partial_slice(&mut bytes);
            if taken.is_empty() {
                self.shared.writer_bell.wait(IDLE_CHECK);
                continue;
            }
            let taken = taken.len();
            match send(&bytes[..taken]) {
                // A transfer that a signal or the timeout cut short leaves half a frame: the link retransmits it.
                Ok(_) | Err(rusb::Error::Interrupted) => {}
                Err(_) => self.shared.lose(),
            }
            self.shared.unsent.fetch_sub(taken, Ordering::SeqCst);
            if self.shared.wants_room.swap(false, Ordering::SeqCst) {
                self.shared.streamer_bell.ring();
            }
        }
    }
}
