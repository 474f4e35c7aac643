//! The shipped edge, and its array, of which all motors of the comparison are.

use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_paper::YARDSTICK;
use std::sync::LazyLock;

/// The shipped pattern for the target [`YARDSTICK`].
pub(super) static EDGE: LazyLock<Pattern> = LazyLock::new(|| {
    let text = include_str!("../../../library/patterns/paper/edge-45-paper.toml");
    Pattern::parse(text, YARDSTICK).expect("a test reads the shipped pattern")
});

/// The array of the shipped edge, and of all motors of the comparison.
pub(super) fn array() -> Array {
    EDGE.array()
}
