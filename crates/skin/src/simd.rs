//! Vectors of `f64`, as wide as the processor's, and the lanes of eight afferents in memory.
//!
//! Products are added with one rounding (`mul_add`) everywhere: that gives the same bits at every width and on every machine.

use pulp::{Simd, bytemuck};
use std::ops::{Deref, DerefMut};

/// Afferents in a group: the widest vector.
pub(crate) const LANES: usize = 8;

/// Lanes in memory, aligned so that no vector crosses a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Aligned<T>(pub(crate) T);

/// One number per lane.
pub(crate) type Row = Aligned<[f64; LANES]>;

impl<T> Deref for Aligned<T> {
    type Target = T;
    #[inline(always)]
    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T> DerefMut for Aligned<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut T {
        &mut self.0
    }
}

/// The vector of the lanes from `first` on.
#[inline(always)]
pub(crate) fn load<S: Simd>(lanes: &Row, first: usize) -> S::f64s {
    S::as_simd_f64s(&lanes[first..first + S::F64_LANES]).0[0]
}

#[inline(always)]
pub(crate) fn store<S: Simd>(lanes: &mut Row, first: usize, values: S::f64s) {
    S::as_mut_simd_f64s(&mut lanes[first..first + S::F64_LANES]).0[0] = values;
}

/// A vector in memory, from the first lane on.
#[inline(always)]
pub(crate) fn spill<S: Simd>(values: S::f64s) -> Row {
    let mut lanes = Aligned([0.0; LANES]);
    store::<S>(&mut lanes, 0, values);
    lanes
}

/// A mask as bits, one per lane, the first lane lowest. (`Simd::first_true_m64s` of pulp 0.22 reads AVX-512 masks from
/// the wrong end.)
#[inline(always)]
pub(crate) fn bits<M: bytemuck::NoUninit>(mask: M, lanes: usize) -> u32 {
    let bytes = bytemuck::bytes_of(&mask);
    // A mask has one bit per lane (or the truth value of a single lane), or per lane the bytes of a number, all ones or all zeros.
    match *bytes {
        [byte] => byte.into(),
        [low, high] => u32::from(low) | u32::from(high) << 8,
        _ => {
            let step = bytes.len() / lanes;
            (0..lanes).fold(0, |bits, lane| bits | u32::from(bytes[step * lane] & 1) << lane)
        }
    }
}
