#!/usr/bin/env python3
"""A ground station made with MAVSDK: connects, and writes the attitudes that it reads as JSON."""

import json
import math
import os
import sys
import threading

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.telemetry import Telemetry


def main():
    address, wanted = sys.argv[1], int(sys.argv[2])
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(address)
    system = mavsdk.first_autopilot(30.0)
    if system is None:
        sys.exit(f"MAVSDK heard no autopilot on {address}")
    telemetry = Telemetry(system)
    read, enough = [], threading.Event()

    def hear(a, *_):
        read.append([math.radians(a.roll_deg), math.radians(a.pitch_deg), math.radians(a.yaw_deg)])
        if len(read) >= wanted:
            enough.set()

    telemetry.subscribe_attitude_euler(hear)
    enough.wait(60.0)
    print(json.dumps(read[:wanted]), flush=True)
    # Its threads do not always end in order.
    os._exit(0 if len(read) >= wanted else 1)


if __name__ == "__main__":
    main()
