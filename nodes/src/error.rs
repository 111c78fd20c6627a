//! Errors of a node.

use whirlstand_bridge::vehicle::Figures;

use crate::config::Role;
use crate::os::RealtimeError;

/// Reason why a node could not start or continue.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The vehicle file is invalid, or an effect does not fit the vehicle.
    #[error("vehicle {origin}: {reason}")]
    Vehicle {
        /// File name or built-in name.
        origin: String,
        /// What is wrong.
        reason: String,
    },
    /// The vehicle is valid, but exceeds the messages of the bus.
    #[error("vehicle {vehicle} cannot fly on a bench: {reason}")]
    NotOnBus {
        /// Vehicle name.
        vehicle: String,
        /// What exceeds the messages, and their limits.
        reason: String,
    },
    /// A value of the configuration is invalid.
    #[error("{field} = {value} cannot be used: {reason}")]
    Config {
        /// Key in the launch file.
        field: String,
        /// Value.
        value: String,
        /// What is wrong, and what would be valid.
        reason: String,
    },
    /// No controller or filter can be designed for this vehicle with these options.
    #[error("{what} cannot be designed for vehicle {vehicle}: {reason}")]
    Design {
        /// `controller` or `estimator`, with its kind.
        what: String,
        /// Vehicle name.
        vehicle: String,
        /// Error of the design.
        reason: String,
    },
    /// The bus or a port cannot be opened.
    #[error(transparent)]
    Open(#[from] whirlstand_bus::OpenError),
    /// A message cannot be sent.
    #[error(transparent)]
    Send(#[from] whirlstand_bus::SendError),
    /// The transport failed while receiving.
    #[error(transparent)]
    Receive(#[from] whirlstand_bus::RecvError),
    /// A peer was not heard from, or did not come to run.
    #[error(
        "the plant waited {waited_s} s for {}, which did not start or stands still; check that it runs on this bench",
        missing.iter().map(|r| r.name()).collect::<Vec<_>>().join(" and ")
    )]
    PeersAbsent {
        /// Roles of the missing peers.
        missing: Vec<Role>,
        /// Waiting time of the plant, s.
        waited_s: f64,
    },
    /// The last part of the log could not be written.
    #[error("the log lacks its end: {0}")]
    LogEndMissing(whirlstand_logs::Hole),
    /// The first measurement was never answered.
    #[error(
        "no usable command arrived for step 0 within {waited_s} s ({rejected} were refused): the chain from imu over \
         estimate to command is broken"
    )]
    NoAnswer {
        /// Waiting time of the plant, s.
        waited_s: f64,
        /// Number of refused commands.
        rejected: u64,
    },
    /// The simulated vehicle left the range of validity of its model.
    #[error(
        "{vehicle} left its model at step {step} ({time_s:.3} s): {state} is {value:.4e}, its bound is {bound:.4e} (SI; \
         `bound` of the state in the vehicle file sets another). The run ends here"
    )]
    Diverged {
        /// Name of the vehicle.
        vehicle: String,
        /// Name of the state.
        state: String,
        /// Value of the state, SI; NaN where the step had no result.
        value: f64,
        /// Bound of the state, SI.
        bound: f64,
        /// Step number.
        step: u64,
        /// Time of the step, s.
        time_s: f64,
    },
    /// The vehicle behind a bridge was never heard from.
    #[error(
        "no attitude arrived from the vehicle within {waited_s} s ({bytes} bytes and {messages} messages did, {signature} \
         more were refused for their signature): {}", advice(*messages, *signature)
    )]
    NoVehicle {
        /// Waiting time of the bridge, s.
        waited_s: f64,
        /// Number of bytes received.
        bytes: u64,
        /// Number of messages received.
        messages: u64,
        /// Number of messages refused for their signature.
        signature: u64,
    },
    /// The autopilot behind a bridge was never heard from.
    #[error(
        "{name} sent no outputs within {waited_s} s ({malformed} bytes or packets were invalid): check that it runs, that host, port and baud rate are right, and that nothing else uses the port"
    )]
    NoAutopilot {
        /// Name of the autopilot.
        name: &'static str,
        /// Waiting time of the bridge, s.
        waited_s: f64,
        /// Number of bytes or packets that are not of its protocol.
        malformed: u64,
    },
    /// The autopilot behind a bridge was not armed.
    #[error("{name} was not armed within {waited_s} s{reason}")]
    NotArmed {
        /// Name of the autopilot.
        name: &'static str,
        /// Waiting time of the bridge, s.
        waited_s: f64,
        /// The reason as the autopilot reports it, or where to find it; with its punctuation.
        reason: String,
    },
    /// The operating system refused a real-time option.
    #[error(transparent)]
    Realtime(#[from] RealtimeError),
    /// The launcher cannot be notified, or signal handlers cannot be installed.
    #[error("cannot {action}: {source}")]
    System {
        /// Attempted action.
        action: &'static str,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The log cannot be written.
    #[error(transparent)]
    Log(#[from] whirlstand_logs::WriteError),
}

impl NodeError {
    /// Error for an autopilot that was never armed; `said` is the reason that it reported, and `advice` where to
    /// find one.
    pub(crate) fn not_armed(name: &'static str, waited_s: f64, said: Option<&str>, advice: &str) -> Self {
        let reason = match said {
            Some(words) => format!(": {words}"),
            None => format!(", and has not said why: {advice}"),
        };
        Self::NotArmed { name, waited_s, reason }
    }

    /// Error for a vehicle whose attitude never arrived.
    pub(crate) fn no_vehicle(waited_s: f64, figures: &Figures) -> Self {
        let Figures { bytes, messages, signature, .. } = *figures;
        Self::NoVehicle { waited_s, bytes, messages, signature }
    }

    /// True when the user can correct it by other input: a launch file, a vehicle file, an option, a system
    /// setting.
    pub fn is_mendable(&self) -> bool {
        matches!(
            self,
            Self::Vehicle { .. }
                | Self::NotOnBus { .. }
                | Self::Config { .. }
                | Self::Design { .. }
                | Self::Open(_)
                | Self::Realtime(_)
        )
    }
}

/// Advice when no attitude arrived.
fn advice(messages: u64, signature: u64) -> &'static str {
    if signature > messages {
        "check that bridge.mavlink.signing_key is the key that the vehicle signs with"
    } else {
        "check that it is powered, that the link, its baud rate and its direction are right, and that it sends its attitude"
    }
}
