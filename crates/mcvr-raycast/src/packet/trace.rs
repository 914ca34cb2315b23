//! Sixteen rays at a time along their pieces: at equal distances, or exactly from cell to cell.

use mcvr_volume::Voxel;

use super::beam::Beam;
use super::corners::{Border, Corners, Weights, trilinear};
use super::lanes::{LANES, Row, Simd};

/// Samples from one to the one whose memory is asked for: gathers wait for theirs, and few of them wait side by side. Measured at 2 to 20;
/// from 4 on within 3 % of the best.
const AHEAD: i32 = 6;

/// Voxels to those whose memory is asked for where cells are integrated.
const LEAD: i32 = 4;

/// Exact counts of the work of packets.
#[derive(Clone, Copy, Default)]
pub(crate) struct Work {
    /// Points at which the field was evaluated.
    pub evaluations: u64,
    /// Cells integrated exactly.
    pub cells: u64,
    /// Cells whose eight voxels were fetched.
    pub fetches: u64,
    pub border: Border,
}

/// Adds `Σ ρ(t) dt` (or `Σ ρ(t) t² dt`) over the piece `[near, far)` of each lane's ray, at its own phase and distance, and then the same
/// with every other sample taken away instead of added: by so much either half of the samples, alone and with twice the weight, differs
/// from the whole.
///
/// # Safety
/// As [`Simd`].
#[inline(always)]
pub(crate) unsafe fn comb<S: Simd, T: Voxel, W: Weights<T>>(
    field: &Corners<'_, T, W>,
    (beam, squared): (&Beam, bool),
    [near, far]: [f64; 2],
    sums: &mut [Row<f64>; 2],
    work: &mut Work,
) {
    let mut u = [[0f32; LANES]; 3];
    let mut d = [[0f32; LANES]; 3];
    let mut depth = [0f32; LANES];
    let mut rise = [0f32; LANES];
    let mut sign = [0f64; LANES];
    let mut steps = [0i32; LANES];
    for l in 0..LANES {
        let a = if near > beam.from[l] { near } else { beam.from[l] };
        let b = if far < beam.to[l] { far } else { beam.to[l] };
        let first = (a * beam.teeth[l] - beam.phase[l]).ceil();
        let end = (b * beam.teeth[l] - beam.phase[l]).ceil();
        let some = a < b && first < end;
        // A ray that meets nothing has infinite ends.
        let t = if some { (first + beam.phase[l]) * beam.distance[l] } else { 0.0 };
        steps[l] = if some { (end - first) as i32 } else { 0 };
        // The same samples are added whatever the pieces.
        let half = 0.5 * first;
        sign[l] = if half == half.floor() { 1.0 } else { -1.0 };
        for axis in 0..3 {
            u[axis][l] = (beam.origin[axis][l] + t * beam.direction[axis][l]) as f32;
            d[axis][l] = (beam.direction[axis][l] * beam.distance[l]) as f32;
        }
        if squared {
            depth[l] = (t * beam.nearness) as f32;
            rise[l] = (beam.distance[l] * beam.nearness) as f32;
        }
    }
    let mut most = 0;
    for &n in &steps {
        work.evaluations += n as u64;
        most = if n > most { n } else { most };
    }
    work.fetches = work.evaluations;
    // SAFETY: the caller's promise of instructions, passed on; addresses are `Corners::read`'s care.
    unsafe {
        let (u, d) =
            ([S::load(&u[0]), S::load(&u[1]), S::load(&u[2])], [S::load(&d[0]), S::load(&d[1]), S::load(&d[2])]);
        let (depth, rise, steps) = (S::load(&depth), S::load(&rise), S::iload(&steps));
        let strides = [S::isplat(field.stride(0)), S::isplat(field.stride(1)), S::isplat(field.stride(2))];
        let origin = S::isplat(field.origin());
        let mut sum = S::splat(0.0);
        let mut turns = S::splat(0.0);
        let mut turn = S::splat(1.0);
        let ahead = if field.far() { AHEAD } else { 0 };
        for step in -ahead..most {
            if ahead > 0 {
                let n = S::splat((step + ahead) as f32);
                let p = [S::add(u[0], S::mul(n, d[0])), S::add(u[1], S::mul(n, d[1])), S::add(u[2], S::mul(n, d[2]))];
                let c = [S::truncate(p[0]), S::truncate(p[1]), S::truncate(p[2])];
                let y = S::imul(c[1], strides[1]);
                let base = S::iadd(S::iadd(c[0], origin), S::iadd(y, S::imul(c[2], strides[2])));
                field.prefetch::<S>(S::ikeep(S::igt(steps, S::isplat(step + ahead)), base));
                if step < 0 {
                    continue;
                }
            }
            let active = S::igt(steps, S::isplat(step));
            let n = S::splat(step as f32);
            let p = [S::add(u[0], S::mul(n, d[0])), S::add(u[1], S::mul(n, d[1])), S::add(u[2], S::mul(n, d[2]))];
            let c = [S::truncate(p[0]), S::truncate(p[1]), S::truncate(p[2])];
            let f = [S::sub(p[0], S::float(c[0])), S::sub(p[1], S::float(c[1])), S::sub(p[2], S::float(c[2]))];
            let base = S::iadd(S::iadd(c[0], origin), S::iadd(S::imul(c[1], strides[1]), S::imul(c[2], strides[2])));
            let w = field.read::<S>(c, base, active, &mut work.border);
            let mut rho = trilinear::<S>(&w, f);
            if squared {
                let t = S::add(depth, S::mul(n, rise));
                rho = S::mul(rho, S::mul(t, t));
            }
            let rho = S::keep(active, rho);
            sum = S::add(sum, rho);
            turns = S::add(turns, S::mul(turn, rho));
            turn = S::sub(S::splat(0.0), turn);
        }
        let (sum, turns) = (S::store(sum), S::store(turns));
        for l in 0..LANES {
            sums[0][l] += f64::from(sum[l]) * beam.distance[l];
            sums[1][l] += f64::from(turns[l]) * (sign[l] * beam.distance[l]);
        }
    }
}

