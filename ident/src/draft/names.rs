//! Names of signals: their parts, and names that a vehicle file allows.

use std::path::Path;

/// The last part of a name: `control[0]` of `/fcu/actuator.control[0]`.
pub fn last_part(name: &str) -> &str {
    let (head, index) = name.split_at(name.find('[').unwrap_or(name.len()));
    let start = head.rfind(['.', '/', ' ']).map_or(0, |at| at + 1);
    if index.is_empty() { &head[start..] } else { &name[start..] }
}

/// Name of a vehicle from that of its own file, without extension, else of the log; without characters that a name
/// may not have.
pub fn model_name(log: &str, file: Option<&str>) -> String {
    let of_log = || Path::new(log).file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let clean = valid_name(&file.map(String::from).or_else(of_log).unwrap_or_default());
    if clean.is_empty() { "drafted".into() } else { clean }
}

/// A name that a vehicle file allows: `control_0` of `control[0]`.
pub fn valid_name(name: &str) -> String {
    let mut clean = String::new();
    for c in name.chars() {
        let allowed = c.is_alphanumeric() || matches!(c, '_' | '-' | '.');
        if allowed {
            clean.push(c);
        } else if !clean.is_empty() && !clean.ends_with('_') {
            clean.push('_');
        }
    }
    clean.trim_end_matches('_').into()
}

pub fn vehicle_name(name: &str, clocks: bool) -> String {
    let own = valid_name(last_part(name));
    if clocks && !own.starts_with("u_") { format!("u_{own}") } else { own }
}

/// Words of a name: `motor` and `1` of `motor1`, `pwm` and `fl` of `pwmFL`.
pub fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = vec![String::new()];
    let mut last = '_';
    for c in name.chars() {
        let begins = c.is_ascii_digit() != last.is_ascii_digit() || c.is_uppercase() && last.is_lowercase();
        if !c.is_alphanumeric() || begins {
            words.push(String::new());
        }
        if c.is_alphanumeric() {
            words.last_mut().expect("there is always one").extend(c.to_lowercase());
        }
        last = c;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// A source without its unit in brackets.
pub fn bare(source: &str) -> &str {
    whirlstand_logs::split_unit(source).0
}

#[cfg(test)]
mod tests {
    use super::model_name;

    /// A browser saves a second download as `flight (2).ulg`; the name of a vehicle has no brackets.
    #[test]
    fn a_vehicle_is_named_after_its_file_without_what_a_name_may_not_have() {
        assert_eq!(model_name("logs/flight (2).ulg", None), "flight_2");
        assert_eq!(model_name("flight.ulg", Some("mine 1e+06")), "mine_1e_06");
        assert_eq!(model_name("flight.v2.ulg", Some("mine.v2")), "mine.v2");
        assert_eq!(model_name("+.ulg", None), "drafted");
    }
}
