//! Common parts of both equations: scaling, compression of the extended pencil, and the graph of its stable
//! subspace.

use nalgebra::DMatrix;
use whirlstand_linalg::{
    C64, GeneralizedSchur, balancing_exponents, complex, orthogonal_completion, symmetric_part,
};

use super::RiccatiError;

/// The data of a Riccati equation, scaled: `A = D^-1 A0 D`, `B = D^-1 B0 E`, `Q = D Q0 D`, `R = E R0 E`,
/// `S = D S0 E`, hence `X = D X0 D`.
pub struct Scaled {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    pub q: DMatrix<f64>,
    pub r: DMatrix<f64>,
    pub s: DMatrix<f64>,
    d: Vec<f64>,
}

impl Scaled {
    /// Scaling by powers of two found by balancing `magnitude`, the entrywise size of the (2n + m) square
    /// pencil.
    pub fn new([a, b, q, r, s]: [&DMatrix<f64>; 5], magnitude: &DMatrix<f64>) -> Self {
        let (n, m) = (a.nrows(), b.ncols());
        let mut without_diagonal = magnitude.clone();
        without_diagonal.fill_diagonal(0.0);
        let e = balancing_exponents(&without_diagonal);
        let half = |x: i32| f64::powi(2.0, (f64::from(x) / 2.0).round() as i32);
        let d: Vec<f64> = (0..n).map(|i| half(e[i] - e[n + i])).collect();
        let inputs: Vec<f64> = (0..m).map(|i| f64::powi(2.0, e[2 * n + i])).collect();
        Self {
            a: DMatrix::from_fn(n, n, |i, j| a[(i, j)] * d[j] / d[i]),
            b: DMatrix::from_fn(n, m, |i, j| b[(i, j)] * inputs[j] / d[i]),
            q: DMatrix::from_fn(n, n, |i, j| q[(i, j)] * d[i] * d[j]),
            r: DMatrix::from_fn(m, m, |i, j| r[(i, j)] * inputs[i] * inputs[j]),
            s: DMatrix::from_fn(n, m, |i, j| s[(i, j)] * d[i] * inputs[j]),
            d,
        }
    }

    /// Transforms a solution of the scaled equation back.
    pub fn unscale(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] / (self.d[i] * self.d[j]))
    }
}

/// Removes the last m columns of the (2n + m) square pencil `(h, j)`, in which `j` is zero, by an orthogonal
/// transformation from the left.
pub fn compress(h: &DMatrix<f64>, j: &DMatrix<f64>, m: usize) -> (DMatrix<f64>, DMatrix<f64>) {
    let size = h.nrows();
    let keep = size - m;
    let q = orthogonal_completion(&h.columns(keep, m).into_owned());
    let qt = q.columns(m, keep).transpose();
    (&qt * h.columns(0, keep), &qt * j.columns(0, keep))
}

/// X with `[I; X]` spanning the deflating subspace of the n eigenvalues of the 2n x 2n pencil that `measure`
/// (smaller is more stable) ranks first.
pub fn stable_graph(
    h: &DMatrix<f64>,
    j: &DMatrix<f64>,
    measure: impl Fn(C64, C64) -> f64,
) -> Result<DMatrix<f64>, RiccatiError> {
    let n = h.nrows() / 2;
    let mut schur = GeneralizedSchur::new(&complex(h), &complex(j))?;
    let mut order: Vec<(f64, usize)> = (0..2 * n)
        .map(|k| {
            let (alpha, beta) = schur.eigenvalue(k);
            (measure(alpha, beta), k)
        })
        .collect();
    order.sort_by(|x, y| x.0.total_cmp(&y.0));
    let mut selected = vec![false; 2 * n];
    order[..n].iter().for_each(|&(_, k)| selected[k] = true);
    schur.reorder(&selected);
    let u1 = schur.z.view((0, 0), (n, n)).into_owned();
    let u2 = schur.z.view((n, 0), (n, n)).into_owned();
    // X U1 = U2, solved transposed.
    let xt = u1
        .transpose()
        .lu()
        .solve(&u2.transpose())
        .ok_or(RiccatiError::NoStabilisingSolution { measure: "subspace condition", value: f64::INFINITY })?;
    Ok(symmetric_part(&xt.transpose().map(|v| v.re)))
}

/// Newton's method in correction form: adds `correction(x)` as long as that at least halves the residual.
pub fn refine(
    mut x: DMatrix<f64>,
    residual: impl Fn(&DMatrix<f64>) -> f64,
    correction: impl Fn(&DMatrix<f64>) -> Option<DMatrix<f64>>,
) -> (DMatrix<f64>, f64) {
    let mut now = residual(&x);
    for _ in 0..10 {
        if now <= f64::EPSILON {
            break;
        }
        let Some(step) = correction(&x) else { break };
        let next = symmetric_part(&(&x + step));
        let then = residual(&next);
        let enough = then < 0.5 * now;
        if then < now {
            (x, now) = (next, then);
        }
        // NaN ends the refinement too.
        if !enough {
            break;
        }
    }
    (x, now)
}
