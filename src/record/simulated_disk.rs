//! The disk of a bench and of tests: it is full, fails, or stops for ever, when they say so of their
//! thread. What it takes is on the real disk.

use std::cell::Cell;
use std::io;

thread_local! {
    /// The free bytes of this thread's disk.
    pub(crate) static ROOM: Cell<usize> = const { Cell::new(usize::MAX) };
    /// Whether it fails to write and to sync.
    pub(crate) static FAILS: Cell<bool> = const { Cell::new(false) };
    /// After how many writes the machine dies, in the middle of one: then nothing reaches the disk.
    pub(crate) static DIES_AFTER: Cell<u32> = const { Cell::new(u32::MAX) };
}

/// How many of these bytes the disk takes at once; 0 for an operation that writes none. It gets full in
/// the middle of a line.
pub(super) fn takes(bytes: usize) -> io::Result<usize> {
    if FAILS.get() || DIES_AFTER.get() == 0 {
        return Err(io::Error::from_raw_os_error(5));
    }
    if bytes == 0 {
        return Ok(0);
    }
    if DIES_AFTER.get() < u32::MAX {
        DIES_AFTER.set(DIES_AFTER.get() - 1);
        if DIES_AFTER.get() == 0 {
            return Ok(bytes / 2);
        }
    }
    let takes = bytes.min(ROOM.get());
    ROOM.set(ROOM.get() - takes);
    if takes == 0 { Err(io::Error::from_raw_os_error(28)) } else { Ok(takes) }
}
