//! Finds the rows of a sweep in the files of its runs.
//!
//! Invariant: each cell has at most one place, in the first file that has its row.

use crate::directory::{Directory, SweepError, failed, open};
use crate::run_file::{self, Line, RunFile};
use std::fs::File;

/// The place of a line: the number of its file, its first byte, and the number of bytes; 0 bytes: there is no line.
#[derive(Clone, Copy, Debug, Default)]
struct At {
    file: u32,
    bytes: u32,
    at: u64,
}

/// The rows of all runs.
#[derive(Debug)]
pub(crate) struct Index {
    pub(crate) files: Vec<RunFile>,
    cells: Vec<At>,
    done: u64,
    failed: u64,
    /// Cells by the file that computed them, and the last failure there.
    pub(crate) by_file: Vec<(u64, Option<String>)>,
}

impl Index {
    /// Reads all files of runs.
    pub(crate) fn read(directory: &Directory, cells: u64) -> Result<Self, SweepError> {
        let mut all = Self {
            files: Vec::new(),
            cells: vec![At::default(); cells as usize],
            done: 0,
            failed: 0,
            by_file: Vec::new(),
        };
        for path in directory.run_files()? {
            let file = all.files.len() as u32;
            let (places, done, failed) = (&mut all.cells, &mut all.done, &mut all.failed);
            let mut own = (0, None);
            let found = run_file::read(directory, &path, |found| {
                own.0 += 1;
                if let Some(error) = found.error {
                    own.1 = Some(format!("cell {}: {error}", found.cell));
                }
                if let Some(place) = places.get_mut(found.cell as usize).filter(|place| place.bytes == 0) {
                    *place = At { file, bytes: found.bytes, at: found.at };
                    *done += 1;
                    *failed += u64::from(found.error.is_some());
                }
            })?;
            all.files.push(found);
            all.by_file.push(own);
        }
        Ok(all)
    }

    /// How many cells have a line.
    pub(crate) const fn done(&self) -> u64 {
        self.done
    }

    /// How many of them failed.
    pub(crate) const fn failed(&self) -> u64 {
        self.failed
    }

    /// Lines that could not be read.
    pub(crate) fn damaged(&self) -> u64 {
        self.files.iter().map(|file| file.damaged).sum()
    }

    pub(crate) const fn reader(&self) -> Reader<'_> {
        Reader { index: self, open: Vec::new() }
    }
}

/// Reads lines by cell. It keeps at most [`MOST_OPEN`] files open, fewer than a process may have by default.
#[derive(Debug)]
pub(crate) struct Reader<'a> {
    index: &'a Index,
    /// The files read last, the newest at the end.
    open: Vec<(u32, File)>,
}

/// The most files that are open at once.
const MOST_OPEN: usize = 500;

impl Reader<'_> {
    /// The line of a cell, if there is one.
    pub(crate) fn line(&mut self, cell: u64) -> Result<Option<Line>, SweepError> {
        let Some(&At { file, bytes, at }) =
            self.index.cells.get(cell as usize).filter(|place| place.bytes > 0)
        else {
            return Ok(None);
        };
        let path = &self.index.files[file as usize].path;
        let open = match self.open.iter().position(|(number, _)| *number == file) {
            Some(open) => open,
            None => {
                if self.open.len() == MOST_OPEN {
                    self.open.remove(0);
                }
                self.open.push((file, open(path).map_err(failed(path, "read"))?));
                self.open.len() - 1
            }
        };
        run_file::line(&mut self.open[open].1, path, at, bytes).map(Some)
    }
}
