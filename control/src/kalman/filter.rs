//! The filter itself: any linear model, measurements that come and go, gains kept once they repeat.

use nalgebra::DMatrix;

use crate::kernel::{Block, Packed, blocks};

/// Longest pattern of measurements, in steps, whose gains are kept.
const MAX_PERIOD: usize = 64;

/// Change of the covariance over one pattern, relative and per step, below which the gains count as settled.
const SETTLED: f64 = 1e-9;

/// A discrete Kalman filter for `x+ = F x + G u + w`, `y = H x + D u + v`, with w of covariance Q and v of
/// independent components.
///
/// Measurements are taken one at a time in Joseph's form (Bucy and Joseph 1968), which keeps the covariance
/// symmetric and positive whatever rounding does to the gain. When the pattern of fresh measurements repeats and
/// the covariance with it, gains are kept and a step costs a few matrix-vector products; the first step that
/// breaks the pattern returns to the full recursion from the kept covariance.
#[derive(Debug, Clone)]
pub struct KalmanFilter {
    states: usize,
    outputs: usize,
    model: FilterModel,
    f: Packed,
    g: Packed,
    h: Packed,
    /// None when there is no feed-through.
    d: Option<Packed>,
    x: Vec<Block>,
    innovation: Vec<Block>,
    independent: Vec<Block>,
    scratch: Vec<Block>,
    column: Vec<f64>,
    gain: DMatrix<f64>,
    whitening: DMatrix<f64>,
    p: DMatrix<f64>,
    work: DMatrix<f64>,
    /// Per phase of the pattern; the first serves while nothing is kept.
    phases: Vec<Phase>,
    pattern: Pattern,
    current: usize,
    nis: f64,
    dof: u32,
    started: bool,
}

/// The model of a [`KalmanFilter`] with n states, m inputs and p outputs.
#[derive(Debug, Clone, PartialEq)]
pub struct FilterModel {
    /// State transition F, n x n.
    pub f: DMatrix<f64>,
    /// Input matrix G, n x m.
    pub g: DMatrix<f64>,
    /// Output matrix H, p x n.
    pub h: DMatrix<f64>,
    /// Feed-through D, p x m.
    pub d: DMatrix<f64>,
    /// Covariance of the process noise over one step, n x n, positive semidefinite.
    pub q: DMatrix<f64>,
    /// Variances of the p measurements, positive.
    pub variance: Vec<f64>,
}

/// What a step needs once the covariance repeats.
#[derive(Debug, Clone)]
struct Phase {
    mask: u64,
    /// States x outputs.
    gain: Packed,
    /// Outputs x outputs: innovations to independent ones of unit variance.
    whitening: Packed,
    std: Vec<f64>,
    p: DMatrix<f64>,
}

/// Where the search for a repeating pattern stands.
#[derive(Debug, Clone)]
struct Pattern {
    recent: [u64; 2 * MAX_PERIOD],
    count: usize,
    state: Search,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Search {
    /// No pattern yet.
    Looking,
    /// A pattern of that many steps; the covariance of one pattern ago is in the first phase's `p`.
    Comparing { period: usize, done: usize },
    /// The covariance repeats; the phases are being filled.
    Filling { period: usize, done: usize },
    /// Kept gains are in use.
    Kept { period: usize, next: usize },
}

impl KalmanFilter {
    /// A filter that starts from zero with the given standard deviations of the n states.
    pub fn new(model: FilterModel, initial: &[f64]) -> Self {
        let (states, outputs) = (model.f.nrows(), model.h.nrows());
        let p = DMatrix::from_fn(states, states, |i, j| if i == j { initial[i] * initial[i] } else { 0.0 });
        let (gain, whitening) = (DMatrix::zeros(states, outputs), DMatrix::zeros(outputs, outputs));
        let phase = Phase {
            mask: 0,
            gain: Packed::new(&gain),
            whitening: Packed::new(&whitening),
            std: initial.to_vec(),
            p: p.clone(),
        };
        Self {
            states,
            outputs,
            f: Packed::new(&model.f),
            g: Packed::new(&model.g),
            h: Packed::new(&model.h),
            d: model.d.iter().any(|v| *v != 0.0).then(|| Packed::new(&model.d)),
            model,
            x: vec![[0.0; 4]; blocks(states)],
            innovation: vec![[0.0; 4]; blocks(outputs)],
            independent: vec![[0.0; 4]; blocks(outputs)],
            scratch: vec![[0.0; 4]; blocks(states)],
            column: vec![0.0; states],
            gain,
            whitening,
            work: p.clone(),
            p,
            phases: vec![phase; MAX_PERIOD],
            pattern: Pattern { recent: [0; 2 * MAX_PERIOD], count: 0, state: Search::Looking },
            current: 0,
            nis: 0.0,
            dof: 0,
            started: false,
        }
    }

