//! Checks of the data themselves, before any cause is searched for.

use crate::thresholds::{GAP_STEPS, MIN_BIC_GAIN, SAME_SIGNAL_FIT, STUCK_SHARE};
use whirlstand_ident::compare::gaps::bridged_s;
use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

use crate::answer::schema::DataFinding;
use crate::data::outliers::Excluded;
use crate::data::record::Data;
use crate::model::free_run::FreeRun;
use crate::model::predictor::{gain_beside_declared, gain_of_inputs};
use whirlstand_logs::stats::{median, rms};

fn finding(kind: &str, place: &str, blocking: bool, text: String) -> DataFinding {
    DataFinding { kind: kind.into(), place: place.into(), text, blocking }
}

/// Finding: a long record is diagnosed at a coarser period.
pub fn thinned(period_s: f64) -> DataFinding {
    let text = format!(
        "the record is long and was resampled to {period_s:.6} s; --period S sets a shorter period, which takes longer"
    );
    finding("long", "t", false, text)
}

/// Findings on the clock and the values of a record.
pub fn record(record: &Record, vehicle: &Vehicle) -> Vec<DataFinding> {
    let mut found = Vec::new();
    let steps: Vec<f64> = record.time.windows(2).map(|t| t[1] - t[0]).collect();
    let typical = median(&steps);
    if typical > 0.0 {
        let found_gaps: Vec<(f64, f64)> = record
            .time
            .windows(2)
            .filter(|t| t[1] - t[0] > GAP_STEPS * typical)
            .map(|t| (t[0], t[1] - t[0]))
            .collect();
        if let Some(longest) = found_gaps.iter().max_by(|a, b| a.1.total_cmp(&b.1)) {
            let lost: f64 = found_gaps.iter().map(|g| g.1 - typical).sum();
            let share = lost / record.duration();
            let bridged = bridged_s(record, vehicle, typical);
            let cut = found_gaps.iter().filter(|g| g.1 > bridged).count();
            let text = format!(
                "{} gaps, {:.1} % of the record in total, the longest {:.3} s at {:.3} s; predictions continue through gaps of up to {bridged:.3} s, {}",
                found_gaps.len(),
                100.0 * share,
                longest.1,
                longest.0,
                if cut > 0 {
                    format!("and {cut} longer ones split the record")
                } else {
                    "and none is longer".into()
                }
            );
            found.push(finding("gap", "t", share > 0.5, text));
        }
        let uneven = steps.iter().filter(|s| (*s - typical).abs() > 0.25 * typical).count();
        let share = uneven as f64 / steps.len().max(1) as f64;
        if share > 0.05 {
            let text = format!(
                "{:.0} % of the steps differ from the median step of {typical:.6} s by more than a quarter; outputs are interpolated, and effects shorter than a step cannot be detected",
                100.0 * share
            );
            found.push(finding("uneven", "t", false, text));
        }
    }
    let names = vehicle.inputs.iter().map(|i| &i.name).chain(vehicle.outputs.iter().map(|o| &o.name));
    for signal in names.filter_map(|n| record.get(n)) {
        let missing = signal.values.iter().filter(|v| !v.is_finite()).count();
        let share = missing as f64 / signal.values.len().max(1) as f64;
        let regular = vehicle.output_index(&signal.name).is_some_and(|i| vehicle.outputs[i].every > 1);
        if missing > 0 && !regular && share < 0.45 {
            let text = format!(
                "{missing} of {} values of {} are not numbers; they are not used",
                signal.values.len(),
                signal.name
            );
            found.push(finding("not_a_number", &signal.name, false, text));
        }
    }
    found
}

/// Finding: samples that were left out because they lie far from their neighbours.
pub fn excluded(excluded: &Excluded, data: &Data, vehicle: &Vehicle) -> DataFinding {
    let channel = &data.channels[excluded.channel];
    let name = &vehicle.outputs[channel.output].name;
    let first = excluded.samples.first().map_or(0, |k| channel.step(*k));
    let text = format!(
        "samples of {name} that lie far from their neighbours are not used: {}, the first at {:.3} s",
        excluded.samples.len(),
        data.start_s + first as f64 * data.period_s
    );
    finding("outliers", name, false, text)
}

