//! Built-in vehicles.

use whirlstand_msgs::names::did_you_mean;

use crate::error::{VehicleError, list};
use crate::model::Vehicle;

const FILES: &[(&str, &str)] = &[
    ("quadrotor", include_str!("../vehicles/quadrotor.toml")),
    ("helicopter-hover", include_str!("../vehicles/helicopter-hover.toml")),
    ("helicopter-longitudinal", include_str!("../vehicles/helicopter-longitudinal.toml")),
    ("helicopter-lateral", include_str!("../vehicles/helicopter-lateral.toml")),
];

/// The paper's model structures without numbers, as templates for identification; not vehicles, since they do
/// not move before a fit.
const TEMPLATES: &[(&str, &str)] = &[
    ("quadrotor-structure", include_str!("../vehicles/quadrotor-structure.toml")),
    ("helicopter-structure", include_str!("../vehicles/helicopter-structure.toml")),
];

/// Names of the built-in templates for identification.
pub fn template_names() -> impl Iterator<Item = &'static str> {
    TEMPLATES.iter().map(|(name, _)| *name)
}

/// Names of the built-in vehicles.
pub fn builtin_names() -> impl Iterator<Item = &'static str> {
    FILES.iter().map(|(name, _)| *name)
}

/// Text of a built-in vehicle file.
pub(crate) fn text(name: &str) -> Option<&'static str> {
    FILES.iter().chain(TEMPLATES).find(|(n, _)| *n == name).map(|(_, text)| *text)
}

impl Vehicle {
    /// The built-in vehicle with the given name.
    ///
    /// # Errors
    /// [`VehicleError::Unknown`] for an unknown name; the message suggests the nearest and lists all.
    pub fn builtin(name: &str) -> Result<Self, VehicleError> {
        let text = text(name).ok_or_else(|| VehicleError::Unknown {
            name: name.into(),
            nearest: did_you_mean(name, builtin_names().chain(template_names())),
            known: list(builtin_names().chain(template_names())),
        })?;
        Ok(Self::parse(text, name)?)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Complex, DMatrix};

    use super::*;

    fn check(name: &str, expected: &[(f64, f64)]) {
        let vehicle = Vehicle::builtin(name).unwrap();
        assert_eq!(vehicle.name, name);
        let poles = vehicle.poles().unwrap();
        assert_eq!(poles.len(), expected.len(), "{name}");
        let mut left: Vec<Complex<f64>> = poles.clone();
        for &(re, im) in expected {
            let found = left.iter().position(|p| (p.re - re).abs() <= 6e-4 && (p.im - im).abs() <= 6e-4);
            let index = found.unwrap_or_else(|| panic!("{name}: no pole at {re} {im:+}i in {left:?}"));
            left.swap_remove(index);
        }
        // Hautus test: [A - p I, B] has full row rank at every pole.
        let n = vehicle.a.nrows();
        for pole in &poles {
            let pencil = DMatrix::from_fn(n, n + vehicle.b.ncols(), |i, j| {
                if j < n {
                    Complex::from(vehicle.a[(i, j)]) - if i == j { *pole } else { Complex::from(0.0) }
                } else {
                    Complex::from(vehicle.b[(i, j - n)])
                }
            });
            let singular = whirlstand_linalg::singular_values(&pencil).unwrap();
            assert!(singular.min() > 1e-6 * singular.max(), "{name}: not controllable at {pole}");
        }
    }

    #[test]
    fn poles_are_those_of_the_paper() {
        let pair = |re: f64, im: f64| [(re, im), (re, -im)];
        check("quadrotor", &[pair(-2.624, 1.052), pair(-0.356, 0.993)].concat());
        let real = |values: &[f64]| values.iter().map(|&v| (v, 0.0)).collect::<Vec<_>>();
        let hover =
            [real(&[0.0, 0.0, -1.168, -4.457, -1.991, -0.387]), pair(-0.355, 1.624).to_vec()].concat();
        check("helicopter-hover", &hover);
        let longitudinal =
            [real(&[0.0, 0.0, -0.126, -0.972]), pair(-0.546, 3.783).to_vec(), pair(-1.278, 0.527).to_vec()];
        check("helicopter-longitudinal", &longitudinal.concat());
        let lateral =
            [real(&[0.0, 0.0, -0.929, -0.155]), pair(-2.600, 2.491).to_vec(), pair(-1.595, 1.838).to_vec()];
        check("helicopter-lateral", &lateral.concat());
    }

    #[test]
    fn degrees_become_radians() {
        let hover = Vehicle::builtin("helicopter-hover").unwrap();
        let degree = std::f64::consts::PI / 180.0;
        let close = |a: f64, b: f64| assert!((a - b).abs() <= 1e-14 * b.abs(), "{a} {b}");
        close(hover.a[(4, 0)], 0.3604 / degree);
        close(hover.b[(1, 0)], 1.2969 * degree);
        assert_eq!(hover.a[(1, 0)], -0.0897);
        close(hover.outputs[hover.output_index("roll_rate").unwrap()].noise, 0.4 * degree);
        close(hover.outputs[hover.output_index("lateral_position").unwrap()].noise, 0.05);
    }
}
