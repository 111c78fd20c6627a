//! Diagnoses of simulated records.

mod devices;
mod diagnose;
mod diagnose_alike;
mod diagnose_together;
mod flight_records;
mod gaps;
mod hover;
mod random_force;
mod screen;
mod support;
mod wandering_zeros;
