#!/usr/bin/env python3
"""Reads `Estimate` live over Zenoh, and with --control replaces the controller.

In a launch file with transport = "zenoh":

    [nodes.controller]
    exec = ["python3", "estimate_zenoh.py", "--control"]

By hand, beside a running bench: python3 estimate_zenoh.py --bench NAME --config "$(whirlstand keys show NAME --path)"
"""

import json
import os
import queue

# Zenoh 1.10 reads and writes a TLS stream on two threads, which breaks a link now and then, unless it is told not to.
os.environ.setdefault("ZENOH_RUNTIME", "(rx: (handover: tx), tx: (worker_threads: 1))")

import zenoh

from whirlstand_messages import Command, Estimate
from whirlstand_node import Node


def configuration(node: Node) -> zenoh.Config:
    """A peer that scouts nothing and listens on loopback only, as Whirlstand's own nodes are, with the key that it was
    given."""
    if node.config:
        config = zenoh.Config.from_file(node.config)
    else:
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("scouting/gossip/enabled", "false")
        config.insert_json5("listen/endpoints", json.dumps(node.listen or ["tcp/127.0.0.1:0"]))
    if node.connect or not node.config:
        config.insert_json5("connect/endpoints", json.dumps(node.connect))
    return config


def main():
    node = Node(__doc__)
    key = f"whirlstand/{node.bench}/"
    with zenoh.open(configuration(node)) as session:
        arrived: queue.SimpleQueue = queue.SimpleQueue()
        session.declare_subscriber(key + Estimate.TOPIC, arrived.put)
        commands = None
        if node.control:
            commands = session.declare_publisher(
                key + Command.TOPIC,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
        node.ready()
        while not node.ended:
            try:
                sample = arrived.get(timeout=0.1)
            except queue.Empty:
                continue
            estimate = Estimate.decode(sample.payload.to_bytes())
            if commands is not None:
                commands.put(node.command(estimate).encode())
            node.show(estimate)


if __name__ == "__main__":
    main()
