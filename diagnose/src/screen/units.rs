//! Columns recorded in another unit, with the opposite sign, or with a gross scale error.
//!
//! A unit error has one of a few known ratios, a fault any factor: a unit error is reported where the
//! interval of the estimated factor contains its ratio, and where physical faults (lost effectiveness, up to
//! twice the strength) would come near it only by chance. All columns of a kind in a wrong unit are preferred
//! over one alone.

use rayon::prelude::*;
use whirlstand_vehicle::Vehicle;

use super::gain::{self, Columns, Factor, scaled};
use super::resemblance::{foresight, integrates};
use super::responses::{Responses, linear};
use crate::answer::schema::{DataFinding, short};
use crate::data::record::Data;
use crate::thresholds::{
    CHANCE_FACTOR_SHARE, GREATEST_PHYSICAL_FACTOR, LONGEST_SCREEN_SHARE, MAX_WRONG_UNITS, MEMORY_GROWTH,
    OPPOSITE_SIGN, OVERSHADOWED_BIC, SAME_LOG_LIKELIHOOD, SEARCHED_FACTORS, SHORTEST_MEMORY_STEPS,
    UNIT_RATIOS, VEHICLE_GAIN_ERROR,
};

/// Columns that are too large by one ratio, which is negative for columns of the opposite sign.
#[derive(Debug, Clone)]
struct WrongUnit {
    /// Indices of the sources: channels, then inputs.
    members: Vec<usize>,
    /// Ratio of recorded to true values.
    ratio: f64,
    /// Other columns that would explain the same with another ratio.
    or: Option<(Vec<usize>, f64)>,
}

/// A tested unit error: log-likelihood and log-prior, columns, ratio.
type Trial<'g> = ((f64, f64), &'g Vec<usize>, f64);

/// Result under one predictor.
struct Weighed {
    columns: Columns,
    log_likelihood: f64,
    /// Factor by which every column is multiplied.
    weights: Vec<f64>,
    units: Vec<WrongUnit>,
}

/// Finds all wrong units of a record. Commands must be given as recorded, not limited.
pub(super) fn units(vehicle: &Vehicle, data: &Data) -> Vec<DataFinding> {
    let open = linear(vehicle);
    let groups = groups(vehicle, data);
    let longest = LONGEST_SCREEN_SHARE * data.steps as f64;
    let all = std::iter::successors(Some(SHORTEST_MEMORY_STEPS), |m| Some(MEMORY_GROWTH * m));
    let shortest_record = data.starts.iter().zip(data.starts.iter().skip(1).chain([&data.steps]));
    let shortest_record = shortest_record.map(|(a, b)| b - a).min().unwrap_or(data.steps);
    let skip = (3.0 * longest) as usize;
    if skip >= shortest_record {
        return Vec::new();
    }
    let memories: Vec<f64> = all.take_while(|m| *m <= longest.max(SHORTEST_MEMORY_STEPS)).collect();
    let weighed = memories.into_par_iter().filter_map(|steps| {
        let responses = Responses::new(&open, data, steps * data.period_s, skip)?;
        let declared = data.channels.iter().map(|c| c.declared).collect();
        Some(weigh(Columns::new(&responses, declared), &groups))
    });
    let weighed: Vec<Weighed> = weighed.collect();
    let Some(best) =
        (0..weighed.len()).max_by(|a, b| weighed[*a].log_likelihood.total_cmp(&weighed[*b].log_likelihood))
    else {
        return Vec::new();
    };
    let beside = &weighed[if best + 1 < weighed.len() { best + 1 } else { best.saturating_sub(1) }];
    let best = &weighed[best];
    // Where no command has an effect, the scale of the outputs is arbitrary.
    let p = data.channels.len();
    let shows = |s: usize| factor(best, beside, &[s]).is_some_and(|f| f.half < GREATEST_PHYSICAL_FACTOR.ln());
    if best.units.is_empty() || !(p..p + data.m).any(shows) {
        return Vec::new();
    }
    let units = best.units.iter().filter_map(|unit| {
        let left = factor(best, beside, &unit.members)?;
        Some((unit, Factor { log: unit.ratio.abs().ln() + left.log, ..left }))
    });
    let units: Vec<_> = units.collect();
    // Products of several ratios come close to any number, so that each of several must match exactly.
    let room = if best.units.len() == 1 { VEHICLE_GAIN_ERROR } else { 0.0 };
    let is_unit =
        |(unit, factor): &&(&WrongUnit, Factor)| is_certain(unit, factor, unit.members[0] >= p, room);
    let certain: Vec<_> = units.iter().filter(is_unit).collect();
    // For a vehicle with other errors than units, any gain may come close to one of their ratios.
    let is_all = |wrong: &[WrongUnit]| {
        foresight(vehicle, &mended(data, wrong.iter()), 0, true).contradicted.is_empty()
    };
    if !certain.is_empty() {
        let wrong: Vec<WrongUnit> = certain.iter().map(|(unit, _)| (*unit).clone()).collect();
        let all = certain.iter().map(|(unit, factor)| finding(vehicle, data, unit, factor));
        return if is_all(&wrong) { all.collect() } else { Vec::new() };
    }
    // A factor that is no ratio of units, and beyond what is searched for as a fault.
    let [(unit, factor)] = units[..] else { return Vec::new() };
    let own = WrongUnit { ratio: factor.log.exp(), ..unit.clone() };
    let beyond = unit.ratio > 0.0 && strengths(&factor, unit.members[0] >= p).0 > *SEARCHED_FACTORS.end();
    if beyond && is_all(std::slice::from_ref(&own)) {
        return vec![strange_size(vehicle, data, &own, &factor)];
    }
    Vec::new()
}

