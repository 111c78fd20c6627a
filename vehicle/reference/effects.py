"""Writes effects.json: responses of a small plant with one effect at a time, by SciPy's DOP853 at 1e-12.

The effects are written here from their definitions in continuous time; nothing is shared with the Rust code.
Run: python3 reference/effects.py
"""
import json, math, pathlib
import numpy as np, scipy
from scipy.integrate import solve_ivp

A = np.array([[0.0, 1.0], [-4.0, -0.8]])
B = np.array([[0.0, 0.0], [2.0, 0.7]])
C = np.array([[1.0, 0.0], [0.0, 1.0], [-4.0, -0.8]])
D = np.array([[0.0, 0.0], [0.0, 0.0], [2.0, 0.7]])
T, N = 0.05, 60
rng = np.random.default_rng(7)
U = np.repeat(np.round(rng.uniform(-2, 2, (N // 5, 2)), 3), 5, axis=0)
X0 = np.array([0.3, -0.2])


def held(k, i):
    return U[k, i] if 0 <= k < N else 0.0


def run(inputs, cuts=(), extra=None, dx=None, A=A, B=B, outputs=None, look=0.0):
    """inputs(t, k) -> u over the step k; extra: (x0, f(t, z, u)) more states and the input they make; dx(t, z) added to x'.

    outputs(t, z, u) -> y; look: how far back outputs look.
    """
    n_extra = 0 if extra is None else len(extra["x0"])
    z = np.concatenate([X0, np.zeros(n_extra) if extra is None else extra["x0"]])
    grid = sorted({round(k * T, 12) for k in range(N + 1)} | {c for c in cuts if 0 < c < N * T})
    dense = []
    for t0, t1 in zip(grid, grid[1:]):
        middle = 0.5 * (t0 + t1)
        k = int(middle / T)
        def f(t, z):
            u = inputs(t if t < t1 else middle, k, middle)
            w, d = (u, []) if extra is None else extra["f"](t, z, u)
            x = z[:2]
            return np.concatenate([A @ x + B @ w + (dx(t, x, middle) if dx else 0), d])
        s = solve_ivp(f, (t0, t1), z, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
        dense.append((t0, t1, s.sol))
        z = s.y[:, -1]
    def state(t):
        if t < 0:
            return None
        for t0, t1, sol in dense:
            if t0 <= t <= t1:
                return sol(t)
    rows = []
    for k in range(N):
        z = state(k * T - look)
        if z is None:
            rows.append(None)
            continue
        t = k * T - look
        kk = int(math.floor(t / T + 1e-9))
        u = inputs(t + 1e-7, kk, t + 1e-7)
        w = u if extra is None else extra["f"](t, z, u)[0]
        rows.append((C @ z[:2] + D @ w) if outputs is None else outputs(z, w))
    return rows


plain = lambda t, k, m: U[k]
cases = []


def case(effects, rows, tolerance):
    def number(v):
        return None if math.isnan(v) else float(f"{v:.13g}")
    cases.append({"effects": effects, "tolerance": tolerance,
                  "y": [None if r is None else [number(v) for v in r] for r in rows]})


def statics(f):
    """f(u1 samples) -> u1 samples, before and at the record."""
    s = f(U[:, 0].copy())
    return lambda t, k, m: np.array([s[min(k, N - 1)], U[min(k, N - 1), 1]])


e = lambda effect, where, **p: [dict(effect=effect, where=where, **p)]
case([], run(plain), 1e-10)

tau = 0.083
delayed = lambda t, k, m: np.array([held(math.floor((m - tau) / T), 0), U[min(k, N - 1), 1]])
case(e("input_delay", "u1", delay_s=tau), run(delayed, cuts=[k * T + tau - T for k in range(N + 1)]), 1e-10)
case(e("input_delay", "u1", delay_s=0.15), run(lambda t, k, m: np.array([held(k - 3, 0), U[min(k, N - 1), 1]])), 1e-10)
two = lambda t, k, m: np.array([held(math.floor((m - 0.083) / T), 0), held(math.floor((m - 0.031) / T), 1)])
case(e("input_delay", "u1", delay_s=0.083) + e("input_delay", "u2", delay_s=0.031),
     run(two, cuts=[k * T + o for k in range(-2, N + 1) for o in (0.083, 0.031)]), 1e-10)

lag = lambda tau: dict(x0=np.zeros(1), f=lambda t, z, u: (np.array([z[2], u[1]]), [(u[0] - z[2]) / tau]))
case(e("actuator_lag", "u1", time_constant_s=0.07), run(plain, extra=lag(0.07)), 1e-9)
w, zeta, g = 2 * math.pi * 3.0, 0.1, 0.9
mode = dict(x0=np.zeros(2), f=lambda t, z, u: (np.array([z[2], u[1]]), [z[3], w * w * (g * u[0] - z[2]) - 2 * zeta * w * z[3]]))
case(e("unmodelled_mode", "u1", frequency_hz=3.0, damping_ratio=zeta, gain=g), run(plain, extra=mode), 1e-9)

case(e("input_gain", "u1", factor=0.6), run(statics(lambda u: 0.6 * u)), 1e-10)
drift = lambda t, k, m: np.array([U[k, 0] * (1 - 0.05 * t), U[k, 1]])
# Only motion is compared, here and below: what D passes on is a mean over the period.
motion = lambda rows: [[*r[:2], math.nan] for r in rows]
case(e("gain_drift", "u1", rate_per_s=-0.05), motion(run(drift)), 1e-4)
case(e("input_bias", "u1", offset=0.25), run(statics(lambda u: u + 0.25)), 1e-10)
case(e("dead_zone", "u1", width=0.3), run(statics(lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.3, 0))), 1e-10)
case(e("input_saturation", "u1", lower=-0.5, upper=0.8), run(statics(lambda u: np.clip(u, -0.5, 0.8))), 1e-10)

def play(u):
    p, out = 0.0, []
    for v in u:
        p = max(v - 0.2, min(v + 0.2, p))
        out.append(p)
    return np.array(out)
case(e("backlash", "u1", width=0.4), run(statics(play)), 1e-10)

# The rate limit in continuous time: a ramp that ends where it meets the command.
limit = 7.3
starts = [0.0]
for k in range(N):
    gap = U[k, 0] - starts[-1]
    starts.append(starts[-1] + math.copysign(min(abs(gap), limit * T), gap))
def ramp(t, k, m):
    gap = U[k, 0] - starts[k]
    return np.array([starts[k] + math.copysign(min(abs(gap), limit * max(t - k * T, 0)), gap), U[k, 1]])
meets = [k * T + abs(U[k, 0] - starts[k]) / limit for k in range(N)]
case(e("rate_limit", "u1", limit_per_s=limit), motion(run(ramp, cuts=meets)), 2e-3)

case(e("input_coupling", "u1->u2", coefficient=-0.4), run(lambda t, k, m: np.array([U[k, 0], U[k, 1] - 0.4 * U[k, 0]])), 1e-10)
A2 = A.copy(); A2[1, 0] = -5.5
case(e("parameter_change", "A[2,1]", value=-5.5), run(plain, A=A2), 1e-10)
B2 = B.copy(); B2[1, 1] *= 1.7
case(e("parameter_change", "B[2,2]", factor=1.7), run(plain, B=B2), 1e-10)

# x abs(x) is not smooth where x changes its sign; locating those four moments as events changes this table by 3e-12.
case(e("quadratic_drag", "v", coefficient=0.9), run(plain, dx=lambda t, x, m: np.array([0, -0.9 * x[1] * abs(x[1])])), 1e-6)
case(e("cubic_stiffness", "p->v", coefficient=3.0), run(plain, dx=lambda t, x, m: np.array([0, -3.0 * x[0] ** 3])), 1e-6)
case(e("quadratic_drag", "v", coefficient=0.9) + e("cubic_stiffness", "p->v", coefficient=3.0),
     run(plain, dx=lambda t, x, m: np.array([0, -0.9 * x[1] * abs(x[1]) - 3.0 * x[0] ** 3])), 1e-6)


def friction(level, asymmetry, drag=0.0):
    """Coulomb friction with sticking, by events."""
    z, s = X0.copy(), math.copysign(1, X0[1])
    rows = []
    stuck_time = 0.0
    for k in range(N):
        rows.append(C @ z + D @ U[k])
        t, end = k * T, (k + 1) * T
        drive = B[1] @ U[k]
        while t < end - 1e-14:
            if s == 0:
                net = A[1, 0] * z[0] + drive
                if net > level + asymmetry: s = 1.0
                elif net < -(level - asymmetry): s = -1.0
                else:
                    stuck_time += end - t
                    break
            force = -(level * s + asymmetry)
            f = lambda t, z: np.array([z[1], A[1] @ z + drive + force - drag * z[1] * abs(z[1])])
            stop = lambda t, z: z[1] * s if t > t_start + 1e-9 else s
            stop.terminal, stop.direction = True, -1 * s * s
            t_start = t
            r = solve_ivp(f, (t, end), z, method="DOP853", rtol=1e-12, atol=1e-13, events=stop, max_step=T / 20)
            z, t = r.y[:, -1].copy(), r.t[-1]
            if r.status == 1:
                z[1], s = 0.0, 0.0
    print(f"friction {level} {asymmetry}: stuck for {stuck_time:.2f} s of {N * T} s")
    return motion(rows)
case(e("coulomb_friction", "v", level=1.1), friction(1.1, 0.0), 2e-4)
case(e("coulomb_friction", "v", level=0.9, asymmetry=0.4), friction(0.9, 0.4), 2e-4)
case(e("coulomb_friction", "v", level=0.5) + e("quadratic_drag", "v", coefficient=0.7), friction(0.5, 0.0, 0.7), 2e-4)

def pulse(at, until, magnitude):
    return lambda t, x, m: np.array([0, magnitude if at <= m < until else 0])
case(e("step_disturbance", "v", at_s=1.013, magnitude=1.5), run(plain, cuts=[1.013], dx=pulse(1.013, 1e9, 1.5)), 1e-9)
case(e("pulse_disturbance", "v", at_s=1.013, duration_s=0.0101, magnitude=40.0),
     run(plain, cuts=[1.013, 1.0231], dx=pulse(1.013, 1.0231, 40.0)), 1e-9)
case(e("pulse_disturbance", "v", at_s=1.0, duration_s=0.7, magnitude=2.0), run(plain, cuts=[1.7], dx=pulse(1.0, 1.7, 2.0)), 1e-9)
case(e("periodic_disturbance", "v", frequency_hz=4.3, amplitude=3.0, phase_rad=0.6),
     run(plain, dx=lambda t, x, m: np.array([0, 3.0 * math.sin(2 * math.pi * 4.3 * t + 0.6)])), 1e-9)

late = lambda look: [r for r in run(plain, look=look)]
base = run(plain)
def only(rows, i):
    return [None if r is None else [r[j] if j == i else b[j] for j in range(3)] for r, b in zip(rows, base)]
case(e("sensor_delay", "p", delay_s=0.083), only(late(0.083), 0), 1e-9)
case(e("sensor_delay", "v", delay_s=0.1), only(late(0.1), 1), 1e-9)
sensor = dict(x0=np.array([X0[0]]), f=lambda t, z, u: (u, [(z[0] - z[2]) / 0.12]))
case(e("sensor_lag", "p", time_constant_s=0.12),
     run(plain, extra=sensor, outputs=lambda z, u: [z[2], z[1], C[2] @ z[:2] + D[2] @ u]), 1e-9)

json.dump({"source": f"scipy {scipy.__version__} DOP853, rtol 1e-12", "A": A.tolist(), "B": B.tolist(), "C": C.tolist(),
           "D": D.tolist(), "period_s": T, "x0": X0.tolist(), "u": U.tolist(), "cases": cases},
          open(pathlib.Path(__file__).parent / "effects.json", "w"))
