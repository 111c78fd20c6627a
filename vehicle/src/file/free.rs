//! Parts of a vehicle file that identification reads and writes: `free`, `fit` and `provenance`.

use std::fmt::Write as _;

use super::table::{Node, Table};
use super::text::{number, push, quoted};
use crate::effects::{Effect, Kind, Place};
use whirlstand_msgs::names::did_you_mean;

use crate::error::{FileError, list};
use crate::free::{Free, Provenance, Target};
use crate::model::Vehicle;

/// Reads `free`: an array of tables.
pub fn free(file: &Table<'_>, vehicle: &Vehicle) -> Result<Vec<Free>, FileError> {
    let Some(node) = file.get("free") else { return Ok(Vec::new()) };
    let mut all: Vec<Free> = Vec::new();
    for node in node.array()? {
        let one = one(&node, vehicle)?;
        if all.iter().any(|f| f.target == one.target) {
            return Err(node.error(format!("{} is given twice", vehicle.free_name(&one.target))));
        }
        all.push(one);
    }
    Ok(all)
}

fn one(node: &Node<'_>, vehicle: &Vehicle) -> Result<Free, FileError> {
    let table = node.table(&["entry", "effect", "where", "parameter", "lower", "upper", "start"])?;
    let target = match (table.get("entry"), table.get("effect")) {
        (Some(entry), None) => entry_target(&entry, vehicle)?,
        (None, Some(effect)) => effect_target(&table, &effect, vehicle)?,
        _ => {
            let reason = "give either entry = \"A[2,1]\", or effect, where and parameter";
            return Err(table.error(None, reason));
        }
    };
    let factor = vehicle.free_factor(&target);
    let bound = |key: &str| -> Result<f64, FileError> {
        let node = table.get(key).ok_or_else(|| {
            let name = vehicle.free_name(&target);
            table.error(
                None,
                format!("{key} is missing: a free parameter needs bounds, as in lower = -10.0, upper = 10.0 for {name}"),
            )
        })?;
        free_value(&node, vehicle, &target, factor)
    };
    let (lower, upper) = (bound("lower")?, bound("upper")?);
    if lower >= upper {
        return Err(table.error(Some("lower"), "must be below upper"));
    }
    if let Target::Effect(index, name) = target
        && let Some((least, most)) = vehicle.effects[index].range(name)
        && (lower < least || upper > most)
    {
        let key = if lower < least { "lower" } else { "upper" };
        return Err(table.error(Some(key), format!("{name} must be from {least} to {most}")));
    }
    let start = table.get("start").map(|n| free_value(&n, vehicle, &target, factor)).transpose()?;
    if let Some(start) = start
        && !(lower..=upper).contains(&start)
    {
        return Err(table.error(Some("start"), "lies outside lower and upper"));
    }
    Ok(Free { target, lower, upper, start })
}

/// A bound or start in SI: in the units of the matrix for an entry, otherwise as in the effect itself.
fn free_value(node: &Node<'_>, vehicle: &Vehicle, target: &Target, factor: f64) -> Result<f64, FileError> {
    let unit = match target {
        Target::Entry(..) => None,
        Target::Effect(index, name) => vehicle.effects[*index].unit(name, vehicle),
    };
    let Some(unit) = unit else { return Ok(node.number()? * factor) };
    if node.is_text() {
        return node.quantity(unit.unit());
    }
    let value = node.number()?;
    unit.two_readings(value).map_or(Ok(value), |reason| Err(node.error(reason)))
}

fn entry_target(node: &Node<'_>, vehicle: &Vehicle) -> Result<Target, FileError> {
    // A matrix entry has the syntax of parameter_change.
    let probe = Effect::new(Kind::ParameterChange, node.text()?, &[("value", 0.0)])
        .and_then(|e| e.resolve(vehicle))
        .map_err(|e| node.error(e.reason))?;
    match probe {
        Place::Entry(matrix, i, j) => Ok(Target::Entry(matrix, i, j)),
        _ => Err(node.error("must be a matrix entry, one-based, as in \"A[2,1]\"")),
    }
}

