//! Shows the progress of plays and computations.
//!
//! On a terminal it shows a bar or a spinner on stderr, and removes it at the end. Elsewhere a play prints lines on stdout: at its
//! beginning, every second, and for each of the first ten late or refused strokes. With `--json` there are no lines.

use super::output::{Stream, is_broken_pipe, say};
use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use meissner_api::Event;
use std::io::Write;
use std::time::{Duration, Instant};

/// Work that takes less needs no bar.
const SHORT: Duration = Duration::from_secs(1);
/// How often a spinner turns.
const TURN: Duration = Duration::from_millis(100);
/// Steps of a computation's bar.
const PARTS: f64 = 1000.0;

/// Runs work that reports its progress, 0 to 1; on a terminal, shows a bar after the first second.
pub(super) fn metered<T>(work: impl FnOnce(&(dyn Fn(f64) + Sync)) -> T) -> T {
    let style = ProgressStyle::with_template("{wide_bar} {percent:>3} %");
    let meter = Meter::new(|| {
        ProgressBar::new(PARTS as u64).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
    });
    let begun = Instant::now();
    work(&|part| {
        if begun.elapsed() > SHORT {
            meter.at(part);
        }
    })
}

/// Runs work that reports no progress; on a terminal, shows a spinner.
pub(super) fn waiting<T>(what: &'static str, work: impl FnOnce() -> T) -> T {
    let meter = Meter::new(|| ProgressBar::new_spinner().with_message(what));
    if let Some(bar) = &meter.0 {
        bar.enable_steady_tick(TURN);
    }
    work()
}

/// Progress of a search, on stderr: a spinner on a terminal, else a line every second.
#[derive(Debug)]
pub(super) struct Search {
    meter: Meter,
    lines: bool,
    shown: Instant,
}

impl Search {
    pub(super) fn new(json: bool) -> Self {
        let meter = Meter::new(ProgressBar::new_spinner);
        Self { lines: !json && meter.0.is_none(), meter, shown: Instant::now() }
    }

    pub(super) fn show(&mut self, progress: &meissner_paper::Progress) {
        let now = Instant::now();
        if now.duration_since(self.shown) < if self.lines { SHORT } else { TURN } {
            return;
        }
        self.shown = now;
        let meissner_paper::Progress { frame, frames, spent, score } = progress;
        let of = if *frames > 1 { format!("frame {} of {frames}, ", frame + 1) } else { String::new() };
        let line = format!(
            "{of}{} evaluations: {:.1} impulses/s, {:.1} ON, {:.1} OFF",
            spent.evaluations,
            score.cost_hz(),
            score.on_hz,
            score.off_hz
        );
        if let Some(bar) = &self.meter.0 {
            bar.set_message(line);
            bar.tick();
        } else if self.lines {
            // A closed stderr does not stop the search.
            let _ = writeln!(Stream::Stderr, "{line}");
        }
    }
}

/// A bar on a terminal; dropping it removes the bar.
#[derive(Debug)]
struct Meter(Option<ProgressBar>);

impl Meter {
    fn new(bar: impl FnOnce() -> ProgressBar) -> Self {
        Self(Stream::Stderr.is_terminal().then(bar))
    }

    /// Shows that `part` of the work is done, 0 to 1.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn at(&self, part: f64) {
        if let Some(bar) = &self.0 {
            bar.set_position((part.clamp(0.0, 1.0) * PARTS) as u64);
        }
    }
}

impl Drop for Meter {
    fn drop(&mut self) {
        if let Some(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

/// The most late and refused strokes that get a line.
const LINES: u32 = 10;

#[derive(Debug)]
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    lines: bool,
    second: u64,
    late: u32,
    refused: u32,
}

impl Progress {
    /// For a play of `seconds`; endless if `None`.
    pub(super) fn new(seconds: Option<f64>, json: bool) -> Self {
        let bar = Stream::Stderr.is_terminal().then(|| bar(seconds));
        Self { lines: !json && bar.is_none(), bar, second: 0, late: 0, refused: 0 }
    }

    pub(super) fn show(&mut self, id: u64, event: &Event) -> Result<()> {
        match event {
            Event::State { play: Some(play), .. } if play.id == id => self.at(play.played_s),
            Event::Began { id: of, onset } if *of == id => {
                self.line(|| format!("play {id} began at tick {}", onset.actual_tick))
            }
            Event::Late { id: of, stroke } if *of == id => {
                self.late += 1;
                self.count(self.late <= LINES, || {
                    format!("late by {:.1} ms: motor {}, {:?}", stroke.late_ms, stroke.motor, stroke.cause)
                })
            }
            Event::Refused { id: of, stroke } if *of == id => {
                self.refused += 1;
                self.count(self.refused <= LINES, || {
                    format!("refused: motor {}, {}", stroke.motor, stroke.reason)
                })
            }
            _ => Ok(()),
        }
    }

    /// Removes the bar.
    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "seconds that have passed")]
    fn at(&mut self, played_s: f64) -> Result<()> {
        if let Some(bar) = &self.bar {
            bar.set_position((played_s * 1000.0) as u64);
            return Ok(());
        }
        let second = played_s as u64;
        if second > self.second {
            self.second = second;
            let (late, refused) = (self.late, self.refused);
            return self.line(|| format!("{second} s, {late} strokes late, {refused} refused"));
        }
        Ok(())
    }

    fn count(&mut self, print: bool, line: impl FnOnce() -> String) -> Result<()> {
        if let Some(bar) = &self.bar {
            bar.set_message(format!("{} late, {} refused", self.late, self.refused));
        }
        if print { self.line(line) } else { Ok(()) }
    }

    fn line(&mut self, line: impl FnOnce() -> String) -> Result<()> {
        match if self.lines { say(&line()) } else { Ok(()) } {
            // The reader of stdout has closed it; the play goes on, and its result counts.
            Err(error) if is_broken_pipe(&error) => self.lines = false,
            said => return said,
        }
        Ok(())
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a length, checked by the daemon"
)]
fn bar(seconds: Option<f64>) -> ProgressBar {
    let (bar, template) = match seconds {
        Some(seconds) => (ProgressBar::new((seconds * 1000.0) as u64), "{wide_bar} {pos:>6}/{len} ms {msg}"),
        None => (ProgressBar::no_length(), "{spinner} {pos:>6} ms {msg}"),
    };
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style).with_message("0 late, 0 refused")
}