    /// The model it runs on.
    pub fn model(&self) -> &FilterModel {
        &self.model
    }

    /// Estimated state.
    pub fn x(&self) -> &[f64] {
        &self.x.as_flattened()[..self.states]
    }

    /// Standard deviation of the estimate.
    pub fn std(&self) -> &[f64] {
        &self.phases[self.current].std
    }

    /// Covariance of the estimate, n x n.
    pub fn covariance(&self) -> &DMatrix<f64> {
        match self.pattern.state {
            Search::Kept { .. } => &self.phases[self.current].p,
            _ => &self.p,
        }
    }

    /// Normalised innovation squared of the last step, chi-square with [`Self::dof`] degrees of freedom.
    pub fn nis(&self) -> f64 {
        self.nis
    }

    /// Number of measurements used in the last step.
    pub fn dof(&self) -> u32 {
        self.dof
    }

    /// Whether the gains have settled.
    pub fn settled(&self) -> bool {
        matches!(self.pattern.state, Search::Kept { .. })
    }

    /// Sets the state without touching its covariance.
    pub fn set_state(&mut self, x: &[f64]) {
        self.x.as_flattened_mut().iter_mut().take(self.states).zip(x).for_each(|(a, b)| *a = *b);
    }

    /// One step: prediction with the input that acted since the step before (none before the first), then the
    /// measurements whose bit in `mask` is set. `y` has p entries, the inputs m. Measurements that are not finite
    /// are left out.
    pub fn step(&mut self, y: &[f64], mask: u64, u_before: &[f64], u_now: &[f64]) {
        let mut mask = mask;
        for (i, v) in y.iter().enumerate().take(self.outputs) {
            if !v.is_finite() {
                mask &= !(1 << i);
            }
        }
        if y.len() < self.outputs {
            mask = 0;
        }
        if self.started {
            self.scratch.fill([0.0; 4]);
            self.f.add(&mut self.scratch, self.x.as_flattened());
            self.g.add(&mut self.scratch, u_before);
            std::mem::swap(&mut self.x, &mut self.scratch);
        }
        if let Search::Kept { period, next } = self.pattern.state {
            if self.phases[next].mask == mask {
                self.current = next;
                self.pattern.state = Search::Kept { period, next: (next + 1) % period };
                self.apply(y, mask, u_now);
                return;
            }
            self.p.copy_from(&self.phases[self.current].p);
            self.pattern.state = Search::Looking;
            self.pattern.count = 0;
        }
        if self.started {
            // Not nalgebra's product, which allocates for its packing.
            for j in 0..self.states {
                self.scratch.fill([0.0; 4]);
                self.f.add(&mut self.scratch, &self.p.as_slice()[j * self.states..(j + 1) * self.states]);
                self.work.column_mut(j).copy_from_slice(&self.scratch.as_flattened()[..self.states]);
            }
            self.p.copy_from(&self.model.q);
            // F P F' + Q.
            for j in 0..self.states {
                for k in 0..self.states {
                    let factor = self.model.f[(j, k)];
                    if factor != 0.0 {
                        for i in 0..self.states {
                            self.p[(i, j)] += self.work[(i, k)] * factor;
                        }
                    }
                }
            }
        }
        self.started = true;
        self.advance_search(mask);
        let slot = match self.pattern.state {
            Search::Filling { done, .. } => done,
            _ => 0,
        };
        self.update_covariance(slot, mask);
        self.current = slot;
        self.apply(y, mask, u_now);
        self.finish_search();
    }

