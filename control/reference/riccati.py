"""Writes riccati.json: hard and ordinary Riccati equations with what slycot and SciPy reach on them.

Run with numpy, scipy, control and slycot installed:  python riccati.py

The residual is the Frobenius norm of the equation's left side over that of X. CAREX and DAREX are the collections
of Benner, Laub and Mehrmann (TU Chemnitz, SPC 95-22 and SPC 95-23); numbers after the name are theirs.
"""

import json
import pathlib
import warnings

import control
import numpy as np
import scipy
import scipy.linalg as sl
import slycot

import systems
from systems import rows

warnings.filterwarnings("ignore")


def care_residual(a, b, q, r, s, x):
    k = np.linalg.solve(r, b.T @ x + s.T)
    return np.linalg.norm(a.T @ x + x @ a - (x @ b + s) @ k + q) / np.linalg.norm(x)


def dare_residual(a, b, q, r, s, x):
    k = np.linalg.solve(r + b.T @ x @ b, b.T @ x @ a + s.T)
    return np.linalg.norm(a.T @ x @ a - x - (a.T @ x @ b + s) @ k + q) / np.linalg.norm(x)


def attempt(solve, residual):
    """Residual of one solver, or None when it refuses."""
    try:
        x = solve()
        value = residual(np.asarray(x))
        return (float(value), x) if np.isfinite(value) else (None, None)
    except Exception:
        return None, None


def solve_all(kind, a, b, q, r, s):
    """Best slycot residual (of SB02OD, and SB02MD or SG02AD through python-control), SciPy's, and slycot's X."""
    n, m = b.shape
    residual = care_residual if kind == "care" else dare_residual
    def check(x):
        return residual(a, b, q, r, s, x)
    def sb02od():
        dico = "C" if kind == "care" else "D"
        cross = s if np.any(s) else None
        return slycot.sb02od(n, m, a, b, q, r, dico, L=cross)[0]
    function = control.care if kind == "care" else control.dare
    tries = [attempt(sb02od, check), attempt(lambda: function(a, b, q, r, s, np.eye(n), method="slycot")[0], check)]
    if not np.any(s):
        tries.append(attempt(lambda: function(a, b, q, r, method="slycot")[0], check))
    done = [t for t in tries if t[0] is not None]
    best = min(done, key=lambda t: t[0]) if done else (None, None)
    scipy_function = sl.solve_continuous_are if kind == "care" else sl.solve_discrete_are
    scipy_residual, scipy_x = attempt(lambda: scipy_function(a, b, q, r, s=s), check)
    return best[0], scipy_residual, best[1] if best[1] is not None else scipy_x


