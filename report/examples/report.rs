//! Makes the report of logs that were recorded before: `cargo run --release -p whirlstand-ident --example report --
//! OUT.html LOG...`, one variant a log.

use std::path::Path;

use whirlstand_evaluate::Run;
use whirlstand_report::{Outcome, run_report};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().ok_or("say where the report goes: OUT.html LOG...")?;
    let runs = arguments
        .map(|log| {
            let path = Path::new(&log);
            let folder = if path.is_file() { path.parent().unwrap_or(path) } else { path };
            let name = folder.file_name().map_or(log.clone(), |n| n.to_string_lossy().into_owned());
            Run::open(path, &name, None)
        })
        .collect::<Result<Vec<_>, _>>()?;
    let first = runs.first().ok_or("name at least one log: OUT.html LOG...")?;
    let outcome = Outcome { verdict: "Made from logs.".into(), ..Outcome::default() };
    let html = run_report(&first.info.launch, "", &outcome, &runs.iter().collect::<Vec<_>>())?;
    std::fs::write(&out, html)?;
    Ok(())
}
