//! Accuracy of the parameters: their covariance, and parameters that the data do not determine.

use super::sweep::simulation;
use nalgebra::DMatrix;
use whirlstand_linalg::symmetric_eigen;

use super::ar::{Ar, RowFilter};
use super::data::Segment;
use super::normal::{Normal, pseudo_inverse};
use super::output_error::{Evaluation, eliminate};
use super::problem::{Parameter, Problem};
use super::sums::spacing;

/// Covariance of the parameters of an output-error fit.
///
/// The fit weights residuals by `whitening`. Where the final residual is still coloured, `residual` describes
/// it by an autoregressive model of each output, and the covariance is F^-1 (sum J' R J) F^-1 with R the
/// residual's autocovariance (Maine and Iliff, NASA RP-1138, 1985; Morelli and Klein, J. Aircraft 34, 1997).
/// R J is computed by the model's filter, |1/A|^2, in one sweep.
pub fn covariance(
    problem: &Problem,
    segments: &[Segment],
    whitening: &[Ar],
    residual: &[Ar],
    fit: &Evaluation,
) -> Option<DMatrix<f64>> {
    let inverse = pseudo_inverse(&fit.information)?;
    if residual.iter().all(|ar| ar.order() == 0) {
        return Some(inverse);
    }
    let np = fit.theta.len();
    let simulation = simulation(problem, &fit.theta)?;
    let columns = simulation.columns();
    let p = problem.p();
    let mut spread = DMatrix::zeros(np, np);
    for ((segment, nuisance), coupling) in segments.iter().zip(&fit.nuisances).zip(&fit.coupling) {
        let mut channels: Vec<Option<Channel>> = (0..p)
            .map(|i| {
                (problem.weights[i] > 0.0).then(|| Channel {
                    whiten: RowFilter::new(&whitening[i], false, columns),
                    colour: RowFilter::new(&residual[i], true, columns),
                    normal: Normal::new(columns),
                    every: spacing(segment, i, p),
                    last: None,
                })
            })
            .collect();
        simulation.sweep(segment, nuisance, &mut |step| {
            for (i, channel) in channels.iter_mut().enumerate() {
                if let Some(channel) = channel
                    && segment.outputs[step.k * p + i].is_finite()
                {
                    channel.add(step.k, step.slopes(i));
                }
            }
        });
        // The nuisances depend on the parameters: the columns of the parameters after elimination of the
        // nuisances.
        let mut turn = DMatrix::zeros(columns, np);
        turn.fill_diagonal(1.0);
        turn.view_mut((np, 0), coupling.shape()).copy_from(coupling);
        for (i, channel) in channels.into_iter().enumerate() {
            let Some(channel) = channel else { continue };
            let weight = (problem.weights[i] / fit.variances[i]).powi(2) * residual[i].variance;
            spread += turn.transpose() * channel.normal.finish().information * &turn * weight;
        }
    }
    Some(&inverse * spread * &inverse)
}

/// Sensitivities of one output as they pass both filters.
struct Channel {
    whiten: RowFilter,
    colour: RowFilter,
    normal: Normal,
    /// Usual distance of fresh values, steps.
    every: usize,
    last: Option<usize>,
}

impl Channel {
    fn add(&mut self, k: usize, slopes: &[f64]) {
        if self.last.is_some_and(|l| k - l != self.every) {
            self.whiten.reset();
            self.colour.reset();
        }
        self.last = Some(k);
        if let Some(row) = self.whiten.next(slopes)
            && let Some(row) = self.colour.next(row)
        {
            self.normal.add(row, 0.0);
        }
    }
}

/// A parameter that the data do not determine, with the reason.
#[derive(Debug, Clone, PartialEq)]
pub struct Undetermined {
    /// Index of the parameter in the problem.
    pub index: usize,
    /// Reason why the data do not determine it, as a sentence.
    pub why: String,
}

/// Largest standard error that still counts as determined, as a share of the parameter's range.
const WIDEST: f64 = 0.25;
/// Smallest eigenvalue of the information, scaled to a diagonal of ones, that exceeds rounding.
const SINGULAR: f64 = 1e-10;

/// The parameter that the data determine least; `None` when they determine all.
pub fn undetermined(
    information: &DMatrix<f64>,
    covariance: &DMatrix<f64>,
    parameters: &[Parameter],
) -> Option<Undetermined> {
    let n = parameters.len();
    let scale: Vec<f64> = (0..n).map(|i| information[(i, i)].max(0.0).sqrt()).collect();
    let size = |i: usize| scale[i] * (parameters[i].upper - parameters[i].lower);
    if let Some(index) = (0..n).find(|i| size(*i).is_nan() || size(*i) <= 1e-6) {
        return Some(Undetermined { index, why: "the fitted outputs do not depend on it".into() });
    }
    let scaled = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (scale[i] * scale[j]));
    let (values, vectors) = match symmetric_eigen(scaled) {
        Ok(eigen) => eigen,
        Err(e) => {
            let index = (0..n).min_by(|a, b| size(*a).total_cmp(&size(*b)))?;
            return Some(Undetermined {
                index,
                why: format!("its information in the data cannot be computed: {e}"),
            });
        }
    };
    let weakest = values.imin();
    if values[weakest] < SINGULAR * values.max() {
        let vector = vectors.column(weakest);
        let index = vector.iamax();
        let with: Vec<&str> = (0..n)
            .filter(|i| *i != index && vector[*i].abs() > 0.1 * vector[index].abs())
            .map(|i| parameters[i].name.as_str())
            .collect();
        let why = format!("the data determine only a combination of it with {}", with.join(", "));
        return Some(Undetermined { index, why });
    }
    let ratio = |i: usize| covariance[(i, i)].max(0.0).sqrt() / (parameters[i].upper - parameters[i].lower);
    let worst = (0..n).max_by(|a, b| ratio(*a).total_cmp(&ratio(*b)))?;
    (ratio(worst) > WIDEST).then(|| {
        let p = &parameters[worst];
        let error = covariance[(worst, worst)].max(0.0).sqrt() / p.factor;
        let partner = (0..n)
            .filter(|i| *i != worst)
            .map(|i| (i, correlation(covariance, i, worst)))
            .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        let with = match partner {
            Some((i, r)) if r.abs() > 0.9 => {
                format!(", with a correlation of {r:.2} with {}", parameters[i].name)
            }
            _ => String::new(),
        };
        let why = format!(
            "its standard error would be {error:.3}, more than a quarter of its range from {:.3} to {:.3}{with}",
            p.lower / p.factor,
            p.upper / p.factor
        );
        Undetermined { index: worst, why }
    })
}

/// Correlation of the errors of parameters `i` and `j`, -1 to 1.
pub fn correlation(covariance: &DMatrix<f64>, i: usize, j: usize) -> f64 {
    let scale = (covariance[(i, i)] * covariance[(j, j)]).sqrt();
    if scale > 0.0 { covariance[(i, j)] / scale } else { 0.0 }
}

/// Information about the first `np` unknowns, np x np, after elimination of the other unknowns; `None` when
/// those are singular.
pub fn marginal(information: &DMatrix<f64>, np: usize) -> Option<DMatrix<f64>> {
    let right = nalgebra::DVector::zeros(information.nrows());
    Some(eliminate(information, &right, np)?.information)
}
