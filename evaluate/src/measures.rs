//! The second pass over a run's log: computes the figures and thins the lines, message by message.

use std::collections::BTreeMap;

use whirlstand_logs::BenchMessage;
use whirlstand_msgs::{Command, Estimate, Message, Setpoint, Truth, flags};
use whirlstand_vehicle::{Input, Vehicle};

use crate::health::NodeHealth;
use crate::layout::{Layout, seconds};
use crate::lines::{ErrorLines, Lines, NisLine, OutputLines};
use crate::merge::Merge;
use crate::metrics::{Consistency, ConsistencySum, Effort, EffortSum, FailsafeSteps, Timing, timing};
use crate::output::OutputSum;
use crate::spectra::SpectrumSum;
use crate::summary::OutputFigures;
use crate::survey::Survey;

/// The signal from which the outputs are judged: the best one in the log.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Source {
    Truth,
    Estimate,
    Measured,
}

/// Figures and lines of a run.
pub(crate) struct Measured {
    /// Figures of the outputs, by name.
    pub outputs: BTreeMap<String, OutputFigures>,
    /// Effort of the inputs, by name.
    pub inputs: BTreeMap<String, Effort>,
    pub estimator: Option<Consistency>,
    pub timing: Timing,
    pub lines: Lines,
}

/// Accumulates figures and lines of a run from its messages in the order of their time.
pub(crate) struct Measures<'a> {
    layout: &'a Layout,
    period_s: f64,
    source: Source,
    has_truth: bool,
    outputs: Vec<OutputSum>,
    inputs: Vec<EffortSum<1>>,
    consistency: ConsistencySum,
    lines: Lines,
    output_spectra: Vec<SpectrumSum>,
    input_spectra: Vec<SpectrumSum>,
    /// Present reference of each output; `None` before the first setpoint.
    wanted: Option<Vec<f64>>,
    /// The last truth.
    truth: Option<Truth>,
    failsafe: FailsafeSteps,
}

impl<'a> Measures<'a> {
    pub fn new(vehicle: &Vehicle, layout: &'a Layout, survey: &Survey, period_s: f64) -> Self {
        let (source, name) = match (survey.has(1), survey.has(2)) {
            (true, _) => (Source::Truth, "truth"),
            (false, true) => (Source::Estimate, "estimate"),
            (false, false) => (Source::Measured, "measured"),
        };
        let outputs = vehicle.outputs.iter().zip(survey.parts()).zip(&survey.tracked);
        let outputs = outputs.map(|((output, parts), tracked)| {
            OutputSum::new(output.unit.shown(), name, *tracked, output.noise, parts)
        });
        Self {
            layout,
            period_s,
            source,
            has_truth: survey.has(1),
            outputs: outputs.collect(),
            inputs: vehicle.inputs.iter().map(|input| EffortSum::new(input.lower, input.upper)).collect(),
            consistency: ConsistencySum::new(layout.states, survey.first_onset_s(), &survey.claimed),
            lines: Lines {
                outputs: vec![OutputLines::default(); layout.outputs()],
                inputs: vec![Default::default(); layout.inputs],
                nis: NisLine::new(period_s),
                errors: vec![ErrorLines::default(); layout.states],
                ..Lines::default()
            },
            output_spectra: vehicle
                .outputs
                .iter()
                .map(|output| SpectrumSum::new(f64::from(output.every) * period_s))
                .collect(),
            input_spectra: vec![SpectrumSum::new(period_s); layout.inputs],
            wanted: None,
            truth: None,
            failsafe: FailsafeSteps::default(),
        }
    }

    /// Takes in the next message; `coming` has the following ones.
    pub fn take(&mut self, message: &BenchMessage, coming: &Merge) {
        match message {
            BenchMessage::Truth(m) => self.take_truth(m, coming),
            BenchMessage::Estimate(m) => self.take_estimate(m, coming),
            BenchMessage::Setpoint(m) => self.take_setpoint(m),
            BenchMessage::Command(m) if m.flags & flags::WITHHELD != 0 => {}
            BenchMessage::Command(m) => self.take_command(m),
            BenchMessage::Imu(m) => self.take_measured(m, coming),
            BenchMessage::Odometry(m) => self.take_measured(m, coming),
            BenchMessage::Outputs(m) => self.take_measured(m, coming),
            BenchMessage::Disturbance(_)
            | BenchMessage::Sent(_)
            | BenchMessage::Reported(_)
            | BenchMessage::Autopilot(_)
            | BenchMessage::Finding(_)
            | BenchMessage::Adjustment(_)
            | BenchMessage::Health(_) => {}
        }
    }

