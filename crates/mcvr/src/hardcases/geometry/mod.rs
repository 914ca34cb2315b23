//! Geometry: eyes, rays, grids and pixels in awkward places.

mod camera;
mod eye;
mod grid;
mod precision;

use super::{Case, CaseError, Context, Cost, Finding, Group};

const fn case(
    name: &'static str,
    breaks: &'static str,
    asserts: &'static str,
    measure: fn(&Context) -> Result<Finding, CaseError>,
) -> Case {
    Case { name, group: Group::Geometry, breaks, asserts, cost: Cost::Quick, measure }
}

pub(super) const CASES: &[Case] = &[
    case(
        "eye-six-pictures",
        "the eye on a voxel's centre, a face, an edge, a corner: samples beside or behind it appear twice or nowhere",
        "six pictures of 90 degrees from one eye hold every sample exactly once",
        eye::six_faces,
    ),
    case(
        "eye-in-density",
        "line weights grow as 1/z² beside the eye: one sample outshines the image, or the variance has no bound",
        "every pixel within Bernstein's inequality, whose second moment grows as the reciprocal of the near plane only",
        eye::in_density,
    ),
    case(
        "eye-clipped-mass",
        "mass in front of the near plane is dropped silently, or renormalised away",
        "the reported share is the mass in front of the near plane",
        eye::clipped_mass,
    ),
    case(
        "eye-at-the-centre",
        "an eye a rounding away from the volume's centre: the camera looks the other way",
        "the axis is the view's at distances down to 2e-308 mm",
        eye::eye_at_centre,
    ),
    case(
        "eye-1e9-diameters",
        "positions along the ray cancel, and a ray's entry and exit merge",
        "line integrals within D/d and rounding of the parallel limit",
        eye::far_eye,
    ),
    case(
        "up-parallel-to-view",
        "right = up x axis is 0 at the poles: NaN in the matrix, an empty image",
        "the camera is the limit of those beside it",
        camera::up_parallel,
    ),
    case(
        "field-of-view-1e-3",
        "a focal length of 1e5 image sides: positions lose their digits",
        "samples agree with ray casting, both estimands",
        camera::narrow_view,
    ),
    case(
        "field-of-view-almost-180",
        "the tangent of 90 degrees: everything falls into one pixel, or beside the image",
        "the mass ahead is in the middle pixel; ray casting is off by no more than it says",
        camera::wide_view,
    ),
    case(
        "camera-not-a-number",
        "comparisons with NaN are false, so bad parameters pass every check",
        "each is refused by name",
        camera::nonsense,
    ),
    case(
        "matrix-scale-1e150",
        "squares of a projection matrix's entries overflow or vanish: a pinhole turns parallel or degenerate",
        "the same camera under any factor",
        camera::scaled_matrix,
    ),
    case(
        "matrix-nearly-singular",
        "an inverse without digits is used as if it had them",
        "refused, or rays project back to their pixels within the condition number",
        camera::nearly_singular,
    ),
    case(
        "near-beyond-the-volume",
        "nothing to draw: a division by an empty total",
        "an image of zeros, and all of the mass reported as clipped",
        camera::near_beyond,
    ),
    case(
        "near-1e-300",
        "fixed-point weights are relative to 1/near²: real ones round to 0 and the image is black or NaN",
        "refused with a near plane that would do, or right",
        camera::tiny_near,
    ),
    case(
        "images-one-pixel-wide",
        "strides and aspect ratios with a side of 1; 16,384 x 1",
        "the pixels of N x 1 add up to the pixel of 1 x 1, sample for sample",
        camera::thin_images,
    ),
    case(
        "march-of-endless-steps",
        "a step of 1e-30 voxels runs for ages and cannot be stopped, one of 0 or NaN for ever",
        "steps that would take more than 2^24 a ray are refused with the smallest that will do, which then works",
        grid::endless_steps,
    ),
    case(
        "rays-that-miss",
        "a slab test by rounding: faint or NaN values beside the volume",
        "their integrals are exactly 0",
        camera::misses,
    ),
    case(
        "rays-along-voxel-edges",
        "0/0 in the slab test; a ray in a face counted in both voxels or in none",
        "exact chords inside, one side at the border, 0 outside",
        grid::rays_on_edges,
    ),
    case(
        "rays-through-corners",
        "two or three planes crossed at once: a cell skipped, or walked twice",
        "chords along face and space diagonals exact to rounding",
        grid::diagonals,
    ),
    case(
        "axis-parallel-pinhole",
        "directions with components of exactly 0 from an eye on a grid plane",
        "exact chords from outside, from a face and from inside",
        grid::axis_pinhole,
    ),
    case(
        "volumes-one-voxel-thick",
        "interpolation cells need two voxels per axis: reads out of range, lost mass",
        "samples agree with ray casting for 1x1x1, 1xNx1 and N = 2; the exact count image sums to 1",
        grid::thin_volumes,
    ),
    case(
        "spacing-1-to-1000",
        "steps and tolerances in voxels of one axis are applied to the others",
        "the same line integrals as the same object in nearly cubic voxels",
        grid::spacing_ratio,
    ),
    case(
        "axes-exchanged-and-mirrored",
        "left-handed direction matrices flip the image or the sign of a determinant",
        "the same line integrals as the same object on a plain grid",
        grid::mirrored,
    ),
    case(
        "oblique-directions",
        "the inverse of a sheared direction is taken for its transpose",
        "count images as on the plain grid, sampled and cast",
        grid::oblique,
    ),
    case(
        "origin-at-1e7-mm",
        "world coordinates in 32 bits: steps of 1 mm",
        "line integrals move by the rounding of 64 bits alone, no sample is lost",
        grid::far_origin,
    ),
    case(
        "grids-beyond-double",
        "spacings whose product under- or overflows: a singular map, an infinite mass, NaN images",
        "refused, or maps that undo each other",
        grid::extreme_grids,
    ),
    case(
        "samples-conserved",
        "samples lost between pixels, or counted on both sides of a border",
        "inside + beside + clipped = M, for every method, kernel and precision",
        precision::conservation,
    ),
    case(
        "samples-on-pixel-borders",
        "positions exactly on borders and corners rounded up, down or twice",
        "each in exactly the pixel that starts there",
        precision::pixel_borders,
    ),
    case(
        "positions-in-32-bits",
        "32-bit floats lose the sub-voxel part of long axes and large images",
        "where they are chosen no position is off by more than 1/64 pixel",
        precision::single_error,
    ),
    case(
        "axis-of-2-million-voxels",
        "voxel numbers beyond 2^21 in 32 bits have no fraction left",
        "every sample in its own voxel's pixel, the last one included",
        precision::long_axis,
    ),
    Case {
        name: "image-16384-squared",
        group: Group::Geometry,
        breaks: "2^28 pixels: indices in 32 bits, positions with 10 bits of fraction, gigabytes per thread",
        asserts: "every sample in one pixel",
        cost: Cost::Large,
        measure: precision::large_image,
    },
];
