//! Findings of the mirror about the vehicle in flight.

use crate::define::message;

/// Largest number of an effect's parameters in a [`Finding`].
pub const MAX_PARAMETERS: usize = 4;

message! {
    /// A change of the vehicle relative to its file, as known to the mirror at step k. All findings about one
    /// change have the same number.
    Finding on "finding" {
        /// Number of the change, from 1.
        number: u64 => "uint64",
        /// Estimated bench time at which the vehicle changed, ns.
        since_ns: u64 => "uint64",
        /// Log-likelihood ratio of the finding against no change; 0 while no cause is known.
        evidence: f64 => "float64",
        /// Probability of the cause among all causes tested; 0 without a cause.
        probability: f64 => "float64",
        /// Estimated parameters of the effect, SI, in the order of `names`.
        value: f64[MAX_PARAMETERS] => "float64[4]",
        /// Lower ends of the parameters' 95 % intervals, SI.
        low: f64[MAX_PARAMETERS] => "float64[4]",
        /// Upper ends of the parameters' 95 % intervals, SI.
        high: f64[MAX_PARAMETERS] => "float64[4]",
        /// Stage of the finding, a [`FindingStage`].
        stage: u32 => "uint32",
        /// The output whose prediction failed first, as index in the vehicle's order.
        output: u32 => "uint32",
        /// Number of parameters in use.
        count: u32 => "uint32",
        /// Number of other causes that the data cannot distinguish from this one.
        alike: u32 => "uint32",
        /// Name of the effect, as in a vehicle file; empty without a cause. Texts are UTF-8, padded with
        /// zeros.
        effect: u8[32] => "uint8[32]",
        /// Place of the effect: `where` in a vehicle file; the first of a pair.
        place: u8[32] => "uint8[32]",
        /// The second place of a pair, or the target vehicle of a mode transition.
        onto: u8[32] => "uint8[32]",
        /// Names of the parameters, separated by commas.
        names: u8[32] => "uint8[32]",
        /// SI units of the parameters, separated by commas.
        units: u8[32] => "uint8[32]",
        /// Effect of the first cause that the data cannot distinguish from this one.
        alike_effect: u8[32] => "uint8[32]",
        /// Place of the first cause that the data cannot distinguish from this one.
        alike_place: u8[32] => "uint8[32]",
    }
}

/// Stage of a finding, as a number in [`Finding::stage`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum FindingStage {
    /// The prediction fails; the cause is unknown.
    Wrong = 1,
    /// A cause is named.
    Named = 2,
    /// Another size or another cause than before.
    Revised = 3,
    /// The named cause is withdrawn; the prediction still fails.
    Withdrawn = 4,
    /// The prediction is correct again.
    Over = 5,
    /// The law designed for the cause is in charge from this step on; `evidence` is the ratio of its cost to
    /// that of the previous law.
    Law = 6,
    /// The first law is in charge again, because the cause of the other one is withdrawn or over.
    FirstLaw = 7,
}

impl FindingStage {
    /// The stage for a number in [`Finding::stage`]; `None` for an unknown number.
    pub fn from_u32(value: u32) -> Option<Self> {
        [Self::Wrong, Self::Named, Self::Revised, Self::Withdrawn, Self::Over, Self::Law, Self::FirstLaw]
            .into_iter()
            .find(|s| *s as u32 == value)
    }
}

/// Text in a field of a message; empty when it is not UTF-8.
pub fn text_of(field: &[u8; 32]) -> &str {
    let end = field.iter().position(|&b| b == 0).unwrap_or(field.len());
    std::str::from_utf8(&field[..end]).unwrap_or("")
}

/// Encodes a text as a field of a message, truncated at a character boundary.
pub fn text_field(text: &str) -> [u8; 32] {
    let mut field = [0; 32];
    let mut end = text.len().min(field.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    field[..end].copy_from_slice(&text.as_bytes()[..end]);
    field
}
