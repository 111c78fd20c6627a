#!/usr/bin/env python3
"""A transmitter module and an SBUS receiver on serial lines with their baud rates, from the published layouts alone.

radio.py MODULE RECEIVER REPORT SCRIPT [VEHICLE]: the module answers with attitude and link statistics and takes channels apart; the
receiver is the pilot. SCRIPT is JSON: [["automatic", {"arm": true, "automatic": true, "failsafe": false, "telemetry":
true, "roll": 1500}], ...]: the sticks, and what the channels must come to before the next phase; with "arm": null the
switch goes off and on until they do. "by hand" instead of a script: somebody turns the vehicle as standard input asks, and
tells roll with the wrong sign. VEHICLE is JSON: {"every": 10, "late": 10}: a vehicle flies by the channels instead of a wave, and its
attitude is told every so many periods, and as it was so many periods ago, with "noise" (standard deviation, rad); with "turned" it
rolls left as channel 1 goes up. Strict: what the layouts do not allow is listed under `faults`.
"""

import json
import math
import os
import random
import select
import signal
import struct
import sys
import time

sys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "autopilots"))
import wire  # noqa: E402
from hand import Hand  # noqa: E402

try:
    # What others read of the same bytes, where it is installed.
    from crsf_parser import CRSFParser, PacketValidationStatus
except ImportError:
    CRSFParser = None

# Frames in a row that the channels must be as a phase awaits.
LASTING = 50
# What they may take for that, s.
PATIENCE = 40.0
# What all phases together may take, s: less than a test waits for this program, so that the report says which one never came.
ALL = 100.0
PERIOD = 0.01
# Of the lines.
CRSF_BAUD, SBUS_BAUD = 420000, 100000


# Frames in a row of a phase that lasts longer.
LONGER = {"refused": 400}


def near(value, wanted):
    return abs(value - wanted) <= 1


# What roll and throttle channels come to.
AWAITED = {
    "disarmed": lambda roll, throttle: near(roll, 1500) and near(throttle, 1000),
    "neutral": lambda roll, throttle: near(roll, 1500) and near(throttle, 1200),
    "manual": lambda roll, throttle: near(roll, 1700) and near(throttle, 1200),
    # The arm switch is moved all the time, in vain.
    "refused": lambda roll, throttle: near(roll, 1500) and near(throttle, 1000),
    # The controller flies: its stick moves, however little.
    "flown": lambda roll, throttle: near(throttle, 1200),
    "automatic": lambda roll, throttle: abs(roll - 1500) > 20 and not near(roll, 1700) and near(throttle, 1200),
}


def crc8(data):
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = ((crc << 1) ^ 0xD5) & 0xFF if crc & 0x80 else (crc << 1) & 0xFF
    return crc


def frame(kind, payload):
    body = bytes([kind]) + payload
    return bytes([0xC8, len(body) + 1]) + body + bytes([crc8(body)])


def unpack(packed):
    bits = int.from_bytes(packed, "little")
    return [(bits >> (11 * i)) & 0x7FF for i in range(16)]


def sbus(us, failsafe):
    ticks = [round((value - 880) * 8 / 5) for value in us]
    packed = sum(value << (11 * i) for i, value in enumerate(ticks)).to_bytes(22, "little")
    return b"\x0f" + packed + bytes([8 if failsafe else 0, 0])


def write(fd, data):
    """A line that nobody reads loses what does not fit."""
    try:
        os.write(fd, data)
    except BlockingIOError:
        pass


class Judge:
    """The frames as crsf_parser reads them, which has the channels in the opposite order."""

    def __init__(self, faults):
        self.frames, self.faults, self.ticks = 0, faults, None
        self.parser = CRSFParser(self.hear) if CRSFParser else None

    def hear(self, frame, status):
        if status != PacketValidationStatus.VALID:
            self.faults.append(f"crsf_parser: {status}")
        self.frames += 1
        self.ticks = list(frame.payload.channels)[::-1]

    def take(self, whole, ticks):
        if self.parser:
            self.parser.parse_stream(bytearray(whole))
            if self.ticks != ticks:
                self.faults.append(f"crsf_parser reads {self.ticks}, and here it is {ticks}")


