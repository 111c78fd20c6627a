//! Sensitivities after a step of a descent, from what the step changed: no run of their own.

use std::ops::Range;
use std::sync::Arc;

use crate::model::columns::{Column, dot};

/// Sensitivities of all samples to some parameters.
#[derive(Debug, Clone)]
pub struct Sensitivities {
    /// One column per parameter.
    pub columns: Arc<Vec<Column>>,
    /// False where they were brought along from another point by [`along`].
    pub exact: bool,
}

/// Change of the samples that sensitivities foretell of a step.
pub fn foretold<'c>(columns: impl Iterator<Item = &'c Column>, step: &[f64], samples: usize) -> Vec<f64> {
    let mut change = vec![0.0; samples];
    for (column, by) in columns.zip(step).filter(|(_, by)| **by != 0.0) {
        change.iter_mut().zip(column.iter()).for_each(|(c, v)| *c += by * v);
    }
    change
}

/// Sensitivities at the end of a step, which explain what those at its beginning did not foretell of it: in every channel
/// the smallest change that does, in units of each parameter's standard error, whose inverse square is its `information`
/// (Broyden, Math. Comp. 19, 1965; where entries are known to be zero, Schubert, Math. Comp. 24, 1970).
pub fn along(
    columns: &[Column],
    step: &[f64],
    information: &[f64],
    unforetold: &[f64],
    channels: &[Range<usize>],
) -> Vec<Column> {
    let mut columns: Vec<Vec<f64>> = columns.iter().map(|column| column.to_vec()).collect();
    for channel in channels {
        let reaches = |column: &Vec<f64>| column[channel.clone()].iter().any(|v| *v != 0.0);
        let weights: Vec<f64> = columns
            .iter()
            .zip(step.iter().zip(information))
            .map(|(column, (by, information))| if reaches(column) { information * by } else { 0.0 })
            .collect();
        let length = dot(&weights, step);
        if length <= 0.0 {
            continue;
        }
        for (column, weight) in columns.iter_mut().zip(&weights).filter(|(_, weight)| **weight != 0.0) {
            let share = weight / length;
            let both = column[channel.clone()].iter_mut().zip(&unforetold[channel.clone()]);
            both.for_each(|(v, change)| *v += share * change);
        }
    }
    columns.into_iter().map(Arc::new).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two channels of two samples; the second parameter does not reach the second channel.
    #[test]
    fn sensitivities_brought_along_explain_the_step_and_keep_their_channels() {
        let columns = [vec![1.0, 2.0, 3.0, 4.0], vec![1.0, -1.0, 0.0, 0.0]].map(Arc::new);
        let (step, information) = ([0.5, -0.2], [4.0, 1.0]);
        let change = [0.9, 1.4, 1.6, 2.2];
        let before = foretold(columns.iter(), &step, 4);
        let unforetold: Vec<f64> = change.iter().zip(&before).map(|(c, b)| c - b).collect();
        let after = along(&columns, &step, &information, &unforetold, &[0..2, 2..4]);
        let explained = foretold(after.iter(), &step, 4);
        assert!(explained.iter().zip(&change).all(|(e, c)| (e - c).abs() < 1e-12), "{explained:?}");
        assert_eq!(after[1][2..], [0.0, 0.0], "a channel that it does not reach");
        // In the first channel the better known parameter changes less for its step: by 4 x 0.5 against 1 x 0.2.
        let moved = |i: usize| after[i][0] - columns[i][0];
        assert!((moved(0) / moved(1) + 4.0 * 0.5 / 0.2).abs() < 1e-9, "{} {}", moved(0), moved(1));
    }

    #[test]
    fn a_step_of_nothing_changes_nothing() {
        let columns = [vec![1.0, 2.0]].map(Arc::new);
        assert_eq!(along(&columns, &[0.0], &[1.0], &[0.3, 0.3], &[0..1, 1..2]), columns);
    }
}
