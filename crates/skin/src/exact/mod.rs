//! The exact method: from breakpoint to breakpoint, eight afferents at a time.
//!
//! A [`Group`] holds the state of eight afferents (`group`). `vectors` takes it from breakpoint to breakpoint. Each lane is one
//! afferent, and it goes only to the breakpoints of the motors that reach it. So it depends only on its own motors, not on its
//! neighbours or on the number of lanes of the processor. A lane that might reach its threshold within a segment leaves the vector
//! for [`Neuron`](crate::membrane::neuron::Neuron).
//!
//! Weights are rounded to whole numbers of 37 bits, or fewer for many motors with a long window. So are their products with the
//! slope change of a breakpoint. (A slope change is 1 or -1, or a share of that if bursts differ in their travel.) So every slope
//! and every sum of inputs is a whole number of at most 2⁵³: exact in `f64` in any order, and 0 at rest. The rounding error of 37
//! bits is smaller than the error of ignoring weights below 10⁻¹⁰.
//!
//! Invariant: the lanes' arithmetic is the same at every vector width.

mod group;
mod vectors;

pub(crate) use group::{Group, LANES, MAX_BUFFERED};

use crate::breakpoints::Breakpoint;
use crate::membrane::equation::Membrane;
use group::Repetition;
use pulp::Arch;
use vectors::Pass;

impl Group {
    /// Goes through a block of breakpoints. `keep`: spikes are kept, not only counted.
    pub(crate) fn run(
        &mut self,
        arch: Arch,
        membrane: &Membrane,
        mut breakpoints: &[Breakpoint],
        keep: bool,
    ) {
        while let Some(cycle) = &self.cycle {
            let before = breakpoints.partition_point(|found| found.at < cycle.next);
            if before == breakpoints.len() {
                break;
            }
            let (now, rest) = breakpoints.split_at(before);
            self.pass(arch, membrane, now, None, keep);
            breakpoints = rest;
            self.find_repetitions(membrane, keep);
        }
        self.pass(arch, membrane, breakpoints, None, keep);
    }

    fn pass(
        &mut self,
        arch: Arch,
        membrane: &Membrane,
        breakpoints: &[Breakpoint],
        until: Option<f64>,
        keep: bool,
    ) {
        // A repetition repeats spikes, so they are buffered while one is looked for.
        let buffers = !keep && self.cycle.is_some();
        arch.dispatch(Pass { group: self, membrane, breakpoints, until, keep: keep || buffers });
        if buffers && self.kept() > MAX_BUFFERED {
            self.cycle = None;
            let going_on = self.lanes.iter_mut().filter(|lane| lane.repetition.is_none());
            going_on.for_each(|lane| lane.spikes = Vec::new());
        }
    }

    /// Finds lanes that repeat themselves, and takes them out.
    fn find_repetitions(&mut self, membrane: &Membrane, keep: bool) {
        let Some(mut cycle) = self.cycle.take() else { return };
        let from = cycle.next;
        let matters = 1.0 + membrane.refractory.max(membrane.lowering);
        let states = std::array::from_fn(|lane| {
            let (at, last_at, last_offset) = (self.at[lane], self.last_at[lane], self.last_offset[lane]);
            // A spike that is too long ago to have an effect counts as none.
            let over = (at - last_at) - last_offset > matters;
            let (last_at, last_offset) = if over { (0.0, 0.0) } else { (last_at - from, last_offset) };
            [at - from, self.v[lane], self.k[lane], self.p[lane], self.resting[lane], last_at, last_offset]
        });
        let compared = cycle.compare(&states);
        for (number, lane) in self.lanes.iter_mut().enumerate() {
            if lane.repetition.is_some() {
                continue;
            }
            if compared.repeats >> number & 1 == 1 {
                lane.repetition = Some(Repetition { from, length: compared.ago });
                // From now on the lane is like one without an afferent.
                self.resting[number] = f64::INFINITY;
                self.weights.iter_mut().for_each(|weights| weights[number] = 0.0);
            } else if compared.kept || compared.given_up {
                if !keep {
                    lane.spikes.clear();
                }
                lane.marked = lane.spikes.len();
            }
        }
        self.cycle = (!compared.given_up && self.goes_on()).then_some(cycle);
    }

    /// Goes to the end of the scene. Returns for each afferent the number of spikes, and their times if they were kept;
    /// and the afferent-half-ticks that were repetitions.
    pub(crate) fn finish(
        mut self,
        arch: Arch,
        membrane: &Membrane,
        keep: bool,
    ) -> (Vec<(u64, Vec<f64>)>, f64) {
        let until = self.end;
        self.pass(arch, membrane, &[], Some(until), keep);
        let repeated =
            self.lanes.iter().filter_map(|lane| lane.repetition).map(|repetition| until - repetition.from);
        let repeated = repeated.sum();
        let trains = self.lanes.into_iter().map(|lane| lane.into_train(until, keep));
        (trains.collect(), repeated)
    }
}
