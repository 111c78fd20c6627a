//! The search for the cause: the generalised likelihood ratio over effects, parameters and onsets, computed
//! in parts over the steps of the loop.
//!
//! Every candidate is replayed from the most likely onset with its initial parameters, which are improved by
//! Gauss-Newton steps; for the likeliest candidates the onset is varied too. The results are log-likelihood
//! ratios on the same data, each reduced by half the logarithm of the number of data for every parameter
//! (Schwarz 1978). They give probabilities with equal priors. The likeliest candidate is named once the
//! probability of all others together is below the permitted error (Baum and Veeravalli 1994).

use std::collections::VecDeque;

use crate::bank::Bank;
use crate::candidates::{Candidate, candidates};
use crate::capture::Capture;
use crate::excess;
use crate::known::Knowledge;
use crate::onsets::Onset;
use crate::predictor::Predictor;
use crate::replay::{REACH_S, Trial, predictor};
use crate::verdict::{Answer, Fit, LIKELIEST, Standing, ranking};

/// Candidates whose onset is searched as well: those whose score is below the best by less than the greater
/// of this log-likelihood and this share of the best score.
const NEAR: (f64, f64) = (15.0, 0.2);
const MOST_NEAR: usize = 16;

/// Largest number of Gauss-Newton steps, including halved ones.
const STEPS: u8 = 5;

/// A candidate is excluded for the rest of this change when its score is below the best by more than this
/// log-likelihood (new data would need a likelihood ratio of e^30 against the present data) and below this
/// share of the best score (a candidate that explains half as much does not become equal with another onset).
const HOPELESS: (f64, f64) = (30.0, 0.5);

/// Length of the data for the grid after the alarm, s, and (`POINTS`) number of grid points from which the search continues.
const GRID_S: f64 = 2.0;
const POINTS: usize = 2;

/// Initial shift of the finer onset search, steps: a small onset error alone may leave a detectable change.
const FINE: u64 = 16;

/// Approximate cost of the construction of a simulator, in predictions.
const BUILDING: usize = 300;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Purpose {
    /// Evaluates the grid of initial parameters and onsets, without Gauss-Newton steps.
    Scan,
    /// Optimizes from the best grid points.
    Look,
    /// Tries another onset.
    Shift,
    /// Evaluates the likeliest candidates finally.
    Conclude,
}

struct Job {
    candidate: usize,
    values: Vec<f64>,
    /// Parameters from which a Gauss-Newton step started.
    from: Option<Vec<f64>>,
    since: u64,
    left: u8,
    purpose: Purpose,
}

/// A search that continues from step to step.
pub struct Search {
    candidates: Vec<Candidate>,
    fits: Vec<Option<Fit>>,
    hopeless: Vec<bool>,
    /// Evidence, parameters and onset of the best grid points of each candidate, the best first.
    grid: Vec<Vec<(f64, Vec<f64>, u64)>>,
    jobs: VecDeque<Job>,
    running: Option<(Job, Trial)>,
    purpose: Purpose,
    /// Shift of the onset that is being tried, in steps.
    shift: u64,
    onset: Onset,
    end: u64,
    steps: f64,
    repeats: Vec<f64>,
    /// Whether the onset has been searched on a finer grid.
    fine: bool,
}

impl Search {
    /// A search for the change at about `onset`, with the data until `end`; `steps` is the average run length to a
    /// false alarm of the bank that tests for a remaining change.
    pub fn new(known: &Knowledge, capture: &Capture, onset: Onset, end: u64, steps: f64) -> Self {
        let from = onset.since.saturating_sub((REACH_S / known.period_s) as u64).max(capture.first());
        let candidates = candidates(known, capture, from, end);
        let count = candidates.len();
        let mut search = Self {
            candidates,
            fits: vec![None; count],
            grid: vec![Vec::new(); count],
            hopeless: vec![false; count],
            jobs: VecDeque::new(),
            running: None,
            purpose: Purpose::Scan,
            fine: false,
            shift: 0,
            onset,
            end,
            steps,
            repeats: excess::anyway(known),
        };
        search.scan(known.period_s, capture);
        search
    }

