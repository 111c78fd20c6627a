#!/usr/bin/env python3
"""A transmitter module and an SBUS receiver on pseudo-terminals, from the published layouts alone.

radio.py MODULE RECEIVER REPORT SCRIPT: the module answers with attitude and link statistics and takes channels apart; the
receiver is the pilot. SCRIPT is JSON: [[seconds, {"arm": true, "automatic": true, "failsafe": false, "telemetry": true,
"roll": 1500}], ...]. Strict: what the layouts do not allow is listed under `faults`.
"""

import json
import math
import os
import select
import struct
import sys
import time
import tty


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


class Module:
    def __init__(self):
        self.bytes = b""
        self.frames = 0
        self.faults = []
        self.channels = None

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
            body, self.bytes = self.bytes[2:26], self.bytes[26:]
            if body[0] != 0x16 or crc8(body[:-1]) != body[-1]:
                self.faults.append(f"a damaged frame {body.hex()}")
                continue
            self.frames += 1
            self.channels = [round(988 + (t - 172) * 1024 / 1639) for t in unpack(body[1:-1])]


def main():
    module_name, receiver_name, report, script = sys.argv[1:]
    script = json.loads(script)
    (module_fd, _a), (receiver_fd, _b) = pty(module_name), pty(receiver_name)
    for fd in (module_fd, receiver_fd):
        os.set_blocking(fd, False)
    module, phases, start = Module(), [], time.monotonic()
    print("ready", flush=True)
    for seconds, sticks in script:
        end = time.monotonic() + seconds
        seen = set()
        due = time.monotonic()
        while (now := time.monotonic()) < end:
            if now >= due:
                due += 0.01
                t = now - start
                if sticks.get("telemetry", True):
                    roll, pitch, yaw = 0.1 * math.sin(t), 0.0, 0.3
                    angles = struct.pack(">hhh", round(pitch * 1e4), round(roll * 1e4), round(yaw * 1e4))
                    link = bytes([60, 61, 100, 8, 0, 4, 2, 70, 100, 8])
                    write(module_fd, frame(0x1E, angles) + frame(0x14, link))
                us = [sticks.get("roll", 1500), 1500, 1200, 1500] + [1000] * 12
                us[4] = 2000 if sticks["arm"] else 1000
                us[5] = 2000 if sticks["automatic"] else 1000
                write(receiver_fd, sbus(us, sticks.get("failsafe", False)))
            if select.select([module_fd], [], [], 0.002)[0]:
                try:
                    module.take(os.read(module_fd, 4096))
                except OSError:
                    time.sleep(0.01)
                # What the last half of a phase shows is what the phase leads to.
                if module.channels and now > end - seconds / 2:
                    seen.add((module.channels[0], module.channels[2]))
        phases.append(sorted(seen))
    with open(report, "w") as out:
        json.dump({"phases": phases, "frames": module.frames, "faults": module.faults[:20]}, out)


if __name__ == "__main__":
    main()
