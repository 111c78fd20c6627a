//! Evidence curve of each effect, on the axes on which an engineer recognises it.

mod sensors;

use whirlstand_logs::shown::ShownUnit;
use whirlstand_vehicle::{Effect, Kind, Matrix, Place, Vehicle};

use crate::answer::curves::{Steps, binned, ends, gains, joined, loudest, thinned};
use crate::answer::schema::{Axis, EvidenceCurve, Points};
use crate::data::record::Data;
use crate::model::input_reconstruction::{Entry, answers, reconstruct, spread};

/// Input of an evidence plot: a cause and the predictions that it changes.
pub(crate) struct PlotInput<'s> {
    pub data: &'s Data,
    pub vehicle: &'s Vehicle,
    /// Standard deviation of the noise of each channel.
    pub noise: &'s [f64],
    /// States over the steps of the record, predicted with the cause.
    pub states: Vec<Vec<f64>>,
    /// Predicted samples without the cause.
    pub without: &'s [f64],
    /// Predicted samples with the cause.
    pub with: &'s [f64],
    /// Predicted samples with a rival in place of the cause.
    pub rival: Option<&'s [f64]>,
}

/// Input or force missing at a place over the steps of a record: according to the cause, the record and the
/// rival.
struct Traces {
    explained: Vec<f64>,
    measured: Vec<f64>,
    rival: Option<Vec<f64>>,
}

impl Traces {
    fn all(&self, draw: impl Fn(&[f64]) -> Points) -> Lines {
        Lines {
            measured: draw(&self.measured),
            explained: draw(&self.explained),
            rival: self.rival.as_deref().map(draw),
        }
    }
}

struct Lines {
    measured: Points,
    explained: Points,
    rival: Option<Points>,
}

impl Lines {
    fn curve(self, caption: &str, x: Axis, y: Axis) -> EvidenceCurve {
        EvidenceCurve {
            caption: caption.into(),
            x,
            y,
            measured: self.measured,
            explained: self.explained,
            rival: self.rival.map(|points| (String::new(), points)),
            ..EvidenceCurve::default()
        }
    }
}

/// The evidence curve of an effect; the caller fills in the names of the cause and of the rival. `None` when
/// nothing can be drawn.
pub(crate) fn evidence_plot(shown: &PlotInput<'_>, effect: &Effect) -> Option<EvidenceCurve> {
    let parameter = |name: &str| effect.parameter(name).unwrap_or(0.0);
    let special = match (effect.kind(), effect.resolve(shown.vehicle).ok()?) {
        (Kind::DeadZone | Kind::InputSaturation | Kind::InputGain | Kind::InputBias, Place::Input(j)) => {
            shown.characteristic(j, effect.kind())
        }
        (Kind::Backlash, Place::Input(j)) => shown.play(j),
        (Kind::InputDelay, Place::Input(j)) => shown.arrival(j, 3.0 * parameter("delay_s")),
        (Kind::ActuatorLag, Place::Input(j)) => shown.arrival(j, 5.0 * parameter("time_constant_s")),
        (Kind::UnmodelledMode, Place::Input(j)) => {
            shown.arrival(j, 3.0 / parameter("frequency_hz").max(1e-3))
        }
        (Kind::RateLimit, Place::Input(j)) => shown.following(j),
        (Kind::GainDrift, Place::Input(j)) => shown.gain_over_time(j),
        (Kind::InputCoupling, Place::InputPair(from, onto)) => shown.coupling(from, onto),
        (Kind::ParameterChange, Place::Entry(Matrix::A, i, j)) => shown.force(i, j),
        (Kind::ParameterChange, Place::Entry(Matrix::B, i, j)) => shown.control(i, j),
        (Kind::QuadraticDrag | Kind::CoulombFriction, Place::State(i)) => shown.force(i, i),
        (Kind::CubicStiffness, Place::StatePair(from, onto)) => shown.force(onto, from),
        (Kind::StepDisturbance, Place::State(i)) => shown.event(i, f64::INFINITY),
        (Kind::PulseDisturbance, Place::State(i)) => {
            shown.event(i, (8.0 * parameter("duration_s")).max(10.0))
        }
        (Kind::PeriodicDisturbance, Place::State(i)) => shown.rhythm(i, parameter("frequency_hz")),
        (Kind::SensorBias | Kind::SensorDrift, Place::Output(i)) => shown.offset(i),
        (Kind::SensorScale, Place::Output(i)) => shown.against(i, i),
        (Kind::Misalignment, Place::OutputPair(a, b)) => shown.against(b, a),
        (Kind::SensorDelay | Kind::SensorLag, Place::Output(i)) => shown.against_slope(i),
        (Kind::Vibration, Place::Output(i)) => shown.tone(i, parameter("frequency_hz")),
        _ => None,
    };
    special.or_else(|| shown.over_time())
}

