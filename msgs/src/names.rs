//! Suggestions for mistyped names, in one wording for the whole program.

/// Smallest similarity of a suggested name: at least half of the letters match.
const LEAST_LIKENESS: f64 = 0.5;

/// Shortest name that counts as similar by being part of another.
const LEAST_PART: usize = 3;

/// The known name most similar to `wanted`, if any is similar; the first of equal ones.
///
/// Similarity is the share of letters that need no edit (Damerau-Levenshtein distance, ignoring case) of the
/// whole name or of the last part of a path such as `/imu.roll`; a name that contains the other is similar,
/// and more so the less it adds.
pub fn nearest<'n>(wanted: &str, known: impl IntoIterator<Item = &'n str>) -> Option<&'n str> {
    let wanted = wanted.to_lowercase();
    let mut best = None;
    for name in known {
        let likeness = likeness(&wanted, &name.to_lowercase());
        if likeness >= LEAST_LIKENESS && best.is_none_or(|(greatest, _)| likeness > greatest) {
            best = Some((likeness, name));
        }
    }
    best.map(|(_, name)| name)
}

/// Suggestion ` (did you mean 'x'?)`, to follow an unknown name; empty when no known name is similar.
pub fn did_you_mean<'n>(wanted: &str, known: impl IntoIterator<Item = &'n str>) -> String {
    nearest(wanted, known).map_or(String::new(), |name| format!(" (did you mean '{name}'?)"))
}

fn likeness(wanted: &str, name: &str) -> f64 {
    let end = name.rsplit(['.', '/']).next().unwrap_or(name);
    [name, end]
        .map(|name| strsim::normalized_damerau_levenshtein(wanted, name).max(contained(wanted, name)))
        .into_iter()
        .fold(0.0, f64::max)
}

fn contained(a: &str, b: &str) -> f64 {
    let (short, long) = if a.len() < b.len() { (a, b) } else { (b, a) };
    if short.len() >= LEAST_PART && long.contains(short) {
        0.5 + 0.5 * short.len() as f64 / long.len() as f64
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_the_one_that_was_meant() {
        let known = ["mode", "rate_hz", "duration_s", "transport", "controller", "/imu.pitch"];
        for (typed, meant) in [
            ("rate", "rate_hz"),
            ("duration", "duration_s"),
            ("contoller", "controller"),
            ("Mode", "mode"),
            ("pitch", "/imu.pitch"),
            ("ptich", "/imu.pitch"),
        ] {
            assert_eq!(nearest(typed, known), Some(meant));
        }
    }

    #[test]
    fn what_is_like_nothing_known_is_not_guessed() {
        assert_eq!(nearest("x", []), None);
        assert_eq!(nearest("u_thrust", ["roll", "/imu.pitch"]), None);
        assert_eq!(did_you_mean("u_thrust", ["roll", "/imu.pitch"]), "");
        assert_eq!(did_you_mean("rol", ["roll", "/imu.pitch"]), " (did you mean 'roll'?)");
    }
}
