#!/usr/bin/env python3
"""Identification against SciPy, side by side in one run.

One 60 s, 100 Hz, 4-output record of the quadrotor. Both programs minimise the same cost (squared simulation errors
over the outputs' noise variances, initial state estimated) from the same start.

    pip install numpy scipy
    cargo build --release
    python3 docs/identify-speed.py target/release/whirlstand

SciPy simulates in two ways: a NumPy loop over the steps, which is what one writes first, and one that an expert writes:
the modes of the model as recursive filters in compiled code (scipy.signal.lfilter). NumPy's matrix library gets one
thread: with more it is slower on matrices of this size. Every time is the least of some repetitions; SciPy's with `pem` is
processor time, so that other work of the machine is not counted against it. `chrt -f 5 python3 docs/identify-speed.py ...`
as root keeps other work out.
"""

import json
import os
import subprocess
import sys
import tempfile
import time

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

import numpy as np
import scipy
from scipy.linalg import expm
from scipy.optimize import differential_evolution, least_squares
from scipy.signal import lfilter

PERIOD = 0.01
STEPS = 6000
NOISE = np.array([0.08, 0.4, 0.08, 0.4])
A = np.array([[0, 1, 0, 0], [-1.1132, -0.7118, 0.0001, 0], [0, 0, 0, 1], [7.2721, 6.1794, -7.9908, -5.2474]])
B = np.array([[0, 0], [-1.1045, 0], [0, 0], [-4.5267, -14.4146]])
FREE = [("A", 1, j) for j in range(4)] + [("A", 3, j) for j in range(4)] + [("B", i, j) for i in (1, 3) for j in (0, 1)]


def matrices(theta):
    a, b = np.zeros((4, 4)), np.zeros((4, 2))
    a[0, 1] = a[2, 3] = 1.0
    for (matrix, i, j), value in zip(FREE, theta):
        (a if matrix == "A" else b)[i, j] = value
    block = np.zeros((6, 6))
    block[:4, :4], block[:4, 4:] = a, b
    block = expm(block * PERIOD)
    return block[:4, :4], block[:4, 4:]


def loop(theta, x0, u):
    phi, gamma = matrices(theta)
    x, drive, out = np.array(x0, float), u @ gamma.T, np.empty((len(u), 4))
    for k in range(len(u)):
        out[k] = x
        x = phi @ x + drive[k]
    return out


def modal(theta, x0, u):
    phi, gamma = matrices(theta)
    poles, modes = np.linalg.eig(phi)
    inverse = np.linalg.inv(modes)
    drive = u @ (inverse @ gamma).T
    drive = np.vstack([inverse @ np.array(x0, float), drive[:-1]])
    states = np.column_stack([lfilter([1.0], [1.0, -p], drive[:, i]) for i, p in enumerate(poles)])
    return (states @ modes.T).real


def record(seed):
    rng = np.random.default_rng(seed)
    u = np.zeros((STEPS, 2))
    for j in range(2):
        k = 0
        while k < STEPS:
            length = int(rng.uniform(0.2, 1.5) / PERIOD)
            u[k : k + length, j] = 0.0 if rng.random() < 0.3 else rng.uniform(-10, 10)
            k += length
    truth = np.array([(A if m == "A" else B)[i, j] for m, i, j in FREE])
    return u, loop(truth, np.zeros(4), u) + NOISE * rng.standard_normal((STEPS, 4)), truth


def vehicle(start, width):
    rows = lambda m: ",\n".join("    " + json.dumps([float(v) for v in row]) for row in m)
    free = "\n".join(
        f'    {{ entry = "{m}[{i + 1},{j + 1}]", lower = {-width}, upper = {width}'
        + (f", start = {float(s)!r} }}," if start is not None else " },")
        for (m, i, j), s in zip(FREE, start if start is not None else [None] * 12)
    )
    a0, b0 = np.zeros((4, 4)), np.zeros((4, 2))
    a0[0, 1] = a0[2, 3] = 1.0
    names = ["roll", "roll_rate", "pitch", "pitch_rate"]
    states = ", ".join(f'{{ name = "{n}" }}' for n in names)
    return (
        f'name = "quadrotor"\nA = [\n{rows(a0)}\n]\nB = [\n{rows(b0)}\n]\nstates = [{states}]\n'
        f'inputs = [{{ name = "u_roll" }}, {{ name = "u_pitch" }}]\nfree = [\n{free}\n]\n'
    )


