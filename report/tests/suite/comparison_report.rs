//! The page of a comparison.

use whirlstand_ident::{CompareOptions, compare};
use whirlstand_report::comparison_report;
use whirlstand_vehicle::Vehicle;

use crate::flights::flight;

#[test]
fn a_comparison_has_a_page_with_every_output() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let record = flight(&vehicle, 20.0, &[0.0; 4], 1.0, Some(3));
    let comparison = compare(&record, &vehicle, &CompareOptions::default()).unwrap();
    let html = comparison_report(&comparison).unwrap();
    for output in &vehicle.outputs {
        assert!(html.contains(&output.name), "{}", output.name);
    }
    std::fs::write(std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("comparison.html"), html).unwrap();
}