def carex():
    """(name, A, B, Q, R, X or None)."""
    def arr(*r):
        return np.array(r, dtype=float)
    r2 = np.sqrt(2)
    yield "carex-1.1", arr([0, 1], [0, 0]), arr([0], [1]), arr([1, 0], [0, 2]), np.eye(1), arr([2, 1], [1, 2])
    yield ("carex-1.2", arr([4, 3], [-4.5, -3.5]), arr([1], [-1]), arr([9, 6], [6, 4]), np.eye(1),
           (1 + r2) * arr([9, 6], [6, 4]))
    yield ("carex-1.3",
           arr([0, 1, 0, 0], [0, -1.89, 0.39, -5.53], [0, -0.034, -2.98, 2.43], [0.034, -0.0011, -0.99, -0.21]),
           arr([0, 0], [0.36, -1.6], [-0.95, -0.032], [0.03, 0]),
           arr([2.313, 2.727, 0.688, 0.023], [2.727, 4.271, 1.148, 0.323], [0.688, 1.148, 0.313, 0.102],
               [0.023, 0.323, 0.102, 0.083]), np.eye(2), None)
    a = np.diag([-0.991, -1.051, -1.118, -1.548, -1.640, -1.721, -1.823, -1.943])
    a += np.diag([0.529, 0.596, 0.596, 0.718, 0.799, 0.901, 1.021], 1)
    a += np.diag([0.522, 0.522, 0.522, 0.922, 0.922, 0.922, 0.922], -1)
    b = 1e-3 * arr([3.84, 4.0, 37.6, 3.08, 2.36, 2.88, 3.08, 3.0],
                   [-2.88, -3.04, -2.8, -2.32, -3.32, -3.82, -4.12, -3.96]).T
    q = np.diag([1.0, 1, 1, 1, 0.1, 0.1, 0.1, 0.1])
    for i, j, v in [(0, 4, 0.5), (0, 7, 0.1), (1, 4, 0.1), (2, 5, 0.5)]:
        q[i, j] = q[j, i] = v
    yield "carex-1.4", a, b, q, np.eye(2), None
    # The 30 states of 1.6, a jet engine, from the data that SciPy's own tests read.
    data = np.load(pathlib.Path(scipy.linalg.__file__).parent / "tests" / "data" / "carex_6_data.npz")
    yield "carex-1.6", data["A"], data["B"], data["Q"], data["R"], None
    e = 1e-6
    x = arr([(1 + np.sqrt(1 + e * e)) / e**2, 1 / (2 + np.sqrt(1 + e * e))],
            [1 / (2 + np.sqrt(1 + e * e)), 0.25 * (1 - e * e / (2 + np.sqrt(1 + e * e)) ** 2)])
    yield "carex-2.1", np.diag([1.0, -2]), arr([e], [0]), np.ones((2, 2)), np.eye(1), x
    e = 1e-8
    yield ("carex-2.2", np.diag([-0.1, -0.02]), arr([0.1, 0], [0.001, 0.01]), arr([100, 1000], [1000, 10000]),
           arr([1 + e, 1], [1, 1]), None)
    for e in (1e6, 1e-6):
        s = np.sqrt(1 + 2 * e)
        yield (f"carex-2.3-{e:.0e}", arr([0, e], [0, 0]), arr([0], [1]), np.eye(2), np.eye(1),
               arr([s / e, 1], [1, s]))
    e = 1e-7
    x11 = 0.5 * (2 * (e + 1) + np.sqrt(2 * (e + 1) ** 2 + 2) + r2 * e)
    yield ("carex-2.4", arr([e + 1, 1], [1, e + 1]), np.eye(2), e * e * np.eye(2), np.eye(2),
           arr([x11, x11 / (x11 - (e + 1))], [x11 / (x11 - (e + 1)), x11]))
    e = 1.0
    yield ("carex-2.5", arr([3 - e, 1], [4, 2 - e]), arr([1], [1]), arr([4 * e - 11, 2 * e - 5], [2 * e - 5, 2 * e - 2]),
           np.eye(1), arr([2, 1], [1, 1]))
    e = 1e6
    v = np.eye(3) - 2.0 / 3.0 * np.ones((3, 3))
    d = np.diag([e * e + np.sqrt(e**4 + 1), 2 * e * e + np.sqrt(4 * e**4 + e), 3 * e * e + np.sqrt(9 * e**4 + e * e)])
    yield ("carex-2.6", e * v @ np.diag([1.0, 2, 3]) @ v, np.eye(3) / np.sqrt(e), v @ np.diag([1 / e, 1, e]) @ v,
           np.eye(3), v @ d @ v)
    e = 1e-6
    yield ("carex-2.7", arr([0, 0.4, 0, 0], [0, 0, 0.345, 0], [0, -0.524 / e, -0.465 / e, 0.262 / e], [0, 0, 0, -1 / e]),
           arr([0], [0], [0], [1 / e]), np.diag([1.0, 0, 1, 0]), np.eye(1), None)
    for e in (1e-2, 1e-6):
        yield (f"carex-2.8-{e:.0e}", arr([-e, 1, 0, 0], [-1, -e, 0, 0], [0, 0, e, 1], [0, 0, -1, e]), np.ones((4, 1)),
               np.ones((4, 4)), np.eye(1), None)
    for count in (5, 20):
        n = 2 * count - 1
        a, b, q = np.zeros((n, n)), np.zeros((n, count)), np.zeros((n, n))
        for i in range(count):
            a[2 * i, 2 * i] = -1.0
            b[2 * i, i] = 1.0
            if i + 1 < count:
                a[2 * i + 1, 2 * i], a[2 * i + 1, 2 * i + 2] = 1.0, -1.0
                q[2 * i + 1, 2 * i + 1] = 10.0
        yield f"carex-3.1-{n}", a, b, q, np.eye(count), None
    n = 20
    a = -2 * np.eye(n) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    a[0, -1] = a[-1, 0] = 1.0
    w = np.linalg.eigh(a)
    x = w[1] @ np.diag(w[0] + np.sqrt(w[0] ** 2 + 1)) @ w[1].T
    yield f"carex-3.2-{n}", a, np.eye(n), np.eye(n), np.eye(n), x
    for n in (8, 21):
        q = np.zeros((n, n))
        q[0, 0] = 1.0
        b = np.zeros((n, 1))
        b[-1] = 1.0
        yield f"carex-4.1-{n}", np.diag(np.ones(n - 1), 1), b, q, np.eye(1), None
    count, mu, delta, kappa = 10, 4.0, 4.0, 1.0
    k = kappa * (2 * np.eye(count) - np.diag(np.ones(count - 1), 1) - np.diag(np.ones(count - 1), -1))
    k[0, 0] = k[-1, -1] = kappa
    a = np.block([[np.zeros((count, count)), np.eye(count)], [-k / mu, -delta / mu * np.eye(count)]])
    b = np.zeros((2 * count, 2))
    b[count, 0], b[-1, 1] = 1 / mu, -1 / mu
    yield "carex-4.3-20", a, b, np.eye(2 * count), np.eye(2), None


