//! Tests of both generators: drawn values are within their ranges, and the simulator gives the same records.

use whirlstand_vehicle::{Kind, Vehicle};

use super::motion::{commands, difference};
use crate::draft::draft;
use crate::facts::Facts;
use crate::noise::Colour;
use crate::random::RandomStream;
use crate::sense::Noise;
use crate::{Case, Generator, Loops, Plan, Setting, Trial};

const BOTH: [Generator; 2] = [Generator::Reference, Generator::Shifted];

#[test]
fn records_and_their_noise_are_drawn_from_the_ranges() {
    for generator in BOTH {
        let ranges = generator.ranges();
        for number in 2_000_000..2_000_200 {
            let plan = Plan::new(number, generator, Loops::Open);
            if plan.case != Case::Clean {
                continue;
            }
            let trial = Trial::draw(&plan, &Setting::default()).unwrap().unwrap();
            let answer = &trial.answer;
            let (shortest, longest) = ranges.lengths_s;
            assert!(answer.duration_s > shortest - 0.1 && answer.duration_s <= longest, "{answer:?}");
            assert!(ranges.rates_hz.iter().any(|hz| (hz - answer.rate_hz).abs() < 1e-9), "{answer:?}");
            assert!(ranges.excitation.kinds.contains(&answer.excitation), "{answer:?}");
            let outputs = &trial.experiment.nominal.vehicle.outputs;
            for (std, output) in answer.noise_std.iter().zip(outputs) {
                let level = std / output.noise;
                let (least, most) = (
                    ranges.noise.level.0 * ranges.noise.spread.0,
                    ranges.noise.level.1 * ranges.noise.spread.1,
                );
                assert!(level >= least - 1e-9 && level <= most + 1e-9, "{level} {answer:?}");
            }
            if let Colour::Ar1 { coefficient } = answer.noise {
                assert_eq!(coefficient == 0.9, generator == Generator::Reference);
            }
        }
    }
}

#[test]
fn a_size_is_one_of_its_generator() {
    let delays = |generator: Generator| -> Vec<f64> {
        let plans = (2_000_000..).map(|number| Plan::new(number, generator, Loops::Open));
        let wanted = plans.filter(|p| p.case == Case::Single && p.effects == [Kind::InputDelay]);
        let setting = Setting { lengths_s: Some((10.0, 20.0)), ..Setting::default() };
        let trials = wanted.take(12).filter_map(|p| Trial::draw(&p, &setting).unwrap());
        trials.map(|t| t.answer.effects[0].parameters["delay_s"]).collect()
    };
    for generator in BOTH {
        let (least, most) = generator.ranges().effects.input_delay_s;
        let delays = delays(generator);
        assert!(delays.len() > 6 && delays.iter().all(|d| (least..=most).contains(d)), "{delays:?}");
    }
}

#[test]
fn effects_of_drawn_sizes_are_what_the_simulator_makes_of_them() {
    let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
    vehicle.outputs.iter_mut().for_each(|o| o.vibration = None);
    let commands = commands(&vehicle, 1500, 5.0);
    let noise = Noise { colour: Colour::White, std: vehicle.outputs.iter().map(|o| o.noise).collect() };
    let facts = Facts::new(&vehicle, &commands, &[0.0; 4]).unwrap();
    let random = [Kind::Turbulence, Kind::Noise, Kind::Quantization, Kind::Dropouts, Kind::Outliers];
    let (mut failed, mut compared) = (Vec::new(), 0);
    for generator in BOTH {
        let mut stream = RandomStream::new(17, generator.name());
        for kind in Kind::all().filter(|kind| !random.contains(kind)) {
            for _ in 0..3 {
                let ranges = &generator.ranges().effects;
                let Some(draft) = draft(kind, &vehicle, &facts, &noise, ranges, &mut stream) else {
                    continue;
                };
                let (least, most) = draft.sizes;
                let effect = draft.at(stream.scaled((least * most).sqrt(), most)).unwrap();
                // A softening spring has no bounded motion at every size.
                if effect.kind() == Kind::CubicStiffness && effect.parameter("coefficient") < Some(0.0) {
                    continue;
                }
                let (worst, visible) = difference(&vehicle, &commands, std::slice::from_ref(&effect));
                if visible < 0.01 {
                    continue;
                }
                compared += 1;
                if worst > 5e-3 {
                    failed.push(format!("{} {effect:?}: {worst:.1e} of {visible:.3}", generator.name()));
                }
            }
        }
    }
    assert!(compared > 100, "{compared}");
    assert!(failed.is_empty(), "{failed:#?}");
}
