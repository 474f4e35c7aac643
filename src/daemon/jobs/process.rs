//! The process of a rendering or a preview: its job is written to it, and its reports are read.
//!
//! Invariant: when a [`RenderProcess`] is dropped, its process is killed and waited for. Until then no other process can get its
//! id.

use crate::render_process::{Job, MAX_LINE, Report};
use rustix::process::Pid;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command};

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct RenderProcess {
    child: Child,
    /// Closing it ends the process.
    stdin: Option<ChildStdin>,
    reports: Option<BufReader<ChildStdout>>,
}

impl RenderProcess {
    /// Starts it.
    pub(in crate::daemon) fn start(mut command: Command) -> io::Result<Self> {
        let mut child = command.spawn()?;
        let (stdin, reports) = (child.stdin.take(), child.stdout.take().map(BufReader::new));
        Ok(Self { child, stdin, reports })
    }

    pub(in crate::daemon) fn pid(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    /// Sends it its job. If the process has already ended, there will be no report.
    pub(in crate::daemon) fn give(&mut self, job: &Job) {
        let line = serde_json::to_vec(job).unwrap_or_default();
        if let Some(stdin) = &mut self.stdin {
            let _ = stdin.write_all(&[&line[..], b"\n"].concat());
        }
    }

    /// Waits for its next report; none if it has ended.
    pub(in crate::daemon) fn report(&mut self) -> Option<Report> {
        let mut line = Vec::new();
        // A read error counts as an end without a report.
        let _ = self.reports.as_mut()?.take(MAX_LINE).read_until(b'\n', &mut line);
        serde_json::from_slice(&line).ok()
    }
}

impl Drop for RenderProcess {
    fn drop(&mut self) {
        // Its work is no longer needed. An error means that it has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
