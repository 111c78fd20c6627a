//! The result of a change in flight, in words.

use serde_json::{Value, json};
use whirlstand_msgs::{Adjustment, AdjustmentVerdict};
use whirlstand_nodes::refusal;
use whirlstand_vehicle::Vehicle;

use super::wanted::Wanted;
use crate::style;

/// The result of one change.
pub(crate) struct Told {
    what: String,
    value: f64,
    step: u64,
    time_s: f64,
    /// Reason for the refusal, if the change was refused.
    pub refused: Option<String>,
}

impl Told {
    /// From a request and its answer.
    pub fn new(wanted: &Wanted, answer: &Adjustment, vehicle: &Vehicle) -> Self {
        let verdict = AdjustmentVerdict::from_u32(answer.verdict);
        let refused = match verdict {
            Some(AdjustmentVerdict::Done) => None,
            Some(verdict) => Some(refusal(verdict, wanted.key())),
            None => Some(format!("for reason {}, which this version does not recognize", answer.verdict)),
        };
        Self {
            what: wanted.text(vehicle),
            value: answer.value,
            step: answer.head.step,
            time_s: answer.head.stamp_ns as f64 * 1e-9,
            refused,
        }
    }

    /// The result as JSON, SI.
    pub fn json(&self) -> Value {
        json!({
            "what": self.what, "value_si": self.value, "step": self.step, "t_s": self.time_s, "refused": self.refused,
        })
    }

    /// The result as a line for a terminal.
    pub fn line(&self) -> String {
        match &self.refused {
            None => format!("{}\n", self.sentence()),
            Some(why) => format!("{} {}: {why}\n", self.what, style::bad("refused")),
        }
    }

    /// The result as a sentence.
    pub fn sentence(&self) -> String {
        match &self.refused {
            None => format!("{} from t {:.3} s on (step {})", self.what, self.time_s, self.step),
            Some(why) => format!("{} refused: {why}", self.what),
        }
    }
}
