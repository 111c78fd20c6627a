//! Conversion from values of one vehicle to rows of all vehicles.

/// Puts one vehicle's values into its lane.
pub fn spread<const K: usize>(rows: &mut [[f64; K]], lane: usize, values: &[f64]) {
    rows.iter_mut().zip(values).for_each(|(row, value)| row[lane] = *value);
}
