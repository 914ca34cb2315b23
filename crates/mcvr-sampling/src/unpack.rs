//! Running sums of a brick, from voxels that lie side by side: those of the volume, or lines that were turned first.
//!
//! Where the innermost axis is not x, the voxels of a brick lie a row or a plane apart. Neighbouring lines share their cache
//! lines, so where samples fall into many bricks, several lines at once are copied so that each lies in one piece.

use mcvr_volume::Voxel;

use crate::nested::Nested;
use crate::order::BRICK;
use crate::units::Units;
use crate::word::Word;
use mcvr_volume::{SimdLevel, vectorised};

/// Entries of a row of running sums that are added up together.
const ROW: usize = 16;
/// Bricks that lie between two samples at most where turning pays: below, turned lines serve several samples.
const SPARSE: usize = 8;

/// Blocks of samples that a thread takes one after the other: the next ones will want the next lines.
const BLOCKS: usize = 4;
/// Bytes between the ends and the beginnings of lines whose lengths are multiples of a brick: without them, lines of 2^n voxels
/// would compete for the same places of the caches.
const GAP: usize = 64;

/// Voxels of lines that follow each other in the order, each in one piece. It is kept from block to block.
#[derive(Default)]
pub(crate) struct Turned {
    /// The lines, whatever type their voxels have.
    store: Vec<u64>,
    /// Where the voxels were copied from: address, number, distance along a line.
    of: [usize; 3],
    first: usize,
    lines: usize,
    /// Bricks that may be wanted, from the first to this one; 0 where none is worth turning.
    bricks: usize,
}

impl Turned {
    /// Bytes that are turned together at most: half of what a core's second cache holds.
    const MOST: usize = 1 << 20;

    /// Lines that begin at a multiple of this begin a cache line in most volumes.
    fn align<T>() -> usize {
        (64 / size_of::<T>()).max(8)
    }

    /// From a line to the next.
    fn pitch<T>(line: usize) -> usize {
        // Then no brick reaches beyond its line.
        if line.is_multiple_of(BRICK) { line + GAP / size_of::<T>() } else { line }
    }

    /// To come: so many samples in bricks up to `first + bricks`, in rising order.
    pub(crate) fn expect(&mut self, samples: usize, first: usize, bricks: usize) {
        let wanted = bricks / SPARSE < samples && samples > 1;
        self.bricks = if wanted { first + bricks } else { 0 };
    }

    /// To come: single bricks, for which nothing is turned.
    pub(crate) fn off(&mut self) {
        self.bricks = 0;
    }

    /// The voxels of a brick, in order, where they can be had so.
    #[inline]
    pub(crate) fn brick<T: Voxel>(&mut self, nested: &Nested, brick: usize, voxels: &[T]) -> Option<&[T]> {
        let ([n0, n1, n2], [s0, s1, s2]) = (nested.extents(), nested.strides());
        if brick >= self.bricks || s1 != 1 {
            return None;
        }
        let from = brick * BRICK;
        let count = BRICK.min(voxels.len() - from);
        let (line, at) = (from / n0, from % n0);
        let end = line + (at + count).div_ceil(n0);
        let of = [voxels.as_ptr() as usize, voxels.len(), s0];
        if line < self.first || end > self.first + self.lines || of != self.of {
            // As many lines as will be wanted and can be held, but no more than lie side by side.
            let align = Self::align::<T>();
            let first = line / align * align;
            let side_by_side = if s2 == n1 * s1 { n1 * n2 - first } else { n1 - first % n1 };
            let wanted = (self.bricks * BRICK).min(voxels.len()).div_ceil(n0) - line;
            let wanted = (line - first + BLOCKS * wanted).next_multiple_of(align);
            let held = Self::MOST / size_of::<T>() / Self::pitch::<T>(n0) / align * align;
            let lines = wanted.min(held).min(side_by_side);
            // A brick that leaves the plane is read voxel by voxel.
            if end > first + lines {
                return None;
            }
            (self.of, self.first, self.lines) = (of, first, lines);
            self.turn(nested, voxels);
        }
        let start = (line - self.first) * Self::pitch::<T>(n0) + at;
        bytemuck::cast_slice(&self.store).get(start..start + count)
    }

