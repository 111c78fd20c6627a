//! A tuning as text for the terminal and as a page.

use whirlstand_campaign::Proportion;
use whirlstand_control::design::LoopFigures;
use whirlstand_logs::shown::{number, shown};
use whirlstand_logs::stats;
use whirlstand_msgs::units::ShownUnit;
use whirlstand_report::{Fan, LawLine, TuneReport, tune_report};
use whirlstand_vehicle::Vehicle;

use super::answer::Tuning;
use super::judge::{LawFigures, Spread};
use super::trials::Motion;
use crate::error::Failure;
use crate::style;

/// Number of frequencies at which the sensitivity is shown.
const FREQUENCIES: usize = 240;

/// Lines of the table: figure, before, after.
fn lines(t: &Tuning) -> Vec<LawLine> {
    let mut lines = Vec::new();
    let mut add = |what: &str, before: String, after: String| {
        lines.push(LawLine { what: what.into(), before, after });
    };
    let spread = |s: Option<&Spread>, unit: &ShownUnit| {
        s.map_or("-".into(), |s| {
            format!("{} ({} to {})", unit.text(s.median), unit.text(s.low), unit.text(s.high))
        })
    };
    let one = ShownUnit::default();
    add("cost", spread(t.before.cost.as_ref(), &one), spread(t.after.cost.as_ref(), &one));
    for key in
        t.before.figures.keys().chain(t.after.figures.keys().filter(|k| !t.before.figures.contains_key(*k)))
    {
        let unit = t.before.units.get(key).unwrap_or(&one);
        add(key, spread(t.before.figures.get(key), unit), spread(t.after.figures.get(key), unit));
    }
    let percent =
        |p: Proportion| format!("{:.1} % ({:.1} to {:.1} %)", 100.0 * p.share, 100.0 * p.low, 100.0 * p.high);
    let chance = |of: &dyn Fn(&LawFigures) -> Proportion| (percent(of(&t.before)), percent(of(&t.after)));
    let (before, after) = chance(&|f| f.probability_unstable);
    add("probability of losing the vehicle", before, after);
    let (before, after) = chance(&|f| f.probability_violated);
    add("probability of breaking [expect]", before, after);
    let of = |figures: &Option<LoopFigures>,
              get: &dyn Fn(&whirlstand_control::design::EstimatedLoop) -> String| {
        match figures {
            Some(LoopFigures::Known(known)) => get(known),
            _ => "-".into(),
        }
    };
    let mut margin = |what: &str, get: &dyn Fn(&whirlstand_control::design::EstimatedLoop) -> String| {
        add(what, of(&t.loop_before, get), of(&t.loop_after, get));
    };
    margin("stable with its filter", &|l| if l.spectral_radius < 1.0 { "yes".into() } else { "no".into() });
    margin("peak sensitivity", &|l| number(l.multivariable_margins.max_sensitivity));
    margin("delay margin", &|l| {
        let least = l.loop_margins.iter().filter_map(|m| m.delay_s).fold(f64::INFINITY, f64::min);
        if least.is_finite() { shown(least, "s") } else { "any".into() }
    });
    lines
}

/// The text for the terminal.
pub(super) fn screen(t: &Tuning) -> String {
    let mut text = format!("{}  {}\n", style::strong("diagnosis"), t.diagnosis);
    for cause in &t.causes {
        let parameters = cause.parameters.iter().map(|(name, e)| {
            format!("{name} {} ({} to {})", e.unit.text(e.value), e.unit.text(e.low), e.unit.text(e.high))
        });
        let parameters: Vec<String> = parameters.collect();
        text.push_str(&format!("  {} of {}: {}\n", cause.effect, cause.place, parameters.join(", ")));
    }
    for l in &t.left_out {
        text.push_str(&format!("  not used: {} of {}: {}\n", l.effect, l.place, l.why));
    }
    text.push_str(&format!(
        "\n{} on {} draws of the extended vehicle, median (95 %)\n",
        style::strong("both laws"),
        t.draws
    ));
    for line in lines(t) {
        text.push_str(&format!("  {:<34} {:<34} -> {}\n", line.what, line.before, line.after));
    }
    text.push_str(&retuned_text(t));
    text.push_str(&truth_text(t));
    text.push_str(&format!("\n{}\n", verdict(t)));
    let vehicle = t.extended_vehicle.as_ref().map_or(String::new(), |v| format!("   vehicle {v}"));
    text.push_str(&format!("run {}{vehicle}   report {}\n", t.tuned, t.report));
    text
}

