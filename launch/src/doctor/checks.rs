//! The properties of a machine that decide whether it keeps deadlines, as the kernel reports them.

use std::path::Path;

use rustix::process::{Resource, getrlimit};
use whirlstand_nodes::config::RealtimeOptions;
use whirlstand_nodes::os::apply_realtime;

use super::check::{Check, Grade};

/// Priority at which SCHED_FIFO is tried.
pub(super) const TRIED_PRIORITY: u8 = 80;

/// Shared memory that is enough for several benches, MiB.
const ENOUGH_SHM_MIB: u64 = 256;

/// All checks, the most important first.
pub(super) fn all() -> Vec<Check> {
    vec![
        preemption(&first_line("/sys/kernel/realtime"), &kernel_version()),
        fifo(),
        throttling(&first_line("/proc/sys/kernel/sched_rt_runtime_us")),
        memlock(getrlimit(Resource::Memlock).current),
        governor(),
        cores(std::thread::available_parallelism().map_or(1, std::num::NonZero::get)),
        isolation(&first_line("/sys/devices/system/cpu/isolated"), &usable_cpus()),
        smt(&first_line("/sys/devices/system/cpu/smt/active")),
        clocksource(&first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource")),
        shared_memory(),
        virtualisation(&std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default()),
    ]
}

fn first_line(path: &str) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    Some(text.lines().next().unwrap_or("").trim().to_string())
}

fn kernel_version() -> String {
    let name = rustix::system::uname();
    format!("{} {}", name.release().to_string_lossy(), name.version().to_string_lossy())
}

fn check(name: &'static str, grade: Grade, found: impl Into<String>, advice: &str) -> Check {
    let advice = (grade == Grade::Warn && !advice.is_empty()).then(|| advice.to_string());
    Check { name, grade, found: found.into(), advice }
}

fn preemption(realtime: &Option<String>, version: &str) -> Check {
    let advice = "boot a PREEMPT_RT kernel (Debian: linux-image-rt-amd64; Ubuntu: linux-image-realtime) or at least \
                  add `preempt=full` to the kernel command line";
    let (grade, model) = if realtime.as_deref() == Some("1") || version.contains("PREEMPT_RT") {
        (Grade::Ok, "PREEMPT_RT")
    } else if version.contains("PREEMPT_DYNAMIC") {
        (Grade::Warn, "PREEMPT_DYNAMIC (not real-time)")
    } else if version.contains("PREEMPT") {
        (Grade::Warn, "PREEMPT (low latency, not real-time)")
    } else {
        (Grade::Warn, "voluntary or none")
    };
    check("kernel preemption", grade, format!("{model}; {version}"), advice)
}

/// Tries SCHED_FIFO on a separate thread, so that this process keeps its scheduling.
fn fifo() -> Check {
    let limit = getrlimit(Resource::Rtprio).current.unwrap_or(u64::MAX);
    let options = RealtimeOptions { priority: Some(TRIED_PRIORITY), ..Default::default() };
    let tried = std::thread::spawn(move || apply_realtime(&options).map_err(|e| e.to_string())).join();
    match tried {
        Ok(Ok(())) => {
            let found = format!("allowed (tried at priority {TRIED_PRIORITY}; RLIMIT_RTPRIO {limit})");
            check("SCHED_FIFO", Grade::Ok, found, "")
        }
        _ => check(
            "SCHED_FIFO",
            Grade::Warn,
            format!("refused at priority {TRIED_PRIORITY} (RLIMIT_RTPRIO {limit}, no CAP_SYS_NICE)"),
            "add `@realtime - rtprio 99` to /etc/security/limits.conf and yourself to that group, or give the container \
             CAP_SYS_NICE (docker: --cap-add sys_nice --ulimit rtprio=99)",
        ),
    }
}

fn throttling(runtime: &Option<String>) -> Check {
    let advice = "`sysctl kernel.sched_rt_runtime_us=-1` keeps the kernel from pausing a busy SCHED_FIFO node (a node \
                  that never sleeps can then take a whole CPU)";
    match runtime.as_deref() {
        Some("-1") => check("RT throttling", Grade::Ok, "off", ""),
        Some(us) => {
            check("RT throttling", Grade::Warn, format!("SCHED_FIFO may run {us} us per second"), advice)
        }
        None => check("RT throttling", Grade::Unknown, "not reported by this kernel", ""),
    }
}

