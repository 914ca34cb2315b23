//! Totals of bricks with the volume read as it lies in memory, whatever the order of the voxels.
//!
//! Where the innermost axis is not x, the voxels of a brick lie a row or a plane apart, each in a cache line and a page of its own.
//! So bricks are not summed one by one: rows of voxels, which lie side by side in memory, are added to a row of sums, one
//! for each line along the innermost axis, and a line's sum is taken out where a brick ends.

use mcvr_volume::Voxel;

use crate::nested::Nested;
use crate::order::BRICK;
use crate::units::Units;
use crate::unpack::prefetch;
use crate::word::Word;
use mcvr_volume::{SimdLevel, vectorised};

/// Lines that are summed side by side at most: sums of 16 and of 32 bits stay in the first cache.
const LINES: usize = 8192;

/// Lines whose sums are such words.
fn lines<W>() -> usize {
    if size_of::<W>() == 2 { LINES } else { LINES / 2 }
}

/// Lines below which a row is too short to ask for the next one early.
const FEW: usize = 512;

/// No line.
const NONE: u32 = u32::MAX;

/// Bricks that are summed in one call: about [`LINES`] lines, so that the two that may be cut by its ends are few.
pub(crate) fn bricks_at_once(nested: &Nested) -> usize {
    (LINES * nested.extents()[0]).div_ceil(BRICK).clamp(256, 1 << 20)
}

/// Writes the totals of the bricks from `first` on.
pub(crate) fn totals<T: Voxel, U: Units<T>>(
    level: SimdLevel,
    nested: &Nested,
    first: usize,
    voxels: &[T],
    units: U,
    totals: &mut [u64],
) {
    at_level::<T, U>(level, nested, first, voxels, units, totals, level);
}

vectorised! {
    fn at_level<T: Voxel, U: Units<T>>(
        nested: &Nested, first: usize, voxels: &[T], units: U, totals: &mut [u64], same: SimdLevel,
    ) = totals_body::<T, U>
}

#[inline(always)]
fn totals_body<T: Voxel, U: Units<T>>(
    nested: &Nested,
    first: usize,
    voxels: &[T],
    units: U,
    totals: &mut [u64],
    level: SimdLevel,
) {
    let start = first * BRICK;
    let end = (start + totals.len() * BRICK).min(voxels.len());
    if nested.axes()[0] == 0 {
        for (total, brick) in totals.iter_mut().zip(voxels[start..end].chunks(BRICK)) {
            if U::BYTES {
                *total = sum_of_bytes(brick, units);
                continue;
            }
            let mut sum = U::Word::default();
            for v in brick {
                sum = sum.plus(units.units(*v));
            }
            *total = sum.to_u64();
        }
        return;
    }
    totals.fill(0);
    let ([n0, n1, _], [s0, s1, s2]) = (nested.extents(), nested.strides());
    let origin = |line: usize| line % n1 * s1 + line / n1 * s2;
    // Lines that lie in the range only in part are few; they are added voxel by voxel.
    let (whole, beyond) = (start.div_ceil(n0), end / n0);
    let mut part = |from: usize, to: usize| {
        for position in from..to {
            let unit = units.units(voxels[origin(position / n0) + position % n0 * s0]);
            totals[(position - start) / BRICK] += unit.to_u64();
        }
    };
    if whole > beyond {
        part(start, end);
        return;
    }
    part(start, whole * n0);
    part(beyond * n0, end);
    if U::BYTES {
        add_lines(level, nested, voxels, [start, whole, beyond], totals, Bytes(units));
    } else {
        add_lines(level, nested, voxels, [start, whole, beyond], totals, units);
    }
}

/// Weights of at most 255, summed in 16 bits: the 256 of a brick fit.
#[derive(Clone, Copy)]
struct Bytes<U>(U);

impl<T: Voxel, U: Units<T>> Units<T> for Bytes<U> {
    type Word = u16;
    #[inline(always)]
    fn units(self, stored: T) -> u16 {
        u16::from(self.0.byte(stored))
    }
}

/// Lanes that bytes are added up in, side by side.
const LANES: usize = 32;

/// Sum of a brick's weights of at most 255 each: in 16 bits, which leaves vectors twice as full as 32.
#[inline(always)]
fn sum_of_bytes<T: Voxel, U: Units<T>>(brick: &[T], units: U) -> u64 {
    let mut lanes = [0u16; LANES];
    let (rows, rest) = brick.as_chunks::<LANES>();
    for row in rows {
        for (lane, v) in lanes.iter_mut().zip(row) {
            *lane += u16::from(units.byte(*v));
        }
    }
    let mut sum = 0u32;
    for lane in lanes {
        sum += u32::from(lane);
    }
    for v in rest {
        sum += u32::from(units.byte(*v));
    }
    u64::from(sum)
}

