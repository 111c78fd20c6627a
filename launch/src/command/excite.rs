//! `whirlstand excite`: test flights that tell parameters and effects apart.

use std::path::Path;
use std::process::ExitCode;

use whirlstand_ident::excite::{Kind, Options, Shape, design};
use whirlstand_msgs::units::Quantity;
use whirlstand_vehicle::Vehicle;

use super::vehicles::find;
use super::{print, write, write_json};
use crate::cli::{ExciteArgs, ExciteKind};
use crate::error::Failure;

/// Largest predicted angle without `--limit`, rad.
const ANGLE: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// Runs the command.
pub(crate) fn excite(args: &ExciteArgs) -> Result<ExitCode, Failure> {
    let vehicle = find(&args.vehicle)?;
    let options = options(args, &vehicle)?;
    let flight = design(&vehicle, &options).map_err(Failure::mend)?;
    let files = args.out.as_ref().map(|folder| (folder.join("inputs.csv"), folder.join("flight.toml")));
    if let Some((csv, launch)) = &files {
        write(csv, &flight.csv(&vehicle))?;
        write(launch, &flight.launch(&vehicle, &reference(&args.vehicle)))?;
    }
    if let Some(path) = &args.json {
        write_json(&flight, path)?;
    }
    if args.json.as_deref() != Some(Path::new("-")) {
        let mut text = flight.text();
        if let Some((csv, launch)) = &files {
            text.push_str(&format!("inputs  {}\nflight  {}\n", csv.display(), launch.display()));
        }
        print(&text)?;
    }
    Ok(ExitCode::SUCCESS)
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
        let value = match value.trim().parse::<f64>() {
            Ok(value) => value,
            Err(_) => {
                let quantity: Quantity = value.parse().map_err(|e| wrong(format!("{e}")))?;
                match vehicle.output_index(name) {
                    Some(i) => {
                        let unit = vehicle.outputs[i].unit.unit();
                        unit.to_si(quantity.in_unit(unit).map_err(|e| wrong(e.to_string()))?)
                    }
                    None => quantity.si,
                }
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
    })
}
