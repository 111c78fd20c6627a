//! `whirlstand watch` and `whirlstand play`: a running bench, or a finished log, on the live page or in the
//! terminal.

use std::cell::{Cell, RefCell};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use whirlstand_live::{Collector, Control, Controls, Hub, LogFeed, Playback, Scene, Server, Terminal};
use whirlstand_logs::Log;
use whirlstand_vehicle::Vehicle;

use crate::cli::{PlayArgs, WatchArgs};
use crate::error::Failure;
use crate::live::{BenchCard, LiveAddresses, LivePage, Look, Seen};
use crate::style;
use crate::supervisor::Signals;

/// Runs `whirlstand watch`.
pub(crate) fn watch(args: &WatchArgs) -> Result<ExitCode, Failure> {
    let card = BenchCard::find(&args.bench)?;
    let bench = &args.bench.name;
    let over = format!("bench {bench} is over");
    if args.tui {
        let hub = Hub::default();
        let look = Look::begin(&card, bench, &hub, None)?;
        let mut terminal = Terminal::open(&hub).map_err(no_terminal)?;
        let left = Cell::new(false);
        let seen = look.until_over(
            false,
            || left.get(),
            // A failure of the terminal ends the view, as the user's key does.
            |until| left.set(terminal.turn(until).unwrap_or(true)),
        );
        drop(terminal);
        return ended(seen?, &over);
    }
    let addresses = LiveAddresses { page: Some(args.listen), foxglove: args.foxglove };
    let Some(page) = LivePage::open(addresses)? else { return Ok(ExitCode::SUCCESS) };
    let look = page.begin(&card, bench)?;
    page.hand_over(&card);
    page.announce();
    let signals = Signals::take().map_err(|e| Failure::Run(format!("cannot handle signals: {e}")))?;
    let (signals, told) = (RefCell::new(signals), Cell::new(false));
    let seen = look.until_over(
        false,
        || {
            told.set(told.get() || signals.borrow_mut().next().is_some());
            told.get()
        },
        // A failure of the system to wait ends the view, as a signal does.
        |until| {
            let longest = until.saturating_duration_since(Instant::now());
            told.set(told.get() || signals.borrow().wait(longest).is_err());
        },
    )?;
    page.end(if seen == Seen::Over { &over } else { "whirlstand watch has ended" });
    ended(seen, &over)
}

fn ended(seen: Seen, over: &str) -> Result<ExitCode, Failure> {
    if seen == Seen::Over {
        style::say(over);
    }
    Ok(ExitCode::SUCCESS)
}

fn no_terminal(error: std::io::Error) -> Failure {
    Failure::Mend(format!("no terminal to draw in ({error}): omit --tui to get a page for a browser"))
}

/// Runs `whirlstand play`.
pub(crate) fn play(args: &PlayArgs) -> Result<ExitCode, Failure> {
    let log = Log::open(&args.log).map_err(Failure::mend)?;
    let playback = Playback::new(args.speed).map_err(|e| Failure::Mend(format!("--speed: {e}")))?;
    let (scene, vehicle) = scene_of(&log)?;
    let hub = Hub::default();
    let collector = Collector::new(scene, &vehicle, false);
    if args.tui {
        let mut terminal = Terminal::open(&hub).map_err(no_terminal)?;
        let mut feed = LogFeed::open(log, collector, hub, playback).map_err(Failure::mend)?;
        while !feed.is_at_end() {
            let next = feed.turn(Instant::now()).map_err(Failure::mend)?;
            if terminal.turn(next).map_err(no_terminal)? {
                break;
            }
        }
        return Ok(ExitCode::SUCCESS);
    }
    let steered = playback.clone();
    let act = move |control: &Control| match control {
        Control::Play { key, value } => steered.set(key, *value).map(|()| format!("{key} {value}")),
        _ => Err("a finished log accepts no commands".into()),
    };
    let server = Server::start(args.listen, hub.clone(), act).map_err(Failure::mend)?;
    let mut feed = LogFeed::open(log, collector, hub.clone(), playback).map_err(Failure::mend)?;
    style::say(&format!("live page {} (Ctrl-C ends it)", server.url()));
    let mut signals = Signals::take().map_err(|e| Failure::Run(format!("cannot handle signals: {e}")))?;
    while signals.next().is_none() {
        let next = feed.turn(Instant::now()).map_err(Failure::mend)?;
        let longest = next.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
        signals.wait(longest).map_err(|e| Failure::Run(format!("cannot handle signals: {e}")))?;
    }
    hub.end("whirlstand play has ended");
    Ok(ExitCode::SUCCESS)
}

/// The scene and the vehicle of a bench's log.
fn scene_of(log: &Log) -> Result<(Scene, Vehicle), Failure> {
    let path = log.path().display().to_string();
    let (Some(info), Some(text)) = (log.info(), log.vehicle_text()) else {
        return Err(Failure::Mend(format!(
            "{path} is not a bench log that contains its vehicle file; use whirlstand compare for other logs"
        )));
    };
    let vehicle = Vehicle::parse(text, &path)
        .map_err(|e| Failure::Mend(format!("the vehicle file in {path} cannot be used: {e}")))?;
    let subtitle = format!("log {path}: {}, {} over {}", vehicle.name, info.mode, info.transport);
    Ok((Scene::new(&info.launch, &subtitle, info.period_ns, &vehicle, Controls::Log), vehicle))
}
