//! The circle: record, causes, extended vehicle, new law, flights, verdict.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use whirlstand_control::design::{EstimatedLoop, LeftOut, LoopFigures};
use whirlstand_diagnose::{Diagnosis, Options, Watch, diagnose};
use whirlstand_evaluate::Flight;
use whirlstand_ident::watch::Stage;
use whirlstand_nodes::config::{LawKind, NodeConfig, VehicleSource};
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::{LinearModel, Vehicle};

use super::answer::Tuning;
use super::draw::{draw, is_disturbance};
use super::flight::{Pilot, fly};
use super::judge::{Gain, Judged, LawFigures, compare, judge};
use super::{text, tuned};
use crate::cli::TuneArgs;
use crate::command::stage_line::StageLine;
use crate::command::{log, tell, write};
use crate::error::Failure;
use crate::file::{Plan, find, plan};

/// Fewest draws that are worth a verdict.
const FEWEST_DRAWS: usize = 20;

/// Runs the command.
pub(crate) fn tune(args: &TuneArgs) -> Result<ExitCode, Failure> {
    if args.draws < FEWEST_DRAWS {
        return Err(Failure::Mend(format!("--draws {}: at least {FEWEST_DRAWS} are expected", args.draws)));
    }
    let found = find(&args.launch)?;
    let plan = plan(&found.document, &found.name, &found.folder).map_err(Failure::mend)?;
    let config = &plan.config;
    let believed = believed(config, &found.folder)?;
    let diagnosis = diagnosis(args, &believed)?;
    let extended = &extended(&diagnosis, &believed);
    let law = args.law.map_or(config.controller.law, LawKind::from);
    let laws = [Pilot::new(config, &believed, config.controller.law)?, Pilot::new(config, extended, law)?];
    let line = StageLine::new("tune", None);
    let listener = line.listener();
    let flown = fly_all(&laws, extended, &plan, &diagnosis, args.draws, &|share| {
        listener(Stage { what: "flying both laws", detail: "", share: Some(share) });
    });
    line.finish();
    let [old, new] = flown?;
    let has_model =
        extended.effects != believed.effects || extended.a != believed.a || extended.b != believed.b;
    let gain = match (has_model, law == config.controller.law) {
        (false, true) => unchanged(),
        _ => compare(&judged(&old), &judged(&new)),
    };
    let paths = Paths::in_folder(&args.out);
    if has_model {
        write(&paths.vehicle, &extended.to_toml())?;
    }
    write(&paths.tuned, &tuned::launch_file(&found, has_model, law, &gain)?)?;
    let linear = LinearModel::new(extended).map_err(Failure::mend)?;
    let shown = |path: &Path| path.display().to_string();
    let answer = Tuning {
        schema: "whirlstand.tune.v1",
        launch: args.launch.clone(),
        vehicle: believed.name.clone(),
        law_before: config.controller.law,
        law_after: law,
        diagnosis: diagnosis.summary.clone(),
        causes: diagnosis.causes.clone(),
        left_out: linear.left_out.iter().map(|(e, why)| left_out(e, why)).collect(),
        draws: args.draws,
        before: LawFigures::of(&judged(&old), extended),
        after: LawFigures::of(&judged(&new), extended),
        loop_before: loop_of(&laws[0], &linear, extended),
        loop_after: loop_of(&laws[1], &linear, extended),
        gain,
        tuned: shown(&paths.tuned),
        extended_vehicle: has_model.then(|| shown(&paths.vehicle)),
        report: shown(&paths.report),
    };
    let flights = |flown: Vec<(Judged, Flight)>| flown.into_iter().map(|(_, flight)| flight).collect();
    write(&paths.report, &text::page(&answer, extended, [flights(old), flights(new)])?)?;
    tell(&args.json, &answer, || text::screen(&answer))?;
    Ok(ExitCode::SUCCESS)
}

struct Paths {
    vehicle: PathBuf,
    tuned: PathBuf,
    report: PathBuf,
}

impl Paths {
    fn in_folder(folder: &Path) -> Self {
        Self {
            vehicle: folder.join(tuned::MODEL),
            tuned: folder.join("tuned.toml"),
            report: folder.join("report.html"),
        }
    }
}

/// The vehicle that the launch file's law is designed for.
fn believed(config: &NodeConfig, folder: &Path) -> Result<Vehicle, Failure> {
    let VehicleSource { origin, text } = config.model.as_ref().unwrap_or(&config.vehicle);
    let mut vehicle = Vehicle::parse(text, origin).map_err(Failure::mend)?;
    vehicle.folder = Some(folder.join(origin).parent().unwrap_or(folder).to_path_buf());
    Ok(vehicle)
}

