#!/usr/bin/env python3
"""A serial line with a plug: a pseudo-terminal whose other end has a name while it is plugged in.

line.py PLUG PYTHON AUTOPILOT REPORT: the autopilot talks on the line; after 4 s it is unplugged, and another second
later plugged in again, as a new line.
"""

import os
import select
import signal
import subprocess
import sys
import termios
import time
import tty


def line(plug):
    """Two pseudo-terminals back to back: the autopilot's end, and the bench's with a name."""
    masters, paths, slaves = [], [], []
    for _ in range(2):
        master, slave = os.openpty()
        tty.setraw(master, termios.TCSANOW)
        tty.setraw(slave, termios.TCSANOW)
        masters.append(master)
        slaves.append(slave)
        paths.append(os.ttyname(slave))
    os.symlink(paths[1], plug)
    # The autopilot's end stays open here, so that it lives when nobody reads.
    os.close(slaves[1])
    return masters, slaves[0], paths[0]


def carry(masters, until, ended):
    while time.monotonic() < until and not ended:
        for ready in select.select(masters, [], [], 0.02)[0]:
            try:
                data = os.read(ready, 4096)
                os.write(masters[1 - masters.index(ready)], data)
            except OSError:
                # Nobody has the bench's end open.
                time.sleep(0.005)


def main():
    plug, python, script, report = sys.argv[1:]
    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    for seconds in (6.0, 1e9):
        masters, held, path = line(plug)
        autopilot = subprocess.Popen(
            [python, script, "--link", path, "--baud", "115200", "--rate", "100", "--arm-after", "0.5", "--report", report]
        )
        carry(masters, time.monotonic() + seconds, ended)
        autopilot.terminate()
        autopilot.wait(timeout=10)
        os.unlink(plug)
        for fd in [*masters, held]:
            os.close(fd)
        if ended:
            return
        time.sleep(1.0)


if __name__ == "__main__":
    main()
