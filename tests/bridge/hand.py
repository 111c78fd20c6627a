"""Somebody who turns a vehicle by hand as `bridge check` asks on standard input, one axis there, and back, and who holds the
sticks of its radio as it asks."""

import os

TURN = 0.5
RATE = 0.8
AXES = ("roll", "pitch", "yaw")


class Hand:
    def __init__(self, turned, reversed_sticks=()):
        """`turned`: axes that the vehicle tells with the wrong sign; `reversed_sticks`: axes whose channel goes down for stick
        right or back."""
        self.stick_signs = [-1 if axis in reversed_sticks else 1 for axis in AXES]
        self.sticks = [0, 0, 0]
        self.signs = [-1.0 if axis in turned else 1.0 for axis in AXES]
        self.said, self.rest = [], b""
        self.axis, self.target, self.angle, self.rate = 0, 0.0, 0.0, 0.0
        os.set_blocking(0, False)

    def listen(self):
        """Reads what is asked for, and keeps it."""
        try:
            *lines, self.rest = (self.rest + os.read(0, 65536)).split(b"\n")
        except BlockingIOError:
            return
        for line in lines:
            line = line.decode()
            self.said.append(line)
            if line.startswith("and back"):
                self.target = 0.0
            if line.startswith("and let it go"):
                self.sticks = [0, 0, 0]
            held = [i for i, axis in enumerate(AXES) if line.startswith(f"now hold the {axis} stick ")]
            if held:
                self.sticks[held[0]] = self.stick_signs[held[0]]
            asked = [i for i, axis in enumerate(AXES) if line.startswith(f"now {axis} ")]
            if asked:
                self.axis, self.target = asked[0], TURN

    def step(self, dt):
        """Angles and rates of roll, pitch and yaw, `dt` s later."""
        step = max(-RATE * dt, min(RATE * dt, self.target - self.angle))
        self.angle += step
        sign = self.signs[self.axis]
        angles, rates = [0.0] * 3, [0.0] * 3
        angles[self.axis], rates[self.axis] = sign * self.angle, sign * step / dt
        return angles, rates
