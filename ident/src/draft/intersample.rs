//! What an input does between its samples: it is held, or goes straight from one to the next.

use super::blocks::Pair;
use super::error::DraftError;
use super::select::{Choice, Tried, refitted, select};
use super::structure::Signals;
use super::survey::Link;

/// Difference of log-likelihoods, less half of the parameters' price in the Bayesian information criterion, from which one of
/// two models is strongly preferred (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995: 2 ln B above 6).
const CLEARLY_LIKELIER: f64 = 3.0;

/// The structures of a link, with an input that is held between its samples, or, where it `may_be_straight`, nothing reacts and it
/// makes the record clearly likelier, with one that goes straight from one to the next; and the data with that input. In a closed
/// loop the next input also knows the next output, so that the likelihood says nothing about it; and inputs that were averaged to
/// longer steps are means over them already. A command that changes in single steps, with rest before and after, is held.
///
/// # Errors
/// As [`select`].
pub fn likelier(
    link: &Link,
    signals: &Signals,
    may_be_straight: bool,
) -> Result<(Pair, Option<Choice>), DraftError> {
    let held = select(&link.pair, signals, link.horizon, &link.own_past)?;
    if link.pair.reacts || !may_be_straight || changes_in_steps(&link.pair) {
        return Ok((link.pair.clone(), held));
    }
    let pair = link.pair.interpolated();
    let straight = Signals { intersample: pair.intersample, ..signals.clone() };
    let samples = link.pair.fitted.iter().flat_map(|s| &s.outputs).filter(|y| y.is_finite()).count() as f64;
    let criterion = |tried: &Tried| tried.fit.cost + 0.5 * tried.structure.parameters() as f64 * samples.ln();
    if let Some((chosen, _)) = &held {
        // One fit tells whether the others are worth it.
        let same = refitted(chosen, &pair, &straight, link.horizon)?;
        if same.is_none_or(|same| same.fit.cost > chosen.fit.cost) {
            return Ok((link.pair.clone(), held));
        }
    }
    let found = select(&pair, &straight, link.horizon, &link.own_past)?;
    let is_likelier = match (&held, &found) {
        (Some((held, _)), Some((found, _))) => criterion(found) + CLEARLY_LIKELIER < criterion(held),
        (held, found) => held.is_none() && found.is_some(),
    };
    Ok(if is_likelier { (pair, found) } else { (link.pair.clone(), held) })
}

/// True where most changes of the input stand alone: none from the sample before to the one before that, none after.
fn changes_in_steps(pair: &Pair) -> bool {
    let (mut alone, mut all) = (0, 0);
    for window in pair.fitted.iter().flat_map(|segment| segment.inputs.windows(4)) {
        let [before, change, after] = [0, 1, 2].map(|k| window[k] != window[k + 1]);
        all += usize::from(change);
        alone += usize::from(change && !before && !after);
    }
    2 * alone > all
}
