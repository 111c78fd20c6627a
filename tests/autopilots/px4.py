"""A stand-in for PX4: connects to the simulator with pymavlink and flies by its sensors.

    px4.py PORT REPORT [--free] [--reconnect-after STEPS] [--pty NAME --baud RATE] [--disarmed] [--telemetry PORT] [--turned AXIS]
           [--wait-for FILE] [--replay-after STEPS] [--beyond] [--station SECONDS] [--ground PORT] [--bits]
           [--slow SECONDS] [--disarm-after STEPS] [--die-after STEPS] [--reboot-after STEPS] [--mark SECONDS]

`--free`: without lockstep, as hardware in the loop is; `--pty`: over a serial line of that name, as it is as well, which carries what
its baud rate allows.
`--telemetry`: tells its attitude to a ground station; `--turned`: with the wrong sign of one axis.
`--wait-for`: connects once that file is there; `--replay-after`: says the same outputs again and again from then on; `--beyond`:
with outputs that go beyond their range. `--station`: armed by a ground station on the same line, which its checks allow after so long.
`--ground`: it speaks to stations at that UDP port alone, as software in the loop does; `--bits`: it says why it does not arm with the
health bits of SYS_STATUS alone. `--slow`: it takes so long to answer; `--disarm-after`: not armed from then on; `--die-after`: it
kills itself; `--reboot-after`: it is silent for a second, begins anew with its clock at zero, and is armed once more half a second
later. `--mark`: it says so when so much time has passed since its first sensors.
"""

import argparse
import math
import os
import signal
import socket
import time

from pymavlink.dialects.v20 import common

import commander
import flight
import wire

GROUPS = {"accel": 0x7, "gyro": 0x38, "mag": 0x1C0, "baro": 0x1A00, "diff": 0x400}


def connect(port):
    until = time.monotonic() + 30
    while True:
        try:
            link = socket.create_connection(("127.0.0.1", port), timeout=20)
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return link
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.02)


class Ground:
    """The UDP port of somebody who listens, and what that one says."""

    def __init__(self, port):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.to = ("127.0.0.1", port)
        self.mav = common.MAVLink(None, srcSystem=1, srcComponent=1)

    def send(self, message):
        self.socket.sendto(message.pack(self.mav), self.to)

    def heard(self):
        try:
            return self.mav.parse_buffer(self.socket.recv(65536)) or []
        except OSError:
            return []


class Line(wire.Line):
    """A serial line of a board, whose driver has no room for everything."""

    def __init__(self, name, baud):
        super().__init__(name, baud)
        self.sent = self.dropped = 0

    def recv(self, most):
        return self.mine.recv(most)

    def sendall(self, data):
        """As PX4 does, whose driver takes a message whole or not at all."""
        if self.sent + len(data) - self.wire.inward.carried > wire.BUFFER:
            self.dropped += 1
            return
        self.sent += len(data)
        self.mine.sendall(data)

    def note(self, report):
        report["dropped"] = self.dropped
        if self.wire.outward.lost and "overrun" not in report.notes:
            report["overrun"] = True
            report.demand(False, "more came than the line carries")


