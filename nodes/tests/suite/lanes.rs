//! Flights side by side are those alone, bit for bit, in every lane width.

use proptest::prelude::*;
use whirlstand_control::EstimatorKind;
use whirlstand_nodes::config::{
    ControllerConfig, EstimatorConfig, LawKind, NodeConfig, SignalChange, VehicleSource,
};
use whirlstand_nodes::flight::{Counts, Pilot};
use whirlstand_vehicle::{Effect, Kind, Vehicle};

use crate::common;

const VEHICLES: [&str; 4] =
    ["quadrotor", "helicopter-hover", "helicopter-longitudinal", "helicopter-lateral"];
const LAWS: [LawKind; 4] = [LawKind::Lqr, LawKind::Ppc, LawKind::Smc, LawKind::Manual];

/// One step as bits.
type Row = Vec<u64>;

/// A whole flight; `None` for one that leaves its model.
type Flight = Option<(Vec<Row>, Counts)>;

fn bits<'a>(values: impl IntoIterator<Item = &'a f64>) -> impl Iterator<Item = u64> {
    values.into_iter().map(|v| v.to_bits())
}

/// All steps of a flight alone.
fn alone(pilot: &Pilot, config: &NodeConfig) -> Flight {
    let mut rows = Vec::new();
    let counts = pilot.fly(config, |step| {
        let values = step.x.iter().chain(step.u).chain(step.disturbance).chain(step.filter.std());
        let mut row: Row = bits(values).chain(bits(&[step.filter.nis()])).collect();
        row.extend([
            step.stamp_ns,
            step.flags.into(),
            step.filter.dof().into(),
            step.filter.converged().into(),
        ]);
        rows.push(row);
    });
    counts.ok().map(|counts| (rows, counts))
}

/// The same side by side; flights that were given up are flown alone.
fn together<const K: usize>(pilot: &Pilot, configs: &[NodeConfig]) -> (Vec<Flight>, usize) {
    let (mut all, mut given_up) = (Vec::new(), 0);
    for chunk in configs.chunks(K) {
        let configs: [&NodeConfig; K] = std::array::from_fn(|l| &chunk[l.min(chunk.len() - 1)]);
        let mut rows = vec![Vec::new(); K];
        let counts = pilot.fly_lanes(&configs, &mut |step| {
            for (l, rows) in rows.iter_mut().enumerate() {
                let lane = |all: &[[f64; K]]| all.iter().map(|row| row[l]).collect::<Vec<f64>>();
                let values =
                    [lane(step.x), lane(step.u), lane(step.disturbance), step.filter.std().to_vec()].concat();
                let mut row: Row = bits(&values).chain(bits(&[step.filter.nis()[l]])).collect();
                let filter = [step.filter.dof().into(), step.filter.converged().into()];
                row.extend([step.stamp_ns, step.flags[l].into()].into_iter().chain(filter));
                rows.push(row);
            }
        });
        for ((counts, rows), config) in counts.into_iter().zip(rows).zip(configs).take(chunk.len()) {
            given_up += usize::from(counts.is_none());
            all.push(counts.map_or_else(|| alone(pilot, config), |counts| Some((rows, counts))));
        }
    }
    (all, given_up)
}

fn bench(vehicle: &str, law: LawKind, kind: EstimatorKind) -> NodeConfig {
    let found = Vehicle::builtin(vehicle).unwrap();
    let state = found.states[0].name.clone();
    let change = |at_s, value| SignalChange { at_s, values: [(state.clone(), value)].into() };
    NodeConfig {
        vehicle: VehicleSource { origin: vehicle.into(), text: found.source_text },
        controller: ControllerConfig::new(law),
        estimator: EstimatorConfig { kind, ..EstimatorConfig::default() },
        setpoint: vec![change(0.3, 0.1), change(1.0, 0.0)],
        ..common::config("lanes", 400)
    }
}

