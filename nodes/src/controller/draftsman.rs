//! Who designs the next law, in a thread beside the loop, and takes those that flew.

use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread;

use whirlstand_msgs::Finding;

use super::law::Law;
use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::setup::Setup;
use crate::succession::{believing, extended};

/// Orders and drafts that may wait. Channels of a fixed size allocate nothing when something is sent.
const DEPTH: usize = 8;

#[expect(clippy::large_enum_variant, reason = "a box would be allocated in a step of the loop")]
enum Order {
    /// The law for a finding; the number comes back with it.
    Draft(u64, Finding),
    /// A law that flies no more: to be freed here, beside the loop.
    Retire(Law),
}

/// What becomes of an order.
pub(super) enum Draft {
    Ready(Law),
    Coming,
    /// No law can be designed; it has been told why.
    None,
}

/// A thread that designs.
pub(super) struct Draftsman {
    orders: SyncSender<Order>,
    drafts: Receiver<(u64, Option<Law>)>,
    number: u64,
}

impl Draftsman {
    /// Begins to work. Before the node takes its priority, which the thread must not have.
    pub(super) fn new(config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let (orders, next) = sync_channel(DEPTH);
        let (done, drafts) = sync_channel(DEPTH);
        let (config, setup) = (config.clone(), setup.clone());
        let work = move || {
            while let Ok(order) = next.recv() {
                let (number, finding) = match order {
                    Order::Draft(number, finding) => (number, finding),
                    Order::Retire(law) => {
                        drop(law);
                        continue;
                    }
                };
                let law = extended(&setup.model, &finding)
                    .and_then(|m| Law::new(&config, &believing(&setup, m)).map_err(|e| e.to_string()));
                if let Err(why) = &law {
                    tracing::warn!("the law that the mirror asked for does not fly: {why}");
                }
                if done.send((number, law.ok())).is_err() {
                    return;
                }
            }
        };
        thread::Builder::new()
            .name("law".into())
            .spawn(work)
            .map_err(|source| NodeError::System { action: "start the thread that designs laws", source })?;
        Ok(Self { orders, drafts, number: 0 })
    }

    /// Asks for the law for a finding, in the place of what was asked for before.
    pub(super) fn order(&mut self, finding: &Finding) {
        self.number += 1;
        if self.orders.try_send(Order::Draft(self.number, *finding)).is_err() {
            tracing::warn!("the law that the mirror asked for is left out: others are still being designed");
        }
    }

    /// What was asked for last. `wait`: until it is there.
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
        // With more orders than fit it is freed here, which is late and not wrong.
        drop(self.orders.try_send(Order::Retire(law)));
    }
}
