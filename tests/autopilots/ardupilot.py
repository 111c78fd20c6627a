"""A stand-in for ArduPilot with its JSON interface.

    ardupilot.py PORT REPORT [--wide] [--resend EVERY] [--restart-after STEPS] [--disarmed] [--telemetry PORT]
                 [--turned AXIS] [--boots SECONDS] [--serial1 PORT]

`--wide` sends 32 channels; `--resend N` acts as if every Nth answer were lost. `--telemetry`: tells its attitude to a ground
station; `--turned`: with the wrong sign of one axis. `--boots`: so long from its first packet to its second. `--serial1`: it is a
MAVLink server at that TCP port, which says why it is not armed.
"""

import argparse
import json
import math
import re
import socket
import struct
import time

import flight
import serial1

NUMBER = re.compile(r"^-?\d+(\.\d+)?([eE][-+]?\d+)?$")


def as_ardupilot_reads(report, data):
    """The line, read as ArduPilot's own parser does: by searching for keys."""
    text = data.decode("ascii")
    report.demand(text.startswith("\n") and text.endswith("\n"), "the line has no line feed on both sides")
    line = text.strip("\n")
    report.demand("\n" not in line, "more than one line")
    for key in ("timestamp", "imu", "gyro", "accel_body", "position", "velocity", "quaternion"):
        report.demand(f'"{key}":' in line and f'"{key}": ' not in line, f"key {key}")
    for token in re.findall(r"-?[\w.+-]+", re.sub(r'"[^"]*"', "", line)):
        report.demand(NUMBER.match(token), f"number {token}")
    return json.loads(line)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("port", type=int)
    parser.add_argument("report")
    parser.add_argument("--wide", action="store_true")
    parser.add_argument("--resend", type=int, default=0)
    parser.add_argument("--restart-after", type=int, default=0)
    parser.add_argument("--disarmed", action="store_true")
    parser.add_argument("--telemetry", type=int)
    parser.add_argument("--turned")
    parser.add_argument("--boots", type=float, default=0.0)
    parser.add_argument("--serial1", type=int)
    args = parser.parse_args()
    report = flight.Report(args.report)
    flight.end_in_order(report)
    report["resent"] = report["resent_same"] = report["restarts"] = 0
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.settimeout(1.0)
    telemetry = flight.Telemetry(args.telemetry, 3) if args.telemetry else None
    checks = serial1.Serial1(args.serial1, report) if args.serial1 else None
    magic, channels = (29569, 32) if args.wide else (18458, 16)
    attitude, last, frame, steps, motors = flight.Attitude(), None, 0, 0, [0.0] * 4

    def packet():
        pwm = [int(round(1000 + 1000 * m)) for m in motors] + [1500] * (channels - 4)
        data = struct.pack(f"<HHI{channels}H", magic, 400, frame, *pwm)
        report.demand(len(data) == (72 if args.wide else 40), "length")
        return data

    answer = None
    while True:
        link.sendto(packet(), ("127.0.0.1", args.port))
        try:
            data, _ = link.recvfrom(65536)
        except (TimeoutError, ConnectionRefusedError):
            # As ArduPilot: the same packet again.
            continue
        report.demand(data != answer, "an answer that nobody asked for")
        answer = data
        if args.resend and frame % args.resend == args.resend - 1:
            link.sendto(packet(), ("127.0.0.1", args.port))
            again, _ = link.recvfrom(65536)
            report["resent"] += 1
            report["resent_same"] += again == data
        state = as_ardupilot_reads(report, data)
        report.demand(last is None or state["timestamp"] > last, "time does not grow")
        if frame == 0:
            report.demand(state["timestamp"] == 0.0, f"the first time is {state['timestamp']}")
        gyro, accel = state["imu"]["gyro"], state["imu"]["accel_body"]
        q = state["quaternion"]
        report.demand(abs(flight.norm(q) - 1.0) < 1e-9, f"quaternion {q}")
        report.demand(abs(flight.norm(accel) - flight.G) < 1.0 and accel[2] < -8.0, f"accelerometer {accel}")
        report.demand(flight.norm(state["position"]) < 100 and flight.norm(state["velocity"]) < 50, "motion")
        dt = 0.0 if last is None else state["timestamp"] - last
        last = state["timestamp"]
        attitude.step(gyro, accel, dt)
        truth = math.atan2(2 * (q[0] * q[1] + q[2] * q[3]), 1 - 2 * (q[1] ** 2 + q[2] ** 2))
        report["roll_error"] = max(report.notes.get("roll_error", 0.0), abs(truth - attitude.roll))
        # Half a second to start, then armed.
        armed = last > 0.5 and not args.disarmed
        if checks:
            checks.tick(armed)
        if telemetry:
            telemetry.attitude(round(1000 * last), attitude.told(args.turned))
        motors = flight.quad_x(*flight.level(attitude, gyro)) if armed else [0.0] * 4
        if frame == 0:
            time.sleep(args.boots)
        frame += 1
        steps += 1
        report["steps"] = steps
        if args.restart_after == steps:
            # A new process: new port, everything forgotten, and longer silent than the bridge takes for a delay.
            link.close()
            link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            link.settimeout(1.0)
            attitude, last, frame, motors, answer = flight.Attitude(), None, 0, [0.0] * 4, None
            report["restarts"] += 1
            time.sleep(0.7)


if __name__ == "__main__":
    main()
