//! Autoregressive models of coloured residuals.

use multiversion::multiversion;

/// Autoregressive model of a residual r: e_k = r_k + a_1 r_(k-1) + ... + a_q r_(k-q) with white e.
#[derive(Debug, Clone, PartialEq)]
pub struct Ar {
    /// Coefficients a_1 to a_q.
    pub coefficients: Vec<f64>,
    /// Variance of the white part e, in the squared unit of the residual.
    pub variance: f64,
}

impl Ar {
    /// White noise of the given variance.
    pub fn white(variance: f64) -> Self {
        Self { coefficients: Vec::new(), variance }
    }

    /// Fits runs of residuals (mean not removed) by Burg's method over all runs together, with the order up to `most`
    /// that BIC selects; the search ends once several orders in a row bring no improvement. Burg's models are always
    /// stable (Burg 1975; Kay and Marple, Proc. IEEE 69, 1981).
    pub fn fit<R: AsRef<[f64]>>(runs: &[R], most: usize) -> Self {
        const PATIENCE: usize = 5;
        let total: usize = runs.iter().map(|r| r.as_ref().len()).sum();
        let n = total as f64;
        let mut variance = runs.iter().flat_map(|r| r.as_ref()).map(|v| v * v).sum::<f64>() / n.max(1.0);
        let mut best = (f64::INFINITY, Self::white(variance));
        let mut residuals: Vec<(Vec<f64>, Vec<f64>)> =
            runs.iter().map(|r| (r.as_ref().to_vec(), r.as_ref().to_vec())).collect();
        let mut a: Vec<f64> = Vec::with_capacity(most);
        for order in 0..=most.min(total / 10) {
            if variance.is_nan() || variance <= 0.0 {
                break;
            }
            let bic = n * variance.ln() + order as f64 * n.ln();
            if bic < best.0 {
                best = (bic, Self { coefficients: a.clone(), variance });
            } else if order > best.1.order() + PATIENCE {
                break;
            }
            // backward[k] holds b_(k-1): shifted by one in each order, by taking a shorter slice. A run that is not
            // longer than the order has nothing left.
            let pairs = residuals.iter_mut().filter(|(f, _)| f.len() > order + 1);
            let mut pairs: Vec<(&mut [f64], &mut [f64])> = pairs
                .map(|(f, b)| {
                    let end = b.len() - order - 1;
                    (&mut f[order + 1..], &mut b[..end])
                })
                .collect();
            let sums = pairs.iter().map(|(f, b)| correlation(f, b));
            let (cross, power) = sums.fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
            if power.is_nan() || power <= 0.0 {
                break;
            }
            let reflection = -2.0 * cross / power;
            for (f, b) in &mut pairs {
                reflect(f, b, reflection);
            }
            let previous = a.clone();
            a.push(reflection);
            for (i, p) in previous.iter().enumerate() {
                a[i] = p + reflection * previous[order - 1 - i];
            }
            variance *= 1.0 - reflection * reflection;
        }
        best.1
    }

    /// Order q of the model.
    pub fn order(&self) -> usize {
        self.coefficients.len()
    }

    /// Applies A(q) to a run of residuals, with zeros before its beginning.
    ///
    /// # Panics
    /// When `out` is not as long as the run.
    pub fn filter(&self, run: &[f64], out: &mut [f64]) {
        assert_eq!(run.len(), out.len(), "one value for each residual");
        filter(&self.coefficients, run, out);
    }

    /// The white part of a run of residuals, without the first `order` values.
    pub fn whiten(&self, run: &[f64]) -> Vec<f64> {
        let q = self.order();
        (q..run.len())
            .map(|k| {
                run[k] + self.coefficients.iter().enumerate().map(|(i, a)| a * run[k - 1 - i]).sum::<f64>()
            })
            .collect()
    }
}

/// Filters rows of numbers by A(q), or by 1/A(q), column by column.
#[derive(Debug, Clone)]
pub struct RowFilter {
    coefficients: Vec<f64>,
    inverse: bool,
    width: usize,
    /// Ring buffer of the last rows: inputs of A(q), or outputs of the inverse.
    ring: Vec<f64>,
    newest: usize,
    filled: usize,
    out: Vec<f64>,
}

impl RowFilter {
    /// A filter for rows of `width` numbers; with `inverse` by 1/A(q).
    pub fn new(ar: &Ar, inverse: bool, width: usize) -> Self {
        let q = ar.order();
        Self {
            coefficients: ar.coefficients.clone(),
            inverse,
            width,
            ring: vec![0.0; q.max(1) * width],
            newest: 0,
            filled: 0,
            out: vec![0.0; width],
        }
    }

    /// Clears all past rows, as after a gap.
    pub fn reset(&mut self) {
        self.filled = 0;
        self.ring.fill(0.0);
    }

