//! What the bus adds to bare iceoryx2: the same ring of three processes, measured in turn.
//!
//! `cargo run --release -p whirlstand-bus --example ring -- [LAPS]`

use std::error::Error;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use whirlstand_bus::ring::{POSITIONS, Ring};
use whirlstand_bus::{BusConfig, Transport, WaitStrategy, remove_residue};

const ROUNDS: usize = 3;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [position, kind, bench, laps, connect] = arguments.as_slice() {
        return member(position.parse()?, kind, bench, laps.parse()?, connect);
    }
    let laps: u64 = arguments.first().map_or(Ok(200_000), |a| a.parse())?;
    let mut best = [Duration::MAX; 3];
    for _ in 0..ROUNDS {
        for (kind, best) in ["bare", "iceoryx2", "zenoh"].into_iter().zip(&mut best) {
            let laps = if kind == "zenoh" { laps / 20 } else { laps };
            let lap = ring(kind, laps)? / u32::try_from(laps)?;
            println!("{kind:>9} {:8.2} us a lap", lap.as_secs_f64() * 1e6);
            *best = lap.min(*best);
        }
    }
    println!("bus over iceoryx2 / bare: {:.2}", best[1].as_secs_f64() / best[0].as_secs_f64());
    Ok(())
}

/// Runs one ring; position 0 is a child as well, and prints the time.
fn ring(kind: &str, laps: u64) -> Result<Duration, Box<dyn Error>> {
    let bench = format!("ring-{kind}-{}", std::process::id());
    let ports: Vec<String> = (0..POSITIONS)
        .map(|_| Ok(format!("tcp/{}", std::net::TcpListener::bind("127.0.0.1:0")?.local_addr()?)))
        .collect::<std::io::Result<_>>()?;
    let mut members: Vec<Child> = (0..POSITIONS)
        .rev()
        .map(|position| {
            Command::new(std::env::current_exe()?)
                .args([&position.to_string(), kind, &bench, &laps.to_string(), &ports.join(",")])
                .stdout(Stdio::piped())
                .spawn()
        })
        .collect::<std::io::Result<_>>()?;
    let lead = members.pop().ok_or("no lead")?.wait_with_output()?;
    for mut member in members {
        member.wait()?;
    }
    remove_residue(&bench)?;
    let nanoseconds = String::from_utf8(lead.stdout)?.trim().parse()?;
    Ok(Duration::from_nanos(nanoseconds))
}

fn member(position: usize, kind: &str, bench: &str, laps: u64, ports: &str) -> Result<(), Box<dyn Error>> {
    let transport = if kind == "zenoh" { Transport::Zenoh } else { Transport::Iceoryx2 };
    let mut bus = BusConfig::new(bench, format!("member-{position}"), transport);
    let ports: Vec<String> = ports.split(',').map(Into::into).collect();
    bus.zenoh.listen = vec![ports[position].clone()];
    bus.zenoh.connect = ports[..position].to_vec();
    bus.wait = WaitStrategy::lockstep();
    let ring = Ring { bus, bare: kind == "bare", laps };
    if let Some(elapsed) = ring.run(position)? {
        println!("{}", elapsed.as_nanos());
    }
    Ok(())
}
