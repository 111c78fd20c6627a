//! Benchmark ring of three processes that pass a message around, once directly over iceoryx2 and once over
//! the bus: measures the overhead of the bus relative to this machine's minimum.
//!
//! Position 0 sends [`Imu`], position 1 answers with [`Estimate`], position 2 with [`Command`], which closes
//! the lap: the payloads of the control loop without its computation. Run each position in its own process,
//! all three with the same bench and laps; [`Ring::run`] returns the time of the laps at position 0.

use std::time::{Duration, Instant};

use iceoryx2::config::Config;
use iceoryx2::node::NodeBuilder;
use iceoryx2::port::publisher::Publisher as IoxPublisher;
use iceoryx2::port::subscriber::Subscriber as IoxSubscriber;
use iceoryx2::prelude::{LogLevel, ServiceName, SignalHandlingMode, ipc, set_log_level_from_env_or};
use whirlstand_msgs::{Command, Estimate, Imu, Message};

use crate::carried::Carried;
use crate::shared_memory::Shared;
use crate::shared_memory_config::config;
use crate::{Bus, BusConfig, OpenError, Publisher, Subscriber};

/// Number of processes in the ring.
pub const POSITIONS: usize = 3;

/// Step number that ends the other processes.
const END: u64 = u64::MAX;

/// Period of position 0's messages until the ring is closed.
const OPENING_PERIOD: Duration = Duration::from_millis(5);

/// Longest time of a lap; after it the ring counts as broken.
const LAP_TIMEOUT: Duration = Duration::from_secs(20);

/// Configuration of a ring.
#[derive(Debug, Clone)]
pub struct Ring {
    /// Bench, transport and waiting strategy; a bare ring uses only the bench's name.
    pub bus: BusConfig,
    /// True to use iceoryx2 alone, with a yield of the processor between polls.
    pub bare: bool,
    /// Number of timed laps, after one tenth as many for warm-up.
    pub laps: u64,
}

/// Reason why a ring did not run.
#[derive(Debug, thiserror::Error)]
pub enum RingError {
    /// The bus refused.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// Sending, receiving or opening failed.
    #[error("ring: {0}")]
    Port(String),
    /// A message did not return.
    #[error("ring: nothing came round within {} s", LAP_TIMEOUT.as_secs())]
    Broken,
}

impl Ring {
    /// Takes a position of the ring until all laps are run; the time of the laps at position 0, otherwise `None`.
    ///
    /// # Errors
    /// [`RingError`] when the transport refuses or the ring is broken.
    ///
    /// # Panics
    /// When `position` is not below [`POSITIONS`].
    pub fn run(&self, position: usize) -> Result<Option<Duration>, RingError> {
        match (self.bare, position) {
            (true, 0) => self.lead(&mut self.bare_link::<Command, Imu>()?).map(Some),
            (true, 1) => follow(&mut self.bare_link::<Imu, Estimate>()?).map(|()| None),
            (true, 2) => follow(&mut self.bare_link::<Estimate, Command>()?).map(|()| None),
            (false, 0) => self.lead(&mut self.bus_link::<Command, Imu>()?).map(Some),
            (false, 1) => follow(&mut self.bus_link::<Imu, Estimate>()?).map(|()| None),
            (false, 2) => follow(&mut self.bus_link::<Estimate, Command>()?).map(|()| None),
            _ => panic!("position {position} of {POSITIONS}"),
        }
    }

    fn lead<L: Link<In = Command, Out = Imu>>(&self, link: &mut L) -> Result<Duration, RingError> {
        let give_up = Instant::now() + LAP_TIMEOUT;
        let at = |step: u64| {
            let mut imu = Imu::zeroed();
            imu.head.step = step;
            imu
        };
        loop {
            link.send(&at(0))?;
            if link.receive(Instant::now() + OPENING_PERIOD)?.is_some() {
                break;
            }
            if Instant::now() > give_up {
                return Err(RingError::Broken);
            }
        }
        let warm_up = self.laps / 10;
        let mut start = Instant::now();
        for lap in 1..=warm_up + self.laps {
            if lap == warm_up + 1 {
                start = Instant::now();
            }
            link.send(&at(lap))?;
            // Answers to the opening messages may still arrive in between.
            while link.receive(Instant::now() + LAP_TIMEOUT)?.ok_or(RingError::Broken)?.head.step != lap {}
        }
        let elapsed = start.elapsed();
        link.send(&at(END))?;
        Ok(elapsed)
    }

