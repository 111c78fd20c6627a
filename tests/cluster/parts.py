"""Flies the parts of a campaign on a HyperQueue server with two workers, by the engine's own client for Python.

    python parts.py PROGRAM CAMPAIGN OUT PARTS
"""

import sys

from hyperqueue import Job, LocalCluster
from hyperqueue.cluster import WorkerConfig

# A program that was killed is started again; one that says that something is wrong is not.
TASK = """
until "$0" campaign "$1" --out "$2" --jobs 1 --shard "$3" --resume; do
    [ $? -ge 128 ] || exit 2
    echo started again
done"""

program, campaign, out, parts = sys.argv[1:]
# On a cluster the server and its workers are there already: client = hyperqueue.Client()
with LocalCluster() as cluster:
    for _ in range(2):
        cluster.start_worker(WorkerConfig(cores=1))
    client = cluster.client()
    job = Job(max_fails=0)
    for part in range(1, int(parts) + 1):
        job.program(
            ["sh", "-c", TASK, program, campaign, out, f"{part}/{parts}"],
            stdout=f"{out}/task-{part}.txt",
            stderr=f"{out}/task-{part}.err",
            crash_limit=5,
        )
    client.wait_for_jobs([client.submit(job)])