/// Finds channels that stood still, and excludes those samples.
pub fn stuck(data: &mut Data, vehicle: &Vehicle) -> Vec<DataFinding> {
    let mut found = Vec::new();
    let (start_s, period_s) = (data.start_s, data.period_s);
    for channel in &mut data.channels {
        let name = &vehicle.outputs[channel.output].name;
        let n = channel.values.len();
        let least = ((STUCK_SHARE * n as f64) as usize).max(30);
        let mut from = 0;
        let mut runs = Vec::new();
        for k in 1..=n {
            if k == n || channel.values[k] != channel.values[from] {
                if k - from >= least && channel.values[from].is_finite() {
                    runs.push((from, k));
                }
                from = k;
            }
        }
        // A coarse sensor repeats itself by rounding.
        if !runs.is_empty()
            && crate::data::sample_effects::is_coarse(channel, &vehicle.outputs[channel.output])
        {
            continue;
        }
        let spread = channel
            .values
            .iter()
            .filter(|v| v.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |s, v| (s.0.min(*v), s.1.max(*v)));
        // Samples stuck at the largest or smallest value of all are a limit, which is an effect of its own.
        runs.retain(|r| {
            let v = channel.values[r.0];
            spread.0 == spread.1 || v > spread.0 && v < spread.1
        });
        if runs.is_empty() {
            continue;
        }
        let still: usize = runs.iter().map(|r| r.1 - r.0).sum();
        for (a, b) in &runs {
            channel.good[*a..*b].fill(false);
            channel.early.retain(|k| !(*a..*b).contains(k));
        }
        let at = start_s + (channel.first + runs[0].0 * channel.stride) as f64 * period_s;
        let text = format!(
            "{name} is constant for {:.1} s from {at:.2} s ({:.0} % of the record in total): the sensor or its link failed; these samples are not used",
            (runs[0].1 - runs[0].0) as f64 * channel.stride as f64 * period_s,
            100.0 * still as f64 / n as f64
        );
        found.push(finding("stuck", name, still * 2 > n, text));
    }
    let good: Vec<bool> = data.channels.iter().map(|c| c.good.iter().any(|g| *g)).collect();
    let mut at = 0;
    data.channels.retain(|_| {
        at += 1;
        good[at - 1]
    });
    found
}

/// Findings on inputs without excitation.
pub fn excitation(data: &Data, vehicle: &Vehicle) -> Vec<DataFinding> {
    let mut found = Vec::new();
    let mut still = Vec::new();
    for (j, input) in vehicle.inputs.iter().enumerate() {
        let u: Vec<f64> = data.input(j).collect();
        let mean = whirlstand_logs::stats::mean(&u);
        let spread = rms(&u.iter().map(|v| v - mean).collect::<Vec<_>>());
        let peak = u.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        if spread <= 1e-6 * peak.max(1e-12) {
            // A step that is present from the first sample on excites the vehicle where the outputs respond
            // to it: beside fitted noise, or beside the declared noise, of which a slow response is no part.
            let answers = |gain: fn(&Vehicle, &Data, &[usize]) -> Option<f64>| {
                gain(vehicle, data, &[j]).is_some_and(|g| g > MIN_BIC_GAIN)
            };
            let moved = peak > 0.0 && (answers(gain_of_inputs) || answers(gain_beside_declared));
            if !moved {
                still.push(input.name.clone());
            }
            continue;
        }
        let at_limit = u.iter().filter(|v| **v <= input.lower || **v >= input.upper).count();
        if at_limit * 2 > u.len() {
            let text = format!(
                "{} is at a limit of the vehicle for {:.0} % of the record, where its effect cannot be determined; fly with a smaller amplitude",
                input.name,
                100.0 * at_limit as f64 / u.len() as f64
            );
            found.push(finding("saturated", &input.name, at_limit * 10 > u.len() * 9, text));
        }
    }
    if !still.is_empty() {
        let all = still.len() == vehicle.inputs.len();
        let text = format!(
            "{} {} not change: effects on {} cannot be detected; fly doublets or a multistep on it (whirlstand excite)",
            still.join(" and "),
            if still.len() == 1 { "does" } else { "do" },
            if still.len() == 1 { "it" } else { "them" }
        );
        found.push(finding("no_excitation", &still.join(","), all, text));
    }
    found
}

