//! modelDescription.xml: the description of the vehicle that a tool reads before it loads the library.

use std::collections::BTreeMap;
use std::fmt::Write;

use whirlstand_vehicle::{SignalUnit, Vehicle};

use crate::contents::Settings;
use crate::variables::{Variable, Variables};

/// Base units in the order of a dimension's exponents; FMI has no unit for samples.
const BASES: [&str; 6] = ["kg", "m", "s", "A", "K", "rad"];

/// The only category of log messages.
pub(crate) const LOG_CATEGORY: &str = "logStatusError";

/// Prefix of the names of states: most outputs have the name of a state.
pub(crate) const STATE_PREFIX: &str = "state.";

/// The vehicle's name as a C identifier, which names the library.
pub(crate) fn model_identifier(vehicle: &Vehicle) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = vehicle.name.chars().map(safe).collect();
    if name.starts_with(|c: char| c.is_ascii_digit()) { format!("_{name}") } else { name }
}

/// Text escaped for an attribute.
fn escaped(text: &str) -> String {
    text.chars().fold(String::new(), |mut out, c| {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            // XML 1.0 has no other control characters.
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
        out
    })
}

/// The description of a vehicle.
pub(crate) fn description(vehicle: &Vehicle, settings: Settings, token: &str) -> String {
    let identifier = model_identifier(vehicle);
    let mut xml = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let mut line = |text: String| {
        xml.push_str(&text);
        xml.push('\n');
    };
    line(format!(
        "<fmiModelDescription fmiVersion=\"3.0\" modelName=\"{}\" instantiationToken=\"{token}\" description=\"{}\" \
         generationTool=\"Whirlstand {}\" variableNamingConvention=\"flat\">",
        escaped(&vehicle.name),
        escaped(&vehicle.description),
        env!("CARGO_PKG_VERSION")
    ));
    line(format!(
        "  <CoSimulation modelIdentifier=\"{identifier}\" canHandleVariableCommunicationStepSize=\"true\" \
         canGetAndSetFMUState=\"true\" fixedInternalStepSize=\"{:?}\"/>",
        settings.period_s
    ));
    line(units(vehicle));
    line(format!("  <LogCategories>\n    <Category name=\"{LOG_CATEGORY}\"/>\n  </LogCategories>"));
    line(format!("  <DefaultExperiment startTime=\"0\" stepSize=\"{:?}\"/>", settings.period_s));
    line(variables(vehicle, settings));
    line(structure(vehicle));
    line("</fmiModelDescription>".into());
    xml
}

/// Every SI unit in use, with the units that the file declares as its display units.
fn units(vehicle: &Vehicle) -> String {
    let declared = vehicle.states.iter().map(|s| &s.unit).chain(vehicle.inputs.iter().map(|u| &u.unit));
    let declared = declared.chain(vehicle.outputs.iter().map(|y| &y.unit));
    let mut units: BTreeMap<String, (&SignalUnit, BTreeMap<String, f64>)> = BTreeMap::new();
    for unit in declared {
        let entry = units.entry(si_name(unit)).or_insert_with(|| (unit, BTreeMap::new()));
        if unit.to_string() != si_name(unit) {
            entry.1.insert(unit.to_string(), 1.0 / unit.factor());
        }
    }
    let mut xml = String::from("  <UnitDefinitions>\n");
    if !units.contains_key("s") {
        xml.push_str("    <Unit name=\"s\"><BaseUnit s=\"1\"/></Unit>\n");
    }
    for (name, (unit, displays)) in &units {
        let exponents = unit.dimension().exponents();
        let bases = BASES.iter().zip(exponents).filter(|(_, exponent)| *exponent != 0);
        let bases: String = bases.map(|(base, exponent)| format!(" {base}=\"{exponent}\"")).collect();
        let _ = write!(xml, "    <Unit name=\"{}\"><BaseUnit{bases}/>", escaped(name));
        for (display, factor) in displays {
            let _ = write!(xml, "<DisplayUnit name=\"{}\" factor=\"{factor:?}\"/>", escaped(display));
        }
        xml.push_str("</Unit>\n");
    }
    xml + "  </UnitDefinitions>"
}

/// The unit of SI in which a signal's values are; a pure number is in `1`.
fn si_name(unit: &SignalUnit) -> String {
    let symbol = unit.si_symbol();
    if symbol.is_empty() { "1".into() } else { symbol }
}

fn unit_attributes(unit: &SignalUnit) -> String {
    let (si, declared) = (si_name(unit), unit.to_string());
    let display =
        if declared == si { String::new() } else { format!(" displayUnit=\"{}\"", escaped(&declared)) };
    format!("unit=\"{}\"{display}", escaped(&si))
}