/// What a flight of a campaign draws: seed, initial state, and how large each of the effects is.
fn drawn(base: &NodeConfig, effects: &[u8], seed: u64, roll: f64, size: f64) -> NodeConfig {
    let vehicle = Vehicle::parse(&base.vehicle.text, "vehicle").unwrap();
    let states: Vec<&str> = vehicle.states.iter().map(|s| s.name.as_str()).collect();
    let (last, output, input) = (states[1], &vehicle.outputs[0].name, &vehicle.inputs[0].name);
    let effects = effects.iter().map(|choice| {
        let (kind, place, parameters): (Kind, &str, Vec<(&str, f64)>) = match choice % 10 {
            0 => (
                Kind::PulseDisturbance,
                last,
                vec![("at_s", 0.5 + 0.1 * size), ("duration_s", 0.2), ("magnitude", size)],
            ),
            1 => (Kind::StepDisturbance, last, vec![("at_s", 0.75), ("magnitude", 0.3 * size)]),
            2 => (Kind::Turbulence, last, vec![("std", 0.3 + size), ("bandwidth_hz", 1.0 + size)]),
            3 => (Kind::SensorBias, output, vec![("offset", 0.01 * size)]),
            4 => (Kind::SensorScale, output, vec![("factor", 1.0 + 0.1 * size)]),
            5 => (Kind::Dropouts, output, vec![("fraction", 0.05 + 0.1 * size)]),
            6 => (Kind::InputDelay, input, vec![("delay_s", 0.012)]),
            7 => (Kind::Noise, output, vec![("std", 0.01 * size)]),
            8 => (Kind::ActuatorLag, input, vec![("time_constant_s", 0.02 + 0.01 * size)]),
            _ => (Kind::QuadraticDrag, last, vec![("coefficient", 0.1 * size)]),
        };
        Effect::new(kind, place, &parameters).unwrap()
    });
    let mut config = NodeConfig { seed, effects: effects.collect(), ..base.clone() };
    config.plant.initial = [(states[0].to_string(), roll)].into();
    config
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn flights_side_by_side_are_those_alone(
        vehicle in 0..VEHICLES.len(),
        law in 0..LAWS.len(),
        kinematic in any::<bool>(),
        effects in proptest::collection::vec(0u8..10, 0..3),
        draws in proptest::collection::vec((any::<u64>(), -0.1f64..0.1, 0.0f64..1.0), 1..18),
    ) {
        let kind = if kinematic { EstimatorKind::Kinematic } else { EstimatorKind::Model };
        let base = bench(VEHICLES[vehicle], LAWS[law], kind);
        let Ok(pilot) = Pilot::new(&base) else { return Ok(()) };
        let configs: Vec<_> =
            draws.iter().map(|(seed, roll, size)| drawn(&base, &effects, *seed, *roll, *size)).collect();
        let expected: Vec<_> = configs.iter().map(|config| alone(&pilot, config)).collect();
        prop_assert!(together::<4>(&pilot, &configs).0 == expected, "4 lanes");
        prop_assert!(together::<8>(&pilot, &configs).0 == expected, "8 lanes");
        prop_assert!(together::<16>(&pilot, &configs).0 == expected, "16 lanes");
    }
}

#[test]
fn only_what_leaves_its_model_is_flown_again() {
    let base = bench("quadrotor", LawKind::Lqr, EstimatorKind::Model);
    let pilot = Pilot::new(&base).unwrap();
    let mut configs: Vec<_> = (0..8).map(|seed| drawn(&base, &[0], seed, 0.02, 0.5)).collect();
    assert_eq!(together::<8>(&pilot, &configs).1, 0);
    let gust = [("at_s", 0.5), ("duration_s", 0.2), ("magnitude", 1e9)];
    configs[3].effects = vec![Effect::new(Kind::PulseDisturbance, "roll_rate", &gust).unwrap()];
    let (flown, given_up) = together::<8>(&pilot, &configs);
    assert_eq!(given_up, 1);
    assert!(flown[3].is_none() && flown.iter().flatten().count() == 7);
    configs[5].steps += 1;
    assert_eq!(together::<8>(&pilot, &configs).1, 8, "flights of other lengths");
}
