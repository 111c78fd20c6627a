"""A stand-in for Betaflight's software-in-the-loop build, strict about pace, layout and arming.

    betaflight.py RAW MOTORS STATE CHANNELS REPORT [--msp PORT] [--blocked FLAGS] [--no-switch] [--deaf]
                  [--stopped SECONDS] [--dies SECONDS]

Its clock runs at the ratio of told to wall time between the last two states, as Betaflight's does; it arms after its boot grace on AUX 1 going
from low to high at low throttle. `--msp`: tells its attitude there, over TCP, and
its arming flags; `--blocked`: with these it is never armed. `--no-switch`: fresh settings, in which no switch arms it.
`--stopped`: a second after it is first armed, the whole process stands still for this time, as on a busy computer.
`--dies`: it ends so long after it felt a tilt.
"""

import argparse
import math
import os
import select
import signal
import socket
import struct
import subprocess
import threading
import time

import flight

BOOT_GRACE_S = 1.0
FDM = struct.Struct("<18d")
RC = struct.Struct("<d16H")


def tell(port, attitude, blocked, switch, deaf):
    """Answers MSP_ATTITUDE, pitch positive nose down and heading 0 to 359 degrees, MSP_STATUS_EX as 2025.12 lays it out, and
    MSP_MODE_RANGES."""
    with socket.create_server(("127.0.0.1", port)) as server:
        unheard = server.accept() if deaf else None
        while True:
            link, _ = server.accept()
            asked = b""
            while data := link.recv(4096):
                asked += data
                while len(asked) >= 6:
                    request, asked = asked[:6], asked[6:]
                    assert request[:4] == b"$M<\x00" and request[4] == request[5], request
                    link.sendall(answer(request[4], attitude, blocked, switch))


def answer(command, attitude, blocked, switch):
    if command == 108:
        roll, pitch, yaw = (math.degrees(angle) for angle in attitude.told(None))
        body = struct.pack("<3h", round(10 * roll), round(-10 * pitch), round(yaw) % 360)
    elif command == 34:
        # Arming on AUX 1 and angle mode on AUX 2 between 1700 and 2100 us, of twenty.
        body = bytes([0, 0, 32, 48, 1, 1, 32, 48] if switch else []).ljust(80, b"\x00")
    else:
        assert command == 150, command
        # Cycle time, errors, sensors, modes, profile, load, profiles, rate profile; further modes; flags.
        body = struct.pack("<HHHIBHBB", 250, 0, 0x23, 1, 0, 3, 4, 0) + b"\x01\x00" + struct.pack("<BIB", 29, blocked, 0)
    body = bytes([len(body), command]) + body
    check = 0
    for byte in body:
        check ^= byte
    return b"$M>" + body + bytes([check])


def stand_still(seconds):
    """Stops this process with all its threads."""
    subprocess.Popen(["sh", "-c", f"sleep {seconds}; kill -CONT {os.getpid()}"])
    os.kill(os.getpid(), signal.SIGSTOP)


