//! `whirlstand bench mirror`: measures the detection delay of the mirror, the cause that it names, and its rate of
//! false alarms.

mod hidden;
mod tally;
mod trial;

use std::collections::BTreeMap;
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressStyle};

use self::hidden::{EFFECTS, vehicle_of};
use self::tally::Tally;
use self::trial::{Clean, Hangar, Trial, hangar_of};
use super::{INTERRUPTED, print, write_json};
use crate::campaign::side_by_side;
use crate::cli::BenchMirrorArgs;
use crate::error::Failure;
use crate::style;

/// Numbers of one seed: flight K has the number SEED 000000 + K.
const NUMBERS_PER_SEED: u64 = 1_000_000;

/// Longest clean flight, s; a longer time is divided into several flights.
const CLEAN_S: f64 = 900.0;

/// Vehicle of the clean flights.
const CLEAN: &str = "quadrotor";

enum Flown {
    Hidden(Trial),
    Clean(Clean),
}

/// Runs the command. The exit code is 1 when a goal is missed and 130 when it was interrupted; the flights
/// finished by then are reported.
pub(crate) fn bench_mirror(args: &BenchMirrorArgs) -> Result<ExitCode, Failure> {
    let names = names(args)?;
    let first = args
        .seed
        .checked_mul(NUMBERS_PER_SEED)
        .filter(|first| *first < 1 << 53 && args.trials < NUMBERS_PER_SEED)
        .ok_or_else(|| Failure::Mend(format!("--seed {}: at most 9000000000 is expected", args.seed)))?;
    let mut hangars = BTreeMap::new();
    for vehicle in names.iter().map(|n| vehicle_of(n)).chain([CLEAN]) {
        if !hangars.contains_key(vehicle) {
            hangars.insert(vehicle, Hangar::new(vehicle, args.rate)?);
        }
    }
    let period_s = hangars[CLEAN].period_s();
    let steps = (3600.0 * args.clean / period_s) as u64;
    let longest = (CLEAN_S / period_s) as u64;
    // The long flights come first, so that no thread is left alone with one at the end.
    let (clean, hidden) = (steps.div_ceil(longest.max(1)), args.trials * names.len() as u64);
    let todo: Vec<u64> = (0..clean + hidden).collect();
    let fly = |index: u64| {
        if index < clean {
            let steps = longest.min(steps - index * longest);
            return hangars[CLEAN].clean(first + index, steps).map(Flown::Clean);
        }
        let (flight, effect) = ((index - clean) / names.len() as u64, (index - clean) % names.len() as u64);
        let what = names[effect as usize];
        let hangar = hangar_of(what, &hangars)
            .ok_or_else(|| Failure::Run(format!("no vehicle was prepared for {what}")))?;
        hangar.hide(what, first + flight).map(Flown::Hidden)
    };
    let jobs = args.jobs.map(std::num::NonZero::get);
    let jobs = jobs.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, std::num::NonZero::get));
    let bar = ProgressBar::new(todo.len() as u64);
    let template = ProgressStyle::with_template("{bar:24.cyan/dim} {pos}/{len} flights  {elapsed}  {msg}");
    bar.set_style(template.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let (mut trials, mut flights) = (Vec::new(), Vec::new());
    let interrupted = side_by_side(&todo, jobs, fly, |flown| {
        match flown? {
            Flown::Hidden(trial) => trials.push(trial),
            Flown::Clean(flight) => flights.push(flight),
        }
        bar.inc(1);
        Ok(false)
    });
    bar.finish_and_clear();
    let interrupted = interrupted? && trials.len() + flights.len() < todo.len();
    let tally = Tally::new(call(args), &names, trials, flights, period_s);
    report(args, &tally)?;
    if interrupted {
        style::say(&format!(
            "interrupted: the results above cover {} of {} flights",
            bar.position(),
            todo.len()
        ));
        return Ok(ExitCode::from(INTERRUPTED));
    }
    Ok(ExitCode::from(u8::from(tally.goals.iter().any(|g| !g.met))))
}

fn report(args: &BenchMirrorArgs, tally: &Tally) -> Result<(), Failure> {
    if let Some(path) = &args.json.path {
        write_json(tally, path)?;
    }
    if args.json.is_printed() {
        return Ok(());
    }
    let mut text = tally.text().replace("MISSED", &style::bad("MISSED"));
    if args.show {
        for trial in tally.trials.iter().filter(|t| t.right != Some(true) || t.wrong_ever) {
            let best = trial.bound_s.map_or("after the end of the flight".into(), |b| format!("{b:.2} s"));
            text += &format!("\nflight {}: {}, best detection {best}\n", trial.number, trial.hidden);
            trial.said.iter().for_each(|line| text += &format!("  {line}\n"));
        }
        for flight in tally.clean_flights.iter().filter(|f| f.alarms > 0) {
            text += &format!("\nclean flight {}\n", flight.number);
            flight.said.iter().for_each(|line| text += &format!("  {line}\n"));
        }
    }
    print(&text)
}

/// Names of the effects that the user asked for, as in the table.
fn names(args: &BenchMirrorArgs) -> Result<Vec<&'static str>, Failure> {
    if args.effects.is_empty() {
        return Ok(EFFECTS.to_vec());
    }
    let known = |name: &String| {
        EFFECTS.into_iter().find(|known| known.replace(' ', "-") == name.replace(' ', "-")).ok_or_else(|| {
            let all = EFFECTS.map(|e| e.replace(' ', "-")).join(", ");
            Failure::Mend(format!("--effects {name}: one of these is expected: {all}"))
        })
    };
    args.effects.iter().map(known).collect()
}

/// The command line that repeats this measurement.
fn call(args: &BenchMirrorArgs) -> String {
    let mut call = format!(
        "whirlstand bench mirror --trials {} --clean {} --seed {}",
        args.trials, args.clean, args.seed
    );
    if args.rate != BenchMirrorArgs::RATE_HZ {
        call += &format!(" --rate {}", args.rate);
    }
    if !args.effects.is_empty() {
        call += &format!(" --effects {}", args.effects.join(",").replace(' ', "-"));
    }
    call
}
