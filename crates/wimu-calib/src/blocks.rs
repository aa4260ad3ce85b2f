//! Sums over blocks of successive samples, in a fixed amount of memory.

/// Sums over at most N blocks of equally many samples. When all blocks are full, neighbours are
/// merged in pairs and the block length doubles.
#[derive(Clone, Debug)]
pub(crate) struct Blocks<T, const N: usize> {
    /// Full blocks, then the one that is being filled, if it has samples.
    blocks: heapless::Vec<T, N>,
    /// Block length, samples.
    length: u64,
    /// Samples of the last block.
    filled: u64,
}

impl<T: Clone + Default, const N: usize> Blocks<T, N> {
    pub fn new() -> Self {
        Self { blocks: heapless::Vec::new(), length: 1, filled: 1 }
    }

    /// The block that the next sample belongs to. `merge` adds two neighbouring blocks.
    pub fn next(&mut self, merge: impl Fn(&T, &T) -> T) -> Option<&mut T> {
        if self.filled == self.length {
            if self.blocks.is_full() {
                for k in 0..N / 2 {
                    self.blocks[k] = merge(&self.blocks[2 * k], &self.blocks[2 * k + 1]);
                }
                self.blocks.truncate(N / 2);
                self.length *= 2;
            }
            let _ = self.blocks.push(T::default());
            self.filled = 0;
        }
        self.filled += 1;
        self.blocks.last_mut()
    }

    /// All blocks, of which the last may be incomplete.
    pub fn all(&self) -> &[T] {
        &self.blocks
    }
}
