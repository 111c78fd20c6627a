//! Serde's short messages in the words of a launch file, with the nearest known key.

use whirlstand_msgs::names::did_you_mean;

/// A sentence on an unknown word: the nearest known word, and all known words.
pub(crate) fn unknown<'k>(what: &str, wanted: &str, known: impl IntoIterator<Item = &'k str>) -> String {
    let known: Vec<_> = known.into_iter().collect();
    if known.is_empty() {
        return format!("unknown {what} '{wanted}': none is known here, remove it");
    }
    let hint = did_you_mean(wanted, known.iter().copied());
    format!("unknown {what} '{wanted}'{hint}; known are {}", known.join(", "))
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
            .replace(", expected f64", ", expected a number")
            .replace(", expected i64", ", expected a whole number")
            .replace(", expected u64", ", expected a whole number")
            .replace(", expected u32", ", expected a whole number"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_of_serde_become_sentences() {
        assert_eq!(
            reworded("unknown field `lawe`, expected one of `law`, `gain`"),
            "unknown key 'lawe' (did you mean 'law'?); known are law, gain"
        );
        assert_eq!(reworded("missing field `law`"), "the key 'law' is missing here: add it");
        assert_eq!(
            reworded("invalid type: string \"x\", expected f64"),
            "this is of the wrong type: found string \"x\", expected a number"
        );
        assert_eq!(
            reworded("invalid type: string \"high\", expected i64"),
            "this is of the wrong type: found string \"high\", expected a whole number"
        );
    }
}
