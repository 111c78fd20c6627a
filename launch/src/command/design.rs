//! `whirlstand design`: gains, poles and margins of a control law.

use std::path::Path;
use std::process::ExitCode;

use whirlstand_control::design::{EstimatedLoop, LoopFigures, Pole};
use whirlstand_control::margins::{LoopMargins, MultivariableMargins};
use whirlstand_control::{Design, Responses};
use whirlstand_logs::shown::counted;
use whirlstand_msgs::units::clean;
use whirlstand_nodes::controller::left_out;
use whirlstand_nodes::estimator::filter_of;
use whirlstand_nodes::setup::Setup;
use whirlstand_report::{DesignReport, design_report};
use whirlstand_vehicle::{Engine, LinearModel, Vehicle};

use super::{tell, write};
use crate::cli::DesignArgs;
use crate::error::Failure;
use crate::file::{Document, Plan, plan};
use crate::style;

/// Most poles at the origin that are listed one by one.
const MOST_DELAY_LINES: usize = 8;

/// Runs the command.
pub(crate) fn design(args: &DesignArgs) -> Result<ExitCode, Failure> {
    let (vehicle, design) = designed(args)?;
    let report = args.out.as_ref().map(|folder| folder.join("report.html"));
    if let Some(path) = &report {
        let responses = Responses::of(&design).map_err(Failure::run)?;
        let report = DesignReport {
            vehicle: &vehicle.name,
            design: &design,
            responses: &responses,
            state_units: &vehicle.states.iter().map(|s| s.unit.shown()).collect::<Vec<_>>(),
            text: &style::plain(&design_text(&design)),
        };
        write(path, &design_report(&report).map_err(Failure::run)?)?;
    }
    let told = || {
        let report = report.as_ref().map(|path| format!("\nreport  {}\n", path.display()));
        design_text(&design) + &report.unwrap_or_default()
    };
    tell(&args.json, &design, told)?;
    Ok(ExitCode::SUCCESS)
}

/// A plan made as a launch file makes it, so that every option has the same meaning here and there.
pub(super) fn controller_plan(
    vehicle: &str,
    law: &str,
    rate_hz: f64,
    options: &[String],
) -> Result<Plan, Failure> {
    let mut document = Document::parse("--law", "[controller]\n").map_err(Failure::mend)?;
    let mut set = |option: &str, key: &str, value: toml::Value| {
        document.set_value(format!("{option} {value}"), key, &value).map_err(Failure::mend)
    };
    set("VEHICLE", "vehicle", vehicle.into())?;
    set("--law", "controller.law", law.into())?;
    set("--rate", "rate_hz", rate_hz.into())?;
    for assignment in options {
        document.set("--set", &format!("controller.{assignment}")).map_err(Failure::mend)?;
    }
    plan(&document, "design", Path::new(".")).map_err(Failure::mend)
}

fn designed(args: &DesignArgs) -> Result<(Vehicle, Design), Failure> {
    let plan = controller_plan(&args.vehicle, &args.law, args.rate, &args.set)?;
    let Some(options) = plan.config.controller.options() else {
        return Err(Failure::Mend(
            "--law manual: there is nothing to design; lqr, ppc or smc is expected".into(),
        ));
    };
    // The node's full setup is not used: a vehicle can be designed for before the bus can carry its outputs.
    let source = &plan.config.vehicle;
    let vehicle = Vehicle::parse(&source.text, &source.origin).map_err(Failure::mend)?;
    let plant = Setup::plant_of(&vehicle, Setup::period_s(&plan.config)).map_err(Failure::mend)?;
    let mut design = Design::new(&plant, &options)
        .map_err(|e| Failure::Mend(format!("{} cannot be designed for {}: {e}", args.law, args.vehicle)))?;
    let linear = LinearModel::new(&vehicle).map_err(Failure::mend)?;
    design.left_out = left_out(&design, &plan.config.controller, &vehicle).map_err(Failure::mend)?;
    design.with_estimator = Some(estimated(&vehicle, &design, &linear, &plan));
    Ok((vehicle, design))
}

/// The loop with the filter that a launch file has by default, or the reason why there is none.
fn estimated(vehicle: &Vehicle, design: &Design, linear: &LinearModel, plan: &Plan) -> LoopFigures {
    let every: Vec<u32> = vehicle.outputs.iter().map(|o| o.every).collect();
    filter_of(vehicle, &design.plant, &plan.config.estimator, Engine::Flying)
        .map_err(|e| e.to_string())
        .and_then(|estimator| {
            EstimatedLoop::new(&design.plant, &design.linear, &estimator, linear, &every)
                .map_err(|e| e.to_string())
        })
        .map_or_else(|why| LoopFigures::Absent { why }, |known| LoopFigures::Known(Box::new(known)))
}

