//! Writes a [`Vehicle`] as the text of a vehicle file.

use nalgebra::DMatrix;

use super::text::{number, push, quoted};
use crate::effects::Effect;
use crate::model::{Input, Output, Vehicle};
use crate::signal_unit::SignalUnit;

impl Vehicle {
    /// The vehicle as the text of a vehicle file, which reads back as the same vehicle.
    ///
    /// When nothing but added effects distinguishes the vehicle from the file it was read from, the text is that
    /// file, comments and all, with the effects appended.
    pub fn to_toml(&self) -> String {
        self.appended().unwrap_or_else(|| self.rendered())
    }

    fn appended(&self) -> Option<String> {
        let read = Self::parse(&self.source_text, &self.name).ok()?;
        let added = self.effects.strip_prefix(read.effects.as_slice())?;
        let same = Self { effects: self.effects.clone(), folder: self.folder.clone(), ..read };
        if same != *self {
            return None;
        }
        let mut text = self.source_text.clone();
        // A file that gives effects as one array cannot be continued by appending tables.
        push_effects(&mut text, added, self);
        let whole = Self::parse(&text, &self.name).ok()?;
        (whole.effects == self.effects).then_some(text)
    }

    fn rendered(&self) -> String {
        let mut text = String::new();
        let states: Vec<_> = self.states.iter().map(|s| s.unit.clone()).collect();
        let inputs: Vec<_> = self.inputs.iter().map(|s| s.unit.clone()).collect();
        let outputs: Vec<_> = self.outputs.iter().map(|s| s.unit.clone()).collect();
        push(&mut text, &format!("name = {}", quoted(&self.name)));
        if !self.description.is_empty() {
            push(&mut text, &format!("description = {}", quoted(&self.description)));
        }
        push_matrix(&mut text, "A", &self.a, &states, &states);
        push_matrix(&mut text, "B", &self.b, &states, &inputs);
        if !self.outputs_name_states() {
            push_matrix(&mut text, "C", &self.c, &outputs, &states);
        }
        if self.d.iter().any(|v| *v != 0.0) {
            push_matrix(&mut text, "D", &self.d, &outputs, &inputs);
        }
        super::free::push_free(&mut text, self);
        super::map::push_map(&mut text, self);
        for state in &self.states {
            push_head(&mut text, "states", &state.name, &state.unit);
            if let Some(bound) = state.bound {
                push(&mut text, &format!("bound = {}", number(bound, state.unit.factor())));
            }
        }
        self.inputs.iter().for_each(|input| push_input(&mut text, input));
        self.outputs.iter().for_each(|output| push_output(&mut text, output));
        push_effects(&mut text, &self.effects, self);
        text
    }

    fn outputs_name_states(&self) -> bool {
        self.outputs.iter().enumerate().all(|(i, output)| {
            self.state_index(&output.name).is_some_and(|j| {
                self.states[j].unit.dimension() == output.unit.dimension()
                    && (0..self.states.len()).all(|k| self.c[(i, k)] == f64::from(u8::from(k == j)))
            })
        })
    }
}

fn push_head(text: &mut String, table: &str, name: &str, unit: &SignalUnit) {
    push(text, &format!("\n[[{table}]]\nname = {}\nunit = {}", quoted(name), quoted(&unit.to_string())));
}

fn push_input(text: &mut String, input: &Input) {
    push_head(text, "inputs", &input.name, &input.unit);
    for (key, value) in [("lower", input.lower), ("upper", input.upper), ("rate_limit", input.rate_limit)] {
        if value.is_finite() {
            push(text, &format!("{key} = {}", number(value, input.unit.factor())));
        }
    }
    if input.is_straight() {
        push(text, &format!("intersample = {}", quoted(input.intersample.name())));
    }
}

fn push_output(text: &mut String, output: &Output) {
    let factor = output.unit.factor();
    push_head(text, "outputs", &output.name, &output.unit);
    for (key, value) in
        [("noise", output.noise), ("bias", output.bias), ("quantization", output.quantization)]
    {
        if value != 0.0 {
            push(text, &format!("{key} = {}", number(value, factor)));
        }
    }
    if output.every != 1 {
        push(text, &format!("every = {}", output.every));
    }
    if let Some(v) = &output.vibration {
        let harmonics = v.harmonics.iter().map(|h| format!("{h:?}")).collect::<Vec<_>>().join(", ");
        push(
            text,
            &format!(
                "vibration = {{ frequency_hz = {:?}, phase_rad = {:?}, harmonics = [{harmonics}], off = {}, on = {}, flying = {} }}",
                v.frequency_hz,
                v.phase_rad,
                number(v.off, factor),
                number(v.on, factor),
                number(v.flying, factor)
            ),
        );
    }
}

fn push_matrix(
    text: &mut String,
    name: &str,
    matrix: &DMatrix<f64>,
    rows: &[SignalUnit],
    columns: &[SignalUnit],
) {
    push(text, &format!("{name} = ["));
    for i in 0..matrix.nrows() {
        let entries = (0..matrix.ncols())
            .map(|j| number(matrix[(i, j)], rows[i].factor() / columns[j].factor()))
            .collect::<Vec<_>>();
        push(text, &format!("    [{}],", entries.join(", ")));
    }
    push(text, "]");
}

/// Writes effects, with values in the units that the file declares for its signals.
fn push_effects(text: &mut String, effects: &[Effect], vehicle: &Vehicle) {
    for effect in effects {
        if !text.ends_with('\n') && !text.is_empty() {
            text.push('\n');
        }
        push(text, "\n[[effects]]");
        push(text, &format!("effect = {}\nwhere = {}", quoted(effect.kind().name()), quoted(effect.place())));
        for (name, value) in effect.parameters() {
            let written = effect.unit(name, vehicle).map_or(format!("{value:?}"), |unit| unit.written(value));
            push(text, &format!("{name} = {written}"));
        }
        for (key, end) in effect.window().ends() {
            push(text, &format!("{key} = {end:?}"));
        }
        if let (Some((name, _)), Some(value)) = (effect.kind().spec().text, effect.text()) {
            push(text, &format!("{name} = {}", quoted(value)));
        }
    }
}
