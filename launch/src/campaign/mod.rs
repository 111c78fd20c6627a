//! `whirlstand campaign`: many flights of one launch file, on every processor of this machine or part by part on others.

mod flyer;
mod in_thread;
mod journal;
mod pilots;
mod redrawn;
mod said;
mod side_by_side;
mod without_log;
mod workers;

pub(crate) use flyer::limits;
pub(crate) use side_by_side::side_by_side;
pub(crate) use without_log::without_log;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressStyle};
use whirlstand_campaign::{Findings, Flight, Shard, Table, TableInfo};
use whirlstand_report::{CampaignReport, campaign_report};

use crate::cli::{CampaignArgs, CampaignCommand, CampaignFlyArgs, CampaignMergeArgs, CampaignReplayArgs};
use crate::command::{INTERRUPTED, tell, write};
use crate::error::Failure;
use crate::exclusive::OutFolder;
use crate::file::Jobs;
use crate::live::LiveAddresses;
use crate::run::{fly_all, folder_name};
use flyer::Flyer;
use journal::Journal;
use said::Said;

/// Runs the command. The exit code is 130 when it was interrupted; the flights that were finished by then are
/// kept and reported.
pub(crate) fn campaign(args: &CampaignArgs) -> Result<ExitCode, Failure> {
    match &args.action {
        None => fly(&args.fly),
        Some(CampaignCommand::Replay(args)) => replay(args),
        Some(CampaignCommand::Merge(args)) => merge(args),
    }
}

fn fly(args: &CampaignFlyArgs) -> Result<ExitCode, Failure> {
    // Without a subcommand clap asks for the file.
    let file = args.file.as_deref().ok_or_else(|| Failure::Mend("a campaign file is expected".into()))?;
    let flyer = Flyer::new(file)?;
    let campaign = flyer.campaign();
    if args.until_width.is_some() && !campaign.method.may_stop_early() {
        return Err(Failure::Mend(format!(
            "--until-width: the first flights of method \"{}\" are not a sample of the whole: use \"random\" or \
             \"sobol\"",
            campaign.method.word()
        )));
    }
    let name = args.shard.map_or("flights".into(), part_name);
    let out = match &args.out {
        // Several parts of a campaign may write into one folder at the same time.
        Some(path) if args.shard.is_some() => OutFolder::shared(path, &name)?,
        Some(path) => OutFolder::given(path)?,
        None => OutFolder::fresh(&folder_name(flyer.name()))?,
    };
    let info = TableInfo {
        digest: flyer.digest().into(),
        version: env!("CARGO_PKG_VERSION").into(),
        flights: campaign.flights(),
        shard: args.shard,
        text: campaign.text.clone(),
        columns: flyer.columns().clone(),
    };
    let numbers: Vec<u64> =
        (0..campaign.flights()).filter(|n| args.shard.is_none_or(|s| s.has(*n))).collect();
    let journal_path = out.path().join(format!("{name}.jsonl"));
    let (mut journal, done) = Journal::open(&journal_path, &info, args.resume)?;
    let jobs =
        args.jobs.or_else(|| std::thread::available_parallelism().ok()).map_or(1, std::num::NonZero::get);
    let bar = bar(numbers.len(), done.len());
    let began = std::time::Instant::now();
    let before = done.len();
    let flown = workers::fly_all(&flyer, &numbers, done, (jobs, args.until_width), &mut journal, &bar);
    bar.finish_and_clear();
    let flown = flown?;
    let table = table(info, flown.flights, flown.enough);
    let said = Said {
        campaign: &file.display().to_string(),
        launch: &campaign.launch,
        method: campaign.method.word(),
        seed: campaign.seed,
        planned: numbers.len() as u64,
        wall_s: Some(began.elapsed().as_secs_f64()),
        flown_now: (table.flights.len().saturating_sub(before)) as u64,
        jobs,
        partial: flown.interrupted,
        enough: flown.enough.is_some(),
        table: None,
        report: None,
        findings: Findings::of(&table),
        columns: &table.info.columns,
    };
    if flown.interrupted {
        tell(&args.json, &said, || said.text())?;
        return Ok(ExitCode::from(INTERRUPTED));
    }
    let path = out.path().join(format!("{name}.parquet"));
    table.write(&path).map_err(Failure::mend)?;
    let report = args.shard.is_none().then(|| report(&table, &said, out.path())).transpose()?;
    journal.remove()?;
    let said = Said { table: Some(path), report, ..said };
    tell(&args.json, &said, || said.text())?;
    Ok(ExitCode::SUCCESS)
}

fn part_name(shard: Shard) -> String {
    format!("part-{}-of-{}", shard.part, shard.of)
}

fn bar(flights: usize, done: usize) -> ProgressBar {
    let bar = ProgressBar::new(flights as u64);
    let template =
        ProgressStyle::with_template("{bar:24.cyan/dim} {pos}/{len} flights  {elapsed}, {eta} left");
    bar.set_style(template.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_position(done as u64);
    bar.reset_eta();
    bar
}

/// The flights, in the order of their numbers.
fn table(info: TableInfo, flights: BTreeMap<u64, Flight>, enough: Option<u64>) -> Table {
    let info = TableInfo { flights: enough.unwrap_or(info.flights), ..info };
    Table { info, flights: flights.into_values().collect() }
}

fn report(table: &Table, said: &Said<'_>, out: &Path) -> Result<PathBuf, Failure> {
    let page = campaign_report(&CampaignReport {
        campaign: said.campaign,
        table,
        findings: &said.findings,
        text: &said.text(),
    })
    .map_err(Failure::run)?;
    let path = out.join("report.html");
    write(&path, &page)?;
    Ok(path)
}

fn replay(args: &CampaignReplayArgs) -> Result<ExitCode, Failure> {
    let flyer = Flyer::new(&args.file)?;
    let flights = flyer.campaign().flights();
    if args.flight >= flights {
        return Err(Failure::Mend(format!(
            "--flight {}: {} has the flights 0 to {}",
            args.flight,
            args.file.display(),
            flights.saturating_sub(1)
        )));
    }
    let jobs: Jobs = flyer.jobs(args.flight, None)?;
    fly_all(&jobs, None, args.out.as_deref(), LiveAddresses::default(), &args.json)
}

fn merge(args: &CampaignMergeArgs) -> Result<ExitCode, Failure> {
    let parts = args
        .parts
        .iter()
        .map(|path| Ok((path.display().to_string(), Table::read(path).map_err(Failure::mend)?)))
        .collect::<Result<Vec<_>, Failure>>()?;
    let table = Table::join(parts).map_err(Failure::mend)?;
    let campaign = whirlstand_campaign::Campaign::parse("the campaign file in the parts", &table.info.text)
        .map_err(Failure::mend)?;
    let out = OutFolder::given(&args.out)?;
    let path = out.path().join("flights.parquet");
    table.write(&path).map_err(Failure::mend)?;
    let said = Said {
        campaign: "CAMPAIGN",
        launch: &campaign.launch,
        method: campaign.method.word(),
        seed: campaign.seed,
        planned: table.info.flights,
        wall_s: None,
        flown_now: 0,
        jobs: 0,
        partial: false,
        enough: false,
        table: Some(path),
        report: None,
        findings: Findings::of(&table),
        columns: &table.info.columns,
    };
    let report = report(&table, &said, out.path())?;
    let said = Said { report: Some(report), ..said };
    tell(&args.json, &said, || said.text())?;
    Ok(ExitCode::SUCCESS)
}
