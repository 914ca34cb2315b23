//! Groups of arguments that several commands share.

use std::path::{Path, PathBuf};

use clap::Args;
use mcvr::Method;
use mcvr::qmc::Scramble;
use mcvr::sampling::VoxelOrder;
use mcvr::scene::film::Curve;
use mcvr::scene::{Emphasis, Estimand, Extent, Hounsfield, Kernel, NegativePolicy, Transfer};
use mcvr::volume::{Endian, VoxelType};

use super::effect_args::{EffectArgs, FilmArgs};
use super::numbers;

/// Attenuation of water per mm at 60 keV: 0.2059 cm²/g at 1 g/cm³ (NIST XCOM tables, total with coherent).
const MU_WATER_60_KEV: f64 = 0.02059;

/// Which volume.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Volume")]
pub struct VolumeArgs {
    /// Volume file (NRRD, MetaImage, NIfTI, raw, raw.gz), phantom:NAME[@SIZE] (see `mcvr info --phantoms`), or a scene
    /// file (.toml) that names one
    #[arg(value_name = "INPUT")]
    pub input: Option<String>,
    /// Raw files: voxels along x, y and z
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::dims)]
    pub dims: Option<[usize; 3]>,
    /// Raw files: voxel type (u8, i8, u16, i16, u32, i32, f32, f64)
    #[arg(long = "type", value_name = "TYPE")]
    pub voxel_type: Option<VoxelType>,
    /// Raw files: byte order (le, be)
    #[arg(long, value_name = "ORDER")]
    pub endian: Option<Endian>,
    /// Raw files: bytes before the first voxel
    #[arg(long, value_name = "BYTES")]
    pub skip: Option<u64>,
    /// Millimetres per voxel along x, y and z; replaces the file's own
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::spacing)]
    pub spacing: Option<[f64; 3]>,
}

impl VolumeArgs {
    /// The input as a file.
    pub fn file(&self) -> Option<&Path> {
        self.input.as_deref().map(Path::new)
    }
}

/// How isovalues become weights.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Density")]
pub struct DensityArgs {
    /// Isovalue to weight: identity, linear:SLOPE,INTERCEPT, piecewise:V,W;V,W;..., hounsfield[:MU_WATER_PER_MM],
    /// hounsfield:KEVkeV[,SCANkeV] (attenuation at a photon energy)
    #[arg(long, value_name = "MAP", value_parser = transfer)]
    pub map: Option<Transfer>,
    /// Isovalues from THRESHOLD on weigh GAIN times as much (the halo dims)
    #[arg(long, value_name = "THRESHOLD,GAIN", value_parser = numbers::pair)]
    pub emphasis: Option<[f64; 2]>,
    /// Negative weights: clamp (to 0, stating the mass) or refuse
    #[arg(long, value_name = "POLICY", value_parser = negative)]
    pub negative: Option<NegativePolicy>,
    /// Move weights up the gradient: thin structures keep their contrast under smooth kernels
    #[arg(long)]
    pub concentrate: bool,
}

impl DensityArgs {
    /// The emphasis as the density map has it.
    pub fn emphasis(&self) -> Option<Emphasis> {
        self.emphasis.map(|[threshold, gain]| Emphasis { threshold, gain })
    }
}

/// From where.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "View")]
pub struct ViewArgs {
    /// Direction from the volume's centre to the eye: azimuth and elevation in degrees [default: 30,20]
    #[arg(long, value_name = "AZ,EL", value_parser = numbers::pair, allow_hyphen_values = true)]
    pub view: Option<[f64; 2]>,
    /// Millimetres from the eye to the volume's centre [default: two diameters]
    #[arg(long, value_name = "MM")]
    pub distance: Option<f64>,
    /// Degrees across the image's shorter side [default: the whole volume]
    #[arg(long, value_name = "DEGREES")]
    pub fov: Option<f64>,
    /// Parallel rays
    #[arg(long)]
    pub parallel: bool,
    /// Smallest depth in mm that counts [default: a thousandth of the diameter]
    #[arg(long, value_name = "MM")]
    pub near: Option<f64>,
    /// Text file with a 3x4 matrix from world mm to homogeneous pixels, instead of the options above
    #[arg(long, value_name = "FILE", conflicts_with_all = ["view", "distance", "fov", "parallel"])]
    pub matrix: Option<PathBuf>,
    /// Image size in pixels [default: 400x400]
    #[arg(long, value_name = "WxH")]
    pub size: Option<Extent>,
}

