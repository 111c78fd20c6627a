//! Subscriptions of a feed to the messages of a running bench.

use whirlstand_bus::{Bus, OpenError, RecvError, Subscriber};
use whirlstand_logs::BenchMessage;
use whirlstand_msgs::{
    Adjustment, Autopilot, Command, Disturbance, Estimate, Finding, Health, Imu, Message, Odometry, Outputs,
    Reported, Sent, Setpoint, Truth,
};

/// Queue length of each topic. A viewer may miss messages of a fast bench, and is told how many.
const DEPTH: usize = whirlstand_bus::MAX_DEPTH;

macro_rules! ears {
    ($($name:ident: $message:ident),* $(,)?) => {
        /// Subscriptions to all topics that are shown.
        pub(crate) struct Ears {
            $($name: Subscriber<$message>,)*
            adjusted: Subscriber<Adjustment>,
            health: Subscriber<Health>,
            /// Number of messages that could not be decoded.
            pub refused: u64,
        }

        impl Ears {
            pub fn open(bus: &Bus) -> Result<Self, OpenError> {
                Ok(Self {
                    $($name: bus.subscriber(DEPTH)?,)*
                    adjusted: bus.subscriber(DEPTH)?,
                    health: bus.subscriber(DEPTH)?,
                    refused: 0,
                })
            }

            /// Passes on the waiting messages, at most one full queue of each topic.
            pub fn drain(&mut self, mut hear: impl FnMut(&BenchMessage)) -> Result<(), RecvError> {
                $(each(&mut self.$name, &mut self.refused, |m| hear(&m.into()))?;)*
                each(&mut self.adjusted, &mut self.refused, |m| hear(&m.into()))?;
                each(&mut self.health, &mut self.refused, |m| hear(&m.into()))
            }

            /// Number of messages that were lost because they arrived faster than they were taken.
            pub fn lost(&self) -> u64 {
                [$(self.$name.lost(),)* self.adjusted.lost()].into_iter().fold(self.health.lost(), u64::saturating_add)
            }
        }
    };
}

whirlstand_logs::loop_topics!(ears);

fn each<M: Message>(
    subscriber: &mut Subscriber<M>,
    refused: &mut u64,
    mut hear: impl FnMut(M),
) -> Result<(), RecvError> {
    for _ in 0..DEPTH {
        match subscriber.try_recv() {
            Ok(Some(message)) => hear(message),
            Ok(None) => break,
            Err(RecvError::Refused { .. }) => *refused += 1,
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
