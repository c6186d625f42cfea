//! Means of records over short blocks of samples: of noise, they keep what is slow.

/// Samples of a block at least: fast noise is correlated over fewer.
const BLOCK_MIN: usize = 4;
/// Blocks of a record at most.
const BLOCKS_MAX: usize = 512;

/// Means of the shots of a capture, block by block.
#[derive(Clone, Debug)]
pub struct BlockMeans {
    /// Samples of a block.
    block: usize,
    /// Blocks of a record.
    blocks: usize,
    /// Samples that all shots have.
    covered: usize,
    /// A row for each shot; 0 where a shot has ended.
    means: Vec<f64>,
}

impl BlockMeans {
    /// Of no shot yet, with room for so many; records of `len` samples.
    #[must_use]
    pub fn new(len: usize, shots: usize) -> Self {
        let block = BLOCK_MIN.max(len.div_ceil(BLOCKS_MAX));
        Self { block, blocks: len / block, covered: len, means: Vec::with_capacity(shots * (len / block)) }
    }

    /// Begins a shot of so many samples, the first of which lies where the record begins.
    pub fn begin(&mut self, samples: usize) {
        self.means.resize(self.means.len() + self.blocks, 0.0);
        self.covered = self.covered.min(samples);
    }

    /// Takes samples of the shot that was begun last; `first`, their number in it, is where a block begins. Belongs in
    /// a kernel on wide vectors.
    #[allow(clippy::inline_always, reason = "else it stays on narrow vectors")]
    #[inline(always)]
    pub fn fill(&mut self, first: usize, samples: &[f64]) {
        let shot = self.means.len() - self.blocks;
        let means = &mut self.means[shot + first / self.block..];
        let scale = 1.0 / self.block as f64;
        if self.block == BLOCK_MIN {
            // The processor takes several blocks side by side where their size is known.
            for (mean, [a, b, c, d]) in means.iter_mut().zip(samples.as_chunks::<BLOCK_MIN>().0) {
                *mean = scale * (a + b + (c + d));
            }
        } else {
            let blocks = samples.chunks_exact(self.block);
            means.iter_mut().zip(blocks).for_each(|(mean, block)| *mean = scale * block.iter().sum::<f64>());
        }
    }

    /// Samples of a block.
    #[must_use]
    pub fn block(&self) -> usize {
        self.block
    }

    /// Samples from the record's start on that all shots have.
    #[must_use]
    pub fn covered(&self) -> usize {
        self.covered
    }

    /// The means of each shot.
    pub fn shots(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.means.chunks_exact(self.blocks.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_those_that_a_shot_fills() {
        for (len, block) in [(2048, 4), (2051, 5), (5000, 10)] {
            let mut means = BlockMeans::new(len, 2);
            let ramp: Vec<f64> = (0..len).map(|n| n as f64).collect();
            means.begin(len);
            means.fill(0, &ramp[..block * 20]);
            means.fill(block * 20, &ramp[block * 20..]);
            means.begin(block * 7 + 1);
            means.fill(0, &ramp[..=block * 7]);
            assert_eq!((means.block(), means.covered()), (block, block * 7 + 1));
            let shots: Vec<&[f64]> = means.shots().collect();
            let middle = |b: usize| (b * block) as f64 + 0.5 * (block - 1) as f64;
            let is_mean = |(b, mean): (usize, &f64)| (mean - middle(b)).abs() < 1e-9;
            assert!(shots.len() == 2 && shots[0].len() == len / block);
            assert!(shots[0].iter().enumerate().all(is_mean) && shots[1][..7].iter().enumerate().all(is_mean));
            assert!(shots[1][7..].iter().all(|mean| *mean == 0.0));
        }
    }
}