    fn bus_link<I: Carried, O: Carried>(&self) -> Result<BusLink<I, O>, RingError> {
        let bus = Bus::open(&self.bus)?;
        Ok(BusLink { input: bus.subscriber(8)?, output: bus.publisher()?, bus })
    }

    fn bare_link<I: Message, O: Message>(&self) -> Result<BareLink<I, O>, RingError> {
        set_log_level_from_env_or(LogLevel::Fatal);
        let name = |topic: &str| {
            let text = format!("bare/{topic}");
            ServiceName::new(&text).map_err(|e| failed(format!("{e:?}")))
        };
        // The default iceoryx2 configuration, except for the location of its files.
        let mut config = config(&self.bus.bench)?;
        config.defaults = Config::default().defaults;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(failed)?;
        let input = node.service_builder(&name(I::TOPIC)?).publish_subscribe::<Shared<I>>().open_or_create();
        let output = node.service_builder(&name(O::TOPIC)?).publish_subscribe::<Shared<O>>().open_or_create();
        Ok(BareLink {
            input: input.map_err(failed)?.subscriber_builder().create().map_err(failed)?,
            output: output.map_err(failed)?.publisher_builder().create().map_err(failed)?,
        })
    }
}

fn follow<L: Link>(link: &mut L) -> Result<(), RingError> {
    loop {
        let step = link.receive(Instant::now() + LAP_TIMEOUT)?.ok_or(RingError::Broken)?.head().step;
        let mut answer = L::Out::zeroed();
        answer.head_mut().step = step;
        link.send(&answer)?;
        if step == END {
            return Ok(());
        }
    }
}

/// Input and output of one position.
trait Link {
    type In: Message;
    type Out: Message;

    fn send(&mut self, message: &Self::Out) -> Result<(), RingError>;

    /// Receives a message; `None` when the deadline is over.
    fn receive(&mut self, deadline: Instant) -> Result<Option<Self::In>, RingError>;
}

struct BusLink<I: Message, O: Message> {
    input: Subscriber<I>,
    output: Publisher<O>,
    bus: Bus,
}

impl<I: Message, O: Message> Link for BusLink<I, O> {
    type In = I;
    type Out = O;

    fn send(&mut self, message: &O) -> Result<(), RingError> {
        self.output.send(message).map_err(failed)
    }

    fn receive(&mut self, deadline: Instant) -> Result<Option<I>, RingError> {
        let mut received = None;
        self.bus
            .wait_until(deadline, || {
                received = self.input.try_recv()?;
                Ok::<_, crate::RecvError>(received.is_some())
            })
            .map_err(failed)?;
        Ok(received)
    }
}

struct BareLink<I: Message, O: Message> {
    input: IoxSubscriber<ipc::Service, Shared<I>, ()>,
    output: IoxPublisher<ipc::Service, Shared<O>, ()>,
}

impl<I: Message, O: Message> Link for BareLink<I, O> {
    type In = I;
    type Out = O;

    fn send(&mut self, message: &O) -> Result<(), RingError> {
        let sample = self.output.loan_uninit().map_err(failed)?;
        sample.write_payload(Shared(*message)).send().map_err(failed)?;
        Ok(())
    }

    fn receive(&mut self, deadline: Instant) -> Result<Option<I>, RingError> {
        loop {
            if let Some(sample) = self.input.receive().map_err(failed)? {
                return Ok(Some(sample.payload().0));
            }
            if Instant::now() >= deadline {
                return Ok(None);
            }
            std::thread::yield_now();
        }
    }
}

fn failed(error: impl ToString) -> RingError {
    RingError::Port(error.to_string())
}