    /// Filters a row; `None` while there are fewer past rows than the order of A(q).
    pub fn next(&mut self, row: &[f64]) -> Option<&[f64]> {
        let q = self.coefficients.len();
        self.out.copy_from_slice(row);
        if q == 0 {
            return Some(&self.out);
        }
        let sign = if self.inverse { -1.0 } else { 1.0 };
        for (i, a) in self.coefficients.iter().enumerate() {
            let at = (self.newest + q - i) % q;
            let past = &self.ring[at * self.width..(at + 1) * self.width];
            accumulate(&mut self.out, past, sign * a);
        }
        self.newest = (self.newest + 1) % q;
        let at = self.newest * self.width..(self.newest + 1) * self.width;
        self.ring[at].copy_from_slice(if self.inverse { &self.out } else { row });
        let ready = self.inverse || self.filled >= q;
        self.filled += 1;
        ready.then_some(&self.out[..])
    }
}

/// Inner product, and both sums of squares, each in eight independent sums.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn correlation(forward: &[f64], backward: &[f64]) -> (f64, f64) {
    let (mut cross, mut power) = ([0.0; 8], [0.0; 8]);
    let ((f8, f_rest), (b8, b_rest)) = (forward.as_chunks::<8>(), backward.as_chunks::<8>());
    for (f, b) in f8.iter().zip(b8) {
        for i in 0..8 {
            cross[i] += f[i] * b[i];
            power[i] += f[i] * f[i] + b[i] * b[i];
        }
    }
    for (i, (f, b)) in f_rest.iter().zip(b_rest).enumerate() {
        cross[i] += f * b;
        power[i] += f * f + b * b;
    }
    (cross.iter().sum(), power.iter().sum())
}

/// Forward and backward residuals of the next order.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn reflect(forward: &mut [f64], backward: &mut [f64], reflection: f64) {
    for (f, b) in forward.iter_mut().zip(backward) {
        let before = *f;
        *f = before + reflection * *b;
        *b += reflection * before;
    }
}

/// Filters in blocks that fit into the first-level cache.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn filter(coefficients: &[f64], run: &[f64], out: &mut [f64]) {
    const BLOCK: usize = 512;
    out.copy_from_slice(run);
    for start in (0..run.len()).step_by(BLOCK) {
        let end = (start + BLOCK).min(run.len());
        for (lag, a) in (1..).zip(coefficients) {
            let from = start.max(lag);
            if from < end {
                let past = &run[from - lag..end - lag];
                out[from..end].iter_mut().zip(past).for_each(|(o, p)| *o += a * p);
            }
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn accumulate(out: &mut [f64], past: &[f64], a: f64) {
    out.iter_mut().zip(past).for_each(|(o, p)| *o += a * p);
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    fn coloured(n: usize, a: &[f64], seed: u64) -> Vec<f64> {
        let mut stream = Stream::new(seed, "ar");
        let mut y: Vec<f64> = Vec::new();
        for k in 0..n {
            let past: f64 =
                a.iter().enumerate().map(|(i, a)| if k > i { a * y[k - 1 - i] } else { 0.0 }).sum();
            y.push(stream.normal() - past);
        }
        y
    }

    #[test]
    fn burg_finds_order_and_coefficients() {
        let a = [-1.5, 0.8];
        let runs = [coloured(4000, &a, 1), coloured(3000, &a, 2)];
        let ar = Ar::fit(&runs, 20);
        assert!(ar.order() >= 2 && ar.order() <= 4, "{ar:?}");
        assert!((ar.coefficients[0] + 1.5).abs() < 0.05 && (ar.coefficients[1] - 0.8).abs() < 0.05, "{ar:?}");
        assert!((ar.variance - 1.0).abs() < 0.05);
        assert_eq!(Ar::fit(&[coloured(5000, &[], 3)], 20).order(), 0);
    }

    #[test]
    fn the_inverse_filter_undoes_the_filter() {
        let ar = Ar { coefficients: vec![-1.5, 0.8], variance: 1.0 };
        let y = coloured(50, &ar.coefficients, 4);
        let (mut whiten, mut colour) = (RowFilter::new(&ar, false, 1), RowFilter::new(&ar, true, 1));
        let white = ar.whiten(&y);
        let mut seen = 0;
        for v in &y {
            if let Some(e) = whiten.next(&[*v]) {
                assert!((e[0] - white[seen]).abs() < 1e-12);
                seen += 1;
            }
        }
        assert_eq!(seen, white.len());
        // From zero initial conditions, 1/A(q) of A(q) y is y.
        for k in 0..y.len() {
            let past: f64 = (0..2).map(|i| if k > i { ar.coefficients[i] * y[k - 1 - i] } else { 0.0 }).sum();
            let back = colour.next(&[y[k] + past]).unwrap()[0];
            assert!((back - y[k]).abs() < 1e-9);
        }
    }
}
