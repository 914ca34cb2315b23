//! The methods that are compared.

use mcvr::mc::{OrderStatistics, Ssp, Stratified, Systematic};
use mcvr::qmc::{Lattice, Paired, Permuted, Scramble, SobolNet, SobolSequence};
use mcvr::sampling::rng::hash;
use mcvr::sampling::{Distribution, PointStream, RenderOptions, Rendered, VoxelOrder, render};
use mcvr::scene::{Estimand, Image, Kernel, Watch};

use crate::Outcome;
use crate::scans::Scene;

/// Where the points come from.
#[derive(Clone, Copy, PartialEq)]
pub enum Points {
    Mc,
    Stratified,
    Systematic,
    Ssp,
    RandomVoxels,
    Net(Scramble),
    /// The default net, kernel axis a taking offset coordinate `[a]`.
    Exchanged([usize; 3]),
    Lattice,
    Sequence,
    /// The sequence in passes that each double the samples; timed only, the image is the sequence's.
    Passes,
    /// The default net, begun anew at each doubling; timed only, the image is the net's.
    Restarts,
}

pub struct Entrant {
    pub name: &'static str,
    pub what: &'static str,
    pub source: &'static str,
    pub points: Points,
    pub order: VoxelOrder,
}

/// What every image here is.
pub const OPTIONS: RenderOptions = RenderOptions {
    estimand: Estimand::Line,
    kernel: Kernel::Tent,
    simd: None,
    precision: None,
    gradients: mcvr::sampling::GradientSource::Lazy,
};

/// The default method's name.
pub const NET: &str = "net";
/// The name of independent samples.
pub const MC: &str = "mc";
/// Samples of the first of several passes, as a power of two.
const FIRST_PASS: u32 = 12;

/// All of them: points, scrambles, orders, coordinates, and what is timed only.
pub fn entrants() -> Vec<Entrant> {
    use Points::*;
    let default = Net(Scramble::Linear);
    let entrant = |name, points, order, what, source| Entrant { name, what, source, points, order };
    let depth = |name, points, what, source| entrant(name, points, VoxelOrder::Depth, what, source);
    let mut all = vec![
        depth(MC, Mc, "independent samples, drawn in rising order", "Rényi 1953; the report's method"),
        depth("stratified", Stratified, "targets `(k + ξ_k)/M`, random offsets", "METHOD section 3"),
        depth(
            "systematic",
            Systematic,
            "targets `(k + ξ)/M` with one ξ, random offsets: quasi-random voxels, random offsets",
            "Madow and Madow 1944; the 2003 paper's hybrid",
        ),
        depth(
            "ssp",
            Ssp,
            "each voxel `⌊M w⌋` or `⌈M w⌉` times, negatively associated, random offsets",
            "Gerber, Chopin and Whiteley 2019",
        ),
        depth("random voxels", RandomVoxels, "sorted random targets, Sobol offsets", "the 2003 paper's other hybrid"),
        depth(NET, default, "`(k/M, Sobol 1, 2, 3)`, linear matrix scramble and shift: the default", "Matoušek 1998"),
        depth("lattice", Lattice, "Korobov lattice chosen by the spectral test, random shift", "`mcvr_qmc::Lattice`"),
        depth("sequence", Sequence, "first M points of the 4-D Sobol sequence", "`mcvr_qmc::SobolSequence`"),
        depth("shift", Net(Scramble::Shift), "the net, digital shift only", "Cranley and Patterson 1976, base 2"),
        depth("owen hash", Net(Scramble::Owen), "the net, nested scramble by a hash", "Burley 2020"),
        depth("owen nested", Net(Scramble::Nested), "the net, a random bit for every prefix", "Owen 1995"),
        entrant("hilbert", default, VoxelOrder::Hilbert, "the net, voxels along a Hilbert curve", "METHOD section 3"),
        entrant("x inner", default, VoxelOrder::Raster, "the net, x innermost: raster", "METHOD section 3"),
        entrant("y inner", default, VoxelOrder::YInnermost, "the net, y innermost", "METHOD section 3"),
        entrant("z inner", default, VoxelOrder::ZInnermost, "the net, z innermost", "METHOD section 3"),
    ];
    let exchanges = [
        ("offsets 1 3 2", [0, 2, 1]),
        ("offsets 2 1 3", [1, 0, 2]),
        ("offsets 2 3 1", [1, 2, 0]),
        ("offsets 3 1 2", [2, 0, 1]),
        ("offsets 3 2 1", [2, 1, 0]),
    ];
    all.extend(exchanges.map(|(name, coordinates)| {
        depth(name, Exchanged(coordinates), "the net, these coordinates on the kernel's x, y, z", "issue 6")
    }));
    all.push(depth("passes", Passes, "the sequence in passes, 2^12, 2^12, 2^13, ... samples", "issue 6"));
    all.push(depth("restarts", Restarts, "nets of 2^12, 2^13, ... samples, one after another", "issue 6"));
    all
}