fn effect_target(table: &Table<'_>, effect: &Node<'_>, vehicle: &Vehicle) -> Result<Target, FileError> {
    let kind = Kind::from_name(effect.text()?).map_err(|e| effect.error(e.reason))?;
    let place = table.requirement("where")?;
    let parameter = table.requirement("parameter")?;
    let (place_text, parameter_text) = (place.text()?, parameter.text()?);
    let names = || kind.spec().parameters.iter().map(|p| p.name);
    let name = names().find(|n| *n == parameter_text).ok_or_else(|| {
        let hint = did_you_mean(parameter_text, names());
        parameter.error(format!("{kind} has no parameter '{parameter_text}'{hint}; it has {}", list(names())))
    })?;
    let index = vehicle.effects.iter().position(|e| e.kind() == kind && e.place() == place_text);
    let index = index.ok_or_else(|| {
        place.error(format!(
            "no {kind} at '{place_text}' is among the effects of this file: add it there first"
        ))
    })?;
    if vehicle.effects[index].parameter(name).is_none() {
        return Err(parameter.error(format!("this {kind} does not use {name}")));
    }
    Ok(Target::Effect(index, name))
}

/// Reads `fit`: a table of output names and weights.
pub fn fit(file: &Table<'_>, vehicle: &Vehicle) -> Result<Vec<(String, f64)>, FileError> {
    let Some(node) = file.get("fit") else { return Ok(Vec::new()) };
    let names: Vec<&str> = vehicle.outputs.iter().map(|o| o.name.as_str()).collect();
    let table = node.table(&names)?;
    let mut all = Vec::new();
    for (key, value) in table.entries() {
        let weight = value.number()?;
        if weight < 0.0 {
            return Err(value.error("a weight must not be negative"));
        }
        all.push((key.to_string(), weight));
    }
    if all.iter().all(|(_, w)| *w == 0.0) {
        return Err(node.error("at least one output must have a weight above 0"));
    }
    Ok(all)
}

/// Reads `provenance`: a table of texts.
pub fn provenance(file: &Table<'_>) -> Result<Provenance, FileError> {
    let Some(node) = file.get("provenance") else { return Ok(Vec::new()) };
    let table = node.open_table()?;
    table.entries().map(|(key, value)| Ok((key.to_string(), value.text()?.to_string()))).collect()
}

/// Writes `free`, `fit` and `provenance`.
pub fn push_free(text: &mut String, vehicle: &Vehicle) {
    if !vehicle.free.is_empty() {
        push(text, "\n# Parameters that identification may change.");
        push(text, "free = [");
        for f in &vehicle.free {
            let factor = vehicle.free_factor(&f.target);
            let mut line = match &f.target {
                Target::Entry(..) => format!("entry = {}", quoted(&vehicle.free_name(&f.target))),
                Target::Effect(index, name) => {
                    let effect = &vehicle.effects[*index];
                    format!(
                        "effect = {}, where = {}, parameter = {}",
                        quoted(effect.kind().name()),
                        quoted(effect.place()),
                        quoted(name)
                    )
                }
            };
            let unit = match &f.target {
                Target::Entry(..) => None,
                Target::Effect(index, name) => vehicle.effects[*index].unit(name, vehicle),
            };
            let written = |si| unit.as_ref().map_or_else(|| number(si, factor), |unit| unit.written(si));
            // Writing to a String is infallible.
            let _ = write!(line, ", lower = {}, upper = {}", written(f.lower), written(f.upper));
            if let Some(start) = f.start {
                let _ = write!(line, ", start = {}", written(start));
            }
            push(text, &format!("    {{ {line} }},"));
        }
        push(text, "]");
    }
    if !vehicle.fit.is_empty() {
        let pairs = vehicle.fit.iter().map(|(n, w)| format!("{} = {w:?}", quoted(n))).collect::<Vec<_>>();
        push(text, &format!("fit = {{ {} }}", pairs.join(", ")));
    }
    if !vehicle.provenance.is_empty() {
        let pairs = vehicle.provenance.iter().map(|(k, v)| format!("{} = {}", quoted(k), quoted(v)));
        push(text, &format!("provenance = {{ {} }}", pairs.collect::<Vec<_>>().join(", ")));
    }
}
