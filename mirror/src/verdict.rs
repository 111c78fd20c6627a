//! The result of a search: probabilities from log-likelihood ratios, and a named cause or none.

use crate::bank::Bank;
use crate::candidates::Candidate;
use crate::capture::Capture;
use crate::excess;
use crate::finding::{Cause, Value};
use crate::known::Knowledge;
use crate::predictor::Predictor;
use crate::replay::distance;

/// Probability above which a cause is named; the other candidates together have at most one in fifty.
pub const CERTAIN: f64 = 0.98;

/// Number of candidates in the final evaluation.
pub const LIKELIEST: usize = 5;

/// Two candidates are indistinguishable when the distance of their predictions is below this share of the
/// best candidate's evidence. When all data have been searched, a remaining change with less than this share
/// of it, such as a few messages that a busy machine delayed, withholds no name.
const SAME: f64 = 0.01;

/// A candidate with its best parameters.
#[derive(Debug, Clone)]
pub struct Fit {
    pub values: Vec<f64>,
    pub since: u64,
    /// Evidence minus the penalty for the number of parameters.
    pub score: f64,
    pub evidence: f64,
    pub spread: Option<Vec<f64>>,
    /// Log-likelihood ratio of the clearest change that remains; 0 without one.
    pub left: f64,
    /// Whether the parameters are at a local maximum.
    pub settled: bool,
}

/// Result of a search.
#[derive(Debug, Clone)]
pub enum Answer {
    /// Cause, onset and evidence.
    Cause(Box<Cause>, u64, f64),
    /// The data are not sufficient yet.
    Open,
    /// No candidate explains the change.
    Unexplained,
}

/// Indices of the candidates, the likeliest first.
pub fn ranking(fits: &[Option<Fit>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..fits.len()).filter(|i| fits[*i].is_some()).collect();
    let score = |i: &usize| fits[*i].as_ref().map_or(f64::NEG_INFINITY, |f| f.score);
    order.sort_by(|a, b| score(b).total_cmp(&score(a)));
    order
}

/// All candidates after a search over the steps from `since` to `end`.
pub struct Standing<'a> {
    pub candidates: &'a [Candidate],
    pub fits: &'a [Option<Fit>],
    /// Tests for a remaining change.
    pub bank: Bank,
    pub since: u64,
    pub end: u64,
    /// Whether no more data will be stored.
    pub is_last: bool,
}

impl Standing<'_> {
    /// The answer that the fits of all candidates support.
    pub fn answer(&self, known: &Knowledge, like: &Predictor, capture: &Capture) -> Answer {
        let order = ranking(self.fits);
        let others = excess::all(known, like, capture, self.since, self.end);
        let scored = |e: &excess::Excess| e.evidence - 0.5 * e.parameters as f64 * (e.samples as f64).ln();
        let loud = others.iter().max_by(|a, b| scored(a).total_cmp(&scored(b)));
        let top = order.first().and_then(|i| self.fits[*i].as_ref().map(|f| f.score));
        let best = top.into_iter().chain(loud.map(scored)).fold(f64::NEG_INFINITY, f64::max);
        let weight = |score: f64| (score - best).exp();
        let total: f64 = self.fits.iter().flatten().map(|f| weight(f.score)).sum::<f64>()
            + others.iter().map(|e| weight(scored(e))).sum::<f64>();
        if let Some(loud) = loud.filter(|l| top.is_none_or(|top| scored(l) > top)) {
            let probability = weight(scored(loud)) / total;
            let cause = Cause {
                effect: loud.effect.clone(),
                values: loud.values.clone(),
                probability,
                indistinguishable: Vec::new(),
            };
            if probability < CERTAIN || scored(loud) <= 0.0 {
                return Answer::Open;
            }
            let bank = self.bank.clone();
            let left = excess::left(known, capture, loud, self.since, self.end, bank);
            return match self.withholds(left, loud.evidence) {
                false => Answer::Cause(Box::new(cause), self.since, loud.evidence),
                true => Answer::Unexplained,
            };
        }
        let Some(&first) = order.first() else { return Answer::Unexplained };
        let Some(fit) = &self.fits[first] else { return Answer::Unexplained };
        let same = self.indistinguishable(known, like, capture, first, &order);
        let is_one = |i: &usize| same.contains(i) || self.candidates[*i].is_same(&self.candidates[first]);
        let one = order.iter().filter(|i| is_one(i));
        let share: f64 = one.filter_map(|i| self.fits[*i].as_ref()).map(|f| weight(f.score)).sum();
        let probability = share / total;
        if probability < CERTAIN || fit.score <= 0.0 {
            return Answer::Open;
        }
        if self.withholds(fit.left, fit.evidence) {
            return Answer::Unexplained;
        }
        match self.cause(first, fit, &same, probability) {
            Some(cause) => Answer::Cause(Box::new(cause), fit.since, fit.evidence),
            None => Answer::Unexplained,
        }
    }

    /// Whether a remaining change with evidence `left` withholds the name of a cause with this evidence.
    fn withholds(&self, left: f64, evidence: f64) -> bool {
        left > 0.0 && !(self.is_last && left < SAME * evidence)
    }

    fn cause(&self, first: usize, fit: &Fit, same: &[usize], probability: f64) -> Option<Cause> {
        let candidate = &self.candidates[first];
        let values = candidate.open.iter().enumerate().map(|(k, open)| {
            let spread = fit.spread.as_ref().map_or(f64::INFINITY, |s| s[k]);
            let value = fit.values[k];
            let (low, high) = (value - 1.96 * spread, value + 1.96 * spread);
            Value { name: open.name, value, low: low.max(open.lower), high: high.min(open.upper) }
        });
        Some(Cause {
            effect: candidate.effect(&fit.values)?,
            values: values.collect(),
            probability,
            indistinguishable: same
                .iter()
                .map(|i| (self.candidates[*i].kind, self.candidates[*i].place.clone()))
                .collect(),
        })
    }

    /// Candidates whose predictions are practically equal to those of the candidate `first`.
    fn indistinguishable(
        &self,
        known: &Knowledge,
        like: &Predictor,
        capture: &Capture,
        first: usize,
        order: &[usize],
    ) -> Vec<usize> {
        let believed = |index: usize| {
            let fit = self.fits[index].as_ref()?;
            self.candidates[index].belief(&fit.values, fit.since)
        };
        let Some(best) = &self.fits[first] else { return Vec::new() };
        let near = order.iter().copied().filter(|i| {
            let apart = !self.candidates[*i].is_same(&self.candidates[first]);
            apart && self.fits[*i].as_ref().is_some_and(|f| best.score - f.score < 7.0)
        });
        let alike = |&other: &usize| {
            let pair = believed(first).zip(believed(other));
            let apart = pair.and_then(|(a, b)| distance(known, like, capture, (&a, &b), self.end));
            apart.is_some_and(|apart| apart < SAME * best.evidence)
        };
        near.take(LIKELIEST).filter(alike).collect()
    }
}
