//! Effects: light, materials, films at their extremes.

mod film;
mod materials;
mod shading;

use super::{Case, CaseError, Context, Cost, Finding, Group};

const fn case(
    name: &'static str,
    breaks: &'static str,
    asserts: &'static str,
    measure: fn(&Context) -> Result<Finding, CaseError>,
) -> Case {
    Case { name, group: Group::Effects, breaks, asserts, cost: Cost::Quick, measure }
}

pub(super) const CASES: &[Case] = &[
    case(
        "zero-gradient",
        "a normal of 0/0 makes the whole pixel NaN; differences of equal floats leave noise with a direction",
        "samples in equal weights are exactly black, for every type and size of weight",
        shading::flat,
    ),
    case(
        "light-at-a-voxel",
        "the way to the light has length 0 at the light: NaN in the pixels around",
        "shaded images agree with ray casting with the light in density",
        shading::light_inside,
    ),
    case(
        "normal-across-the-light",
        "the cosine's sign is noise: pixels jump between lit and black",
        "sin α to 8 roundings for 90° ± α, α from 1e-16; both sides add up to the two-sided factor exactly",
        shading::grazing,
    ),
    case(
        "gradients-one-voxel-thick",
        "central differences at a border that is everywhere",
        "shaded images of volumes one voxel thick agree with ray casting",
        shading::thin,
    ),
    case(
        "gradients-of-1e300",
        "squares of gradients overflow or vanish: NaN or a black image",
        "the same shaded image when all weights are times 2^±1000",
        shading::scaled_weights,
    ),
    case(
        "cue-minimum-1e-300",
        "amounts are relative to the nearest possible light: real ones round to 0 and the image is black",
        "refused with a minimum that would do, or right",
        shading::tiny_cue,
    ),
    case(
        "light-of-1e300",
        "an intensity overflows the accumulators or the image",
        "exactly scaled, or refused; never an infinite pixel",
        shading::intensity,
    ),
    case(
        "materials-that-touch",
        "the shared boundary belongs to both materials, or to neither",
        "one colour and one weight for each isovalue, the boundary's the upper one's",
        materials::touching,
    ),
    case(
        "materials-with-gaps",
        "isovalues between materials keep their weight, or are counted twice",
        "the masses of the parts add up to the whole exactly",
        materials::gaps,
    ),
    case(
        "materials-that-overlap",
        "which of two materials a voxel has depends on their order",
        "refused by name, in either order; touching ones accepted",
        materials::overlaps,
    ),
    case(
        "materials-of-no-weight",
        "a scene that weighs nothing: a division by the total",
        "an error that says so, by sampling and by casting",
        materials::weightless,
    ),
    case(
        "emphasis-above-the-maximum",
        "another code path for the emphasised map changes rounding or the random numbers",
        "not a bit of the image changes",
        materials::emphasis,
    ),
    case(
        "depth-colour-at-its-ends",
        "0/0 in a range of no width, colours beyond 1 at the ends: NaN in fixed point",
        "colours between their stops at every depth, the stops' own at the ends",
        materials::depth_ends,
    ),
    case(
        "largest-sums",
        "fixed-point sums beyond 64 bits wrap around",
        "all samples in one pixel at the largest amount: exactly 1",
        materials::accumulators,
    ),
    case(
        "transmission-at-0-and-1e4",
        "exp underflows; its logarithm is infinite",
        "exactly 1 and exactly 0, falling between, and the logarithm gives the depth back",
        film::transmission_ends,
    ),
    case(
        "photons-1-and-1e12",
        "Poisson counts by multiplication never end at 1e12; by a normal law they are negative at 1",
        "mean and variance are Poisson's; counts are whole",
        film::photon_moments,
    ),
    case(
        "photons-0-and-nan",
        "0 photons divide by 0; NaN passes every comparison",
        "refused with the limits, pixels beyond 0..1 by their place; no photon, no count",
        film::photons_refused,
    ),
    case(
        "photons-on-any-threads",
        "noise keyed by thread: another image on another machine",
        "the same counts on 1, 2, 3 and 16 threads",
        film::photon_threads,
    ),
    case(
        "tone-of-a-flat-image",
        "a window of no width: 0/0, and a random grey",
        "every grey in 0..1, a flat image at the start of the curve",
        film::tones,
    ),
    case(
        "png-beyond-the-range",
        "values beyond white wrap around to black",
        "white stays white, black black, NaN black",
        film::png_beyond,
    ),
    case(
        "hounsfield-below-air",
        "padding of -1024 and less attenuates less than nothing",
        "weight 0, counted and its mass stated, or refused",
        film::below_air,
    ),
];