    /// Restarts the search with the data until `end`.
    pub fn again(&mut self, known: &Knowledge, capture: &Capture, end: u64) {
        let from = self.onset.since.saturating_sub((REACH_S / known.period_s) as u64).max(capture.first());
        let fresh = candidates(known, capture, from, end);
        // The candidates follow from the captured motion; if their list has the same length, the earlier fits
        // are kept.
        let best = self.fits.iter().flatten().map(|f| f.score).fold(f64::NEG_INFINITY, f64::max);
        let behind = |f: &Fit| f.settled && f.score < best - HOPELESS.0 && f.score < HOPELESS.1 * best;
        let is_behind: Vec<bool> = self.fits.iter().map(|f| f.as_ref().is_some_and(behind)).collect();
        if fresh.len() == self.candidates.len() {
            // A general candidate is at least as likely as its special case: two-sided limits are kept as
            // long as a one-sided limit is.
            let all_are = |c: &Candidate| {
                self.candidates.iter().zip(&is_behind).all(|(other, behind)| *behind || !c.is_same(other))
            };
            self.hopeless = self.candidates.iter().map(all_are).collect();
            self.candidates = fresh;
        } else {
            (self.hopeless, self.fits) = (vec![false; fresh.len()], vec![None; fresh.len()]);
            self.candidates = fresh;
        }
        self.end = end;
        self.scan(known.period_s, capture);
    }

    /// The step after the last one of the data.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Sets up the grid for the candidates without a fit, or with one that may be a wrong local maximum.
    fn scan(&mut self, period_s: f64, capture: &Capture) {
        let first = capture.first();
        (self.purpose, self.fine) = (Purpose::Scan, false);
        self.grid = vec![Vec::new(); self.candidates.len()];
        let best = self.fits.iter().flatten().map(|f| f.score).fold(f64::NEG_INFINITY, f64::max);
        let second = (1.0 / period_s) as u64;
        for (index, candidate) in self.candidates.iter().enumerate() {
            // A low score may be a wrong local maximum.
            let behind = |f: &Fit| f.evidence <= 0.0 || candidate.starts.len() > 1 && f.score < best - NEAR.0;
            if self.hopeless[index] || !self.fits[index].as_ref().is_none_or(behind) {
                continue;
            }
            let onsets = self.onset.grid(candidate.remembers(), (first, self.end), second);
            for (values, since) in candidate.starts.iter().flat_map(|s| onsets.iter().map(move |o| (s, *o))) {
                // The effect holds the input before the onset.
                let stood = candidate
                    .memory
                    .as_ref()
                    .map(|(input, _)| capture.sample(since.saturating_sub(1).max(first)).u[*input]);
                self.jobs.push_back(Job {
                    candidate: index,
                    values: values.iter().copied().chain(stood).collect(),
                    from: None,
                    since,
                    left: 0,
                    purpose: Purpose::Scan,
                });
            }
        }
    }

    /// Continues from the previous results, and from the best points of the grid.
    fn look(&mut self) {
        self.purpose = Purpose::Look;
        for index in (0..self.candidates.len()).filter(|i| !self.hopeless[*i]) {
            let mut job = |values: Vec<f64>, since| {
                self.jobs.push_back(Job {
                    candidate: index,
                    values,
                    from: None,
                    since,
                    left: STEPS,
                    purpose: Purpose::Look,
                });
            };
            if let Some(fit) = self.fits[index].take() {
                job(fit.values, fit.since);
            }
            self.grid[index].drain(..).for_each(|(_, values, since)| job(values, since));
        }
    }