/// Pieces of rays in cells: `u + t d` from the cells' corners `c`, and their depths over the farthest.
#[derive(Clone, Copy)]
struct Line<S: Simd> {
    u: [S::F; 3],
    d: [S::F; 3],
    c: [S::F; 3],
    /// Depth at `t = 0` and its rise, where the estimand weighs with its square.
    depth: Option<[S::F; 2]>,
}

impl<S: Simd> Line<S> {
    /// `ρ`, or `ρ` times the depth's square, of cells with the given corners.
    ///
    /// # Safety
    /// As [`Simd`].
    #[inline(always)]
    unsafe fn at(&self, w: &[S::F; 8], t: S::F) -> S::F {
        let Self { u, d, c, depth } = *self;
        // SAFETY: the caller's promise of instructions, passed on.
        unsafe {
            let x = S::sub(S::add(u[0], S::mul(t, d[0])), c[0]);
            let y = S::sub(S::add(u[1], S::mul(t, d[1])), c[1]);
            let z = S::sub(S::add(u[2], S::mul(t, d[2])), c[2]);
            let rho = trilinear::<S>(w, [x, y, z]);
            let Some([depth, rise]) = depth else { return rho };
            let z = S::add(depth, S::mul(t, rise));
            S::mul(rho, S::mul(z, z))
        }
    }
}

// Gauss-Legendre on [-1, 1], as in `cell`: exact for the cubic of a trilinear cell, and for it times t².
const GAUSS_2: f32 = 0.577_350_26;
const GAUSS_3: f32 = 0.774_596_7;
const GAUSS_3_SIDE: f32 = 5.0 / 9.0;
const GAUSS_3_CENTRE: f32 = 8.0 / 9.0;

