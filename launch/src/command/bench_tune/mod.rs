//! `whirlstand bench tune`: measures the benefit of tuning from one record, on a vehicle whose true model is
//! known.

mod answer;
mod cell;
mod cells;
mod processes;
mod table;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use self::answer::{Answer, Cell};
use self::cells::{Scene, wanted};
use self::processes::Processes;
use self::table::Tally;
use super::{INTERRUPTED, print, tell, write};
use crate::cli::{BenchTuneArgs, ModeArg};
use crate::error::Failure;

/// Runs the command. The exit code is 1 when a goal is missed and 130 when the command was interrupted; the
/// cells flown until then are kept.
pub(crate) fn bench_tune(args: &BenchTuneArgs) -> Result<ExitCode, Failure> {
    let scenes = wanted(&args.only)?;
    let journal = args.out.join("cells.jsonl");
    let processes = args.processes.map(|mode| Processes { mode, seeds: args.seeds });
    let mut cells = read(&journal)?;
    // Cells that were flown in another mode are excluded from this table.
    cells.retain(|cell| cell.processes.as_deref() == args.processes.map(ModeArg::word));
    if !args.table {
        for scene in &scenes {
            if cells.iter().any(|cell| cell.cell == scene.name()) {
                continue;
            }
            let Some(cell) = cell::fly(scene, args.draws, processes)? else {
                return Ok(ExitCode::from(INTERRUPTED));
            };
            append(&journal, &cell)?;
            if !args.json.is_printed() {
                print(&line(&cell))?;
            }
            cells.push(cell);
        }
    }
    let known: Vec<String> = scenes.iter().map(Scene::name).collect();
    write(&args.out.join("table.md"), &Tally::new(cells.clone()).text())?;
    cells.retain(|cell| known.contains(&cell.cell));
    let tally = Tally::new(cells);
    tell(&args.json, &tally, || tally.text())?;
    Ok(ExitCode::from(u8::from(!tally.is_met())))
}

fn line(cell: &Cell) -> String {
    let said = match &cell.result {
        Answer::Flown(outcome) if outcome.named.is_empty() => "nothing was named".into(),
        Answer::Flown(outcome) => outcome.named.join("; "),
        Answer::Failed(why) => why.clone(),
    };
    format!("{}  {said}  ({:.0} s)\n", cell.cell, cell.wall_s)
}

/// Reads the cells that earlier calls have flown.
fn read(path: &Path) -> Result<Vec<Cell>, Failure> {
    let text = match std::fs::read_to_string(path) {
        Ok(text) => text,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(e) => return Err(Failure::file("read", path, &e)),
    };
    let parse = |(number, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|e| {
            Failure::Mend(format!(
                "{}, line {}: a cell of this command is expected ({e}); delete that line to fly it again",
                path.display(),
                number + 1
            ))
        })
    };
    text.lines().enumerate().map(parse).collect()
}

/// Appends one cell to the file immediately.
fn append(path: &PathBuf, cell: &Cell) -> Result<(), Failure> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| Failure::file("make the folder", folder, &e))?;
    }
    let line = serde_json::to_string(cell).map_err(Failure::run)? + "\n";
    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
    file.and_then(|mut file| file.write_all(line.as_bytes())).map_err(|e| Failure::file("write", path, &e))
}
