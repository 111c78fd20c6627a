"""The closed loop of `whirlstand bench flight` in JAX (jit of vmap of scan) and as a NumPy batch, on one processor.

The built-in quadrotor at 1 kHz with the noise and vibration of its sensors, a Kalman filter on its model, and LQR with the exact
prediction over one period of latency, in double precision. Gains are constant here; the bench also runs the filter's
covariance until it repeats, and all checks of the nodes. One thread; seconds are of the processor's time, on both sides, so that
other load on the machine changes them little.

    python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements.txt
    peers/bin/python tests/peers/closed_loop.py target/release/whirlstand
"""

import json
import os
import pathlib
import resource
import subprocess
import sys
import tomllib

os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
os.environ["JAX_ENABLE_X64"] = "true"
os.environ["JAX_PLATFORMS"] = "cpu"

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import scipy  # noqa: E402
from scipy.linalg import expm, solve_discrete_are  # noqa: E402

PERIOD_S = 1e-3
STEPS = 1000
FLIGHTS = 1024
REPEATS = 5

root = pathlib.Path(__file__).resolve().parents[2]
vehicle = tomllib.loads((root / "vehicle/vehicles/quadrotor.toml").read_text())
A, B = np.array(vehicle["A"]), np.array(vehicle["B"])
n, m = B.shape
block = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * PERIOD_S)
F, G = block[:n, :n], block[:n, n:]
limit = np.array([i["upper"] for i in vehicle["inputs"]])
noise = np.array([o["noise"] for o in vehicle["outputs"]])
tones = [o["vibration"] for o in vehicle["outputs"]]
amplitude = np.array([t["flying"] for t in tones])
harmonics = np.array([t["harmonics"] for t in tones])
phase = np.array([t.get("phase_rad", 0.0) for t in tones])
omega = 2 * np.pi * tones[0]["frequency_hz"]

P = solve_discrete_are(F, G, np.eye(n), np.eye(m))
L = np.linalg.solve(G.T @ P @ G + np.eye(m), G.T @ P @ F)
R = np.diag(noise**2 + amplitude**2 / 2)
S = solve_discrete_are(F.T, np.eye(n), 1e-4 * np.eye(n), R)
K = S @ np.linalg.inv(S + R)


def vibration(xp, t):
    """Of all outputs at time t, s."""
    order = xp.arange(1, harmonics.shape[1] + 1)
    angle = order * (omega * t + phase[:, None])
    return amplitude * xp.sum(harmonics * xp.sin(angle), axis=1)


def step(xp, state, t, normal):
    """One step of one flight, or of a batch of them with flights in rows."""
    x, estimate, applied, command = state
    y = x + noise * normal + vibration(xp, t)
    predicted = estimate @ F.T + applied @ G.T
    estimate = predicted + (y - predicted) @ K.T
    ahead = estimate @ F.T + command @ G.T
    wanted = xp.clip(-(ahead @ L.T), -limit, limit)
    x = x @ F.T + command @ G.T
    return x, estimate, command, wanted


def processor_s():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def rate(flown):
    """Steps a second of the processor's time: the median of all repeats, the first left out."""
    rates = []
    for seed in range(REPEATS + 1):
        start = processor_s()
        flown(seed)
        rates.append(FLIGHTS * STEPS / (processor_s() - start))
    return sorted(rates[1:])[REPEATS // 2]


def by_numpy(seed):
    random = np.random.default_rng(seed)
    state = (np.zeros((FLIGHTS, n)), np.zeros((FLIGHTS, n)), np.zeros((FLIGHTS, m)), np.zeros((FLIGHTS, m)))
    for k in range(STEPS):
        state = step(np, state, k * PERIOD_S, random.standard_normal((FLIGHTS, n)))
    return state[0]


@jax.jit
@jax.vmap
def scanned(key):
    def one(state, k):
        normal = jax.random.normal(jax.random.fold_in(key, k), (n,))
        return step(jnp, state, k * PERIOD_S, normal), None

    start = (jnp.zeros(n), jnp.zeros(n), jnp.zeros(m), jnp.zeros(m))
    return jax.lax.scan(one, start, jnp.arange(STEPS))[0][0]


def by_jax(seed):
    return scanned(jax.random.split(jax.random.key(seed), FLIGHTS)).block_until_ready()


def by_whirlstand(program):
    """Of `bench flight`: one flight after the other, and side by side as a campaign flies them."""
    call = [program, "bench", "flight", "--seconds", "2", "--repeat", str(REPEATS), "--json"]
    told = json.loads(subprocess.run(call, stdout=subprocess.PIPE, check=False).stdout)
    return [figure["value"] for figure in told["figures"] if "processor's time" in figure["name"]]


print(f"JAX {jax.__version__}, NumPy {np.__version__}, SciPy {scipy.__version__}, Python {sys.version.split()[0]}")
print(f"{FLIGHTS} flights of {STEPS} steps, one thread; load of the machine {os.getloadavg()[0]:.1f}")
spread = [np.std(np.asarray(f(1)), axis=0) for f in (by_numpy, by_jax)]
assert np.allclose(*spread, rtol=0.2), f"the two loops differ: {spread}"
peers = {"JAX, jit of vmap of scan": rate(by_jax), "NumPy batch": rate(by_numpy)}
for name, steps in peers.items():
    print(f"{name:30}{steps / 1e6:6.2f} M steps/s")
if len(sys.argv) > 1:
    one, many = by_whirlstand(sys.argv[1])
    print(f"{'whirlstand, flight by flight':30}{one / 1e6:6.2f} M steps/s")
    ratios = ", ".join(f"{many / steps:.2f} times {name.split(',')[0]}" for name, steps in peers.items())
    print(f"{'whirlstand, side by side':30}{many / 1e6:6.2f} M steps/s: {ratios}")
