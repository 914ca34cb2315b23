//! Adding footprints to an image of sums.

use mcvr_volume::vectorised;

use crate::frame::Batch;
use crate::profiles::Row;

/// Added to a number below 2^52 it leaves the number, rounded to a whole one, in the float's last 52 bits.
const MAGIC: f64 = (1u64 << 52) as f64;

/// The whole number nearest to an amount (not negative, below 2^51).
#[inline(always)]
pub(crate) fn whole(amount: f32) -> i64 {
    (f64::from(amount) + MAGIC).to_bits().wrapping_sub(MAGIC.to_bits()) as i64
}

/// Adds a voxel to the image.
#[inline(always)]
fn add<R: Row>(image: &mut [i64], width: usize, rows: &[R], batch: &Batch, n: usize) {
    let (across, down) = (rows[batch.across[n] as usize], rows[batch.down[n] as usize]);
    let (across, down) = (&across.pixels()[..R::SIDE], &down.pixels()[..R::SIDE]);
    let (amount, start) = (batch.amount[n], batch.start[n] as usize);
    assert!(start + (R::SIDE - 1) * width + R::SIDE <= image.len());
    for r in 0..R::SIDE {
        // SAFETY: the last row ends within the image, as just checked, and the others before it.
        let row = unsafe { image.get_unchecked_mut(start + r * width..start + r * width + R::SIDE) };
        let down = amount * down[r];
        for c in 0..R::SIDE {
            row[c] = row[c].wrapping_add(whole(down * across[c]));
        }
    }
}

/// Adds `many` voxels of each batch from its own place on. Neighbours overlap in the image, where adding to pixels just written is
/// slow: batches from places far apart take turns.
#[inline(always)]
fn interleave<R: Row>(image: &mut [i64], width: usize, rows: &[R], batches: &[(&Batch, usize)], many: usize) {
    for n in 0..many {
        for (batch, from) in batches {
            add(image, width, rows, batch, from + n);
        }
    }
}

vectorised! {
    /// Adds voxels of several batches in turns.
    pub(crate) fn interleaved<R: Row>(
        image: &mut [i64], width: usize, rows: &[R], batches: &[(&Batch, usize)], many: usize,
    ) = interleave
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_become_whole_numbers() {
        for v in [0.0f32, 0.4, 0.6, 1.0, 3.5, 1e6, (1u64 << 49) as f32] {
            assert_eq!(whole(v), f64::from(v).round_ties_even() as i64, "{v}");
        }
    }
}
