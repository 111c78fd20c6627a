//! The measurements of `whirlstand bench` without the command line around them:
//! `bench [NAME]...`, with `SECONDS`, `REPEAT` and `PRIORITY` from the environment.

use std::error::Error;

use whirlstand_nodes::bench::{Options, run, run_member};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|a| a == "--member") {
        println!("{}", run_member(&serde_json::from_reader(std::io::stdin())?)?);
        return Ok(());
    }
    let number = |name: &str, default: f64| -> Result<f64, Box<dyn Error>> {
        Ok(std::env::var(name).map_or(Ok(default), |v| v.parse())?)
    };
    let seconds = number("SECONDS", 2.0)?;
    let priority = number("PRIORITY", 0.0)? as u8;
    let options = Options {
        what: arguments,
        seconds,
        repeat: number("REPEAT", 3.0)? as u32,
        realtime_seconds: seconds,
        priority: (priority > 0).then_some(priority),
        cpus: std::env::var("CPUS").unwrap_or_default().split(',').filter_map(|c| c.parse().ok()).collect(),
        member: vec![std::env::current_exe()?.to_string_lossy().into_owned(), "--member".into()],
        run: vec!["whirlstand".into(), "run".into()],
    };
    run(&options, |f| {
        let verdict = f.goal.map_or(String::new(), |g| format!("  goal {} met: {}", g.limit, g.met));
        println!("{:<60} {:>14.2} {:<8}{verdict} {:?}", f.name, f.value, f.unit, f.all);
    })?;
    Ok(())
}
