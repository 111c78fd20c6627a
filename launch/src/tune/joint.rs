//! Parameters that are drawn jointly, with the correlations of their errors from the diagnosis.

use nalgebra::{DMatrix, DVector};
use whirlstand_campaign::correlation_root;
use whirlstand_diagnose::answer::{Cause, Correlation};
use whirlstand_vehicle::Stream;

/// Standard deviations from the centre to either end of an interval that holds 95 %.
const NINETY_FIVE: f64 = 1.96;

/// The joint normal distribution of the parameters of all causes.
#[derive(Debug, Clone)]
pub(super) struct Joint<'a> {
    causes: &'a [Cause],
    /// A root of the correlation matrix; `None` where all parameters are independent.
    root: Option<DMatrix<f64>>,
}

impl<'a> Joint<'a> {
    /// The distribution of the parameters of these causes. Pairs without a correlation are independent.
    pub fn new(causes: &'a [Cause], correlations: &[Correlation]) -> Self {
        let names: Vec<_> = causes
            .iter()
            .flat_map(|c| c.parameters.keys().map(move |name| (&c.effect, &c.place, name)))
            .collect();
        let mut matrix = DMatrix::identity(names.len(), names.len());
        for correlation in correlations {
            let [first, second] = correlation
                .between
                .each_ref()
                .map(|p| names.iter().position(|n| *n == (&p.effect, &p.place, &p.parameter)));
            if let (Some(i), Some(j)) = (first, second)
                && i != j
            {
                (matrix[(i, j)], matrix[(j, i)]) = (correlation.coefficient, correlation.coefficient);
            }
        }
        let root = Some(&matrix).filter(|matrix| !matrix.is_identity(0.0)).and_then(correlation_root);
        Self { causes, root }
    }

    /// A draw: cause, parameter and value, in the order of the causes. A parameter without an interval is left
    /// out.
    pub fn draw(&self, seed: u64) -> Vec<(&'a Cause, &'a str, f64)> {
        let mut normal = Vec::new();
        for cause in self.causes {
            let mut stream = Stream::new(seed, &format!("tune/{}/{}", cause.effect, cause.place));
            normal.extend(cause.parameters.iter().map(|_| stream.normal()));
        }
        if let Some(root) = &self.root {
            normal = (root * DVector::from_vec(normal)).as_slice().to_vec();
        }
        let parameters = self.causes.iter().flat_map(|c| c.parameters.iter().map(move |p| (c, p)));
        parameters
            .zip(normal)
            .filter_map(|((cause, (name, estimate)), normal)| {
                let deviation = (estimate.high - estimate.low) / (2.0 * NINETY_FIVE);
                deviation.is_finite().then_some((cause, name.as_str(), estimate.value + deviation * normal))
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use whirlstand_diagnose::answer::{Estimate, Evidence, ParameterPlace};
    use whirlstand_msgs::units::ShownUnit;

    use super::*;

    fn cause(effect: &str, parameter: &str, value: f64, half: f64) -> Cause {
        let (low, high) = (value - half, value + half);
        let estimate = Estimate { value, low, high, unit: ShownUnit::default() };
        Cause {
            effect: effect.into(),
            place: "u_roll".into(),
            parameters: BTreeMap::from([(parameter.to_owned(), estimate)]),
            text: None,
            evidence: Evidence {
                delta_bic: 0.0,
                heldout_gain_sigma: 0.0,
                share_of_residual: 0.0,
                p_value: 0.0,
                detectability: 0.0,
            },
            indistinguishable: Vec::new(),
            notes: Vec::new(),
        }
    }

    fn correlation(coefficient: f64) -> Correlation {
        let place = |effect: &str, parameter: &str| ParameterPlace {
            effect: effect.into(),
            place: "u_roll".into(),
            parameter: parameter.into(),
        };
        let between = [place("input_delay", "delay_s"), place("actuator_lag", "time_constant_s")];
        Correlation { between, coefficient }
    }

    /// Standard deviations and correlation of many draws.
    fn spread(joint: &Joint<'_>) -> (f64, f64, f64) {
        let draws: Vec<[f64; 2]> = (0..4000)
            .map(|seed| {
                let drawn = joint.draw(seed);
                [drawn[0].2 - 0.1, drawn[1].2 - 0.2]
            })
            .collect();
        let mean = |f: &dyn Fn(&[f64; 2]) -> f64| draws.iter().map(f).sum::<f64>() / draws.len() as f64;
        let (a, b) = (mean(&|d| d[0] * d[0]).sqrt(), mean(&|d| d[1] * d[1]).sqrt());
        (a, b, mean(&|d| d[0] * d[1]) / (a * b))
    }

    #[test]
    fn draws_have_the_intervals_and_the_correlation_of_the_diagnosis() {
        let causes = [
            cause("input_delay", "delay_s", 0.1, 0.0196),
            cause("actuator_lag", "time_constant_s", 0.2, 0.098),
        ];
        for wanted in [-0.95, 0.0, 0.6, 1.0] {
            let (a, b, found) = spread(&Joint::new(&causes, &[correlation(wanted)]));
            assert!((a - 0.01).abs() < 0.0005 && (b - 0.05).abs() < 0.0025, "{a} {b}");
            assert!((found - wanted).abs() < 0.05, "{found} in place of {wanted}");
        }
        // The sum of a delay and a lag is known far better than either of them: their correlation is -0.95.
        let narrow = [
            cause("input_delay", "delay_s", 0.1, 0.0196),
            cause("actuator_lag", "time_constant_s", 0.2, 0.0196),
        ];
        let sum = |correlations: &[Correlation]| {
            let joint = Joint::new(&narrow, correlations);
            let sums = (0..4000).map(|seed| joint.draw(seed).iter().map(|d| d.2).sum::<f64>() - 0.3);
            (sums.map(|s| s * s).sum::<f64>() / 4000.0).sqrt()
        };
        let (alone, together) = (sum(&[]), sum(&[correlation(-0.95)]));
        assert!(together < 0.3 * alone, "{alone} {together}");
    }

    #[test]
    fn independent_parameters_are_drawn_as_ever() {
        let causes = [cause("input_delay", "delay_s", 0.1, 0.0196)];
        let joint = Joint::new(&causes, &[correlation(0.5)]);
        let normal = Stream::new(7, "tune/input_delay/u_roll").normal();
        assert!((joint.draw(7)[0].2 - 0.1 - 0.01 * normal).abs() < 1e-15);
    }
}
