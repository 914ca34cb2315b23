//! The sections of a scene file.

use mcvr_qmc::Scramble;
use mcvr_refine::PixelGoal;
use mcvr_sampling::VoxelOrder;
use mcvr_scene::{Estimand, Kernel};
use mcvr_volume::{Endian, VoxelType};
use schemars::JsonSchema;
use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserializer, Error, MapAccess, SeqAccess, Visitor};

use super::schema;
use crate::Method;

/// Which scan.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VolumeSection {
    /// File (relative to the scene file) or `phantom:NAME@SIZE`.
    pub input: Option<String>,
    /// Raw files: voxels along x, y, z.
    pub dims: Option<[usize; 3]>,
    /// Raw files: voxel type.
    #[serde(rename = "type")]
    #[schemars(schema_with = "schema::voxel_types")]
    pub voxel_type: Option<VoxelType>,
    /// Raw files: byte order.
    #[schemars(schema_with = "schema::endians")]
    pub endian: Option<Endian>,
    /// Raw files: bytes before the first voxel.
    pub skip: Option<u64>,
    /// Millimetres per voxel; replaces the file's own.
    pub spacing: Option<[f64; 3]>,
}

/// A view: `[camera]`, or one of several `[[camera]]`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSection {
    /// What its image is called where there are several cameras: letters, digits, - and _; a number when absent.
    #[schemars(regex(pattern = r"^[A-Za-z0-9_-]{1,64}$"))]
    pub name: Option<String>,
    /// Azimuth and elevation in degrees.
    pub view: Option<[f64; 2]>,
    /// Millimetres from the eye to the volume's centre.
    pub distance: Option<f64>,
    /// Full angle in degrees across the shorter side.
    pub fov: Option<f64>,
    /// Parallel rays.
    pub parallel: Option<bool>,
    /// Near plane in mm.
    pub near: Option<f64>,
    /// World millimetres to homogeneous pixels, by rows; instead of view, distance, fov and parallel.
    pub matrix: Option<[[f64; 4]; 3]>,
}

impl CameraSection {
    /// Its name, or its number counted from 1, given its index.
    pub fn label(&self, index: usize) -> String {
        self.name.clone().unwrap_or_else(|| (index + 1).to_string())
    }
}

/// Which image.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ImageSection {
    /// Columns and rows.
    pub size: Option<[usize; 2]>,
    /// Reconstruction kernel.
    pub kernel: Option<Kernel>,
    /// What a pixel means.
    pub estimand: Option<Estimand>,
}

/// By which method and budget.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SamplingSection {
    /// Method by name.
    #[schemars(schema_with = "schema::methods")]
    pub method: Option<Method>,
    /// Samples (rays for a march).
    pub samples: Option<u64>,
    /// Key of all randomness.
    pub seed: Option<u64>,
    /// Order of the voxels.
    #[serde(deserialize_with = "order")]
    #[schemars(schema_with = "schema::orders")]
    pub order: Option<VoxelOrder>,
    /// Randomisation of the net.
    #[schemars(schema_with = "schema::scrambles")]
    pub scramble: Option<Scramble>,
    /// Whether parts of the volume that the camera cannot see are left out (the default); false for the very points of a
    /// cloud.
    pub cull: Option<bool>,
    /// Step of a march in voxels.
    pub step: Option<f64>,
    /// March, comb and rays: rays at random places in their pixels, which makes the image unbiased.
    pub jitter: Option<bool>,
    /// Comb and rays: rays where the image needs them, until at most this share of the mean pixel is expected to be left between
    /// them, such as 0.01.
    pub adaptive: Option<f64>,
    /// Tolerance of exact ray casting.
    pub tolerance: Option<f64>,
}

/// Which error is enough: samples are drawn until it is reached. Any key asks for error bars.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ErrorSection {
    /// RMSE of the image over its mean pixel, such as 0.02.
    pub rmse: Option<f64>,
    /// Error that most pixels keep.
    pub pixel: Option<PixelSection>,
    /// Probability with which the error is met, and that of the pixels' intervals.
    pub confidence: Option<f64>,
    /// Seconds after which no further pass begins.
    pub time: Option<f64>,
    /// Independent replicates that the error is measured from: 8, 16, 32 or 64.
    pub replicates: Option<u32>,
}

/// Error that most pixels keep.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PixelSection {
    /// Largest error over the mean pixel of the image.
    pub error: f64,
    /// Share of the pixels that keep it; 0.95 when absent.
    pub share: Option<f64>,
}

impl PixelSection {
    /// As the stopping rule has it.
    pub fn goal(&self) -> PixelGoal {
        PixelGoal { error: self.error, share: self.share.unwrap_or(0.95) }
    }
}

/// The names of a voxel order: those of the command line, and those that records have.
pub(super) fn order_names() -> impl Iterator<Item = (String, VoxelOrder)> {
    let recorded = |o: VoxelOrder| serde_json::to_value(o).ok().and_then(|v| v.as_str().map(str::to_owned));
    let short = VoxelOrder::ALL.into_iter().map(|(name, order)| (name.to_owned(), order));
    let long = VoxelOrder::ALL.into_iter().filter_map(move |(name, order)| Some((recorded(order)?, name, order)));
    short.chain(long.filter(|(long, name, _)| long != name).map(|(long, _, order)| (long, order)))
}

/// Reads an order by any of its names.
fn order<'de, D: Deserializer<'de>>(source: D) -> Result<Option<VoxelOrder>, D::Error> {
    let given = String::deserialize(source)?;
    match order_names().find(|(name, _)| *name == given) {
        Some((_, order)) => Ok(Some(order)),
        None => Err(D::Error::unknown_variant(&given, &["raster", "hilbert", "y", "z", "depth"])),
    }
}

/// Reads `[camera]` or `[[camera]]`. One visitor rather than an untagged enum, which would lose the lines of errors.
pub(super) fn cameras<'de, D: Deserializer<'de>>(source: D) -> Result<Vec<CameraSection>, D::Error> {
    struct OneOrMany;

    impl<'de> Visitor<'de> for OneOrMany {
        type Value = Vec<CameraSection>;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("[camera] or several [[camera]]")
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
            CameraSection::deserialize(MapAccessDeserializer::new(map)).map(|c| vec![c])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
            let mut all = vec![];
            while let Some(camera) = list.next_element()? {
                all.push(camera);
            }
            if all.is_empty() { Err(A::Error::custom("an empty list of cameras; give at least one")) } else { Ok(all) }
        }
    }

    source.deserialize_any(OneOrMany)
}