    /// Copies the lines.
    fn turn<T: Voxel>(&mut self, nested: &Nested, voxels: &[T]) {
        let ([n0, n1, _], [s0, s1, s2]) = (nested.extents(), nested.strides());
        let (lines, pitch) = (self.lines, Self::pitch::<T>(n0));
        let origin = self.first % n1 * s1 + self.first / n1 * s2;
        let words = (lines * pitch * size_of::<T>()).div_ceil(size_of::<u64>());
        self.store.resize(words.max(self.store.len()), 0);
        let out: &mut [T] = bytemuck::cast_slice_mut(&mut self.store);
        let side = square_side::<T>();
        let (whole_rows, whole_lines) = (n0 / side * side, lines / side * side);
        for row in (0..whole_rows).step_by(side) {
            // Each row lies in a page of its own, where the processor does not expect the next one.
            for next in row + side..(row + 2 * side).min(n0) {
                prefetch(&voxels[origin + next * s0..][..lines]);
            }
            for line in (0..whole_lines).step_by(side) {
                square(&voxels[origin + row * s0 + line..], s0, &mut out[line * pitch + row..], pitch);
            }
        }
        // What squares leave over.
        for line in 0..lines {
            for row in if line < whole_lines { whole_rows } else { 0 }..n0 {
                out[line * pitch + row] = voxels[origin + row * s0 + line];
            }
        }
    }
}

/// Side of the squares that [`square`] turns.
fn square_side<T>() -> usize {
    if size_of::<T>() == 1 { 16 } else { 8 }
}

/// Rows `pitch_in` apart for columns `pitch_out` apart, in a square.
#[inline(always)]
fn square<T: Voxel>(rows: &[T], pitch_in: usize, columns: &mut [T], pitch_out: usize) {
    #[cfg(target_arch = "x86_64")]
    if size_of::<T>() <= 2 {
        let (rows, columns) = (bytemuck::cast_slice(rows), bytemuck::cast_slice_mut(columns));
        // SAFETY: every x86-64 processor has SSE2.
        unsafe {
            if size_of::<T>() == 1 {
                sse::bytes(rows, pitch_in, columns, pitch_out);
            } else {
                sse::words(rows, 2 * pitch_in, columns, 2 * pitch_out);
            }
        }
        return;
    }
    let side = square_side::<T>();
    for i in 0..side {
        for j in 0..side {
            columns[i * pitch_out + j] = rows[j * pitch_in + i];
        }
    }
}

/// Squares of bytes and of words in registers: in each step row `i` of the upper half is interleaved with row `i` of the lower;
/// after as many steps as a row number has bits, rows are columns.
#[cfg(target_arch = "x86_64")]
mod sse {
    use std::arch::x86_64::*;

    macro_rules! square {
        ($name:ident, $side:literal, $low:ident, $high:ident) => {
            /// All pitches in bytes.
            #[target_feature(enable = "sse2")]
            pub(super) fn $name(rows: &[u8], pitch_in: usize, columns: &mut [u8], pitch_out: usize) {
                let mut square = [_mm_setzero_si128(); $side];
                for (i, row) in square.iter_mut().enumerate() {
                    *row = bytemuck::pod_read_unaligned(&rows[i * pitch_in..][..16]);
                }
                let mut step = 1;
                while step < $side {
                    let mut next = [_mm_setzero_si128(); $side];
                    for i in 0..$side / 2 {
                        next[2 * i] = $low(square[i], square[i + $side / 2]);
                        next[2 * i + 1] = $high(square[i], square[i + $side / 2]);
                    }
                    square = next;
                    step *= 2;
                }
                for (i, column) in square.iter().enumerate() {
                    columns[i * pitch_out..][..16].copy_from_slice(bytemuck::bytes_of(column));
                }
            }
        };
    }

    square!(bytes, 16, _mm_unpacklo_epi8, _mm_unpackhi_epi8);
    square!(words, 8, _mm_unpacklo_epi16, _mm_unpackhi_epi16);
}

/// Writes the inclusive running sums of up to 256 voxels; the rest of the sums is the total.
#[inline]
pub(crate) fn running<T: Voxel, U: Units<T>>(level: SimdLevel, voxels: &[T], units: U, sums: &mut [U::Word; BRICK]) {
    weigh::<T, U>(level, voxels, units, sums);
    #[cfg(target_arch = "x86_64")]
    if level == SimdLevel::Avx512
        && let Some(sums) = (sums as &mut dyn std::any::Any).downcast_mut::<[u32; BRICK]>()
    {
        // SAFETY: the level is only ever chosen on processors with AVX-512 F, BW, DQ and VL.
        unsafe { add_up_avx512(sums) };
        return;
    }
    add_up::<U::Word>(level, sums);
}

vectorised! {
    fn weigh<T: Voxel, U: Units<T>>(voxels: &[T], units: U, weights: &mut [U::Word; BRICK]) = weigh_body::<T, U>
}

#[inline(always)]
fn weigh_body<T: Voxel, U: Units<T>>(voxels: &[T], units: U, weights: &mut [U::Word; BRICK]) {
    if let Some(voxels) = voxels.first_chunk::<BRICK>() {
        for (weight, v) in weights.iter_mut().zip(voxels) {
            *weight = units.units(*v);
        }
    } else {
        let (used, rest) = weights.split_at_mut(voxels.len());
        for (weight, v) in used.iter_mut().zip(voxels) {
            *weight = units.units(*v);
        }
        rest.fill(U::Word::default());
    }
}

