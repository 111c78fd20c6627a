//! Matrix-vector products for the control step: columns padded to four rows, sizes fixed at compile time for the
//! common ones, so that the compiler keeps sums in registers.

use nalgebra::DMatrix;

/// Four rows.
pub type Block = [f64; 4];

/// A matrix stored column after column in blocks of four rows, padded with zeros.
#[derive(Debug, Clone)]
pub struct Packed {
    blocks: usize,
    data: Vec<Block>,
}

/// Number of blocks that hold `rows` rows.
pub const fn blocks(rows: usize) -> usize {
    rows.div_ceil(4)
}

impl Packed {
    /// Packs a matrix.
    pub fn new(m: &DMatrix<f64>) -> Self {
        let blocks = blocks(m.nrows());
        let mut packed = Self { blocks, data: vec![[0.0; 4]; blocks * m.ncols()] };
        packed.fill(m);
        packed
    }

    /// Takes over another matrix of the same shape.
    pub fn fill(&mut self, m: &DMatrix<f64>) {
        let blocks = self.blocks;
        for j in 0..m.ncols() {
            for i in 0..m.nrows() {
                self.data[j * blocks + i / 4][i % 4] = m[(i, j)];
            }
        }
    }

    /// `y += m x`; y has as many blocks as the matrix, x as many entries as it has columns.
    #[inline(always)]
    pub fn add(&self, y: &mut [Block], x: &[f64]) {
        self.add_scaled(y, x, 1.0);
    }

    /// `y -= m x`.
    #[inline(always)]
    pub fn subtract(&self, y: &mut [Block], x: &[f64]) {
        self.add_scaled(y, x, -1.0);
    }

    #[inline(always)]
    fn add_scaled(&self, y: &mut [Block], x: &[f64], scale: f64) {
        match self.blocks {
            1 => fixed::<1>(&self.data, y, x, scale),
            2 => fixed::<2>(&self.data, y, x, scale),
            3 => fixed::<3>(&self.data, y, x, scale),
            4 => fixed::<4>(&self.data, y, x, scale),
            0 => {}
            blocks => {
                for (column, v) in self.data.chunks_exact(blocks).zip(x) {
                    let factor = v * scale;
                    y.iter_mut().zip(column).for_each(|(y, c)| axpy(y, c, factor));
                }
            }
        }
    }
}

#[inline(always)]
fn axpy(y: &mut Block, c: &Block, factor: f64) {
    for l in 0..4 {
        y[l] += c[l] * factor;
    }
}

#[inline(always)]
fn fixed<const B: usize>(data: &[Block], y: &mut [Block], x: &[f64], scale: f64) {
    let Some(y) = y.first_chunk_mut::<B>() else { return };
    let mut sum = *y;
    for (column, v) in data.as_chunks::<B>().0.iter().zip(x) {
        let factor = v * scale;
        for b in 0..B {
            axpy(&mut sum[b], &column[b], factor);
        }
    }
    *y = sum;
}
