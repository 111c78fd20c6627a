//! Topics of the loop, from the bus into the log.

use whirlstand_bus::{Bus, Carried, Subscriber};
use whirlstand_logs::{BenchMessage, Channel};
use whirlstand_msgs::{
    Adjustment, Autopilot, Command, Disturbance, Estimate, Finding, Head, Imu, Message, Odometry, Outputs,
    Reported, Sent, Setpoint, Truth,
};

use crate::error::NodeError;
use crate::ports::receive;
use crate::recorder::sink::Sink;

/// Queue length of each topic.
pub const QUEUE_DEPTH: usize = 1024;

pub(super) struct Topic<M: Message> {
    subscriber: Subscriber<M>,
    /// Channel in the log; `None` while no file can be written.
    channel: Option<Channel<M>>,
    last: Option<M>,
    first: First,
}

/// Number of messages missed before the first one of a topic, for a recorder that begins with its bench: a
/// publisher counts from 0, so that a first number above 0 gives the number of missing messages. Repetitions
/// of step 0 do not count as missing: at most as many messages were lost as steps passed. For a restarted
/// recorder the first message has no meaning.
#[derive(Debug, Default)]
struct First {
    is_awaited: bool,
    missed: u64,
}

impl First {
    fn note(&mut self, head: &Head) {
        if std::mem::take(&mut self.is_awaited) {
            self.missed = head.seq.min(head.step);
        }
    }
}

impl<M: Carried> Topic<M>
where
    BenchMessage: From<M>,
{
    fn open(bus: &Bus, sink: &mut Sink) -> Result<Self, NodeError> {
        let first = First { is_awaited: sink.files().is_new(), missed: 0 };
        Ok(Self { subscriber: bus.subscriber(QUEUE_DEPTH)?, channel: sink.channel(), last: None, first })
    }

    /// The next message, if one waits. A repeated message is skipped: while a bench starts, step 0 is
    /// repeated until all nodes have received it.
    pub(super) fn receive(&mut self, refused: &mut u64) -> Result<Option<M>, NodeError> {
        while let Some(message) = receive(&mut self.subscriber, refused)? {
            self.first.note(message.head());
            let repeated = self.last.is_some_and(|mut last| {
                last.head().step == message.head().step && {
                    last.head_mut().seq = message.head().seq;
                    bytemuck::bytes_of(&last) == bytemuck::bytes_of(&message)
                }
            });
            if !repeated {
                return Ok(Some(message));
            }
        }
        Ok(None)
    }

    pub(super) fn write(&mut self, sink: &mut Sink, message: &M) {
        self.last = Some(*message);
        sink.write(self.channel.as_ref(), message);
    }

    /// Writes waiting messages, at most one full queue, so that the turn ends even when the publisher is
    /// faster.
    fn drain(&mut self, sink: &mut Sink, refused: &mut u64) -> Result<(), NodeError> {
        for _ in 0..QUEUE_DEPTH {
            let Some(message) = self.receive(refused)? else { break };
            self.write(sink, &message);
        }
        Ok(())
    }

    /// Step of the last message of this run of the plant.
    pub(super) fn step(&self) -> Option<u64> {
        self.last.map(|m| m.head().step)
    }

    fn lost(&self) -> u64 {
        self.subscriber.lost().saturating_add(self.first.missed)
    }
}

macro_rules! topics {
    ($leader:ident: $leading:ident, $($name:ident: $message:ident),* $(,)?) => {
        /// All topics of the loop, from the bus into the log.
        pub(super) struct Topics {
            /// Leading topic, whose progress bounds the number of waiting messages of the others.
            pub(super) $leader: Topic<$leading>,
            $(pub(super) $name: Topic<$message>,)*
            /// Requests from outside; not part of the loop, because several nodes answer them.
            adjusted: Topic<Adjustment>,
        }

        impl Topics {
            pub(super) fn open(bus: &Bus, sink: &mut Sink) -> Result<Self, NodeError> {
                Ok(Self { $leader: Topic::open(bus, sink)?, $($name: Topic::open(bus, sink)?,)* adjusted: Topic::open(bus, sink)? })
            }

            /// Writes the waiting messages of each topic but the leading one, at most one full queue each.
            pub(super) fn drain_followers(
                &mut self,
                sink: &mut Sink,
                refused: &mut u64,
            ) -> Result<(), NodeError> {
                $(self.$name.drain(sink, refused)?;)*
                self.adjusted.drain(sink, refused)
            }

            /// Continues in another file.
            pub(super) fn move_to(&mut self, sink: &mut Sink) {
                self.$leader.channel = sink.channel();
                $(self.$name.channel = sink.channel();)*
                self.adjusted.channel = sink.channel();
            }

            /// Resets for a new run of the plant.
            pub(super) fn begin_run(&mut self) {
                self.$leader.last = None;
                $(self.$name.last = None;)*
                self.adjusted.last = None;
            }

            /// Number of messages that never reached the recorder, over all topics.
            pub(super) fn lost(&self) -> u64 {
                [$(self.$name.lost(),)* self.adjusted.lost()].into_iter().fold(self.$leader.lost(), u64::saturating_add)
            }
        }
    };
}

whirlstand_logs::loop_topics!(topics);

#[cfg(test)]
mod tests {
    use super::{First, Head};

    #[test]
    fn a_first_message_that_is_not_number_zero_is_a_loss_unless_the_recorder_came_late_or_step_0_is_repeated()
    {
        for (is_awaited, seq, step, missed) in [
            (true, 34, 34, 34),
            (true, 40, 34, 34),
            (true, 0, 0, 0),
            (true, 9, 0, 0),
            (true, 1, 200, 1),
            (false, 34, 34, 0),
        ] {
            let mut first = First { is_awaited, missed: 0 };
            first.note(&Head { seq, step, stamp_ns: 0 });
            first.note(&Head { seq: 99, step: 99, stamp_ns: 0 });
            assert_eq!(first.missed, missed, "number {seq}, step {step}");
        }
    }
}
