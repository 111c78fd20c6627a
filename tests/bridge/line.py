#!/usr/bin/env python3
"""A serial line with a plug: it carries what its baud rate allows, and its other end has a name while it is plugged in.

line.py PLUG PYTHON AUTOPILOT REPORT: the autopilot talks on the line. SIGUSR1 pulls the plug, or plugs it in again, as a
new line with an autopilot that began anew; SIGTERM ends it.
"""

import os
import signal
import subprocess
import sys
import termios
import tty

sys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "autopilots"))
import wire  # noqa: E402

BAUD = 921600


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


def main():
    plug, python, script, report = sys.argv[1:]
    signals, wakes = os.pipe()
    os.set_blocking(wakes, False)
    signal.set_wakeup_fd(wakes)
    for number in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, lambda *_: None)
    ended = False
    while not ended:
        masters, held, path = line(plug)
        autopilot = subprocess.Popen(
            [python, script, "--link", path, "--baud", str(BAUD), "--rate", "100", "--arm-after", "0.5", "--report", report]
        )
        carrier = wire.Wire(*masters, BAUD)
        ended = next_signal(signals) == signal.SIGTERM
        autopilot.terminate()
        autopilot.wait(timeout=10)
        carrier.end()
        os.unlink(plug)
        for fd in [*masters, held]:
            os.close(fd)
        ended = ended or next_signal(signals) == signal.SIGTERM


def next_signal(signals):
    """Waits for a signal, and says which it is."""
    return os.read(signals, 1)[0]


if __name__ == "__main__":
    main()