/// The record with its columns in the right units.
fn mended<'u>(data: &Data, units: impl Iterator<Item = &'u WrongUnit>) -> Data {
    let mut data = data.clone();
    for (unit, source) in units.flat_map(|unit| unit.members.iter().map(move |source| (unit, *source))) {
        match source.checked_sub(data.channels.len()) {
            Some(j) => data.inputs.chunks_exact_mut(data.m).for_each(|row| row[j] /= unit.ratio),
            None => data.channels[source].values.iter_mut().for_each(|v| *v /= unit.ratio),
        }
    }
    data
}

/// The most likely units under one predictor, added one after the other.
fn weigh(columns: Columns, groups: &[Vec<usize>]) -> Weighed {
    let mut weights = vec![1.0; columns.sources()];
    let mut log_likelihood = columns.likelihood(&weights).0;
    let mut found: Vec<WrongUnit> = Vec::new();
    while found.len() < MAX_WRONG_UNITS {
        let taken = |s: &usize| found.iter().any(|u| u.members.contains(s));
        let open = groups.iter().filter(|g| !g.iter().any(taken));
        let tried = open.flat_map(|g| ratios().map(move |r| (g, r)));
        let tried = tried.map(|(g, r)| (columns.likelihood(&scaled(&weights, g, 1.0 / r)), g, r));
        // The first of equally good ones: one column is preferred over several.
        let total = |l: (f64, f64)| l.0 + l.1;
        let tried: Vec<Trial<'_>> = tried.collect();
        let better = tried
            .iter()
            .copied()
            .reduce(|a, b| if total(b.0) > total(a.0) + SAME_LOG_LIKELIHOOD { b } else { a });
        let Some((best, members, ratio)) = better else { break };
        if 2.0 * (best.0 - log_likelihood) < OVERSHADOWED_BIC {
            break;
        }
        let same = |t: &&Trial<'_>| {
            !t.1.iter().any(|s| members.contains(s)) && total(t.0) > total(best) - SAME_LOG_LIKELIHOOD
        };
        let or = tried.iter().find(same).map(|t| (t.1.clone(), t.2));
        found.push(WrongUnit { members: members.clone(), ratio, or });
        (weights, log_likelihood) = (scaled(&weights, members, 1.0 / ratio), best.0);
    }
    Weighed { columns, log_likelihood, weights, units: found }
}

/// Remaining scale error of columns. The interval of the best predictor is widened by the difference to another one, and to
/// the estimate beside other inputs of any effectiveness, as one of them may have a fault: for a correct vehicle, all agree.
fn factor(best: &Weighed, beside: &Weighed, members: &[usize]) -> Option<Factor> {
    let left = |weighed: &Weighed, weights: &[f64]| gain::factor(&weighed.columns, weights, members);
    let (own, other) = (left(best, &best.weights)?, left(beside, &best.weights)?);
    let others = left(best, &gain::other_inputs_free(&best.columns, &best.weights, members))?;
    let half = own.half + (own.log - other.log).abs() + (own.log - others.log).abs();
    // Weights multiply a column: the scale error is their inverse.
    Some(Factor { log: -own.log, half })
}

/// Ratios of units, and the sign of another convention of axes.
fn ratios() -> impl Iterator<Item = f64> {
    UNIT_RATIOS.iter().flat_map(|r| [*r, 1.0 / r]).chain([OPPOSITE_SIGN])
}

