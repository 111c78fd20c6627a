#!/usr/bin/env python3
"""Reads what a log holds for panels, with public packages and by the schemas in the log, and prints it as JSON.

    log.py out/log.mcap
"""

import json
import math
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as RosFactory


def angles(q):
    """Roll, pitch and yaw of a turn in axes forward, left and up, positive to the right, nose up and nose to the right."""
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x**2 + q.y**2))
    pitch = -math.asin(2 * (q.w * q.y - q.z * q.x))
    yaw = -math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    return roll, pitch, yaw


def main(path):
    schemas, frames, events, scenes, truths, poses = {}, {}, [], [], {}, []
    misplaced = 0
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[ProtobufFactory(), RosFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            schemas[channel.topic] = schema.name
            at = message.log_time
            stamps = []
            if channel.topic == "/truth":
                truths[at] = decoded.x
            elif channel.topic == "/tf":
                for t in decoded.transforms:
                    stamps.append(t.timestamp)
                    frames[t.child_frame_id] = frames.get(t.child_frame_id, 0) + 1
                    if t.child_frame_id == "vehicle":
                        poses.append((at, angles(t.rotation)))
            elif channel.topic == "/scene":
                stamps = [e.timestamp for e in decoded.entities]
                scenes.append([[len(e.cubes), len(e.cylinders), e.frame_id] for e in decoded.entities])
            elif channel.topic == "/log":
                stamps = [decoded.timestamp]
                events.append([at / 1e9, decoded.message])
            misplaced += sum(s.seconds * 10**9 + s.nanos != at for s in stamps)
    worst = max(
        (abs(a - getattr(truths[at], name)) for at, pose in poses for a, name in zip(pose, ("roll", "pitch", "yaw"))
         if hasattr(truths[at], name)),
        default=None,
    )
    print(json.dumps({
        "schemas": schemas,
        "frames": frames,
        "events": events,
        "scenes": scenes,
        "worst_angle": worst,
        "misplaced": misplaced,
        "end_s": max(truths) * 1e-9,
    }))


if __name__ == "__main__":
    main(*sys.argv[1:])
