//! Trials as processes. Diagnosis gets a folder with a record and a vehicle file; the answer is stored elsewhere.

use std::fs::File;
use std::io::Write;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use sha2::{Digest, Sha256};
use signal_hook::consts::SIGTERM;
use wait_timeout::ChildExt;
use whirlstand_blind::{Diagnosis, Plan, Scored, Setting, Trial};

use crate::cli::BlindRunArgs;
use crate::error::Failure;
use crate::supervisor::Signals;

/// Longest time that one diagnosis may take.
const DIAGNOSIS_TIMEOUT: Duration = Duration::from_secs(300);

/// Time between two checks whether to end.
const GLANCE: Duration = Duration::from_millis(50);

/// Runs the trials.
pub(super) struct TrialRunner {
    program: PathBuf,
    /// Folder in which diagnosis works; it has a subfolder for each trial.
    open: PathBuf,
    /// Folder in which the answers are stored.
    sealed: PathBuf,
    /// One line for each trial, written before its diagnosis runs.
    seals: Option<Mutex<File>>,
    /// Prints each seal on standard error before its diagnosis runs.
    aloud: bool,
    keep_all: bool,
    keep_failures: bool,
    /// Gives each diagnosis one thread, for when several run at once.
    single_threaded: bool,
    /// Drops the trials that have begun.
    hurry: AtomicBool,
    /// Removed with all of its contents when the runner is dropped.
    _temporary: Option<tempfile::TempDir>,
}

impl TrialRunner {
    pub fn new(args: &BlindRunArgs, jobs: usize) -> Result<Self, Failure> {
        let program = match &args.program {
            Some(program) => {
                std::path::absolute(program).map_err(|e| Failure::file("find the program", program, &e))?
            }
            None => std::env::current_exe()
                .map_err(|e| Failure::Run(format!("the path of this executable is unknown: {e}")))?,
        };
        let wanted = args.keep.as_ref().or(args.out.as_ref());
        let (root, temporary) = match wanted {
            Some(folder) => {
                let root =
                    std::path::absolute(folder).map_err(|e| Failure::file("use the folder", folder, &e))?;
                (root, None)
            }
            None => {
                let folder = tempfile::tempdir()
                    .map_err(|e| Failure::Run(format!("cannot create a folder for the trials: {e}")))?;
                (folder.path().to_path_buf(), Some(folder))
            }
        };
        let (open, sealed) = (root.join("trials"), root.join("sealed"));
        for folder in [&open, &sealed] {
            std::fs::create_dir_all(folder).map_err(|e| Failure::file("make the folder", folder, &e))?;
        }
        let seals = wanted
            .map(|_| {
                let path = root.join("seals.txt");
                File::create(&path).map_err(|e| Failure::file("write", &path, &e)).map(Mutex::new)
            })
            .transpose()?;
        Ok(Self {
            program,
            open,
            sealed,
            seals,
            aloud: args.only.is_some(),
            keep_all: args.keep.is_some(),
            keep_failures: args.out.is_some(),
            single_threaded: jobs > 1,
            hurry: AtomicBool::new(false),
            _temporary: temporary,
        })
    }

