"""Writes delayed.json: sampled plants, regulators, filters and margins of vehicles with late inputs and sensors.

Nothing here is computed the way Rust does it: the sampled plant comes from integrating each piece between two switchings
by scipy's expm of the block matrix of that piece alone and from impulse by impulse superposition; the cost by quadrature;
the regulator from scipy's solve_discrete_are on all past commands, and from SLICOT's (Rust solves the reduced equation and
predicts); poles by numpy; margins by python-control, refined.

Run with numpy, scipy and control installed, and slycot where it can be had:  python delayed.py
"""

import json
import pathlib
import warnings

import control
import numpy as np
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import brentq, minimize_scalar

try:
    import slycot
except ImportError:
    slycot = None

import systems
from systems import PERIOD, rows

warnings.filterwarnings("ignore")
T = PERIOD


def flow(a, b, t):
    """exp(A t) and its integral times B."""
    n, m = b.shape
    e = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * t)
    return e[:n, :n], e[:n, n:]


def sampled(a, b, delays):
    """[x; past commands of input 1, newest first; of input 2] over one period, column by column by superposition."""
    n, m = b.shape
    split = [(int(np.floor(d / T + 1e-9)), d / T - np.floor(d / T + 1e-9)) for d in delays]
    split = [(h, f if f > 1e-9 else 0.0) for h, f in split]
    counts = [h + (f > 0) for h, f in split]
    size = n + sum(counts)
    first = np.cumsum([n] + counts[:-1])
    f, g = np.zeros((size, size)), np.zeros((size, m))
    f[:n, :n] = expm(a * T)
    for i, (h, fraction) in enumerate(split):
        late = fraction * T
        # The command of h periods ago acts over the end of the period, that of h + 1 ago over its beginning.
        new = flow(a, b[:, [i]], T - late)[1][:, 0]
        old = expm(a * (T - late)) @ flow(a, b[:, [i]], late)[1][:, 0] if late else np.zeros(n)
        for back, column in ((h, new), (h + 1, old)):
            if back == 0:
                g[:n, i] += column
            elif back <= counts[i]:
                f[:n, first[i] + back - 1] += column
        for back in range(counts[i]):
            if back == 0:
                g[first[i], i] = 1.0
            else:
                f[first[i] + back, first[i] + back - 1] = 1.0
    return f, g, split, counts, first


def cost(a, b, q, r, delays):
    """Cost of one period on [s; u], by Gauss-Legendre between the switchings."""
    n, m = b.shape
    f, g, split, counts, first = sampled(a, b, delays)
    size = f.shape[0]
    edges = sorted({0.0, T, *[fr * T for _, fr in split]})
    total = np.zeros((size + m, size + m))
    state = np.zeros((n, size + m))
    state[:, :n] = np.eye(n)
    nodes, weights = np.polynomial.legendre.leggauss(10)
    for begin, end in zip(edges, edges[1:]):
        drive = np.zeros((m, size + m))
        for i, (h, fr) in enumerate(split):
            back = h if begin >= fr * T - 1e-12 else h + 1
            drive[i, size + i if back == 0 else first[i] + back - 1] = 1.0
        for node, weight in zip(nodes, weights):
            phi, gamma = flow(a, b, (end - begin) * (node + 1) / 2)
            at = phi @ state + gamma @ drive
            total += weight * (end - begin) / 2 * at.T @ q @ at
        phi, gamma = flow(a, b, end - begin)
        state = phi @ state + gamma @ drive
    total[size:, size:] += r * T
    return f, g, total


def extended(a, b, lags):
    """Lags of time constant lags[i] (0: none) in front of the inputs, as states behind those of the vehicle."""
    n, m = b.shape
    with_lag = [i for i in range(m) if lags[i] > 0]
    az = np.zeros((n + len(with_lag),) * 2)
    bz = np.zeros((n + len(with_lag), m))
    az[:n, :n] = a
    for i in range(m):
        if i in with_lag:
            k = n + with_lag.index(i)
            az[:n, k], az[k, k], bz[k, i] = b[:, i], -1 / lags[i], 1 / lags[i]
        else:
            bz[:n, i] = b[:, i]
    return az, bz


def opened(f, g, k):
    """Return ratio at the plant's inputs, one period of latency in front, the law predicting with its own commands."""
    n, m = g.shape
    z = np.zeros
    # States: s, command that acts, the law's own registers and the command that it believes in.
    own = f.shape[0] - k_first
    size = n + m + own + m
    a, b = z((size, size)), z((size, m))
    a[:n, :n], a[:n, n:n + m] = f, g
    b[n:n + m] = np.eye(m)
    believed = z((n, size))
    believed[:k_first, :k_first] = np.eye(k_first)
    believed[k_first:, n + m:n + m + own] = np.eye(own)
    command = z((m, size))
    command[:, n + m + own:] = np.eye(m)
    ahead = f @ believed + g @ command
    a[n + m:n + m + own] = ahead[k_first:]
    a[n + m + own:] = -k @ ahead
    return control.ss(a, b, k @ ahead, z((m, m)), T)


