"""PX4's side of the conversation with a ground station, on the line over which its sensors come as well.

Written from PX4's documents and the MAVLink services: heartbeats, arming by command, words, the events of the arming checks, the
attitude at the rate that is asked for. Armed by a station alone, and only once its checks pass.
"""

import struct
import time

from pymavlink.generator.mavcrc import x25crc

ARM, SET_INTERVAL, REQUEST_MESSAGE, PREARM_CHECKS = 400, 511, 512, 401
ACCEPTED, DENIED, UNSUPPORTED = 0, 1, 3
ATTITUDE, ACTUATOR_CONTROLS, VERSION = 30, 93, 148
# FNV-1a of "commander_arming_check_summary", 24 bits, with component 1 above: from the tests of libevents.
SUMMARY = 1 << 24 | 11047904
GPS, MAGNETOMETER = 1 << 3, 1 << 27
PROTOCOL = 8
# Bits of SYS_STATUS: gyroscope, accelerometer, magnetometer, pressure, GPS, and whether the checks before arming pass.
BIT_MAGNETOMETER, BIT_GPS, BIT_CHECKS = 0x4, 0x20, 0x10000000
CHECKED = 0xF | BIT_GPS | BIT_CHECKS


class Event:
    """EVENT, number 410, which pymavlink does not know: laid out by its definition in common.xml."""

    NUMBER = 410
    FIELDS = "EVENT uint32_t id uint32_t event_time_boot_ms uint16_t sequence uint8_t destination_component uint8_t destination_system "
    FIELDS += "uint8_t log_levels uint8_t arguments "

    def __init__(self, payload):
        self.payload = payload.rstrip(b"\0") or b"\0"

    def pack(self, mav):
        definition = x25crc(self.FIELDS.encode() + b"\x28")
        extra = (definition.crc & 0xFF) ^ (definition.crc >> 8)
        number = self.NUMBER.to_bytes(3, "little")
        frame = bytes([len(self.payload), 0, 0, mav.seq, mav.srcSystem, mav.srcComponent]) + number + self.payload
        mav.seq = (mav.seq + 1) & 0xFF
        return b"\xfd" + frame + x25crc(frame + bytes([extra])).crc.to_bytes(2, "little")


class Commander:
    def __init__(self, mav, send, report, ready_after, bits=False):
        self.mav, self.send, self.report = mav, send, report
        self.armed = False
        self.began = time.monotonic()
        self.ready_after = ready_after
        self.bits = bits
        self.was_ready = None
        self.interval = 0.1
        self.next = {"beat": 0.0, "attitude": 0.0}
        self.sequence = 65525
        report["armed_by"] = None
        report["denied"] = 0
        report["intervals"] = {}

    def boot_ms(self):
        return int(1e3 * (time.monotonic() - self.began)) + 1

    def is_ready(self):
        return time.monotonic() - self.began > self.ready_after

    def say(self, severity, text):
        self.send(self.mav.statustext_encode(severity, text.encode()))

    def tell_checks(self):
        """As PX4 lays it out: u8 part, u32 errors, u32 warnings, u32 modes."""
        if self.bits:
            return
        failing, modes = (0, 0x7FFF) if self.is_ready() else (GPS | MAGNETOMETER, 0)
        arguments = struct.pack("<BIII", 0, failing, 0, modes).ljust(40, b"\0")
        self.sequence = (self.sequence + 1) & 0xFFFF
        self.send(Event(struct.pack("<IIHBBB", SUMMARY, self.boot_ms(), self.sequence, 0, 0, PROTOCOL << 4 | PROTOCOL) + arguments))

    def hear(self, message):
        """What somebody says to the vehicle."""
        kind, source = message.get_type(), message.get_srcSystem()
        if kind == "BAD_DATA":
            return
        simulator = source == 142
        if kind.startswith("HIL_"):
            self.report.demand(simulator, f"{kind} of system {source}: somebody else writes the sensors")
        if simulator and kind != "COMMAND_LONG":
            return
        self.report["stations"] = sorted({*self.report.notes.get("stations", []), source} - {142})
        if kind == "COMMAND_LONG" and message.target_system in (0, 1):
            self.command(message, source)
        if kind == "PARAM_REQUEST_LIST" or kind == "PARAM_REQUEST_READ":
            self.send(self.mav.param_value_encode(b"SYS_HITL", 1.0, 6, 1, 0))

    def command(self, message, source):
        result = UNSUPPORTED
        if message.command == ARM:
            result = self.arm(message, source)
        elif message.command == SET_INTERVAL:
            number = int(message.param1)
            self.report["intervals"][str(number)] = message.param2
            self.report.demand(number != ACTUATOR_CONTROLS, f"system {source} changed the rate of the outputs")
            if number == ATTITUDE and message.param2 > 0:
                # As slow as the line is.
                self.interval = max(0.05, 1e-6 * message.param2)
            result = ACCEPTED
        elif message.command == PREARM_CHECKS:
            self.tell_checks()
            result = ACCEPTED
        elif message.command == REQUEST_MESSAGE and int(message.param1) == VERSION or message.command == 520:
            self.send(self.mav.autopilot_version_encode(0x200F, 0x010E0000, 0, 0, 0, *[[0] * 8] * 3, 0, 0, 1))
            result = ACCEPTED
        self.send(self.mav.command_ack_encode(message.command, result, 0, 0, source, message.get_srcComponent()))

    def arm(self, message, source):
        if message.param1 < 0.5:
            self.armed = False
        elif not self.is_ready():
            self.report["denied"] += 1
            self.say(2, "Arming denied: Resolve system health failures first\t")
            return DENIED
        else:
            self.armed = True
            self.report["armed_by"] = source
            self.say(6, "Armed by external command\t")
        self.next["beat"] = 0.0
        return ACCEPTED

    def tick(self, angles, rates):
        """What is due."""
        now = time.monotonic()
        ready = self.is_ready()
        if ready != self.was_ready and not self.bits:
            self.was_ready = ready
            self.tell_checks()
            if not ready:
                self.say(2, "Preflight Fail: ekf2 missing data\t")
        if now >= self.next["beat"]:
            self.next["beat"] = now + 1.0
            # HIL is on.
            mode = 1 | 32 | (128 if self.armed else 0)
            self.send(self.mav.heartbeat_encode(2, 12, mode, 0x00010000, 4 if self.armed else 3))
            well = CHECKED if ready else CHECKED & ~(BIT_CHECKS | BIT_MAGNETOMETER | BIT_GPS)
            self.send(self.mav.sys_status_encode(CHECKED, CHECKED, well, 100, 12000, -1, -1, 0, 0, 0, 0, 0, 0))
        if now >= self.next["attitude"]:
            self.next["attitude"] = now + self.interval
            self.send(self.mav.attitude_encode(self.boot_ms(), *angles, *rates))
