"""Writes stiff.json: one sample period of plants from slow to stiff, in multiple precision: python3 reference/stiff.py
(needs mpmath).

For dx/dt = A x + B u, u held, with white noise of density diag(w) on the derivatives: Phi = exp(A T), Gamma = the integral
of exp(A t) B and W = the integral of exp(A t) diag(w) exp(A' t), t from 0 to T. All three come from forward exponentials;
W from the linear differential equation of its entries, dW/dt = A W + W A' + diag(w), which holds exp(-A t) nowhere.
"""
import json, pathlib
import mpmath as mp

mp.mp.dps = 150
RATES_HZ = (1, 50, 1000, 20000)


def exponential(m):
    """exp(m) by a Taylor series and squarings."""
    size = max(sum(abs(m[i, j]) for j in range(m.cols)) for i in range(m.rows))
    halvings = max(0, int(mp.ceil(mp.log(size, 2))) + 10) if size > 0 else 0
    x, term, total = m / mp.mpf(2) ** halvings, mp.eye(m.rows), mp.eye(m.rows)
    for k in range(1, 60):
        term = term * x / k
        total += term
    for _ in range(halvings):
        total = total * total
    return total


def augmented(a, b):
    """[a b; 0 0]."""
    n, m = a.rows, b.cols
    block = mp.zeros(n + m, n + m)
    for i in range(n):
        for j in range(n):
            block[i, j] = a[i, j]
        for j in range(m):
            block[i, n + j] = b[i, j]
    return block


def step(a, b, w, period):
    n, m = a.rows, b.cols
    e = exponential(augmented(a, b) * period)
    phi = [[e[i, j] for j in range(n)] for i in range(n)]
    gamma = [[e[i, n + j] for j in range(m)] for i in range(n)]
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    place = {p: k for k, p in enumerate(pairs)}
    entry = lambda i, j: place[(min(i, j), max(i, j))]
    k, source = mp.zeros(len(pairs), len(pairs)), mp.zeros(len(pairs), 1)
    for row, (i, j) in enumerate(pairs):
        for l in range(n):
            k[row, entry(l, j)] += a[i, l]
            k[row, entry(i, l)] += a[j, l]
        source[row] = w[i] if i == j else 0
    e = exponential(augmented(k, source) * period)
    gramian = [[e[entry(i, j), len(pairs)] for j in range(n)] for i in range(n)]
    return phi, gamma, gramian


def chain(poles):
    """Lags one behind the other."""
    n = len(poles)
    return [[p if i == j else -p if j == i - 1 else 0 for j in range(n)] for i, p in enumerate(poles)]


def companion(p, q):
    return [[0, 1], [-p * q, p + q]]


def driven(a, rate):
    """The last state of the plant is moved by an actuator, which follows the command at `rate`."""
    n = len(a)
    return [row + [1.0 if i == n - 1 else 0.0] for i, row in enumerate(a)] + [[0.0] * n + [-rate]]


QUADROTOR = [[0, 1, 0, 0], [-1.1132, -0.7118, 0.0001, 0], [0, 0, 0, 1], [7.2721, 6.1794, -7.9908, -5.2474]]
PLANTS = {
    **{f"lag {p:g}": [[-p]] for p in (1e-6, 1e-3, 1.0, 1e3, 1e6)},
    **{f"angle with damping {p:g}": [[0.0, 1.0], [0.0, -p]] for p in (1e-6, 1.0, 1e3, 1e6)},
    "poles -1e6 and -1e-6": companion(-1e6, -1e-6),
    "poles -2e3 and -0.5": companion(-2e3, -0.5),
    **{f"oscillator {w:g}": [[0.0, 1.0], [-w * w, -0.2 * w]] for w in (1e-3, 1.0, 1e3, 1e6)},
    "unstable beside fast": [[2.0, 1.0], [0.0, -1e5]],
    "chain from slow to fast": chain([-1e-6, -1e-3, -1.0, -1e3, -1e6]),
    "chain from fast to slow": chain([-1e6, -1e3, -1.0, -1e-3, -1e-6]),
    "repeated -1e4": [[-1e4, 1.0, 0.0], [0.0, -1e4, 1.0], [0.0, 0.0, -1e4]],
    "quadrotor with lag of 1 us": driven(QUADROTOR, 1e6),
    "quadrotor with lag of 1 ms": driven(QUADROTOR, 1e3),
}

cases = []
for name, rows in PLANTS.items():
    n = len(rows)
    a = mp.matrix(rows)
    b, w = mp.zeros(n, 1), [0.25] * n
    b[n - 1] = 1.5
    for rate in RATES_HZ:
        phi, gamma, gramian = step(a, b, [mp.mpf(v) for v in w], mp.mpf(1.0 / rate))
        # What is far below the smallest number is zero.
        table = lambda m: [[float(v) if abs(v) > 1e-300 else 0.0 for v in row] for row in m]
        case = {"name": f"{name}, {rate} Hz", "a": [[float(v) for v in row] for row in rows], "b": table(b.tolist()),
                "w": w, "period_s": 1.0 / rate, "phi": table(phi), "gamma": table(gamma), "gramian": table(gramian)}
        cases.append(case)
here = pathlib.Path(__file__).parent
text = {"source": f"mpmath {mp.__version__}, {mp.mp.dps} digits", "cases": cases}
(here / "stiff.json").write_text(json.dumps(text))
