//! The circle: record, causes, extended vehicle, new law, flights, verdict.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use whirlstand_control::design::LeftOut;
use whirlstand_diagnose::{Diagnosis, Options, Watch, diagnose};
use whirlstand_ident::watch::Stage;
use whirlstand_nodes::config::{ControllerConfig, LawKind, NodeConfig, VehicleSource};
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::{LinearModel, Vehicle};

use super::answer::Tuning;
use super::draws::{Draws, is_disturbance};
use super::judge::{Gain, Judged, LawFigures, compare};
use super::pilot::Pilot;
use super::trials::{Flown, Motion, Trials};
use super::{text, tuned};
use crate::campaign::limits;
use crate::cli::TuneArgs;
use crate::command::stage_line::StageLine;
use crate::command::{INTERRUPTED, log, tell, write};
use crate::error::Failure;
use crate::file::{Plan, find, plan};

/// Fewest draws that are worth a verdict.
const FEWEST_DRAWS: u64 = 20;

/// Runs the command.
pub(crate) fn tune(args: &TuneArgs) -> Result<ExitCode, Failure> {
    if args.draws < FEWEST_DRAWS {
        return Err(Failure::Mend(format!("--draws {}: at least {FEWEST_DRAWS} are expected", args.draws)));
    }
    let found = find(&args.launch)?;
    let plan = plan(&found.document, &found.name, &found.folder).map_err(Failure::mend)?;
    let config = &plan.config;
    let (believed, origin) = &believed(config, &found.folder)?;
    let diagnosis = diagnosis(args, believed)?;
    let extended = &extended(&diagnosis, believed);
    let law = args.law.map_or(config.controller.law, LawKind::from);
    let controller = ControllerConfig { law, ..config.controller.clone() };
    let old = Pilot::new(config, (believed, origin), config.controller.clone())?;
    let new = Pilot::new(config, (extended, origin), controller)?;
    let draws = Draws::new(config, origin, extended, &diagnosis);
    let Some(flown) = fly([&old, &new], extended, &plan, &draws, args.draws)? else {
        return Ok(ExitCode::from(INTERRUPTED));
    };
    let [(old_flights, old_motions), (new_flights, new_motions)] = flown;
    let has_model =
        extended.effects != believed.effects || extended.a != believed.a || extended.b != believed.b;
    let gain = match (has_model, law == config.controller.law) {
        (false, true) => unchanged(),
        _ => compare(&old_flights, &new_flights),
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
        before: LawFigures::of(&old_flights, extended),
        after: LawFigures::of(&new_flights, extended),
        loop_before: old.loop_around(&linear, extended),
        loop_after: new.loop_around(&linear, extended),
        gain,
        tuned: shown(&paths.tuned),
        extended_vehicle: has_model.then(|| shown(&paths.vehicle)),
        report: shown(&paths.report),
    };
    let top = std::f64::consts::PI / Setup::period_s(config);
    write(&paths.report, &text::page(&answer, extended, [old_motions, new_motions], top)?)?;
    tell(&args.json, &answer, || text::screen(&answer))?;
    Ok(ExitCode::SUCCESS)
}

/// How the flights of a law are judged, and their motion.
type Flights = (Vec<Judged>, Vec<Motion>);

/// Both laws on every draw; `None` when a signal ended it.
fn fly(
    laws: [&Pilot; 2],
    extended: &Vehicle,
    plan: &Plan,
    draws: &Draws<'_>,
    count: u64,
) -> Result<Option<[Flights; 2]>, Failure> {
    let plant = Setup::plant_of(extended, Setup::period_s(&plan.config)).map_err(Failure::mend)?;
    let trials = Trials { draws, vehicle: extended, plant: &plant, limits: &limits(plan) };
    let line = StageLine::new("tune", None);
    let listener = line.listener();
    let flown: Result<Option<Flown>, Failure> = trials.fly(&laws, 0..count, &|share| {
        listener(Stage { what: "flying both laws", detail: "", share: Some(share) });
    });
    line.finish();
    Ok(flown?.map(|flown| {
        let mut laws =
            flown.into_iter().map(|trials| trials.into_iter().map(|t| (t.judged, t.motion)).unzip());
        [laws.next().unwrap_or_default(), laws.next().unwrap_or_default()]
    }))
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

/// The vehicle that the launch file's law is designed for, and where its file is.
fn believed(config: &NodeConfig, folder: &Path) -> Result<(Vehicle, String), Failure> {
    let VehicleSource { origin, text } = config.model.as_ref().unwrap_or(&config.vehicle);
    let mut vehicle = Vehicle::parse(text, origin).map_err(Failure::mend)?;
    let path = folder.join(origin);
    vehicle.folder = Some(path.parent().unwrap_or(folder).to_path_buf());
    Ok((vehicle, path.display().to_string()))
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
