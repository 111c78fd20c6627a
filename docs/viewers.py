"""What viewers of the live page cost the loop, as a table in Markdown.

    viewers.py WHIRLSTAND [RUNS] [PRIORITY]: flights of 20 s at 500 Hz in real time, without a page, and with a page that 0,
    1 and 5 programs read, interleaved, RUNS times each (2). With PRIORITY all nodes of the loop run under SCHED_FIFO.
"""

import json
import re
import subprocess
import sys
import tempfile
import threading
import urllib.request

FLIGHT = ["run", "quadrotor", "--mode", "realtime", "--duration", "20", "--set", "rate_hz=500"]


def read(url, heard):
    frames = urllib.request.urlopen(url)
    heard.append(sum(len(line) for line in frames))


def fly(program, viewers, priority):
    """The plant's figures of one flight with this many viewers, `None` for no page at all."""
    with tempfile.TemporaryDirectory() as out:
        page = [] if viewers is None else ["--live", "0"]
        nodes = ("plant", "estimator", "controller") if priority else ()
        options = [word for node in nodes for word in ("--set", f"nodes.{node}.priority={priority}")]
        command = [program, *FLIGHT, "--out", out, *page, *options]
        quiet = subprocess.DEVNULL
        bench = subprocess.Popen(command, stdout=quiet, stderr=subprocess.PIPE, text=True)
        threads, heard = [], []
        for line in bench.stderr:
            found = re.search(r"live page (http://\S+?)(\?\S*)?$", line.split(" (")[0].strip())
            if found and not threads:
                url = found[1] + "events" + (found[2] or "")
                threads = [threading.Thread(target=read, args=(url, heard)) for _ in range(viewers)]
                for thread in threads:
                    thread.start()
        bench.wait()
        for thread in threads:
            thread.join()
        # Each one has really read.
        assert len(heard) == (viewers or 0) and all(count > 1_000_000 for count in heard), heard
        with open(f"{out}/summary.json") as file:
            return json.load(file)["runs"][0]


def main():
    program, runs = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 2
    priority = sys.argv[3] if len(sys.argv) > 3 else None
    columns = (None, 0, 1, 5)
    found = {viewers: [] for viewers in columns}
    for _ in range(runs):
        for viewers in columns:
            found[viewers].append(fly(program, viewers, priority))
    latency = lambda key: lambda run: f"{run['timing']['nodes']['plant']['latency'][key]:.0f} us"
    rows = {
        "command latency, p50": latency("p50_us"),
        "p99": latency("p99_us"),
        "p99.9": latency("p999_us"),
        "missed of 10,000": lambda run: str(run["timing"]["deadline_misses"]),
        "lost": lambda run: str(run["timing"]["lost"]),
    }
    print("| | no page | no viewer | 1 | 5 |\n|---|---|---|---|---|")
    for name, cell in rows.items():
        print(f"| {name} | " + " | ".join(", ".join(cell(run) for run in found[v]) for v in columns) + " |")


main()
