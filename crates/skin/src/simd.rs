//! Vectors of `f32` or `f64`, as wide as the processor's.
//!
//! [`Number`] names the operations of `pulp` once for both precisions, so the stepped method is written once. Products
//! are added with one rounding (`mul_add`) everywhere: that gives the same bits at every width and on every machine.
//!
//! Invariant: no operation here mixes lanes.

use pulp::{Simd, bytemuck};
use std::ops::{Deref, DerefMut};

/// Lanes in memory, aligned so that no vector crosses a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Aligned<T>(pub(crate) T);

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

/// The numbers of a vector.
pub(crate) trait Number: Copy + Default + Send + Sync + 'static {
    type Vector<S: Simd>: Copy;
    type Mask<S: Simd>: Copy;

    fn of(value: f64) -> Self;
    fn wide(self) -> f64;
    /// The number of lanes of a vector.
    fn width<S: Simd>() -> usize;
    fn splat<S: Simd>(simd: S, value: Self) -> Self::Vector<S>;
    fn load<S: Simd>(lanes: &[Self]) -> Self::Vector<S>;
    fn store<S: Simd>(lanes: &mut [Self], vector: Self::Vector<S>);
    fn add<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn sub<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn mul<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn mul_add<S: Simd>(
        simd: S,
        a: Self::Vector<S>,
        b: Self::Vector<S>,
        c: Self::Vector<S>,
    ) -> Self::Vector<S>;
    fn max<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn min<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn div<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn abs<S: Simd>(simd: S, a: Self::Vector<S>) -> Self::Vector<S>;
    fn at_least<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Mask<S>;
    fn both<S: Simd>(simd: S, a: Self::Mask<S>, b: Self::Mask<S>) -> Self::Mask<S>;
    fn either<S: Simd>(simd: S, a: Self::Mask<S>, b: Self::Mask<S>) -> Self::Mask<S>;
    fn select<S: Simd>(
        simd: S,
        mask: Self::Mask<S>,
        a: Self::Vector<S>,
        b: Self::Vector<S>,
    ) -> Self::Vector<S>;
    /// The mask as bits, one per lane, the first lane lowest.
    fn bits<S: Simd>(mask: Self::Mask<S>) -> u32;
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

macro_rules! number {
    ($number:ident, $vector:ident, $mask:ident, $lanes:ident, $load:ident, $store:ident, $splat:ident, $add:ident,
     $sub:ident, $mul:ident, $mul_add:ident, $max:ident, $min:ident, $div:ident, $abs:ident, $at_least:ident, $and:ident, $or:ident,
     $select:ident, $of:expr) => {
        impl Number for $number {
            type Vector<S: Simd> = S::$vector;
            type Mask<S: Simd> = S::$mask;

            #[inline(always)]
            fn of(value: f64) -> Self {
                $of(value)
            }
            #[inline(always)]
            fn wide(self) -> f64 {
                self.into()
            }
            #[inline(always)]
            fn width<S: Simd>() -> usize {
                S::$lanes
            }
            #[inline(always)]
            fn splat<S: Simd>(simd: S, value: Self) -> S::$vector {
                simd.$splat(value)
            }
            #[inline(always)]
            fn load<S: Simd>(lanes: &[Self]) -> S::$vector {
                S::$load(&lanes[..S::$lanes]).0[0]
            }
            #[inline(always)]
            fn store<S: Simd>(lanes: &mut [Self], vector: S::$vector) {
                S::$store(&mut lanes[..S::$lanes]).0[0] = vector;
            }
            #[inline(always)]
            fn add<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$add(a, b)
            }
            #[inline(always)]
            fn sub<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$sub(a, b)
            }
            #[inline(always)]
            fn mul<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$mul(a, b)
            }
            #[inline(always)]
            fn mul_add<S: Simd>(simd: S, a: S::$vector, b: S::$vector, c: S::$vector) -> S::$vector {
                simd.$mul_add(a, b, c)
            }
            #[inline(always)]
            fn max<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$max(a, b)
            }
            #[inline(always)]
            fn min<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$min(a, b)
            }
            #[inline(always)]
            fn div<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$div(a, b)
            }
            #[inline(always)]
            fn abs<S: Simd>(simd: S, a: S::$vector) -> S::$vector {
                simd.$abs(a)
            }
            #[inline(always)]
            fn at_least<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$mask {
                simd.$at_least(a, b)
            }
            #[inline(always)]
            fn both<S: Simd>(simd: S, a: S::$mask, b: S::$mask) -> S::$mask {
                simd.$and(a, b)
            }
            #[inline(always)]
            fn either<S: Simd>(simd: S, a: S::$mask, b: S::$mask) -> S::$mask {
                simd.$or(a, b)
            }
            #[inline(always)]
            fn select<S: Simd>(simd: S, mask: S::$mask, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$select(mask, a, b)
            }
            #[inline(always)]
            fn bits<S: Simd>(mask: S::$mask) -> u32 {
                bits(mask, S::$lanes)
            }
        }
    };
}

number!(
    f64,
    f64s,
    m64s,
    F64_LANES,
    as_simd_f64s,
    as_mut_simd_f64s,
    splat_f64s,
    add_f64s,
    sub_f64s,
    mul_f64s,
    mul_add_f64s,
    max_f64s,
    min_f64s,
    div_f64s,
    abs_f64s,
    greater_than_or_equal_f64s,
    and_m64s,
    or_m64s,
    select_f64s,
    |value| value
);
number!(
    f32,
    f32s,
    m32s,
    F32_LANES,
    as_simd_f32s,
    as_mut_simd_f32s,
    splat_f32s,
    add_f32s,
    sub_f32s,
    mul_f32s,
    mul_add_f32s,
    max_f32s,
    min_f32s,
    div_f32s,
    abs_f32s,
    greater_than_or_equal_f32s,
    and_m32s,
    or_m32s,
    select_f32s,
    |value: f64| value as f32
);
