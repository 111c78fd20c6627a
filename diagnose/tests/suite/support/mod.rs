//! Records of simulated flights and their diagnoses.

#[path = "../../../../ident/tests/suite/support/mod.rs"]
mod flights;

pub use flights::{changed, flight, pushed_flight, steered_flight, stick, with_gap};
use whirlstand_diagnose::{Diagnosis, Options, diagnose};
use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

/// The diagnosis of a record with default options.
pub fn diagnosis(record: Record, vehicle: &Vehicle) -> Diagnosis {
    diagnose(vec![record], vehicle, &Options::default()).unwrap()
}

/// Names of all causes, sorted, each followed by the causes that are indistinguishable from it.
pub fn named(answer: &Diagnosis) -> Vec<Vec<String>> {
    let mut all: Vec<Vec<String>> = answer
        .causes
        .iter()
        .map(|c| {
            let alike = c.indistinguishable.iter().map(|a| format!("{}({})", a.effect, a.place));
            std::iter::once(format!("{}({})", c.effect, c.place)).chain(alike).collect()
        })
        .collect();
    all.sort();
    all
}