class Module:
    def __init__(self):
        self.bytes = b""
        self.frames = 0
        self.faults = []
        self.channels = None
        # Every set of channels that came, each once.
        self.all = set()
        self.judge = Judge(self.faults)

    def take(self, data):
        self.bytes += data
        while len(self.bytes) >= 2:
            address, length = self.bytes[0], self.bytes[1]
            if address != 0xC8 or length != 24:
                self.faults.append(f"a frame begins with {self.bytes[:3].hex()}")
                self.bytes = self.bytes[1:]
                continue
            if len(self.bytes) < 26:
                return
            whole, self.bytes = self.bytes[:26], self.bytes[26:]
            body = whole[2:]
            if body[0] != 0x16 or crc8(body[:-1]) != body[-1]:
                self.faults.append(f"a damaged frame {body.hex()}")
                continue
            self.frames += 1
            ticks = unpack(body[1:-1])
            self.judge.take(whole, ticks)
            self.channels = [round(1500 + (t - 992) * 5 / 8) for t in ticks]
            self.all.add(tuple(self.channels))


class Vehicle:
    """The paper's quadrotor (Martinez et al. 2008, Table 2), in degrees, flown by channels 1 and 2: up rolls right and pitches up."""

    A = [[0, 1, 0, 0], [-1.1132, -0.7118, 0.0001, 0], [0, 0, 0, 1], [7.2721, 6.1794, -7.9908, -5.2474]]
    B = [[0, 0], [-1.1045, 0], [0, 0], [-4.5267, -14.4146]]
    PARTS = 10

    def __init__(self, every, late, turned=False, noise=0.0):
        self.every, self.late = every, late
        self.roll_sign = -1 if turned else 1
        self.noise, self.random = noise, random.Random(1)
        self.x, self.past, self.periods = [0.0] * 4, [], 0

    def step(self, channels, push, effective=1.0):
        """One period; `push` is somebody's hand on it, an angular acceleration about roll in deg/s^2, and `effective` the
        share of the roll command that acts."""
        u = [-20.0 * (us - 1500) / 500 for us in (channels[:2] if channels else (1500, 1500))]
        u[0] *= self.roll_sign * effective
        for _ in range(self.PARTS):
            dx = [sum(a * x for a, x in zip(row, self.x)) + sum(b * v for b, v in zip(b_row, u)) for row, b_row in zip(self.A, self.B)]
            dx[1] += push
            self.x = [x + d * PERIOD / self.PARTS for x, d in zip(self.x, dx)]
        roll, pitch = (math.radians(self.x[i]) + self.random.gauss(0.0, self.noise) for i in (0, 2))
        self.past = [*self.past, (roll, pitch, 0.0)][-self.late - 1 :]
        self.periods += 1

    def told(self):
        """The attitude that is told now, if one is."""
        return self.past[0] if self.periods % self.every == 0 else None

    def is_level(self):
        return abs(self.x[0]) < 1.0 and abs(self.x[2]) < 1.0