def darex():
    """(name, A, B, Q, R, S, X or None)."""
    def arr(*r):
        return np.array(r, dtype=float)
    def zero(b):
        return np.zeros(b.shape)
    a, b = arr([4, 3], [-4.5, -3.5]), arr([1], [-1])
    q = arr([9, 6], [6, 4])
    yield "darex-1.1", a, b, q, np.eye(1), zero(b), (1 + np.sqrt(5)) / 2 * q
    a, b = np.diag([0.9512, 0.9048]), arr([4.877, 4.877], [-1.1895, 3.569])
    yield "darex-1.2", a, b, np.diag([0.005, 0.02]), np.diag([1 / 3, 3.0]), zero(b), None
    b = arr([1], [0])
    yield "darex-1.3", arr([2, -1], [1, 0]), b, np.diag([0.0, 1]), np.zeros((1, 1)), zero(b), np.eye(2)
    yield ("darex-1.4", arr([0, 1], [0, -1]), arr([1, 0], [2, 1]), arr([-4, -4], [-4, 7]) / 11, arr([9, 3], [3, 1]),
           arr([3, 1], [-1, 7]), None)
    b = arr([0], [1])
    yield ("darex-1.5", arr([0, 1], [0, 0]), b, arr([1, 2], [2, 4]), np.eye(1), zero(b),
           arr([1, 2], [2, 2 + np.sqrt(5)]))
    b = arr([0.0033, 0.02], [0.1, -0.0007], [0.04, 0.0073], [-0.0028, 0.1])
    yield ("darex-1.6",
           arr([0.998, 0.067, 0, 0], [-0.067, 0.998, 0, 0], [0, 0, 0.998, 0.153], [0, 0, -0.153, 0.998]), b,
           arr([1.87, 0, 0, -0.244], [0, 0.744, 0.205, 0], [0, 0.205, 0.589, 0], [-0.244, 0, 0, 1.048]), np.eye(2),
           zero(b), None)
    b = 1e-4 * arr([37.112, 7.361], [-870.51, 0.0093411], [-11984.0, -4.1378e-4], [-31927.0, 9.2535e-4])
    yield ("darex-1.7",
           1e-3 * arr([984.75, -79.903, 0.9054, -1.0765], [41.588, 998.99, -35.855, 12.684],
                      [-546.62, 44.916, -329.91, 193.18], [2662.4, -100.45, -924.55, -263.25]), b, 0.01 * np.eye(4),
           np.eye(2), zero(b), None)
    b = arr([1, -1, -1, -1], [0, 1, -1, -1], [0, 0, 1, -1], [0, 0, 0, 1])
    yield ("darex-1.8",
           arr([-0.6, -2.2, -3.6, -5.400018], [1, 0.6, 0.8, 3.399982], [0, 1, 1.8, 3.799982], [0, 0, 0, -0.999982]), b,
           arr([2, 1, 3, 6], [1, 2, 2, 5], [3, 2, 6, 11], [6, 5, 11, 22]), np.eye(4), zero(b), None)
    b = 1e-4 * arr([0.0434, -0.0122], [2.6606, -1.0453], [3.753, -5.51], [3.6076, -6.6], [0.4617, -0.9148])
    yield ("darex-1.9",
           1e-2 * arr([95.407, 1.9643, 0.3597, 0.0673, 0.019], [40.849, 41.317, 16.084, 4.4679, 1.1971],
                      [12.217, 26.326, 36.149, 15.93, 12.383], [4.1118, 12.858, 27.209, 21.442, 40.976],
                      [0.1305, 0.5808, 1.875, 3.6162, 94.28]), b, np.eye(5), np.eye(2), zero(b), None)
    shift = np.diag([1.0, 1.0], 1)
    a, b = np.kron(np.eye(2), shift), np.kron(np.eye(2), arr([0], [0], [1]))
    q = sl.block_diag(arr([1, 1, 0], [1, 1, 0], [0, 0, 0]), arr([1, -1, 0], [-1, 1, 0], [0, 0, 0]))
    yield "darex-1.10", a, b, q, np.diag([3.0, 1]), zero(b), None
    a, b = arr([4, 3], [-4.5, -3.5]), arr([1], [-1])
    for delta in (1e-2, 1e6):
        yield (f"darex-2.1-{delta:.0e}", a, b, arr([9, 6], [6, 4]), delta * np.eye(1), zero(b),
               (1 + np.sqrt(1 + 4 * delta)) / 2 * arr([9, 6], [6, 4]))
    a, b = np.diag([0.9512, 0.9048]), arr([4.877, 4.877], [-1.1895, 3.569])
    yield "darex-2.2-1e4", a, b, np.diag([0.005, 0.02]), np.diag([1e4 / 3, 3e-4]), zero(b), None
    d, b = 1e6, arr([0], [1])
    yield "darex-2.3", arr([0, d], [0, 0]), b, np.eye(2), np.eye(1), zero(b), np.diag([1, 1 + d * d])
    v, b = np.eye(3) - 2.0 / 3.0 * np.ones((3, 3)), np.eye(3)
    yield ("darex-2.4", v @ np.diag([0.0, 1, 3]) @ v, b, d * np.eye(3), d * np.eye(3), zero(b),
           d * v @ np.diag([1, (1 + np.sqrt(5)) / 2, (9 + np.sqrt(85)) / 2]) @ v)
    tau = 1e8
    a = np.diag([1.0, 1, 1], -1)
    a[0, 0] = 1 - 1 / tau
    b = arr([1 / tau], [0], [0], [0])
    yield "darex-2.5", a, b, np.diag([0.0, 0, 0, 1]), 0.25 * np.eye(1), zero(b), None
    for n in (10, 30):
        b = np.zeros((n, 1))
        b[-1] = 1.0
        yield f"darex-4.1-{n}", np.diag(np.ones(n - 1), 1), b, np.eye(n), np.eye(1), zero(b), np.diag(np.arange(1.0, n + 1))
    # What users reported to SciPy: gh-2251, and a problem with a cross weight under pull request 6616.
    a = arr([0.63399379, 0.54906824, 0.76253406], [0.5404729, 0.53745766, 0.08731853], [0.27524045, 0.84922129, 0.4681622])
    b = arr([0.96861695], [0.05532739], [0.78934047])
    yield "scipy-2251", a, b, np.eye(3), np.eye(1), zero(b), None
    data = np.load(pathlib.Path(scipy.linalg.__file__).parent / "tests" / "data" / "gendare_20170120_data.npz")
    yield "scipy-6616", data["A"], data["B"], data["Q"], data["R"], data["S"], None
    # What a user reported to Drake (issue 8034): a nilpotent A, and all matrices the identity.
    b = arr([0], [1])
    yield "drake-8034-nilpotent", arr([0, 1], [0, 0]), b, np.eye(2), np.eye(1), zero(b), np.diag([1.0, 2.0])
    yield "drake-8034-identity", np.eye(2), np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), (1 + 5**0.5) / 2 * np.eye(2)
    # In python-control issue 157 a DLQR was refused because A was as good as singular. Its data was an attachment; a
    # delay in the state makes A singular here.
    for name, (a, b) in systems.vehicles().items():
        phi, gamma = systems.zoh(a, b)
        n, m = b.shape
        q, r = systems.weights(a)
        big = np.zeros((n + m, n + m))
        big[:n, :n], big[:n, n:] = phi, gamma
        entry = np.vstack([np.zeros((n, m)), np.eye(m)])
        yield f"delayed-{name}", big, entry, sl.block_diag(q, np.zeros((m, m))), r, zero(entry), None


