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

pub(crate) use group::Group;

use crate::breakpoints::Breakpoint;
use crate::membrane::equation::Membrane;
use crate::membrane::neuron::Instant;
use pulp::Arch;
use vectors::Pass;

impl Group {
    /// Goes through a block of breakpoints. `keep`: spikes are kept, not only counted.
    pub(crate) fn run(&mut self, arch: Arch, membrane: &Membrane, breakpoints: &[Breakpoint], keep: bool) {
        arch.dispatch(Pass { group: self, membrane, breakpoints, until: None, keep });
    }

    /// Goes to the end of the scene. Returns for each afferent the number of spikes, and their times if they were kept.
    pub(crate) fn finish(mut self, arch: Arch, membrane: &Membrane, keep: bool) -> Vec<(u64, Vec<f64>)> {
        let until = Some(self.end);
        arch.dispatch(Pass { group: &mut self, membrane, breakpoints: &[], until, keep });
        let half_ticks = |spikes: &[Instant]| spikes.iter().map(Instant::half_ticks).collect();
        self.lanes.iter().map(|lane| (lane.count, half_ticks(&lane.spikes))).collect()
    }
}
