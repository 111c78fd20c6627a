//! Why a node ends before its time.

use whirlstand_bridge::vehicle::Figures;

use crate::config::Role;
use crate::os::RealtimeError;

/// Why a node could not start or go on.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The vehicle file is wrong, or an effect does not fit it.
    #[error("vehicle {origin}: {reason}")]
    Vehicle {
        /// File name or built-in name.
        origin: String,
        /// What is wrong.
        reason: String,
    },
    /// The vehicle is well-formed, but does not fit through the bus.
    #[error("vehicle {vehicle} cannot fly on a bench: {reason}")]
    NotOnBus {
        /// Vehicle name.
        vehicle: String,
        /// What does not fit, and what would.
        reason: String,
    },
    /// A value of the configuration is impossible.
    #[error("{field} = {value} cannot be used: {reason}")]
    Config {
        /// Key, as in the launch file.
        field: String,
        /// Value.
        value: String,
        /// What is wrong, and what would be right.
        reason: String,
    },
    /// No controller or filter can be made for this vehicle with these options.
    #[error("{what} cannot be designed for vehicle {vehicle}: {reason}")]
    Design {
        /// `controller` or `estimator`, with its kind.
        what: String,
        /// Vehicle name.
        vehicle: String,
        /// What the design says.
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
    /// A peer was never heard.
    #[error(
        "the plant waited {waited_s} s for {}, which did not start; check that they run on this bench",
        missing.iter().map(|r| r.name()).collect::<Vec<_>>().join(" and ")
    )]
    PeersAbsent {
        /// Roles that were not heard.
        missing: Vec<Role>,
        /// How long the plant waited, s.
        waited_s: f64,
    },
    /// The last part of the log could not be written.
    #[error("the log lacks its end: {0}")]
    LogEndMissing(whirlstand_logs::Hole),
    /// Nobody answered the first measurement.
    #[error(
        "no usable command arrived for step 0 within {waited_s} s ({rejected} were refused): the chain from imu over \
         estimate to command is broken"
    )]
    NoAnswer {
        /// How long the plant waited, s.
        waited_s: f64,
        /// Commands that came but were refused.
        rejected: u64,
    },
    /// The simulated vehicle left what its model is valid for.
    #[error(
        "{vehicle} left its model at step {step} ({time_s:.3} s): {state} is {value:.4e}, its bound is {bound:.4e} (SI; \
         `bound` of the state in the vehicle file sets another). The run ends here"
    )]
    Diverged {
        /// Name of the vehicle.
        vehicle: String,
        /// The state.
        state: String,
        /// Its value, SI; not a number where the step had no result.
        value: f64,
        /// Its bound, SI.
        bound: f64,
        /// The step.
        step: u64,
        /// Time of the step, s.
        time_s: f64,
    },
    /// The vehicle behind a bridge was never heard.
    #[error(
        "no attitude arrived from the vehicle within {waited_s} s ({bytes} bytes and {messages} messages did, {signature} \
         more were refused for their signature): {}", advice(*messages, *signature)
    )]
    NoVehicle {
        /// How long the bridge waited, s.
        waited_s: f64,
        /// Bytes that came.
        bytes: u64,
        /// Messages that came.
        messages: u64,
        /// Messages that were refused for their signature.
        signature: u64,
    },
    /// The autopilot behind a bridge was never heard.
    #[error(
        "{name} sent no outputs within {waited_s} s ({malformed} bytes or packets were invalid): check that it runs, that host, port and baud rate are right, and that nothing else uses the port"
    )]
    NoAutopilot {
        /// Name of the autopilot.
        name: &'static str,
        /// How long the bridge waited, s.
        waited_s: f64,
        /// Bytes or packets that are not of its protocol.
        malformed: u64,
    },
    /// The operating system refuses a real-time option.
    #[error(transparent)]
    Realtime(#[from] RealtimeError),
    /// The launcher cannot be told, or signals cannot be caught.
    #[error("cannot {action}: {source}")]
    System {
        /// What the node tried to do.
        action: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The log cannot be written.
    #[error(transparent)]
    Log(#[from] whirlstand_logs::WriteError),
}

impl NodeError {
    /// A vehicle whose attitude never came.
    pub(crate) fn no_vehicle(waited_s: f64, figures: &Figures) -> Self {
        let Figures { bytes, messages, signature, .. } = *figures;
        Self::NoVehicle { waited_s, bytes, messages, signature }
    }

    /// Whether the user can mend it by other input: a launch file, a vehicle file, an option, a system setting.
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

/// What to look at when no attitude came.
fn advice(messages: u64, signature: u64) -> &'static str {
    if signature > messages {
        "check that bridge.mavlink.signing_key is the key that the vehicle signs with"
    } else {
        "check that it is powered, that the link, its baud rate and its direction are right, and that it sends its attitude"
    }
}
