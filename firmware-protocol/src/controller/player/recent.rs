//! What was rendered last, so that an e-stop can take back what is not played.
//!
//! Invariant: it reaches back from the rendered end by the horizon at least.

use crate::controller::HORIZON;
use crate::stroke::Lines;
use core::hash::{Hash, Hasher};

/// Ticks in which no line changed.
#[derive(Clone, Copy, Debug, Hash)]
pub(super) struct Rendered {
    pub(super) lines: Lines,
    pub(super) ticks: u32,
    /// Moves that began in the first of them.
    pub(super) begun: u16,
}

const RUNS: usize = HORIZON as usize;

/// A ring of as many runs as the horizon has ticks.
#[derive(Clone, Debug)]
pub(super) struct Recent {
    runs: [Rendered; RUNS],
    /// The place of the next run.
    next: usize,
}

impl Hash for Recent {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.newest_first().for_each(|run| run.hash(hasher));
    }
}

impl Recent {
    pub(super) const NOTHING: Self =
        Self { runs: [Rendered { lines: Lines::OFF, ticks: 0, begun: 0 }; RUNS], next: 0 };

    #[inline(always)]
    pub(super) fn push(&mut self, run: Rendered) {
        self.runs[self.next % RUNS] = run;
        self.next = (self.next + 1) % RUNS;
    }

    fn newest_first(&self) -> impl Iterator<Item = &Rendered> {
        let runs = (1..=RUNS).map(|ago| &self.runs[(self.next + RUNS - ago) % RUNS]);
        runs.take_while(|run| run.ticks > 0)
    }

    /// Pulses in the last `ticks`, and moves that began in them.
    pub(super) fn in_last(&self, mut ticks: u32) -> (u64, u64) {
        let (mut pulses, mut begun) = (0, 0);
        for run in self.newest_first() {
            let of = run.ticks.min(ticks);
            pulses += u64::from(run.lines.pulsing().len() * of);
            if of < run.ticks || of == 0 {
                break;
            }
            begun += u64::from(run.begun);
            ticks -= of;
        }
        (pulses, begun)
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
            return Some(Rendered { ticks, begun: 0, ..*last });
        }
        self.next = before;
        Some(core::mem::replace(last, Rendered { ticks: 0, ..*last }))
    }
}
