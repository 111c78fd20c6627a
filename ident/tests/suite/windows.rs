//! Effects that act for a part of the time, on parts of a record: time counts from the beginning of the whole record.

use whirlstand_ident::identify::{Log, Noise, Options, Segment, Source, identify};
use whirlstand_ident::watch::Watch;
use whirlstand_ident::{CompareOptions, compare};
use whirlstand_vehicle::Vehicle;

use crate::support::{flight, with_gap};

/// A cart whose input has half of its effect from 40 s on, and whose sensor reads too much until then.
const CART: &str = "A = [[0.0, 1.0], [-4.0, -0.5]]\nB = [[0.0], [2.0]]\n\
    states = [{ name = \"x\", unit = \"m\" }, { name = \"v\", unit = \"m/s\" }]\n\
    inputs = [{ name = \"u\", lower = -9.0, upper = 9.0 }]\n\
    outputs = [{ name = \"x\", unit = \"m\", noise = 0.002 }, { name = \"v\", unit = \"m/s\", noise = 0.01 }]\n\
    free = [{ entry = \"A[2,2]\", lower = -5.0, upper = 0.0 }, { entry = \"B[2,1]\", lower = 0.0, upper = 9.0 }]\n\
    [[effects]]\neffect = \"input_gain\"\nwhere = \"u\"\nfactor = 0.5\nfrom_s = 40.0\n\
    [[effects]]\neffect = \"sensor_scale\"\nwhere = \"v\"\nfactor = 1.5\nuntil_s = 40.0\n";

fn cart() -> Vehicle {
    Vehicle::parse(CART, "cart.toml").unwrap()
}

#[test]
fn compare_sees_an_effect_when_it_is_in_a_part_of_the_record() {
    let vehicle = cart();
    let record = flight(&vehicle, 80.0, &[0.0; 2], 1.0, None);
    for (from_s, until_s) in [(None, None), (Some(25.0), None), (Some(45.0), Some(75.0))] {
        let options = CompareOptions { from_s, until_s, horizon_s: 2.0, ..CompareOptions::default() };
        let c = compare(&record, &vehicle, &options).unwrap();
        for (output, o) in c.ordered() {
            assert!(o.fit.unwrap() > 99.9, "{from_s:?} {output}: {:?}", o.fit);
            assert!(o.horizon_fit.unwrap() > 99.0, "{from_s:?} {output}: {:?}", o.horizon_fit);
        }
    }
}

#[test]
fn identify_sees_an_effect_when_it_is_in_every_piece() {
    let vehicle = cart();
    let record = with_gap(&flight(&vehicle, 80.0, &[0.0; 2], 1.0, Some(4)), 30.0, 35.0);
    let segments = Segment::unbroken(&record, &vehicle, None, (Some(5.0), None)).unwrap();
    assert_eq!(segments.len(), 2);
    let log = || Log { file: "gap.csv".into(), sha256: String::new() };
    let sources: Vec<Source> = segments.into_iter().map(|segment| Source { log: log(), segment }).collect();
    for noise in [Noise::White, Noise::Kalman] {
        let options = Options { noise: Some(noise), ..Options::default() };
        let answer = identify(&vehicle, &sources, &[], &options, &Watch::default()).unwrap();
        for (name, truth) in [("A[2,2]", -0.5), ("B[2,1]", 2.0)] {
            let found = answer.parameters.iter().find(|p| p.name == name).unwrap().value;
            assert!((found / truth - 1.0).abs() < 0.02, "{noise:?} {name}: {found}, in truth {truth}");
        }
    }
}