def main():
    parser = argparse.ArgumentParser()
    for port in ("raw", "motors", "state", "channels"):
        parser.add_argument(port, type=int)
    parser.add_argument("report")
    parser.add_argument("--msp", type=int)
    parser.add_argument("--deaf", action="store_true")
    parser.add_argument("--blocked", type=lambda text: int(text, 0), default=0)
    parser.add_argument("--no-switch", action="store_true")
    parser.add_argument("--yaw", type=float, default=0.0, help="demand per yaw rate, s/rad")
    parser.add_argument("--stopped", type=float, default=0.0)
    parser.add_argument("--dies", type=float)
    args = parser.parse_args()
    report = flight.Report(args.report)
    report["disarmed"] = False
    # It stays until it is disarmed.
    flight.end_in_order(report, lambda: report.notes.get("armed_at") is None or report["disarmed"])
    state, channels = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    state.bind(("127.0.0.1", args.state))
    channels.bind(("127.0.0.1", args.channels))
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    attitude, last, last_wall = flight.Attitude(), None, None
    fresh = flight.Fresh(report)
    rate = 1.0
    began = None
    if args.msp:
        threading.Thread(target=tell, args=(args.msp, attitude, args.blocked, not args.no_switch, args.deaf), daemon=True).start()
    tilted_at = None
    armed, seen_low, aux, throttle = False, False, 1000, 1000
    report["rates"] = []
    report["armed_at"] = report["rc"] = None
    rates = []
    while True:
        ready, _, _ = select.select([state, channels], [], [], 1.0)
        now = time.monotonic()
        if channels in ready:
            data = channels.recv(4096)
            report.demand(len(data) == 40, f"{len(data)} bytes of channels")
            _, *pulses = RC.unpack(data)
            report.demand(all(1000 <= p <= 2000 for p in pulses), f"pulses {pulses}")
            report["rc"] = pulses
            throttle, aux = pulses[2], pulses[4]
            grace_over = began is not None and now - began > BOOT_GRACE_S
            if grace_over and aux < 1300 and throttle <= 1050:
                seen_low = True
            if not armed and aux > 1700 and not (args.blocked or args.no_switch):
                report.demand(grace_over and seen_low and throttle <= 1050, "armed too early or with throttle up")
                armed = grace_over and seen_low and throttle <= 1050
                report["armed_at"] = now - began if began else None
            if args.stopped and armed and now - began - report["armed_at"] > 1.0:
                stand_still(args.stopped)
                args.stopped, now = 0.0, time.monotonic()
            if armed and aux < 1300:
                armed = False
                report["disarmed"] = True
        if state not in ready:
            continue
        data = state.recv(4096)
        report.demand(len(data) == 144, f"{len(data)} bytes of state")
        f = FDM.unpack(data)
        report.demand(all(math.isfinite(x) for x in f), "not finite")
        began = now if began is None else began
        dt = 0.0
        if last is not None:
            sim, wall = f[0] - last, now - last_wall
            report.demand(sim >= 0, "older than the state before")
            dt = rate * wall
            # Betaflight's clock runs at this rate until the next packet.
            if 0 < sim < 0.02 and wall > 0:
                rate = sim / wall
            rates.append(rate)
        # Yaw comes positive nose left.
        gyro = (f[1], f[2], -f[3])
        # Betaflight negates all three, for forward, left, up.
        accel = (-f[4], f[5], f[6])
        fresh.look("the gyroscope", gyro)
        fresh.look("the accelerometer", accel)
        fresh.look("the barometer", f[17], most=99)
        report.demand(abs(flight.norm(accel) - flight.G) < 1.0 and accel[2] < -8.0, f"accelerometer {accel}")
        report.demand(abs(flight.norm(f[7:11]) - 1.0) < 1e-9, f"quaternion {f[7:11]}")
        report.demand(abs(f[14] - 8.545594) < 0.01 and abs(f[15] - 47.397742) < 0.01, f"place {f[14:17]}")
        report.demand(400 < f[16] < 600 and 90_000 < f[17] < 101_325, f"height {f[16]}, pressure {f[17]}")
        last, last_wall = f[0], now
        attitude.step(gyro, accel, dt)
        if tilted_at is None and abs(attitude.roll) > 0.1:
            tilted_at = now
        if args.dies is not None and tilted_at is not None and now - tilted_at > args.dies:
            report.write()
            return
        thrust = armed and throttle > 1200
        yaw = -args.yaw * gyro[2]
        fr, rl, fl, rr = flight.quad_x(*flight.level(attitude, gyro), yaw) if thrust else [0.055 if armed else 0.0] * 4
        # Motor 1 is rear right, then front right, rear left, front left.
        motors = [rr, fr, rl, fl]
        pulses = [1000 + 1000 * m for m in motors] + [1500.0] * 4 + [0.0] * 8
        out.sendto(struct.pack("<H2x16f", 4, *pulses), ("127.0.0.1", args.raw))
        out.sendto(struct.pack("<4f", *motors), ("127.0.0.1", args.motors))
        report["steps"] += 1
        if report["steps"] % 50 == 0:
            ordered = sorted(rates)
            report["rates"] = [ordered[0], ordered[len(ordered) // 2], ordered[-1]]


if __name__ == "__main__":
    main()
