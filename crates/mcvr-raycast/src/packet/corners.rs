//! The eight voxels of a cell, for sixteen cells at once: read in their stored type, turned into weights in registers.

use mcvr_volume::Voxel;

use super::lanes::{LANES, Row, Simd};

/// A type whose neighbour along x comes with it in one read of four bytes.
pub(crate) trait Whole: Voxel {
    /// Stored value 0 less the smallest one: from a value to its place in a table.
    const ORIGIN: i32;

    /// The voxels at `index` and after it.
    ///
    /// # Safety
    /// As [`Simd`]; four bytes from `base + index` on must be readable in every lane of the mask.
    unsafe fn pair<S: Simd>(base: *const Self, index: S::I, mask: S::M) -> [S::I; 2];
}

macro_rules! whole {
    ($($t:ty, $origin:literal, |$word:ident| $split:expr;)*) => {$(
        impl Whole for $t {
            const ORIGIN: i32 = $origin;

            #[inline(always)]
            unsafe fn pair<S: Simd>(base: *const $t, index: S::I, mask: S::M) -> [S::I; 2] {
                // SAFETY: the caller's promise is `gather`'s condition.
                unsafe {
                    let $word = S::gather::<{ size_of::<$t>() as i32 }>(base.cast(), index, mask);
                    $split
                }
            }
        }
    )*};
}

whole! {
    u8, 0, |word| [S::iand(word, S::isplat(0xff)), S::iand(S::ishr::<8>(word), S::isplat(0xff))];
    i8, 128, |word| [S::isar::<24>(S::ishl::<24>(word)), S::isar::<24>(S::ishl::<16>(word))];
    u16, 0, |word| [S::iand(word, S::isplat(0xffff)), S::ishr::<16>(word)];
    i16, 32768, |word| [S::isar::<16>(S::ishl::<16>(word)), S::isar::<16>(word)];
}

/// From stored values to weights.
pub(crate) trait Weights<T: Voxel>: Sync {
    /// Voxels from the first of a pair to the end of what reading the pair touches.
    const REACH: usize;

    /// Weights of the voxels at `index` and after it, anything in lanes outside the mask.
    ///
    /// # Safety
    /// As [`Simd`]; [`Weights::REACH`] voxels from `base + index` on must be readable in every lane of the mask.
    unsafe fn pair<S: Simd>(&self, base: *const T, index: S::I, mask: S::M) -> [S::F; 2];

    /// Weight of one voxel; the same bits as [`Weights::pair`] gives.
    fn one(&self, stored: T) -> f32;
}

/// The stored value is the weight, but for a unit.
pub(crate) struct Plain;

impl<T: Whole> Weights<T> for Plain {
    const REACH: usize = 4 / size_of::<T>();

    #[inline(always)]
    unsafe fn pair<S: Simd>(&self, base: *const T, index: S::I, mask: S::M) -> [S::F; 2] {
        // SAFETY: the caller's promise, passed on.
        unsafe {
            let [a, b] = T::pair::<S>(base, index, mask);
            [S::float(a), S::float(b)]
        }
    }

    fn one(&self, stored: T) -> f32 {
        stored.to_f64() as f32
    }
}

/// `max(0, slope * stored + intercept)`.
pub(crate) struct Affine {
    pub slope: f32,
    pub intercept: f32,
}

impl Affine {
    #[inline(always)]
    unsafe fn weigh<S: Simd>(&self, v: S::F) -> S::F {
        // SAFETY: the caller's promise of instructions, passed on.
        unsafe { S::max(S::add(S::mul(v, S::splat(self.slope)), S::splat(self.intercept)), S::splat(0.0)) }
    }

    /// The same of one value.
    pub fn of(&self, stored: f32) -> f32 {
        let w = stored * self.slope + self.intercept;
        if w > 0.0 { w } else { 0.0 }
    }
}

impl<T: Whole> Weights<T> for Affine {
    const REACH: usize = 4 / size_of::<T>();

    #[inline(always)]
    unsafe fn pair<S: Simd>(&self, base: *const T, index: S::I, mask: S::M) -> [S::F; 2] {
        // SAFETY: the caller's promise, passed on.
        unsafe {
            let [a, b] = T::pair::<S>(base, index, mask);
            [self.weigh::<S>(S::float(a)), self.weigh::<S>(S::float(b))]
        }
    }

    fn one(&self, stored: T) -> f32 {
        self.of(stored.to_f64() as f32)
    }
}

impl Weights<f32> for Affine {
    const REACH: usize = 2;

    #[inline(always)]
    unsafe fn pair<S: Simd>(&self, base: *const f32, index: S::I, mask: S::M) -> [S::F; 2] {
        // SAFETY: the caller's promise, passed on.
        unsafe {
            let [a, b] = S::gather_pair(base, index, mask);
            [self.weigh::<S>(a), self.weigh::<S>(b)]
        }
    }