def own(program, folder, text, *options, threads=None):
    path = os.path.join(folder, "vehicle.toml")
    with open(path, "w") as file:
        file.write(text)
    command = [program, "identify", os.path.join(folder, "record.csv"), "--vehicle", path, "--noise", "white"]
    environment = dict(os.environ, **({"RAYON_NUM_THREADS": str(threads)} if threads else {}))
    begun = time.perf_counter()
    answer = subprocess.run(command + ["--json", "-", *options], capture_output=True, text=True, env=environment)
    wall = time.perf_counter() - begun
    if answer.returncode != 0:
        sys.exit(answer.stderr)
    return json.loads(answer.stdout), wall


def main():
    program = os.path.abspath(sys.argv[1] if len(sys.argv) > 1 else "target/release/whirlstand")
    u, y, truth = record(1)
    start = 0.8 * truth + np.where(truth == 0, 0.05, 0.0)
    print(f"SciPy {scipy.__version__}, NumPy {np.__version__}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as folder:
        time_axis = np.arange(STEPS) * PERIOD
        head = "t[s],u_roll,u_pitch,roll,roll_rate,pitch,pitch_rate"
        table = np.column_stack([time_axis, u, y])
        np.savetxt(os.path.join(folder, "record.csv"), table, delimiter=",", header=head, comments="", fmt="%.9g")

        print("\npem, from the same start")
        runs = [own(program, folder, vehicle(start, 30.0)) for _ in range(20)]
        answer, wall = min(runs, key=lambda run: run[0]["search"]["seconds"])
        mine = {p["name"]: p for p in answer["parameters"]}
        seconds = answer["search"]["seconds"]
        sigma = np.array([answer["outputs"][n]["noise_std"] for n in ("roll", "roll_rate", "pitch", "pitch_rate")])
        print(f"  whirlstand             {seconds:9.4f} s in the program, {wall:.3f} s with start and reading")
        for name, simulate in (("NumPy loop", loop), ("modal lfilter", modal)):
            residual = lambda z: ((y - simulate(z[:12], z[12:], u)) / sigma).ravel()
            spent = float("inf")
            for _ in range(5):
                begun = time.process_time()
                found = least_squares(residual, np.concatenate([start, np.zeros(4)]), x_scale="jac")
                spent = min(spent, time.process_time() - begun)
            worst = max(
                abs(found.x[i] - mine[f"{m}[{r + 1},{c + 1}]"]["value"]) / mine[f"{m}[{r + 1},{c + 1}]"]["standard_error"]
                for i, (m, r, c) in enumerate(FREE)
            )
            print(
                f"  least_squares, {name:13} {spent:9.4f} s  {spent / seconds:7.1f} times as long"
                f"  (greatest difference of the optima {worst:.4f} standard errors)"
            )

        print("\nga, time a simulation at the same number of evaluations")
        evaluations = 60_000
        best = {}
        for threads in (1, 2):
            runs = [
                own(
                    program, folder, vehicle(None, 30.0), "--method", "ga", "--evaluations", str(evaluations), "--stagnation",
                    "1000000", threads=threads,
                )[0]
                for _ in range(2)
            ]
            answer = min(runs, key=lambda run: run["search"]["seconds"])
            best[threads] = answer["search"]["seconds"] / answer["search"]["evaluations"]
            print(
                f"  whirlstand, {threads} thread(s)   {1e6 * best[threads]:9.1f} us"
                f"  ({answer['search']['evaluations']} evaluations, {answer['search']['seconds']:.2f} s)"
            )
        print(f"  speed-up on 2 threads    {best[1] / best[2]:9.2f}")
        for name, simulate in (("NumPy loop", loop), ("modal lfilter", modal)):
            variance = y.var(axis=0)

            def cost(z):
                with np.errstate(all="ignore"):
                    value = np.mean((y - simulate(z[:12], z[12:], u)) ** 2 / variance)
                return value if np.isfinite(value) else 1e300

            # A few generations tell the time of one evaluation; as many would take minutes to hours.
            begun = time.perf_counter()
            found = differential_evolution(
                cost, [(-30, 30)] * 12 + [(-1, 1)] * 4, maxiter=1, popsize=5, polish=False, seed=1
            )
            each = (time.perf_counter() - begun) / found.nfev
            print(
                f"  differential_evolution, {name:13} {1e6 * each:9.1f} us  {each / best[2]:7.1f} times as long"
                f"  ({found.nfev} evaluations)"
            )


if __name__ == "__main__":
    main()
