"""A serial line between two descriptors: it carries baud / 10 bytes a second each way, as 8N1 does (8E2: baud / 12), and no more than BUFFER bytes
wait to be carried, as in the driver at its end. A pseudo-terminal alone carries everything at once, whatever its baud rate.
"""

import contextlib
import os
import socket
import threading
import time
import tty

# Of Linux's serial drivers, in bytes.
BUFFER = 4096
# How often the line is looked at, s.
GRAIN = 0.002


class Way:
    """One direction."""

    def __init__(self, source, target, rate):
        self.source, self.target, self.rate = source, target, rate
        self.waiting, self.credit = b"", 0.0
        # Bytes that were carried; bytes that found no room, and that nobody read at the other end.
        self.carried = self.lost = 0

    def turn(self, elapsed):
        """What the line does in `elapsed` s."""
        try:
            data = os.read(self.source, 65536)
        except OSError:
            # Nothing there, or nobody has the other end open.
            data = b""
        self.waiting += data
        self.credit += elapsed * self.rate
        count = min(int(self.credit), len(self.waiting))
        # A line that has nothing to carry does not save up for later.
        self.credit = self.credit - count if count < len(self.waiting) else 0.0
        if count:
            self.give(self.waiting[:count])
            self.waiting = self.waiting[count:]
        self.lost += max(0, len(self.waiting) - BUFFER)
        self.waiting = self.waiting[:BUFFER]

    def give(self, data):
        self.carried += len(data)
        try:
            os.write(self.target, data)
        except OSError:
            # What nobody reads is lost, as on a wire.
            pass


class Wire:
    """The line between the descriptors `near` and `far`; both are made non-blocking. `bits` a byte: 10 of 8N1, 12 of 8E2."""

    def __init__(self, near, far, baud, bits=10):
        for fd in (near, far):
            os.set_blocking(fd, False)
        self.outward, self.inward = Way(near, far, baud / bits), Way(far, near, baud / bits)
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.carry, daemon=True)
        self.thread.start()

    def carry(self):
        looked = time.monotonic()
        while not self.ended.wait(GRAIN):
            now = time.monotonic()
            for way in (self.outward, self.inward):
                way.turn(now - looked)
            looked = now

    def end(self):
        self.ended.set()
        self.thread.join()


class Line:
    """A serial line whose other end has a name, that of a pseudo-terminal; this end is the socket `mine`."""

    def __init__(self, name, baud, bits=10):
        # The other end stays open here, so that the line lives when nobody has it open.
        self.master, self.held = os.openpty()
        tty.setraw(self.held)
        self.mine, self.far = socket.socketpair()
        self.wire = Wire(self.master, self.far.fileno(), baud, bits)
        self.name = name
        os.symlink(os.ttyname(self.held), name)

    def close(self):
        # The name goes first: the system gives the terminal's number to the next who asks for one.
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self.name)
        self.wire.end()
        for end in (self.mine, self.far):
            end.close()
        os.close(self.master)
        os.close(self.held)
