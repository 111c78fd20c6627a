//! `whirlstand inject` and `whirlstand set`: changes in flight.

use std::process::ExitCode;

use serde_json::json;
use whirlstand_vehicle::Vehicle;

use super::tell;
use crate::cli::{InjectArgs, JsonArg, SetArgs, WhichBenchArgs};
use crate::error::Failure;
use crate::live::{BenchCard, Told, Wanted, ask};

/// Exit code when the bench refuses a request: the user can change the request.
const REFUSED: u8 = 2;

/// Runs `whirlstand inject`.
pub(crate) fn inject(args: &InjectArgs) -> Result<ExitCode, Failure> {
    adjust(&args.bench, &args.gusts, &args.json, |text, vehicle| Wanted::gust(text, args.length, vehicle))
}

/// Runs `whirlstand set`.
pub(crate) fn set(args: &SetArgs) -> Result<ExitCode, Failure> {
    adjust(&args.bench, &args.settings, &args.json, Wanted::setting)
}

fn adjust(
    bench: &WhichBenchArgs,
    texts: &[String],
    json: &JsonArg,
    read: impl Fn(&str, &Vehicle) -> Result<Wanted, Failure>,
) -> Result<ExitCode, Failure> {
    let card = BenchCard::find(bench)?;
    let vehicle = card.vehicle()?;
    let wanted = texts.iter().map(|text| read(text, &vehicle)).collect::<Result<Vec<_>, _>>()?;
    let answers = ask(&card, &wanted)?;
    let told: Vec<_> = wanted.iter().zip(&answers).map(|(w, a)| Told::new(w, a, &vehicle)).collect();
    let all: Vec<_> = told.iter().map(Told::json).collect();
    let value = json!({ "schema": "whirlstand.adjusted.v1", "bench": bench.name, "adjusted": all });
    tell(json, &value, || told.iter().map(Told::line).collect())?;
    let refused = told.iter().any(|t| t.refused.is_some());
    Ok(if refused { ExitCode::from(REFUSED) } else { ExitCode::SUCCESS })
}