    /// Gains, whitening and covariance for the measurements in `mask`, one at a time.
    fn update_covariance(&mut self, slot: usize, mask: u64) {
        let (n, p) = (self.states, self.outputs);
        self.gain.fill(0.0);
        self.whitening.fill(0.0);
        for i in 0..p {
            if mask >> i & 1 == 0 {
                continue;
            }
            // k = P h' / s; `column` holds it.
            let mut s = self.model.variance[i];
            for r in 0..n {
                let v: f64 = (0..n).map(|c| self.p[(r, c)] * self.model.h[(i, c)]).sum();
                self.column[r] = v;
                s += self.model.h[(i, r)] * v;
            }
            // The innovation left after the measurements before: row i of (I - H K).
            for j in 0..=i {
                let through: f64 = (0..n).map(|r| self.model.h[(i, r)] * self.gain[(r, j)]).sum();
                self.whitening[(i, j)] = f64::from(u8::from(i == j)) - through;
            }
            for r in 0..n {
                self.column[r] /= s;
            }
            for j in 0..=i {
                let w = self.whitening[(i, j)];
                for r in 0..n {
                    self.gain[(r, j)] += self.column[r] * w;
                }
                self.whitening[(i, j)] = w / s.sqrt();
            }
            // Joseph: T = (I - k h) P, then P = T (I - k h)' + r k k'.
            for c in 0..n {
                let hp: f64 = (0..n).map(|r| self.model.h[(i, r)] * self.p[(r, c)]).sum();
                for r in 0..n {
                    self.work[(r, c)] = self.p[(r, c)] - self.column[r] * hp;
                }
            }
            for r in 0..n {
                let th: f64 = (0..n).map(|c| self.work[(r, c)] * self.model.h[(i, c)]).sum();
                for c in 0..=r {
                    let v = self.work[(r, c)] - th * self.column[c]
                        + self.model.variance[i] * self.column[r] * self.column[c];
                    self.p[(r, c)] = v;
                    self.p[(c, r)] = v;
                }
            }
        }
        let phase = &mut self.phases[slot];
        phase.mask = mask;
        phase.gain.fill(&self.gain);
        phase.whitening.fill(&self.whitening);
        for r in 0..n {
            phase.std[r] = self.p[(r, r)].max(0.0).sqrt();
        }
    }

    /// Innovations, NIS and the state.
    fn apply(&mut self, y: &[f64], mask: u64, u_now: &[f64]) {
        let phase = &self.phases[self.current];
        for (i, v) in self.innovation.as_flattened_mut().iter_mut().enumerate().take(self.outputs) {
            // What is left out may be NaN, which no zero gain would stop.
            *v = if mask >> i & 1 == 1 { y[i] } else { 0.0 };
        }
        self.h.subtract(&mut self.innovation, self.x.as_flattened());
        if let Some(d) = &self.d {
            d.subtract(&mut self.innovation, u_now);
        }
        let innovation = &self.innovation.as_flattened()[..self.outputs];
        phase.gain.add(&mut self.x, innovation);
        self.independent.fill([0.0; 4]);
        phase.whitening.add(&mut self.independent, innovation);
        self.nis = self.independent.as_flattened().iter().map(|v| v * v).sum();
        self.dof = mask.count_ones();
    }

    /// Takes note of this step's mask and decides what the step is for.
    fn advance_search(&mut self, mask: u64) {
        let pattern = &mut self.pattern;
        pattern.recent[pattern.count % (2 * MAX_PERIOD)] = mask;
        pattern.count += 1;
        let ago = |k: usize| pattern.recent[(pattern.count - 1 - k) % (2 * MAX_PERIOD)];
        match pattern.state {
            Search::Comparing { period, .. } | Search::Filling { period, .. } if ago(0) != ago(period) => {
                pattern.state = Search::Looking;
            }
            _ => {}
        }
        if pattern.state == Search::Looking
            && pattern.count >= 2 * MAX_PERIOD
            && pattern.count.is_multiple_of(16)
        {
            let period = (1..=MAX_PERIOD).find(|&p| (0..2 * MAX_PERIOD - p).all(|k| ago(k) == ago(k + p)));
            if let Some(period) = period {
                pattern.state = Search::Comparing { period, done: 0 };
            }
        }
    }

    /// After the covariance of this step is known: does it repeat, are the phases complete?
    fn finish_search(&mut self) {
        match self.pattern.state {
            Search::Comparing { period, done } => {
                if done == 0 {
                    self.phases[1].p.copy_from(&self.p);
                    self.pattern.state = Search::Comparing { period, done: 1 };
                } else if done < period {
                    self.pattern.state = Search::Comparing { period, done: done + 1 };
                } else if self.repeats(period) {
                    self.pattern.state = Search::Filling { period, done: 0 };
                } else {
                    self.phases[1].p.copy_from(&self.p);
                    self.pattern.state = Search::Comparing { period, done: 1 };
                }
            }
            Search::Filling { period, done } => {
                self.phases[done].p.copy_from(&self.p);
                self.pattern.state = if done + 1 == period {
                    Search::Kept { period, next: 0 }
                } else {
                    Search::Filling { period, done: done + 1 }
                };
            }
            Search::Looking | Search::Kept { .. } => {}
        }
    }

    fn repeats(&self, period: usize) -> bool {
        let before = &self.phases[1].p;
        let tolerance = SETTLED * period as f64;
        (0..self.states).all(|j| {
            (0..=j).all(|i| {
                let size = (self.p[(i, i)] * self.p[(j, j)]).sqrt();
                (self.p[(i, j)] - before[(i, j)]).abs() <= tolerance * size
            })
        })
    }
}
