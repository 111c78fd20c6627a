"""The messages of a Whirlstand bench, as docs/wire-format.md lays them out.

Shared memory carries the ctypes structures as they are. A network carries the schema hash (8 bytes, little-endian)
and then postcard: every f64 as 8 bytes little-endian, every u64 and u32 as a LEB128 varint, every u8 as it is.
"""

import ctypes
import struct
from ctypes import c_double, c_uint8, c_uint32, c_uint64


class SchemaMismatch(Exception):
    """The peer runs another version of the message."""


class Head(ctypes.Structure):
    """Sequence number of the publisher, step of the loop, and time of that step in ns."""

    _fields_ = [("seq", c_uint64), ("step", c_uint64), ("stamp_ns", c_uint64)]


class Message(ctypes.Structure):
    """What all messages have in common."""

    TOPIC: str
    TYPE_NAME: str
    SCHEMA_HASH: int

    @classmethod
    def type_name(cls) -> str:
        """The name under which iceoryx2 knows the type."""
        return cls.TYPE_NAME

    def encode(self) -> bytes:
        """The bytes for a network."""
        out = bytearray(struct.pack("<Q", self.SCHEMA_HASH))
        for kind, values in _elements(self):
            for value in values:
                if kind is c_double:
                    out += struct.pack("<d", value)
                elif kind is c_uint8:
                    out.append(value)
                else:
                    out += _varint(value)
        return bytes(out)

    @classmethod
    def decode(cls, wire: bytes):
        """The message in bytes from a network."""
        found = struct.unpack_from("<Q", wire)[0]
        if found != cls.SCHEMA_HASH:
            raise SchemaMismatch(
                f"{cls.TYPE_NAME} has schema {found:#018x} at the peer and {cls.SCHEMA_HASH:#018x} here: "
                "both sides must run the same message version"
            )
        memory = bytearray()
        at = 8
        for kind, values in _elements(cls()):
            for _ in values:
                if kind is c_double:
                    memory += wire[at : at + 8]
                    at += 8
                elif kind is c_uint8:
                    memory.append(wire[at])
                    at += 1
                else:
                    value, at = _read_varint(wire, at)
                    memory += value.to_bytes(ctypes.sizeof(kind), "little")
        if at != len(wire):
            raise ValueError(f"{cls.TYPE_NAME}: {len(wire)} bytes received, {at} expected")
        return cls.from_buffer_copy(memory)


def _elements(structure):
    """Kind and values of each field, in memory order, with the head opened up."""
    for name, kind in structure._fields_:
        value = getattr(structure, name)
        if isinstance(value, ctypes.Structure):
            yield from _elements(value)
        elif isinstance(value, ctypes.Array):
            yield value._type_, list(value)
        else:
            yield kind, [value]


