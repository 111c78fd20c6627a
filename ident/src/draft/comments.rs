//! Text of a drafted vehicle file, with comments on the source of each number.

use whirlstand_logs::shown::number;
use whirlstand_vehicle::{Kind, Vehicle};

use super::answer::{Draft, ParameterAnswer};

/// The vehicle file of a draft: the usual text of the vehicle, with comments above its parts. With `rotors` the
/// inputs are rotors that are all alike.
pub fn text(vehicle: &Vehicle, rotors: bool, draft: &Draft) -> String {
    let mut text = vehicle.to_toml();
    above(&mut text, "A = [", &model(draft));
    let mut bounds = vec![
        "Bounds: poles from a time constant of one step to slow growth; gains up to ten times the ratio of the spreads of output"
            .to_string(),
        "and input; delays and lags up to those of small vehicles.".to_string(),
    ];
    if rotors {
        bounds.push(
            "Gains, delays and lags of the rotors stay as fitted here: they were fitted as those of equal rotors, and one by one"
                .into(),
        );
        bounds.push("the record hardly determines them.".into());
    }
    above(&mut text, "free = [", &bounds);
    for input in &vehicle.inputs {
        let anchor = format!("[[inputs]]\nname = \"{}\"", input.name);
        let mut lines = vec!["Limits: the range of the record plus a margin of a tenth.".to_string()];
        if input.is_straight() {
            lines.push(
                "Between samples: straight from one to the next (foh), which explains the record better than held values (zoh)."
                    .into(),
            );
        }
        above(&mut text, &anchor, &lines);
    }
    for output in &vehicle.outputs {
        let anchor = format!("[[outputs]]\nname = \"{}\"", output.name);
        let noise = "Noise: the sample-to-sample scatter about a smooth motion (white_noise_std), and that of rounding (a step over root 12).";
        above(&mut text, &anchor, &[noise.to_string()]);
    }
    for effect in &vehicle.effects {
        let anchor = format!("[[effects]]\neffect = \"{}\"\nwhere = \"{}\"", effect.kind(), effect.place());
        above(&mut text, &anchor, &[effect_comment(effect.kind(), effect.place(), draft)]);
    }
    head(draft) + &text
}

/// Inserts comment lines above the line that begins with `anchor`.
fn above(text: &mut String, anchor: &str, lines: &[String]) {
    let found =
        if text.starts_with(anchor) { Some(0) } else { text.find(&format!("\n{anchor}")).map(|at| at + 1) };
    if let Some(at) = found {
        let comment: String = lines.iter().map(|line| format!("# {line}\n")).collect();
        text.insert_str(at, &comment);
    }
}

fn head(draft: &Draft) -> String {
    let mut lines = vec![format!(
        "A first vehicle file, drafted from {}. Every number below was estimated from it.",
        draft.log
    )];
    lines.extend(draft.parts().map(|part| format!("Part of it: {part}.")));
    lines.push("Predictions of held-out data:".into());
    lines.extend(draft.axes.iter().map(|axis| format!("  {}.", axis.sentence())));
    for left in &draft.left_out {
        lines.push(format!("Left out: {}: {}", left.output, left.why));
    }
    lines.iter().map(|line| format!("# {line}\n")).collect()
}

/// Comment lines that describe the matrices.
fn model(draft: &Draft) -> Vec<String> {
    let mut lines = vec![format!(
        "Each axis was fitted separately by prediction error in steps of {} s; its structure was chosen by predictions of held-out data:",
        number(draft.period_s)
    )];
    for axis in &draft.axes {
        let values: Vec<String> = axis.parameters.iter().map(ParameterAnswer::sentence).collect();
        lines.push(format!(
            "  {} from {}, {}: {}",
            axis.output,
            axis.driven_by(),
            axis.words,
            values.join(", ")
        ));
    }
    lines.extend(
        draft.angles.iter().map(|angle| format!("  {angle} is the integral of its rate by definition.")),
    );
    lines
}

fn effect_comment(kind: Kind, place: &str, draft: &Draft) -> String {
    if kind == Kind::InputBias {
        return format!("Trim: the offset of {place} that keeps the output at its mean in the record.");
    }
    let start = format!("{kind}({place})");
    let all = draft.axes.iter().flat_map(|axis| &axis.parameters);
    let values: Vec<String> =
        all.filter(|p| p.name.starts_with(&start)).map(ParameterAnswer::sentence).collect();
    format!("Fitted: {}.", values.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_comment_stands_above_the_line_that_it_is_about() {
        let mut text = "A = [\n]\n\n[[inputs]]\nname = \"u\"\n".to_string();
        above(&mut text, "[[inputs]]\nname = \"u\"", &["Limits.".into()]);
        above(&mut text, "A = [", &["Model.".into(), "More.".into()]);
        above(&mut text, "nothing", &["lost".into()]);
        assert_eq!(text, "# Model.\n# More.\nA = [\n]\n\n# Limits.\n[[inputs]]\nname = \"u\"\n");
    }
}
