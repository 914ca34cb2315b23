//! The voxels of one stream with the kernel offsets of another.

use mcvr_sampling::{PointBlock, PointStream, Search};

/// Hybrids, to find out which half of a gain comes from where: the 2003 paper drew random voxels with quasi-random offsets,
/// and the reverse. Point k has the target of the one stream's point k and the uniforms of the other's. Both are filled
/// whole, so that a hybrid costs a little more than it had to.
#[derive(Clone, Debug)]
pub struct Paired<V, O> {
    voxels: V,
    offsets: O,
}

impl<V: PointStream, O: PointStream> Paired<V, O> {
    /// `None` unless both streams have as many points.
    pub fn new(voxels: V, offsets: O) -> Option<Self> {
        (voxels.samples() == offsets.samples()).then_some(Self { voxels, offsets })
    }
}

impl<V: PointStream, O: PointStream> PointStream for Paired<V, O> {
    fn samples(&self) -> u64 {
        self.voxels.samples()
    }

    fn search(&self) -> Search {
        self.voxels.search()
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        let mut voxels = PointBlock::default();
        voxels.resize(out.targets.len());
        self.voxels.fill(block, total, &mut voxels);
        self.offsets.fill(block, total, out);
        std::mem::swap(&mut out.targets, &mut voxels.targets);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scramble, SobolNet};

    #[test]
    fn targets_are_the_one_s_and_offsets_the_other_s() {
        let [a, b] = [1, 2].map(|seed| SobolNet::new(5000, seed, Scramble::default()));
        let paired = Paired::new(a.clone(), b.clone()).unwrap();
        assert_eq!(paired.samples(), 5000);
        let mut blocks = [(); 3].map(|()| PointBlock::default());
        let streams: [&dyn PointStream; 3] = [&a, &b, &paired];
        for (stream, out) in streams.into_iter().zip(&mut blocks) {
            out.resize(mcvr_sampling::block_len(5000, 2));
            stream.fill(2, 1 << 50, out);
        }
        let [a, b, paired] = blocks;
        assert_eq!((paired.targets, paired.uniforms), (a.targets, b.uniforms));
        let other = SobolNet::new(5001, 1, Scramble::default());
        assert!(Paired::new(other.clone(), SobolNet::new(5000, 1, Scramble::default())).is_none());
    }
}