fn memlock(limit: Option<u64>) -> Check {
    let advice = "lock_memory = true needs `ulimit -l unlimited`: add `@realtime - memlock unlimited` to \
                  /etc/security/limits.conf (docker: --ulimit memlock=-1)";
    match limit {
        None => check("locked memory", Grade::Ok, "unlimited", ""),
        Some(bytes) if bytes >= 1 << 30 => {
            check("locked memory", Grade::Ok, format!("{} MiB", bytes >> 20), "")
        }
        // A process with CAP_IPC_LOCK is not bound by the limit.
        Some(bytes) if has_capability(14) => check(
            "locked memory",
            Grade::Ok,
            format!("limit {} KiB, not binding (CAP_IPC_LOCK)", bytes >> 10),
            "",
        ),
        Some(bytes) => check("locked memory", Grade::Warn, format!("limit {} KiB", bytes >> 10), advice),
    }
}

/// Whether the capability of this number is in effect for this process.
fn has_capability(number: u32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|l| l.strip_prefix("CapEff:"));
    effective
        .and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok())
        .is_some_and(|set| set >> number & 1 == 1)
}

fn governor() -> Check {
    let cpus = std::fs::read_dir("/sys/devices/system/cpu").into_iter().flatten().flatten();
    let mut governors: Vec<String> =
        cpus.filter_map(|cpu| first_line(cpu.path().join("cpufreq/scaling_governor").to_str()?)).collect();
    governors.sort();
    governors.dedup();
    let advice =
        "`cpupower frequency-set -g performance` keeps the clock frequency from dropping between steps";
    match governors.as_slice() {
        [] => check(
            "CPU frequency",
            Grade::Unknown,
            "not under this system's control (fixed, or a virtual machine)",
            "",
        ),
        [one] if one == "performance" => check("CPU frequency", Grade::Ok, "governor performance", ""),
        some => check("CPU frequency", Grade::Warn, format!("governor {}", some.join(", ")), advice),
    }
}

fn cores(count: usize) -> Check {
    let advice = "plant, estimator and controller share too few cores; a step then waits for the scheduler: use a machine with \
                  4 cores or more, or lower the rate";
    let grade = if count >= 4 { Grade::Ok } else { Grade::Warn };
    check("cores", grade, format!("{count} usable"), advice)
}

/// CPUs that this process may use, by number.
fn usable_cpus() -> Vec<usize> {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let list = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
    list.map_or(Vec::new(), cpu_list)
}

/// Reads a list of CPUs as the kernel writes it, such as `0-3,8`.
fn cpu_list(text: &str) -> Vec<usize> {
    let range = |part: &str| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        Some(first.trim().parse().ok()?..=last.trim().parse().ok()?)
    };
    text.split(',').filter_map(range).flatten().collect()
}

/// Most CPUs that are isolated: the number of nodes in the loop.
const NODES_IN_THE_LOOP: usize = 3;

fn isolation(isolated: &Option<String>, usable: &[usize]) -> Check {
    match isolated.as_deref() {
        None => check("isolated CPUs", Grade::Unknown, "not reported by this kernel", ""),
        Some("") => check("isolated CPUs", Grade::Warn, "none", &isolation_advice(usable)),
        Some(list) => check("isolated CPUs", Grade::Ok, list, ""),
    }
}

/// Advice on isolation: the last half of the CPUs is left to the nodes, the first half serves the rest of the
/// system.
fn isolation_advice(usable: &[usize]) -> String {
    let count = (usable.len() / 2).min(NODES_IN_THE_LOOP);
    let names: Vec<_> = usable[usable.len() - count..].iter().map(usize::to_string).collect();
    match names.join(",") {
        list if list.is_empty() => {
            "no CPU can be reserved for the nodes: use a machine with 4 cores or more".into()
        }
        list => format!(
            "boot with `isolcpus={list} nohz_full={list} rcu_nocbs={list}` and give {} to the nodes with `cpus` in the launch file",
            if count == 1 { "it" } else { "those" }
        ),
    }
}

