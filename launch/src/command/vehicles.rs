//! `whirlstand vehicle new|list|show|check|fmu`.

use std::collections::BTreeMap;
use std::process::ExitCode;

use serde_json::{Value, json};
use whirlstand_logs::shown::counted;
use whirlstand_msgs::units::clean;
use whirlstand_nodes::signals::check_room;
use whirlstand_vehicle::{Vehicle, builtin_names, template_names};

use super::tell;
use super::vehicle_fmu::vehicle_fmu;
use super::vehicle_new::vehicle_new;
use crate::cli::{JsonArg, VehicleCommand};
use crate::error::Failure;
use crate::style;

/// Runs the command.
pub(crate) fn vehicles(command: &VehicleCommand) -> Result<ExitCode, Failure> {
    match command {
        VehicleCommand::New(args) => vehicle_new(args)?,
        VehicleCommand::List { json } => list(json)?,
        VehicleCommand::Show { vehicle } => super::print_data(&find(vehicle)?.source_text)?,
        VehicleCommand::Check { vehicle, json } => check(&find(vehicle)?, json)?,
        VehicleCommand::Fmu(args) => vehicle_fmu(&find(&args.vehicle)?, args)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Finds a vehicle by built-in name or path.
///
/// # Errors
/// What is wrong with the name or the file.
pub(crate) fn find(name_or_path: &str) -> Result<Vehicle, Failure> {
    Vehicle::find(name_or_path).map_err(Failure::mend)
}

fn list(json: &JsonArg) -> Result<(), Failure> {
    let vehicles = builtin_names().map(|n| Vehicle::builtin(n).map_err(Failure::run));
    let vehicles = vehicles.collect::<Result<Vec<_>, _>>()?;
    let all: Vec<_> = vehicles
        .iter()
        .map(|v| json!({ "name": v.name, "description": v.description, "states": v.states.len(), "inputs": v.inputs.len(), "outputs": v.outputs.len() }))
        .collect();
    let templates: Vec<&str> = template_names().collect();
    let value = json!({ "schema": "whirlstand.vehicles.v1", "vehicles": all, "templates": templates });
    tell(json, &value, || list_text(&vehicles))
}

fn list_text(vehicles: &[Vehicle]) -> String {
    let mut text = String::new();
    for v in vehicles {
        let size = [(v.states.len(), "state"), (v.inputs.len(), "input"), (v.outputs.len(), "output")]
            .map(|(n, what)| counted(n, what))
            .join(", ");
        let name = style::strong(&format!("{:<26}", v.name));
        text.push_str(&format!("{name}  {size:<34}  {}\n", v.description));
    }
    let templates = template_names().collect::<Vec<_>>().join(", ");
    text.push_str(&format!("templates without numbers, for `whirlstand identify`: {templates}\n"));
    text
}

/// Poles of the model, slowest first.
fn poles(vehicle: &Vehicle) -> Result<Vec<(f64, f64)>, Failure> {
    let poles = vehicle.poles().map_err(|e| {
        Failure::Mend(format!(
            "{}: A: its poles cannot be computed: {e}; use other units for the states",
            vehicle.name
        ))
    })?;
    let mut poles: Vec<_> = poles.iter().map(|p| (p.re, p.im)).collect();
    poles.sort_by(|a, b| b.0.total_cmp(&a.0).then(b.1.total_cmp(&a.1)));
    Ok(poles)
}

fn check(v: &Vehicle, json: &JsonArg) -> Result<(), Failure> {
    let poles = poles(v)?;
    tell(json, &description(v, &poles), || check_text(v, &poles))
}

fn check_text(v: &Vehicle, poles: &[(f64, f64)]) -> String {
    let mut text = format!("{}  {}\n", style::strong(&v.name), v.description);
    let mut row = |head: &str, body: String| text.push_str(&format!("{head:<10}{body}\n"));
    let with_unit =
        |name: &str, unit: String| if unit.is_empty() { name.into() } else { format!("{name} [{unit}]") };
    let join = |names: Vec<String>| names.join(", ");
    row("states", join(v.states.iter().map(|s| with_unit(&s.name, s.unit.to_string())).collect()));
    for u in &v.inputs {
        let bare = u.unit.is_one();
        let value = |si: f64| clean(u.unit.unit().from_si(si));
        let mut range = format!("{}  {} to {}", u.name, value(u.lower), value(u.upper));
        if u.lower == f64::NEG_INFINITY && u.upper == f64::INFINITY {
            range = format!("{}  without limits", u.name);
        } else if !bare {
            range.push_str(&format!(" {}", u.unit));
        }
        if u.rate_limit.is_finite() {
            let per = if bare { " 1".into() } else { format!(" {}", u.unit) };
            range.push_str(&format!(", at most {}{per}/s", value(u.rate_limit)));
        }
        row("input", range);
    }
    for y in &v.outputs {
        let unit = if y.unit.is_one() { String::new() } else { format!(" {}", y.unit) };
        let noise = clean(y.unit.unit().from_si(y.noise));
        let vibration = y
            .vibration
            .as_ref()
            .map_or(String::new(), |v| format!(", vibration at {} Hz", clean(v.frequency_hz)));
        let every = if y.every == 1 { "every step".into() } else { format!("every {} steps", y.every) };
        row("output", format!("{}  noise {noise}{unit}, {every}{vibration}", y.name));
    }
    for effect in &v.effects {
        let shown = |(name, value): (&str, f64)| {
            let value = effect.unit(name, v).map_or_else(|| clean(value), |unit| unit.shown(value));
            format!("{name} = {value}")
        };
        let window = effect.window();
        let ends = [("from", window.from_s), ("until", window.until_s)];
        let ends = ends.into_iter().filter_map(|(word, end)| Some(format!("{word} {} s", clean(end?))));
        let parameters: Vec<_> = effect.parameters().map(shown).chain(ends).collect();
        row("effect", format!("{} at {}: {}", effect.kind(), effect.place(), parameters.join(", ")));
    }
    let pole =
        |&(re, im): &(f64, f64)| if im == 0.0 { format!("{re:.4}") } else { format!("{re:.4}{im:+.4}i") };
    row("poles", format!("{} 1/s", poles.iter().map(pole).collect::<Vec<_>>().join(", ")));
    text.push_str(&format!("{}\n", style::good("The vehicle file is valid.")));
    if let Err(error) = check_room(v) {
        text.push_str(&format!("{}\n", style::bad(&format!("{error}"))));
    }
    text
}

/// The vehicle as JSON. Values are SI, in `si_unit`; `unit` is the unit that the file declares.
fn description(v: &Vehicle, poles: &[(f64, f64)]) -> Value {
    let finite = |x: f64| x.is_finite().then_some(x);
    json!({
        "schema": "whirlstand.vehicle.v1",
        "valid": true,
        "name": v.name,
        "description": v.description,
        "states": v.states.iter().map(|s| json!({ "name": s.name, "unit": s.unit.to_string() })).collect::<Vec<_>>(),
        "inputs": v.inputs.iter().map(|u| json!({
            "name": u.name, "unit": u.unit.to_string(), "si_unit": u.unit.si_symbol(), "lower": finite(u.lower), "upper": finite(u.upper),
            "rate_limit": finite(u.rate_limit) })).collect::<Vec<_>>(),
        "outputs": v.outputs.iter().map(|y| json!({
            "name": y.name, "unit": y.unit.to_string(), "si_unit": y.unit.si_symbol(), "noise": y.noise, "bias": y.bias,
            "quantization": y.quantization, "every": y.every })).collect::<Vec<_>>(),
        "effects": v.effects.iter().map(|e| json!({
            "effect": e.kind().name(), "where": e.place(),
            "from_s": e.window().from_s, "until_s": e.window().until_s,
            "parameters": e.parameters().collect::<BTreeMap<_, _>>(),
            "units": e.parameters().map(|(name, _)| (name, e.unit(name, v).map(|u| u.si_symbol())))
                .collect::<BTreeMap<_, _>>() })).collect::<Vec<_>>(),
        "poles": poles,
        "not_on_bench": check_room(v).err().map(|e| e.to_string()),
    })
}
