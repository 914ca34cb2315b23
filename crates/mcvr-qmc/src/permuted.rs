//! The same points with their offset coordinates on other kernel axes.

use mcvr_sampling::{PointBlock, PointStream, Search};

/// A stream whose kernel axis `a` takes the coordinate that `coordinates[a]` names, 0, 1 or 2 of the inner stream's. The
/// coordinates of a low-discrepancy set are not equally good together with the first one, which chooses the voxel.
#[derive(Clone, Debug)]
pub struct Permuted<S> {
    inner: S,
    coordinates: [usize; 3],
}

impl<S: PointStream> Permuted<S> {
    /// `None` unless `coordinates` is a permutation of 0, 1, 2.
    pub fn new(inner: S, coordinates: [usize; 3]) -> Option<Self> {
        let complete = (0..3).all(|a| coordinates.contains(&a));
        complete.then_some(Self { inner, coordinates })
    }
}

impl<S: PointStream> PointStream for Permuted<S> {
    fn samples(&self) -> u64 {
        self.inner.samples()
    }

    fn search(&self) -> Search {
        self.inner.search()
    }

    fn fill(&self, block: u64, total: u64, out: &mut PointBlock) {
        self.inner.fill(block, total, out);
        // Exchanges of whole arrays: what belongs to axis 0, then 1; the last is what is left.
        let mut at = [0, 1, 2];
        for axis in 0..2 {
            if let Some(from) = at.iter().position(|&c| c == self.coordinates[axis]) {
                out.uniforms.swap(axis, from);
                at.swap(axis, from);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scramble, SobolNet};

    #[test]
    fn every_axis_takes_the_coordinate_that_is_named() {
        let net = || SobolNet::new(100, 1, Scramble::default());
        let block = |stream: &dyn PointStream| {
            let mut out = PointBlock::default();
            out.resize(100);
            stream.fill(0, 1 << 40, &mut out);
            out
        };
        let plain = block(&net());
        for a in 0..3 {
            for b in 0..3 {
                for c in 0..3 {
                    match Permuted::new(net(), [a, b, c]) {
                        Some(permuted) => {
                            let moved = block(&permuted);
                            assert_eq!(moved.targets, plain.targets);
                            for (axis, from) in [a, b, c].into_iter().enumerate() {
                                assert_eq!(moved.uniforms[axis], plain.uniforms[from], "{a}{b}{c}");
                            }
                        }
                        None => assert!(a == b || b == c || a == c),
                    }
                }
            }
        }
        assert!(Permuted::new(net(), [0, 1, 3]).is_none());
    }
}
