"""What the stand-ins for autopilots have in common: an attitude controller and a strict eye.

Written from the published layouts of the protocols, not from the bridge. Each stand-in estimates attitude from gyroscope
and accelerometer alone, holds it level, and notes everything that its autopilot would trip over.
"""

import json
import math
import signal
import socket
import sys
import time

G = 9.80665


class Report:
    """Notes kept in a file, so that they outlive the process."""

    def __init__(self, path):
        self.path = path
        self.notes = {"faults": [], "steps": 0}

    def __setitem__(self, key, value):
        self.notes[key] = value

    def __getitem__(self, key):
        return self.notes[key]

    def demand(self, holds, what):
        """Notes a fault when something does not hold."""
        if not holds and len(self.notes["faults"]) < 20:
            self.notes["faults"].append(what)

    def write(self):
        with open(self.path, "w") as file:
            json.dump(self.notes, file)


class Fresh:
    """Sensors that must not stand still: an autopilot takes a value that does not change for a failed sensor, and an estimator
    takes its noise for a bias."""

    def __init__(self, report):
        self.report, self.last = report, {}

    def look(self, name, values, most=1):
        """The next reading; one is a fault when as many as `most` in a row were equal to the one before."""
        last, equal = self.last.get(name, (None, 0))
        equal = equal + 1 if values == last else 0
        self.last[name] = values, equal
        self.report.demand(equal < most, f"{name} stands still at {values}, reading {equal + 1}")


def end_in_order(report, when=lambda: True):
    """Writes the report when asked to end, and `when` says so, or two seconds later."""

    def stop(*_):
        until = time.monotonic() + 2.0
        signal.signal(signal.SIGALRM, lambda *_: end() if when() or time.monotonic() > until else None)
        signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)

    def end():
        signal.setitimer(signal.ITIMER_REAL, 0)
        report.write()
        sys.exit(0)

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)


class Attitude:
    """A complementary filter: forward, right, down; roll right and nose up are positive. Yaw is the integral of its rate."""

    def __init__(self):
        self.roll = self.pitch = None
        self.yaw = 0.0

    def step(self, gyro, accel, dt):
        felt = math.atan2(-accel[1], -accel[2]), math.atan2(accel[0], math.hypot(accel[1], accel[2]))
        if self.roll is None:
            self.roll, self.pitch = felt
        share = math.exp(-dt / 0.5)
        self.roll = share * (self.roll + gyro[0] * dt) + (1.0 - share) * felt[0]
        self.pitch = share * (self.pitch + gyro[1] * dt) + (1.0 - share) * felt[1]
        self.yaw += gyro[2] * dt

    def told(self, turned):
        """Roll, pitch and yaw as told to a ground station; the axis `turned` with the wrong sign."""
        angles = {"roll": self.roll or 0.0, "pitch": self.pitch or 0.0, "yaw": self.yaw}
        return [-angle if axis == turned else angle for axis, angle in angles.items()]


class Telemetry:
    """What a ground station hears, in MAVLink."""

    def __init__(self, port, autopilot):
        from pymavlink.dialects.v20 import common

        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.to = ("127.0.0.1", port)
        self.autopilot = autopilot
        self.mav = common.MAVLink(None, srcSystem=1, srcComponent=1)

    def tell(self, message):
        self.socket.sendto(message.pack(self.mav), self.to)

    def attitude(self, ms, angles):
        """At 50 Hz, with a heartbeat each second."""
        if ms % 1000 < 20:
            self.tell(self.mav.heartbeat_encode(2, self.autopilot, 0, 0, 4))
        if ms % 20 < 4:
            self.tell(self.mav.attitude_encode(ms, *angles, 0, 0, 0))


def level(attitude, gyro):
    """Demands of roll and pitch, -1 to 1, that bring the paper's quadrotor level."""
    roll = -20.0 * attitude.roll - 9.0 * gyro[0]
    pitch = -5.0 * attitude.pitch - 1.0 * gyro[1]
    size = max(1.0, abs(roll) + abs(pitch))
    return roll / size, pitch / size


def quad_x(roll, pitch, yaw=0.0):
    """Motors front right, rear left, front left, rear right; the first two push the nose right."""
    front_right, rear_left = -roll + pitch + yaw, roll - pitch + yaw
    front_left, rear_right = roll + pitch - yaw, -roll - pitch - yaw
    return [0.5 + 0.5 * demand for demand in (front_right, rear_left, front_left, rear_right)]


def norm(v):
    return math.sqrt(sum(x * x for x in v))
