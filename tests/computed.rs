//! Whole-process tests that keep the processors busy: records, campaigns, benches in lockstep. One more runs at a
//! time than there are processors.

mod any_vehicle;
mod blind;
mod campaign;
mod cli;
mod cluster;
mod compensation;
mod determinism;
mod diagnose;
mod divergence;
mod docs;
mod edges;
mod excite;
mod exclusive;
mod extended_design;
mod faults;
mod fmi;
mod foreign_logs;
mod hard_vehicles;
mod identify;
mod in_flight;
mod lockstep_waits;
mod measured;
mod mirror;
mod rejection;
mod relays;
mod support;
mod tune;
mod units;
mod vehicle_new;
mod waits;

// The longest first, so that none is left to run alone at the end.
whirlstand_test_harness::suites!(
    whirlstand_test_harness::run:
    vehicle_new,
    faults,
    rejection,
    tune,
    cluster,
    mirror,
    blind,
    lockstep_waits,
    determinism,
    campaign,
    diagnose,
    relays,
    identify,
    docs,
    compensation,
    exclusive,
    edges,
    waits,
    extended_design,
    cli,
    in_flight,
    excite,
    fmi,
    any_vehicle,
    units,
    foreign_logs,
    measured,
    divergence,
    hard_vehicles,
);
