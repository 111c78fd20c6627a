//! The messages that a feed hears: from the bus, or from a log.

use bytemuck::bytes_of;
use whirlstand_bus::{Bus, OpenError, RecvError, Subscriber};
use whirlstand_logs::{BenchInfo, RawMessage, ReadError, named_schema};
use whirlstand_msgs::{
    Adjustment, Autopilot, Command, Disturbance, Estimate, Finding, Head, Health, Imu, Message, Odometry,
    Outputs, Sent, Setpoint, Truth,
};

/// Queue of each topic: whoever looks on may miss what a fast bench says, and is told how much.
const DEPTH: usize = whirlstand_bus::MAX_DEPTH;

/// How the messages of a topic are written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct HeardType {
    pub topic: &'static str,
    pub name: &'static str,
    /// In ROS 2 message syntax.
    pub schema: String,
}

impl HeardType {
    fn of<M: Message>(info: &BenchInfo) -> Self {
        Self { topic: M::TOPIC, name: M::TYPE_NAME, schema: named_schema::<M>(info) }
    }
}

macro_rules! heard {
    ($($name:ident: $message:ident),* $(,)?) => {
        /// A message of a bench.
        #[derive(Debug, Clone, Copy)]
        pub(crate) enum Heard {
            $($message($message),)*
            Adjustment(Adjustment),
            Health(Health),
        }

        impl Heard {
            /// Number, step and time.
            pub fn head(&self) -> &Head {
                match self {
                    $(Self::$message(m) => &m.head,)*
                    Self::Adjustment(m) => &m.head,
                    Self::Health(m) => &m.head,
                }
            }

            /// Topic and memory image.
            pub fn raw(&self) -> (&'static str, &[u8]) {
                match self {
                    $(Self::$message(m) => ($message::TOPIC, bytes_of(m)),)*
                    Self::Adjustment(m) => (Adjustment::TOPIC, bytes_of(m)),
                    Self::Health(m) => (Health::TOPIC, bytes_of(m)),
                }
            }

            /// What can be heard, with the schemas of a bench.
            pub fn types(info: &BenchInfo) -> Vec<HeardType> {
                vec![
                    $(HeardType::of::<$message>(info),)*
                    HeardType::of::<Adjustment>(info),
                    HeardType::of::<Health>(info),
                ]
            }

            /// A message of a log; `None` for a topic that is not shown.
            ///
            /// # Errors
            /// As [`RawMessage::decode`].
            pub fn decode(raw: &RawMessage<'_>) -> Result<Option<Self>, ReadError> {
                Ok(match raw.topic.name.strip_prefix('/') {
                    $(Some($message::TOPIC) => Some(Self::$message(raw.decode()?)),)*
                    Some(Adjustment::TOPIC) => Some(Self::Adjustment(raw.decode()?)),
                    Some(Health::TOPIC) => Some(Self::Health(raw.decode()?)),
                    _ => None,
                })
            }
        }

        /// Subscriptions to all that is shown.
        pub(crate) struct Ears {
            $($name: Subscriber<$message>,)*
            adjusted: Subscriber<Adjustment>,
            health: Subscriber<Health>,
            /// Messages that could not be read.
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

            /// Hands on what waits, at most one queue full of each topic.
            pub fn drain(&mut self, mut hear: impl FnMut(&Heard)) -> Result<(), RecvError> {
                $(each(&mut self.$name, &mut self.refused, |m| hear(&Heard::$message(m)))?;)*
                each(&mut self.adjusted, &mut self.refused, |m| hear(&Heard::Adjustment(m)))?;
                each(&mut self.health, &mut self.refused, |m| hear(&Heard::Health(m)))
            }

            /// Messages that came faster than they were taken.
            pub fn lost(&self) -> u64 {
                [$(self.$name.lost(),)* self.adjusted.lost()].into_iter().fold(self.health.lost(), u64::saturating_add)
            }
        }
    };
}

whirlstand_logs::loop_topics!(heard);

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
