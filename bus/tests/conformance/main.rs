//! The conformance suite: what holds on every transport. Each body is generic, and instantiated for each. Beside
//! it: what only one transport has, and the Python examples.

mod faults;
mod flow;
mod protection;
mod python;
mod residue;
mod schema;
mod stage;
mod zenoh_settings;

use std::process::ExitCode;

use whirlstand_bus::Transport;
use whirlstand_test_harness::{Outcome, Test, run};

/// The body of a test that every transport passes.
type Body = fn(Transport);

/// The body of a test that needs a Python.
type PythonBody = fn() -> Outcome;

/// A list of functions with their names.
macro_rules! named {
    ($($suite:ident::$test:ident),+ $(,)?) => { [$((stringify!($suite::$test), $suite::$test)),+] };
}

/// What every transport passes.
const CONFORMANCE: &[(&str, Body)] = &named!(
    flow::every_message_arrives_as_it_was_sent,
    flow::messages_keep_their_order,
    flow::several_publishers_share_a_topic,
    flow::a_message_sent_again_keeps_its_number,
    flow::a_late_joiner_hears_nothing_from_before,
    flow::a_full_queue_loses_the_oldest_and_counts,
    flow::other_topics_of_the_same_type_are_apart,
    flow::two_benches_do_not_meet,
    flow::waiting_ends_with_a_message_or_at_the_deadline,
    flow::a_subscriber_that_left_is_not_missed,
    faults::a_killed_publisher_can_be_started_again,
    faults::a_killed_subscriber_disturbs_nobody,
    faults::a_stopped_subscriber_does_not_block_the_sender,
    schema::another_version_of_a_message_is_refused,
    schema::impossible_names_and_depths_are_refused,
);

/// What only one transport has.
const OF_ONE_TRANSPORT: &[(&str, fn())] = &named!(
    residue::nothing_is_left_of_killed_nodes,
    residue::what_is_in_use_stays,
    residue::whoever_leaves_last_clears_up,
    residue::a_node_killed_while_it_joins_leaves_a_usable_bench,
    residue::a_stale_bench_is_told_and_a_live_one_is_not,
    residue::the_pages_of_a_segment_are_taken_when_it_is_made,
    zenoh_settings::access_control_of_the_configuration_file_is_obeyed,
    zenoh_settings::endpoints_are_told_and_faults_are_named,
    protection::whoever_has_no_key_of_the_bench_is_kept_out,
    protection::a_member_publishes_its_own_topics_only,
    protection::whoever_answers_a_member_is_known_as_well,
    protection::health_is_taken_from_the_node_that_it_speaks_of,
    zenoh_settings::a_bench_has_one_launcher_at_a_time,
);

/// The examples in Python.
const PYTHON: &[(&str, PythonBody)] = &named!(python::over_zenoh, python::over_iceoryx2);

/// This program is also the peers that its tests start.
fn main() -> ExitCode {
    let (name, value) = whirlstand_bus::ONE_THREAD;
    // SAFETY: no other thread runs yet.
    unsafe { std::env::set_var(name, value) };
    if let Some(role) = std::env::var_os(stage::PEER) {
        faults::run_peer(&role.to_string_lossy());
        return ExitCode::SUCCESS;
    }
    let transports = [Transport::Iceoryx2, Transport::Zenoh, Transport::Inproc];
    let conformance = transports.into_iter().flat_map(|transport| {
        let named = move |(name, body): &(&str, Body)| {
            let body = *body;
            Test::new(&format!("{transport}::{name}"), move || body(transport))
        };
        CONFORMANCE.iter().map(named)
    });
    let single = OF_ONE_TRANSPORT.iter().map(|(name, body)| Test::new(name, *body));
    let python = PYTHON.iter().map(|(name, body)| Test::new(name, *body));
    run(conformance.chain(single).chain(python).collect())
}
