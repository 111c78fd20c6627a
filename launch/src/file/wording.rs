//! Serde's short messages in the words of a launch file, with the nearest known key.

/// The known word that is most like `wanted`.
pub(crate) fn nearest<'k>(wanted: &str, known: impl IntoIterator<Item = &'k str>) -> Option<&'k str> {
    let likeness = |k: &str| strsim::normalized_damerau_levenshtein(wanted, k).max(contained(wanted, k));
    known.into_iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)))
}

/// A word that contains the other is like it, the more so the less it adds: `rate` is like `rate_hz`.
fn contained(a: &str, b: &str) -> f64 {
    let (short, long) = if a.len() < b.len() { (a, b) } else { (b, a) };
    if !short.is_empty() && long.contains(short) {
        0.5 + 0.5 * short.len() as f64 / long.len() as f64
    } else {
        0.0
    }
}

/// A sentence for a word that is not among the known ones: what it was meant to be, and the known ones.
pub(crate) fn unknown<'k>(what: &str, wanted: &str, known: impl IntoIterator<Item = &'k str>) -> String {
    let known: Vec<_> = known.into_iter().collect();
    match nearest(wanted, known.iter().copied()) {
        Some(near) => {
            format!(
                "unknown {what} '{wanted}'; the nearest known one is '{near}' (known: {})",
                known.join(", ")
            )
        }
        None => format!("unknown {what} '{wanted}': none is known here, remove it"),
    }
}

/// Serde's message in the words of a launch file.
pub(crate) fn reworded(message: &str) -> String {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    match quoted.split_first() {
        Some((wanted, known)) if message.starts_with("unknown field") => {
            unknown("key", wanted, known.iter().copied())
        }
        Some((wanted, known)) if message.starts_with("unknown variant") => {
            unknown("value", wanted, known.iter().copied())
        }
        Some((missing, _)) if message.starts_with("missing field") => {
            format!("the key '{missing}' is missing here: add it")
        }
        _ => message
            .replace("invalid type: ", "this is of the wrong type: found ")
            .replace("floating point", "number")
            .replace(", expected f64", ", expected a number"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_key_is_the_one_that_was_meant() {
        let known = ["mode", "rate_hz", "duration_s", "transport", "controller"];
        for (typed, meant) in
            [("rate", "rate_hz"), ("duration", "duration_s"), ("contoller", "controller"), ("Mode", "mode")]
        {
            assert_eq!(nearest(typed, known), Some(meant));
        }
        assert_eq!(nearest("x", []), None);
    }

    #[test]
    fn messages_of_serde_become_sentences() {
        assert_eq!(
            reworded("unknown field `lawe`, expected one of `law`, `gain`"),
            "unknown key 'lawe'; the nearest known one is 'law' (known: law, gain)"
        );
        assert_eq!(reworded("missing field `law`"), "the key 'law' is missing here: add it");
        assert_eq!(
            reworded("invalid type: string \"x\", expected f64"),
            "this is of the wrong type: found string \"x\", expected a number"
        );
    }
}