    /// Present reference of output `i`; before the first setpoint, that of the first one.
    fn wanted(&self, i: usize, coming: &Merge) -> f64 {
        match (&self.wanted, coming.next_setpoint()) {
            (Some(wanted), _) => wanted[i],
            (None, Some(BenchMessage::Setpoint(first))) => self.layout.wanted(first)[i],
            _ => f64::NAN,
        }
    }

    fn take_truth(&mut self, m: &Truth, coming: &Merge) {
        let t = seconds(m);
        let (x, u) = (&m.x[..self.layout.states], &m.u[..self.layout.inputs]);
        for i in 0..self.outputs.len() {
            let y = self.layout.output(i, x, u);
            self.lines.outputs[i].truth.push(t, y);
            let wanted = self.wanted(i, coming);
            self.outputs[i].take(t, y, wanted);
        }
        self.take_inputs(t, u);
        if m.flags & flags::HELD != 0 {
            self.lines.held.take(t, self.period_s);
        }
        self.failsafe.of_steps += 1;
        if m.flags & flags::FAILSAFE != 0 {
            self.lines.failsafe.take(t, self.period_s);
            self.failsafe.at_end += 1;
        } else {
            self.failsafe.at_end = 0;
        }
        self.truth = Some(*m);
    }

    fn take_estimate(&mut self, m: &Estimate, coming: &Merge) {
        let t = seconds(m);
        for i in 0..self.outputs.len() {
            let y = self.layout.output(i, &m.x[..self.layout.states], &[]);
            self.lines.outputs[i].estimate.push(t, y);
            if self.source == Source::Estimate {
                let wanted = self.wanted(i, coming);
                self.outputs[i].take(t, y, wanted);
            }
        }
        self.lines.nis.take(t, m.nis, f64::from(m.dof));
        // Truth and estimate of a step have the same stamp.
        let truth = self.truth.filter(|truth| (seconds(truth) - t).abs() < 1e-9);
        if let Some(truth) = &truth {
            for (i, lines) in self.lines.errors.iter_mut().enumerate() {
                lines.error.push(t, m.x[i] - truth.x[i]);
                lines.claimed.push(t, m.std[i]);
            }
        }
        self.consistency.take(t, m, truth.as_ref().map(|truth| &truth.x[..]));
    }

    fn take_setpoint(&mut self, m: &Setpoint) {
        let wanted = self.layout.wanted(m);
        for (lines, wanted) in self.lines.outputs.iter_mut().zip(&wanted) {
            lines.wanted.push(seconds(m), *wanted);
        }
        self.wanted = Some(wanted);
    }

    fn take_command(&mut self, m: &Command) {
        if !self.has_truth {
            self.take_inputs(seconds(m), &m.u[..self.layout.inputs]);
        }
    }

    fn take_inputs(&mut self, t: f64, u: &[f64]) {
        let inputs = self.inputs.iter_mut().zip(&mut self.lines.inputs).zip(&mut self.input_spectra);
        for (((sum, line), spectrum), u) in inputs.zip(u) {
            sum.take(&[*u]);
            line.push(t, *u);
            spectrum.take(t, *u);
        }
    }

    /// Takes in the fresh values of a sensor's message.
    fn take_measured<M: Message>(&mut self, message: &M, coming: &Merge) {
        let t = seconds(message);
        for (i, y) in self.layout.measured(message) {
            self.lines.outputs[i].measured.push(t, y);
            self.output_spectra[i].take(t, y);
            if self.source == Source::Measured {
                let wanted = self.wanted(i, coming);
                self.outputs[i].take(t, y, wanted);
            }
        }
    }

    /// Figures and lines of all messages.
    pub fn finish(mut self, vehicle: &Vehicle, health: &[NodeHealth]) -> Measured {
        self.lines.nis.finish();
        self.lines.output_spectra = self.output_spectra.into_iter().map(SpectrumSum::finish).collect();
        self.lines.input_spectra = self.input_spectra.into_iter().map(SpectrumSum::finish).collect();
        let outputs = vehicle.outputs.iter().zip(self.outputs);
        let inputs = vehicle.inputs.iter().zip(&self.inputs);
        let states = vehicle.states.iter().map(|state| (state.name.clone(), state.unit.shown()));
        let effort = |(input, sum): (&Input, &EffortSum<1>)| {
            (input.name.clone(), sum.finish(0, self.period_s, input.unit.shown()))
        };
        Measured {
            outputs: outputs.map(|(output, sum)| (output.name.clone(), sum.finish())).collect(),
            inputs: inputs.map(effort).collect(),
            estimator: self.consistency.finish(states),
            timing: timing(
                health,
                self.lines.held.steps,
                FailsafeSteps { steps: self.lines.failsafe.steps, ..self.failsafe },
            ),
            lines: self.lines,
        }
    }
}