fn diagnosis(args: &TuneArgs, vehicle: &Vehicle) -> Result<Diagnosis, Failure> {
    let records = args.logs.iter().map(|path| log::read_for(path, &args.map, vehicle));
    let records = records.collect::<Result<Vec<_>, _>>()?;
    let line = StageLine::new("tune", None);
    let listener = line.listener();
    let watch = Watch::new(Arc::new(AtomicBool::new(false)), listener);
    let answer = diagnose(&records, vehicle, &Options { watch, ..Options::default() });
    line.finish();
    answer.map_err(Failure::mend)
}

/// The vehicle with what was found of it. A gust that the record holds is not the vehicle's, and those of the flights to come
/// are the launch file's.
fn extended(diagnosis: &Diagnosis, believed: &Vehicle) -> Vehicle {
    let mut vehicle = diagnosis.extended.as_deref().unwrap_or(believed).clone();
    vehicle.effects.retain(|e| !is_disturbance(e) || believed.effects.contains(e));
    vehicle
}

fn left_out(effect: &whirlstand_vehicle::Effect, why: &str) -> LeftOut {
    LeftOut { effect: effect.kind().name().into(), place: effect.place().into(), why: why.into() }
}

fn judged(flown: &[(Judged, Flight)]) -> Vec<Judged> {
    flown.iter().map(|(judged, _)| judged.clone()).collect()
}

fn unchanged() -> Gain {
    Gain {
        cost_ratio: None,
        cost_ratio_low: None,
        cost_ratio_high: None,
        better_share: 0.0,
        certain: false,
        why: "the diagnosis found nothing that the law does not know".into(),
    }
}

/// Margins of a law with its filter around the vehicle as it is.
fn loop_of(pilot: &Pilot, linear: &LinearModel, vehicle: &Vehicle) -> Option<LoopFigures> {
    let design = pilot.design.as_ref()?;
    let every: Vec<u32> = vehicle.outputs.iter().map(|o| o.every).collect();
    let figures = EstimatedLoop::new(&design.plant, &design.linear, pilot.estimator(), linear, &every);
    Some(figures.map_or_else(
        |e| LoopFigures::Absent { why: e.to_string() },
        |known| LoopFigures::Known(Box::new(known)),
    ))
}

/// One draw, flown by the old law and by the new one.
type Pair = [(Judged, Flight); 2];

/// Both laws on every draw, each draw with its own noise; the work is shared among the processors.
fn fly_all(
    laws: &[Pilot; 2],
    extended: &Vehicle,
    plan: &Plan,
    diagnosis: &Diagnosis,
    draws: usize,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<[Vec<(Judged, Flight)>; 2], Failure> {
    let config = &plan.config;
    // One measure for both laws: the vehicle's own sizes.
    let plant = Setup::plant_of(extended, Setup::period_s(config)).map_err(Failure::mend)?;
    let fly_one = |k: usize| -> Result<Pair, Failure> {
        let seed = config.seed.wrapping_add(k as u64);
        // The first draw is what was found itself.
        let mut truth = if k == 0 { extended.clone() } else { draw(extended, diagnosis, seed) };
        for effect in config.effects.iter().filter(|e| is_disturbance(e)) {
            truth.add_effect(effect.clone()).map_err(Failure::mend)?;
        }
        let one = |law: &Pilot| -> Result<(Judged, Flight), Failure> {
            let flown = fly(law, &truth, config, seed).map_err(Failure::mend)?;
            let judged = judge(&flown.flight, flown.lost, &truth, &plant, &plan.expect);
            Ok((judged, flown.flight))
        };
        Ok([one(&laws[0])?, one(&laws[1])?])
    };
    let workers = std::thread::available_parallelism().map_or(1, std::num::NonZero::get).min(draws);
    let done = std::sync::atomic::AtomicUsize::new(0);
    let work = |worker: usize| -> Result<Vec<(usize, Pair)>, Failure> {
        let mut flown = Vec::new();
        for k in (worker..draws).step_by(workers) {
            flown.push((k, fly_one(k)?));
            let count = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress(count as f64 / draws as f64);
        }
        Ok(flown)
    };
    let parts: Vec<_> = std::thread::scope(|scope| {
        let work = &work;
        let threads: Vec<_> = (0..workers).map(|worker| scope.spawn(move || work(worker))).collect();
        threads.into_iter().map(std::thread::ScopedJoinHandle::join).collect()
    });
    let mut all = Vec::with_capacity(draws);
    for part in parts {
        all.extend(part.map_err(|_| Failure::Run("a flight of tune ended the program".into()))??);
    }
    all.sort_by_key(|(k, _)| *k);
    let (old, new) = all.into_iter().map(|(_, [old, new])| (old, new)).unzip();
    Ok([old, new])
}
