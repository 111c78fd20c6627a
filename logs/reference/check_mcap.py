#!/usr/bin/env python3
"""Reads a Whirlstand log with the public packages `mcap` and `mcap-ros2-support`, as any user would.

    check_mcap.py LOG              a finished log: read through its index
    check_mcap.py LOG --truncated  a log whose recorder was killed: read from the start to where it ends

Prints what was found as JSON on one line; exits with 1 and a sentence when something is not as it should be.
"""

import argparse
import json
import math
import sys

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory


def finished(file):
    """Messages, metadata and attachments through the index, as Foxglove reads them."""
    reader = make_reader(file, validate_crcs=True)
    metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    attached = {a.name: a.data for a in reader.iter_attachments()}
    messages = ((s, c, m) for s, c, m in reader.iter_messages(log_time_order=False))
    return metadata, attached, list(messages)


def truncated(file):
    """Records in file order until the file breaks off."""
    metadata, attached, schemas, channels, messages = {}, {}, {}, {}, []
    records = StreamReader(file, validate_crcs=True).records
    while True:
        try:
            record = next(records)
        except StopIteration:
            break
        except (McapError, EOFError) as error:
            print(f"the file ends with: {type(error).__name__} {error}", file=sys.stderr)
            break
        if isinstance(record, Metadata):
            metadata[record.name] = record.metadata
        elif isinstance(record, Attachment):
            attached[record.name] = record.data
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            messages.append((schemas[channel.schema_id], channel, record))
    return metadata, attached, messages


def check(metadata, attached, messages):
    """Decodes every message by the schema in the log and compares what must agree."""
    info = metadata["whirlstand"]
    for key in ("version", "seed", "period_ns", "states", "inputs", "outputs"):
        assert key in info, f"the metadata has no {key}"
    states, inputs = ([s["name"] for s in json.loads(info[key])] for key in ("states", "inputs"))
    factory, decoders, topics = DecoderFactory(), {}, {}
    for schema, channel, message in messages:
        assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr", channel
        if schema.id not in decoders:
            decoders[schema.id] = factory.decoder_for(channel.message_encoding, schema)
        decoded = decoders[schema.id](message.data)
        topic = topics.setdefault(channel.topic, {"count": 0, "last_step": 0, "sum": 0.0})
        topic["count"] += 1
        topic["last_step"] = decoded.head.step
        assert decoded.head.seq & 0xFFFFFFFF == message.sequence, f"{channel.topic}: sequence number"
        assert message.publish_time == message.log_time, f"{channel.topic}: one clock"
        # What a node says of itself has the wall clock's time.
        assert channel.topic == "/health" or decoded.head.stamp_ns == message.log_time, f"{channel.topic}: time stamp"
        if channel.topic == "/imu":
            topic["sum"] += decoded.roll
        elif channel.topic == "/truth":
            # A state is found by its name; what the vehicle has no signal for follows.
            assert len(decoded.x.unused) == 16 - len(states) and len(decoded.u.unused) == 8 - len(inputs)
            topic["sum"] += getattr(decoded.x, states[0])
        assert math.isfinite(topic["sum"])
    return {
        "metadata": {k: info[k] for k in ("version", "seed", "vehicle", "launch")},
        "attached": {name: len(data) for name, data in sorted(attached.items())},
        "topics": topics,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log")
    parser.add_argument("--truncated", action="store_true")
    arguments = parser.parse_args()
    with open(arguments.log, "rb") as file:
        found = (truncated if arguments.truncated else finished)(file)
    try:
        print(json.dumps(check(*found)))
    except AssertionError as error:
        sys.exit(f"{arguments.log}: {error}")


if __name__ == "__main__":
    main()
