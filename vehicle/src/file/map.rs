//! The part of a vehicle file that maps signals to their names in logs: `map`.

use super::table::Table;
use super::text::{push, quoted};
use crate::error::FileError;
use crate::model::Vehicle;

/// The name of a record's time axis, which can be mapped like a signal.
const TIME: &str = "t";

/// Reads `map`: a table of inputs and outputs (and `t`, the time), each with its name in logs.
pub fn map(file: &Table<'_>, vehicle: &Vehicle) -> Result<Vec<(String, String)>, FileError> {
    let Some(node) = file.get("map") else { return Ok(Vec::new()) };
    let inputs = vehicle.inputs.iter().map(|input| input.name.as_str());
    let outputs = vehicle.outputs.iter().map(|output| output.name.as_str());
    let names: Vec<&str> = inputs.chain(outputs).chain([TIME]).collect();
    let table = node.table(&names)?;
    let one = |(key, value): (&str, super::table::Node<'_>)| {
        let source = value.text()?.trim();
        if source.is_empty() {
            return Err(value.error("must name a signal of a log, as in \"phi\" or \"phi[deg]\""));
        }
        Ok((key.to_string(), source.to_string()))
    };
    table.entries().map(one).collect()
}

/// Writes `map`.
pub fn push_map(text: &mut String, vehicle: &Vehicle) {
    if vehicle.map.is_empty() {
        return;
    }
    push(text, "\n# Names of the signals in logs.");
    push(text, "[map]");
    for (name, source) in &vehicle.map {
        push(text, &format!("{} = {}", quoted(name), quoted(source)));
    }
}

#[cfg(test)]
mod tests {
    use crate::model::Vehicle;

    const CART: &str = r#"
A = [[-1.0]]
B = [[2.0]]
states = [{ name = "speed", unit = "m/s" }]
inputs = [{ name = "u_force" }]
"#;

    #[test]
    fn names_of_logs_are_read_and_written() {
        let text =
            format!("{CART}map = {{ u_force = \"cmd.f[3]\", speed = \"-gps.v[km/h]\", t = \"Time[ms]\" }}\n");
        let vehicle = Vehicle::parse(&text, "cart.toml").unwrap();
        assert!(vehicle.map.contains(&("speed".to_string(), "-gps.v[km/h]".to_string())));
        let changed = Vehicle { description: "written anew".into(), ..vehicle.clone() };
        let again = Vehicle::parse(&changed.to_toml(), "cart.toml").unwrap();
        assert_eq!(again.map, vehicle.map);
    }

    #[test]
    fn a_name_that_is_no_signal_is_told() {
        let error = Vehicle::parse(&format!("{CART}map = {{ sped = \"v\" }}\n"), "cart.toml").unwrap_err();
        assert!(error.to_string().contains("did you mean 'speed'"), "{error}");
        let error = Vehicle::parse(&format!("{CART}map = {{ speed = \"\" }}\n"), "cart.toml").unwrap_err();
        assert!(error.to_string().contains("must name a signal"), "{error}");
    }
}
