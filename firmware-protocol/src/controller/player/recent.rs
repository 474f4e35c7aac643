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

#[derive(Clone, Debug)]
pub(super) struct Recent {
    runs: heapless::Deque<Rendered, { HORIZON as usize }>,
}

impl Hash for Recent {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.runs.iter().for_each(|run| run.hash(hasher));
    }
}

impl Recent {
    pub(super) const NOTHING: Self = Self { runs: heapless::Deque::new() };

    pub(super) fn push(&mut self, run: Rendered) {
        if self.runs.is_full() {
            self.runs.pop_front();
        }
        let _ = self.runs.push_back(run);
    }

    /// Pulses in the last `ticks`, and moves that began in them.
    pub(super) fn in_last(&self, mut ticks: u32) -> (u64, u64) {
        let (mut pulses, mut begun) = (0, 0);
        for run in self.runs.iter().rev() {
            let of = run.ticks.min(ticks);
            pulses += u64::from(run.lines.pulsing().len()) * u64::from(of);
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
        let last = self.runs.back_mut()?;
        if last.ticks > ticks {
            last.ticks -= ticks;
            return Some(Rendered { ticks, begun: 0, ..*last });
        }
        self.runs.pop_back()
    }
}
