//! Basis functions of the errors of one device: of an actuator between a command and what the vehicle gets, and of a sensor
//! between a quantity and its measurement.
//!
//! They are those that descriptions of devices name beside offset, gain and lag: a static curve, hysteresis, a gain that
//! drifts, creep and a limited rate (Doebelin, Measurement Systems, chapter 3), and the stiction of actuators (Choudhury,
//! Thornhill and Shah, Control Engineering Practice 13, 2005).

use super::basis::{Basis, Recipe, Signal, curves};
use crate::thresholds::{CREEP_TIMES, SENSOR_TRIED, SLEW_SHARES, STICTION_TRIED, STICTION_WIDTHS};

/// Errors of one kind that a number describes, which is searched for between two values.
pub struct Family<'s> {
    /// Creates the basis of a number on demand.
    pub make: Box<dyn Fn(f64) -> Basis + Send + Sync + 's>,
    /// Range of the number.
    pub range: (f64, f64),
    /// How many values of it are tried, equally spaced in its logarithm, and then between the neighbours of the best one.
    pub tried: &'static [usize],
}

/// Errors of a device: those without a number to search for, and the others.
pub type Errors<'s> = (Vec<Recipe<'s>>, Vec<Family<'s>>);

/// Errors of an actuator with this command, over the steps of a record.
pub fn of_actuator(u: &Signal) -> Errors<'_> {
    let sticking = move |width: f64| {
        let description = format!("makes {} stick", u.name);
        Basis { description, functions: vec![u.values.clone(), error(stuck(&u.values, width), u)] }
    };
    (curves(u), vec![Family { make: Box::new(sticking), range: STICTION_WIDTHS, tried: &STICTION_TRIED }])
}

/// Errors of a sensor of this quantity, over its samples; records begin at the samples `starts`.
pub fn of_sensor<'s>(y: &'s Signal, starts: &'s [usize]) -> Errors<'s> {
    let creeping = move |share: f64| {
        let description = format!("makes {} creep", y.name);
        Basis { description, functions: crept(&y.values, share * y.values.len() as f64, starts).into() }
    };
    let fastest = y.values.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
    let slewing = move |share: f64| {
        let description = format!("limits the rate of {}", y.name);
        Basis { description, functions: vec![error(slewed(&y.values, share * fastest, starts), y)] }
    };
    let creeping = Family { make: Box::new(creeping), range: CREEP_TIMES, tried: &SENSOR_TRIED };
    let slewing = Family { make: Box::new(slewing), range: SLEW_SHARES, tried: &SENSOR_TRIED };
    (curves(y), vec![creeping, slewing])
}

/// A device's value minus the true one.
fn error(mut device: Vec<f64>, truth: &Signal) -> Vec<f64> {
    device.iter_mut().zip(&truth.values).for_each(|(d, t)| *d -= t);
    device
}

/// A signal behind stiction: held until the signal is `width` away, where it jumps to it. It begins at rest.
fn stuck(signal: &[f64], width: f64) -> Vec<f64> {
    let follow = |held: &mut f64, v: &f64| {
        if (v - *held).abs() >= width {
            *held = *v;
        }
        Some(*held)
    };
    signal.iter().scan(0.0, follow).collect()
}

/// A signal whose change from one sample to the next is limited.
fn slewed(signal: &[f64], most: f64, starts: &[usize]) -> Vec<f64> {
    let (mut at, mut starts) = (0.0, starts.iter().peekable());
    let follow = |(k, v): (usize, &f64)| {
        let begins = starts.next_if(|start| **start <= k).is_some();
        at = if begins { *v } else { at + (v - at).clamp(-most, most) };
        at
    };
    signal.iter().enumerate().map(follow).collect()
}

/// A signal behind a lag of so many samples, and the decay of what the lag holds when a record begins.
fn crept(signal: &[f64], samples: f64, starts: &[usize]) -> [Vec<f64>; 2] {
    let keep = (-1.0 / samples).exp();
    let (mut lagged, mut decay, mut starts) = (0.0, 0.0, starts.iter().peekable());
    let follow = |(k, v): (usize, &f64)| {
        let begins = starts.next_if(|start| **start <= k).is_some();
        (lagged, decay) = if begins { (0.0, 1.0) } else { (keep * lagged + (1.0 - keep) * v, keep * decay) };
        (lagged, decay)
    };
    signal.iter().enumerate().map(follow).unzip::<f64, f64, Vec<_>, Vec<_>>().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stiction_holds_until_the_command_is_away() {
        assert_eq!(stuck(&[0.1, 0.3, 0.4, 0.0, -0.2], 0.25), [0.0, 0.3, 0.3, 0.0, 0.0]);
    }

    /// Two records: the second begins where its own signal does.
    #[test]
    fn a_limited_rate_begins_anew_in_each_record() {
        assert_eq!(slewed(&[0.0, 1.0, 1.0, -2.0, -1.0], 0.5, &[0, 3]), [0.0, 0.5, 1.0, -2.0, -1.5]);
    }

    #[test]
    fn creep_approaches_a_step_and_forgets_its_beginning() {
        let [lagged, decay] = crept(&[1.0; 200], 20.0, &[0]);
        for (k, (lagged, decay)) in lagged.iter().zip(&decay).enumerate() {
            let e = (-(k as f64) / 20.0).exp();
            assert!((lagged - (1.0 - e)).abs() < 1e-12 && (decay - e).abs() < 1e-12);
        }
    }
}
