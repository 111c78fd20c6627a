"""A controller as it would be in ROS 2, of packages that know nothing of Whirlstand: Zenoh, and rosbags for CDR and type hashes.

It listens where a router of rmw_zenoh would, checks what is published against the types of ROS 2, answers each
sensor_msgs/Imu with a command, and leaves a report when it is asked to end."""

import argparse
import json
import math
import queue
import signal
import struct
import time

import numpy
import zenoh
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
DOMAIN = 7
COMMAND = "std_msgs/msg/Float64MultiArray"
# What is published, by topic.
TYPES = {
    "imu": "sensor_msgs/msg/Imu",
    "odom": "nav_msgs/msg/Odometry",
    "tf": "tf2_msgs/msg/TFMessage",
    "viewer/imu": "sensor_msgs/msg/Imu",
    "viewer/odom": "nav_msgs/msg/Odometry",
}
# u = -K x in rad and rad/s, as in examples/python; x is of flight: nose up is positive.
GAIN = [[-300.0, -202.0, -90.0, -15.0], [49.0, 31.0, -321.0, -57.0]]
LIMIT = 20.0


def mangled(type_name: str) -> str:
    package, _, name = type_name.split("/")
    return f"{package}::msg::dds_::{name}_"


def angles(q) -> tuple[float, float]:
    """Roll and pitch of a quaternion, as tf2 has them."""
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x * q.x + q.y * q.y))
    return roll, math.asin(2 * (q.w * q.y - q.z * q.x))


class Check:
    """What was seen, and what of it was wrong."""

    def __init__(self):
        self.faults: list[str] = []
        self.counts: dict[str, int] = {}
        # The last number of every publisher, by topic and publisher.
        self.numbers: dict[tuple[str, bytes], int] = {}

    def must(self, right: bool, text: str):
        if not right and len(self.faults) < 10:
            self.faults.append(text)

    def message(self, sample):
        """The topic and the decoded message."""
        parts = str(sample.key_expr).split("/")
        topic = "/".join(parts[1:-2])
        name = TYPES[topic]
        self.must(parts[0] == str(DOMAIN), f"domain {parts[0]}")
        self.must(parts[-2] == mangled(name), f"{topic}: type {parts[-2]}")
        self.must(parts[-1] == STORE.hash_rihs01(name), f"{topic}: hash {parts[-1]}")
        self.counts[topic] = self.counts.get(topic, 0) + 1
        attachment = sample.attachment.to_bytes() if sample.attachment else b""
        self.must(len(attachment) == 33, f"{topic}: attachment of {len(attachment)} bytes")
        if len(attachment) == 33:
            number, stamp, length = struct.unpack_from("<qqB", attachment)
            publisher = (topic, attachment[17:])
            before = self.numbers.get(publisher)
            self.must(before is None or number > before, f"{topic}: number {number} after {before}")
            self.must(length == 16 and abs(stamp * 1e-9 - time.time()) < 600, f"{topic}: {length}, {stamp}")
            self.numbers[publisher] = number
        data = sample.payload.to_bytes()
        message = STORE.deserialize_cdr(data, name)
        again = bytes(STORE.serialize_cdr(message, name))
        self.must(again == data, f"{topic}: written again it is {len(again)} bytes, and {len(data)} were sent")
        return topic, message

    def tokens(self, found: set[str]):
        """What `ros2 topic list` goes by."""
        nodes = [t for t in found if "/NN/" in t]
        self.must(sorted(t.split("/NN/")[1] for t in nodes) == ["%/%/whirlstand", "%/%viewer/whirlstand"], f"{nodes}")
        wanted = [("MP", topic, name) for topic, name in TYPES.items()] + [("MS", "command", COMMAND)]
        for entity, topic, name in wanted:
            namespace = "%viewer" if topic.startswith("viewer/") else "%"
            end = (
                f"/{entity}/%/{namespace}/whirlstand/%{topic.replace('/', '%')}/{mangled(name)}/"
                f"{STORE.hash_rihs01(name)}/::,:,:,:,,"
            )
            ours = [t for t in found if t.startswith(f"@ros2_lv/{DOMAIN}/") and t.endswith(end)]
            self.must(len(ours) >= 1, f"no token ends with {end}")
        for token in found:
            self.must(len(token.split("/")) in (9, 13), f"{token}: {len(token.split('/'))} parts")


def command(imu) -> bytes:
    roll, pitch = angles(imu.orientation)
    x = [roll, imu.angular_velocity.x, -pitch, -imu.angular_velocity.y]
    u = [min(max(-sum(k * v for k, v in zip(row, x)), -LIMIT), LIMIT) for row in GAIN]
    types = STORE.types
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return bytes(STORE.serialize_cdr(types[COMMAND](layout=layout, data=numpy.array(u)), COMMAND))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--listen", required=True)
    parser.add_argument("--report", required=True)
    options = parser.parse_args()
    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", json.dumps([options.listen]))
    arrived: queue.SimpleQueue = queue.SimpleQueue()
    check = Check()
    tokens: set[str] = set()
    with zenoh.open(config) as session:
        session.liveliness().declare_subscriber(
            f"@ros2_lv/{DOMAIN}/**", lambda sample: tokens.add(str(sample.key_expr)), history=True
        )
        for topic in TYPES:
            session.declare_subscriber(f"{DOMAIN}/{topic}/*/*", arrived.put)
        key = f"{DOMAIN}/command/{mangled(COMMAND)}/{STORE.hash_rihs01(COMMAND)}"
        publisher = session.declare_publisher(key, express=True)
        sent = 0
        while not ended:
            try:
                topic, message = check.message(arrived.get(timeout=0.1))
            except queue.Empty:
                continue
            if topic == "imu":
                check.must(message.header.frame_id == "base_link", message.header.frame_id)
                check.must(message.linear_acceleration_covariance[0] == -1, "the bench measures no acceleration")
                if sent == 0:
                    # A command that is none must not disturb the flight. Whose messages come hears ours.
                    publisher.put(b"\x00\x01\x00\x00nonsense")
                sent += 1
                attachment = struct.pack("<qqB16s", sent, time.time_ns(), 16, b"controller in py")
                publisher.put(command(message), attachment=attachment)
            elif topic == "tf":
                transform = message.transforms[0]
                check.must((transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link"), "frames of tf")
            elif topic == "odom":
                check.must((message.header.frame_id, message.child_frame_id) == ("odom", "base_link"), "frames of odom")
        check.tokens(set(tokens))
        publishers = sorted(topic for topic, _ in check.numbers)
        check.must(publishers == sorted([*TYPES, "tf"]), f"publishers of {publishers}; those of /tf are two")
    with open(options.report, "w") as file:
        json.dump({"faults": check.faults, "counts": check.counts}, file)


main()