def _varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _read_varint(wire: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = wire[at]
        value |= (byte & 0x7F) << shift
        at += 1
        shift += 7
        if byte < 0x80:
            return value, at


# The layouts below are written by `WHIRLSTAND_BLESS=1 cargo test -p whirlstand-msgs --test wire_format`, and checked
# by the same test without it. Units and meanings are in docs/wire-format.md.
# layouts: begin


class Imu(Message):
    TOPIC = "imu"
    TYPE_NAME = "whirlstand/msg/Imu"
    SCHEMA_HASH = 0xbcae7513cba6275b
    _fields_ = [
        ("head", Head),
        ("roll", c_double),
        ("pitch", c_double),
        ("yaw", c_double),
        ("roll_rate", c_double),
        ("pitch_rate", c_double),
        ("yaw_rate", c_double),
        ("valid", c_uint32),
        ("flags", c_uint32),
    ]


class Odometry(Message):
    TOPIC = "odometry"
    TYPE_NAME = "whirlstand/msg/Odometry"
    SCHEMA_HASH = 0xb576362c2fa31ae2
    _fields_ = [
        ("head", Head),
        ("longitudinal_position", c_double),
        ("lateral_position", c_double),
        ("height", c_double),
        ("longitudinal_speed", c_double),
        ("lateral_speed", c_double),
        ("vertical_speed", c_double),
        ("valid", c_uint32),
        ("reserved", c_uint32),
    ]


class Outputs(Message):
    TOPIC = "outputs"
    TYPE_NAME = "whirlstand/msg/Outputs"
    SCHEMA_HASH = 0xdcd91c371c55a956
    _fields_ = [
        ("head", Head),
        ("y", c_double * 32),
        ("valid", c_uint64),
    ]


class Estimate(Message):
    TOPIC = "estimate"
    TYPE_NAME = "whirlstand/msg/Estimate"
    SCHEMA_HASH = 0xeb99a7d75a3eeacd
    _fields_ = [
        ("head", Head),
        ("x", c_double * 16),
        ("std", c_double * 16),
        ("bias", c_double * 4),
        ("nis", c_double),
        ("dof", c_uint32),
        ("count", c_uint32),
        ("flags", c_uint32),
        ("reserved", c_uint32),
    ]


class Command(Message):
    TOPIC = "command"
    TYPE_NAME = "whirlstand/msg/Command"
    SCHEMA_HASH = 0xb7d9d211592d206e
    _fields_ = [
        ("head", Head),
        ("u", c_double * 8),
        ("count", c_uint32),
        ("flags", c_uint32),
    ]


class Setpoint(Message):
    TOPIC = "setpoint"
    TYPE_NAME = "whirlstand/msg/Setpoint"
    SCHEMA_HASH = 0x8d789c7eb22297df
    _fields_ = [
        ("head", Head),
        ("x", c_double * 16),
        ("stick", c_double * 8),
        ("tracked", c_uint64),
    ]


class Truth(Message):
    TOPIC = "truth"
    TYPE_NAME = "whirlstand/msg/Truth"
    SCHEMA_HASH = 0x75548f0862fa95ed
    _fields_ = [
        ("head", Head),
        ("x", c_double * 16),
        ("u", c_double * 8),
        ("states", c_uint32),
        ("inputs", c_uint32),
        ("flags", c_uint32),
        ("reserved", c_uint32),
    ]


class Disturbance(Message):
    TOPIC = "disturbance"
    TYPE_NAME = "whirlstand/msg/Disturbance"
    SCHEMA_HASH = 0x795e3c63fe1f170e
    _fields_ = [
        ("head", Head),
        ("dx", c_double * 16),
        ("count", c_uint32),
        ("reserved", c_uint32),
    ]


class Sent(Message):
    TOPIC = "sent"
    TYPE_NAME = "whirlstand/msg/Sent"
    SCHEMA_HASH = 0x626298cbd73834b9
    _fields_ = [
        ("head", Head),
        ("channels", c_double * 16),
        ("u", c_double * 8),
        ("stick", c_double * 16),
        ("link_quality", c_double),
        ("messages", c_uint64),
        ("count", c_uint32),
        ("in_charge", c_uint32),
        ("armed", c_uint32),
        ("reason", c_uint32),
    ]


class Reported(Message):
    TOPIC = "reported"
    TYPE_NAME = "whirlstand/msg/Reported"
    SCHEMA_HASH = 0xb397116d9a304fa5
    _fields_ = [
        ("head", Head),
        ("rssi", c_double),
        ("remote_rssi", c_double),
        ("pilot_rssi", c_double),
        ("custom_mode", c_uint32),
        ("base_mode", c_uint32),
        ("system_status", c_uint32),
        ("known", c_uint32),
    ]


class Autopilot(Message):
    TOPIC = "autopilot"
    TYPE_NAME = "whirlstand/msg/Autopilot"
    SCHEMA_HASH = 0xa50d53367fca3891
    _fields_ = [
        ("head", Head),
        ("outputs", c_double * 32),
        ("rc", c_double * 16),
        ("gyro", c_double * 3),
        ("accel", c_double * 3),
        ("mag", c_double * 3),
        ("pressure", c_double),
        ("fix", c_double * 3),
        ("velocity", c_double * 3),
        ("armed", c_uint32),
        ("fault", c_uint32),
    ]


class Health(Message):
    TOPIC = "health"
    TYPE_NAME = "whirlstand/msg/Health"
    SCHEMA_HASH = 0xd46af5720c7cbba0
    _fields_ = [
        ("head", Head),
        ("steps", c_uint64),
        ("deadline_misses", c_uint64),
        ("lost", c_uint64),
        ("rejected", c_uint64),
        ("latency_max_ns", c_uint64),
        ("latency", c_uint32 * 32),
        ("pid", c_uint32),
        ("state", c_uint32),
        ("node", c_uint8 * 32),
    ]


class Progress(Message):
    TOPIC = "progress"
    TYPE_NAME = "whirlstand/msg/Progress"
    SCHEMA_HASH = 0x4a1f30e6492ffa7a
    _fields_ = [
        ("head", Head),
        ("written", c_uint64),
        ("lost", c_uint64),
    ]


class Adjustment(Message):
    TOPIC = "adjusted"
    TYPE_NAME = "whirlstand/msg/Adjustment"
    SCHEMA_HASH = 0x9566d54f41f05de6
    _fields_ = [
        ("head", Head),
        ("id", c_uint64),
        ("value", c_double),
        ("length_ns", c_uint64),
        ("what", c_uint32),
        ("index", c_uint32),
        ("verdict", c_uint32),
        ("reserved", c_uint32),
    ]


class Stick(Message):
    TOPIC = "stick"
    TYPE_NAME = "whirlstand/msg/Stick"
    SCHEMA_HASH = 0x48ca180d9c1edd72
    _fields_ = [
        ("head", Head),
        ("u", c_double * 8),
        ("id", c_uint64),
    ]


class Finding(Message):
    TOPIC = "finding"
    TYPE_NAME = "whirlstand/msg/Finding"
    SCHEMA_HASH = 0x7717eeb667ca1b99
    _fields_ = [
        ("head", Head),
        ("number", c_uint64),
        ("since_ns", c_uint64),
        ("evidence", c_double),
        ("probability", c_double),
        ("value", c_double * 4),
        ("low", c_double * 4),
        ("high", c_double * 4),
        ("stage", c_uint32),
        ("output", c_uint32),
        ("count", c_uint32),
        ("alike", c_uint32),
        ("effect", c_uint8 * 32),
        ("place", c_uint8 * 32),
        ("onto", c_uint8 * 32),
        ("names", c_uint8 * 32),
        ("units", c_uint8 * 32),
        ("alike_effect", c_uint8 * 32),
        ("alike_place", c_uint8 * 32),
    ]


# layouts: end