fn smt(active: &Option<String>) -> Check {
    match active.as_deref() {
        Some("0") => check("SMT", Grade::Ok, "off", ""),
        Some("1") => check(
            "SMT",
            Grade::Warn,
            "on: two threads share a core",
            "`echo off > /sys/devices/system/cpu/smt/control`, or leave the sibling of an isolated CPU idle",
        ),
        _ => check("SMT", Grade::Unknown, "not reported by this kernel", ""),
    }
}

fn clocksource(source: &Option<String>) -> Check {
    let advice = "a slow clock source costs microseconds each time the clock is read: boot with `tsc=reliable` if the CPU \
                  has a constant TSC";
    match source.as_deref() {
        Some(s @ ("tsc" | "kvm-clock" | "arch_sys_counter" | "hyperv_clocksource_tsc_page")) => {
            check("clock source", Grade::Ok, s, "")
        }
        Some(other) => check("clock source", Grade::Warn, other, advice),
        None => check("clock source", Grade::Unknown, "not reported by this kernel", ""),
    }
}

fn shared_memory() -> Check {
    let Ok(stat) = rustix::fs::statvfs(Path::new("/dev/shm")) else {
        return check(
            "shared memory",
            Grade::Warn,
            "/dev/shm is missing",
            "mount it: `mount -t tmpfs -o size=1g tmpfs /dev/shm`",
        );
    };
    let mib = |blocks: u64| (blocks * stat.f_frsize) >> 20;
    let (free, size) = (mib(stat.f_bavail), mib(stat.f_blocks));
    let grade = if free >= ENOUGH_SHM_MIB { Grade::Ok } else { Grade::Warn };
    check(
        "shared memory",
        grade,
        format!("/dev/shm has {free} MiB free of {size} MiB"),
        "several benches need more: `mount -o remount,size=1g /dev/shm` (docker: --shm-size 1g)",
    )
}

fn virtualisation(cpuinfo: &str) -> Check {
    let flags = cpuinfo.lines().find(|l| l.starts_with("flags") || l.starts_with("Features")).unwrap_or("");
    if flags.split_whitespace().any(|f| f == "hypervisor") {
        check(
            "virtual machine",
            Grade::Warn,
            "yes: the host may pause this machine at any time",
            "run on bare metal, or pin its virtual CPUs on the host",
        )
    } else {
        check("virtual machine", Grade::Ok, "none detected", "")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_are_told_apart() {
        let rt = preemption(&Some("1".into()), "6.12.0 #1 SMP PREEMPT_RT");
        assert_eq!((rt.grade, rt.advice), (Grade::Ok, None));
        let dynamic = preemption(&None, "6.12.0 #1 SMP PREEMPT_DYNAMIC");
        assert_eq!(dynamic.grade, Grade::Warn);
        assert!(dynamic.found.contains("PREEMPT_DYNAMIC") && dynamic.advice.unwrap().contains("PREEMPT_RT"));
    }

    #[test]
    fn only_cpus_that_are_there_are_to_be_isolated() {
        let advice = |cpus: &[usize]| isolation(&Some(String::new()), cpus).advice.unwrap();
        assert!(advice(&[0, 1]).starts_with("boot with `isolcpus=1 nohz_full=1 rcu_nocbs=1` and give it"));
        assert!(advice(&[0, 1, 2, 3]).contains("`isolcpus=2,3 "));
        assert!(advice(&(0..64).collect::<Vec<_>>()).contains("`isolcpus=61,62,63 "));
        assert!(advice(&[4, 6, 8]).contains("`isolcpus=8 "));
        assert!(advice(&[0]).contains("no CPU"));
        assert_eq!(cpu_list("\t0-2,8\n"), [0, 1, 2, 8]);
        assert!(!usable_cpus().is_empty());
    }

    #[test]
    fn a_warning_always_says_what_to_change() {
        for check in all() {
            assert_eq!(check.grade == Grade::Warn, check.advice.is_some(), "{check:?}");
            assert!(!check.found.is_empty(), "{check:?}");
        }
    }
}
