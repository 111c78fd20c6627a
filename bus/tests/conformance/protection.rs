//! A protected bench over Zenoh: only its members take part, and each publishes what is its own.

use std::time::{Duration, Instant};

use whirlstand_bus::{
    Authority, Bus, BusConfig, Member, Protection, RecvError, Refusal, Transport, Writes, spoken_key,
    zenoh_configuration,
};
use whirlstand_msgs::{Command, Health, Imu, encode};
use zenoh::Wait;

use crate::stage::{PATIENCE, Stage, at, next, until_heard};

/// How long a stranger knocks: many times the 20 ms after which Zenoh tries a connection again.
const KNOCKING: Duration = Duration::from_millis(500);

fn only(topics: &[&str]) -> Writes {
    Writes::Only(topics.iter().map(|t| (*t).into()).collect())
}

/// A bench with a plant, a controller and an observer.
struct Bench {
    stage: Stage,
    authority: Authority,
}

impl Bench {
    fn new(test: &str) -> Self {
        Self { stage: Stage::new(Transport::Zenoh, test), authority: Authority::new(test).unwrap() }
    }

    fn config(&self, name: &str) -> BusConfig {
        self.vouched_for(name, &self.authority)
    }

    fn vouched_for(&self, name: &str, authority: &Authority) -> BusConfig {
        let members =
            [("plant", only(&["imu"])), ("controller", only(&["command"])), ("observer", Writes::Nothing)];
        let mut config = self.stage.config(name);
        config.zenoh.protection = Some(Protection {
            identity: authority.issue(name, &["127.0.0.1".into()]).unwrap(),
            members: members.map(|(name, writes)| Member { name: name.into(), writes }).into(),
        });
        config
    }

    /// Joins, as all that come later connect to.
    fn join(&self, name: &str) -> Bus {
        self.stage.join_as(&self.config(name))
    }
}

/// The same configuration with the endpoints of those that listen in plain text.
fn in_plain_text(mut config: BusConfig) -> BusConfig {
    config.zenoh.protection = None;
    config.zenoh.connect.iter_mut().for_each(|e| *e = e.replace("tls/", "tcp/"));
    config
}

pub fn whoever_has_no_key_of_the_bench_is_kept_out() {
    let bench = Bench::new("members");
    let plant = bench.join("plant");
    assert!(plant.locators()[0].starts_with("tls/127.0.0.1:"), "{:?}", plant.locators());
    let mut commands = plant.subscriber::<Command>(64).unwrap();
    let mut imu = plant.publisher::<Imu>().unwrap();
    let controller = bench.join("controller");
    let mut own = controller.publisher::<Command>().unwrap();

    let foreign = Authority::new("somebody else").unwrap();
    let mut without_certificate = in_plain_text(bench.config("controller"));
    without_certificate.zenoh.connect = bench.config("x").zenoh.connect;
    let strangers = [
        ("in plain text", in_plain_text(bench.config("controller"))),
        ("over TLS without a certificate", without_certificate),
        ("with a certificate of another bench", bench.vouched_for("controller", &foreign)),
        // Vouched for by the bench, but of a name that is in no list.
        ("as an unknown member", bench.config("mallory")),
    ];
    let strangers: Vec<_> = strangers
        .into_iter()
        .map(|(how, config)| {
            let bus = Bus::open(&config).unwrap();
            let (publisher, subscriber) =
                (bus.publisher::<Command>().unwrap(), bus.subscriber::<Imu>(64).unwrap());
            (how, bus, publisher, subscriber)
        })
        .collect();
    until_heard(&controller, &mut own);
    let mut strangers = strangers;
    let (until, mut step) = (Instant::now() + KNOCKING, 0);
    while Instant::now() < until {
        for (_, _, publisher, _) in &mut strangers {
            publisher.send(&at(1_000_000)).unwrap();
        }
        imu.send(&at(step)).unwrap();
        own.send(&at(step)).unwrap();
        assert_eq!(next(&plant, &mut commands).head.step, step, "only the controller is heard");
        step += 1;
    }
    for (how, _, _, subscriber) in &mut strangers {
        assert!(matches!(subscriber.try_recv(), Ok(None)), "{how}: nothing is heard either");
    }
}

