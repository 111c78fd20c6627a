//! Records of simulated flights, and what is told of them.

// Each test file uses a part of this.
#![allow(dead_code, unused_imports)]

#[path = "../../../ident/tests/support/mod.rs"]
mod flights;

pub use flights::{changed, flight, pushed_flight, stick, with_gap};
use whirlstand_diagnose::{Diagnosis, Options, diagnose};
use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

/// The diagnosis of a record, as the program makes it.
pub fn diagnosis(record: Record, vehicle: &Vehicle) -> Diagnosis {
    diagnose(vec![record], vehicle, &Options::default()).unwrap()
}

/// Names of all causes, sorted, each with those that cannot be told from it.
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
