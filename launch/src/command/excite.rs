//! `whirlstand excite`: designs test flights that distinguish parameters and effects.

use std::path::Path;
use std::process::ExitCode;

use whirlstand_control::{Controller, Design};
use whirlstand_ident::excite::{ClosedLoop, InjectionPoint, Kind, Options, Shape, design};
use whirlstand_msgs::names::did_you_mean;
use whirlstand_msgs::units::Quantity;
use whirlstand_nodes::estimator::filter_of;
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::{Engine, Vehicle};

use super::design::controller_plan;
use super::vehicles::find;
use super::{print, write, write_json};
use crate::cli::{ExciteArgs, ExciteKind};
use crate::error::Failure;
use crate::file::unknown;

/// Largest predicted angle without `--limit`, rad.
const ANGLE: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// Runs the command.
pub(crate) fn excite(args: &ExciteArgs) -> Result<ExitCode, Failure> {
    let vehicle = find(&args.vehicle)?;
    let closed = closed_loop(args, &vehicle)?;
    let options = Options { closed, ..options(args, &vehicle)? };
    let flight = design(&vehicle, &options).map_err(Failure::mend)?;
    let files = args.out.as_ref().map(|folder| (folder.join("inputs.csv"), folder.join("flight.toml")));
    if let Some((csv, launch)) = &files {
        write(csv, &flight.csv())?;
        let lines: String = args.set.iter().map(|a| line(a)).collect();
        write(launch, &flight.launch(&reference(&args.vehicle), &lines))?;
    }
    if let Some(path) = &args.json.path {
        write_json(&flight, path)?;
    }
    if !args.json.is_printed() {
        let mut text = flight.text();
        if let Some((csv, launch)) = &files {
            text.push_str(&format!("inputs  {}\nflight  {}\n", csv.display(), launch.display()));
        }
        print(&text)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// An assignment as a line of a launch file. A value that is not TOML is written as a string, as on the
/// command line.
fn line(assignment: &str) -> String {
    match (assignment.parse::<toml::Table>(), assignment.split_once('=')) {
        (Err(_), Some((key, text))) => {
            format!("{} = {}\n", key.trim(), toml::Value::String(text.trim().into()))
        }
        _ => format!("{assignment}\n"),
    }
}

/// The controller that remains active, as the launch file will design it.
fn closed_loop(args: &ExciteArgs, vehicle: &Vehicle) -> Result<Option<ClosedLoop>, Failure> {
    let Some(law) = &args.controller else {
        return match (args.setpoint.first(), args.set.first()) {
            (Some(name), _) => Err(Failure::Mend(format!(
                "--setpoint {name}: moving a setpoint requires a controller: give --controller lqr, ppc or smc"
            ))),
            (_, Some(set)) => Err(Failure::Mend(format!("--set {set}: give --controller lqr, ppc or smc"))),
            _ => Ok(None),
        };
    };
    let plan = controller_plan(&args.vehicle, law, args.rate, &args.set)?;
    let Some(law_options) = plan.config.controller.options() else {
        return Err(Failure::Mend(
            "--controller manual: leave it out to fly open loop; lqr, ppc or smc is expected".into(),
        ));
    };
    let states = args.setpoint.iter().map(|name| {
        vehicle.state_index(name).ok_or_else(|| {
            let names: Vec<&str> = vehicle.states.iter().map(|s| s.name.as_str()).collect();
            Failure::Mend(format!(
                "--setpoint {name}: no such state{}; '{}' has {}",
                did_you_mean(name, names.iter().copied()),
                vehicle.name,
                names.join(", ")
            ))
        })
    });
    let states: Vec<usize> = states.collect::<Result<_, _>>()?;
    let plant = Setup::plant_of(vehicle, Setup::period_s(&plan.config)).map_err(Failure::mend)?;
    let failed = |what: &str, e: &dyn std::fmt::Display| {
        Failure::Mend(format!("{what} cannot be designed for {}: {e}", args.vehicle))
    };
    let design = Design::new(&plant, &law_options).map_err(|e| failed(law, &e))?;
    let estimator = filter_of(vehicle, &plant, &plan.config.estimator, Engine::Flying)
        .map_err(|e| failed("an estimator", &e))?;
    Ok(Some(ClosedLoop {
        law: law.clone(),
        controller: Controller::new(&design),
        estimator,
        through: if states.is_empty() { InjectionPoint::Command } else { InjectionPoint::Setpoint(states) },
    }))
}

/// The vehicle as the launch file names it: paths there are relative to the launch file, so they are made absolute.
fn reference(vehicle: &str) -> String {
    let path = Path::new(vehicle);
    if path.is_file() {
        std::path::absolute(path).map_or(vehicle.into(), |p| p.display().to_string())
    } else {
        vehicle.into()
    }
}

fn options(args: &ExciteArgs, vehicle: &Vehicle) -> Result<Options, Failure> {
    for (name, value) in [
        ("--duration", args.duration),
        ("--rate", args.rate),
        ("--lowest", args.lowest),
        ("--highest", args.highest),
        ("--amplitude", args.amplitude),
    ] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(Failure::Mend(format!("{name}: a number above 0 is expected")));
        }
    }
    let limit = |text: &String| -> Result<(String, f64), Failure> {
        let wrong = |reason: String| Failure::Mend(format!("--limit {text}: {reason}"));
        let (name, value) =
            text.split_once('=').ok_or_else(|| wrong("write OUTPUT=VALUE, as in roll=\"10 deg\"".into()))?;
        let Some(i) = vehicle.output_index(name) else {
            let known = vehicle.outputs.iter().map(|o| o.name.as_str());
            return Err(wrong(format!("{} of the vehicle {}", unknown("output", name, known), vehicle.name)));
        };
        let unit = &vehicle.outputs[i].unit;
        let value = match value.trim().parse::<f64>() {
            Ok(value) => unit.two_readings(value).map_or(Ok(value), |why| Err(wrong(why)))?,
            Err(_) => {
                let quantity: Quantity = value.parse().map_err(|e| wrong(format!("{e}")))?;
                quantity.in_unit(unit.unit()).map_err(|e| wrong(e.to_string()))?;
                quantity.si
            }
        };
        if value > 0.0 {
            Ok((name.to_string(), value))
        } else {
            Err(wrong("a value above 0 is expected".into()))
        }
    };
    Ok(Options {
        shape: Shape {
            kind: match args.kind {
                ExciteKind::Doublets => Kind::Doublets,
                ExciteKind::Steps3211 => Kind::Steps3211,
                ExciteKind::Multistep => Kind::Multistep,
                ExciteKind::Multisine => Kind::Multisine,
                ExciteKind::Sweep => Kind::Sweep,
            },
            steps: (args.duration * args.rate).round() as usize,
            period_s: 1.0 / args.rate,
            lowest_hz: args.lowest,
            highest_hz: args.highest,
            seed: args.seed,
        },
        amplitude: args.amplitude,
        limits: args.limit.iter().map(limit).collect::<Result<_, _>>()?,
        angle_limit: ANGLE,
        closed: None,
    })
}