    fn one(&self, stored: f32) -> f32 {
        self.of(stored)
    }
}

impl Weights<f32> for Plain {
    const REACH: usize = 2;

    #[inline(always)]
    unsafe fn pair<S: Simd>(&self, base: *const f32, index: S::I, mask: S::M) -> [S::F; 2] {
        // SAFETY: the caller's promise, passed on.
        unsafe { S::gather_pair(base, index, mask) }
    }

    fn one(&self, stored: f32) -> f32 {
        stored
    }
}

/// A weight for every stored value, smallest value first.
pub(crate) struct Table(pub Vec<f32>);

impl<T: Whole> Weights<T> for Table {
    const REACH: usize = 4 / size_of::<T>();

    #[inline(always)]
    unsafe fn pair<S: Simd>(&self, base: *const T, index: S::I, mask: S::M) -> [S::F; 2] {
        debug_assert!(self.0.len() == 1 << (8 * size_of::<T>()), "a weight for every value");
        // SAFETY: the caller's promise, passed on; every value of the type has its place in the table (checked where tables are made),
        // and lanes outside the mask are not read.
        unsafe {
            let [a, b] = T::pair::<S>(base, index, mask);
            let (a, b) = (S::iadd(a, S::isplat(T::ORIGIN)), S::iadd(b, S::isplat(T::ORIGIN)));
            let table: *const u8 = self.0.as_ptr().cast();
            [S::float_of_bits(S::gather::<4>(table, a, mask)), S::float_of_bits(S::gather::<4>(table, b, mask))]
        }
    }

    fn one(&self, stored: T) -> f32 {
        stored.ordinal().and_then(|i| self.0.get(i)).copied().unwrap_or(0.0)
    }
}

/// Bytes of volumes that stay in the inner caches.
const NEAR: usize = 1 << 19;

/// Voxels with their weights, for packets.
pub(crate) struct Corners<'a, T, W> {
    voxels: &'a [T],
    weights: W,
    /// What a weight of 1 stands for.
    unit: f64,
    dims: [usize; 3],
    /// Voxels from one to the next along an axis.
    strides: [i32; 3],
    /// Largest index of a cell's first voxel from which all its voxels can be read in pairs.
    last: i32,
}

/// Exact counts of reads in the careful way.
#[derive(Clone, Copy, Default)]
pub(crate) struct Border {
    /// Cells that were read the careful way.
    pub cells: u64,
    /// Voxels read in them.
    pub reads: u64,
}

impl<'a, T: Voxel, W: Weights<T>> Corners<'a, T, W> {
    /// `None` where 32-bit indices do not reach, or an axis has no cell between two voxels.
    pub fn new(voxels: &'a [T], weights: W, unit: f64, dims: [usize; 3]) -> Option<Self> {
        let [nx, ny, nz] = dims;
        let len = nx.checked_mul(ny)?.checked_mul(nz)?;
        let whole = dims.iter().all(|n| *n >= 2) && len == voxels.len() && i32::try_from(len).is_ok();
        // From a cell's first voxel to the first of its last row.
        let last = len.checked_sub(nx + nx * ny + W::REACH.max(2))?;
        whole.then_some(Self {
            voxels,
            weights,
            unit,
            dims,
            strides: [1, nx as i32, (nx * ny) as i32],
            last: last as i32,
        })
    }

    /// What a weight of 1 stands for.
    pub fn unit(&self) -> f64 {
        self.unit
    }

    #[inline(always)]
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Index of the first voxel of cell (0, 0, 0), which lies outside the grid.
    #[inline(always)]
    pub fn origin(&self) -> i32 {
        -1 - self.stride(1) - self.stride(2)
    }

    /// Voxels from one to the next along an axis.
    #[inline(always)]
    pub fn stride(&self, axis: usize) -> i32 {
        self.strides[axis]
    }