    /// Keeps a grid point if it is among the best of its candidate.
    fn keep(&mut self, job: Job, evidence: f64) {
        let points = &mut self.grid[job.candidate];
        let sizes = self.candidates[job.candidate].open.len();
        // One onset is kept for each set of initial parameters, which a Gauss-Newton step cannot reach from
        // far away.
        match points.iter_mut().find(|p| p.1[..sizes] == job.values[..sizes]) {
            Some(known) if known.0 < evidence => *known = (evidence, job.values, job.since),
            Some(_) => {}
            None => points.push((evidence, job.values, job.since)),
        }
        points.sort_by(|a, b| b.0.total_cmp(&a.0));
        // While grid points of this candidate remain, all are kept: another onset may improve a worse one.
        let all = self.candidates[job.candidate].starts.len();
        let open = self.jobs.front().is_some_and(|next| next.candidate == job.candidate);
        points.truncate(if open { all } else { POINTS });
    }

    /// Continues the search by about `budget` predictions. Returns the answer once the search is complete.
    pub fn work(
        &mut self,
        known: &Knowledge,
        like: &Predictor,
        capture: &Capture,
        budget: usize,
    ) -> Option<Answer> {
        let mut left = budget;
        while left > 0 {
            if self.running.is_none() {
                let Some(job) = self.jobs.pop_front() else {
                    if let Some(answer) = self.next_round(known, like, capture) {
                        return Some(answer);
                    }
                    continue;
                };
                let moved = if job.purpose == Purpose::Scan { 0 } else { job.values.len() };
                left = left.saturating_sub(BUILDING * (moved + 1));
                if let Some(trial) = self.trial(known, like, capture, &job) {
                    self.running = Some((job, trial));
                }
                continue;
            }
            let Some((job, mut trial)) = self.running.take() else { break };
            let steps = (left / trial.cost()).max(1);
            let taken = steps.min(64);
            if trial.go_on(capture, taken) {
                self.conclude(job, &trial);
            } else {
                self.running = Some((job, trial));
            }
            left = left.saturating_sub(taken * (self.running.as_ref().map_or(1, |r| r.1.cost())));
        }
        None
    }

    fn trial(&self, known: &Knowledge, like: &Predictor, capture: &Capture, job: &Job) -> Option<Trial> {
        let candidate = &self.candidates[job.candidate];
        let at = |values: &[f64]| predictor(known, like, capture, &candidate.belief(values, job.since)?);
        let mut all = vec![at(&job.values)?];
        let mut moves = Vec::new();
        if job.purpose == Purpose::Scan {
            let end = self.end.min(self.onset.since + self.onset.took + (GRID_S / known.period_s) as u64);
            return Some(Trial::new(all, moves, job.since, end, None));
        }
        for (k, open) in candidate.parameters().enumerate() {
            let mut values = job.values.clone();
            // The finite difference is taken inwards near the upper bound.
            let small = if values[k] + open.small > open.upper { -open.small } else { open.small };
            values[k] += small;
            all.push(at(&values)?);
            moves.push(small);
        }
        let check = (job.purpose == Purpose::Conclude).then(|| {
            let mut bank = Bank::new(&self.repeats, self.steps);
            bank.restart(job.since);
            bank
        });
        Some(Trial::new(all, moves, job.since, self.end, check))
    }