vectorised! {
    fn add_up<W: Word>(sums: &mut [W; BRICK]) = add_up_body::<W>
}

#[inline(always)]
fn add_up_body<W: Word>(sums: &mut [W; BRICK]) {
    // Within rows by steps that double, which run side by side; then each row takes the total of those before it.
    let mut before = W::default();
    for row in sums.as_chunks_mut::<ROW>().0 {
        scan::<W, 1>(row);
        scan::<W, 2>(row);
        scan::<W, 4>(row);
        scan::<W, 8>(row);
        let own = row[ROW - 1];
        for sum in row.iter_mut() {
            *sum = sum.plus(before);
        }
        before = before.plus(own);
    }
}

/// [`add_up_body`] with a row a register; what waits from row to row is one addition.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
fn add_up_avx512(sums: &mut [u32; BRICK]) {
    use std::arch::x86_64::*;
    let none = _mm512_setzero_si512();
    let last = _mm512_set1_epi32(ROW as i32 - 1);
    let mut before = none;
    for row in sums.as_chunks_mut::<ROW>().0 {
        // SAFETY: 16 words of 32 bits are read from an array of 16.
        let mut v = unsafe { _mm512_loadu_si512(row.as_ptr().cast()) };
        v = _mm512_add_epi32(v, _mm512_alignr_epi32::<15>(v, none));
        v = _mm512_add_epi32(v, _mm512_alignr_epi32::<14>(v, none));
        v = _mm512_add_epi32(v, _mm512_alignr_epi32::<12>(v, none));
        v = _mm512_add_epi32(v, _mm512_alignr_epi32::<8>(v, none));
        // SAFETY: 16 words of 32 bits are written to an array of 16.
        unsafe { _mm512_storeu_si512(row.as_mut_ptr().cast(), _mm512_add_epi32(v, before)) };
        before = _mm512_add_epi32(before, _mm512_permutexvar_epi32(last, v));
    }
}

/// Adds to each entry the one so many places before it.
#[inline(always)]
fn scan<W: Word, const STEP: usize>(row: &mut [W; ROW]) {
    let mut moved = [W::default(); ROW];
    moved[STEP..].copy_from_slice(&row[..ROW - STEP]);
    for (sum, moved) in row.iter_mut().zip(moved) {
        *sum = sum.plus(moved);
    }
}

/// Asks for voxels that will be read soon.
#[inline(always)]
pub(crate) fn prefetch<T>(voxels: &[T]) {
    #[cfg(target_arch = "x86_64")]
    for line in voxels.chunks((64 / size_of::<T>()).max(1)) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint about memory that the slice owns; it reads and writes nothing.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = voxels;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::order::Layout;
    use crate::units::TableUnits;

    fn agree<T: Voxel>(dims: [usize; 3], value: impl Fn(usize) -> T) {
        let n: usize = dims.iter().product();
        let voxels: Vec<T> = (0..n).map(value).collect();
        let table: Vec<u32> = (0..65536).map(|i| i * 3 % 200).collect();
        let units = TableUnits(&table[..]);
        for axis in 0..3 {
            let nested = Nested::new(dims, axis).unwrap();
            let mut turned = Turned::default();
            turned.expect(usize::MAX, 0, nested.bricks());
            let mut used = 0;
            for brick in 0..nested.bricks() {
                let (mut expected, mut got) = ([0u32; BRICK], [9u32; BRICK]);
                let read = nested.sums(brick, &voxels, units, &mut expected);
                if let Some(lines) = turned.brick(&nested, brick, &voxels) {
                    assert_eq!(lines.len(), read);
                    used += 1;
                    for level in SimdLevel::available() {
                        running::<T, TableUnits<'_, u32>>(level, lines, units, &mut got);
                        assert_eq!(got, expected, "{dims:?} axis {axis} brick {brick} {level:?}");
                    }
                }
                assert_eq!(nested.unpack(brick, &voxels, units, &mut turned, &mut got), read);
                assert_eq!(got, expected, "{dims:?} axis {axis} brick {brick}");
            }
            let [nx, ny, _] = dims;
            let side_by_side = [0, nx * ny, n][axis];
            assert!(used > 0 || side_by_side < 3 * BRICK, "{dims:?} axis {axis}");
            assert!(used == 0 || axis > 0);
        }
    }

    #[test]
    fn turned_lines_have_the_running_sums_of_the_order() {
        for dims in [[70, 33, 17], [530, 9, 3], [7, 300, 5], [130, 3, 256], [200, 70, 5], [9, 9, 300], [20, 5, 2]] {
            agree(dims, |i| (i * i % 251) as u8);
            agree(dims, |i| (i * i % 251) as i8);
            agree(dims, |i| (i * i % 9973) as u16);
            agree(dims, |i| (i * i % 9973) as i16 - 99);
        }
    }
}