fn design_text(d: &Design) -> String {
    let (inputs, states) = (d.plant.input_names(), d.plant.state_names());
    let mut text = format!(
        "{} for {} and {}, sampled every {} ms, one period of latency accounted for\n",
        style::strong(&d.law.to_uppercase()),
        counted(states.len(), "state"),
        counted(inputs.len(), "input"),
        clean(d.plant.period_s() * 1e3)
    );
    text.push_str(&late_text(d));
    let mut columns = states.to_vec();
    columns.extend(d.integral.iter().map(|&i| format!("int {}", states[i])));
    // Further columns belong to the states of super-twisting, which are no feedback of a vehicle state.
    let mut gain =
        d.linear.gain.columns(0, states.len()).into_owned().resize_horizontally(columns.len(), 0.0);
    let integrals = d.integral.len();
    gain.columns_mut(states.len(), integrals).copy_from(&d.linear.memory_gain.columns(0, integrals));
    let title = if d.sliding.is_some() {
        "gain K in u = -K x (SI), within the boundary layer"
    } else {
        "gain K in u = -K x (SI)"
    };
    text.push_str(&table(title, inputs, &columns, &gain));
    if let Some(sliding) = &d.sliding {
        let mut surface = sliding.surface.columns(0, states.len()).into_owned();
        surface = surface.resize_horizontally(columns.len(), 0.0);
        surface
            .columns_mut(states.len(), integrals)
            .copy_from(&sliding.surface.columns(d.plant.size(), integrals));
        text.push_str(&table("sliding surface", inputs, &columns, &surface));
        text.push_str(&format!("\n{}\n  {}\n", style::strong("reaching"), sliding.reaching));
        let held = inputs.iter().zip(&sliding.matched_disturbance);
        let held: Vec<_> = held.map(|(name, d)| format!("{name} {d:.4}")).collect();
        text.push_str(&format!("  matched disturbance overcome (input units): {}\n", held.join(", ")));
    }
    text.push_str(&poles("open-loop poles", &d.open_loop_poles));
    text.push_str(&poles("closed-loop poles (delayed loop)", &d.closed_loop_poles));
    text.push_str(&format!("\n{}\n", style::strong("margins, one input at a time")));
    text.push_str(&margins_text(inputs, &d.loop_margins, &d.multivariable_margins));
    match &d.with_estimator {
        None => {}
        Some(LoopFigures::Absent { why }) => text.push_str(&format!("\nwith the filter: {why}\n")),
        Some(LoopFigures::Known(e)) => {
            text.push_str(&format!("\n{}\n", style::strong("margins with the filter, as flown")));
            text.push_str(&margins_text(inputs, &e.loop_margins, &e.multivariable_margins));
            if e.spectral_radius >= 1.0 {
                text.push_str("  UNSTABLE: law and filter together do not stabilize this vehicle\n");
            }
        }
    }
    for l in &d.left_out {
        text.push_str(&format!("not used: {} of {}: {}\n", l.effect, l.place, l.why));
    }
    text
}

/// Text on the delays of this plant and on its other properties outside the matrices.
fn late_text(d: &Design) -> String {
    let late = d.plant.input_names().iter().zip(d.plant.delays_s()).filter(|(_, s)| **s > 0.0);
    let late: Vec<String> = late.map(|(name, s)| format!("{name} {} ms", clean(s * 1e3))).collect();
    match late.is_empty() {
        true => String::new(),
        false => format!(
            "late inputs: {}; the law also feeds back {} past commands\n",
            late.join(", "),
            d.plant.memory_names().len()
        ),
    }
}

fn margins_text(inputs: &[String], loops: &[LoopMargins], m: &MultivariableMargins) -> String {
    let mut text = String::new();
    let or = |v: Option<f64>, unit: &str| v.map_or("infinite".into(), |v| format!("{v:.3}{unit}"));
    for (name, m) in inputs.iter().zip(loops) {
        text.push_str(&format!(
            "  {name:<12} gain x {} to {}, phase {}, delay {}, crossover {}\n",
            m.gain_decrease.map_or("0".into(), |v| format!("{v:.3}")),
            or(m.gain_increase, ""),
            or(m.phase_deg, " deg"),
            or(m.delay_s.map(|s| s * 1e3), " ms"),
            or(m.crossover_rad_s, " rad/s"),
        ));
    }
    text.push_str(&format!(
        "  {:<12} gains x {:.3} to {} or phases of {:.1} deg, all inputs at once; peak sensitivity {:.3}\n",
        "together",
        m.disk_gain_low,
        or(m.disk_gain_high, ""),
        m.disk_phase_deg,
        m.max_sensitivity
    ));
    text
}

fn table(title: &str, rows: &[String], columns: &[String], matrix: &nalgebra::DMatrix<f64>) -> String {
    let mut text = format!("\n{}\n  {:<12}", style::strong(title), "");
    let width = |name: &str| name.len().max(11);
    columns.iter().for_each(|name| text.push_str(&format!(" {name:>w$}", w = width(name))));
    text.push('\n');
    for (i, row) in rows.iter().enumerate().take(matrix.nrows()) {
        text.push_str(&format!("  {row:<12}"));
        for (name, value) in columns.iter().zip(matrix.row(i).iter()) {
            text.push_str(&format!(" {value:>w$.5}", w = width(name)));
        }
        text.push('\n');
    }
    text
}

fn poles(title: &str, poles: &[Pole]) -> String {
    let mut text = format!("\n{}\n", style::strong(title));
    let delays = poles.iter().filter(|p| p.continuous.is_none()).count();
    // The poles of many past commands are given in one line.
    let many = delays > MOST_DELAY_LINES;
    for pole in poles.iter().filter(|p| !many || p.continuous.is_some()) {
        let line = match (pole.continuous, pole.frequency_rad_s, pole.damping) {
            (Some([re, im]), Some(frequency), damping) => {
                let place = if im == 0.0 { format!("{re:.4}") } else { format!("{re:.4} {im:+.4}i") };
                let damping = damping.map_or(String::new(), |d| format!("   damping {d:.3}"));
                format!("{place:<22} 1/s   {frequency:.4} rad/s{damping}")
            }
            _ => "delay (z = 0)".into(),
        };
        text.push_str(&format!("  {line}\n"));
    }
    if many {
        text.push_str(&format!("  delay (z = 0)          {delays} times\n"));
    }
    text
}
