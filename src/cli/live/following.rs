//! The loop of a live play: reads its source and the daemon's answers, and sends messages when they are due.
//!
//! One thread waits for the source, answers and signals at once. Each turn of the loop reads at most one piece of the source, so
//! none of the three blocks the others.
//!
//! Invariant: a message is sent only in a turn that could read the source.

use super::device::Input;
use super::lines::Lines;
use super::pace::Pace;
use super::signals::Signals;
use crate::cli::progress::Updates;
use anyhow::{Result, anyhow, bail};
use meissner_api::{Code, EndCause, LiveAnswer, LiveApplied, LiveMessage, LivePose};
use meissner_array::units::TickRate;
use meissner_client::{ClientError, LivePlay};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::{Duration, Instant};

/// How long to wait for the end of a play after the request to end it.
const END: Duration = Duration::from_secs(5);

/// Where messages come from.
#[derive(Debug)]
pub(super) enum Source {
    Lines(Lines),
    Input(Box<Input>),
}

/// How a play ended.
#[derive(Debug)]
pub(super) enum End {
    /// Its source has ended.
    Source,
    /// This process was asked to end, by the signal of this number.
    Signal(u8),
    /// The daemon has ended it, for this cause; without one the connection broke.
    Daemon(Option<EndCause>),
    /// A source or a connection that cannot be read.
    Failed(anyhow::Error),
}

impl Source {
    /// Describes the source in a line for the user.
    pub(super) fn shown(&self) -> String {
        match self {
            Self::Lines(_) => "stdin".to_owned(),
            Self::Input(input) => input.shown(),
        }
    }

    /// Whether silence may mean that the source hangs. A file is never late, and a mouse may be held still.
    pub(super) const fn must_speak(&self) -> bool {
        matches!(self, Self::Lines(lines) if !lines.is_file())
    }

    /// Waits for the first message; `Err`: a signal came before it.
    pub(super) fn first(&mut self, signals: &Signals) -> Result<Result<LiveMessage, u8>> {
        let lines = match self {
            Self::Input(input) => return Ok(Ok(moved_to(input.pose()))),
            Self::Lines(lines) => lines,
        };
        loop {
            while let Some(message) = lines.next()? {
                match message {
                    LiveMessage { end: true, .. } => bail!("stdin: ends the play before it has begun"),
                    message if message == LiveMessage::default() => {}
                    message => return Ok(Ok(message)),
                }
            }
            if lines.is_over() {
                bail!("stdin: ends before its first line: {}", lines.wanted());
            }
            let [can_read, _] = wait(&mut [lines.as_fd(), signals.as_fd()], None)?;
            if let Some(signal) = signals.taken() {
                return Ok(Err(signal));
            }
            if can_read {
                lines.read()?;
            }
        }
    }
}

impl AsFd for Source {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Lines(lines) => lines.as_fd(),
            Self::Input(input) => input.as_fd(),
        }
    }
}

fn moved_to(pose: LivePose) -> LiveMessage {
    LiveMessage { pose: Some(pose), ..LiveMessage::default() }
}

/// Waits until something can be read, or has ended; returns which.
fn wait<const N: usize>(files: &mut [BorrowedFd<'_>; N], timeout: Option<Duration>) -> Result<[bool; N]> {
    let mut fds = files.map(|file| PollFd::from_borrowed_fd(file, PollFlags::IN));
    // A timeout that is too long for the system counts as none.
    let timeout = timeout.and_then(|timeout| Timespec::try_from(timeout).ok());
    match poll(&mut fds, timeout.as_ref()) {
        Ok(_) => Ok(fds.map(|fd| !fd.revents().is_empty())),
        Err(Errno::INTR) => Ok([false; N]),
        Err(error) => Err(anyhow!("cannot wait for the source ({error})")),
    }
}

/// Counts of the messages by their result.
#[derive(Debug, Default)]
struct Counts {
    applied: u64,
    merged: u64,
    refused: u64,
    /// From the newest applied message to the tick from which strokes were replaced, ms.
    decided_ms: Option<f64>,
    /// From the newest applied message that moved a pin to its first new stroke, ms.
    first_stroke_ms: Option<f64>,
}

#[derive(Debug)]
pub(super) struct Following<'a> {
    play: &'a mut LivePlay,
    source: Source,
    pace: Pace,
    signals: &'a Signals,
    /// The tick rate of the device.
    rate: TickRate,
    counts: Counts,
    shown: Updates,
    /// Where an input device has moved the shape.
    pose: Option<LivePose>,
    /// Whether the source has ended; its last message may still wait.
    is_over: bool,
}

