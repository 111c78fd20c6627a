//! Collects the messages of a running bench for all viewers of a page, until the bench ends.

use std::time::{Duration, Instant};

use whirlstand_live::{BusFeed, Collector, Controls, Foxglove, FoxgloveFeed, Hub, Scene};

use super::card::BenchCard;
use crate::error::Failure;
use crate::keys::OBSERVER;

/// Time between two checks whether the bench has ended or its nodes have other addresses.
const CHECK: Duration = Duration::from_millis(250);

/// Time between two attempts to join a bench that is starting.
const JOIN_AGAIN: Duration = Duration::from_millis(50);

/// Time after which a bench on another host is joined again when not all of its nodes have been heard; it doubles
/// with each attempt. A link that breaks while it is set up is not always set up again.
const NOT_HEARD: Duration = Duration::from_secs(2);

/// Largest value of that time, since a node may be missing permanently.
const NOT_HEARD_LONGEST: Duration = Duration::from_secs(64);

/// Reason why the collection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Seen {
    /// The bench has ended.
    Over,
    /// The collection was told to end.
    Told,
}

/// The collection of one bench's messages.
pub(crate) struct Look {
    card: BenchCard,
    collector: Collector,
    hub: Hub,
    foxglove: Option<FoxgloveFeed>,
}

impl Look {
    /// Sends the viewers, including those with Foxglove, the description of the vehicle.
    ///
    /// # Errors
    /// When the vehicle cannot be read, or Foxglove's topics are refused.
    pub fn begin(
        card: &BenchCard,
        title: &str,
        hub: &Hub,
        foxglove: Option<&Foxglove>,
    ) -> Result<Self, Failure> {
        let vehicle = card.vehicle()?;
        let mode = serde_json::to_value(card.mode).map_err(Failure::run)?;
        let subtitle = format!(
            "bench {}: {}, {} over {}",
            card.bench,
            vehicle.name,
            mode.as_str().unwrap_or_default(),
            card.transport
        );
        let controls = Controls::Bench {
            plant_closed: card.plant_closed.clone(),
            controller_closed: card.controller_closed.clone(),
        };
        let mut scene = Scene::new(title, &subtitle, card.period_ns, &vehicle, controls);
        scene.effects = card.effects.clone();
        let collector =
            Collector::new(scene, &vehicle, card.remote.is_none()).with_engine(card.engine.into());
        collector.greet(hub);
        let foxglove = foxglove.map(|served| served.begin(&vehicle, card.period_ns));
        let foxglove = foxglove.transpose().map_err(Failure::run)?;
        Ok(Self { card: card.clone(), collector, hub: hub.clone(), foxglove })
    }

    /// Collects until the bench ends or `is_told_to_end` returns true, which is checked continually. A bench that
    /// `begins` may not exist yet. `pause` sleeps until a time at most.
    ///
    /// # Errors
    /// When the bench cannot be joined, or the transport fails.
    pub fn until_over(
        self,
        begins: bool,
        mut is_told_to_end: impl FnMut() -> bool,
        mut pause: impl FnMut(Instant),
    ) -> Result<Seen, Failure> {
        let Self { card, mut collector, hub, foxglove } = self;
        let nodes = card.remote.as_ref().map_or(&[][..], |remote| &remote.nodes);
        let mut patience = NOT_HEARD;
        loop {
            if is_told_to_end() {
                return Ok(Seen::Told);
            }
            // The addresses are read before the bench is joined, so that a change in between is noticed.
            let addresses = card.addresses(OBSERVER);
            let bus = match card.join(OBSERVER) {
                Ok(bus) => bus,
                Err(_) if begins => {
                    pause(Instant::now() + JOIN_AGAIN);
                    continue;
                }
                Err(e) => return Err(e),
            };
            let feed = BusFeed::open(bus, collector, hub.clone(), foxglove.clone());
            let mut feed = feed.map_err(Failure::mend)?;
            let mut check = Instant::now() + CHECK;
            let hears_by = Instant::now() + patience;
            loop {
                let now = Instant::now();
                let next = feed.turn(now).map_err(Failure::run)?;
                if is_told_to_end() {
                    feed.leave();
                    return Ok(Seen::Told);
                }
                if now >= check {
                    check = now + CHECK;
                    if card.is_over() || card.remote.is_some() && feed.plant_has_stopped() {
                        feed.leave();
                        return Ok(Seen::Over);
                    }
                    if card.addresses(OBSERVER) != addresses {
                        break;
                    }
                    if now >= hears_by && !feed.has_heard(nodes) {
                        patience = NOT_HEARD_LONGEST.min(2 * patience);
                        break;
                    }
                }
                pause(next);
            }
            collector = feed.leave();
        }
    }
}
