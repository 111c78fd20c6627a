"""What a program under `exec` in a launch file needs besides messages: who it is, and how it starts and ends."""

import argparse
import os
import signal
import socket
import time

from whirlstand_messages import Command, Estimate

# State feedback u = -K x for the built-in quadrotor; states roll, roll rate, pitch, pitch rate in rad and rad/s, rows
# u_roll and u_pitch (linear-quadratic, Q = diag(40, 8, 40, 1), R = 1 in degrees). It stands in for your own law.
GAIN = [[-300.0, -202.0, -90.0, -15.0], [49.0, 31.0, -321.0, -57.0]]
LIMIT = 20.0


class Node:
    """This program's place on a bench, from the environment that the launcher sets, or from the command line."""

    def __init__(self, description: str):
        parser = argparse.ArgumentParser(description=description)
        parser.add_argument("--bench", default=os.environ.get("WHIRLSTAND_BENCH"), help="name of the bench")
        parser.add_argument("--node", default=os.environ.get("WHIRLSTAND_NODE", "python"), help="name of this node")
        parser.add_argument(
            "--connect",
            default=os.environ.get("WHIRLSTAND_ZENOH_CONNECT", ""),
            help="Zenoh endpoints of the other nodes, separated by commas",
        )
        parser.add_argument(
            "--listen",
            default=os.environ.get("WHIRLSTAND_ZENOH_LISTEN", ""),
            help="Zenoh endpoints to listen on, separated by commas",
        )
        parser.add_argument(
            "--config",
            default=os.environ.get("WHIRLSTAND_ZENOH_CONFIG", ""),
            help="Zenoh's configuration with this program's key; for a running bench: whirlstand keys show BENCH --path",
        )
        parser.add_argument("--control", action="store_true", help="be the controller: answer with Command")
        parser.add_argument("--every", type=int, default=100, help="print every that many estimates")
        options = parser.parse_args()
        if not options.bench:
            parser.error("which bench? Give --bench, or set WHIRLSTAND_BENCH")
        self.bench: str = options.bench
        self.name: str = options.node
        self.connect = [e for e in options.connect.split(",") if e]
        self.listen = [e for e in options.listen.split(",") if e]
        self.config: str = options.config
        self.control: bool = options.control
        self.every: int = max(1, options.every)
        self.ended = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._end)
        self._seen = 0
        self._sent = 0
        self._last = None

    def _end(self, _number, _frame):
        self.ended = True

    def ready(self):
        """Tells the launcher that this node can take part; without a launcher, nobody."""
        address = os.environ.get("NOTIFY_SOCKET")
        if address:
            if address.startswith("@"):
                address = "\0" + address[1:]
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
                notify.sendto(b"READY=1", address)

    def show(self, estimate: Estimate):
        """Prints some of the estimates."""
        if self._seen % self.every == 0:
            states = " ".join(f"{x:+.5f}" for x in estimate.x[: estimate.count])
            print(f"step {estimate.head.step}  t {estimate.head.stamp_ns * 1e-9:.3f} s  x {states}", flush=True)
        self._seen += 1

    def command(self, estimate: Estimate) -> Command:
        """The answer to an estimate: of the same step, with this publisher's own sequence number.

        An estimate that comes again is answered with the same command again.
        """
        if self._last is not None and self._last.head.step == estimate.head.step:
            return self._last
        command = Command()
        command.head.seq = self._sent
        command.head.step = estimate.head.step
        command.head.stamp_ns = estimate.head.stamp_ns
        command.count = len(GAIN)
        for i, row in enumerate(GAIN):
            u = -sum(k * x for k, x in zip(row, estimate.x))
            command.u[i] = min(max(u, -LIMIT), LIMIT)
        self._sent += 1
        self._last = command
        return command


def pause():
    """Lets other processes run, a tenth of a millisecond."""
    time.sleep(1e-4)