/// Groups of columns that may share one wrong unit or sign: each alone, an angle with its rate, those of one
/// unit, all angles with their rates, all inputs.
fn groups(vehicle: &Vehicle, data: &Data) -> Vec<Vec<usize>> {
    let p = data.channels.len();
    let inputs: Vec<usize> = (p..p + data.m).collect();
    let si = |s: &usize| match s.checked_sub(p) {
        Some(j) => vehicle.inputs[j].unit.si_symbol(),
        None => vehicle.outputs[data.channels[*s].output].unit.si_symbol(),
    };
    let mut groups: Vec<Vec<usize>> = (0..p + data.m).map(|s| vec![s]).collect();
    let mut add = |group: Vec<usize>| {
        if group.len() > 1 && !groups.contains(&group) {
            groups.push(group);
        }
    };
    for (angle, rate) in (0..p).flat_map(|a| (0..p).map(move |b| (a, b))) {
        if integrates(vehicle, data, (angle, rate)) {
            add(vec![angle.min(rate), angle.max(rate)]);
        }
    }
    for range in [0..p, p..p + data.m] {
        for first in range.clone() {
            add(range.clone().filter(|s| si(s) == si(&first)).collect());
        }
    }
    add((0..p).filter(|s| ["rad", "rad/s"].contains(&si(s).as_str())).collect());
    add(inputs);
    groups
}

/// True when only the unit explains the factor: its interval contains the unit's ratio, and hardly any factor
/// of physical faults. Where no physical factor lies in the interval, the gains of the vehicle file may also
/// be wrong by `room`.
fn is_certain(unit: &WrongUnit, factor: &Factor, input: bool, room: f64) -> bool {
    let (low, high) = (factor.log - factor.half, factor.log + factor.half);
    let (weakest, strongest) = strengths(factor, input);
    // No fault turns a sign.
    let turned = unit.ratio < 0.0;
    let physical = if turned { 0.0 } else { (strongest.min(GREATEST_PHYSICAL_FACTOR) - weakest).max(0.0) };
    let room = if physical > 0.0 { 0.0 } else { room };
    let holds = |r: f64| low - room < r.abs().ln() && r.abs().ln() < high + room;
    let alone = !ratios().any(|r| r != unit.ratio && (r < 0.0) == turned && holds(r));
    // An interval as wide as the distance between ratios distinguishes none of them. An effect that the vehicle lacks changes
    // its gain by any factor of moderate size, but does not turn it: such a ratio has to be known as well as a gain that is kept.
    let least = UNIT_RATIOS.iter().copied().fold(f64::INFINITY, f64::min);
    let beyond_faults = turned || low.abs().min(high.abs()) > SEARCHED_FACTORS.end().ln();
    let narrow =
        if beyond_faults { 2.0 * factor.half < least.ln() } else { factor.half < VEHICLE_GAIN_ERROR };
    narrow && holds(unit.ratio) && alone && physical < CHANCE_FACTOR_SHARE * GREATEST_PHYSICAL_FACTOR
}

/// Smallest and largest strength of a part that would look like a column with this scale error.
fn strengths(factor: &Factor, input: bool) -> (f64, f64) {
    let (low, high) = (factor.log - factor.half, factor.log + factor.half);
    // A vehicle of a tenth of the strength responds as to a command recorded ten times too large.
    if input { ((-high).exp(), (-low).exp()) } else { (low.exp(), high.exp()) }
}

/// Name and SI unit of a source.
fn signal(vehicle: &Vehicle, data: &Data, source: usize) -> (String, String) {
    let p = data.channels.len();
    let named = |name: &str, unit: String| (name.to_string(), unit);
    match source.checked_sub(p) {
        Some(j) => named(&vehicle.inputs[j].name, vehicle.inputs[j].unit.si_symbol()),
        None => {
            let output = &vehicle.outputs[data.channels[source].output];
            named(&output.name, output.unit.si_symbol())
        }
    }
}

fn finding(vehicle: &Vehicle, data: &Data, unit: &WrongUnit, factor: &Factor) -> DataFinding {
    let signals = |members: &[usize]| members.iter().map(|s| signal(vehicle, data, *s)).collect::<Vec<_>>();
    let own = signals(&unit.members);
    let input = unit.members[0] >= data.channels.len();
    let at = |sigmas: f64| short(unit.ratio.signum() * (factor.log + sigmas * factor.half).exp());
    let mut text = format!(
        "{}: {} times ({} to {}) what {} {}, which points to {}. {}",
        too_large(&own, unit.ratio),
        at(0.0),
        at(-1.0),
        at(1.0),
        vehicle.name,
        if input { "answers to" } else { "does" },
        if unit.ratio < 0.0 { "another convention of axes" } else { "a wrong unit" },
        mending(&own, unit.ratio)
    );
    if let Some((members, ratio)) = &unit.or {
        text.push_str(&format!(
            "; or {}, which this record cannot distinguish",
            too_large(&signals(members), *ratio)
        ));
    }
    if input && unit.ratio < 0.0 {
        text.push_str("; or the actuator is connected the wrong way round: then turn the sign of its entries of B in the vehicle file");
    } else if input {
        text.push_str(&format!(
            "; a vehicle with an input_gain of {} would respond in the same way: if that is the case, add it to the vehicle file",
            short(1.0 / unit.ratio)
        ));
    }
    let names: Vec<&str> = own.iter().map(|(n, _)| n.as_str()).collect();
    let kind = if unit.ratio < 0.0 { "sign" } else { "unit" };
    DataFinding { kind: kind.into(), place: names.join(","), text, blocking: true }
}