/// Share of `y` that a simulated signal explains: 1 - |y - s|^2 / |y|^2 of the varying parts.
fn fit(y: &[f64], s: &[f64]) -> f64 {
    let (my, ms) = (whirlstand_logs::stats::mean(y), whirlstand_logs::stats::mean(s));
    let error: f64 = y.iter().zip(s).map(|(y, s)| (y - my - (s - ms)).powi(2)).sum();
    let power: f64 = y.iter().map(|y| (y - my).powi(2)).sum();
    if power > 0.0 { 1.0 - error / power } else { 0.0 }
}

/// Finds channels that were swapped: the simulation of one channel fits the measurement of another.
pub fn channels(free_run: &FreeRun<'_>, predicted: &[f64], residual: &[f64]) -> Vec<DataFinding> {
    let data = free_run.data;
    let vehicle = &free_run.vehicle;
    let ranges = data.ranges();
    let name = |c: usize| vehicle.outputs[data.channels[c].output].name.as_str();
    let measured: Vec<f64> = predicted.iter().zip(residual).map(|(p, r)| p + r).collect();
    let mut found = Vec::new();
    let p = data.channels.len();
    let own_fits: Vec<f64> =
        (0..p).map(|c| fit(&measured[ranges[c].clone()], &predicted[ranges[c].clone()])).collect();
    for a in 0..p {
        for b in a + 1..p {
            let (ya, yb) = (&measured[ranges[a].clone()], &measured[ranges[b].clone()]);
            let (sa, sb) = (&predicted[ranges[a].clone()], &predicted[ranges[b].clone()]);
            if ya.len() != yb.len() {
                continue;
            }
            let (ab, ba) = (fit(ya, sb), fit(yb, sa));
            if ab > SAME_SIGNAL_FIT
                && ba > SAME_SIGNAL_FIT
                && ab > own_fits[a] + 0.3
                && ba > own_fits[b] + 0.3
            {
                let text = format!(
                    "{} and {} are swapped: each matches the simulation of the other. Rename them with --map {}={} --map {}={}",
                    name(a),
                    name(b),
                    name(a),
                    name(b),
                    name(b),
                    name(a)
                );
                found.push(finding("swapped", &format!("{},{}", name(a), name(b)), true, text));
            }
        }
    }
    found
}

/// Finds inputs that were swapped: the vehicle responds to the other one.
pub fn inputs(
    free_run: &FreeRun<'_>,
    initial: &[f64],
    predicted: &[f64],
    residual: &[f64],
) -> Vec<DataFinding> {
    let data = free_run.data;
    let ranges = data.ranges();
    let measured: Vec<f64> = predicted.iter().zip(residual).map(|(p, r)| p + r).collect();
    let quality = |s: &[f64]| -> f64 {
        let fits = ranges.iter().map(|r| fit(&measured[r.clone()], &s[r.clone()]).max(-1.0));
        fits.sum::<f64>() / ranges.len() as f64
    };
    let own = quality(predicted);
    let attempt = |change: &dyn Fn(&mut [f64])| -> f64 {
        let mut changed = data.clone();
        changed.inputs.chunks_exact_mut(data.m).for_each(change);
        let moved = FreeRun::new(&free_run.vehicle, &changed);
        moved.run(&[], initial).map_or(-1.0, |s| quality(&s))
    };
    let inputs = &free_run.vehicle.inputs;
    let mut found = Vec::new();
    for j in 0..data.m {
        for i in j + 1..data.m {
            let swapped = attempt(&|u: &mut [f64]| u.swap(i, j));
            if swapped > SAME_SIGNAL_FIT && swapped > own + 0.4 {
                let (a, b) = (&inputs[j].name, &inputs[i].name);
                let text = format!(
                    "{a} and {b} are swapped: the vehicle responds to each as if it were the other. Rename them with --map {a}={b} --map {b}={a}"
                );
                found.push(finding("swapped", &format!("{a},{b}"), true, text));
            }
        }
    }
    found
}
