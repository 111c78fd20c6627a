//! The live page of a run, and its Foxglove server, in the launcher's process. The loop runs in other processes,
//! or in a thread that is independent of them.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use whirlstand_live::{Address, Answer, Control, Foxglove, Hub, Server};
use whirlstand_msgs::MAX_INPUTS;
use whirlstand_vehicle::Vehicle;

use super::ask::ask;
use super::card::BenchCard;
use super::hand::Hands;
use super::look::Look;
use super::told::Told;
use super::wanted::Wanted;
use crate::error::Failure;

/// Longest gust that a viewer may ask for, s.
const LONGEST_GUST_S: f64 = 3600.0;

/// Addresses at which a running bench is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct LiveAddresses {
    /// Address of the live page.
    pub page: Option<Address>,
    /// Address of the Foxglove server.
    pub foxglove: Option<Address>,
}

/// The live page, the Foxglove server, and the bench that they show at present.
pub(crate) struct LivePage {
    hub: Hub,
    server: Option<Server>,
    foxglove: Option<Foxglove>,
    shown: Arc<Mutex<Option<BenchCard>>>,
}

/// A thread that collects the messages of a bench, until this is dropped.
pub(crate) struct Looker {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    shown: Arc<Mutex<Option<BenchCard>>>,
}

impl LivePage {
    /// Serves the page and Foxglove at the given addresses; `None` when neither has one.
    ///
    /// # Errors
    /// When an address is not available.
    pub fn open(addresses: LiveAddresses) -> Result<Option<Self>, Failure> {
        if addresses == LiveAddresses::default() {
            return Ok(None);
        }
        let hub = Hub::default();
        let shown = Arc::<Mutex<Option<BenchCard>>>::default();
        let act = {
            let (shown, hands) = (shown.clone(), Arc::<Hands>::default());
            move |control: &Control| {
                let card = shown.lock().unwrap_or_else(PoisonError::into_inner).clone();
                card.map_or_else(|| Err("no bench is running".into()), |card| act(&card, &hands, control))
            }
        };
        let server = addresses.page.map(|address| Server::start(address, hub.clone(), act.clone()));
        let foxglove = addresses.foxglove.map(|address| Foxglove::start(address, act));
        let server = server.transpose().map_err(Failure::mend)?;
        let foxglove = foxglove.transpose().map_err(Failure::mend)?;
        Ok(Some(Self { hub, server, foxglove, shown }))
    }

    /// Prints the addresses of the page and of the Foxglove server.
    pub fn announce(&self) {
        if let Some(server) = &self.server {
            crate::style::say(&format!("live page {}", server.url()));
        }
        if let Some(foxglove) = &self.foxglove {
            let (url, topic) = (foxglove.url(), foxglove.control_topic());
            crate::style::say(&format!("Foxglove {url} (publish controls to {topic})"));
        }
    }

    /// Begins to collect the messages of a running bench.
    ///
    /// # Errors
    /// As [`Look::begin`].
    pub fn begin(&self, card: &BenchCard, title: &str) -> Result<Look, Failure> {
        Look::begin(card, title, &self.hub, self.foxglove.as_ref())
    }

    /// Lets viewers request changes of a bench.
    pub fn hand_over(&self, card: &BenchCard) {
        *self.shown.lock().unwrap_or_else(PoisonError::into_inner) = Some(card.clone());
    }

    /// Shows a bench that is starting.
    ///
    /// # Errors
    /// When the vehicle cannot be read, or no thread can be started.
    pub fn look_at(&self, card: &BenchCard, title: &str) -> Result<Looker, Failure> {
        let look = self.begin(card, title)?;
        let stop = Arc::new(AtomicBool::new(false));
        let told = stop.clone();
        let body = move || {
            let is_told = || told.load(Ordering::Relaxed);
            let pause = |until: Instant| std::thread::sleep(until.saturating_duration_since(Instant::now()));
            if let Err(e) = look.until_over(true, is_told, pause) {
                tracing::warn!("the live page can no longer show this run: {e}");
            }
        };
        let thread =
            std::thread::Builder::new().name("live-feed".into()).spawn(body).map_err(Failure::run)?;
        self.hand_over(card);
        Ok(Looker { stop, thread: Some(thread), shown: self.shown.clone() })
    }

