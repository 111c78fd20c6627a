#!/usr/bin/env python3
"""A transmitter module and an SBUS receiver on pseudo-terminals, from the published layouts alone.

radio.py MODULE RECEIVER REPORT SCRIPT: the module answers with attitude and link statistics and takes channels apart; the
receiver is the pilot. SCRIPT is JSON: [["automatic", {"arm": true, "automatic": true, "failsafe": false, "telemetry":
true, "roll": 1500}], ...]: the sticks, and what the channels must come to before the next phase; with "arm": null the
switch goes off and on until they do. "by hand" instead of a script: somebody turns the vehicle as standard input asks, and
tells roll with the wrong sign. Strict: what the layouts do not allow is listed under `faults`.
"""

import json
import math
import os
import select
import signal
import struct
import sys
import time
import tty

from hand import Hand

try:
    # What others read of the same bytes, where it is installed.
    from crsf_parser import CRSFParser, PacketValidationStatus
except ImportError:
    CRSFParser = None

# Frames in a row that the channels must be as a phase awaits.
LASTING = 50
# What they may take for that, s.
PATIENCE = 40.0
PERIOD = 0.01


def near(value, wanted):
    return abs(value - wanted) <= 1


# What roll and throttle channels come to.
AWAITED = {
    "disarmed": lambda roll, throttle: near(roll, 1500) and near(throttle, 1000),
    "neutral": lambda roll, throttle: near(roll, 1500) and near(throttle, 1200),
    "manual": lambda roll, throttle: near(roll, 1700) and near(throttle, 1200),
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


def pty(name):
    master, slave = os.openpty()
    tty.setraw(slave)
    os.symlink(os.ttyname(slave), name)
    return master, slave


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


class Radio:
    def __init__(self, module_name, receiver_name):
        # This end of the other's side stays open too, so that the lines live when nobody has them open.
        (self.module_fd, _a), (self.receiver_fd, _b) = pty(module_name), pty(receiver_name)
        self.held = _a, _b
        for fd in (self.module_fd, self.receiver_fd):
            os.set_blocking(fd, False)
        self.module, self.due, self.start = Module(), time.monotonic(), time.monotonic()

    def turn(self, sticks, angles):
        """Until the next period: takes frames in; then says telemetry and sticks."""
        while (left := self.due - time.monotonic()) > 0:
            if select.select([self.module_fd], [], [], left)[0]:
                self.module.take(os.read(self.module_fd, 4096))
        self.due = max(self.due + PERIOD, time.monotonic())
        if sticks.get("telemetry", True):
            roll, pitch, yaw = angles
            packed = struct.pack(">hhh", *(round(angle * 1e4) for angle in (pitch, roll, yaw)))
            link = bytes([60, 61, 100, 8, 0, 4, 2, 70, 100, 8])
            write(self.module_fd, frame(0x1E, packed) + frame(0x14, link))
        us = [sticks.get("roll", 1500), 1500, 1200, 1500] + [1600] * 12
        us[4] = 2000 if sticks.get("arm") else 1000
        us[5] = 2000 if sticks.get("automatic") else 1000
        write(self.receiver_fd, sbus(us, sticks.get("failsafe", False)))

    def check_switches(self, awaited, channels):
        """5 arms the vehicle, 6 is a switch of the bench alone, and the others are the pilot's, once somebody is in charge."""
        arm = {"automatic": 2000, "manual": 2000, "neutral": 2000, "disarmed": 1000}[awaited]
        rest = [1000 if awaited == "disarmed" else 1600] * 10
        wanted = [arm, 1000, *rest]
        if not all(near(value, want) for value, want in zip(channels[4:], wanted)):
            self.module.faults.append(f"{awaited}: switches {channels[4:]}, not {wanted}")

    def phase(self, awaited, sticks):
        """The channels that were seen while they were as awaited, frame after frame for a while."""
        until, seen, frames = time.monotonic() + PATIENCE, [], self.module.frames
        again = sticks["arm"] is None
        while len(seen) < LASTING:
            now = time.monotonic()
            if now > until:
                self.module.faults.append(f"never came to {awaited}: {self.module.channels}")
                return seen
            if again:
                sticks = {**sticks, "arm": int(2.0 * now) % 2 == 1}
            self.turn(sticks, (0.1 * math.sin(now - self.start), 0.0, 0.3))
            if self.module.frames == frames:
                continue
            frames = self.module.frames
            channels = self.module.channels
            here = channels[0], channels[2]
            if AWAITED[awaited](*here) and (sticks["arm"] or not again):
                again = False
                seen.append(here)
                self.check_switches(awaited, channels)
            else:
                # A wave that passes through neutral is not neutral.
                seen = []
        return sorted(set(seen))


def main():
    module_name, receiver_name, report, script = sys.argv[1:]
    radio, notes = Radio(module_name, receiver_name), {}
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
    with open(report, "w") as out:
        json.dump({**notes, "frames": radio.module.frames, "judged": radio.module.judge.frames, "faults": radio.module.faults[:20]}, out)


if __name__ == "__main__":
    main()