    /// Weights of the eight voxels of the active lanes' cells, x fastest; anything in the others. `cells` are cell coordinates (the
    /// voxels `cell - 1` and `cell` on each axis; those outside the grid weigh 0), `base` the index of the first voxel.
    ///
    /// # Safety
    /// As [`Simd`].
    #[inline(always)]
    pub unsafe fn read<S: Simd>(&self, cells: [S::I; 3], base: S::I, active: S::M, border: &mut Border) -> [S::F; 8] {
        let [nx, ny, nz] = [self.dims[0] as i32 - 2, self.dims[1] as i32 - 2, self.dims[2] as i32 - 2];
        let (row, plane) = (self.strides[1], self.strides[2]);
        // SAFETY: lanes of `inside` have 1 <= cell <= extent - 1 on each axis, so their eight voxels are voxels of the grid, and
        // `base <= last` leaves `REACH` voxels to read from the first of each pair on. `base` belongs to `cells` (the caller
        // computes both), and is not negative then.
        unsafe {
            let minus = S::isplat(-1);
            let x = S::ule(S::iadd(cells[0], minus), S::isplat(nx));
            let y = S::ule(S::iadd(cells[1], minus), S::isplat(ny));
            let z = S::ule(S::iadd(cells[2], minus), S::isplat(nz));
            let inside = S::both(S::both(S::both(x, y), z), S::both(active, S::ule(base, S::isplat(self.last))));
            let voxels = self.voxels.as_ptr();
            let [a, b] = self.weights.pair::<S>(voxels, base, inside);
            let [c, d] = self.weights.pair::<S>(voxels, S::iadd(base, S::isplat(row)), inside);
            let [e, f] = self.weights.pair::<S>(voxels, S::iadd(base, S::isplat(plane)), inside);
            let [g, h] = self.weights.pair::<S>(voxels, S::iadd(base, S::isplat(plane + row)), inside);
            let corners = [a, b, c, d, e, f, g, h];
            let outside = S::bits(active) & !S::bits(inside);
            if outside == 0 {
                return corners;
            }
            let mut rows = [[0.0; LANES]; 8];
            for (row, corner) in rows.iter_mut().zip(corners) {
                *row = S::store(corner);
            }
            self.mend(&mut rows, [S::istore(cells[0]), S::istore(cells[1]), S::istore(cells[2])], outside, border);
            [
                S::load(&rows[0]),
                S::load(&rows[1]),
                S::load(&rows[2]),
                S::load(&rows[3]),
                S::load(&rows[4]),
                S::load(&rows[5]),
                S::load(&rows[6]),
                S::load(&rows[7]),
            ]
        }
    }

    /// Whether the voxels are too many for the inner caches.
    pub fn far(&self) -> bool {
        size_of_val(self.voxels) > NEAR
    }

    /// Asks for the voxels of cells, wherever they are.
    ///
    /// # Safety
    /// As [`Simd`].
    #[inline(always)]
    pub unsafe fn prefetch<S: Simd>(&self, base: S::I) {
        let (first, row, plane) = (self.voxels.as_ptr(), self.strides[1] as isize, self.strides[2] as isize);
        let at = |offset: isize| first.wrapping_offset(offset);
        // SAFETY: the caller's promise, passed on.
        unsafe { S::prefetch([first, at(row), at(plane), at(plane + row)], base) }
    }

    /// Reads the cells at the border voxel by voxel.
    #[inline(never)]
    fn mend(&self, rows: &mut [Row<f32>; 8], cells: [Row<i32>; 3], lanes: u32, border: &mut Border) {
        let [nx, ny, nz] = self.dims;
        let mut left = lanes;
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            // Negative numbers wrap to huge ones, which lie outside too.
            let x = cells[0][lane].wrapping_sub(1) as usize;
            let y = cells[1][lane].wrapping_sub(1) as usize;
            let z = cells[2][lane].wrapping_sub(1) as usize;
            for (n, row) in rows.iter_mut().enumerate() {
                let (x, y, z) = (x.wrapping_add(n & 1), y.wrapping_add(n >> 1 & 1), z.wrapping_add(n >> 2 & 1));
                row[lane] = if x < nx && y < ny && z < nz {
                    border.reads += 1;
                    self.weights.one(self.voxels[x + nx * (y + ny * z)])
                } else {
                    0.0
                };
            }
        }
        border.cells += u64::from(lanes.count_ones());
    }
}

/// The trilinear value at `f` in [0, 1]³ of cells with the given corners.
///
/// # Safety
/// As [`Simd`].
#[inline(always)]
pub(crate) unsafe fn trilinear<S: Simd>(w: &[S::F; 8], f: [S::F; 3]) -> S::F {
    // SAFETY: the caller's promise of instructions, passed on.
    unsafe {
        let p = mix::<S>(mix::<S>(w[0], w[1], f[0]), mix::<S>(w[2], w[3], f[0]), f[1]);
        let q = mix::<S>(mix::<S>(w[4], w[5], f[0]), mix::<S>(w[6], w[7], f[0]), f[1]);
        mix::<S>(p, q, f[2])
    }
}

/// `a` to `b`.
#[inline(always)]
unsafe fn mix<S: Simd>(a: S::F, b: S::F, x: S::F) -> S::F {
    // SAFETY: the caller's promise of instructions, passed on.
    unsafe { S::add(a, S::mul(x, S::sub(b, a))) }
}