    fn conclude(&mut self, job: Job, trial: &Trial) {
        if job.purpose == Purpose::Scan {
            return self.keep(job, trial.evidence());
        }
        let candidate = &self.candidates[job.candidate];
        let evidence = trial.evidence();
        let score = evidence - 0.5 * job.values.len() as f64 * (trial.samples().max(2) as f64).ln();
        let best = &mut self.fits[job.candidate];
        if best.as_ref().is_none_or(|b| score > b.score) {
            *best = Some(Fit {
                values: job.values.clone(),
                since: job.since,
                score,
                evidence,
                spread: trial.spread(),
                left: trial.left,
                settled: false,
            });
        } else if let Some(from) = job.from.as_ref().filter(|_| job.left > 0) {
            // The step was too large: try half of it.
            let values = from.iter().zip(&job.values).map(|(a, b)| 0.5 * (a + b)).collect();
            self.jobs.push_front(Job { values, left: job.left - 1, ..job });
            return;
        } else if job.purpose == Purpose::Conclude
            && let Some(best) = best.as_mut().filter(|b| b.values == job.values && b.since == job.since)
        {
            best.left = trial.left;
            best.spread = trial.spread();
        }
        let newton = trial.newton().filter(|(_, gain)| *gain >= 0.05);
        if let Some(best) = best.as_mut().filter(|b| b.values == job.values) {
            best.settled = newton.is_none();
        }
        if job.left == 0 {
            return;
        }
        let Some((step, _)) = newton else { return };
        let moved = |(v, (s, o)): (&f64, (&f64, &crate::candidates::Open))| (v + s).clamp(o.lower, o.upper);
        let values: Vec<f64> =
            job.values.iter().zip(step.iter().zip(candidate.parameters())).map(moved).collect();
        if values != job.values {
            self.jobs.push_front(Job { values, from: Some(job.values), left: job.left - 1, ..job });
        }
    }

    fn next_round(&mut self, known: &Knowledge, like: &Predictor, capture: &Capture) -> Option<Answer> {
        match self.purpose {
            Purpose::Scan => {
                self.look();
                return None;
            }
            Purpose::Look => {
                self.purpose = Purpose::Shift;
                let doubt = (self.end - self.onset.since).min((1.0 / known.period_s) as u64);
                self.shift = (doubt / 2).next_power_of_two().max(1);
            }
            Purpose::Shift if self.shift > 1 => self.shift /= 2,
            Purpose::Shift => {
                self.purpose = Purpose::Conclude;
                for index in ranking(&self.fits).into_iter().take(LIKELIEST) {
                    let Some(fit) = &self.fits[index] else { continue };
                    let (values, since) = (fit.values.clone(), fit.since);
                    self.jobs.push_back(Job {
                        candidate: index,
                        values,
                        from: None,
                        since,
                        left: 2,
                        purpose: Purpose::Conclude,
                    });
                }
                return None;
            }
            Purpose::Conclude if !self.fine && self.is_left() => {
                (self.purpose, self.fine, self.shift) = (Purpose::Shift, true, FINE);
            }
            Purpose::Conclude => {
                let standing = Standing {
                    candidates: &self.candidates,
                    fits: &self.fits,
                    bank: Bank::new(&self.repeats, self.steps),
                    since: self.onset.since,
                    end: self.end,
                    is_last: capture.is_full() && self.end == capture.next(),
                };
                return Some(standing.answer(known, like, capture));
            }
        }
        let ranking = ranking(&self.fits);
        let score = |i: &usize| self.fits[*i].as_ref().map_or(f64::NEG_INFINITY, |f| f.score);
        let best = ranking.first().map_or(0.0, score);
        let near = |i: &usize| score(i) > best - NEAR.0.max(NEAR.1 * best);
        for index in ranking.iter().copied().filter(near).take(if self.fine { LIKELIEST } else { MOST_NEAR })
        {
            let Some(fit) = &self.fits[index] else { continue };
            let last = self.end.saturating_sub(8);
            for since in [fit.since.saturating_sub(self.shift), fit.since + self.shift] {
                if since > capture.first() && since < last {
                    let values = fit.values.clone();
                    self.jobs.push_back(Job {
                        candidate: index,
                        values,
                        from: None,
                        since,
                        left: if self.fine { STEPS } else { 1 },
                        purpose: Purpose::Shift,
                    });
                }
            }
        }
        None
    }

    /// Whether the likeliest candidate leaves a change that the tests detect.
    fn is_left(&self) -> bool {
        let first = ranking(&self.fits).first().and_then(|i| self.fits[*i].as_ref());
        first.is_some_and(|fit| fit.left > 0.0)
    }
}