def record(name, kind, a, b, q, r, s, x):
    slycot_residual, scipy_residual, solution = solve_all(kind, a, b, q, r, s)
    best = x if x is not None else solution
    out = {"name": name, "kind": kind, "a": rows(a), "b": rows(b), "q": rows(q), "r": rows(r)}
    if np.any(s):
        out["s"] = rows(s)
    out["slycot"], out["scipy"] = slycot_residual, scipy_residual
    if x is not None:
        out["exact"] = rows(x)
    elif best is not None:
        out["trace"] = float(np.trace(best))
    print(f"{name:28s} {kind} slycot {slycot_residual!s:24s} scipy {scipy_residual}")
    return out


def main():
    cases = []
    for name, a, b, q, r, x in carex():
        cases.append(record(name, "care", a, b, q, r, np.zeros(b.shape), x))
    for name, a, b, q, r, s, x in darex():
        cases.append(record(name, "dare", a, b, q, r, s, x))
    for name, (a, b) in systems.vehicles().items():
        q, r = systems.weights(a)
        cases.append(record(name, "care", a, b, q, r, np.zeros(b.shape), None))
        phi, gamma = systems.zoh(a, b)
        cases.append(record(name, "dare", phi, gamma, q, r, np.zeros(b.shape), None))
    random = []
    for k in range(200):
        a, b, q, r, _ = systems.random_system(k)
        s = np.zeros(b.shape)
        c_slycot, c_scipy, c_x = solve_all("care", a, b, q, r, s)
        d_slycot, d_scipy, d_x = solve_all("dare", a, b, q, r, s)
        random.append({"care": c_slycot, "care_scipy": c_scipy, "care_trace": float(np.trace(c_x)),
                       "dare": d_slycot, "dare_scipy": d_scipy, "dare_trace": float(np.trace(d_x))})
    table = {"slycot": slycot.__version__, "scipy": __import__("scipy").__version__, "cases": cases, "random": random}
    path = pathlib.Path(__file__).with_name("riccati.json")
    text = json.dumps(table, separators=(",", ":")).replace('{"name"', '\n{"name"').replace('{"care"', '\n{"care"')
    path.write_text(text + "\n")


main()
