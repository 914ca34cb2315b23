//! A point cloud from one request.

use mcvr_sampling::{Cloud, Counters, Distribution, Provenance, SamplingError, VoxelOrder, sample};
use mcvr_scene::{Density, DensityMap, Watch};
use mcvr_volume::Volume;

use crate::make::MakeError;
use crate::request::{check, point_stream};
use crate::{Method, Request};

/// Draws the points that [`make`](crate::make()) would project, and keeps them. The estimand plays no part: a cloud
/// serves both.
///
/// # Errors
/// [`MakeError`] for a method that draws no samples, [`VoxelOrder::Depth`] (a cloud has no view to take the depth
/// from), too little memory (12 bytes a point), or what [`make`](crate::make()) refuses.
pub fn draw_cloud(
    volume: &Volume,
    map: &DensityMap,
    request: &Request,
    watch: &Watch<'_>,
) -> Result<(Cloud, Counters), MakeError> {
    let Request { method, seed, order, .. } = *request;
    let refuse = |problem: String| Err(MakeError::Sampling(SamplingError::Cloud(problem)));
    if !method.samples_volume() {
        let why = match method {
            Method::Auto => "may cast rays",
            Method::Footprint => "adds whole voxels",
            _ => "casts rays",
        };
        return refuse(format!("{method} {why} and draws no points; use qmc, stratified or mc"));
    }
    if order == VoxelOrder::Depth {
        return refuse("order depth follows a view, and a cloud has none; use raster, hilbert, y or z".into());
    }
    check(request)?;
    let density = Density::new(volume, map.clone())?;
    let distribution = Distribution::new(&density, order)?;
    let provenance = Provenance {
        source: volume.name().to_owned(),
        map: serde_json::to_string(map).unwrap_or_default(),
        method: method.name().to_owned(),
        seed,
        order: order.name().to_owned(),
        scramble: (method == Method::Qmc).then(|| request.scramble.name().to_owned()),
    };
    let stream = point_stream(request, distribution.total());
    Ok(sample(&distribution, &*stream, request.kernel, provenance, watch)?)
}