/// Adds the lines from `whole` to `beyond` to the totals of bricks, which begin at the voxel `start` in order.
#[inline(always)]
fn add_lines<T: Voxel, U: Units<T>>(
    level: SimdLevel,
    nested: &Nested,
    voxels: &[T],
    [start, whole, beyond]: [usize; 3],
    totals: &mut [u64],
    units: U,
) {
    let ([n0, n1, _], [s0, s1, s2]) = (nested.extents(), nested.strides());
    let mut sums = Lines::<U::Word>::new(n0);
    let mut line = whole;
    while line < beyond {
        // Lines follow each other in memory up to the end of the middle axis, and beyond it where that is the whole plane.
        let side_by_side = if s2 == n1 * s1 { beyond - line } else { n1 - line % n1 };
        let count = side_by_side.min(beyond - line).min(lines::<U::Word>());
        let rows =
            Rows { first: line % n1 * s1 + line / n1 * s2, stride: s0, lines: count, position: line * n0 - start };
        sums.add::<T, U>(level, voxels, rows, units, totals);
        line += count;
    }
}

vectorised! {
    /// Adds a row of voxels to the sums of their lines.
    fn add_row<T: Voxel, U: Units<T>>(values: &[T], units: U, sums: &mut [U::Word]) = add_row_body::<T, U>
}

#[inline(always)]
fn add_row_body<T: Voxel, U: Units<T>>(values: &[T], units: U, sums: &mut [U::Word]) {
    for (sum, v) in sums.iter_mut().zip(values) {
        *sum = sum.plus(units.units(*v));
    }
}

/// Lines side by side.
#[derive(Clone, Copy)]
struct Rows {
    /// The first voxel of the first line.
    first: usize,
    /// From a row to the next.
    stride: usize,
    lines: usize,
    /// Of the first voxel in the order of voxels, from the first brick on.
    position: usize,
}

/// Sums of lines, and which of them end a brick at which row.
struct Lines<W> {
    sums: Vec<W>,
    /// Per number of rows, the first line that ends a brick after so many; per line, the next one that ends there.
    ends: Vec<u32>,
    next: Vec<u32>,
}

impl<W: Word> Lines<W> {
    fn new(rows: usize) -> Self {
        Self { sums: vec![W::default(); lines::<W>()], ends: vec![NONE; rows + 1], next: vec![NONE; lines::<W>()] }
    }

    #[inline(always)]
    fn add<T: Voxel, U: Units<T, Word = W>>(
        &mut self,
        level: SimdLevel,
        voxels: &[T],
        rows: Rows,
        units: U,
        totals: &mut [u64],
    ) {
        let n0 = self.ends.len() - 1;
        let sums = &mut self.sums[..rows.lines];
        for line in 0..rows.lines {
            let end = (BRICK - (rows.position + line * n0) % BRICK).min(n0);
            self.next[line] = std::mem::replace(&mut self.ends[end], line as u32);
        }
        for row in 0..n0 {
            let values = &voxels[rows.first + row * rows.stride..][..sums.len()];
            if size_of::<W>() <= 4 && rows.lines >= FEW && row + 1 < n0 {
                // It lies in other pages, where the processor does not expect it.
                prefetch(&voxels[rows.first + (row + 1) * rows.stride..][..sums.len()]);
            }
            if size_of::<W>() == 2 {
                add_row_body(values, units, sums);
            } else {
                // Loops with a table want the registers for themselves.
                add_row::<T, U>(level, values, units, sums);
            }
            let mut ending = std::mem::replace(&mut self.ends[row + 1], NONE);
            while ending != NONE {
                let line = ending as usize;
                let sum = std::mem::take(&mut sums[line]);
                totals[(rows.position + line * n0 + row) / BRICK] += sum.to_u64();
                ending = self.next[line];
                if row + 1 < n0 {
                    let end = (row + 1 + BRICK).min(n0);
                    self.next[line] = std::mem::replace(&mut self.ends[end], line as u32);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::order::Layout;
    use crate::units::TableUnits;

    #[test]
    fn totals_are_the_last_running_sums_at_every_level() {
        let table: Vec<u32> = (0..256).map(|i| i * 3 % 200).collect();
        for dims in [[40, 33, 17], [530, 9, 3], [7, 300, 5], [3, 2, 700], [64, 64, 256], [1, 1, 1], [5000, 3, 2]] {
            let voxels: Vec<u8> = (0..dims.iter().product::<usize>()).map(|i| (i * i % 251) as u8).collect();
            for axis in 0..3 {
                let nested = Nested::new(dims, axis).unwrap();
                let mut sums = [0u32; BRICK];
                let expected: Vec<u64> = (0..nested.bricks())
                    .map(|brick| {
                        nested.sums(brick, &voxels, TableUnits(&table[..]), &mut sums);
                        u64::from(sums[BRICK - 1])
                    })
                    .collect();
                for level in SimdLevel::available() {
                    for step in [1, 7, 64, 100_000] {
                        let mut got = vec![u64::MAX; expected.len()];
                        for (i, chunk) in got.chunks_mut(step).enumerate() {
                            totals::<u8, TableUnits<'_, u32>>(
                                level,
                                &nested,
                                i * step,
                                &voxels,
                                TableUnits(&table[..]),
                                chunk,
                            );
                        }
                        assert_eq!(got, expected, "{dims:?}, axis {axis}, {level:?}, {step} at once");
                    }
                }
            }
        }
    }
}
