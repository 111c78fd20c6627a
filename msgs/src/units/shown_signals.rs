//! Units in which a vehicle's signals and the entries of its matrices are shown to a reader.

use super::ShownUnit;

/// Shown units of all signals of a vehicle, from which those of matrix entries follow.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ShownSignals {
    states: Vec<(String, ShownUnit)>,
    inputs: Vec<(String, ShownUnit)>,
    outputs: Vec<(String, ShownUnit)>,
}

impl ShownSignals {
    /// Shown units from names and units in the order of the vehicle.
    pub fn new(
        states: impl IntoIterator<Item = (String, ShownUnit)>,
        inputs: impl IntoIterator<Item = (String, ShownUnit)>,
        outputs: impl IntoIterator<Item = (String, ShownUnit)>,
    ) -> Self {
        let [states, inputs, outputs] =
            [states.into_iter().collect(), inputs.into_iter().collect(), outputs.into_iter().collect()];
        Self { states, inputs, outputs }
    }

    /// Shown unit of a signal by name, or of a matrix entry as in effects (`A[2,1]`); `None` for names not in
    /// the vehicle.
    pub fn of(&self, place: &str) -> Option<ShownUnit> {
        let mut signals = self.outputs.iter().chain(&self.inputs).chain(&self.states);
        let signal = signals.find(|(name, _)| name == place);
        signal.map(|(_, unit)| unit.clone()).or_else(|| self.entry(place))
    }

    fn entry(&self, place: &str) -> Option<ShownUnit> {
        let (matrix, indices) = place.strip_suffix(']')?.split_once('[')?;
        let (row, column) = indices.split_once(',')?;
        let at = |list: &[(String, ShownUnit)], index: &str| {
            let index: usize = index.trim().parse().ok()?;
            Some(list.get(index.checked_sub(1)?)?.1.clone())
        };
        let of = match matrix {
            "A" | "B" => at(&self.states, row)?.per_second(),
            "C" | "D" => at(&self.outputs, row)?,
            _ => return None,
        };
        let per = match matrix {
            "A" | "C" => at(&self.states, column)?,
            _ => at(&self.inputs, column)?,
        };
        Some(of.over(&per))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signals(list: &[(&str, &str)]) -> Vec<(String, ShownUnit)> {
        let of = |(name, unit): &(&str, &str)| {
            (name.to_string(), ShownUnit::declared(&unit.parse().unwrap(), unit))
        };
        list.iter().map(of).collect()
    }

    #[test]
    fn an_entry_is_shown_in_the_units_of_its_signals() {
        let shown = ShownSignals::new(
            signals(&[("tilt", "mrad"), ("rate", "rad/s")]),
            signals(&[("drive", "1"), ("wheel", "V")]),
            signals(&[("tilt", "deg")]),
        );
        for (place, si, told) in [
            ("rate", "rad/s", "2.00 rad/s"),
            ("tilt", "rad", "115 deg"),
            // "mrad/s/rad/s" would divide by s twice: SI is shown.
            ("A[1,2]", "", "2.00"),
            ("A[2,1]", "1/s^2", "0.00200 rad/s^2/mrad"),
            ("A[2,2]", "1/s", "2.00 1/s"),
            ("B[2,1]", "rad/s^2", "2.00 rad/s^2"),
            ("B[1,2]", "rad*s^2*A/kg/m^2", "2000 mrad/s/V"),
            ("B[2,2]", "rad*s*A/kg/m^2", "2.00 rad/s^2/V"),
            ("C[1,1]", "", "0.115 deg/mrad"),
        ] {
            let unit = shown.of(place).unwrap();
            assert_eq!((unit.si_symbol(), unit.text(2.0).as_str()), (si, told), "{place}");
        }
        for nothing in ["A[3,1]", "A[0,1]", "A[1]", "E[1,1]", "yaw", "B[1,x]"] {
            assert_eq!(shown.of(nothing), None, "{nothing}");
        }
    }
}
