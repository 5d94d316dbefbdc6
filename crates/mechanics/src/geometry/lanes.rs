//! One number or four at once: the same arithmetic, to the last bit.
use std::ops::{Add, BitAnd, BitOr, Mul, Sub};
use wide::f32x4;

/// How many numbers the widest lanes hold.
pub const LANES: usize = 4;

/// Numbers that are calculated with side by side: one (`f32`) or four (`f32x4`). No operation fuses or reorders, so that four lanes
/// give what one gives four times, on any processor.
pub trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {
    /// How many numbers: a divisor of [`LANES`].
    const N: usize;
    /// A yes or no for each.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask>;

    /// The same number everywhere.
    fn splat(v: f32) -> Self;
    /// The numbers from place `at` on, a multiple of [`Self::N`].
    fn load(from: &[f32; LANES], at: usize) -> Self;
    /// Puts the numbers back to place `at`.
    fn store(self, to: &mut [f32; LANES], at: usize);
    /// Column by column what `row` gives for each lane.
    fn columns(row: impl FnMut(usize) -> [f32; 4]) -> [Self; 4];
    /// Where a number is below another; never where one is NaN.
    fn less(self, than: Self) -> Self::Mask;
    /// Where a number is not below another; never where one is NaN.
    fn at_least(self, other: Self) -> Self::Mask;
    /// `yes` where the mask says so, else `no`.
    fn choose(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// The whole part of numbers within 0..2^31, also as counts.
    fn whole(self) -> (Self, [usize; LANES]);
    /// One bit a lane, the first lowest.
    fn bits(mask: Self::Mask) -> u32;
}

impl Lanes for f32 {
    const N: usize = 1;
    type Mask = bool;

    #[inline]
    fn splat(v: f32) -> Self {
        v
    }
    #[inline]
    fn load(from: &[f32; LANES], at: usize) -> Self {
        from[at]
    }
    #[inline]
    fn store(self, to: &mut [f32; LANES], at: usize) {
        to[at] = self;
    }
    #[inline]
    fn columns(mut row: impl FnMut(usize) -> [f32; 4]) -> [Self; 4] {
        row(0)
    }
    #[inline]
    fn less(self, than: Self) -> bool {
        self < than
    }
    #[inline]
    fn at_least(self, other: Self) -> bool {
        self >= other
    }
    #[inline]
    fn choose(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
    #[inline]
    fn whole(self) -> (Self, [usize; LANES]) {
        let count = self as i32;
        (count as f32, [count as usize, 0, 0, 0])
    }
    #[inline]
    fn bits(mask: bool) -> u32 {
        u32::from(mask)
    }
}

impl Lanes for f32x4 {
    const N: usize = 4;
    type Mask = f32x4;

    #[inline]
    fn splat(v: f32) -> Self {
        f32x4::splat(v)
    }
    #[inline]
    fn load(from: &[f32; LANES], _: usize) -> Self {
        f32x4::new(*from)
    }
    #[inline]
    fn store(self, to: &mut [f32; LANES], _: usize) {
        *to = self.to_array();
    }
    #[inline]
    fn columns(mut row: impl FnMut(usize) -> [f32; 4]) -> [Self; 4] {
        // Written out: through `array::map` the rows would go by way of memory.
        let (a, b, c, d) = (row(0), row(1), row(2), row(3));
        f32x4::transpose([f32x4::new(a), f32x4::new(b), f32x4::new(c), f32x4::new(d)])
    }
    #[inline]
    fn less(self, than: Self) -> f32x4 {
        self.simd_lt(than)
    }
    #[inline]
    fn at_least(self, other: Self) -> f32x4 {
        self.simd_ge(other)
    }
    #[inline]
    fn choose(mask: f32x4, yes: Self, no: Self) -> Self {
        mask.select(yes, no)
    }
    #[inline]
    fn whole(self) -> (Self, [usize; LANES]) {
        let counts = self.fast_trunc_int();
        let [a, b, c, d] = counts.to_array();
        let places = [a as usize, b as usize, c as usize, d as usize];
        (f32x4::from_i32x4(counts), places)
    }
    #[inline]
    fn bits(mask: f32x4) -> u32 {
        mask.to_bitmask()
    }
}

/// The places of the bits that are set, ascending.
pub(crate) fn set_bits(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = bits.trailing_zeros();
        bits &= bits.wrapping_sub(1);
        (place < u32::BITS).then_some(place as usize)
    })
}
