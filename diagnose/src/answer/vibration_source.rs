//! Source of a vibration: compares its tone in flight with records on the ground with the engine on and with
//! it off.

use crate::thresholds::{LINE_AMPLITUDE_RATIO, ROTOR_SPEED_SHARE};
use whirlstand_logs::Record;

use whirlstand_logs::stats::{median, rms};

/// Amplitude of the strongest tone near `frequency_hz` in an output, and whether it stands out of the
/// surrounding spectrum.
fn amplitude(record: &Record, output: &str, frequency_hz: f64) -> Option<(f64, bool)> {
    let signal = record.get(output)?;
    let points: Vec<(f64, f64)> = record
        .time
        .iter()
        .zip(&signal.values)
        .filter(|(_, v)| v.is_finite())
        .map(|(t, v)| (*t, *v))
        .collect();
    if points.len() < 64 {
        return None;
    }
    let mean = points.iter().map(|p| p.1).sum::<f64>() / points.len() as f64;
    let duration = points[points.len() - 1].0 - points[0].0;
    let at = |f: f64| {
        let (mut c, mut s) = (0.0, 0.0);
        for (k, (t, y)) in points.iter().enumerate() {
            let w = 1.0 - (std::f64::consts::TAU * (k as f64 + 0.5) / points.len() as f64).cos();
            let (sine, cosine) = (std::f64::consts::TAU * f * t).sin_cos();
            c += w * (y - mean) * cosine;
            s += w * (y - mean) * sine;
        }
        2.0 * c.hypot(s) / points.len() as f64
    };
    let df = 0.5 / duration;
    let reach = (ROTOR_SPEED_SHARE * frequency_hz / df).ceil() as i64;
    let all: Vec<f64> = (-reach..=reach).map(|i| at(frequency_hz + i as f64 * df)).collect();
    let strongest = all.iter().copied().fold(0.0, f64::max);
    Some((strongest, strongest > LINE_AMPLITUDE_RATIO * median(&all).max(1e-9 * rms(&all))))
}

/// Source of a tone according to the three records: its name and the reason as a sentence. `None` when no
/// ground record was given that has the output.
pub fn source(
    output: &str,
    frequency_hz: f64,
    flight: f64,
    on: Option<&Record>,
    off: Option<&Record>,
) -> Option<(&'static str, String)> {
    let on = on.and_then(|r| amplitude(r, output, frequency_hz));
    let off = off.and_then(|r| amplitude(r, output, frequency_hz));
    let described = |found: Option<(f64, bool)>| match found {
        None => "not recorded".to_string(),
        Some((_, false)) => "absent".to_string(),
        Some((a, true)) => {
            format!("{:.0} % of that in flight", 100.0 * a / flight.abs().max(f64::MIN_POSITIVE))
        }
    };
    let text = format!(
        "on the ground with the engine on: {}; with the engine off: {}",
        described(on),
        described(off)
    );
    let source = match (on, off) {
        (None, None) => return None,
        (_, Some((_, true))) => "sensor",
        (Some((_, true)), _) => "engine",
        (Some((_, false)), _) => "airframe",
        (None, Some((_, false))) => "engine or airframe",
    };
    Some((source, text))
}

/// Aliases of a tone at this sampling period, Hz: frequencies above the Nyquist frequency that fold onto
/// `frequency_hz`.
pub fn aliases(frequency_hz: f64, period_s: f64) -> Vec<f64> {
    let rate = 1.0 / period_s;
    vec![rate - frequency_hz, rate + frequency_hz, 2.0 * rate - frequency_hz]
}