impl Entrant {
    /// Powers of two at which errors are measured; the net goes farther, for the 2 % that few scans reach before.
    pub fn levels(&self, quick: bool) -> &'static [u32] {
        match self.points {
            Points::Passes | Points::Restarts => &[],
            _ if quick => &[10, 12, 14],
            Points::Exchanged(_) => &[18, 22],
            // Several times the time of the others: enough to see whether the fast scrambles err as it does.
            Points::Net(Scramble::Nested) => &[18, 20, 22],
            Points::Net(Scramble::Linear) if self.name == NET => &[18, 20, 22, 24, 26, 28],
            _ => &[18, 20, 22, 24, 26],
        }
    }

    /// Powers of two at which images are timed. Exchanging coordinates takes no time.
    pub fn timed(&self, quick: bool) -> &'static [u32] {
        match self.points {
            Points::Exchanged(_) => &[],
            _ if quick => &[12, 14],
            Points::Net(Scramble::Nested) => &[18, 20, 22],
            _ => &[18, 20, 22, 24, 26],
        }
    }

    /// Whether this is the default net in this scene, whose order is one of the three.
    pub fn is_default(&self, depth: VoxelOrder) -> bool {
        self.name != NET && self.points == Points::Net(Scramble::Linear) && self.order == depth
    }

    /// Low discrepancy in all four coordinates.
    pub fn is_qmc(&self) -> bool {
        matches!(self.points, Points::Net(_) | Points::Lattice | Points::Sequence)
    }

    /// A seed that no other method, number of samples or replicate has.
    pub fn seed(&self, level: u32, replicate: usize) -> u64 {
        let name = self.name.bytes().fold(0, |h, b| hash(&[h, u64::from(b)]));
        hash(&[name, u64::from(level), replicate as u64])
    }

    fn stream(&self, samples: u64, seed: u64, d: &Distribution<'_>) -> Outcome<Box<dyn PointStream>> {
        let net = |scramble| SobolNet::new(samples, seed, scramble);
        Ok(match self.points {
            Points::Mc => Box::new(OrderStatistics::new(samples, seed)),
            Points::Stratified => Box::new(Stratified::new(samples, seed)),
            Points::Systematic => Box::new(Systematic::new(samples, seed)),
            Points::Ssp => Box::new(Ssp::new(samples, seed, d)),
            Points::RandomVoxels => {
                let voxels = OrderStatistics::new(samples, seed);
                Box::new(Paired::new(voxels, net(Scramble::Linear)).ok_or("unequal streams")?)
            }
            Points::Net(scramble) => Box::new(net(scramble)),
            Points::Exchanged(coordinates) => {
                Box::new(Permuted::new(net(Scramble::Linear), coordinates).ok_or("no permutation")?)
            }
            Points::Lattice => Box::new(Lattice::new(samples, seed)),
            Points::Sequence => Box::new(SobolSequence::new(seed, Scramble::Linear).run(0, samples)),
            Points::Passes | Points::Restarts => return Err("passes are no single stream".into()),
        })
    }

    /// One image: the points of a method, and whatever has to be made for them, are made here and now.
    pub fn image(&self, scene: &Scene<'_>, level: u32, seed: u64) -> Outcome<Image> {
        let (distribution, _) = scene.distribution(self.order)?;
        let rendered = |stream: &dyn PointStream| -> Outcome<Rendered> {
            Ok(render(distribution, stream, &scene.camera, &OPTIONS, &Watch::default())?)
        };
        match self.points {
            Points::Passes => {
                let sequence = SobolSequence::new(seed, Scramble::Linear);
                let mut sum = Image::zeros(scene.camera.extent());
                for pass in FIRST_PASS.min(level)..level + 1 {
                    let (first, samples) =
                        if pass <= FIRST_PASS { (0, 1 << pass) } else { (1 << (pass - 1), 1 << (pass - 1)) };
                    let image = rendered(&sequence.run(first, samples))?.image;
                    let share = samples as f64 / (1u64 << level) as f64;
                    sum.values_mut().iter_mut().zip(image.values()).for_each(|(s, v)| *s += share * v);
                }
                Ok(sum)
            }
            Points::Restarts => {
                for pass in FIRST_PASS.min(level)..level {
                    rendered(&SobolNet::new(1 << pass, seed, Scramble::Linear))?;
                }
                Ok(rendered(&SobolNet::new(1 << level, seed, Scramble::Linear))?.image)
            }
            _ => Ok(rendered(&*self.stream(1 << level, seed, distribution)?)?.image),
        }
    }
}
