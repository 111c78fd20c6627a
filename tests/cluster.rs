//! Campaigns on a cluster: the parts of a campaign are flown by a real Slurm on this machine with three emulated nodes,
//! and by two workers of HyperQueue.

use std::cell::RefCell;
use std::collections::HashSet;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::support::{Finished, Running, run, spawn, until};
use whirlstand_test_harness::{Missing, Outcome};

/// Longest time for Slurm to start, and for an array of tasks to be flown, on a loaded machine.
const LONGEST: Duration = Duration::from_secs(240);

const CAMPAIGN: &str = r#"
launch = "quadrotor"
flights = 1500
method = "sobol"
seed = 3
set = ["duration_s=60"]

[[vary]]
key = "effects.0.magnitude"
uniform = ["100 deg/s^2", "400 deg/s^2"]

[[vary]]
key = "seed"
integers = [1, 1000000]
"#;

/// The daemons of a cluster, which are ended together with it.
struct Slurm {
    folder: PathBuf,
    /// Tasks whose delay was shortened.
    hurried: RefCell<HashSet<String>>,
    _daemons: Vec<Running>,
}

impl Slurm {
    fn start(folder: &Path) -> Result<Self, Missing> {
        let remedy = "Debian has them as slurm-wlm and munge";
        for program in ["munged", "slurmctld", "slurmd", "sbatch", "sinfo", "squeue", "scontrol"] {
            let known = Command::new("sh").args(["-c", &format!("command -v {program}")]).output();
            if !known.is_ok_and(|found| found.status.success()) {
                return Err(Missing::installable(format!("no {program}"), remedy));
            }
        }
        if !is_root() {
            return Err(Missing::beyond_this_machine("no right to start Slurm", "its daemons run as root"));
        }
        let host = Command::new("hostname").arg("-s").output().map(|o| o.stdout).unwrap_or_default();
        let host = String::from_utf8_lossy(&host).trim().to_string();
        let free: Vec<TcpListener> = (0..4).map(|_| TcpListener::bind("127.0.0.1:0").unwrap()).collect();
        let ports: Vec<u16> = free.iter().map(|l| l.local_addr().unwrap().port()).collect();
        drop(free);
        std::fs::write(folder.join("slurm.conf"), configuration(folder, &host, &ports)).unwrap();
        let key: Vec<u8> = (0..1024u32).map(|i| (i * 197 + std::process::id()) as u8).collect();
        std::fs::write(folder.join("munge.key"), key).unwrap();
        let private = std::os::unix::fs::PermissionsExt::from_mode(0o400);
        std::fs::set_permissions(folder.join("munge.key"), private).unwrap();
        let at = |name: &str| folder.join(name).display().to_string();
        let mut munged = Command::new("munged");
        munged.args(["--foreground", "--force"]);
        for (option, file) in [
            ("key-file", "munge.key"),
            ("socket", "munge.sock"),
            ("pid-file", "munged.pid"),
            ("log-file", "munged.log"),
        ] {
            munged.arg(format!("--{option}={}", at(file)));
        }
        munged.arg(format!("--seed-file={}", at("munge.seed")));
        let mut slurm =
            Self { folder: folder.into(), hurried: RefCell::default(), _daemons: vec![spawn(munged)] };
        slurm.until("munged listens", || folder.join("munge.sock").exists());
        slurm._daemons.push(spawn(slurm.command("slurmctld", &["-D"])));
        for node in ["n1", "n2", "n3"] {
            std::fs::create_dir(folder.join(format!("spool-{node}"))).unwrap();
            slurm._daemons.push(spawn(slurm.command("slurmd", &["-D", "-N", node])));
        }
        slurm.until("three nodes are idle", || {
            slurm.said("sinfo", &["-h", "-N", "-o", "%T"]).lines().filter(|state| *state == "idle").count()
                == 3
        });
        Ok(slurm)
    }

    fn command(&self, program: &str, args: &[&str]) -> Command {
        let mut command = Command::new(program);
        command.args(args).env("SLURM_CONF", self.folder.join("slurm.conf")).current_dir(&self.folder);
        command
    }