    /// Tells the viewers that the bench has ended, with the reason.
    pub fn end(self, why: &str) {
        self.hub.end(why);
    }
}

impl Drop for Looker {
    fn drop(&mut self) {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner).take();
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Carries out a viewer's request.
fn act(card: &BenchCard, hands: &Hands, control: &Control) -> Answer {
    let text = |e: Failure| e.to_string();
    let vehicle = card.vehicle().map_err(text)?;
    let wanted = match control {
        Control::Inject { for_s, .. } if !(*for_s > 0.0 && *for_s <= LONGEST_GUST_S) => {
            return Err(format!("a gust lasts more than 0 s and at most {LONGEST_GUST_S} s, not {for_s}"));
        }
        Control::Inject { what, for_s } => Wanted::gust(what, *for_s, &vehicle).map_err(text)?,
        Control::Set { what } => Wanted::setting(what, &vehicle).map_err(text)?,
        Control::Take { hand } => return hands.take(card, &vehicle, *hand),
        Control::Stick { hand, at } => return hands.say(*hand, deflected(&vehicle, at)?),
        Control::Give { hand } => {
            hands.give(*hand);
            Wanted::Stick(None)
        }
        Control::Stop {} => Wanted::Stop,
        Control::Play { .. } => return Err("only a finished log can be played".into()),
    };
    let answers = ask(card, &[wanted]).map_err(text)?;
    let told = answers.first().map(|answer| Told::new(&wanted, answer, &vehicle));
    let told = told.ok_or("the bench did not answer")?;
    if told.refused.is_some() { Err(told.sentence()) } else { Ok(told.sentence()) }
}

/// Inputs that belong to stick positions: from -1 to 1 between the limits of each input, 0 at neutral.
fn deflected(vehicle: &Vehicle, at: &BTreeMap<String, f64>) -> Result<[f64; MAX_INPUTS], String> {
    let mut u = [0.0; MAX_INPUTS];
    for (u, input) in u.iter_mut().zip(&vehicle.inputs) {
        *u = input.neutral();
    }
    for (name, share) in at {
        let index = vehicle.inputs.iter().position(|input| input.name == *name);
        let index =
            index.filter(|i| *i < MAX_INPUTS).ok_or_else(|| format!("the vehicle has no input '{name}'"))?;
        let input = &vehicle.inputs[index];
        if !(-1.0..=1.0).contains(share) {
            return Err(format!("the stick on {name} goes from -1 to 1, not to {share}"));
        }
        let end = if *share < 0.0 { input.lower } else { input.upper };
        if !end.is_finite() {
            return Err(format!("{name} has no limit in the vehicle file, so it has no stick"));
        }
        u[index] = input.neutral() + share.abs() * (end - input.neutral());
    }
    Ok(u)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stick_goes_to_the_limits_and_not_beyond() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let (name, upper) = (vehicle.inputs[1].name.clone(), vehicle.inputs[1].upper);
        let at = |share: f64| deflected(&vehicle, &BTreeMap::from([(name.clone(), share)]));
        assert_eq!(at(0.5).unwrap()[..2], [vehicle.inputs[0].neutral(), 0.5 * upper]);
        assert_eq!(at(-1.0).unwrap()[1], vehicle.inputs[1].lower);
        assert!(at(1.01).unwrap_err().contains("-1 to 1") && at(f64::NAN).is_err());
        let unknown = deflected(&vehicle, &BTreeMap::from([("u_wings".into(), 0.0)]));
        assert!(unknown.unwrap_err().contains("no input 'u_wings'"));
    }
}
