//! The tuning sequence: record, causes, extended vehicle, new law, flights, verdict.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use whirlstand_control::design::LeftOut;
use whirlstand_diagnose::{Diagnosis, Options, Verdict, Watch, diagnose};
use whirlstand_ident::watch::Stage;
use whirlstand_nodes::config::{ControllerConfig, LawKind, NodeConfig, VehicleSource};
use whirlstand_nodes::controller;
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::{Effect, LinearModel, Vehicle};

use super::answer::{Tuning, WorstDraw};
use super::draws::{Draws, is_disturbance};
use super::joint::Joint;
use super::judge::{Gain, Judged, LawFigures, compare, told_keys};
use super::pilot::Pilot;
use super::retune::{Retuned, Wanted, retune};
use super::trials::{Flown, Motion, Trials};
use super::tuned::Choice;
use super::{text, truth, tuned};
use crate::campaign::limits;
use crate::cli::TuneArgs;
use crate::command::diagnose::{check_part, part};
use crate::command::log::period_of;
use crate::command::stage_line::StageLine;
use crate::command::{INTERRUPTED, tell, write};
use crate::error::Failure;
use crate::file::{FoundFile, find, plan};

/// Least number of draws for a verdict.
const FEWEST_DRAWS: u64 = 20;

/// Runs the command.
pub(crate) fn tune(args: &TuneArgs) -> Result<ExitCode, Failure> {
    let Some(answer) = circle(args)? else { return Ok(ExitCode::from(INTERRUPTED)) };
    tell(&args.json, &answer, || text::screen(&answer))?;
    Ok(ExitCode::SUCCESS)
}

/// Runs the tuning sequence and writes its files; `None` when a signal ended it.
///
/// # Errors
/// What is wrong with the arguments, the record or a file, and when no law can be designed.
pub(crate) fn circle(args: &TuneArgs) -> Result<Option<Tuning>, Failure> {
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
    let joint = Joint::new(&diagnosis.causes, &diagnosis.correlations);
    let draws = &Draws::new(config, origin, extended, joint);
    let plant = &Setup::plant_of(extended, Setup::period_s(config)).map_err(Failure::mend)?;
    let trials = Trials { draws, vehicle: extended, plant, limits: &limits(&plan) };
    let Some((new, retuned)) = chosen(args, new, config, (extended, origin), &trials)? else {
        return Ok(None);
    };
    let Some(flown) = fly(&trials, [&old, &new], args.draws)? else {
        return Ok(None);
    };
    let [(old_flights, old_motions), (new_flights, new_motions)] = flown;
    let has_model =
        extended.effects != believed.effects || extended.a != believed.a || extended.b != believed.b;
    let gain = match (has_model, new.controller == old.controller) {
        (false, true) => unchanged(diagnosis.verdict),
        _ => compare(&old_flights, &new_flights),
    };
    let truth = args.truth.as_deref().map(|path| truth::fly(path, &plan, [&old, &new], args.draws));
    let truth = match truth.transpose()? {
        Some(None) => return Ok(None),
        truth => truth.flatten(),
    };
    let paths = Paths::in_folder(&args.out);
    let worst = worst(if gain.certain { &new_flights } else { &old_flights }, extended, &paths.worst);
    let choice =
        Choice { has_model, controller: &new.controller, is_retuned: retuned.is_some(), gain: &gain };
    write_files(&paths, &found, &choice, &config.effects, draws, worst.draw)?;
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
        left_out: left_out(&new, &linear, extended)?,
        draws: args.draws,
        before: LawFigures::of(&old_flights, extended),
        after: LawFigures::of(&new_flights, extended),
        loop_before: old.loop_around(&linear, extended),
        loop_after: new.loop_around(&linear, extended),
        retuned,
        worst,
        truth: truth.map(|truth| truth.judged(gain.certain)),
        gain,
        tuned: shown(&paths.tuned),
        extended_vehicle: has_model.then(|| shown(&paths.vehicle)),
        report: shown(&paths.report),
    };
    let top = std::f64::consts::PI / Setup::period_s(config);
    write(&paths.report, &text::page(&answer, extended, [old_motions, new_motions], top)?)?;
    Ok(Some(answer))
}

/// The judgement and the motion of a law's flights.
type Flights = (Vec<Judged>, Vec<Motion>);