    fn said(&self, program: &str, args: &[&str]) -> String {
        let output = self.command(program, args).stderr(Stdio::null()).output();
        output.map(|o| String::from_utf8_lossy(&o.stdout).into_owned()).unwrap_or_default()
    }

    /// Polls until the condition holds; on a timeout the log of the daemons is reported.
    fn until(&self, what: &str, is: impl Fn() -> bool) {
        let start = Instant::now();
        while !is() {
            if start.elapsed() > LONGEST {
                let log = std::fs::read_to_string(self.folder.join("slurmctld.log")).unwrap_or_default();
                panic!("within {LONGEST:?} it does not come that {what}:\n{log}");
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Slurm delays a requeued task by two minutes, so that its node has forgotten the task before: of one that starts
    /// within the same second, the node takes the credential for one that was revoked. This makes it seconds.
    fn hurry(&self) {
        for job in self.said("squeue", &["-h", "-r", "-t", "PD", "-o", "%i"]).split_whitespace() {
            if self.hurried.borrow_mut().insert(job.into()) {
                self.said("scontrol", &["update", &format!("JobId={job}"), "StartTime=now+5"]);
            }
        }
    }

    /// Waits for all tasks of a submitted array.
    fn submit(&self, args: &[&str]) -> Running {
        spawn(self.command("sbatch", &[&["--wait"], args].concat()))
    }
}

fn configuration(folder: &Path, host: &str, ports: &[u16]) -> String {
    let at = folder.display();
    let nodes: String = ["n1", "n2", "n3"]
        .iter()
        .zip(&ports[1..])
        .map(|(node, port)| {
            format!("NodeName={node} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=1\n")
        })
        .collect();
    format!(
        "ClusterName=whirlstand{port}\nSlurmctldHost={host}(127.0.0.1)\nSlurmctldPort={port}\nSlurmUser=root\n\
         SlurmdUser=root\nAuthType=auth/munge\nCredType=cred/munge\nAuthInfo=socket={at}/munge.sock\n\
         StateSaveLocation={at}/state\nSlurmdSpoolDir={at}/spool-%n\nSlurmctldPidFile={at}/slurmctld.pid\n\
         SlurmdPidFile={at}/slurmd-%n.pid\nSlurmctldLogFile={at}/slurmctld.log\nSlurmdLogFile={at}/slurmd-%n.log\n\
         ProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nSwitchType=switch/none\nMpiDefault=none\n\
         SelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\nSlurmdParameters=config_overrides\n\
         ReturnToService=2\nJobRequeue=1\n{nodes}PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP\n",
        port = ports[0],
    )
}

/// Slurm's daemons change their user and must run as root for that.
fn is_root() -> bool {
    std::fs::metadata("/proc/self").is_ok_and(|own| std::os::unix::fs::MetadataExt::uid(&own) == 0)
}

/// The process of a part, once it has kept some flights.
fn pid_of(part: &str, out: &Path) -> Option<i32> {
    let journal = out.join(format!("part-{}.jsonl", part.replace('/', "-of-")));
    let kept = std::fs::read_to_string(journal).map_or(0, |text| text.lines().count());
    let own = |process: &std::fs::DirEntry| {
        let words = std::fs::read(process.path().join("cmdline")).unwrap_or_default();
        let words: Vec<&[u8]> = words.split(|byte| *byte == 0).collect();
        let is = |word: &str| words.contains(&word.as_bytes());
        // The task's shell has the whole command in one argument.
        is("campaign") && is(part) && is(&out.display().to_string())
    };
    let mut processes = std::fs::read_dir("/proc").ok()?.filter_map(Result::ok).filter(|_| kept > 2);
    processes.find(own)?.file_name().to_str()?.parse().ok()
}

fn a_killed_task_is_run_again_by_slurm_and_the_parts_join_to_the_bytes_of_the_whole() -> Outcome {
    let dir = tempfile::tempdir().unwrap();
    // Slurm's daemons check whether other users may write to the location of their folders.
    let at = |name: &str| dir.path().join(name);
    std::fs::write(at("gusts.toml"), CAMPAIGN).unwrap();
    let file = at("gusts.toml").display().to_string();
    let slurm = Slurm::start(dir.path())?;
    let out = at("parts");
    let task = format!(
        "{program} campaign {file} --out {out} --jobs 1 --shard $SLURM_ARRAY_TASK_ID/3 --resume && exit\n\
         status=$?\n[ $status -lt 128 ] || scontrol requeue ${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID\nexit $status",
        program = env!("CARGO_BIN_EXE_whirlstand"),
        out = out.display(),
    );
    let mut array = slurm.submit(&[
        "--array=1-3",
        "--requeue",
        "-o",
        "task-%a.txt",
        "--open-mode=append",
        "--wrap",
        &task,
    ]);
    kill_second(&mut array, &out, || told(&slurm));
    let part = |n: u32| out.join(format!("part-{n}-of-3.parquet"));
    slurm.until("all parts are there", || {
        slurm.hurry();
        (1..=3).all(|n| part(n).exists())
    });
    let log = told(&slurm);
    assert!(log.contains("Requeuing JobId=1_2"), "{log}");
    drop(array);

    assert_joined_to_the_whole(dir.path(), &out);
    Ok(())
}

fn a_killed_task_of_hyperqueue_goes_on_and_the_parts_join_to_the_bytes_of_the_whole() -> Outcome {
    let python = whirlstand_test_harness::python_with("hyperqueue")?;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("gusts.toml"), dir.path().join("parts"));
    std::fs::write(&file, CAMPAIGN).unwrap();
    std::fs::create_dir(&out).unwrap();
    let mut engine = Command::new(python);
    engine.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cluster/parts.py"));
    engine.args([Path::new(env!("CARGO_BIN_EXE_whirlstand")), file.as_path(), out.as_path()]).arg("3");
    let mut engine = spawn(engine);
    let said = || {
        let tasks = ["task-1.err", "task-2.err", "task-3.err"];
        tasks.map(|name| std::fs::read_to_string(out.join(name)).unwrap_or_default()).join("\n")
    };
    kill_second(&mut engine, &out, said);
    let ended = engine.finish_within(LONGEST);
    assert_eq!(ended.code(), 0, "{}\n{}", ended.stderr, said());
    let again = std::fs::read_to_string(out.join("task-2.txt")).unwrap();
    assert!(again.contains("started again"), "{again}");
    assert_joined_to_the_whole(dir.path(), &out);
    Ok(())
}

/// Kills the task of part 2 of 3 once it has kept some flights.
fn kill_second(engine: &mut Running, out: &Path, said: impl Fn() -> String) {
    let mut second = None;
    until("part 2 did not keep a flight", || {
        second = pid_of("2/3", out);
        second.is_some() || !engine.is_alive()
    });
    kill(second.unwrap_or_else(|| panic!("part 2 was over before it was seen: {}", said())));
}

/// The three parts in `out` join to the bytes of the campaign `gusts.toml` in `dir` that is flown in one piece.
fn assert_joined_to_the_whole(dir: &Path, out: &Path) {
    let at = |name: &str| dir.join(name).display().to_string();
    let flown = |args: &[&str]| -> Finished { run([&["campaign"], args].concat()).success() };
    flown(&[&at("gusts.toml"), "--out", &at("whole")]);
    let part = |n: u32| out.join(format!("part-{n}-of-3.parquet")).display().to_string();
    flown(&["merge", &part(2), &part(1), &part(3), "--out", &at("joined")]);
    let bytes = |folder: &str| std::fs::read(dir.join(folder).join("flights.parquet")).unwrap();
    assert!(bytes("whole") == bytes("joined"), "the table differs");
}

fn kill(pid: i32) {
    // SAFETY: sends a signal, touches no memory.
    unsafe { libc::kill(pid, libc::SIGKILL) };
}

/// Output of Slurm's controller and of the tasks.
fn told(slurm: &Slurm) -> String {
    ["slurmctld.log", "task-1.txt", "task-2.txt", "task-3.txt"]
        .map(|name| std::fs::read_to_string(slurm.folder.join(name)).unwrap_or_default())
        .join("\n")
}

whirlstand_test_harness::listed!(
    a_killed_task_is_run_again_by_slurm_and_the_parts_join_to_the_bytes_of_the_whole,
    a_killed_task_of_hyperqueue_goes_on_and_the_parts_join_to_the_bytes_of_the_whole,
);
