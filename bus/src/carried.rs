//! Ports between processes, behind one pointer: what a transport does for a message type is compiled here once,
//! not again in every crate that opens a port. For the types of iceoryx2 alone that was a tenth of the executable.

use whirlstand_msgs::{
    Adjustment, Autopilot, Command, Disturbance, Estimate, Finding, Health, Imu, Message, Odometry, Outputs,
    Progress, Reported, Sent, Setpoint, Stick, Truth,
};

use crate::port::{PublisherPort, SubscriberPort};
use crate::{OpenError, network, shared_memory};

/// A message type that a bus carries: all those of `whirlstand_msgs`, and others by [`carried!`](crate::carried).
pub trait Carried: Message {
    #[doc(hidden)]
    fn open_publisher(place: &Place<'_>) -> Result<OpenPublisher<Self>, OpenError>;
    #[doc(hidden)]
    fn open_subscriber(place: &Place<'_>, depth: usize) -> Result<OpenSubscriber<Self>, OpenError>;
}

/// Lets a bus carry further message types. Use it in the crate that defines them.
#[macro_export]
macro_rules! carried {
    ($($message:ty),+ $(,)?) => { $(
        impl $crate::Carried for $message {
            fn open_publisher(
                place: &$crate::Place<'_>,
            ) -> Result<$crate::OpenPublisher<Self>, $crate::OpenError> {
                place.publisher()
            }

            fn open_subscriber(
                place: &$crate::Place<'_>,
                depth: usize,
            ) -> Result<$crate::OpenSubscriber<Self>, $crate::OpenError> {
                place.subscriber(depth)
            }
        }
    )+ };
}

carried!(
    Adjustment,
    Autopilot,
    Command,
    Disturbance,
    Estimate,
    Finding,
    Health,
    Imu,
    Odometry,
    Outputs,
    Progress,
    Reported,
    Sent,
    Setpoint,
    Stick,
    Truth,
);

/// Transport to other processes.
pub(crate) enum Carrier<'a> {
    Iceoryx2(&'a std::rc::Rc<shared_memory::Member>),
    Zenoh(&'a network::Member),
}

/// Where a port opens: a topic of a bench.
#[doc(hidden)]
pub struct Place<'a> {
    pub(crate) carrier: Carrier<'a>,
    pub(crate) topic: &'a str,
    pub(crate) speaker: Option<&'a str>,
}

/// A port as [`Carried::open_publisher`] returns it.
#[doc(hidden)]
pub struct OpenPublisher<M>(pub(crate) Box<dyn PublisherPort<M>>);

/// A port as [`Carried::open_subscriber`] returns it.
#[doc(hidden)]
pub struct OpenSubscriber<M>(pub(crate) Box<dyn SubscriberPort<M>>);

impl Place<'_> {
    #[doc(hidden)]
    pub fn publisher<M: Message>(&self) -> Result<OpenPublisher<M>, OpenError> {
        Ok(OpenPublisher(match self.carrier {
            Carrier::Iceoryx2(member) => Box::new(member.publisher::<M>(self.topic)?),
            Carrier::Zenoh(member) => Box::new(member.publisher::<M>(self.topic, self.speaker)?),
        }))
    }

    #[doc(hidden)]
    pub fn subscriber<M: Message>(&self, depth: usize) -> Result<OpenSubscriber<M>, OpenError> {
        Ok(OpenSubscriber(match self.carrier {
            Carrier::Iceoryx2(member) => Box::new(member.subscriber::<M>(self.topic, depth)?),
            Carrier::Zenoh(member) => Box::new(member.subscriber::<M>(self.topic, depth)?),
        }))
    }
}