/// Finding on columns of a size that neither a unit nor a fault explains.
fn strange_size(vehicle: &Vehicle, data: &Data, unit: &WrongUnit, factor: &Factor) -> DataFinding {
    let signals: Vec<_> = unit.members.iter().map(|s| signal(vehicle, data, *s)).collect();
    let at = |sigmas: f64| {
        let log = factor.log + sigmas * factor.half;
        short(if unit.ratio > 1.0 { log } else { -log }.exp())
    };
    let text = format!(
        "{} ({} to {}) for {}: this is not the ratio of two units, and faults are only searched for up to a factor of {}. Check the column and the vehicle file; if both are right, identify the vehicle from the record first (whirlstand identify)",
        too_large(&signals, unit.ratio),
        at(if unit.ratio > 1.0 { -1.0 } else { 1.0 }),
        at(if unit.ratio > 1.0 { 1.0 } else { -1.0 }),
        vehicle.name,
        short(*SEARCHED_FACTORS.end())
    );
    let names: Vec<&str> = signals.iter().map(|(n, _)| n.as_str()).collect();
    DataFinding { kind: "size".into(), place: names.join(","), text, blocking: true }
}

/// Text: columns are too large by a ratio.
fn too_large(signals: &[(String, String)], ratio: f64) -> String {
    let names: Vec<&str> = signals.iter().map(|(n, _)| n.as_str()).collect();
    if ratio == OPPOSITE_SIGN {
        let have = if names.len() == 1 { "has" } else { "have" };
        return format!("{} {have} the opposite sign", list(&names));
    }
    let (much, size) = if ratio > 1.0 { ("large", ratio) } else { ("small", 1.0 / ratio) };
    let are = if names.len() == 1 { "is" } else { "are" };
    format!("{} {are} {} times too {much}", list(&names), short(size))
}

/// Text: how to correct columns that are too large by a ratio.
fn mending(signals: &[(String, String)], ratio: f64) -> String {
    let columns = if signals.len() == 1 { "column" } else { "columns" };
    if ratio == OPPOSITE_SIGN {
        let maps: Vec<String> = signals.iter().map(|(name, _)| format!("--map {name}=-{name}")).collect();
        return format!("Turn the sign of the {columns}, or use {}", maps.join(" "));
    }
    let maps =
        signals.iter().map(|(name, si)| Some(format!("--map {name}={name}[{}]", recorded(si, ratio)?)));
    match maps.collect::<Option<Vec<String>>>() {
        Some(maps) => format!("Write the unit into the header of the {columns}, or use {}", maps.join(" ")),
        None if ratio > 1.0 => format!("Divide the {columns} by {}", short(ratio)),
        None => format!("Multiply the {columns} by {}", short(1.0 / ratio)),
    }
}

/// Unit of a column recorded larger than in SI by a ratio, where that unit has a usual name.
fn recorded(si: &str, ratio: f64) -> Option<String> {
    let is = |r: f64| (ratio / r - 1.0).abs() < 1e-6;
    let [degrees, gravity, thousand, speed] = UNIT_RATIOS;
    let unit = match si {
        "rad" if is(degrees) => "deg".into(),
        "rad/s" if is(degrees) => "deg/s".into(),
        "m/s" if is(speed) => "km/h".into(),
        "m/s^2" if is(1.0 / gravity) => "g".into(),
        "m" | "m/s" | "N" | "V" | "rad" | "rad/s" if is(thousand) => format!("m{si}"),
        "m" | "m/s" | "N" | "V" if is(1.0 / thousand) => format!("k{si}"),
        "rad" | "rad/s" if is(1.0 / degrees) => si.into(),
        "m/s" if is(1.0 / speed) => si.into(),
        "m/s^2" if is(gravity) => si.into(),
        _ => return None,
    };
    Some(unit)
}

fn list(names: &[&str]) -> String {
    match names {
        [all @ .., last] if !all.is_empty() => format!("{} and {last}", all.join(", ")),
        _ => names.concat(),
    }
}
