//! Bounds the moves that begin, of all motors, by what the chip has time for: [`Layout::max_dense`] within 10 ms.
//!
//! Invariant: `room` and the moves begun in the last 10 ms, those of the present block included, sum up to [`Layout::max_dense`].

use crate::array::{CAPACITY, Layout};
use crate::limits::Refusal;

/// Room for the blocks in which moves count, with the present one.
const BLOCKS: usize = Layout::MAX_DENSE_BLOCKS;
// Each motor may begin two moves in a block.
const _: () = assert!(2 * CAPACITY <= u8::MAX as usize);

#[derive(Clone, Debug)]
pub(super) struct Density {
    /// Moves that have begun in each block, in a ring.
    begun: [u8; BLOCKS],
    /// Length of the ring.
    blocks: u8,
    /// The place of the present block.
    present: u8,
    /// How many more may begin.
    room: u16,
}

impl Density {
    pub(super) const fn new(layout: &Layout) -> Self {
        Self { begun: [0; BLOCKS], blocks: layout.dense_blocks(), present: 0, room: layout.max_dense() }
    }

    /// The next block begins.
    pub(super) fn next_block(&mut self) {
        self.present = if self.present + 1 < self.blocks { self.present + 1 } else { 0 };
        self.room += u16::from(core::mem::take(&mut self.begun[usize::from(self.present)]));
    }

    /// A move begins in the present block.
    ///
    /// # Errors
    /// [`Refusal::Dense`] if too many have begun; then it does not count.
    pub(super) fn begin(&mut self) -> Result<(), Refusal> {
        self.room = self.room.checked_sub(1).ok_or(Refusal::Dense)?;
        self.begun[usize::from(self.present)] += 1;
        Ok(())
    }

    /// A move begins that is not refused.
    pub(super) fn count(&mut self) {
        if self.room > 0 {
            self.room -= 1;
            self.begun[usize::from(self.present)] += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Compares it with a count over all moves that have begun. Moves down are never refused; they leave less room for moves up.
        #[test]
        fn moves_up_are_as_dense_as_they_may_be_and_no_denser(
            blocks in prop::collection::vec((prop_oneof![Just(0usize), 0usize..60, Just(250)], 0u8..4), 1..300),
        ) {
            let mut density = Density::new(&Layout::PAPER);
            let mut begun = std::vec::Vec::new();
            for (block, (moves, down)) in blocks.into_iter().enumerate() {
                density.next_block();
                for number in 0..moves {
                    let fits = begun.iter().filter(|&&at| at + 53 > block).count() < 192;
                    if number % 4 < down.into() {
                        density.count();
                    } else {
                        prop_assert_eq!(density.begin(), if fits { Ok(()) } else { Err(Refusal::Dense) });
                    }
                    if fits {
                        begun.push(block);
                    }
                }
            }
        }
    }
}
