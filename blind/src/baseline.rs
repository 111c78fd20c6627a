//! The record of an experiment without hidden effects, with which the records with effects are compared.

use whirlstand_vehicle::{Effect, Kind};

use super::detect::Detector;
use super::error::BlindError;
use super::experiment::Experiment;
use super::facts::Facts;

/// Facts, detector and clean record with which effects are compared.
pub(crate) struct Baseline {
    pub facts: Facts,
    pub detector: Detector,
    /// The record without hidden effects.
    pub clean: Vec<f64>,
}

impl Baseline {
    pub fn new(experiment: &Experiment) -> Result<Self, BlindError> {
        let vehicle = &experiment.nominal.vehicle;
        Ok(Self {
            facts: Facts::new(vehicle, &experiment.commands, &experiment.x0)?,
            detector: Detector::new(vehicle, &experiment.noise, &experiment.x0, &experiment.commands),
            clean: experiment.record(&[], None)?,
        })
    }

    /// The difference of two records, whitened and without the part that the base model can imitate.
    pub fn signature(&self, with: &[f64], without: &[f64]) -> Vec<f64> {
        self.detector.signature(difference(with, without))
    }

    /// A detector that treats the scatter of the effect `other` as measurement noise.
    pub fn detector_with_noise_of(&self, experiment: &Experiment, other: &Effect) -> Detector {
        let vehicle = &experiment.nominal.vehicle;
        let mut noise = experiment.noise.clone();
        let more = match other.kind() {
            Kind::Noise => other.parameter("std").unwrap_or(0.0),
            Kind::Quantization => other.parameter("step").unwrap_or(0.0) / 12.0f64.sqrt(),
            _ => 0.0,
        };
        if let Some(i) = vehicle.output_index(other.place()) {
            noise.std[i] = noise.std[i].hypot(more);
        }
        Detector::new(vehicle, &noise, &experiment.x0, &experiment.commands)
    }

    /// Whether a record stays within ten times the peak of the clean record; an effect must not crash the
    /// vehicle.
    pub fn bounded(&self, record: &[f64]) -> bool {
        let p = self.facts.y.len();
        (0..p).all(|i| {
            let peak = |of: &[f64]| of.iter().skip(i).step_by(p).fold(0.0f64, |peak, y| peak.max(y.abs()));
            peak(record) <= 10.0 * peak(&self.clean)
        })
    }
}

/// The samplewise difference `with` minus `without`.
pub(crate) fn difference(with: &[f64], without: &[f64]) -> Vec<f64> {
    with.iter().zip(without).map(|(a, b)| a - b).collect()
}