pub fn a_member_publishes_its_own_topics_only() {
    let bench = Bench::new("roles");
    let plant = bench.join("plant");
    let mut commands = plant.subscriber::<Command>(8).unwrap();
    let mut imus = plant.subscriber::<Imu>(8).unwrap();
    let controller = bench.join("controller");
    let mut allowed = controller.publisher::<Command>().unwrap();
    let mut forbidden = controller.publisher::<Imu>().unwrap();
    let observer = bench.join("observer");
    let mut watching = observer.subscriber::<Command>(8).unwrap();
    let mut meddling = observer.publisher::<Command>().unwrap();
    until_heard(&controller, &mut allowed);
    until_heard(&controller, &mut forbidden);
    until_heard(&observer, &mut meddling);
    let mut step = 0;
    let patience = Instant::now() + PATIENCE;
    loop {
        meddling.send(&at(1_000_000)).unwrap();
        forbidden.send(&at(step)).unwrap();
        allowed.send(&at(step)).unwrap();
        // One link, one order: what is forbidden would have come first.
        assert_eq!(next(&plant, &mut commands).head.step, step);
        assert!(imus.try_recv().unwrap().is_none());
        step += 1;
        // An observer hears what is said once its subscription is known.
        if step > 10 && watching.try_recv().unwrap().is_some() {
            break;
        }
        assert!(Instant::now() < patience, "the observer hears nothing");
    }
}

/// The plant is the one that connects here: it must know who answers where the controller listened.
pub fn whoever_answers_a_member_is_known_as_well() {
    let bench = Bench::new("answers");
    let impostor = bench.stage.join_as(&bench.vouched_for("controller", &Authority::new("other").unwrap()));
    let observer = bench.join("observer");
    let mut forged = [impostor, observer].map(|bus| (bus.publisher::<Command>().unwrap(), bus));
    let controller = bench.join("controller");
    let mut own = controller.publisher::<Command>().unwrap();
    let plant = bench.join("plant");
    let mut commands = plant.subscriber::<Command>(64).unwrap();
    until_heard(&controller, &mut own);
    let (until, mut step) = (Instant::now() + KNOCKING, 0);
    while Instant::now() < until {
        forged.iter_mut().for_each(|(publisher, _)| publisher.send(&at(1_000_000)).unwrap());
        own.send(&at(step)).unwrap();
        assert_eq!(next(&plant, &mut commands).head.step, step);
        step += 1;
    }
}

/// A health of the plant, as somebody may write it.
fn health_of_the_plant(step: u64) -> Health {
    let mut health: Health = at(step);
    health.set_node_name("plant");
    health
}

pub fn health_is_taken_from_the_node_that_it_speaks_of() {
    let bench = Bench::new("health");
    let observer = bench.join("observer");
    let mut heard = observer.subscriber::<Health>(64).unwrap();
    let plant = bench.join("plant");
    let mut own = plant.publisher::<Health>().unwrap();
    let controller = bench.join("controller");
    let mut in_its_name = controller.publisher::<Health>().unwrap();
    until_heard(&plant, &mut own);
    until_heard(&controller, &mut in_its_name);

    in_its_name.send(&health_of_the_plant(7)).unwrap();
    let mut refused = None;
    observer
        .wait_until(Instant::now() + PATIENCE, || {
            refused = heard.try_recv().err();
            Ok::<_, RecvError>(refused.is_some())
        })
        .unwrap();
    let Some(RecvError::Refused { source: Refusal::Speaker { said, from }, .. }) = refused else {
        panic!("{refused:?}");
    };
    assert_eq!((said.as_str(), from.as_str()), ("plant", "controller"));

    // The plant's own key is closed to the controller's certificate, whatever program uses it.
    let config =
        zenoh::Config::from_json5(&zenoh_configuration(&bench.config("controller")).unwrap()).unwrap();
    let session = zenoh::open(config).wait().unwrap();
    let key = spoken_key(&bench.stage.name, "health", "plant");
    let forger = session.declare_publisher(key).wait().unwrap();
    let patience = Instant::now() + PATIENCE;
    while !forger.matching_status().wait().unwrap().matching() {
        assert!(Instant::now() < patience, "the forger finds nobody");
        std::thread::yield_now();
    }
    let mut wire = Vec::new();
    for step in 0..100 {
        encode(&health_of_the_plant(1_000_000), &mut wire);
        forger.put(wire.clone()).wait().unwrap();
        own.send(&health_of_the_plant(step)).unwrap();
        assert_eq!(next(&observer, &mut heard).head.step, step);
    }
}