def check_sensor(report, s, last, fresh):
    bits = s.fields_updated
    for name, group in GROUPS.items():
        report.demand(bits & group in (0, group), f"group {name} is not whole: {bits:#x}")
    report.demand(bits & ~0x1FFF == 0, f"unknown bits {bits:#x}")
    report.demand(bits & 0x3F == 0x3F, "no accelerometer or gyroscope")
    report.demand(s.id == 0, f"id {s.id}")
    report.demand(last is None or s.time_usec > last, f"time {last} to {s.time_usec}")
    accel = (s.xacc, s.yacc, s.zacc)
    fresh.look("the accelerometer", accel)
    fresh.look("the gyroscope", (s.xgyro, s.ygyro, s.zgyro))
    report.demand(abs(flight.norm(accel) - flight.G) < 1.0 and s.zacc < -8.0, f"accelerometer {accel}")
    if bits & GROUPS["mag"]:
        fresh.look("the magnetometer", (s.xmag, s.ymag, s.zmag), most=99)
        field = flight.norm((s.xmag, s.ymag, s.zmag))
        report.demand(0.2 < field < 0.7 and s.zmag > 0.2, f"magnetometer in gauss {field}")
    if bits & GROUPS["baro"]:
        fresh.look("the barometer", s.abs_pressure, most=99)
        report.demand(900 < s.abs_pressure < 1013.25, f"pressure in hPa {s.abs_pressure}")
        report.demand(400 < s.pressure_alt < 600, f"height {s.pressure_alt}")
        report.demand(-50 < s.temperature < 50, f"temperature {s.temperature}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("port", type=int)
    parser.add_argument("report")
    parser.add_argument("--free", action="store_true")
    parser.add_argument("--reconnect-after", type=int)
    parser.add_argument("--pty")
    parser.add_argument("--baud", type=int)
    parser.add_argument("--disarmed", action="store_true")
    parser.add_argument("--telemetry", type=int)
    parser.add_argument("--turned")
    parser.add_argument("--wait-for")
    parser.add_argument("--replay-after", type=int)
    parser.add_argument("--beyond", action="store_true")
    parser.add_argument("--station", type=float)
    parser.add_argument("--ground", type=int)
    parser.add_argument("--bits", action="store_true")
    parser.add_argument("--slow", type=float, default=0.0)
    parser.add_argument("--disarm-after", type=int)
    parser.add_argument("--die-after", type=int)
    parser.add_argument("--reboot-after", type=int)
    parser.add_argument("--mark", type=float)
    args = parser.parse_args()
    report = flight.Report(args.report)
    flight.end_in_order(report)
    report["seen"] = seen = {}
    report["connections"] = 0
    steps = 0
    while args.wait_for and not os.path.exists(args.wait_for):
        time.sleep(0.01)
    while True:
        try:
            link = Line(args.pty, args.baud) if args.pty else connect(args.port)
        except OSError:
            report.write()
            return
        report["connections"] += 1
        steps = converse(link, args, report, seen, steps)
        link.close()
        if steps is None:
            report.write()
            return


def converse(link, args, report, seen, steps):
    mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
    # The bench discards what has waited too long for a serial line, also in the middle of a message: a receiver skips the rest.
    mav.robust_parsing = args.pty is not None
    send = lambda message: link.sendall(message.pack(mav))
    send(mav.heartbeat_encode(2, 12, 0, 0, 4))
    # PX4 asks for the truth every 5 ms.
    send(mav.command_long_encode(0, 0, 511, 0, 115, 5000, 0, 0, 0, 0, 0))
    attitude, last, turned, began = flight.Attitude(), None, 0.0, None
    first_time = None
    silent_until, marked = None, args.mark is None
    fresh = flight.Fresh(report)
    telemetry = flight.Telemetry(args.telemetry, 12) if args.telemetry else None
    ground = Ground(args.ground) if args.ground else None
    tell = (ground.mav, ground.send) if ground else (mav, send)
    station = commander.Commander(*tell, report, args.station, args.bits) if args.station is not None else None
    gyro = (0.0, 0.0, 0.0)
    while True:
        try:
            data = link.recv(65536)
        except OSError:
            data = b""
        if not data:
            return None
        if args.pty:
            link.note(report)
        if station:
            station.tick(attitude.told(args.turned), gyro)
            for message in ground.heard() if ground else []:
                station.hear(message)
        for message in mav.parse_buffer(data) or []:
            kind = message.get_type()
            seen[kind] = seen.get(kind, 0) + 1
            if kind == "BAD_DATA":
                continue
            if station and not ground:
                station.hear(message)
            if kind == "HIL_GPS":
                report.demand(message.fix_type == 3 and message.satellites_visible > 5, "no fix")
                report.demand(abs(message.lat - 473977420) < 10000 and abs(message.alt - 488000) < 5000, "place")
            if kind == "HIL_STATE_QUATERNION":
                q = message.attitude_quaternion
                report.demand(abs(flight.norm(q) - 1.0) < 1e-3, f"quaternion {q}")
                truth = math.atan2(2 * (q[0] * q[1] + q[2] * q[3]), 1 - 2 * (q[1] ** 2 + q[2] ** 2))
                report["roll_error"] = max(report.notes.get("roll_error", 0.0), abs(truth - (attitude.roll or truth)))
            if kind != "HIL_SENSOR":
                continue
            if silent_until is not None and time.monotonic() < silent_until:
                continue
            began = began or time.monotonic()
            if not marked and time.monotonic() > began + args.mark:
                marked = True
                print(f"{args.mark:g} s have passed", flush=True)
            check_sensor(report, message, last, fresh)
            first_time = first_time or message.time_usec
            dt = 0.0 if last is None else (message.time_usec - last) * 1e-6
            last = message.time_usec
            gyro = (message.xgyro, message.ygyro, message.zgyro)
            attitude.step(gyro, (message.xacc, message.yacc, message.zacc), dt)
            # Half a second to start, then armed.
            armed = last - first_time > 500_000 and not args.disarmed
            if station:
                armed = station.armed
            if args.disarm_after and steps >= args.disarm_after:
                armed = False
            if telemetry:
                telemetry.attitude(last // 1000, attitude.told(args.turned))
            controls = flight.quad_x(*flight.level(attitude, gyro)) if armed else [0.0] * 4
            controls += [math.nan] * 12
            if args.beyond and steps % 100 == 99:
                controls[2] = 1.5
            steps += 1
            if args.die_after == steps:
                report.write()
                os.kill(os.getpid(), signal.SIGKILL)
            if args.reboot_after == steps:
                first_time, silent_until = None, time.monotonic() + 1.0
                report["reboots"] = report.notes.get("reboots", 0) + 1
                continue
            if not args.replay_after or steps <= args.replay_after:
                # Its clock is that of the sensors, until it has rebooted.
                clock = last if silent_until is None else last - first_time
                said = mav.hil_actuator_controls_encode(clock, controls, 129 if armed else 1, 0 if args.free else 1)
            if args.slow:
                time.sleep(args.slow)
            send(said)
            report["steps"] = steps
            if args.reconnect_after == steps:
                return steps


if __name__ == "__main__":
    main()
