#!/usr/bin/env python3
"""A client of Foxglove's WebSocket protocol that is not Foxglove's: it attaches to a bench, reads all topics by the schemas
that they are offered with, steers, and prints what it saw as JSON.

    client.py ws://127.0.0.1:8765 /control/SECRET

Protocol: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md. The server's messages are decoded by the public packages
`mcap-ros2-support` and `mcap-protobuf-support`.
"""

import asyncio
import base64
import json
import struct
import sys

import websockets
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as RosFactory

SUBPROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
MESSAGE_DATA = 1
# What the bench is asked for, and what it says then.
SETPOINT = {"do": "set", "what": "setpoint.roll=5deg"}
GUST = {"do": "inject", "what": "roll_rate=60deg/s^2", "for_s": 0.2}
TOO_MUCH = {"do": "set", "what": "setpoint.roll=1e9deg"}
STOP = {"do": "stop"}
NEEDED = {"/imu", "/truth", "/estimate", "/command", "/setpoint", "/health", "/tf", "/scene"}


class Client:
    """One connection."""

    def __init__(self, socket):
        self.socket = socket
        self.channels, self.decoders, self.messages = {}, {}, {}
        self.statuses, self.events, self.times = [], [], {}
        self.frames = set()

    async def hear(self):
        """Takes one message of the server."""
        data = await self.socket.recv()
        if isinstance(data, str):
            self.told(json.loads(data))
            await self.subscribe()
        elif data[0] == MESSAGE_DATA:
            subscription, time = struct.unpack_from("<IQ", data, 1)
            self.message(self.channels[subscription], time, data[13:])

    def told(self, message):
        if message["op"] == "serverInfo":
            self.info = message
        elif message["op"] == "advertise":
            for channel in message["channels"]:
                self.channels.setdefault(channel["id"], channel)
        elif message["op"] == "status":
            self.statuses.append(message["message"])

    async def subscribe(self):
        new = [c["id"] for c in self.channels.values() if not c.setdefault("subscribed", False)]
        for channel in new:
            self.channels[channel]["subscribed"] = True
        if new:
            wanted = [{"id": channel, "channelId": channel} for channel in new]
            await self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self, channel, time, data):
        topic = channel["topic"]
        if topic not in self.decoders:
            is_ros = channel["encoding"] == "cdr"
            text = channel["schema"]
            raw = text.encode() if is_ros else base64.b64decode(text)
            schema = Schema(id=channel["id"], name=channel["schemaName"], encoding=channel["schemaEncoding"], data=raw)
            factory = RosFactory() if is_ros else ProtobufFactory()
            self.decoders[topic] = factory.decoder_for(channel["encoding"], schema)
        decoded = self.decoders[topic](data)
        self.messages[topic] = decoded
        self.times.setdefault(topic, []).append(time)
        if topic == "/log":
            self.events.append(decoded.message)
        elif topic == "/tf":
            self.frames.update(t.child_frame_id for t in decoded.transforms)

    async def until(self, seen):
        while not seen():
            await self.hear()

    async def publish(self, topic, control, channel):
        offer = {"id": channel, "topic": topic, "encoding": "json", "schemaName": "control"}
        await self.socket.send(json.dumps({"op": "advertise", "channels": [offer]}))
        await self.socket.send(struct.pack("<BI", MESSAGE_DATA, channel) + json.dumps(control).encode())

    async def ask(self, topic, control, channel):
        """Publishes a control and waits for the sentence that answers it."""
        before = len(self.statuses)
        await self.publish(topic, control, channel)
        await self.until(lambda: len(self.statuses) > before)
        return self.statuses[-1]


async def main(url, topic):
    async with websockets.connect(url, subprotocols=SUBPROTOCOLS, max_size=None) as socket:
        client = Client(socket)
        await client.until(lambda: NEEDED <= set(client.messages) and len(client.frames) == 3)
        answers = [
            await client.ask("/control/guess", GUST, 1),
            await client.ask(topic, TOO_MUCH, 2),
            await client.ask(topic, SETPOINT, 3),
            await client.ask(topic, GUST, 4),
        ]
        await client.until(lambda: any("gust on roll_rate" in event for event in client.events))
        await client.until(lambda: abs(client.messages["/setpoint"].x.roll) > 0.08)
        answers.append(await client.ask(topic, STOP, 5))
        truth, transform = client.messages["/truth"], client.messages["/tf"].transforms[0]
        span = [min(min(t) for t in client.times.values()), max(max(t) for t in client.times.values())]
        scene = client.messages["/scene"].entities
        print(json.dumps({
            "subprotocol": socket.subprotocol,
            "server": client.info["name"],
            "capabilities": client.info["capabilities"],
            "topics": {c["topic"]: c["schemaName"] for c in client.channels.values()},
            "roll": truth.x.roll,
            "input": truth.u.u_roll,
            "setpoint": client.messages["/setpoint"].x.roll,
            "frames": sorted(client.frames),
            "parent": transform.parent_frame_id,
            "scene": [[len(e.cubes), len(e.cylinders), e.frame_id] for e in scene],
            "times_s": [t * 1e-9 for t in span],
            "answers": answers,
            "events": client.events,
        }))


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