impl<'a> Following<'a> {
    pub(super) fn new(
        play: &'a mut LivePlay,
        source: Source,
        pace: Pace,
        signals: &'a Signals,
        rate: TickRate,
    ) -> Self {
        let pose = match &source {
            Source::Input(input) => Some(input.pose()),
            Source::Lines(_) => None,
        };
        Self {
            play,
            source,
            pace,
            signals,
            rate,
            counts: Counts::default(),
            shown: Updates::new(),
            pose,
            is_over: false,
        }
    }

    /// Follows the source until it ends, a signal comes, or the daemon ends the play. In the first two cases it ends the play.
    pub(super) fn run(&mut self) -> End {
        let end = loop {
            match self.turn() {
                Ok(None) => {}
                Ok(Some(end)) => break end,
                Err(error) => break End::Failed(error),
            }
        };
        match end {
            End::Daemon(_) => end,
            // Without a cause from the daemon, the receipt has the reason.
            End::Source => match self.finish() {
                Some(cause) if cause != EndCause::Stop => End::Daemon(Some(cause)),
                _ => End::Source,
            },
            End::Signal(_) | End::Failed(_) => {
                self.finish();
                end
            }
        }
    }

    /// Removes the progress line, and prints how many more updates were refused; returns the total.
    pub(super) fn summary(self) -> u64 {
        match self.counts.refused.saturating_sub(1) {
            0 => {}
            1 => self.shown.say("one more update was refused"),
            more => self.shown.say(&format!("{more} more updates were refused")),
        }
        self.counts.refused
    }

    fn turn(&mut self) -> Result<Option<End>> {
        // Even if the daemon reads no more messages, its answers include the end of the play.
        if let Some(end) = self.read_answers()? {
            return Ok(Some(end));
        }
        if let Some(signal) = self.signals.taken() {
            return Ok(Some(End::Signal(signal)));
        }
        let now = Instant::now();
        self.take_messages(now)?;
        if self.is_over && self.pace.is_done(now) {
            return Ok(Some(End::Source));
        }
        if let Some(message) = self.pace.due(now) {
            match self.play.send(message) {
                // The answers have the reason.
                Err(ClientError::HungUp { .. }) => {}
                sent => drop(sent?),
            }
        }
        self.wait(now)?;
        Ok(None)
    }

    /// Passes on lines that were read: the next one of a file when it is due, all of any other source.
    fn take_messages(&mut self, now: Instant) -> Result<()> {
        let Source::Lines(lines) = &mut self.source else { return Ok(()) };
        if lines.is_file() {
            if !self.is_over && self.pace.is_free(now) {
                match lines.next()? {
                    Some(message) => Self::take(&mut self.pace, &mut self.is_over, message),
                    None if lines.is_over() => self.is_over = true,
                    None => lines.read()?,
                }
            }
        } else {
            while !self.is_over
                && let Some(message) = lines.next()?
            {
                Self::take(&mut self.pace, &mut self.is_over, message);
            }
            self.is_over |= lines.is_over();
        }
        if self.is_over {
            self.pace.end(now);
        }
        Ok(())
    }

    fn take(pace: &mut Pace, is_over: &mut bool, message: LiveMessage) {
        *is_over |= message.end;
        pace.hear(LiveMessage { end: false, ..message });
    }