/// By which method.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Method")]
pub struct MethodArgs {
    /// Reconstruction kernel: box, tent, bspline3, shell [default: tent]
    #[arg(long)]
    pub kernel: Option<Kernel>,
    /// What a pixel means: line (mean line integral) or count (share of samples) [default: line]
    #[arg(long)]
    pub estimand: Option<Estimand>,
    /// Key of all randomness; the same seed gives the same image on any number of threads [default: 1]
    #[arg(long)]
    pub seed: Option<u64>,
    /// Order of the voxels for qmc and stratified: depth, raster, hilbert, y, z [default: depth]
    #[arg(long)]
    pub order: Option<VoxelOrder>,
    /// Randomisation of the net: linear, owen, nested, shift, none [default: linear]
    #[arg(long)]
    pub scramble: Option<Scramble>,
    /// March and comb: distance of the samples in units of the smallest voxel spacing; footprint: side of a voxel's parts,
    /// of which smaller ones err less, down to 0.125 [default: 1]
    #[arg(long, value_name = "VOXELS")]
    pub step: Option<f64>,
    /// March, comb and rays: rays at random places in their pixels, which makes the image unbiased, instead of on a grid
    #[arg(long)]
    pub jitter: bool,
    /// Comb and rays: rays where the image needs them, from one for 4 by 4 pixels to 64 in a pixel, until what is expected to be
    /// left between them is at most this share of the mean pixel, such as 1%; instead of --samples
    #[arg(long, value_name = "ERROR", value_parser = numbers::share)]
    pub adaptive: Option<f64>,
    /// Exact ray casting: error of the pixel-area integral relative to the mean pixel [default: 1e-4]
    #[arg(long, value_name = "REL")]
    pub tolerance: Option<f64>,
    /// Scene file; flags win over it
    #[arg(long, value_name = "FILE.toml")]
    pub scene: Option<PathBuf>,
    /// One of the scene's cameras, by name or number [default: all of them]
    #[arg(long, value_name = "NAME|N")]
    pub camera: Option<String>,
    /// Draw from the whole volume, also where the camera does not look: slower and noisier, but bit for bit the image that
    /// `mcvr project` makes of a cloud
    #[arg(long)]
    pub no_cull: bool,
}

/// One method and its budget.
#[derive(Args, Clone, Debug, Default)]
pub struct BudgetArgs {
    /// qmc, mc, stratified, mc-quicksort, mc-binary, mc-linear, march or exact [default: qmc]
    #[arg(long, short, help_heading = "Method")]
    pub method: Option<Method>,
    /// Samples (for march: rays), such as 1e6 or 2^22 [default: 2^22]
    #[arg(long, short = 'n', value_name = "M", value_parser = numbers::count, help_heading = "Method")]
    pub samples: Option<u64>,
}

/// All that decides an image.
#[derive(Args, Clone, Debug, Default)]
pub struct ImageArgs {
    #[command(flatten)]
    pub volume: VolumeArgs,
    #[command(flatten)]
    pub budget: BudgetArgs,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub view: ViewArgs,
    #[command(flatten)]
    pub density: DensityArgs,
    #[command(flatten)]
    pub effects: EffectArgs,
    #[command(flatten)]
    pub film: FilmArgs,
}

impl ImageArgs {
    /// All files that are read.
    pub fn inputs(&self) -> [Option<&Path>; 3] {
        [self.volume.file(), self.method.scene.as_deref(), self.view.matrix.as_deref()]
    }
}

