"""Plant, estimator and controller at 1 kHz over dora, and `whirlstand bench realtime` beside it in the same run.

    pip install -r tests/peers/requirements.txt
    python tests/peers/three_nodes.py target/release/whirlstand [--seconds 30]

The three nodes of the peer are Python, dora's own client for it, and do nothing but hand on what came: plant to estimator to controller
and back to the plant, 24 numbers each. The latency is from before the plant sends until it has the answer, as in Whirlstand's
`Health`; an answer later than a period is a miss. So what is compared is a transport with its clients, and the peer has no
filter and no law to compute.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time

import numpy

PERIOD_NS = 1_000_000
NUMBERS = 24


def node(role, steps, report):
    """One node of the peer, as dora starts it."""
    import pyarrow
    from dora import Node

    node = Node()
    if role == "plant":
        latencies = plant(node, pyarrow, steps)
        numpy.save(report, numpy.array(latencies))
        return
    output = {"estimator": "estimate", "controller": "command"}[role]
    for event in node:
        if event["type"] == "STOP":
            return
        if event["type"] == "INPUT":
            node.send_output(output, event["value"])


def plant(node, pyarrow, steps):
    """Sends at absolute times, and waits for the answer to each; latencies in ns."""
    latencies = []
    values = numpy.zeros(NUMBERS)
    # The others are started by then.
    begin = time.monotonic_ns() + 2_000_000_000
    for step in range(steps):
        at = begin + step * PERIOD_NS
        wait = at - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait * 1e-9)
        values[0] = step
        sent = time.monotonic_ns()
        node.send_output("imu", pyarrow.array(values))
        while True:
            event = node.next(timeout=5.0)
            if event is None or event["type"] == "STOP":
                return latencies
            if event["type"] == "INPUT" and event["value"][0].as_py() == step:
                break
        latencies.append(time.monotonic_ns() - sent)
    return latencies


def dataflow(folder, steps):
    """The file that dora reads."""
    report = os.path.join(folder, "latencies.npy")
    wiring = [
        ("plant", "imu", "controller/command"),
        ("estimator", "estimate", "plant/imu"),
        ("controller", "command", "estimator/estimate"),
    ]
    lines = ["nodes:"]
    for role, output, source in wiring:
        lines += [
            f"  - id: {role}",
            f"    path: {sys.executable}",
            f"    args: {os.path.abspath(__file__)} --role {role} --steps {steps} --report {report}",
            f"    inputs: {{ in: {source} }}",
            f"    outputs: [{output}]",
        ]
    path = os.path.join(folder, "dataflow.yml")
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    return path, report


def dora(seconds):
    """Latencies of the peer, in ns."""
    with tempfile.TemporaryDirectory() as folder:
        path, report = dataflow(folder, seconds * 1_000)
        program = os.path.join(os.path.dirname(sys.executable), "dora")
        ended = subprocess.run([program, "run", path], cwd=folder, timeout=seconds + 60, capture_output=True, text=True)
        if not os.path.exists(report):
            sys.exit(f"dora did not come to its end:\n{ended.stdout}\n{ended.stderr}")
        return numpy.load(report)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("whirlstand", nargs="?", default="target/release/whirlstand")
    parser.add_argument("--seconds", type=int, default=30)
    parser.add_argument("--role", help=argparse.SUPPRESS)
    parser.add_argument("--steps", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--report", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.role:
        return node(args.role, args.steps, args.report)
    loads = [os.getloadavg()[0]]
    latencies = dora(args.seconds)
    loads.append(os.getloadavg()[0])
    ours = subprocess.run(
        [args.whirlstand, "bench", "realtime", "--realtime-seconds", str(args.seconds)],
        timeout=4 * args.seconds + 120,
        capture_output=True,
        text=True,
    )
    loads.append(os.getloadavg()[0])
    print("load of the machine before, between and after: " + ", ".join(f"{load:.1f}" for load in loads))
    p50, p99, p999 = numpy.percentile(latencies, [50, 99, 99.9]) * 1e-3
    late = int((latencies > PERIOD_NS).sum())
    print(f"dora, three Python nodes: {len(latencies)} steps, {late} later than a period")
    print(f"  p50 {p50:.0f} us, p99 {p99:.0f} us, p99.9 {p999:.0f} us")
    print(ours.stdout or ours.stderr)


if __name__ == "__main__":
    main()
