//! The bridges without a wire: autopilots and vehicles at their other end are the tests' own.

mod autopilot_axes;
mod support;
mod vehicle_axes;
mod vehicle_in_charge;
mod vehicle_links;
mod vehicle_safety;
mod vehicle_sent;
mod vehicle_streams;