/// How PNG files are toned; other formats hold linear values.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Tone of PNG files")]
pub struct ToneArgs {
    /// linear, log, or film (dark where dense) [default: linear]
    #[arg(long)]
    pub tone: Option<Curve>,
    /// Exchange black and white
    #[arg(long)]
    pub invert: bool,
    /// Percentiles of the pixels that become black and white [default: 0,99.9]
    #[arg(long, value_name = "LOW,HIGH", value_parser = numbers::percentiles)]
    pub window: Option<[f64; 2]>,
    /// 16 bits per pixel
    #[arg(long)]
    pub deep: bool,
}

fn negative(text: &str) -> Result<NegativePolicy, String> {
    match text {
        "clamp" => Ok(NegativePolicy::Clamp),
        "refuse" => Ok(NegativePolicy::Refuse),
        _ => Err(format!("unknown policy '{text}'; one of clamp, refuse")),
    }
}

fn transfer(text: &str) -> Result<Transfer, String> {
    let (name, rest) = text.split_once(':').map_or((text, None), |(n, r)| (n, Some(r)));
    match (name, rest) {
        ("identity", None) => Ok(Transfer::Identity),
        ("linear", Some(rest)) => numbers::pair(rest).map(|[slope, intercept]| Transfer::Linear { slope, intercept }),
        ("piecewise", Some(rest)) => {
            rest.split(';').map(numbers::pair).collect::<Result<_, _>>().map(Transfer::Piecewise)
        }
        ("hounsfield", rest) => hounsfield(rest).map(Transfer::Hounsfield),
        _ => Err(format!(
            "unknown map '{text}'; one of identity, linear:SLOPE,INTERCEPT, piecewise:V,W;V,W, hounsfield[:MU], \
             hounsfield:KEVkeV[,SCANkeV]"
        )),
    }
}

/// Nothing, an attenuation of water, or a photon energy and perhaps that of the scan.
fn hounsfield(text: Option<&str>) -> Result<Hounsfield, String> {
    let Some(text) = text else { return Hounsfield::of_water(MU_WATER_60_KEV).map_err(|e| e.to_string()) };
    let energy = |text: &str| {
        let number = text.get(..text.len().saturating_sub(3)).filter(|_| text.to_ascii_lowercase().ends_with("kev"));
        number.and_then(|n| n.trim().parse::<f64>().ok())
    };
    let bad = || format!("'{text}' is neither an attenuation per mm (0.0206) nor an energy (60keV, or 60keV,70keV)");
    let made = match text.split_once(',') {
        Some((kev, scan)) => Hounsfield::at_energy(energy(kev).ok_or_else(bad)?, energy(scan).ok_or_else(bad)?),
        None => match energy(text) {
            Some(kev) => Hounsfield::at_energy(kev, Hounsfield::SCAN_KEV),
            None => Hounsfield::of_water(text.parse().map_err(|_| bad())?),
        },
    };
    made.map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_read() {
        assert_eq!(transfer("linear:2,-1"), Ok(Transfer::Linear { slope: 2.0, intercept: -1.0 }));
        assert_eq!(transfer("piecewise:0,0;100,2"), Ok(Transfer::Piecewise(vec![[0.0, 0.0], [100.0, 2.0]])));
        let water = |mu| Ok(Transfer::Hounsfield(Hounsfield::of_water(mu).unwrap()));
        assert_eq!((transfer("hounsfield"), transfer("hounsfield:0.03")), (water(MU_WATER_60_KEV), water(0.03)));
        let energy = |kev, scan| Ok(Transfer::Hounsfield(Hounsfield::at_energy(kev, scan).unwrap()));
        assert_eq!(transfer("hounsfield:60keV"), energy(60.0, Hounsfield::SCAN_KEV));
        assert_eq!(transfer("hounsfield:60kev,65 keV"), energy(60.0, 65.0));
        for bad in
            ["hounsfield:x", "hounsfield:keV", "hounsfield:5keV", "hounsfield:60keV,70", "hounsfield:0", "hounsfield:é"]
        {
            assert!(transfer(bad).is_err(), "{bad}");
        }
        assert!(transfer("linear").is_err() && transfer("cubic:1").is_err());
    }
}
