#!/usr/bin/env python3
"""An autopilot for the tests, made with pymavlink and nothing of Whirlstand's: the vehicle side of a MAVLink link.

As a node of a bench (`--bench` or the environment of the launcher, over Zenoh) the bench's own plant is the vehicle:
its `Imu` goes out as ATTITUDE, and the override (or MANUAL_CONTROL, or SET_ATTITUDE_TARGET) that comes back is the `Command`. Without a bench the attitude is a
slow wave, and `--events` damages the stream when the override is as an event awaits it. At its end it writes what it saw to `--report`, and it is strict: what
the protocol does not allow is listed under `faults`.
"""

import argparse
import json
import math
import os
import queue
import select
import signal
import socket
import sys
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402
from pymavlink.dialects.v20 import common as mav  # noqa: E402

from hand import Hand  # noqa: E402
from pilot import Pilot  # noqa: E402

IGNORE = 65535
# The vehicle of a bench is any quadrotor: it rolls right on stick right and pitches up on stick back. Its inputs of the paper
# have the other sign, so that full stick is this.
FULL_STICK = -20.0
# A stick that somebody holds, us from the middle.
HELD = 300
# Overrides in a row that show that a state lasts.
LASTING = 5


class Autopilot:
    def __init__(self, options):
        self.options = options
        self.link = mavutil.mavlink_connection(
            options.link, baud=options.baud, source_system=1, source_component=1, dialect="common"
        )
        if options.key:
            self.link.setup_signing(bytes.fromhex(options.key), sign_outgoing=True)
        self.start = time.monotonic()
        self.armed_at = None
        self.first_override = None
        self.first_beat = None
        self.u = [0.0, 0.0]
        self.seen = {}
        self.faults = []
        self.history = []
        self.moved_before_armed = 0
        self.gap = 0.0
        self.last_override = None
        self.next_beat = 0.0
        self.silent = False
        self.not_a_number = False
        self.disarmed = False
        self.events = json.loads(options.events)
        self.neutral, self.lasted = None, 0
        self.told = False
        self.hand = Hand(options.turned.split(","), options.reversed.split(",")) if options.hand else None
        self.pilot = Pilot(json.loads(options.pilot)) if options.pilot else None
        self.override = None
        self.rc = [1500, 1500, 1000, 1500] + [1500] * 12
        self.requested = {}

    def now(self):
        return time.monotonic() - self.start

    def boot_ms(self):
        return int((self.now() + self.options.boot) * 1000) & 0xFFFFFFFF

    def armed(self):
        return self.armed_at is not None and not self.disarmed

    def fault(self, text):
        if len(self.faults) < 20:
            self.faults.append(f"{self.now():.3f} s: {text}")

    def beat(self):
        if self.now() < self.next_beat:
            return
        self.next_beat = self.now() + 0.5
        mode = mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        if self.armed():
            mode |= mav.MAV_MODE_FLAG_SAFETY_ARMED
        self.link.mav.heartbeat_send(
            mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_GENERIC, mode, 0, mav.MAV_STATE_ACTIVE
        )

    def attitude(self, roll, pitch, yaw, p, q, r):
        if self.silent:
            return
        if self.not_a_number:
            roll = math.nan
        self.link.mav.attitude_send(self.boot_ms(), roll, pitch, yaw, p, q, r)
        if 65 in self.requested:
            self.link.mav.rc_channels_send(self.boot_ms(), 16, *self.rc, 0, 0, 255)

    def listen(self):
        while True:
            message = self.link.recv_msg()
            if message is None:
                return
            kind = message.get_type()
            self.seen[kind] = self.seen.get(kind, 0) + 1
            if message.get_srcSystem() != 255 or message.get_srcComponent() != 190:
                self.fault(f"{kind} comes from {message.get_srcSystem()}/{message.get_srcComponent()}")
            handler = getattr(self, "on_" + kind.lower(), None)
            if handler:
                handler(message)
            elif kind == "BAD_DATA":
                self.fault(f"damaged bytes: {message.data[:20]!r}")
            else:
                self.fault(f"{kind} was not expected")

    def on_heartbeat(self, m):
        self.first_beat = self.first_beat or self.now()
        if m.type != mav.MAV_TYPE_GCS or m.autopilot != mav.MAV_AUTOPILOT_INVALID:
            self.fault("the heartbeat is not that of a ground station")

    def on_timesync(self, m):
        if m.tc1 == 0:
            theirs = int((self.now() + self.options.boot) * 1e9)
            self.link.mav.timesync_send(theirs, m.ts1)

    def on_command_long(self, m):
        result = mav.MAV_RESULT_UNSUPPORTED
        if m.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = mav.MAV_RESULT_ACCEPTED
            self.requested[int(m.param1)] = m.param2
        else:
            self.fault(f"command {m.command} was not expected")
        if (m.target_system, m.target_component) != (1, 1):
            self.fault(f"a command for {m.target_system}/{m.target_component}")
        self.link.mav.command_ack_send(m.command, result)

    def on_rc_channels_override(self, m):
        us = [m.chan1_raw, m.chan2_raw]
        others = [getattr(m, f"chan{i}_raw") for i in range(3, 9)]
        if any(value != IGNORE for value in others):
            self.fault(f"channels that nobody mapped are {others}")
        released = us[0] == 0
        for i, value in enumerate(us):
            if released:
                self.rc[i] = 1500 + (self.hand.sticks[i] * HELD if self.hand else 0)
            elif 1000 <= value <= 2000:
                self.rc[i] = value
        self.override = None if released else [None if value == IGNORE else value for value in us]
        self.take("an override", (m.target_system, m.target_component), us, released)

    def on_manual_control(self, m):
        """Sticks in thousandths: y to the right, x forward; 32767 is a stick that is not there."""
        if (m.z, m.r) != (32767, 32767) or m.buttons or m.buttons2 or m.enabled_extensions:
            self.fault(f"sticks that nobody mapped: {m}")
        if not all(-1000 <= stick <= 1000 for stick in (m.x, m.y)):
            self.fault(f"sticks {m.x}, {m.y}")
        self.take("sticks", (m.target, 1), [1500 + m.y / 2, 1500 - m.x / 2])

    def on_set_attitude_target(self, m):
        """Body rates, of which 1 rad/s is a full stick, without an attitude (128) and without thrust (64)."""
        rates = m.body_roll_rate, m.body_pitch_rate
        if m.type_mask != 128 | 64 or m.body_yaw_rate != 0.0:
            self.fault(f"a target that nobody mapped: {m}")
        if not all(-1.0 <= rate <= 1.0 for rate in rates):
            self.fault(f"rates {rates}")
        self.take("a target", (m.target_system, m.target_component), [1500 + 500 * rate for rate in rates])

    def take(self, what, target, us, released=False):
        """Roll and pitch as they came, as pulses, us."""
        if target != (1, 1):
            self.fault(f"{what} for {target}")
        now = self.now()
        for i, value in enumerate(us):
            if value not in (0, IGNORE) and not 1000 <= value <= 2000:
                self.fault(f"channel {i + 1} is {value} us")
        if not self.armed() and not released and us != [1500, 1500]:
            # One that was on its way while this end disarmed is no fault; a second later it is.
            self.moved_before_armed += 1
        if self.first_override is None:
            self.first_override = now
        if self.last_override is not None and self.armed():
            self.gap = max(self.gap, now - self.last_override)
        self.last_override = now
        neutral = released or us == [1500, 1500]
        self.lasted = self.lasted + 1 if neutral == self.neutral else 1
        self.neutral = neutral
        if not self.history or self.history[-1][1] != neutral:
            self.history.append((round(now, 4), neutral, us))
        self.u = [0.0, 0.0] if released else [(value - 1500) / 500 * FULL_STICK for value in us]
        if self.options.rolls_left:
            self.u[0] = -self.u[0]

    def fly(self):
        """One period by the pilot's radio and the override; it is armed by his switch. False at the end."""
        radio = self.pilot.radio()
        on = self.pilot.is_on()
        if on != self.armed():
            self.armed_at, self.disarmed, self.next_beat = self.now(), not on, 0.0
        told = [mine if theirs is None else theirs for mine, theirs in zip(radio, self.override or (None, None))]
        self.rc = told + radio[2:]
        moved = self.pilot.step(self.override, self.fault)
        if moved:
            self.attitude(*moved[0], *moved[1])
        return bool(moved)

    def arm_when_due(self):
        due = self.first_override is not None and self.now() > self.first_override + self.options.arm_after
        if self.armed_at is None and due:
            self.armed_at = self.now()
            self.next_beat = 0.0

    def happen(self):
        """The next event, when the override has been for a while as it awaits; false when it is the end."""
        if not self.events:
            return True
        event = self.events[0]
        if event["when"] == "told":
            if not self.told:
                return True
        elif not self.lasted >= event.get("for", LASTING) or (event["when"] == "neutral") != self.neutral:
            return True
        what = self.events.pop(0)["do"]
        if what in ("silence", "speak"):
            self.silent = what == "silence"
        elif what in ("disarm", "arm"):
            self.disarmed, self.next_beat = what == "disarm", 0.0
        elif what not in ("note", "end"):
            raise ValueError(f"no event is called {what}")
        self.history.append((round(self.now(), 4), what, []))
        self.lasted = 0
        return what != "end"

    def report(self):
        if not self.options.report:
            return
        with open(self.options.report, "w") as out:
            json.dump(
                {
                    "seen": self.seen,
                    "faults": self.faults,
                    "history": self.history[:1000],
                    "armed_at": self.armed_at,
                    "moved_before_armed": self.moved_before_armed,
                    "longest_gap_s": self.gap,
                    "requested": {str(k): v for k, v in self.requested.items()},
                    "seconds": self.now(),
                    "said": self.hand.said if self.hand else [],
                },
                out,
            )


