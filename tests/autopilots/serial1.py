"""ArduPilot's MAVLink at the TCP port of its SERIAL1, as software in the loop has it.

Written from ArduPilot's documents and the MAVLink services: heartbeats; texts only to those who have said something; its
checks before arming one text each, every half minute or when asked (MAV_CMD_RUN_PREARM_CHECKS). Nobody arms it here.
"""

import socket
import time

from pymavlink.dialects.v20 import common

PREARM_CHECKS, ACCEPTED = 401, 0
QUADROTOR, ARDUPILOT, CRITICAL, INFO = 2, 3, 2, 6
STABILIZE = 0
FAILING = ("PreArm: RC not calibrated", "PreArm: AHRS: EKF3 Yaw inconsistent 12 deg. Wait or reboot")
CHUNK = 50


class Serial1:
    def __init__(self, port, report):
        self.server = socket.create_server(("127.0.0.1", port))
        self.server.setblocking(False)
        self.report, self.client = report, None
        self.mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
        self.beat, self.text, self.spoken_to = 0.0, 0, False
        report["asked"] = report["beats"] = 0

    def send(self, message):
        try:
            self.client.sendall(message.pack(self.mav))
        except OSError:
            self.client = None

    def say(self, severity, text):
        """A text of more than 50 bytes comes in several messages with one number."""
        if not self.spoken_to:
            return
        data = text.encode()
        self.text += 1
        for i in range(0, len(data), CHUNK):
            number = self.text if len(data) > CHUNK else 0
            self.send(self.mav.statustext_encode(severity, data[i : i + CHUNK], number, i // CHUNK))

    def hear(self):
        try:
            data = self.client.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.client = None
            return
        for message in self.mav.parse_buffer(data) or []:
            kind = message.get_type()
            self.report.demand(kind in ("HEARTBEAT", "COMMAND_LONG"), f"{kind} on a link that only listens")
            self.spoken_to = True
            if kind == "HEARTBEAT":
                self.report.demand(message.autopilot == 8, "a heartbeat of no station")
                self.report["beats"] += 1
            if kind == "COMMAND_LONG":
                self.command(message)

    def command(self, message):
        wanted = message.command == PREARM_CHECKS and message.target_system == 1
        self.report.demand(wanted, f"command {message.command} to {message.target_system}")
        self.report["asked"] += 1
        for text in FAILING:
            self.say(CRITICAL, text)
        # What it says last is not why.
        self.say(INFO, "GPS 1: detected u-blox")
        self.send(self.mav.command_ack_encode(PREARM_CHECKS, ACCEPTED, 0, 0, message.get_srcSystem(), message.get_srcComponent()))

    def tick(self, armed):
        """What is due."""
        if self.client is None:
            try:
                self.client, _ = self.server.accept()
            except BlockingIOError:
                return
            self.client.setblocking(False)
            self.spoken_to = False
        self.hear()
        now = time.monotonic()
        if self.client and now >= self.beat:
            self.beat = now + 1.0
            mode = 1 | (128 if armed else 0)
            self.send(self.mav.heartbeat_encode(QUADROTOR, ARDUPILOT, mode, STABILIZE, 4 if armed else 3))