/// Text on the chosen weights and the draws that they were chosen on.
fn retuned_text(t: &Tuning) -> String {
    let Some(r) = &t.retuned else { return String::new() };
    let factors = r.factors.iter().map(|(name, factor)| format!("{name} x {}", number(*factor)));
    format!(
        "\n{}  {}\n  {} {} -> {} on draws {} to {}; {} tried, {} rejected; peak sensitivity {} of at most {}\n",
        style::strong("weights"),
        factors.collect::<Vec<_>>().join(", "),
        r.against,
        number(r.before),
        number(r.after),
        r.first_draw,
        r.first_draw + r.draws - 1,
        r.tried,
        r.refused,
        r.sensitivity.map_or("-".into(), number),
        number(r.sensitivity_limit)
    )
}

/// Text on the results of the laws on the true vehicle.
fn truth_text(t: &Tuning) -> String {
    let Some(truth) = &t.truth else { return String::new() };
    let cost = |f: &LawFigures| f.cost.map_or("lost".into(), |c| number(c.median));
    format!(
        "\n{}  cost {} -> {}, designed on the truth {}; share of the gain {}\n",
        style::strong("on the truth"),
        cost(&truth.before),
        cost(&truth.after),
        cost(&truth.designed),
        truth.share.map_or("-".into(), number)
    )
}

fn verdict(t: &Tuning) -> String {
    let kept = if t.gain.certain { "The new law is kept" } else { "The old law is kept" };
    let ratio = match (t.gain.cost_ratio, t.gain.cost_ratio_low, t.gain.cost_ratio_high) {
        (Some(ratio), Some(low), Some(high)) => {
            format!(
                "; its cost is {} times the old one's ({} to {})",
                number(ratio),
                number(low),
                number(high)
            )
        }
        _ => String::new(),
    };
    format!("{kept}: {}{}.", t.gain.why, if t.gain.certain { ratio.as_str() } else { "" })
}

/// The page; `top` is the highest frequency of the sampled loop, rad/s.
pub(super) fn page(
    t: &Tuning,
    vehicle: &Vehicle,
    motions: [Vec<Motion>; 2],
    top: f64,
) -> Result<String, Failure> {
    let fans = (0..vehicle.states.len()).map(|i| Fan {
        name: vehicle.states[i].name.clone(),
        unit: vehicle.states[i].unit.shown(),
        laws: [0, 1].map(|law| fan(&motions[law], i, vehicle.states.len())),
    });
    let frequencies: Vec<f64> =
        (0..FREQUENCIES).map(|k| top * 1e-4 * 1e4f64.powf(k as f64 / (FREQUENCIES - 1) as f64)).collect();
    let known = |figures: &Option<LoopFigures>| match figures {
        Some(LoopFigures::Known(known)) => Some((**known).clone()),
        _ => None,
    };
    let loops = [known(&t.loop_before), known(&t.loop_after)];
    let sensitivity = loops
        .each_ref()
        .map(|l| l.as_ref().and_then(|l| l.sensitivity(&frequencies).ok()).unwrap_or_default());
    let report = TuneReport {
        title: format!("{} of {}", law_name(t), t.vehicle),
        verdict: verdict(t),
        kept: t.gain.certain,
        lines: lines(t),
        fans: fans.collect(),
        frequencies,
        sensitivity,
        poles: loops.map(|l| l.map_or_else(Vec::new, |l| l.poles)),
        text: style::plain(&screen(t)),
    };
    tune_report(&report).map_err(Failure::run)
}

fn law_name(t: &Tuning) -> String {
    let name = |law| {
        serde_json::to_value(law).ok().and_then(|v| Some(v.as_str()?.to_uppercase())).unwrap_or_default()
    };
    let (before, after) = (name(t.law_before), name(t.law_after));
    if before == after { after } else { format!("{before} and {after}") }
}

/// Time, and the quantiles 5 %, 50 % and 95 % of the draws.
fn fan(motions: &[Motion], state: usize, states: usize) -> [Vec<f64>; 4] {
    let points = motions.iter().map(|m| m.states.len() / states).max().unwrap_or(0);
    let spacing_s = motions.first().map_or(0.0, |m| m.spacing_s);
    let mut answer: [Vec<f64>; 4] = Default::default();
    for k in 0..points {
        let values: Vec<f64> =
            motions.iter().filter_map(|m| m.states.get(k * states + state)).copied().collect();
        answer[0].push(k as f64 * spacing_s);
        for (i, share) in [0.05, 0.5, 0.95].into_iter().enumerate() {
            answer[i + 1].push(stats::quantile(&values, share));
        }
    }
    answer
}