def notify_ready():
    address = os.environ.get("NOTIFY_SOCKET")
    if address:
        if address.startswith("@"):
            address = "\0" + address[1:]
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
            sock.sendto(b"READY=1", address)


def fly_bench(autopilot, ended):
    """The plant of a bench is the vehicle."""
    import zenoh
    from whirlstand_messages import Command, Imu

    # The launcher's configuration holds this program's key.
    config = zenoh.Config.from_file(os.environ["WHIRLSTAND_ZENOH_CONFIG"])
    connect = [e for e in os.environ.get("WHIRLSTAND_ZENOH_CONNECT", "").split(",") if e]
    config.insert_json5("connect/endpoints", json.dumps(connect))
    key = f"whirlstand/{os.environ['WHIRLSTAND_BENCH']}/"
    with zenoh.open(config) as session:
        arrived = queue.SimpleQueue()
        session.declare_subscriber(key + Imu.TOPIC, arrived.put)
        commands = session.declare_publisher(
            key + Command.TOPIC,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        notify_ready()
        sent = 0
        while not ended():
            try:
                imu = Imu.decode(arrived.get(timeout=0.05).payload.to_bytes())
            except queue.Empty:
                autopilot.listen()
                autopilot.beat()
                continue
            autopilot.listen()
            autopilot.attitude(imu.roll, imu.pitch, imu.yaw, imu.roll_rate, imu.pitch_rate, imu.yaw_rate)
            command = Command()
            command.head.seq = sent
            command.head.step = imu.head.step
            command.head.stamp_ns = imu.head.stamp_ns
            command.count = 2
            command.u[0], command.u[1] = autopilot.u
            commands.put(command.encode())
            sent += 1
            autopilot.beat()
            autopilot.arm_when_due()


def fly_alone(autopilot, ended):
    """The attitude is a slow wave."""
    period = 1.0 / autopilot.options.rate
    due = time.monotonic()
    while not ended() and autopilot.now() < autopilot.options.seconds:
        due = max(due + period, time.monotonic() - 0.1)
        while (left := due - time.monotonic()) > 0:
            try:
                select.select([autopilot.link.fd], [], [], left)
            except (OSError, ValueError, TypeError):
                time.sleep(left)
            autopilot.listen()
        autopilot.listen()
        if not autopilot.happen():
            return
        t = autopilot.now()
        autopilot.beat()
        if autopilot.pilot:
            if not autopilot.fly():
                return
            continue
        autopilot.arm_when_due()
        if autopilot.hand:
            autopilot.hand.listen()
            angles, rates = autopilot.hand.step(period)
            autopilot.attitude(*angles, *rates)
            continue
        autopilot.attitude(0.02 * math.sin(t), 0.02 * math.cos(t), 0.5, 0.02 * math.cos(t), -0.02 * math.sin(t), 0.0)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--link", required=True, help="as pymavlink has it: udpout:HOST:PORT, tcp:HOST:PORT, /dev/...")
    parser.add_argument("--baud", type=int, default=115200)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--boot", type=float, default=100.0, help="age of this autopilot at the start, s")
    parser.add_argument("--arm-after", type=float, default=1.0, help="s after the first override")
    parser.add_argument("--seconds", type=float, default=1e9)
    parser.add_argument("--events", default="[]", help='JSON: [{"when": "moved", "neutral" or "told" (SIGUSR1), "for": overrides, "do": ...}, ...]')
    parser.add_argument("--hand", action="store_true", help="somebody turns it as standard input asks")
    parser.add_argument("--turned", default="", help="axes that are told with the wrong sign then")
    parser.add_argument("--reversed", default="", help="axes whose stick moves its channel the other way")
    parser.add_argument("--rolls-left", action="store_true", help="the vehicle of the bench rolls left on stick right")
    parser.add_argument("--pilot", default="", help="phases of a pilot whose vehicle it is (JSON, as pilot.py has them)")
    parser.add_argument("--key", default="", help="secret of a signed link, 64 hexadecimal digits")
    parser.add_argument("--report", default="")
    options = parser.parse_args()
    asked = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: asked.append(True))
    autopilot = Autopilot(options)
    signal.signal(signal.SIGUSR1, lambda *_: setattr(autopilot, "told", True))
    try:
        if os.environ.get("WHIRLSTAND_BENCH"):
            fly_bench(autopilot, lambda: bool(asked))
        else:
            fly_alone(autopilot, lambda: bool(asked))
        # What arrived before the signal is part of what was seen and heard.
        autopilot.listen()
        if autopilot.hand:
            autopilot.hand.listen()
    finally:
        autopilot.report()
    return 0


if __name__ == "__main__":
    sys.exit(main())
