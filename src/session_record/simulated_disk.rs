//! The disk of a bench and of tests: it is full, or fails, when they say so. What it takes is on the real disk, without syncing.

use super::writer::Disk;
use std::cell::Cell;
use std::fs::{self, File};
use std::io::{self, Write};

thread_local! {
    /// The free bytes of this thread's disk.
    pub(crate) static ROOM: Cell<usize> = const { Cell::new(usize::MAX) };
    /// Whether it fails to write and to sync.
    pub(crate) static FAILS: Cell<bool> = const { Cell::new(false) };
}

/// The disk gets full in the middle of a line.
fn room(bytes: usize) -> io::Result<usize> {
    let takes = bytes.min(ROOM.get());
    match (FAILS.get(), takes) {
        (true, _) => Err(io::Error::from_raw_os_error(5)),
        (false, 0) => Err(io::Error::from_raw_os_error(28)),
        (false, takes) => {
            ROOM.set(ROOM.get() - takes);
            Ok(takes)
        }
    }
}

fn append(file: &mut File, bytes: &[u8]) -> io::Result<usize> {
    file.write(&bytes[..room(bytes.len())?])
}

pub(super) const SIMULATED: Disk = Disk {
    append,
    sync: |_| if FAILS.get() { Err(io::Error::from_raw_os_error(5)) } else { Ok(()) },
    replace: |_, path, bytes| {
        let next = path.with_extension("new");
        fs::write(&next, &bytes[..room(bytes.len())?])?;
        if ROOM.get() == 0 {
            return Err(io::Error::from_raw_os_error(28));
        }
        fs::rename(next, path)
    },
};
