//! `whirlstand blind`: what diagnosis finds of hidden effects, by trials whose answers are sealed while it runs.

mod runner;

use std::path::Path;
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressStyle};
use whirlstand_blind::{Case, Commands, Generator, Loops, Plan, Scored, Setting, TRIALS_PER_SEED, Tally};
use whirlstand_vehicle::Kind;

use self::runner::TrialRunner;
use super::vehicles::find;
use super::{INTERRUPTED, print, simulate, write, write_json};
use crate::cli::{BlindArgs, BlindCase, BlindGenerator, BlindLoop};
use crate::error::Failure;
use crate::style;
use crate::supervisor::Signals;

/// Runs the command; exit code 1 when a goal is missed, 130 when it was interrupted: what was done by then is told. On
/// SIGINT the trials that have begun come to their end; SIGTERM and a second signal drop them.
pub(crate) fn blind(args: &BlindArgs) -> Result<ExitCode, Failure> {
    let setting = setting(args)?;
    let all = plans(args)?;
    let earlier = args.resume.as_deref().map(|path| earlier(path, args)).transpose()?.unwrap_or_default();
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
    let code = report(args, &tally)?;
    if cut.is_some() {
        crate::style::say(&format!("interrupted: {done} of {} trials were done, and count above", all.len()));
        return Ok(ExitCode::from(INTERRUPTED));
    }
    Ok(code)
}

fn report(args: &BlindArgs, tally: &Tally) -> Result<ExitCode, Failure> {
    let text = tally.text();
    if let Some(folder) = &args.out {
        write_json(tally, &folder.join("blind.json"))?;
        write(&folder.join("blind.txt"), &text)?;
    }
    if let Some(path) = &args.json.path {
        write_json(tally, path)?;
    }
    let missed = tally.goals.iter().filter(|g| g.met == Some(false)).count();
    if args.json.is_printed() {
        return Ok(ExitCode::from(u8::from(missed > 0)));
    }
    if args.only.is_some() {
        print(&tally.trials.iter().map(whirlstand_blind::opened).collect::<String>())?;
    } else {
        let painted = text.replace("MISSED", &style::bad("MISSED"));
        let again = match tally.failures().next() {
            Some(_) => {
                "\nrepeat one: whirlstand blind --only NUMBER --keep DIR, with the same vehicle and input\n"
            }
            None => "",
        };
        print(&format!("{painted}{again}"))?;
    }
    Ok(ExitCode::from(u8::from(missed > 0)))
}

/// The trials of an earlier run of the same call.
fn earlier(path: &Path, args: &BlindArgs) -> Result<Vec<Scored>, Failure> {
    let mend = |why: String| Failure::Mend(format!("--resume {}: {why}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|e| mend(e.to_string()))?;
    let tally: Tally = serde_json::from_str(&text)
        .map_err(|e| mend(format!("not the results of whirlstand blind (its --json): {e}")))?;
    let (was, is) = (tally.call.split(" (").next().unwrap_or_default(), call(args));
    if was != is {
        return Err(mend(format!("these are of another call: '{was}', not '{is}'")));
    }
    Ok(tally.trials)
}

/// The user's vehicle and excitation, and what is drawn instead.
fn setting(args: &BlindArgs) -> Result<Setting, Failure> {
    let vehicle = args.vehicle.as_deref().map(find).transpose()?;
    let setting = Setting { vehicle, commands: None, lengths_s: args.length, rates_hz: args.rate.clone() };
    let Some(path) = &args.input else { return Ok(setting) };
    let Some(vehicle) = &setting.vehicle else {
        return Err(Failure::Mend("--input needs the --vehicle whose inputs it has".into()));
    };
    let record = super::log::read(path, &args.map)?;
    let period_s = simulate::period(&record, None)?;
    let (_, inputs) = simulate::commands(vehicle, &record, period_s)?;
    Ok(Setting { commands: Some(Commands { period_s, inputs }), ..setting })
}

/// What the trials are drawn from.
fn generator(args: &BlindArgs) -> Generator {
    match args.generator {
        BlindGenerator::Reference => Generator::Reference,
        BlindGenerator::Shifted => Generator::Shifted,
    }
}

/// Whether a law flies them.
fn loops(args: &BlindArgs) -> Loops {
    match args.control_loop {
        BlindLoop::Open => Loops::Open,
        BlindLoop::Closed => Loops::Closed,
        BlindLoop::Both => Loops::Both,
    }
}

/// The first so many plans of the seed that are wanted, or the one that is asked for.
fn plans(args: &BlindArgs) -> Result<Vec<Plan>, Failure> {
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
    Ok(all.filter(|p| p.wanted(&cases, &effects)).take(args.trials).collect())
}

/// The call as it can be repeated.
fn call(args: &BlindArgs) -> String {
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