    /// Waits until there is something to do, and reads a piece of the source.
    fn wait(&mut self, now: Instant) -> Result<()> {
        let Self { play, source, pace, signals, is_over, .. } = self;
        let is_file = matches!(source, Source::Lines(lines) if lines.is_file());
        let timeout = pace.wait(now, is_file);
        // A file is always readable, and so is a pipe at its end.
        if is_file || *is_over {
            wait(&mut [play.as_fd(), signals.as_fd()], timeout)?;
            return Ok(());
        }
        let [_, _, can_read] = wait(&mut [play.as_fd(), signals.as_fd(), source.as_fd()], timeout)?;
        match source {
            _ if !can_read => {}
            Source::Lines(lines) => lines.read()?,
            Source::Input(input) => {
                input.read()?;
                let pose = Some(input.pose());
                if pose != self.pose {
                    self.pose = pose;
                    self.pace.hear(moved_to(input.pose()));
                }
            }
        }
        Ok(())
    }

    /// Reads the answers that have come.
    fn read_answers(&mut self) -> Result<Option<End>> {
        loop {
            match self.play.next(Duration::ZERO) {
                Ok(Some(LiveAnswer { ended: Some(cause), .. })) => return Ok(Some(End::Daemon(Some(cause)))),
                Ok(Some(answer)) => self.note(answer),
                Ok(None) | Err(ClientError::HungUp { .. }) => return Ok(Some(End::Daemon(None))),
                Err(ClientError::Timeout { .. }) => return Ok(None),
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Ends the play, unless it is over; returns the daemon's cause if it comes in time.
    fn finish(&mut self) -> Option<EndCause> {
        let end = LiveMessage { end: true, ..LiveMessage::default() };
        // If the connection is closed, the play is over; if sending blocks, closing the connection ends the play.
        if self.play.send(end).is_err() {
            return None;
        }
        let until = Instant::now() + END;
        loop {
            match self.play.next(until.saturating_duration_since(Instant::now())) {
                Ok(Some(LiveAnswer { ended: Some(cause), .. })) => return Some(cause),
                // The end of the play came before an update, which is refused.
                Ok(Some(LiveAnswer { problem: Some(_), .. })) => {}
                Ok(Some(answer)) => self.note(answer),
                Ok(None) | Err(_) => return None,
            }
        }
    }

    fn note(&mut self, answer: LiveAnswer) {
        let LiveAnswer { seq, applied, merged_into, problem, .. } = answer;
        self.pace.answered();
        let Counts { applied: applied_count, merged, refused, decided_ms, first_stroke_ms } =
            &mut self.counts;
        if let Some(LiveApplied { received_tick, from_tick, ticks, .. }) = applied {
            let rate = self.rate;
            let after = |tick: u64| rate.ticks_to_ms(tick.saturating_sub(received_tick));
            *applied_count += 1;
            *decided_ms = Some(after(from_tick));
            *first_stroke_ms = ticks.into_iter().flatten().min().map(after).or(*first_stroke_ms);
        }
        *merged += u64::from(merged_into.is_some());
        // If the play was over, the reason follows.
        if let Some(problem) = problem.filter(|problem| problem.code != Code::NotFound.parts().0) {
            *refused += 1;
            if *refused == 1 {
                let number = seq.map_or_else(String::new, |seq| format!(" {seq}"));
                self.shown.say(&format!("update{number} was refused: {problem}"));
            }
        }
        let Counts { applied, merged, refused, decided_ms, first_stroke_ms } = self.counts;
        self.shown.show(Instant::now(), || {
            let ms = |what: &str, ms: Option<f64>| {
                ms.map_or_else(String::new, |ms| format!(", {what} {ms:.1} ms"))
            };
            format!(
                "{applied} applied, {merged} merged, {refused} refused{}{}",
                ms("decided after", decided_ms),
                ms("first new stroke after", first_stroke_ms)
            )
        });
    }
}
