//! Matrices as lists of rows in serialised form.

use nalgebra::DMatrix;
use serde::Serializer;

/// Writes a matrix as a list of its rows.
pub fn serialize<S: Serializer>(m: &DMatrix<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq((0..m.nrows()).map(|i| m.row(i).iter().copied().collect::<Vec<f64>>()))
}