/// Flies both laws on every draw; `None` when a signal ended it.
fn fly(trials: &Trials<'_>, laws: [&Pilot; 2], count: u64) -> Result<Option<[Flights; 2]>, Failure> {
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

/// The new law, with its weights chosen anew where that is requested; `None` when a signal ended it.
fn chosen(
    args: &TuneArgs,
    new: Pilot,
    config: &NodeConfig,
    model: (&Vehicle, &str),
    trials: &Trials<'_>,
) -> Result<Option<(Pilot, Option<Retuned>)>, Failure> {
    if !args.retune {
        return Ok(Some((new, None)));
    }
    if !(args.max_sensitivity > 1.0 && args.max_sensitivity.is_finite()) {
        return Err(Failure::Mend(format!(
            "--max-sensitivity {}: a peak above 1 is expected; no loop stays below that",
            args.max_sensitivity
        )));
    }
    let sensitivity_limit = args.max_sensitivity;
    // The draws with lower numbers are those that are judged.
    let wanted = Wanted { config, model, trials, first_draw: args.draws, sensitivity_limit };
    let line = StageLine::new("tune", None);
    (line.listener())(Stage { what: "choosing weights", detail: "", share: None });
    let found = retune(new, &wanted);
    line.finish();
    Ok(found?.map(|(pilot, told)| (pilot, Some(told))))
}

/// The draw on which a law costs most; a draw on which it loses the vehicle comes before all others.
fn worst(flights: &[Judged], vehicle: &Vehicle, launch: &Path) -> WorstDraw {
    let most = flights.iter().enumerate().max_by(|a, b| a.1.cost.total_cmp(&b.1.cost));
    let (draw, lost) = most.map_or((0, false), |(at, judged)| (at as u64, judged.lost));
    let value = |key: String| Some((key.clone(), most?.1.value(&key)?));
    let figures = told_keys(vehicle).into_iter().filter_map(value).collect();
    WorstDraw { draw, lost, figures, launch: launch.display().to_string() }
}

/// Writes the launch files and vehicle files of a tuning.
fn write_files(
    paths: &Paths,
    found: &FoundFile,
    choice: &Choice<'_>,
    effects: &[Effect],
    draws: &Draws<'_>,
    worst: u64,
) -> Result<(), Failure> {
    if choice.has_model {
        write(&paths.vehicle, &draws.vehicle(0).to_toml())?;
    }
    write(&paths.tuned, &tuned::launch_file(found, choice)?)?;
    write(&paths.worst, &tuned::draw_file(found, choice, draws.seed(worst), effects)?)?;
    write(&paths.worst_vehicle, &draws.vehicle(worst).to_toml())
}

struct Paths {
    vehicle: PathBuf,
    tuned: PathBuf,
    worst: PathBuf,
    worst_vehicle: PathBuf,
    report: PathBuf,
}

impl Paths {
    fn in_folder(folder: &Path) -> Self {
        Self {
            vehicle: folder.join(tuned::MODEL),
            tuned: folder.join("tuned.toml"),
            worst: folder.join("worst.toml"),
            worst_vehicle: folder.join(tuned::WORST_VEHICLE),
            report: folder.join("report.html"),
        }
    }
}

/// The vehicle for which the launch file's law is designed, and the folder of its file.
fn believed(config: &NodeConfig, folder: &Path) -> Result<(Vehicle, String), Failure> {
    let VehicleSource { origin, text } = config.model.as_ref().unwrap_or(&config.vehicle);
    let mut vehicle = Vehicle::parse(text, origin).map_err(Failure::mend)?;
    let path = folder.join(origin);
    vehicle.folder = Some(path.parent().unwrap_or(folder).to_path_buf());
    Ok((vehicle, path.display().to_string()))
}

fn diagnosis(args: &TuneArgs, vehicle: &Vehicle) -> Result<Diagnosis, Failure> {
    check_part(&args.part)?;
    let records = args.logs.iter().map(|path| part(path, &args.part, vehicle));
    let records = records.collect::<Result<Vec<_>, _>>()?;
    let line = StageLine::new("tune", None);
    let listener = line.listener();
    let watch = Watch::new(Arc::new(AtomicBool::new(false)), listener);
    let period_s = records.first().and_then(|record| period_of(&args.part, vehicle, record));
    let answer = diagnose(records, vehicle, &Options { watch, period_s, ..Options::default() });
    line.finish();
    answer.map_err(Failure::mend)
}

/// The vehicle extended by the causes found. A gust in the record does not belong to the vehicle; the gusts of
/// later flights are those of the launch file.
fn extended(diagnosis: &Diagnosis, believed: &Vehicle) -> Vehicle {
    let mut vehicle = diagnosis.extended.as_deref().unwrap_or(believed).clone();
    vehicle.effects.retain(|e| !is_disturbance(e) || believed.effects.contains(e));
    vehicle
}

/// Effects of the vehicle that the law does not use; for control by stick, all nonlinear effects.
fn left_out(pilot: &Pilot, linear: &LinearModel, vehicle: &Vehicle) -> Result<Vec<LeftOut>, Failure> {
    if let Some(design) = &pilot.design {
        return controller::left_out(design, &pilot.controller, vehicle).map_err(Failure::mend);
    }
    let told = |(effect, why): &(Effect, &'static str)| LeftOut {
        effect: effect.kind().name().into(),
        place: effect.place().into(),
        why: (*why).into(),
    };
    Ok(linear.left_out.iter().map(told).collect())
}

/// The result when the diagnosis found no cause for which a new law could be designed, with the reason.
fn unchanged(verdict: Verdict) -> Gain {
    let why = match verdict {
        Verdict::Inconclusive => "the diagnosis is inconclusive, so there is nothing to design a new one for",
        Verdict::Unexplained => {
            "the cause is not an effect in the table, so there is nothing to design a new one for"
        }
        Verdict::Consistent | Verdict::Explained | Verdict::PartlyExplained => {
            "the diagnosis found nothing that the law does not already account for"
        }
    };
    Gain {
        cost_ratio: None,
        cost_ratio_low: None,
        cost_ratio_high: None,
        better_share: 0.0,
        certain: false,
        why: why.into(),
    }
}