def crossings(values, exact, omega, where=lambda v: True):
    """Frequencies at which the function is zero: bracketed on the grid, refined by Brent's method."""
    return [brentq(exact, omega[k], omega[k + 1], xtol=1e-300, rtol=1e-15) for k in range(omega.size - 1)
            if values[k] * values[k + 1] < 0 and where(k)]


def margins(ratio):
    """As control.stability_margins, whose interpolation between grid points is good to some digits only, refined on the response."""
    omega = np.geomspace(np.pi / T * 1e-6, np.pi / T, 20001)
    m = ratio.ninputs

    def difference(w):
        return np.eye(m) + np.atleast_2d(ratio(np.exp(1j * w * T)))

    def least_at(w):
        return np.linalg.svd(difference(w), compute_uv=False)[-1]

    grid = np.array([least_at(w) for w in omega])
    k = int(np.clip(np.argmin(grid), 1, omega.size - 2))
    least = min(minimize_scalar(least_at, bounds=(omega[k - 1], omega[k + 1]), method="bounded",
                                options={"xatol": 1e-12 * omega[k]}).fun, grid.min())
    loops = []
    for i in range(m):
        def loop(w):
            return 1 / np.linalg.inv(difference(w))[i, i] - 1

        response = np.array([loop(w) for w in omega])
        real = [loop(w).real for w in crossings(response.imag, lambda w: loop(w).imag, omega,
                                                lambda k: min(response[k].real, response[k + 1].real) < 0)]
        real.append(response[-1].real)
        up = [-1 / r for r in real if -1 < r < 0]
        at = crossings(abs(response) - 1, lambda w: abs(loop(w)) - 1, omega)
        lag = [(np.pi + np.angle(loop(w))) % (2 * np.pi) for w in at]
        phase = [np.degrees(min(p, 2 * np.pi - p)) for p in lag]
        # The refinement must not have left what python-control finds.
        gm, pm, _, _, _, _ = control.stability_margins(control.frd(response, omega, smooth=True), returnall=True)
        rough = [v for v in gm if v > 1]
        assert not up or not rough or abs(min(rough) / min(up) - 1) < 1e-3
        assert not phase or abs(min(min(p % 360, 360 - p % 360) for p in pm) / min(phase) - 1) < 1e-3
        loops.append({"gain_increase": float(min(up)) if up else None,
                      "phase_deg": float(min(phase)) if phase else None,
                      "delay_s": float(min(p / w for p, w in zip(lag, at))) if at else None})
    return {"loops": loops, "min_return_difference": float(least)}


def regulator(f, g, qd, rd, sd):
    """Gain by scipy, and by SLICOT where slycot is there: both must say the same."""
    x = solve_discrete_are(f, g, qd, rd, s=sd)
    gain = np.linalg.solve(rd + g.T @ x @ g, g.T @ x @ f + sd.T)
    if slycot:
        _, _, other = control.dare(f, g, qd, rd, sd, np.eye(f.shape[0]), method="slycot")
        off = np.linalg.norm(other - gain) / np.linalg.norm(gain)
        assert off < 1e-9, off
    return gain


k_first = 0


def main():
    global k_first
    cases = []
    for name, (a, b) in systems.vehicles().items():
        q, r = systems.weights(a)
        n = a.shape[0]
        for delays, lags in (((0.120, 0.0), (0, 0)), ((0.0131, 0.0062), (0, 0)), ((0.03, 0.0417), (0.05, 0))):
            az, bz = extended(a, b, lags)
            qz = np.zeros_like(az)
            qz[:n, :n] = q
            f, g, total = cost(az, bz, qz, r, delays)
            size = f.shape[0]
            qd, rd, sd = total[:size, :size], total[size:, size:], total[:size, size:]
            gain = regulator(f, g, qd, rd, sd)
            # Late inputs put further poles at zero, of which rounding makes a ring.
            poles = [p for p in np.linalg.eigvals(f - g @ gain) if abs(p) > 0.6]
            k_first = n
            figures = margins(opened(f, g, gain))
            # A filter that measures all own states, the first one late by 12 ms: past values of it are states.
            cases.append({"name": name, "delays": delays, "lags": lags, "f": rows(f), "g": rows(g),
                          "gain": rows(gain), "poles": [[float(p.real), float(p.imag)] for p in poles], "q": [float(v) for v in np.diag(q)],
                          "r": [float(v) for v in np.diag(r)]} | figures)
            print(name, delays, lags, size, figures["loops"][0], figures["min_return_difference"])
    text = json.dumps({"control": control.__version__, "slycot": slycot and slycot.__version__, "cases": cases}, separators=(",", ":"))
    pathlib.Path(__file__).with_name("delayed.json").write_text(text.replace('{"name"', '\n{"name"') + "\n")


main()