fn variables(vehicle: &Vehicle, settings: Settings) -> String {
    let references = Variables::of(vehicle);
    let reference = |variable| format!("valueReference=\"{}\"", references.reference(variable));
    let mut lines = vec![
        format!(
            "<Float64 name=\"time\" {} causality=\"independent\" variability=\"continuous\" unit=\"s\"/>",
            reference(Variable::Time)
        ),
        format!(
            "<UInt64 name=\"seed\" {} causality=\"parameter\" variability=\"fixed\" start=\"{}\" description=\"Determines \
             all that is random\"/>",
            reference(Variable::Seed),
            settings.seed
        ),
        format!(
            "<Boolean name=\"noise\" {} causality=\"parameter\" variability=\"fixed\" start=\"true\" \
             description=\"Noise, dropouts, outliers, turbulence, rounding and sampling by sensors, vibration of the \
             engine\"/>",
            reference(Variable::Noise)
        ),
    ];
    for (i, u) in vehicle.inputs.iter().enumerate() {
        let limits = if u.lower.is_finite() || u.upper.is_finite() {
            let shown = |si: f64| u.unit.unit().from_si(si);
            let limits = format!(
                "The vehicle's own limits: {} to {} {}",
                shown(u.lower),
                shown(u.upper),
                if u.unit.is_one() { String::new() } else { u.unit.to_string() }
            );
            format!(" description=\"{}\"", escaped(limits.trim_end()))
        } else {
            String::new()
        };
        lines.push(format!(
            "<Float64 name=\"{}\" {} causality=\"input\" variability=\"continuous\" {} start=\"{:?}\"{limits}/>",
            escaped(&u.name),
            reference(Variable::Input(i)),
            unit_attributes(&u.unit),
            u.neutral()
        ));
    }
    for (i, y) in vehicle.outputs.iter().enumerate() {
        lines.push(format!(
            "<Float64 name=\"{}\" {} causality=\"output\" variability=\"discrete\" initial=\"calculated\" {} \
             description=\"As its sensor shows it\"/>",
            escaped(&y.name),
            reference(Variable::Output(i)),
            unit_attributes(&y.unit)
        ));
    }
    for (i, x) in vehicle.states.iter().enumerate() {
        lines.push(format!(
            "<Float64 name=\"{STATE_PREFIX}{}\" {} causality=\"local\" variability=\"continuous\" initial=\"exact\" {} \
             start=\"0\"/>",
            escaped(&x.name),
            reference(Variable::State(i)),
            unit_attributes(&x.unit)
        ));
    }
    format!("  <ModelVariables>\n    {}\n  </ModelVariables>", lines.join("\n    "))
}

/// The dependencies of the outputs. At a communication point an output shows the measurement of that time,
/// which contains no input of the same time.
fn structure(vehicle: &Vehicle) -> String {
    let references = Variables::of(vehicle);
    let outputs = (0..vehicle.outputs.len()).map(|i| references.reference(Variable::Output(i)));
    let outputs: Vec<usize> = outputs.collect();
    let line = |element: &str| {
        let lines =
            outputs.iter().map(|r| format!("    <{element} valueReference=\"{r}\" dependencies=\"\"/>\n"));
        lines.collect::<String>()
    };
    let initial = outputs.iter().map(|r| format!("    <InitialUnknown valueReference=\"{r}\"/>\n"));
    let initial: String = initial.collect();
    format!("  <ModelStructure>\n{}{initial}  </ModelStructure>", line("Output"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_identifiers_and_texts_attributes() {
        let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
        assert_eq!(model_identifier(&vehicle), "helicopter_hover");
        vehicle.name = "4.rotors".into();
        assert_eq!(model_identifier(&vehicle), "_4_rotors");
        assert_eq!(escaped("a < \"b\" & c\n"), "a &lt; &quot;b&quot; &amp; c ");
    }

    #[test]
    fn values_are_in_si_and_shown_in_the_file_s_units() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let text = description(&vehicle, Settings { period_s: 0.005, seed: 7 }, "token");
        for part in [
            "<Unit name=\"rad/s\"><BaseUnit s=\"-1\" rad=\"1\"/><DisplayUnit name=\"deg/s\" factor=\"57.29577951308232\"/>",
            "fixedInternalStepSize=\"0.005\"",
            "start=\"7\"",
            "name=\"roll\"",
            "name=\"state.roll_rate\"",
            "unit=\"rad\" displayUnit=\"deg\"",
        ] {
            assert!(text.contains(part), "{part} is missing in\n{text}");
        }
    }
}
