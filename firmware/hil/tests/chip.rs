//! The emulated chip for tests.

use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;

pub(crate) fn which(seed: u64) -> Which {
    Which::Chip(ChipOptions::new(seed))
}
