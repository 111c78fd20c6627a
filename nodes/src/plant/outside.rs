//! Inputs of the plant from outside the loop: disturbances on `inject`, and gusts, the engine's state and the
//! end of the run on `adjust`.

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict, Disturbance, Head, MAX_STATES};
use whirlstand_vehicle::{Engine, Simulator};

use crate::adjustment_desk::{AdjustmentDesk, MOST_REQUESTS};
use crate::error::NodeError;
use crate::ports::receive;

/// Topic on which a program outside the loop disturbs the vehicle.
pub const INJECT_TOPIC: &str = "inject";

/// Queue length for disturbances from outside.
const INJECT_DEPTH: usize = 16;

/// Largest number of simultaneous gusts.
const MOST_GUSTS: usize = 16;

#[derive(Debug, Clone, Copy)]
struct Gust {
    state: usize,
    /// Disturbance of the state's derivative, SI.
    size: f64,
    /// First step without the gust.
    until: u64,
}

pub(super) struct Outside {
    inject: Option<Subscriber<Disturbance>>,
    desk: AdjustmentDesk,
    injected: [f64; MAX_STATES],
    gusts: [Option<Gust>; MOST_GUSTS],
    /// Bounds of the states, SI.
    bounds: Vec<f64>,
    period_ns: u64,
    is_to_end: bool,
    refused: u64,
}

impl Outside {
    pub(super) fn open(
        bus: &Bus,
        is_open: bool,
        bounds: Vec<f64>,
        period_ns: u64,
    ) -> Result<Self, NodeError> {
        let business =
            &[AdjustmentKind::Gust, AdjustmentKind::Engine, AdjustmentKind::Stop, AdjustmentKind::Effect];
        Ok(Self {
            inject: if is_open { Some(bus.subscriber_on(INJECT_TOPIC, INJECT_DEPTH)?) } else { None },
            desk: AdjustmentDesk::open(bus, business, "plant.inject", is_open)?,
            injected: [0.0; MAX_STATES],
            gusts: [None; MOST_GUSTS],
            bounds,
            period_ns,
            is_to_end: false,
            refused: 0,
        })
    }

    /// Applies waiting requests to the vehicle from the step of `head` on; a change of the engine takes
    /// effect from step `measured` on, the next one not measured yet.
    pub(super) fn act(
        &mut self,
        head: Head,
        measured: u64,
        simulator: &mut Simulator,
    ) -> Result<(), NodeError> {
        if self.inject.is_none() {
            return Ok(());
        }
        let mut changed = self.take_injected()?;
        for gust in &mut self.gusts {
            let is_over = gust.is_some_and(|g| g.until <= head.step);
            changed |= is_over;
            *gust = gust.filter(|_| !is_over);
        }
        for _ in 0..MOST_REQUESTS {
            let Some((kind, request)) = self.desk.next()? else { break };
            let (mut head, verdict) = (
                head,
                match kind {
                    AdjustmentKind::Engine => self.engine(&request, simulator),
                    AdjustmentKind::Stop => self.stop(&request),
                    AdjustmentKind::Effect => switch(&request, simulator),
                    _ => self.gust(&request, head.step),
                },
            );
            changed |= verdict == AdjustmentVerdict::Done;
            if kind == AdjustmentKind::Engine {
                (head.step, head.stamp_ns) = (measured, measured * self.period_ns);
            }
            self.desk.answer(&request, head, verdict)?;
        }
        if changed {
            let mut dx = self.injected;
            self.gusts.iter().flatten().for_each(|gust| dx[gust.state] += gust.size);
            simulator.disturb(&dx[..self.bounds.len()]);
        }
        Ok(())
    }

    /// Work between steps, see [`AdjustmentDesk::attend`].
    pub(super) fn attend(&mut self, head: Head) -> Result<(), NodeError> {
        self.desk.attend(head)
    }

    /// True when the run ends after this step.
    pub(super) fn is_to_end(&self) -> bool {
        self.is_to_end
    }

    /// Number of unusable messages from outside.
    pub(super) fn refused(&self) -> u64 {
        self.refused + self.desk.malformed()
    }

    fn engine(&self, request: &Adjustment, simulator: &mut Simulator) -> AdjustmentVerdict {
        let states = [Engine::Off, Engine::On, Engine::Flying];
        let Some(engine) = states.into_iter().find(|e| f64::from(*e as u8) == request.value) else {
            return AdjustmentVerdict::Unusable;
        };
        simulator.set_engine(engine);
        AdjustmentVerdict::Done
    }

    fn stop(&mut self, request: &Adjustment) -> AdjustmentVerdict {
        if request.value != 0.0 {
            return AdjustmentVerdict::Unusable;
        }
        self.is_to_end = true;
        AdjustmentVerdict::Done
    }

    fn gust(&mut self, request: &Adjustment, step: u64) -> AdjustmentVerdict {
        let (state, size) = (request.index as usize, request.value);
        let Some(bound) = self.bounds.get(state) else { return AdjustmentVerdict::NoSuchState };
        if !size.is_finite() || request.length_ns == 0 {
            return AdjustmentVerdict::Unusable;
        }
        // A larger gust would by itself take the state beyond its bound.
        if size.abs() * request.length_ns as f64 * 1e-9 > *bound {
            return AdjustmentVerdict::OutOfRange;
        }
        let Some(free) = self.gusts.iter_mut().find(|g| g.is_none()) else { return AdjustmentVerdict::Busy };
        let until = step.saturating_add(request.length_ns.div_ceil(self.period_ns));
        *free = Some(Gust { state, size, until });
        AdjustmentVerdict::Done
    }

    fn take_injected(&mut self) -> Result<bool, NodeError> {
        let Some(inject) = &mut self.inject else { return Ok(false) };
        let mut newest = None;
        // At most the queue's length: a sender without a pause must not delay the step.
        for _ in 0..INJECT_DEPTH {
            let Some(d) = receive(inject, &mut self.refused)? else { break };
            if d.count as usize == self.bounds.len() && d.dx.iter().all(|v| v.is_finite()) {
                newest = Some(d.dx);
            } else {
                self.refused += 1;
            }
        }
        self.injected = newest.unwrap_or(self.injected);
        Ok(newest.is_some())
    }
}

fn switch(request: &Adjustment, simulator: &mut Simulator) -> AdjustmentVerdict {
    let on = match request.value {
        0.0 => false,
        1.0 => true,
        _ => return AdjustmentVerdict::Unusable,
    };
    match simulator.switch(request.index as usize, on) {
        true => AdjustmentVerdict::Done,
        false => AdjustmentVerdict::NoSuchEffect,
    }
}