impl PlotInput<'_> {
    fn residual(&self, predicted: &[f64]) -> Vec<f64> {
        let mut r: Vec<f64> = predicted.iter().zip(self.without).map(|(p, w)| p - w).collect();
        self.data.fill(&mut r);
        r
    }

    fn traces(&self, entry: Entry) -> Option<Traces> {
        let explained = self.residual(self.with);
        let measured = self.residual(&self.data.measured());
        let rival = self.rival.map(|r| self.residual(r));
        let mut all: Vec<&[f64]> = vec![&explained, &measured];
        all.extend(rival.as_deref());
        let mut traces = reconstruct(self.vehicle, self.data, entry, self.noise, &all)?.into_iter();
        Some(Traces { explained: traces.next()?, measured: traces.next()?, rival: traces.next() })
    }

    fn input(&self, j: usize) -> (Vec<f64>, &str, ShownUnit) {
        let input = &self.vehicle.inputs[j];
        (self.data.input(j).collect(), &input.name, input.unit.shown())
    }

    fn time(&self) -> Vec<f64> {
        (0..self.data.steps).map(|k| self.data.start_s + k as f64 * self.data.period_s).collect()
    }

    /// Static characteristic of an actuator: effective input against commanded input.
    fn characteristic(&self, j: usize, kind: Kind) -> Option<EvidenceCurve> {
        let traces = self.traces(Entry::Input(j))?;
        let (u, name, unit) = self.input(j);
        let sum = |more: &[f64]| u.iter().zip(more).map(|(u, m)| u + m).collect::<Vec<f64>>();
        let caption = match kind {
            Kind::DeadZone => "Small inputs have no effect: the line is flat around zero.",
            Kind::InputSaturation => "Large inputs are clipped: the line flattens.",
            Kind::InputBias => "The line is parallel to the dotted one: a constant is added.",
            _ => "The line has a different slope from the dotted one: the gain differs.",
        };
        let (low, high) = ends(&u);
        Some(EvidenceCurve {
            cloud: thinned(&u, &sum(&traces.measured)),
            without: (vec![low, high], vec![low, high]),
            ..traces.all(|more| binned(&u, &sum(more), |_| true)).curve(
                caption,
                Axis::new(&format!("{name} as commanded"), unit.clone()),
                Axis::new(&format!("{name} as reconstructed"), unit),
            )
        })
    }

    /// Difference between effective and commanded input, separately for rising and for falling commands
    /// (backlash).
    fn play(&self, j: usize) -> Option<EvidenceCurve> {
        let traces = self.traces(Entry::Input(j))?;
        let (u, name, unit) = self.input(j);
        // Where the input is constant, the direction of the last change counts.
        let mut up = vec![false; u.len()];
        for k in 1..u.len() {
            up[k] = if u[k] == u[k - 1] { up[k - 1] } else { u[k] > u[k - 1] };
        }
        let draw = |y: &[f64]| joined(binned(&u, y, |k| up[k]), binned(&u, y, |k| !up[k]));
        let (low, high) = ends(&u);
        Some(EvidenceCurve {
            cloud: thinned(&u, &traces.measured),
            without: (vec![low, high], vec![0.0, 0.0]),
            ..traces.all(draw).curve(
                "Rising inputs arrive too low, falling ones too high: two lines, each offset by half the backlash.",
                Axis::new(&format!("{name} as commanded"), unit.clone()),
                Axis::new(&format!("missing part of {name}"), unit),
            )
        })
    }

    /// Step response of an actuator: the share of a commanded step that has arrived as a function of time.
    fn arrival(&self, j: usize, reach_s: f64) -> Option<EvidenceCurve> {
        let (u, name, _) = self.input(j);
        let period = self.data.period_s;
        let reach = (reach_s.clamp(12.0 * period, 3.0) / period) as usize;
        let moves = Steps::moves(&u, Steps::every(reach));
        let answers = answers(self.vehicle, self.data, Entry::Input(j), &moves)?;
        let steps = Steps::new(reach, answers, self.noise)?;
        let draw = |predicted: &[f64]| steps.arrived(&spread(self.data, &self.residual(predicted)), period);
        let lines = Lines {
            measured: draw(&self.data.measured()),
            explained: draw(self.with),
            rival: self.rival.map(draw),
        };
        let end = *lines.measured.0.last()?;
        Some(EvidenceCurve {
            without: (vec![0.0, end], vec![1.0, 1.0]),
            ..lines.curve(
                "Step response of the input: a delay steps late, a lag rises from the start, a mode rings.",
                Axis::time(&format!("time after a step of {name}")),
                Axis::number("share of the step"),
            )
        })
    }

    /// Commanded and effective input over the time window in which they differ most.
    fn following(&self, j: usize) -> Option<EvidenceCurve> {
        let (u, name, unit) = self.input(j);
        let t = self.time();
        // The whole input is reconstructed, not only the difference: otherwise its sharp edges would be
        // compared with smoothed ones.
        let rows = answers(self.vehicle, self.data, Entry::Input(j), &u)?;
        let p = self.data.channels.len();
        let nominal: Vec<f64> = self
            .data
            .channels
            .iter()
            .enumerate()
            .flat_map(|(c, channel)| (0..channel.values.len()).map(move |k| (c, channel.step(k))))
            .map(|(c, step)| rows[step * p + c])
            .collect();
        let whole = |predicted: &[f64]| {
            self.residual(predicted).iter().zip(&nominal).map(|(r, n)| r + n).collect::<Vec<f64>>()
        };
        let (explained, measured) = (whole(self.with), whole(&self.data.measured()));
        let rival = self.rival.map(whole);
        let mut all: Vec<&[f64]> = vec![&explained, &measured];
        all.extend(rival.as_deref());
        let mut traces = reconstruct(self.vehicle, self.data, Entry::Input(j), self.noise, &all)?.into_iter();
        let traces = Traces { explained: traces.next()?, measured: traces.next()?, rival: traces.next() };
        let lacks: Vec<f64> = traces.explained.iter().zip(&u).map(|(e, u)| e - u).collect();
        let part = loudest(&lacks, (4.0 / self.data.period_s).ceil().max(60.0) as usize);
        let draw = |y: &[f64]| -> Points { (t[part.clone()].to_vec(), y[part.clone()].to_vec()) };
        Some(EvidenceCurve {
            without: (t[part.clone()].to_vec(), u[part.clone()].to_vec()),
            ..traces.all(draw).curve(
                "Where the input is commanded to move faster, it follows ramps of constant slope.",
                Axis::time("time"),
                Axis::new(&format!("{name} as reconstructed"), unit),
            )
        })
    }

    fn gain_over_time(&self, j: usize) -> Option<EvidenceCurve> {
        let traces = self.traces(Entry::Input(j))?;
        let (u, name, _) = self.input(j);
        let t = self.time();
        Some(EvidenceCurve {
            without: (vec![t[0], *t.last()?], vec![1.0, 1.0]),
            ..traces.all(|more| gains(&t, &u, more)).curve(
                "The gain of the input changes with time.",
                Axis::time("time"),
                Axis::number(&format!("effective share of {name}")),
            )
        })
    }

    fn coupling(&self, from: usize, onto: usize) -> Option<EvidenceCurve> {
        let traces = self.traces(Entry::Input(onto))?;
        let (u, name, unit) = self.input(from);
        let (_, other, other_unit) = self.input(onto);
        Some(self.scatter(
            &u,
            traces,
            "The missing part of one input is proportional to the other input.",
            Axis::new(name, unit),
            Axis::new(&format!("missing part of {other}"), other_unit),
        ))
    }

    /// Force missing in the derivative of state `i`, against state `j`.
    fn force(&self, i: usize, j: usize) -> Option<EvidenceCurve> {
        let traces = self.traces(Entry::State(i))?;
        let state = &self.vehicle.states[j];
        Some(self.scatter(
            &self.states[j],
            traces,
            "Friction shows as a step at zero, viscous damping as a straight line, drag as a curve that grows with the square, a hardening spring as one that grows with the cube.",
            Axis::new(&state.name, state.unit.shown()),
            self.missing_on(i),
        ))
    }

    /// Force missing in the derivative of state `i`, against input `j`.
    fn control(&self, i: usize, j: usize) -> Option<EvidenceCurve> {
        let traces = self.traces(Entry::State(i))?;
        let (u, name, unit) = self.input(j);
        Some(self.scatter(
            &u,
            traces,
            "A straight line: the effect of the input is wrong by a factor.",
            Axis::new(name, unit),
            self.missing_on(i),
        ))
    }

    fn missing_on(&self, i: usize) -> Axis {
        let state = &self.vehicle.states[i];
        let unit = state.unit.shown().per_second();
        Axis::new(&format!("missing part of the derivative of {}", state.name), unit)
    }

    fn scatter(&self, x: &[f64], traces: Traces, caption: &str, x_axis: Axis, y_axis: Axis) -> EvidenceCurve {
        let (low, high) = ends(x);
        EvidenceCurve {
            cloud: thinned(x, &traces.measured),
            without: (vec![low, high], vec![0.0, 0.0]),
            ..traces.all(|y| binned(x, y, |_| true)).curve(caption, x_axis, y_axis)
        }
    }

    /// Force missing in the derivative of state `i` around the time of an event.
    fn event(&self, i: usize, about_s: f64) -> Option<EvidenceCurve> {
        let traces = self.traces(Entry::State(i))?;
        let t = self.time();
        let part = loudest(&traces.explained, (about_s / self.data.period_s).min(t.len() as f64) as usize);
        let draw = |y: &[f64]| -> Points {
            let every = part.len().div_ceil(4000).max(1);
            part.clone().step_by(every).map(|k| (t[k], y[k])).unzip()
        };
        Some(EvidenceCurve {
            without: (vec![t[part.start], t[part.end - 1]], vec![0.0, 0.0]),
            ..traces.all(draw).curve(
                "A force that appears and disappears independently of the inputs.",
                Axis::time("time"),
                self.missing_on(i),
            )
        })
    }

    fn rhythm(&self, i: usize, frequency_hz: f64) -> Option<EvidenceCurve> {
        let traces = self.traces(Entry::State(i))?;
        let x = folded(&self.time(), frequency_hz)?;
        Some(self.scatter(
            &x,
            traces,
            "Folded over one period, the missing force is a wave.",
            Axis::time(&format!("time within a period of {frequency_hz:.3} Hz")),
            self.missing_on(i),
        ))
    }
}

/// Each sample's time within the period of a tone (folded time).
fn folded(t: &[f64], frequency_hz: f64) -> Option<Vec<f64>> {
    let period = 1.0 / frequency_hz;
    (frequency_hz > 0.0 && period.is_finite()).then(|| t.iter().map(|t| t.rem_euclid(period)).collect())
}
