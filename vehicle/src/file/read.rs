//! Parses the text of a vehicle file into a [`Vehicle`].

use nalgebra::DMatrix;
use toml::de::DeTable;
use whirlstand_msgs::names::did_you_mean;
use whirlstand_msgs::units::Unit;

use super::axes;
use super::copies::{Signal, unconverted};
use super::table::{Node, Source, Table};
use crate::effects::{Effect, FieldValue, Kind};
use crate::error::FileError;
use crate::model::{Input, Intersample, Output, State, Vehicle, Vibration};
use crate::signal_unit::SignalUnit;

const KEYS: &[&str] = &[
    "name",
    "description",
    "A",
    "B",
    "C",
    "D",
    "states",
    "inputs",
    "outputs",
    "effects",
    "free",
    "fit",
    "map",
    "provenance",
    axes::KEYS[0],
    axes::KEYS[1],
];

impl Vehicle {
    /// Reads a vehicle from the text of a vehicle file; `origin` names it in errors.
    ///
    /// # Errors
    /// [`FileError`] with line, field and reason: not TOML, an unknown key, a row of the wrong length, a value
    /// that is not a finite number, an unknown or incompatible unit, a name given twice, an invalid effect.
    pub fn parse(text: &str, origin: &str) -> Result<Self, FileError> {
        let source = Source { file: origin, text };
        let document = DeTable::parse(text).map_err(|e| {
            let reason = format!("this is not valid TOML: {}", e.message());
            source.error(e.span().map(|s| s.start), "", reason)
        })?;
        let file = Table::document(source, document.get_ref());
        file.check_keys(KEYS)?;

        let mut states = states(&file)?;
        let mut inputs = inputs(&file)?;
        let own_states = states.clone();
        let own_inputs = inputs.clone();
        let (state_signals, input_signals) = (signals_of(&own_states), signals_of_inputs(&own_inputs));
        let a = matrix(&file, "A", (&state_signals, "state"), (&state_signals, "state"), true)?;
        let b = matrix(&file, "B", (&state_signals, "state"), (&input_signals, "input"), true)?;
        let a = a.ok_or_else(|| file.error(None, "A is missing"))?;
        let b = b.ok_or_else(|| file.error(None, "B is missing"))?;
        let axes = axes::axes(&file, &states, &inputs)?;
        let (a, b) = axes::append(axes, &mut states, &mut inputs, a, b);
        let outputs = outputs(&file, &states)?;
        let rows = (&outputs.iter().map(|o| (o.name.as_str(), &o.unit)).collect::<Vec<_>>()[..], "output");
        let c = match matrix(&file, "C", rows, (&state_signals, "state"), false)? {
            // C and D refer to the file's own states and inputs.
            Some(c) => c.resize(outputs.len(), states.len(), 0.0),
            None => outputs_name_states(&file, &outputs, &states)?,
        };
        let d = matrix(&file, "D", rows, (&input_signals, "input"), false)?
            .map(|d| d.resize(outputs.len(), inputs.len(), 0.0))
            .unwrap_or_else(|| DMatrix::zeros(outputs.len(), inputs.len()));

        let stem = std::path::Path::new(origin).file_stem().map_or(origin.into(), |s| s.to_string_lossy());
        let mut vehicle = Self {
            name: file.get("name").map_or(Ok(stem.into_owned()), |n| n.name())?,
            description: file.get("description").map_or(Ok(""), |n| n.text())?.into(),
            states,
            inputs,
            outputs,
            a,
            b,
            c,
            d,
            effects: Vec::new(),
            free: Vec::new(),
            fit: Vec::new(),
            map: Vec::new(),
            provenance: super::free::provenance(&file)?,
            source_text: text.into(),
            folder: folder_of(origin),
        };
        if let Some(effects) = file.get("effects") {
            for node in effects.array()? {
                let effect = effect(&node, &vehicle)?;
                vehicle.effects.push(effect);
            }
        }
        vehicle.free = super::free::free(&file, &vehicle)?;
        vehicle.fit = super::free::fit(&file, &vehicle)?;
        vehicle.map = super::map::map(&file, &vehicle)?;
        Ok(vehicle)
    }
}

/// Folder of the file; `None` for a bare name.
fn folder_of(origin: &str) -> Option<std::path::PathBuf> {
    std::path::Path::new(origin).parent().filter(|p| !p.as_os_str().is_empty()).map(Into::into)
}

fn signals_of(states: &[State]) -> Vec<Signal<'_>> {
    states.iter().map(|s| (s.name.as_str(), &s.unit)).collect()
}

fn signals_of_inputs(inputs: &[Input]) -> Vec<Signal<'_>> {
    inputs.iter().map(|s| (s.name.as_str(), &s.unit)).collect()
}

/// Elements of an array of tables; a bare name stands for a table that has only this name.
fn signals<'a>(file: &Table<'a>, key: &str) -> Result<Vec<Node<'a>>, FileError> {
    let nodes = file.requirement(key)?.array()?;
    if nodes.is_empty() {
        return Err(file.error(Some(key), "must not be empty"));
    }
    Ok(nodes)
}

