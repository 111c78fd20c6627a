//! Matrix-vector products for the control step: columns padded to four rows, sizes fixed at compile time for the
//! common ones, so that the compiler keeps sums in registers.

use nalgebra::DMatrix;

/// A block of four rows.
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

    /// Copies another matrix of the same shape.
    pub fn fill(&mut self, m: &DMatrix<f64>) {
        let blocks = self.blocks;
        for j in 0..m.ncols() {
            for i in 0..m.nrows() {
                self.data[j * blocks + i / 4][i % 4] = m[(i, j)];
            }
        }
    }

    /// A matrix of zeros.
    pub fn zeros(rows: usize, columns: usize) -> Self {
        let blocks = blocks(rows);
        Self { blocks, data: vec![[0.0; 4]; blocks * columns] }
    }

    /// Sets all entries to zero.
    pub fn clear(&mut self) {
        self.data.fill([0.0; 4]);
    }

    /// Copies a packed matrix of the same shape.
    pub fn copy_from(&mut self, other: &Self) {
        self.data.copy_from_slice(&other.data);
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.data.len() / self.blocks.max(1)
    }

    /// Column j in blocks.
    #[inline(always)]
    pub fn column(&self, j: usize) -> &[Block] {
        &self.data[j * self.blocks..(j + 1) * self.blocks]
    }

    /// Column j in blocks.
    #[inline(always)]
    pub fn column_mut(&mut self, j: usize) -> &mut [Block] {
        &mut self.data[j * self.blocks..(j + 1) * self.blocks]
    }

    /// Entry in row i and column j.
    #[inline(always)]
    pub fn entry(&self, i: usize, j: usize) -> f64 {
        self.data[j * self.blocks + i / 4][i % 4]
    }

    /// Sets the entry in row i and column j.
    #[inline(always)]
    pub fn set(&mut self, i: usize, j: usize, value: f64) {
        self.data[j * self.blocks + i / 4][i % 4] = value;
    }

    /// `self += a b` for the first `columns` columns of b.
    pub fn add_product(&mut self, a: &Self, b: &Self, columns: usize) {
        for j in 0..columns {
            a.add(self.column_mut(j), b.column(j).as_flattened());
        }
    }

    /// Copies the transpose of an n x n matrix.
    pub fn transpose_from(&mut self, other: &Self, n: usize) {
        for j in 0..n {
            for i in 0..n {
                self.set(i, j, other.entry(j, i));
            }
        }
    }

    /// Makes an n x n matrix symmetric by the mean of both halves.
    pub fn symmetrise(&mut self, n: usize) {
        for j in 0..n {
            for i in 0..j {
                let mean = 0.5 * (self.entry(i, j) + self.entry(j, i));
                self.set(i, j, mean);
                self.set(j, i, mean);
            }
        }
    }

    /// Converts to a dense matrix of that shape.
    pub fn to_matrix(&self, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |i, j| self.entry(i, j))
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

    /// Adds products as [`Self::add`] for K vectors, interleaved entry by entry.
    #[inline(always)]
    pub fn add_lanes<const K: usize>(&self, y: &mut [[f64; K]], x: &[[f64; K]]) {
        self.by_row(y, x, |sum, c, x| sum + c * x);
    }

    /// Subtracts products as [`Self::subtract`] for K vectors.
    #[inline(always)]
    pub fn subtract_lanes<const K: usize>(&self, y: &mut [[f64; K]], x: &[[f64; K]]) {
        self.by_row(y, x, |sum, c, x| sum - c * x);
    }

    #[inline(always)]
    fn by_row<const K: usize>(
        &self,
        y: &mut [[f64; K]],
        x: &[[f64; K]],
        each: impl Fn(f64, f64, f64) -> f64,
    ) {
        for (i, y) in y.iter_mut().enumerate() {
            let mut sum = *y;
            for (block, x) in self.data.iter().skip(i / 4).step_by(self.blocks).zip(x) {
                let c = block[i % 4];
                for l in 0..K {
                    sum[l] = each(sum[l], c, x[l]);
                }
            }
            *y = sum;
        }
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

/// `y += c factor`, block by block.
#[inline(always)]
pub fn add_scaled(y: &mut [Block], c: &[Block], factor: f64) {
    for (y, c) in y.iter_mut().zip(c) {
        axpy(y, c, factor);
    }
}

/// Sum of the products of all entries.
#[inline(always)]
pub fn dot(a: &[Block], b: &[Block]) -> f64 {
    let mut sum = [0.0; 4];
    for (a, b) in a.iter().zip(b) {
        for l in 0..4 {
            sum[l] += a[l] * b[l];
        }
    }
    (sum[0] + sum[1]) + (sum[2] + sum[3])
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
