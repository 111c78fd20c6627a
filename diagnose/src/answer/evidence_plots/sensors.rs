//! Evidence curves of sensor effects: residuals of the outputs themselves.

use super::{PlotInput, Traces, folded};
use crate::answer::curves::loudest;
use crate::answer::schema::{Axis, EvidenceCurve, Points};

impl PlotInput<'_> {
    /// Sample times of a channel, with its residual, the part that the cause explains, and the part that the
    /// rival explains.
    fn channel(&self, output: usize) -> Option<(Vec<f64>, Traces)> {
        let c = self.data.channels.iter().position(|c| c.output == output)?;
        let (channel, range) = (&self.data.channels[c], self.data.ranges()[c].clone());
        let t = (0..channel.values.len())
            .map(|k| self.data.start_s + channel.step(k) as f64 * self.data.period_s)
            .collect();
        let of = |predicted: &[f64]| self.residual(predicted)[range.clone()].to_vec();
        let traces = Traces {
            explained: of(self.with),
            measured: of(&self.data.measured()),
            rival: self.rival.map(of),
        };
        Some((t, traces))
    }

    fn residual_label(&self, output: usize) -> Axis {
        let output = &self.vehicle.outputs[output];
        Axis::new(&format!("residual of {}", output.name), output.unit.shown())
    }

    /// Simulated values of one output at the sample times of another.
    fn simulated(&self, output: usize, like: usize) -> Option<Vec<f64>> {
        let find = |output: usize| self.data.channels.iter().position(|c| c.output == output);
        let (own, other) = (find(output)?, find(like)?);
        let range = self.data.ranges()[own].clone();
        let (own, other) = (&self.data.channels[own], &self.data.channels[other]);
        let values = &self.without[range];
        let at = |k: usize| (other.step(k).saturating_sub(own.first) / own.stride).min(values.len() - 1);
        Some((0..other.values.len()).map(|k| values[at(k)]).collect())
    }

    pub(crate) fn offset(&self, output: usize) -> Option<EvidenceCurve> {
        let (t, traces) = self.channel(output)?;
        Some(self.scatter(
            &t,
            traces,
            "A constant error is a bias, one that grows with time is a drift; both are independent of the motion.",
            Axis::time("time"),
            self.residual_label(output),
        ))
    }

    /// Residual of an output against the simulated values of another output.
    pub(crate) fn against(&self, output: usize, other: usize) -> Option<EvidenceCurve> {
        let (_, traces) = self.channel(output)?;
        let x = self.simulated(other, output)?;
        let o = &self.vehicle.outputs[other];
        Some(self.scatter(
            &x,
            traces,
            "A straight line through zero: the error is proportional to the signal.",
            Axis::new(&format!("{} as simulated", o.name), o.unit.shown()),
            self.residual_label(output),
        ))
    }

    pub(crate) fn against_slope(&self, output: usize) -> Option<EvidenceCurve> {
        let (t, traces) = self.channel(output)?;
        let y = self.simulated(output, output)?;
        let n = y.len();
        let slope = |k: usize| {
            let (a, b) = (k.saturating_sub(1), (k + 1).min(n - 1));
            (y[b] - y[a]) / (t[b] - t[a])
        };
        let x: Vec<f64> = (0..n).map(slope).collect();
        let o = &self.vehicle.outputs[output];
        Some(self.scatter(
            &x,
            traces,
            "The error of a delayed sensor is proportional to the slope of the signal: a falling line.",
            Axis::new(&format!("slope of {} as simulated", o.name), o.unit.shown().per_second()),
            self.residual_label(output),
        ))
    }

    pub(crate) fn tone(&self, output: usize, frequency_hz: f64) -> Option<EvidenceCurve> {
        let (t, traces) = self.channel(output)?;
        let x = folded(&t, frequency_hz)?;
        Some(self.scatter(
            &x,
            traces,
            "Folded over one period, the residual is a wave.",
            Axis::time(&format!("time within a period of {frequency_hz:.3} Hz")),
            self.residual_label(output),
        ))
    }

    /// Residual over time of the output, and in the time window, in which the cause is clearest.
    pub(crate) fn over_time(&self) -> Option<EvidenceCurve> {
        let explained = self.residual(self.with);
        let ranges = self.data.ranges();
        let strength = |c: usize| {
            let noise = self.noise[c].max(f64::MIN_POSITIVE);
            explained[ranges[c].clone()].iter().map(|d| (d / noise).powi(2)).sum::<f64>()
        };
        let c = (0..ranges.len()).max_by(|a, b| strength(*a).total_cmp(&strength(*b)))?;
        let output = self.data.channels[c].output;
        let (t, traces) = self.channel(output)?;
        let part = loudest(&traces.explained, 1500);
        let draw = |y: &[f64]| -> Points { (t[part.clone()].to_vec(), y[part.clone()].to_vec()) };
        Some(EvidenceCurve {
            without: (vec![t[part.start], t[part.end - 1]], vec![0.0, 0.0]),
            ..traces.all(draw).curve(
                "The part of the record where it is clearest.",
                Axis::time("time"),
                self.residual_label(output),
            )
        })
    }
}
