#!/usr/bin/env python3
"""Reads `Estimate` live over iceoryx2, and with --control replaces the controller.

In a launch file with transport = "iceoryx2":

    [nodes.controller]
    exec = ["python3", "estimate_iceoryx2.py", "--control"]

By hand, beside a running bench: python3 estimate_iceoryx2.py --bench NAME
"""

import iceoryx2 as iox2

from whirlstand_messages import Command, Estimate
from whirlstand_node import Node, pause

# The settings with which Whirlstand's nodes make and open a topic; all must ask for the same.
MAX_PUBLISHERS = 8
MAX_SUBSCRIBERS = 8
MAX_NODES = 32
MAX_DEPTH = 1024


def join(node: Node) -> iox2.Node:
    """Joins the bench, which is an iceoryx2 domain of its own: prefix and root path carry its name."""
    config = iox2.config.default()
    config.global_cfg.prefix = iox2.FileName.new(f"whirlstand.{node.bench}~")
    config.global_cfg.root_path = iox2.Path.new(f"/tmp/whirlstand.{node.bench}/")
    return (
        iox2.NodeBuilder.new()
        .name(iox2.NodeName.new(node.name))
        .config(config)
        .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
        .create(iox2.ServiceType.Ipc)
    )


def topic(member: iox2.Node, bench: str, message):
    """Opens or makes a topic; a node with another version of the message is refused here."""
    schema = iox2.AttributeVerifier.new().require(
        iox2.AttributeKey.new("whirlstand.schema"), iox2.AttributeValue.new(f"{message.SCHEMA_HASH:#018x}")
    )
    return (
        member.service_builder(iox2.ServiceName.new(f"whirlstand/{bench}/{message.TOPIC}"))
        .publish_subscribe(message)
        .max_publishers(MAX_PUBLISHERS)
        .max_subscribers(MAX_SUBSCRIBERS)
        .max_nodes(MAX_NODES)
        .subscriber_max_buffer_size(MAX_DEPTH)
        .subscriber_max_borrowed_samples(2)
        .history_size(0)
        .enable_safe_overflow(True)
        .open_or_create_with_attributes(schema)
    )


def main():
    node = Node(__doc__)
    iox2.set_log_level_from_env_or(iox2.LogLevel.Fatal)
    member = join(node)
    estimates = topic(member, node.bench, Estimate).subscriber_builder().buffer_size(16).create()
    commands = None
    if node.control:
        commands = topic(member, node.bench, Command).publisher_builder().create()
    node.ready()
    while not node.ended:
        sample = estimates.receive()
        if sample is None:
            pause()
            continue
        estimate = Estimate.from_buffer_copy(sample.payload().contents)
        sample.delete()
        if commands is not None:
            commands.send_copy(node.command(estimate))
        node.show(estimate)


if __name__ == "__main__":
    main()
