//! How footprints are made.

use mcvr_scene::{Estimand, Kernel};
use mcvr_volume::{Grid, SimdLevel};

use crate::FootprintError;

/// Into how many parts a voxel falls. A tent is a sum of narrower tents exactly, `2 n - 1` of them along an axis, whose footprints err less,
/// and all of which are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refine {
    /// So many along the shortest side, and along the others as many as make the parts about cubic.
    Cubic(u32),
    /// So many along each axis.
    Each(u32),
}

impl Default for Refine {
    fn default() -> Self {
        Self::Cubic(1)
    }
}

impl Refine {
    /// Parts along the shortest side.
    pub(crate) fn number(self) -> u32 {
        let (Self::Cubic(n) | Self::Each(n)) = self;
        n
    }
}

/// How to add footprints.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FootprintOptions {
    /// How weights are spread: `tent` only.
    pub kernel: Kernel,
    /// What a pixel means (METHOD section 2).
    pub estimand: Estimand,
    /// Parts of a voxel: more err less.
    pub refine: Refine,
    /// Vector instructions; `None` for the best there are. All give the same bits.
    pub level: Option<SimdLevel>,
}

impl FootprintOptions {
    /// Largest `refine`.
    pub const REFINE_LIMIT: u32 = 8;

    /// Most voxels along an axis.
    pub const EXTENT_LIMIT: usize = 1 << 24;

    /// Refuses what cannot be made.
    ///
    /// # Errors
    /// [`FootprintError::Kernel`], [`FootprintError::Refine`] or [`FootprintError::Extent`].
    pub fn check(&self, grid: &Grid) -> Result<(), FootprintError> {
        if self.kernel != Kernel::Tent {
            return Err(FootprintError::Kernel(self.kernel));
        }
        let given = self.refine.number();
        if !(1..=Self::REFINE_LIMIT).contains(&given) {
            return Err(FootprintError::Refine { given, limit: Self::REFINE_LIMIT });
        }
        let dims = grid.dims();
        if dims.iter().any(|&n| n > Self::EXTENT_LIMIT) {
            return Err(FootprintError::Extent { dims, limit: Self::EXTENT_LIMIT });
        }
        Ok(())
    }
}
