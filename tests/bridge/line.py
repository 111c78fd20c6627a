#!/usr/bin/env python3
"""A serial line with a plug: a pseudo-terminal whose other end has a name while it is plugged in.

line.py PLUG PYTHON AUTOPILOT REPORT: the autopilot talks on the line. SIGUSR1 pulls the plug, or plugs it in again, as a
new line with an autopilot that began anew; SIGTERM ends it.
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


def carry(masters, signals):
    """Carries bytes both ways until a signal comes."""
    while True:
        ready = select.select([signals, *masters], [], [])[0]
        if signals in ready:
            return
        for fd in ready:
            try:
                data = os.read(fd, 4096)
                os.write(masters[1 - masters.index(fd)], data)
            except OSError:
                # Nobody has the bench's end open, and nothing tells when somebody does.
                time.sleep(0.005)


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
            [python, script, "--link", path, "--baud", "115200", "--rate", "100", "--arm-after", "0.5", "--report", report]
        )
        carry(masters, signals)
        ended = next_signal(signals) == signal.SIGTERM
        autopilot.terminate()
        autopilot.wait(timeout=10)
        os.unlink(plug)
        for fd in [*masters, held]:
            os.close(fd)
        ended = ended or next_signal(signals) == signal.SIGTERM


def next_signal(signals):
    """Waits for a signal, and says which it is."""
    return os.read(signals, 1)[0]


if __name__ == "__main__":
    main()
