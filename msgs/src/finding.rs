//! What the mirror says of the vehicle while it flies.

use crate::define::message;

/// Most parameters of an effect that a [`Finding`] has room for.
pub const MAX_PARAMETERS: usize = 4;

message! {
    /// A change of the vehicle against its file, as far as the mirror knows it at step k. Everything that is said of one
    /// change has the same number.
    Finding on "finding" {
        /// Number of the change, from 1.
        number: u64 => "uint64",
        /// Bench time from which on the vehicle is another, as far as is known, ns.
        since_ns: u64 => "uint64",
        /// Log-likelihood ratio of what is said against no change; 0 as long as nothing is known but that there is one.
        evidence: f64 => "float64",
        /// Probability of the cause among all that was tried; 0 without one.
        probability: f64 => "float64",
        /// Estimated parameters of the effect, SI, in the order of `names`.
        value: f64[MAX_PARAMETERS] => "float64[4]",
        /// Lower ends of the intervals that hold them with 95 %.
        low: f64[MAX_PARAMETERS] => "float64[4]",
        /// Upper ends.
        high: f64[MAX_PARAMETERS] => "float64[4]",
        /// A [`FindingStage`].
        stage: u32 => "uint32",
        /// The output whose prediction became wrong first, in the vehicle's order.
        output: u32 => "uint32",
        /// Number of parameters in use.
        count: u32 => "uint32",
        /// Number of other causes that the data cannot tell from this one.
        alike: u32 => "uint32",
        /// The effect, as in a vehicle file; empty without a cause. Texts are UTF-8, filled up with zeros.
        effect: u8[32] => "uint8[32]",
        /// Its place: `where` in a vehicle file, of a pair the first.
        place: u8[32] => "uint8[32]",
        /// Of a pair the second, of a mode transition the vehicle that it leads to.
        onto: u8[32] => "uint8[32]",
        /// Names of the parameters, separated by commas.
        names: u8[32] => "uint8[32]",
        /// Their SI units, separated by commas.
        units: u8[32] => "uint8[32]",
        /// The first of the causes that the data cannot tell from this one, its effect and its place.
        alike_effect: u8[32] => "uint8[32]",
        /// See `alike_effect`.
        alike_place: u8[32] => "uint8[32]",
    }
}

/// How far a finding has come, as a number in [`Finding::stage`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum FindingStage {
    /// Prediction has become wrong; nothing is known of the cause.
    Wrong = 1,
    /// This is the cause, as far as the data go.
    Named = 2,
    /// Another size, or another cause than was said before.
    Revised = 3,
    /// What was said does not hold; prediction is still wrong.
    Withdrawn = 4,
    /// Prediction is right again.
    Over = 5,
    /// The law that was designed for the cause flies from here on; `evidence` is its cost over that of the law before.
    Law = 6,
    /// The first law flies again, because what the other was designed for is withdrawn or over.
    FirstLaw = 7,
}

impl FindingStage {
    /// The stage for a number in [`Finding::stage`]; `None` for one that this version does not know.
    pub fn from_u32(value: u32) -> Option<Self> {
        [Self::Wrong, Self::Named, Self::Revised, Self::Withdrawn, Self::Over, Self::Law, Self::FirstLaw]
            .into_iter()
            .find(|s| *s as u32 == value)
    }
}

/// A text in the field of a message; what is not UTF-8 is none.
pub fn text_of(field: &[u8; 32]) -> &str {
    let end = field.iter().position(|&b| b == 0).unwrap_or(field.len());
    std::str::from_utf8(&field[..end]).unwrap_or("")
}

/// The field of a message for a text, cut to fit at a character boundary.
pub fn text_field(text: &str) -> [u8; 32] {
    let mut field = [0; 32];
    let mut end = text.len().min(field.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    field[..end].copy_from_slice(&text.as_bytes()[..end]);
    field
}
