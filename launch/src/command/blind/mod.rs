//! `whirlstand blind`: measures how well diagnosis finds hidden effects, by trials whose answers are sealed
//! until the diagnosis has ended.

mod parts;
mod runner;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressStyle};
use whirlstand_blind::{Case, Commands, Generator, Loops, Plan, Scored, Setting, TRIALS_PER_SEED, Tally};
use whirlstand_vehicle::Kind;

use self::parts::{Part, Results};
use self::runner::TrialRunner;
use super::vehicles::find;
use super::{INTERRUPTED, print, simulate, write, write_json};
use crate::cli::{
    BlindArgs, BlindCase, BlindCommand, BlindGenerator, BlindLoop, BlindMergeArgs, BlindRunArgs, JsonArg,
};
use crate::error::Failure;
use crate::style;
use crate::supervisor::Signals;

/// Runs the command. The exit code is 1 when a goal is missed and 130 when it was interrupted; the trials finished
/// by then are reported. On SIGINT the trials that have begun are finished; SIGTERM and a second signal drop them.
pub(crate) fn blind(args: &BlindArgs) -> Result<ExitCode, Failure> {
    match &args.action {
        None => run(&args.run),
        Some(BlindCommand::Merge(args)) => merge(args),
    }
}

fn run(args: &BlindRunArgs) -> Result<ExitCode, Failure> {
    let setting = setting(args)?;
    let part = args.shard.map(|shard| Part::new(shard, &setting));
    let all = plans(args)?;
    let earlier = args.resume.as_deref().map(|path| earlier(path, args, part.as_ref())).transpose()?;
    let earlier = earlier.unwrap_or_default();
    let known = |p: &Plan| earlier.iter().any(|t| t.answer.number == p.number);
    let plans: Vec<Plan> = all.iter().filter(|p| !known(p)).cloned().collect();
    let jobs = match args.jobs {
        Some(jobs) => jobs.get(),
        None => std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
    };
    let runner = TrialRunner::new(args, jobs)?;
    let bar = ProgressBar::new(plans.len() as u64);
    let template = ProgressStyle::with_template("{bar:24.cyan/dim} {pos}/{len} trials  {elapsed}  {msg}");
    bar.set_style(template.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let mut signals = Signals::take().map_err(Failure::run)?;
    let results = runner.run(&plans, &setting, jobs, &bar, &mut signals);
    drop(signals);
    bar.finish_and_clear();
    let (mut trials, skipped) = results?;
    trials.extend(earlier);
    let done = trials.len() + skipped;
    let cut = (done < all.len()).then(|| format!(" (interrupted after {done})"));
    let tally = Tally::new(format!("{}{}", call(args), cut.as_deref().unwrap_or_default()), trials, skipped);
    let is_part = part.is_some();
    let code = report(&args.out, &args.json, args.only.is_some(), Results { tally, part })?;
    if cut.is_some() {
        crate::style::say(&format!("interrupted: the results above cover {done} of {} trials", all.len()));
        return Ok(ExitCode::from(INTERRUPTED));
    }
    // Whether a goal is met can be judged on the whole run only, not on a part.
    Ok(if is_part { ExitCode::SUCCESS } else { code })
}

fn merge(args: &BlindMergeArgs) -> Result<ExitCode, Failure> {
    let tally = parts::joined(&args.parts)?;
    report(&args.out, &args.json, false, Results { tally, part: None })
}

/// Writes the requested files and prints the rest. The exit code is 1 when a goal is missed. `opened`: for every
/// trial, the hidden effect and the named causes.
fn report(
    out: &Option<PathBuf>,
    json: &JsonArg,
    opened: bool,
    results: Results,
) -> Result<ExitCode, Failure> {
    let tally = &results.tally;
    let text = tally.text();
    if let Some(folder) = out {
        write_json(&results, &folder.join("blind.json"))?;
        write(&folder.join("blind.txt"), &text)?;
    }
    if let Some(path) = &json.path {
        write_json(&results, path)?;
    }
    let missed = tally.goals.iter().filter(|g| g.met == Some(false)).count();
    if json.is_printed() {
        return Ok(ExitCode::from(u8::from(missed > 0)));
    }
    if opened {
        print(&tally.trials.iter().map(whirlstand_blind::opened).collect::<String>())?;
    } else {
        let painted = text.replace("MISSED", &style::bad("MISSED"));
        let again = match tally.failures().next() {
            Some(_) => {
                "\nto repeat one: whirlstand blind --only NUMBER --keep DIR, with the same vehicle and input\n"
            }
            None => "",
        };
        print(&format!("{painted}{again}"))?;
    }
    Ok(ExitCode::from(u8::from(missed > 0)))
}

/// The trials of an earlier run of the same call and part, for resuming.
fn earlier(path: &Path, args: &BlindRunArgs, part: Option<&Part>) -> Result<Vec<Scored>, Failure> {
    let mend = |why: String| Failure::Mend(format!("--resume {}: {why}", path.display()));
    let Results { tally, part: of } = Results::read(path).map_err(mend)?;
    let (was, is) = (parts::of_call(&tally), call(args));
    if was != is {
        return Err(mend(format!("these results are from another call: '{was}', not '{is}'")));
    }
    if of.as_ref() != part {
        return Err(mend("these results are from another part, vehicle, record or version".into()));
    }
    Ok(tally.trials)
}

/// The user's vehicle and excitation, and which of them are drawn instead.
fn setting(args: &BlindRunArgs) -> Result<Setting, Failure> {
    let vehicle = args.vehicle.as_deref().map(find).transpose()?;
    let setting = Setting { vehicle, commands: None, lengths_s: args.length, rates_hz: args.rate.clone() };
    let Some(path) = &args.input else { return Ok(setting) };
    let Some(vehicle) = &setting.vehicle else {
        return Err(Failure::Mend("--input requires --vehicle: the vehicle whose inputs it contains".into()));
    };
    let record = super::log::read(path, &args.map)?;
    let period_s = simulate::period(&record, None)?;
    let (_, inputs) = simulate::commands(vehicle, &record, period_s)?;
    Ok(Setting { commands: Some(Commands { period_s, inputs }), ..setting })
}

/// The generator from which the trials are drawn.
fn generator(args: &BlindRunArgs) -> Generator {
    match args.generator {
        BlindGenerator::Reference => Generator::Reference,
        BlindGenerator::Shifted => Generator::Shifted,
    }
}

/// Whether the trials are flown in closed loop.
fn loops(args: &BlindRunArgs) -> Loops {
    match args.control_loop {
        BlindLoop::Open => Loops::Open,
        BlindLoop::Closed => Loops::Closed,
        BlindLoop::Both => Loops::Both,
    }
}

/// The plans of the trials: the first accepted plans of the seed, the requested part of them, or a single
/// one.
fn plans(args: &BlindRunArgs) -> Result<Vec<Plan>, Failure> {
    let (generator, loops) = (generator(args), loops(args));
    if let Some(number) = args.only {
        return Ok(vec![Plan::new(number, generator, loops)]);
    }
    let effects: Vec<Kind> = args
        .effects
        .iter()
        .map(|name| Kind::from_name(name).map_err(|e| Failure::Mend(format!("--effects: {}", e.reason))))
        .collect::<Result<_, _>>()?;
    let mut cases: Vec<Case> = args
        .kinds
        .iter()
        .map(|case| match case {
            BlindCase::Single => Case::Single,
            BlindCase::Clean => Case::Clean,
            BlindCase::Pair => Case::Pair,
            BlindCase::Outside => Case::Outside,
        })
        .collect();
    if cases.is_empty() && !effects.is_empty() {
        cases = vec![Case::Single, Case::Pair];
    }
    if effects.len() == 1 && cases == [Case::Pair] {
        return Err(Failure::Mend("--effects: a pair needs two effects".into()));
    }
    let first = args
        .seed
        .checked_mul(TRIALS_PER_SEED)
        .filter(|first| *first < 1 << 53)
        .ok_or_else(|| Failure::Mend(format!("--seed {}: at most 9000000000 is expected", args.seed)))?;
    let all = (first..first + TRIALS_PER_SEED).map(|number| Plan::new(number, generator, loops));
    let all = all.filter(|p| p.wanted(&cases, &effects)).take(args.trials);
    let own = |at: u64| args.shard.is_none_or(|shard| shard.has(at));
    Ok((0..).zip(all).filter(|(at, _)| own(*at)).map(|(_, plan)| plan).collect())
}

/// The command line that repeats this run.
fn call(args: &BlindRunArgs) -> String {
    let mut arguments = vec!["whirlstand blind".to_string()];
    match args.only {
        Some(number) => arguments.push(format!("--only {number}")),
        None => arguments.push(format!("--trials {} --seed {}", args.trials, args.seed)),
    }
    arguments.extend(args.vehicle.iter().map(|v| format!("--vehicle {v}")));
    arguments.extend(args.input.iter().map(|i| format!("--input {}", i.display())));
    if args.generator != BlindGenerator::Reference {
        arguments.push(format!("--generator {}", generator(args).name()));
    }
    match args.control_loop {
        BlindLoop::Open => {}
        BlindLoop::Closed => arguments.push("--loop closed".into()),
        BlindLoop::Both => arguments.push("--loop both".into()),
    }
    arguments.extend(args.length.map(|(from, to)| format!("--length {from}:{to}")));
    if let Some(rates) = &args.rate {
        let rates: Vec<String> = rates.iter().map(f64::to_string).collect();
        arguments.push(format!("--rate {}", rates.join(",")));
    }
    if !args.effects.is_empty() {
        arguments.push(format!("--effects {}", args.effects.join(",")));
    }
    if !args.kinds.is_empty() {
        let kinds: Vec<&str> = args.kinds.iter().map(|k| k.word()).collect();
        arguments.push(format!("--kinds {}", kinds.join(",")));
    }
    arguments.join(" ")
}
