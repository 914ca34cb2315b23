//! The methods by name.

use mcvr_scene::Kernel;
use serde::{Deserialize, Serialize};

/// A way to make an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Independent samples drawn in rising order, with nothing to sort.
    Mc,
    /// Independent samples, all drawn and sorted first: the report's improvement 1.
    McQuicksort,
    /// Independent samples, a binary search each.
    McBinary,
    /// Independent samples, a linear search each; small budgets only.
    McLinear,
    /// One sample in each of M strata of equal mass.
    Stratified,
    /// The sorted Sobol net.
    #[default]
    Qmc,
    /// Ray march with a fixed step; the budget counts rays.
    March,
    /// A few rays a pixel, each integrated exactly; the budget counts rays.
    Rays,
    /// Rays with samples at wide equal distances, each from a random start of its own; the budget counts rays.
    Comb,
    /// The projected tents of all voxels, added up: no noise, a small bias; the budget plays no part.
    Footprint,
    /// Whichever of the others is expected to reach the error asked for soonest.
    Auto,
    /// Ray casting, exact along each ray, each pixel's area to a tolerance; the budget plays no part.
    Exact,
}

impl Method {
    /// Every method.
    pub const ALL: [Method; 12] = [
        Method::Mc,
        Method::McQuicksort,
        Method::McBinary,
        Method::McLinear,
        Method::Stratified,
        Method::Qmc,
        Method::March,
        Method::Rays,
        Method::Comb,
        Method::Footprint,
        Method::Exact,
        Method::Auto,
    ];

    /// Most samples that a linear search is let loose on.
    pub const LINEAR_LIMIT: u64 = 1 << 14;

    /// Most samples that are sorted in memory: 8 GiB of targets.
    pub const QUICKSORT_LIMIT: u64 = 1 << 30;

    /// Stable name, also on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Method::Mc => "mc",
            Method::McQuicksort => "mc-quicksort",
            Method::McBinary => "mc-binary",
            Method::McLinear => "mc-linear",
            Method::Stratified => "stratified",
            Method::Qmc => "qmc",
            Method::March => "march",
            Method::Rays => "rays",
            Method::Comb => "comb",
            Method::Footprint => "footprint",
            Method::Auto => "auto",
            Method::Exact => "exact",
        }
    }

    /// Name for people.
    pub fn label(self) -> &'static str {
        match self {
            Method::Mc => "Monte Carlo",
            Method::McQuicksort => "Monte Carlo, quicksort",
            Method::McBinary => "Monte Carlo, binary search",
            Method::McLinear => "Monte Carlo, linear search",
            Method::Stratified => "stratified",
            Method::Qmc => "quasi-Monte Carlo (Sobol net)",
            Method::March => "ray march, 1-voxel step",
            Method::Rays => "rays, exact in depth",
            Method::Comb => "comb of samples in depth",
            Method::Footprint => "footprints of all voxels",
            Method::Auto => "chosen by the program",
            Method::Exact => "ray casting, exact",
        }
    }

    /// Slope of the error against the budget that theory expects (METHOD section 4). Stratifying the voxels alone
    /// falls back to -1/2 once M exceeds the number of non-zero voxels; a net reaches -2/3 once its strata are
    /// smaller than a pixel, `M ≫ P^1.5`.
    pub fn expected_slope(self) -> Option<f64> {
        match self {
            Method::Mc | Method::McQuicksort | Method::McBinary | Method::McLinear | Method::Stratified => Some(-0.5),
            Method::Qmc => Some(-2.0 / 3.0),
            Method::March | Method::Rays | Method::Comb | Method::Footprint | Method::Exact | Method::Auto => None,
        }
    }

    /// True for methods that draw samples of the volume.
    pub fn samples_volume(self) -> bool {
        !self.casts_rays() && !matches!(self, Method::Footprint | Method::Auto)
    }

    /// What its work is counted in: samples, rays or footprints.
    pub fn unit(self) -> &'static str {
        match self {
            Method::Footprint => "footprints",
            _ if self.samples_volume() => "samples",
            _ => "rays",
        }
    }

    /// Whether it can make images of a kernel.
    pub fn knows(self, kernel: Kernel) -> bool {
        match self {
            Method::Footprint => kernel == Kernel::Tent,
            _ => self.samples_volume() || kernel != Kernel::Shell,
        }
    }

    /// True for methods that cast rays.
    pub fn casts_rays(self) -> bool {
        matches!(self, Method::March | Method::Rays | Method::Comb | Method::Exact)
    }
}

impl std::str::FromStr for Method {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|m| m.name() == s)
            .ok_or_else(|| format!("unknown method '{s}'; one of {}", Self::ALL.map(Method::name).join(", ")))
    }
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
