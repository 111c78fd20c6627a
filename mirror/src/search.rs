//! The search for the cause: the generalised likelihood ratio over effects, sizes and onsets, a part of it at
//! every step.
//!
//! Every candidate is replayed from the most likely onset with its initial sizes, which are improved by
//! Gauss-Newton steps; for the likeliest candidates the onset is varied too. The result are log-likelihood ratios
//! on the same data, each reduced by half the logarithm of the number of data for every parameter (Schwarz 1978).
//! They give probabilities with equal prior weights. The likeliest candidate is named once the probability of all
//! others together is below the permitted error (Baum and Veeravalli 1994).

use std::collections::VecDeque;

use crate::bank::Bank;
use crate::candidates::{Candidate, candidates};
use crate::capture::Capture;
use crate::excess;
use crate::known::Knowledge;
use crate::predictor::Predictor;
use crate::replay::{REACH_S, Trial, predictor};
use crate::verdict::{Answer, Fit, LIKELIEST, Standing, ranking};

/// Candidates whose onset is searched as well: those whose distance in score to the best is less than the greater
/// of this log-likelihood and this share of the best score.
const NEAR: (f64, f64) = (15.0, 0.2);
const MOST_NEAR: usize = 16;

/// Most Gauss-Newton steps, including halved ones.
const STEPS: u8 = 5;

/// Log-likelihood by which a candidate lies behind the best so that it is not looked at again in this change: more data
/// would have to be e^30 times against what there is. A share as well, since what explains half as much as the best is not
/// made its equal by another begin.
const HOPELESS: (f64, f64) = (30.0, 0.5);

/// Begins before the likeliest that the grid has, in shares of the time since then (one second at most), for an effect that
/// remembers where it began: play stands where the input was.
const BEGINS: [f64; 5] = [0.0, 0.0625, 0.125, 0.25, 0.5];

/// Data that the grid is looked at with, s, and points of it from which a search goes on.
const GRID_S: f64 = 2.0;
const POINTS: usize = 2;

/// What is left by the likeliest may be so small an error of its begin, in steps, as a finer search finds.
const FINE: u64 = 16;

/// Predictions that making a simulator costs, about.
const BUILDING: usize = 300;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Purpose {
    /// Evaluates the grid of initial sizes and onsets, without a Gauss-Newton step.
    Scan,
    /// Searches any onset and size.
    Look,
    /// Tries another onset.
    Shift,
    /// Makes the final evaluation of this search.
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
    /// Evidence, values and begin of the best points of each candidate's grid, the best first.
    grid: Vec<Vec<(f64, Vec<f64>, u64)>>,
    jobs: VecDeque<Job>,
    running: Option<(Job, Trial)>,
    purpose: Purpose,
    /// Shift of the onset that is being tried, steps.
    shift: u64,
    since: u64,
    end: u64,
    steps: f64,
    repeats: Vec<f64>,
    /// Whether the onset has been searched on a finer grid.
    fine: bool,
}

impl Search {
    /// A search for what changed at about `since`, with the data until `end`. `steps`: how many of them a bank that looks
    /// for what is left takes on average to alarm for nothing.
    pub fn new(known: &Knowledge, capture: &Capture, since: u64, end: u64, steps: f64) -> Self {
        let from = since.saturating_sub((REACH_S / known.period_s) as u64).max(capture.first());
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
            since,
            end,
            steps,
            repeats: excess::anyway(known),
        };
        search.scan(known.period_s, capture);
        search
    }

    /// Restarts the search with the data until `end`.
    pub fn again(&mut self, known: &Knowledge, capture: &Capture, end: u64) {
        let from = self.since.saturating_sub((REACH_S / known.period_s) as u64).max(capture.first());
        let fresh = candidates(known, capture, from, end);
        // Sizes follow from what moved; what was found keeps its place when the list is the same.
        let best = self.fits.iter().flatten().map(|f| f.score).fold(f64::NEG_INFINITY, f64::max);
        let behind = |f: &Fit| f.settled && f.score < best - HOPELESS.0 && f.score < HOPELESS.1 * best;
        let is_behind: Vec<bool> = self.fits.iter().map(|f| f.as_ref().is_some_and(behind)).collect();
        if fresh.len() == self.candidates.len() {
            // What holds another as a special case is at least as likely: limits to both sides are not given up before one is.
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

    /// Lays out the grid of those that have no size yet, or one that may be wrong.
    fn scan(&mut self, period_s: f64, capture: &Capture) {
        let first = capture.first();
        (self.purpose, self.fine) = (Purpose::Scan, false);
        self.grid = vec![Vec::new(); self.candidates.len()];
        let best = self.fits.iter().flatten().map(|f| f.score).fold(f64::NEG_INFINITY, f64::max);
        let span = (self.end - self.since).min((1.0 / period_s) as u64) as f64;
        for (index, candidate) in self.candidates.iter().enumerate() {
            // What lies behind may have come to rest at the wrong size.
            let behind = |f: &Fit| f.evidence <= 0.0 || candidate.starts.len() > 1 && f.score < best - NEAR.0;
            if self.hopeless[index] || !self.fits[index].as_ref().is_none_or(behind) {
                continue;
            }
            let begins = if candidate.remembers() { &BEGINS[..] } else { &BEGINS[..1] };
            for (values, share) in candidate.starts.iter().flat_map(|s| begins.iter().map(move |b| (s, b))) {
                let since = self.since.saturating_sub((share * span) as u64).max(first + 1).min(self.since);
                // It stands where its input was.
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

    /// Keeps a point of the grid if it is among the best.
    fn keep(&mut self, job: Job, evidence: f64) {
        let points = &mut self.grid[job.candidate];
        let sizes = self.candidates[job.candidate].open.len();
        // One begin for each size: sizes are what a step of Gauss and Newton cannot find from afar.
        match points.iter_mut().find(|p| p.1[..sizes] == job.values[..sizes]) {
            Some(known) if known.0 < evidence => *known = (evidence, job.values, job.since),
            Some(_) => {}
            None => points.push((evidence, job.values, job.since)),
        }
        points.sort_by(|a, b| b.0.total_cmp(&a.0));
        // A size that is not the best yet may become it with another begin.
        let all = self.candidates[job.candidate].starts.len();
        let open = self.jobs.front().is_some_and(|next| next.candidate == job.candidate);
        points.truncate(if open { all } else { POINTS });
    }

    /// Continues the search by about the given number of predictions. Returns the answer when it has
    /// finished.
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
            let end = self.end.min(self.since + (GRID_S / known.period_s) as u64);
            return Some(Trial::new(all, moves, job.since, end, None));
        }
        for (k, open) in candidate.parameters().enumerate() {
            let mut values = job.values.clone();
            // The difference is taken inwards where the bound is near.
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
                unexplained: trial.unexplained,
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
            best.unexplained = trial.unexplained;
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
                let doubt = (self.end - self.since).min((1.0 / known.period_s) as u64);
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
                    since: self.since,
                    end: self.end,
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

    /// Whether the likeliest candidate leaves a change for which the tests would alarm.
    fn is_left(&self) -> bool {
        let first = ranking(&self.fits).first().and_then(|i| self.fits[*i].as_ref());
        first.is_some_and(|fit| fit.unexplained)
    }
}
