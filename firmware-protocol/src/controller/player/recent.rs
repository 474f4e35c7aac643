//! What was rendered last, so that an e-stop can take back what is not played.
//!
//! Invariant: it reaches back from the rendered end by the horizon at least.

use crate::controller::HORIZON;
use crate::message::Counters;
use crate::stroke::Lines;

/// What was counted of the moves that began in a tick: at most one of each motor.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Begun {
    played: u8,
    amended: u8,
    shortened: u8,
}

impl Begun {
    /// The low bytes of these counts.
    pub(super) fn of(&Counters { played, amended, shortened, .. }: &Counters) -> Self {
        Self { played: played as u8, amended: amended as u8, shortened: shortened as u8 }
    }

    /// What was counted since `before`.
    pub(super) fn since(self, before: Self) -> Self {
        Self {
            played: self.played.wrapping_sub(before.played),
            amended: self.amended.wrapping_sub(before.amended),
            shortened: self.shortened.wrapping_sub(before.shortened),
        }
    }

    /// Counts them no longer. Returns how many moves they were.
    pub(super) fn take_back(self, counters: &mut Counters) -> u16 {
        counters.played -= u64::from(self.played);
        counters.amended -= u64::from(self.amended);
        counters.shortened -= u64::from(self.shortened);
        self.played.into()
    }
}

/// Ticks in which no line changed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rendered {
    pub(super) lines: Lines,
    pub(super) ticks: u32,
    /// What began in the first of them.
    pub(super) begun: Begun,
}

const RUNS: usize = HORIZON as usize;

/// A ring of as many runs as the horizon has ticks.
#[derive(Clone, Debug)]
pub(super) struct Recent {
    runs: [Rendered; RUNS],
    /// The place of the next run.
    next: usize,
}

impl Recent {
    pub(super) const NOTHING: Self = {
        let begun = Begun { played: 0, amended: 0, shortened: 0 };
        Self { runs: [Rendered { lines: Lines::OFF, ticks: 0, begun }; RUNS], next: 0 }
    };

    #[inline(always)]
    pub(super) fn push(&mut self, run: Rendered) {
        self.runs[self.next % RUNS] = run;
        self.next = (self.next + 1) % RUNS;
    }

    fn newest_first(&self) -> impl Iterator<Item = &Rendered> {
        let runs = (1..=RUNS).map(|ago| &self.runs[(self.next + RUNS - ago) % RUNS]);
        runs.take_while(|run| run.ticks > 0)
    }

    /// Takes the last `ticks` out of these counts.
    pub(super) fn without_last(&self, mut ticks: u32, mut counters: Counters) -> Counters {
        for run in self.newest_first() {
            let of = run.ticks.min(ticks);
            counters.pulses -= u64::from(run.lines.pulsing().len() * of);
            if of < run.ticks || of == 0 {
                break;
            }
            run.begun.take_back(&mut counters);
            ticks -= of;
        }
        counters
    }

    /// Takes the newest run, and of it at most `ticks`, the last ones.
    pub(super) fn take_back(&mut self, ticks: u32) -> Option<Rendered> {
        let before = (self.next + RUNS - 1) % RUNS;
        let last = &mut self.runs[before];
        if last.ticks == 0 {
            return None;
        }
        if last.ticks > ticks {
            last.ticks -= ticks;
            return Some(Rendered { ticks, begun: Begun::default(), ..*last });
        }
        self.next = before;
        Some(core::mem::replace(last, Rendered { ticks: 0, ..*last }))
    }
}