/// Adds `∫ ρ dt` (or `∫ ρ t² dt`) over the piece `[near, far)` of each lane's ray, cell by cell (Amanatides and Woo 1987).
///
/// # Safety
/// As [`Simd`].
#[inline(always)]
pub(crate) unsafe fn cells<S: Simd, T: Voxel, W: Weights<T>>(
    field: &Corners<'_, T, W>,
    (beam, squared): (&Beam, bool),
    [near, far]: [f64; 2],
    sums: &mut Row<f64>,
    work: &mut Work,
) {
    let dims = field.dims();
    let mut u = [[0f32; LANES]; 3];
    let mut d = [[0f32; LANES]; 3];
    let mut inverse = [[0f32; LANES]; 3];
    // Plane after the cell's own number: 0 or 1, or infinity for a ray along the planes.
    let mut ahead = [[0f32; LANES]; 3];
    let mut way = [[0i32; LANES]; 3];
    let mut cell = [[0i32; LANES]; 3];
    let mut end = [0f32; LANES];
    let mut depth = [0f32; LANES];
    for l in 0..LANES {
        let a = if near > beam.from[l] { near } else { beam.from[l] };
        let b = if far < beam.to[l] { far } else { beam.to[l] };
        let some = a < b;
        let t = if some { a } else { 0.0 };
        end[l] = if some { (b - a) as f32 } else { 0.0 };
        depth[l] = (t * beam.nearness) as f32;
        for axis in 0..3 {
            let p = (beam.origin[axis][l] + t * beam.direction[axis][l]) as f32;
            let direction = beam.direction[axis][l] as f32;
            let slow = 1.0 / direction;
            let meets = slow.abs() < 1e30;
            u[axis][l] = p;
            d[axis][l] = direction;
            inverse[axis][l] = if meets { slow } else { 1.0 };
            ahead[axis][l] = if !meets {
                f32::INFINITY
            } else if direction > 0.0 {
                1.0
            } else {
                0.0
            };
            way[axis][l] = if !meets {
                0
            } else if direction > 0.0 {
                1
            } else {
                -1
            };
            let whole = p as i32;
            cell[axis][l] = if whole > dims[axis] as i32 { dims[axis] as i32 } else { whole };
        }
    }
    debug_assert!(dims.iter().sum::<usize>() < i32::MAX as usize - 6, "indices of voxels fit");
    // SAFETY: the caller's promise of instructions, passed on; addresses are `Corners::read`'s care.
    unsafe {
        let u = [S::load(&u[0]), S::load(&u[1]), S::load(&u[2])];
        let d = [S::load(&d[0]), S::load(&d[1]), S::load(&d[2])];
        let inverse = [S::load(&inverse[0]), S::load(&inverse[1]), S::load(&inverse[2])];
        let ahead = [S::load(&ahead[0]), S::load(&ahead[1]), S::load(&ahead[2])];
        let way = [S::iload(&way[0]), S::iload(&way[1]), S::iload(&way[2])];
        let mut cell = [S::iload(&cell[0]), S::iload(&cell[1]), S::iload(&cell[2])];
        let strides = [S::isplat(field.stride(0)), S::isplat(field.stride(1)), S::isplat(field.stride(2))];
        let jump = [S::imul(way[0], strides[0]), S::imul(way[1], strides[1]), S::imul(way[2], strides[2])];
        let mut base = S::iadd(S::imul(cell[1], strides[1]), S::imul(cell[2], strides[2]));
        base = S::iadd(S::iadd(base, cell[0]), S::isplat(field.origin()));
        let (end, depth, rise) = (S::load(&end), S::load(&depth), S::splat(beam.nearness as f32));
        let half = S::splat(0.5);
        let mut t = S::splat(0.0);
        let mut sum = S::splat(0.0);
        let lead = if field.far() { LEAD } else { 0 };
        // From a voxel to the next along the axis that the ray follows most.
        let negative =
            [S::sub(S::splat(0.0), inverse[0]), S::sub(S::splat(0.0), inverse[1]), S::sub(S::splat(0.0), inverse[2])];
        let sizes = [S::max(inverse[0], negative[0]), S::max(inverse[1], negative[1]), S::max(inverse[2], negative[2])];
        let voxel = S::min(S::min(sizes[0], sizes[1]), sizes[2]);
        // A straight line meets at most this many cells; the bound also ends walks on which rounding keeps `t` from advancing.
        for n in -lead..dims.iter().sum::<usize>() as i32 + 6 {
            if lead > 0 {
                let t = S::add(t, S::mul(S::splat((if n < 0 { n + lead } else { lead }) as f32), voxel));
                let p = [S::add(u[0], S::mul(t, d[0])), S::add(u[1], S::mul(t, d[1])), S::add(u[2], S::mul(t, d[2]))];
                let c = [S::truncate(p[0]), S::truncate(p[1]), S::truncate(p[2])];
                let rows = S::iadd(S::imul(c[1], strides[1]), S::imul(c[2], strides[2]));
                let base = S::iadd(S::iadd(rows, c[0]), S::isplat(field.origin()));
                field.prefetch::<S>(S::ikeep(S::lt(t, end), base));
                if n < 0 {
                    continue;
                }
            }
            let left = S::lt(t, end);
            if S::bits(left) == 0 {
                break;
            }
            let c = [S::float(cell[0]), S::float(cell[1]), S::float(cell[2])];
            let mut next = [end; 3];
            for axis in 0..3 {
                next[axis] = S::mul(S::sub(S::add(c[axis], ahead[axis]), u[axis]), inverse[axis]);
            }
            let leave = S::min(S::min(next[0], next[1]), S::min(next[2], end));
            let active = S::both(left, S::lt(t, leave));
            let lanes = S::bits(active).count_ones();
            if lanes > 0 {
                work.cells += u64::from(lanes);
                let w = field.read::<S>(cell, base, active, &mut work.border);
                let (m, h) = (S::mul(half, S::add(leave, t)), S::mul(half, S::sub(leave, t)));
                let line = Line::<S> { u, d, c, depth: squared.then_some([depth, rise]) };
                let value = if squared {
                    let x = S::mul(h, S::splat(GAUSS_3));
                    let before = line.at(&w, S::sub(m, x));
                    let after = line.at(&w, S::add(m, x));
                    let centre = S::mul(S::splat(GAUSS_3_CENTRE), line.at(&w, m));
                    S::add(centre, S::mul(S::splat(GAUSS_3_SIDE), S::add(before, after)))
                } else {
                    let x = S::mul(h, S::splat(GAUSS_2));
                    S::add(line.at(&w, S::sub(m, x)), line.at(&w, S::add(m, x)))
                };
                sum = S::add(sum, S::keep(active, S::mul(h, value)));
            }
            // Rounding never takes a ray back.
            t = S::max(t, leave);
            for axis in 0..3 {
                let hit = S::both(left, S::le(next[axis], leave));
                cell[axis] = S::iadd(cell[axis], S::ikeep(hit, way[axis]));
                base = S::iadd(base, S::ikeep(hit, jump[axis]));
            }
        }
        let sum = S::store(sum);
        for l in 0..LANES {
            sums[l] += f64::from(sum[l]);
        }
    }
}