fn unit(table: &Table<'_>) -> Result<SignalUnit, FileError> {
    let Some(node) = table.get("unit") else { return Ok(SignalUnit::default()) };
    node.text()?.parse().map_err(|e: whirlstand_msgs::units::UnitError| node.error(e.to_string()))
}

/// Adds the name to those already used.
fn unique(node: &Node<'_>, seen: &mut Vec<String>) -> Result<String, FileError> {
    let name = node.name()?;
    if seen.contains(&name) {
        return Err(node.error(format!("'{name}' is given twice; names must be unique")));
    }
    seen.push(name.clone());
    Ok(name)
}

fn states(file: &Table<'_>) -> Result<Vec<State>, FileError> {
    let mut seen = Vec::new();
    signals(file, "states")?
        .iter()
        .map(|node| {
            let table = node.table(&["name", "unit", "bound"])?;
            let unit = unit(&table)?;
            let bound = table.get("bound").map(|n: Node<'_>| n.magnitude(unit.unit())).transpose()?;
            if bound == Some(0.0) {
                return Err(table.error(Some("bound"), "must be above 0; leave it out for the default"));
            }
            Ok(State { name: unique(&table.requirement("name")?, &mut seen)?, unit, bound })
        })
        .collect()
}

fn inputs(file: &Table<'_>) -> Result<Vec<Input>, FileError> {
    let mut seen = Vec::new();
    let mut read = |node: &Node<'_>| {
        let table = node.table(&["name", "unit", "lower", "upper", "rate_limit", "intersample"])?;
        let name = unique(&table.requirement("name")?, &mut seen)?;
        let unit = unit(&table)?;
        let limit = |key, default| table.get(key).map_or(Ok(default), |n: Node<'_>| n.quantity(unit.unit()));
        let lower = limit("lower", f64::NEG_INFINITY)?;
        let upper = limit("upper", f64::INFINITY)?;
        if lower > upper {
            return Err(table.error(Some("lower"), "must not be above upper"));
        }
        let rate_limit = match table.get("rate_limit") {
            None => f64::INFINITY,
            Some(node) => node.magnitude(&per_second(&unit, &node)?)?,
        };
        if rate_limit == 0.0 {
            return Err(table.error(Some("rate_limit"), "must be above 0; leave it out for none"));
        }
        let intersample = match table.get("intersample").map(|node: Node<'_>| node.text()).transpose()? {
            None | Some("zoh") => Intersample::Held,
            Some("foh") => Intersample::Interpolated,
            Some(other) => {
                let what = format!(
                    "is \"{other}\": expected \"zoh\" for commands that are held from sample to sample, or \"foh\" for \
                     measured signals that go straight from one sample to the next"
                );
                return Err(table.error(Some("intersample"), what));
            }
        };
        Ok(Input { name, unit, lower, upper, rate_limit, intersample })
    };
    signals(file, "inputs")?.iter().map(&mut read).collect()
}

fn per_second(unit: &SignalUnit, node: &Node<'_>) -> Result<Unit, FileError> {
    let text = unit.to_string();
    let text = if text.trim().is_empty() || text == "-" { "1".into() } else { text };
    format!("{text}/s").parse().map_err(|e: whirlstand_msgs::units::UnitError| node.error(e.to_string()))
}

fn outputs(file: &Table<'_>, states: &[State]) -> Result<Vec<Output>, FileError> {
    if file.get("outputs").is_none() {
        let ideal = |s: &State| Output {
            name: s.name.clone(),
            unit: s.unit.clone(),
            noise: 0.0,
            bias: 0.0,
            quantization: 0.0,
            every: 1,
            vibration: None,
        };
        return Ok(states.iter().map(ideal).collect());
    }
    let mut seen = Vec::new();
    let read = |node: &Node<'_>| {
        let table = node.table(&["name", "unit", "noise", "bias", "quantization", "every", "vibration"])?;
        let name = unique(&table.requirement("name")?, &mut seen)?;
        let mut unit = unit(&table)?;
        if table.get("unit").is_none()
            && let Some(state) = states.iter().find(|s| s.name == name)
        {
            unit = state.unit.clone();
        }
        let magnitude = |key| table.get(key).map_or(Ok(0.0), |n: Node<'_>| n.magnitude(unit.unit()));
        Ok(Output {
            noise: magnitude("noise")?,
            quantization: magnitude("quantization")?,
            bias: table.get("bias").map_or(Ok(0.0), |n| n.quantity(unit.unit()))?,
            every: table.get("every").map_or(Ok(1), |n| n.count())?,
            vibration: table.get("vibration").map(|n| vibration(&n, &unit)).transpose()?,
            name,
            unit,
        })
    };
    signals(file, "outputs")?.iter().map(read).collect()
}

fn vibration(node: &Node<'_>, unit: &SignalUnit) -> Result<Vibration, FileError> {
    let table = node.table(&["frequency_hz", "phase_rad", "harmonics", "off", "on", "flying"])?;
    let of = |text: &str| text.parse::<Unit>().map_err(|e| node.error(e.to_string()));
    let amplitude = |key| table.get(key).map_or(Ok(0.0), |n: Node<'_>| n.magnitude(unit.unit()));
    let frequency_hz = table.requirement("frequency_hz")?.magnitude(&of("Hz")?)?;
    let phase_rad = table.get("phase_rad").map_or(Ok(0.0), |n| n.quantity(&of("rad")?))?;
    let harmonics = match table.get("harmonics") {
        None => vec![1.0],
        Some(list) => list.array()?.iter().map(Node::number).collect::<Result<_, _>>()?,
    };
    Ok(Vibration {
        frequency_hz,
        phase_rad,
        harmonics,
        off: amplitude("off")?,
        on: amplitude("on")?,
        flying: amplitude("flying")?,
    })
}

/// A matrix in the declared units, converted to SI: entry times (unit of the row / unit of the column).
fn matrix(
    file: &Table<'_>,
    key: &str,
    (rows, row_is): (&[Signal<'_>], &str),
    (columns, column_is): (&[Signal<'_>], &str),
    square: bool,
) -> Result<Option<DMatrix<f64>>, FileError> {
    let node = match file.get(key) {
        Some(node) => node,
        None if square => return Err(file.error(None, format!("{key} is missing"))),
        None => return Ok(None),
    };
    let lines = node.array()?;
    if lines.len() != rows.len() {
        let (found, needed) = (lines.len(), rows.len());
        return Err(node.error(format!("has {found} rows, but {needed} are needed: one for each {row_is}")));
    }
    let mut matrix = DMatrix::zeros(rows.len(), columns.len());
    for (i, line) in lines.iter().enumerate() {
        let entries = line.array()?;
        if entries.len() != columns.len() {
            let (found, needed) = (entries.len(), columns.len());
            let reason =
                format!("this row has {found} entries, but {needed} are needed: one for each {column_is}");
            return Err(line.error(reason));
        }
        let numbers = entries.iter().map(Node::number).collect::<Result<Vec<_>, _>>()?;
        if let Some((j, reason)) = unconverted(key, &numbers, rows[i], columns) {
            return Err(entries[j].error(reason));
        }
        for (j, number) in numbers.into_iter().enumerate() {
            // The ratio is computed first: it is exactly 1 between equal units, so that the paper's digits
            // are unchanged.
            matrix[(i, j)] = number * (rows[i].1.factor() / columns[j].1.factor());
        }
    }
    Ok(Some(matrix))
}

/// Without C every output measures the state of the same name.
fn outputs_name_states(
    file: &Table<'_>,
    outputs: &[Output],
    states: &[State],
) -> Result<DMatrix<f64>, FileError> {
    let nodes = match file.get("outputs") {
        Some(node) => node.array()?,
        None => Vec::new(),
    };
    let mut c = DMatrix::zeros(outputs.len(), states.len());
    for (i, output) in outputs.iter().enumerate() {
        let error = |key: &str, reason: String| match nodes.get(i).and_then(|n| n.open_table().ok()) {
            Some(table) => table.error(Some(key), reason),
            None => file.error(None, reason),
        };
        let j = states.iter().position(|s| s.name == output.name).ok_or_else(|| {
            let names = || states.iter().map(|s| s.name.as_str());
            let hint = did_you_mean(&output.name, names());
            let known = crate::error::list(names());
            let name = &output.name;
            error(
                "name",
                format!("'{name}' is not a state{hint}; states are {known}. For any other output give C"),
            )
        })?;
        if states[j].unit.dimension() != output.unit.dimension() {
            let (own, state) = (&output.unit, &states[j].unit);
            return Err(error("unit", format!("'{own}' is incompatible with the state's unit, '{state}'")));
        }
        c[(i, j)] = 1.0;
    }
    Ok(c)
}

fn effect(node: &Node<'_>, vehicle: &Vehicle) -> Result<Effect, FileError> {
    let table = node.open_table()?;
    let kind_node = table.requirement("effect")?;
    let kind = Kind::from_name(kind_node.text()?).map_err(|e| kind_node.error(e.reason))?;
    let place = table.requirement("where")?.text()?;
    let mut fields = Vec::new();
    for (key, value) in table.entries().filter(|(key, _)| !["effect", "where"].contains(key)) {
        let value = if value.is_text() {
            FieldValue::Text(value.text()?.into())
        } else {
            FieldValue::Number(value.number()?)
        };
        fields.push((key, value));
    }
    let located =
        |e: crate::error::EffectError| table.error(e.field.as_deref(), format!("{}: {}", e.effect, e.reason));
    let effect = Effect::from_fields(kind, place, fields).map_err(located)?;
    vehicle.check_written_effect(&effect).map_err(located)?;
    Ok(effect.confirmed())
}
