"""A ground station at the end of a serial line, made of what others wrote: pymavlink, MAVSDK or MAVProxy.

    station.py KIND LINE BAUD REPORT

It makes the line LINE, which carries what BAUD allows and whose other end the station has, waits for the vehicle, tries to write what the bench owns
(where the library lets it), asks for the attitude, arms until it is armed, reads attitudes, and writes down what it saw.
"""

import json
import os
import re
import select
import subprocess
import sys
import tempfile
import threading
import time
import tty

import wire

WANTED = 20
PATIENCE = 60.0


def cable(name, baud):
    """A serial line: the bench's end has the name. Returns the path of the other end, and the line."""
    masters, paths = [], []
    for _ in range(2):
        master, slave = os.openpty()
        tty.setraw(slave)
        masters.append(master)
        # Both slaves stay open here, so that a line lives when nobody has it open.
        paths.append(os.ttyname(slave))
    os.symlink(paths[0], name)
    return paths[1], wire.Wire(*masters, baud)


class Seen(dict):
    def demand(self, holds, what):
        if not holds:
            self.setdefault("faults", []).append(what)


def by_pymavlink(path, baud, seen):
    from pymavlink import mavutil

    os.environ["MAVLINK20"] = "1"
    link = mavutil.mavlink_connection(path, baud=baud, source_system=255, source_component=190, dialect="common")
    beat = link.wait_heartbeat(timeout=PATIENCE)
    seen.demand(beat is not None and beat.autopilot == 12, f"heartbeat {beat}")
    send = link.mav.command_long_send
    # What the bench owns: its sensors, and the rate of the outputs.
    for _ in range(3):
        link.mav.hil_sensor_send(1, 9.0, 9.0, 9.0, 5.0, 5.0, 5.0, 0, 0, 0, 0, 0, 0, 0, 0x3F)
        send(1, 1, 511, 0, 93, 1e6, 0, 0, 0, 0, 0)
    send(1, 1, 511, 0, 30, 50000, 0, 0, 0, 0, 0)
    until, asked, attitudes = time.monotonic() + PATIENCE, 0.0, 0
    while time.monotonic() < until and attitudes < WANTED:
        now = time.monotonic()
        if not seen.get("armed") and now >= asked:
            asked = now + 1.0
            send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
        message = link.recv_match(blocking=True, timeout=0.2)
        kind = message.get_type() if message else None
        if kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            seen["armed"] = bool(message.base_mode & 128)
        elif kind == "STATUSTEXT":
            seen.setdefault("words", []).append(message.text)
        elif kind == "ATTITUDE" and seen.get("armed"):
            attitudes += 1
            seen.demand(abs(message.roll) < 1.0, f"roll {message.roll}")
        elif kind in ("BAD_DATA", "HIL_ACTUATOR_CONTROLS"):
            seen.demand(False, f"{kind}: {message}")
    seen["attitudes"] = attitudes


def by_mavsdk(path, baud, seen):
    from mavsdk import ComponentType, Configuration, Mavsdk
    from mavsdk.plugins.action import Action
    from mavsdk.plugins.telemetry import Telemetry

    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(f"serial://{path}:{baud}")
    system = mavsdk.first_autopilot(PATIENCE)
    if system is None:
        seen.demand(False, "MAVSDK heard no autopilot")
        return
    telemetry, action = Telemetry(system), Action(system)
    attitudes, armed, enough = [], threading.Event(), threading.Event()

    def hear_armed(is_armed, *_):
        if is_armed:
            armed.set()

    def hear_attitude(a, *_):
        if armed.is_set():
            attitudes.append(a.roll_deg)
        if len(attitudes) >= WANTED:
            enough.set()

    telemetry.subscribe_armed(hear_armed)
    telemetry.subscribe_attitude_euler(hear_attitude)
    until = time.monotonic() + PATIENCE
    while not armed.is_set() and time.monotonic() < until:
        try:
            seen["arm"] = str(action.arm())
        except Exception as e:  # Denied: its checks do not pass yet.
            seen["arm"] = str(e)
        armed.wait(1.0)
    enough.wait(PATIENCE)
    seen["armed"], seen["attitudes"] = armed.is_set(), len(attitudes)
    seen.demand(all(abs(roll) < 60.0 for roll in attitudes), f"roll {attitudes}")


def by_mavproxy(path, baud, seen):
    folder = tempfile.TemporaryDirectory()
    program = os.path.join(os.path.dirname(sys.executable), "mavproxy.py")
    options = ["--master", path, "--baudrate", str(baud), "--nowait", "--mav20"]
    options += ["--default-modules", "arm,link,message", "--state-basedir", folder.name, "--streamrate", "-1"]
    proxy = subprocess.Popen(
        [sys.executable, program, *options],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=folder.name,
        env={**os.environ, "TERM": "dumb", "HOME": folder.name},
    )
    os.set_blocking(proxy.stdout.fileno(), False)
    said, asked, until, attitudes = "", 0.0, time.monotonic() + PATIENCE, 0

    def type_in(line):
        proxy.stdin.write(line.encode() + b"\n")
        proxy.stdin.flush()

    type_in("watch ATTITUDE")
    while time.monotonic() < until and attitudes < WANTED:
        now = time.monotonic()
        if not seen.get("armed") and now >= asked:
            asked = now + 1.0
            type_in("arm throttle")
        if select.select([proxy.stdout], [], [], 0.2)[0]:
            said += (proxy.stdout.read() or b"").decode(errors="replace")
        seen["armed"] = bool(re.search(r"^ARMED", said, re.MULTILINE))
        attitudes = said.partition("\nARMED")[2].count("< ATTITUDE {")
    seen["attitudes"] = attitudes
    seen["said"] = said[-4000:]
    proxy.kill()
    proxy.wait()


def main():
    kind, name, baud, report = sys.argv[1:]
    seen = Seen(faults=[])
    path, line = cable(name, int(baud))
    try:
        {"pymavlink": by_pymavlink, "mavsdk": by_mavsdk, "mavproxy": by_mavproxy}[kind](path, int(baud), seen)
    finally:
        lost = line.outward.lost
        seen.demand(lost == 0, f"{lost} bytes more came than the line carries")
        with open(report, "w") as file:
            json.dump(seen, file)
        # The name goes before the line: the system gives the terminal's number to the next who asks, whom the bench would
        # find when it looks for its station again.
        os.unlink(name)
        print("the station is done", file=sys.stderr, flush=True)
    # The threads of a library do not always end in order.
    os._exit(0)


if __name__ == "__main__":
    main()
