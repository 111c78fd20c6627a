//! Thread that sends commands to the vehicle when they arrive, while the other thread is not polling.

use std::sync::atomic::Ordering;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use whirlstand_bus::Bus;

use super::bus_receiver::{BusReceiver, Counts};
use super::duplicate_filter::Reader;
use super::shared_vehicle::SharedVehicle;
use crate::config::{NodeConfig, Role};
use crate::error::NodeError;
use crate::os::StopFlag;
use crate::setup::Setup;

/// Longest sleep, after which the stop flag is checked.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// The thread with its counters.
pub(super) struct Commands {
    thread: Option<JoinHandle<Result<(), NodeError>>>,
    stop: StopFlag,
    counts: Arc<Counts>,
    locators: Vec<String>,
}

impl Commands {
    /// Starts the thread; returns when it receives commands.
    ///
    /// # Errors
    /// The bus cannot be opened.
    pub fn start(
        config: &NodeConfig,
        shared: Arc<Mutex<SharedVehicle>>,
        stop: StopFlag,
    ) -> Result<Self, NodeError> {
        let mut bus_config = Setup::bus_config(config, Role::Plant);
        bus_config.node = "plant-commands".into();
        for endpoint in &mut bus_config.zenoh.listen {
            // The configured port belongs to the thread of the measurements.
            if let Some((host, _)) = endpoint.rsplit_once(':') {
                *endpoint = format!("{host}:0");
            }
        }
        let counts = Arc::<Counts>::default();
        let own = StopFlag::default();
        let (ready, opened) = sync_channel(1);
        let thread = {
            let (counts, own) = (counts.clone(), own.clone());
            std::thread::Builder::new()
                .name("commands".into())
                .spawn(move || {
                    let bus = match Bus::open(&bus_config) {
                        Ok(bus) => bus,
                        Err(e) => return Err(e.into()),
                    };
                    let mut receiver = BusReceiver::open(&bus, Reader::Commands)?;
                    // Nobody waits any more when the starting thread has failed.
                    let _ = ready.send(bus.locators().to_vec());
                    while !own.is_set() && !stop.is_set() {
                        bus.wait_until(Instant::now() + LONGEST_SLEEP, || {
                            receiver.receive_all(&shared, &counts).map(|()| false)
                        })?;
                    }
                    Ok(())
                })
                .map_err(|source| NodeError::System { action: "start a thread", source })?
        };
        let mut started = Self { thread: Some(thread), stop: own, counts, locators: Vec::new() };
        match opened.recv() {
            Ok(locators) => started.locators = locators,
            Err(_) => started.join()?,
        }
        Ok(started)
    }

    /// Endpoints on which the thread listens.
    pub fn locators(&self) -> &[String] {
        &self.locators
    }

    /// Counters of the thread.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Number of commands and estimates lost on the way.
    pub fn lost(&self) -> u64 {
        self.counts.lost.load(Ordering::Relaxed)
    }

    /// Number of messages of another version.
    pub fn refused(&self) -> u64 {
        self.counts.refused.load(Ordering::Relaxed)
    }

    /// Checks that the thread is still running without an error.
    ///
    /// # Errors
    /// The error that ended the thread.
    pub fn check(&mut self) -> Result<(), NodeError> {
        match &self.thread {
            Some(thread) if thread.is_finished() && !self.stop.is_set() => self.join(),
            _ => Ok(()),
        }
    }

    fn join(&mut self) -> Result<(), NodeError> {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Ok(()),
        }
    }
}

impl Drop for Commands {
    fn drop(&mut self) {
        self.stop.set();
        if let Some(thread) = self.thread.take() {
            // Its error was returned by `check`, or is irrelevant at the end.
            let _ = thread.join();
        }
    }
}
