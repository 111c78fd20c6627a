"""A pilot whose radio a MAVLink autopilot hears, and the vehicle that flies by its channels."""

import math
import time

from radio import LASTING, PATIENCE, PERIOD, Vehicle

ARM, AUTOMATIC = 4, 5


class Pilot:
    """Goes through phases of sticks and switches as radio.py's script has them, one period after the other:
    [["flown", {"arm": true, "automatic": true, "frames": 1500}], ...]. "disarmed" and "manual": nothing is overridden; "flown":
    the controller overrides, and does not take it back. With "arm": null the switch goes off and on until it does."""

    def __init__(self, phases):
        self.vehicle = Vehicle(1, 0)
        self.phases = iter(phases)
        self.sticks = None
        self.next_phase()

    def next_phase(self):
        self.awaited, self.sticks = next(self.phases, (None, self.sticks))
        if self.awaited is None:
            return
        self.left = self.lasting = self.sticks.get("frames", LASTING)
        self.until = time.monotonic() + PATIENCE + 2 * PERIOD * self.lasting
        self.again = self.sticks["arm"] is None

    def is_on(self):
        """His arm switch."""
        return int(2.0 * time.monotonic()) % 2 == 1 if self.again else self.sticks["arm"] is not False

    def radio(self):
        """What his receiver hears, us."""
        us = [self.sticks.get("roll", 1500), 1500, 1200, 1500] + [1600] * 12
        us[ARM] = 2000 if self.is_on() else 1000
        us[AUTOMATIC] = 2000 if self.sticks["automatic"] else 1000
        return us

    def step(self, override, fault):
        """One period under this override of roll and pitch, `None` where there is none. Angles and rates of roll, pitch and yaw;
        `None` at the end of the last phase."""
        channels = [mine if theirs is None else theirs for mine, theirs in zip(self.radio(), override or (None, None))]
        self.vehicle.step(channels, self.sticks.get("push", 0.0))
        overridden = override is not None
        if overridden == (self.awaited == "flown") and self.is_on() == (self.awaited != "disarmed"):
            self.again, self.left = False, self.left - 1
        else:
            self.left = self.lasting
        if time.monotonic() > self.until:
            fault(f"never came to {self.awaited}: {override}")
            self.left = 0
        if self.left <= 0:
            self.next_phase()
        roll, p, pitch, q = (math.radians(x) for x in self.vehicle.x)
        return None if self.awaited is None else ((roll, pitch, 0.0), (p, q, 0.0))
