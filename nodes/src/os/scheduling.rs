//! Priority, CPU affinity and locked memory.

use std::io;

use crate::config::RealtimeOptions;

/// Reason why the operating system refused a real-time option, with the remedy.
#[derive(Debug, thiserror::Error)]
pub enum RealtimeError {
    /// `sched_setscheduler` refused.
    #[error(
        "SCHED_FIFO priority {priority} was refused ({source}). Allow it with `ulimit -r {priority}` (a line \
         `@realtime - rtprio 99` in /etc/security/limits.conf and membership of that group), with \
         `LimitRTPRIO=` under systemd, or with the capability CAP_SYS_NICE; or take `priority` out of the \
         launch file"
    )]
    Priority {
        /// Requested priority.
        priority: u8,
        /// The system's answer.
        source: io::Error,
    },
    /// The priority is out of the range of SCHED_FIFO.
    #[error("priority = {0} is outside 1 to 99, the priorities of SCHED_FIFO")]
    PriorityRange(u8),
    /// `sched_setaffinity` refused.
    #[error(
        "CPU affinity {cpus:?} was refused ({source}). This process may use the CPUs {allowed:?}: change `cpus` \
         in the launch file, or the cpuset of the container or service"
    )]
    Affinity {
        /// Requested CPUs.
        cpus: Vec<usize>,
        /// CPUs that the process may use.
        allowed: Vec<usize>,
        /// The system's answer.
        source: io::Error,
    },
    /// `mlockall` refused.
    #[error(
        "locking memory was refused ({source}); the limit is {limit}. Raise it with `ulimit -l unlimited` (a \
         line `@realtime - memlock unlimited` in /etc/security/limits.conf), with `LimitMEMLOCK=infinity` \
         under systemd, or with the capability CAP_IPC_LOCK; or take `lock_memory` out of the launch file"
    )]
    LockMemory {
        /// RLIMIT_MEMLOCK as text.
        limit: String,
        /// The system's answer.
        source: io::Error,
    },
}

/// Applies the options to the calling thread, and memory locking to the process. Call it after the bus is
/// open: running threads keep their scheduling.
///
/// # Errors
/// [`RealtimeError`] for the first option that the system refuses.
pub fn apply_realtime(options: &RealtimeOptions) -> Result<(), RealtimeError> {
    if !options.cpus.is_empty() {
        set_affinity(&options.cpus).map_err(|source| RealtimeError::Affinity {
            cpus: options.cpus.clone(),
            allowed: available_cpus(),
            source,
        })?;
    }
    if options.lock_memory {
        // SAFETY: mlockall takes no pointer.
        let status = unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) };
        if status != 0 {
            return Err(RealtimeError::LockMemory {
                source: io::Error::last_os_error(),
                limit: memory_limit(),
            });
        }
    }
    if let Some(priority) = options.priority {
        if !(1..=99).contains(&priority) {
            return Err(RealtimeError::PriorityRange(priority));
        }
        let parameters = libc::sched_param { sched_priority: i32::from(priority) };
        // SAFETY: `parameters` is a valid sched_param; 0 is the calling thread.
        let status = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
        if status != 0 {
            return Err(RealtimeError::Priority { priority, source: io::Error::last_os_error() });
        }
    }
    Ok(())
}

fn set_affinity(cpus: &[usize]) -> io::Result<()> {
    // SAFETY: a zeroed cpu_set_t is the empty set.
    let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    for &cpu in cpus {
        if cpu >= libc::CPU_SETSIZE as usize {
            return Err(io::Error::from_raw_os_error(libc::EINVAL));
        }
        // SAFETY: `cpu` is below CPU_SETSIZE, checked above.
        unsafe { libc::CPU_SET(cpu, &mut set) };
    }
    // SAFETY: `set` is a valid cpu_set_t of the size given; 0 is the calling thread.
    let status = unsafe { libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set) };
    if status == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// CPUs that the calling thread may run on.
pub(crate) fn available_cpus() -> Vec<usize> {
    // SAFETY: a zeroed cpu_set_t is the empty set.
    let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: `set` is a valid cpu_set_t of the size given, to write to; 0 is the calling thread.
    unsafe { libc::sched_getaffinity(0, size_of::<libc::cpu_set_t>(), &raw mut set) };
    // SAFETY: every index is below CPU_SETSIZE.
    (0..libc::CPU_SETSIZE as usize).filter(|&cpu| unsafe { libc::CPU_ISSET(cpu, &set) }).collect()
}

fn memory_limit() -> String {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: `limit` is a valid rlimit to write to.
    let status = unsafe { libc::getrlimit(libc::RLIMIT_MEMLOCK, &raw mut limit) };
    match (status, limit.rlim_cur) {
        (0, libc::RLIM_INFINITY) => "unlimited".into(),
        (0, bytes) => format!("{} KiB", bytes / 1024),
        _ => "unknown".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_say_what_to_change() {
        let e = apply_realtime(&RealtimeOptions { priority: Some(0), ..Default::default() }).unwrap_err();
        assert!(e.to_string().contains("1 to 99"), "{e}");
        let e = apply_realtime(&RealtimeOptions { cpus: vec![1023], ..Default::default() }).unwrap_err();
        assert!(e.to_string().contains("`cpus`"), "{e}");
        let e = apply_realtime(&RealtimeOptions { cpus: vec![5000], ..Default::default() }).unwrap_err();
        assert!(matches!(e, RealtimeError::Affinity { ref allowed, .. } if !allowed.is_empty()), "{e}");
    }

    #[test]
    fn a_thread_can_be_put_on_one_cpu() {
        std::thread::spawn(|| {
            let cpu = available_cpus()[0];
            apply_realtime(&RealtimeOptions { cpus: vec![cpu], ..Default::default() }).unwrap();
            assert_eq!(available_cpus(), [cpu]);
        })
        .join()
        .unwrap();
    }
}
