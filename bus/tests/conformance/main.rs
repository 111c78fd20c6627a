//! The conformance suite: what holds on every transport. Each body is generic, and instantiated for each. Beside
//! it: what only one transport has, and the Python examples.

mod faults;
mod flow;
mod python;
mod residue;
mod schema;
mod stage;
mod zenoh_settings;

/// One test for each body and transport.
macro_rules! conformance {
    ($($suite:ident::$test:ident),+ $(,)?) => {
        conformance!(@on iceoryx2 Iceoryx2 $($suite::$test)+);
        conformance!(@on zenoh Zenoh $($suite::$test)+);
        conformance!(@on inproc Inproc $($suite::$test)+);
    };
    (@on $module:ident $transport:ident $($suite:ident::$test:ident)+) => {
        mod $module {
            $(
                #[test]
                fn $test() {
                    crate::$suite::$test(whirlstand_bus::Transport::$transport);
                }
            )+
        }
    };
}

conformance!(
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

/// Not a test: what this program does when a test starts it again as a peer.
#[test]
fn peer_process() {
    faults::run_peer();
}
