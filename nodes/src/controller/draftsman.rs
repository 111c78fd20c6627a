//! Designs the next law in a thread beside the loop, and frees laws that are no longer in use.

use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};

use whirlstand_msgs::Finding;

use super::law::Law;
use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::notices::{Notice, say};
use crate::setup::Setup;
use crate::succession::{believing, extended};
use crate::worker::Worker;

/// Largest number of waiting orders and designs.
const DEPTH: usize = 8;

#[expect(clippy::large_enum_variant, reason = "a box would be allocated in a step of the loop")]
enum Order {
    /// Order to design the law for a finding; the number is returned with the law.
    Draft(u64, Finding),
    /// Order to free a law that is no longer in use, outside the loop.
    Retire(Law),
}

/// Result of a design order.
pub(super) enum Draft {
    Ready(Law),
    Coming,
    /// No law can be designed; the reason was reported.
    None,
}

/// Design thread.
pub(super) struct Draftsman {
    orders: Worker<Order>,
    drafts: Receiver<(u64, Option<Law>)>,
    number: u64,
}

impl Draftsman {
    /// Starts the thread, before the node takes its priority, which the thread must not have.
    pub(super) fn new(config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let (done, drafts) = sync_channel(DEPTH);
        let (config, setup) = (config.clone(), setup.clone());
        let work = move |order| {
            let (number, finding) = match order {
                Order::Draft(number, finding) => (number, finding),
                Order::Retire(law) => return drop(law),
            };
            let law = extended(&setup.model, &finding)
                .and_then(|m| Law::new(&config, &believing(&setup, m)).map_err(|e| e.to_string()));
            if let Err(why) = &law {
                tracing::warn!("the law that the mirror asked for cannot be used: {why}");
            }
            // Nobody waits for it when the controller is gone.
            let _ = done.send((number, law.ok()));
        };
        let orders = Worker::start("law", DEPTH, work)
            .map_err(|source| NodeError::System { action: "start the thread that designs laws", source })?;
        Ok(Self { orders, drafts, number: 0 })
    }

    /// Orders the law for a finding, replacing the previous order.
    pub(super) fn order(&mut self, finding: &Finding) {
        self.number += 1;
        if self.orders.hand(Order::Draft(self.number, *finding)).is_err() {
            say(Notice::DraftLeftOut);
        }
    }

    /// The result of the last order; with `wait`, waits for it.
    pub(super) fn draft(&mut self, wait: bool) -> Draft {
        loop {
            let next = if wait {
                self.drafts.recv().map_err(|_| TryRecvError::Disconnected)
            } else {
                self.drafts.try_recv()
            };
            match next {
                Ok((number, Some(law))) if number == self.number => return Draft::Ready(law),
                Ok((number, None)) if number == self.number => return Draft::None,
                Ok((_, Some(law))) => self.retire(law),
                Ok((_, None)) => {}
                Err(TryRecvError::Empty) => return Draft::Coming,
                Err(TryRecvError::Disconnected) => return Draft::None,
            }
        }
    }

    /// Frees a law.
    pub(super) fn retire(&self, law: Law) {
        // When the queue is full the law is freed here, which only takes time.
        drop(self.orders.hand(Order::Retire(law)));
    }
}