class Radio:
    def __init__(self, module_name, receiver_name, vehicle):
        self.vehicle = vehicle
        # CRSF is 8N1, and SBUS 8E2.
        self.lines = wire.Line(module_name, CRSF_BAUD), wire.Line(receiver_name, SBUS_BAUD, bits=12)
        for line in self.lines:
            line.mine.setblocking(False)
        self.module_fd, self.receiver_fd = (line.mine.fileno() for line in self.lines)
        self.module, self.due, self.start = Module(), time.monotonic(), time.monotonic()

    def turn(self, sticks, angles):
        """Until the next period: takes frames in; then says telemetry and sticks."""
        while (left := self.due - time.monotonic()) > 0:
            if select.select([self.module_fd], [], [], left)[0]:
                self.module.take(os.read(self.module_fd, 4096))
        self.due = max(self.due + PERIOD, time.monotonic())
        if self.vehicle:
            self.vehicle.step(self.module.channels, sticks.get("push", 0.0), sticks.get("effective", 1.0))
            angles = self.vehicle.told()
        if sticks.get("telemetry", True) and angles:
            roll, pitch, yaw = angles
            packed = struct.pack(">hhh", *(round(angle * 1e4) for angle in (pitch, roll, yaw)))
            link = bytes([60, 61, 100, 8, 0, 4, 2, 70, 100, 8])
            write(self.module_fd, frame(0x1E, packed) + frame(0x14, link))
        us = [sticks.get("roll", 1500), 1500, 1200, 1500] + [1600] * 12
        us[4] = 2000 if sticks.get("arm") else 1000
        us[5] = 2000 if sticks.get("automatic") else 1000
        write(self.receiver_fd, sbus(us, sticks.get("failsafe", False)))

    def close(self):
        """What the bench sent beyond what its line carries is a fault."""
        lost = self.lines[0].wire.outward.lost
        if lost:
            self.module.faults.append(f"{lost} bytes more came than the line carries")
        for line in self.lines:
            line.close()

    def check_switches(self, awaited, channels):
        """5 arms the vehicle, 6 is a switch of the bench alone, and the others are the pilot's, once somebody is in charge."""
        off = awaited in ("disarmed", "refused")
        arm, rest = (1000, [1000] * 10) if off else (2000, [1600] * 10)
        wanted = [arm, 1000, *rest]
        if not all(near(value, want) for value, want in zip(channels[4:], wanted)):
            self.module.faults.append(f"{awaited}: switches {channels[4:]}, not {wanted}")

    def note_recovery(self):
        """The time after the gust from which on it has been level, s of the vehicle's own time; `None` while it is not."""
        if not self.vehicle.is_level():
            self.recovered_after = None
        elif self.recovered_after is None:
            self.recovered_after = PERIOD * (self.vehicle.periods - self.pushed_at)

    def phase(self, awaited, sticks):
        """The channels that were seen while they were as awaited, frame after frame for a while."""
        lasting = sticks.get("frames", LONGER.get(awaited, LASTING))
        until = min(time.monotonic() + PATIENCE + 2 * PERIOD * lasting, self.start + ALL)
        seen, frames = [], self.module.frames
        again, vain = sticks["arm"] is None, awaited == "refused"
        if "gust" in sticks:
            self.vehicle.x[1] += sticks["gust"]
            self.pushed_at, self.recovered_after = self.vehicle.periods, None
        while len(seen) < lasting:
            now = time.monotonic()
            if now > until:
                self.module.faults.append(f"never came to {awaited}: {self.module.channels}")
                return seen
            if again:
                sticks = {**sticks, "arm": int(2.0 * now) % 2 == 1}
            self.turn(sticks, (0.1 * math.sin(now - self.start), 0.0, 0.3))
            if "gust" in sticks:
                self.note_recovery()
            if self.module.frames == frames:
                continue
            frames = self.module.frames
            channels = self.module.channels
            here = channels[0], channels[2]
            if AWAITED[awaited](*here) and (sticks["arm"] or not again or vain):
                again = vain
                seen.append(here)
                self.check_switches(awaited, channels)
            else:
                # A wave that passes through neutral is not neutral.
                seen = []
        return sorted(set(seen))


def main():
    module_name, receiver_name, report, script, *vehicle = sys.argv[1:]
    radio, notes = Radio(module_name, receiver_name, Vehicle(**json.loads(vehicle[0])) if vehicle else None), {}
    if script == "by hand":
        hand, ended = Hand(["roll"]), []
        signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
        while not ended:
            hand.listen()
            radio.turn({}, hand.step(PERIOD)[0])
        # The last words may have come with the signal.
        hand.listen()
        notes["said"] = hand.said
    else:
        notes["phases"] = [radio.phase(awaited, sticks) for awaited, sticks in json.loads(script)]
        notes["recovered_after_s"] = getattr(radio, "recovered_after", None)
    radio.close()
    with open(report, "w") as out:
        json.dump({**notes, "channels": sorted(radio.module.all), "frames": radio.module.frames, "judged": radio.module.judge.frames, "faults": radio.module.faults[:20]}, out)


if __name__ == "__main__":
    main()