    /// Runs all plans, `jobs` at a time, until a signal arrives. After the first SIGINT the trials that have begun
    /// are finished; after SIGTERM or a second signal they are dropped. Returns the trials, and how many plans
    /// could not be drawn.
    pub fn run(
        &self,
        plans: &[Plan],
        setting: &Setting,
        jobs: usize,
        bar: &ProgressBar,
        signals: &mut Signals,
    ) -> Result<(Vec<Scored>, usize), Failure> {
        let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
        let trials = Mutex::new((Vec::new(), 0usize, 0usize));
        let worker = || -> Result<(), Failure> {
            while let Some(plan) = plans.get(next.fetch_add(1, Ordering::Relaxed)) {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                let scored = self.trial(plan, setting).inspect_err(|_| {
                    // The other threads need not begin another trial.
                    next.store(plans.len(), Ordering::Relaxed);
                })?;
                if self.hurry.load(Ordering::Relaxed) {
                    break;
                }
                let mut all = trials.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                match scored {
                    Some(scored) => {
                        all.2 += usize::from(!scored.is_good());
                        all.0.push(scored);
                    }
                    None => all.1 += 1,
                }
                bar.inc(1);
                bar.set_message(format!("{} not answered correctly", all.2));
            }
            Ok(())
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..jobs).map(|_| scope.spawn(worker)).collect();
            while workers.iter().any(|worker| !worker.is_finished()) {
                signals.wait(GLANCE).map_err(Failure::run)?;
                while let Some(signal) = signals.next() {
                    let again = stop.swap(true, Ordering::Relaxed);
                    self.hurry.fetch_or(again || signal == SIGTERM, Ordering::Relaxed);
                }
            }
            workers.into_iter().try_for_each(|w| match w.join() {
                Ok(result) => result,
                Err(panic) => std::panic::resume_unwind(panic),
            })
        })?;
        let (trials, skipped, _) = trials.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        Ok((trials, skipped))
    }

    fn trial(&self, plan: &Plan, setting: &Setting) -> Result<Option<Scored>, Failure> {
        let Some(trial) = Trial::draw(plan, setting).map_err(Failure::mend)? else { return Ok(None) };
        let answer = trial.answer_json();
        let seal = seal(&answer);
        let folder = self.open.join(plan.number.to_string());
        let sealed = self.sealed.join(format!("{}.json", plan.number));
        super::write(&folder.join("trial.csv"), &trial.csv())?;
        super::write(&folder.join("nominal.toml"), trial.vehicle_file())?;
        super::write(&sealed, &answer)?;
        if let Some(file) = &self.seals {
            let mut file = file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            writeln!(file, "{} {seal}", plan.number)
                .map_err(|e| Failure::Run(format!("cannot write the list of seals: {e}")))?;
        }
        if self.aloud {
            crate::style::say(&format!("trial {}, its answer sealed with SHA-256 {seal}", plan.number));
        }
        let start = Instant::now();
        let diagnosis = self.diagnose(&folder)?;
        let seconds = start.elapsed().as_secs_f64();
        let scored = match diagnosis {
            Ok(diagnosis) => Scored::new(&trial, &diagnosis, seal, seconds).map_err(Failure::run)?,
            Err(reason) => Scored::failed(&trial, seal, reason, seconds),
        };
        let good = scored.is_good();
        if !(self.keep_all || self.keep_failures && !good) {
            // A file that cannot be removed now is removed with the whole folder, or stays in a folder that
            // the user named.
            let _ = std::fs::remove_dir_all(&folder);
            let _ = std::fs::remove_file(&sealed);
        }
        Ok(Some(scored))
    }

    /// The diagnosis, or the reason why there is none.
    fn diagnose(&self, folder: &Path) -> Result<Result<Diagnosis, String>, Failure> {
        let said = folder.join("stderr.txt");
        let words = File::create(&said).map_err(|e| Failure::file("write", &said, &e))?;
        let mut command = Command::new(&self.program);
        command
            .args(["diagnose", "trial.csv", "--vehicle", "nominal.toml", "--json", "diagnosis.json"])
            .current_dir(folder)
            .env("NO_COLOR", "1")
            // Ctrl-C on a terminal is meant for the whole run, which finishes the trials that have begun.
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(words);
        if self.single_threaded {
            command.env("RAYON_NUM_THREADS", "1");
        }
        let mut child = command
            .spawn()
            .map_err(|e| Failure::Run(format!("{} cannot be started: {e}", self.program.display())))?;
        let until = Instant::now() + DIAGNOSIS_TIMEOUT;
        let status = loop {
            let status = child.wait_timeout(GLANCE).map_err(Failure::run)?;
            if status.is_some() || self.hurry.load(Ordering::Relaxed) || Instant::now() >= until {
                break status;
            }
        };
        let Some(status) = status else {
            // The process may have ended by itself in between; either way it is reaped here.
            let _ = child.kill();
            let _ = child.wait();
            return Ok(Err(format!("no diagnosis within {} s", DIAGNOSIS_TIMEOUT.as_secs())));
        };
        let path = folder.join("diagnosis.json");
        let words = || {
            let all = std::fs::read_to_string(&said).unwrap_or_default();
            all.lines().find(|l| !l.trim().is_empty()).unwrap_or("no message").to_string()
        };
        Ok(match std::fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text).map_err(|e| format!("its JSON cannot be parsed: {e}")),
            Err(_) => Err(format!("no diagnosis ({status}): {}", words())),
        })
    }
}

/// SHA-256 in hexadecimal.
fn seal(text: &str) -> String {
    Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}
