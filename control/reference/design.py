"""Writes design.json: gains, poles and margins of the delayed loop for the four vehicles, by python-control.

Run with numpy, scipy, control and slycot installed:  python design.py
"""

import json
import pathlib
import warnings

import control
import numpy as np
from scipy.linalg import expm
from scipy.signal import place_poles

import systems
from systems import PERIOD, rows

warnings.filterwarnings("ignore")


def sampled_cost(a, b, q, r):
    """The cost over one period by Gauss-Legendre quadrature (Rust uses Van Loan's exponential)."""
    n, m = b.shape
    f = np.zeros((n + m, n + m))
    f[:n, :n], f[:n, n:] = a, b
    w = np.zeros((n + m, n + m))
    w[:n, :n], w[n:, n:] = q, r
    nodes, weights = np.polynomial.legendre.leggauss(12)
    total = np.zeros_like(w)
    for node, weight in zip(nodes, weights):
        e = expm(f * PERIOD * (node + 1) / 2)
        total += weight * PERIOD / 2 * e.T @ w @ e
    return total[:n, :n], total[n:, n:], total[:n, n:]


def opened(phi, gamma, k):
    """Return ratio at the plant's inputs: plant and delay, then the predicting law."""
    n, m = gamma.shape
    z = np.zeros
    plant = control.ss(np.block([[phi, gamma], [z((m, n + m))]]), np.vstack([z((n, m)), np.eye(m)]),
                       np.hstack([np.eye(n), z((n, m))]), z((n, m)), PERIOD)
    # The law: v = -K (Phi x + Gamma v_before); its output here is -v.
    law = control.ss(-k @ gamma, -k @ phi, k @ gamma, k @ phi, PERIOD)
    return law * plant


def figures(phi, gamma, k):
    """Poles and margins of the loop with the gain k."""
    n, m = gamma.shape
    ratio = opened(phi, gamma, k)
    big = np.block([[phi, gamma], [-k @ phi, -k @ gamma]])
    poles = np.linalg.eigvals(big)
    omega = np.geomspace(np.pi / PERIOD * 1e-6, np.pi / PERIOD, 20001)
    loops = []
    for i in range(m):
        others = [j for j in range(m) if j != i]
        a = ratio.A - ratio.B[:, others] @ ratio.C[others, :]
        single = control.ss(a, ratio.B[:, [i]], ratio.C[[i], :], 0, PERIOD)
        response = control.frd(single, omega, smooth=True)
        gm, pm, _, _, wgc, _ = control.stability_margins(response, returnall=True)
        up, down = [g for g in gm if g > 1], [g for g in gm if g < 1]
        lag = [(p % 360.0) * np.pi / 180 / w for p, w in zip(pm, wgc)]
        phase = [min(p % 360.0, 360.0 - p % 360.0) for p in pm]
        loops.append({
            "gain_increase": float(min(up)) if up else None,
            "gain_decrease": float(max(down)) if down else None,
            "phase_deg": float(min(phase)) if phase else None,
            "delay_s": float(min(lag)) if lag else None,
        })
    response = ratio.frequency_response(omega, squeeze=False).complex
    least = min(np.linalg.svd(np.eye(m) + response[:, :, i], compute_uv=False)[-1] for i in range(omega.size))
    disk = control.disk_margins(ratio, omega, skew=0.0)[0]
    return {
        "poles": sorted([[float(p.real), float(p.imag)] for p in poles]),
        "loops": loops,
        "min_return_difference": float(least),
        "disk": float(np.min(disk)),
    }


def main():
    cases = []
    poles = {4: [-3, -4, -5, -6], 8: [-1, -1.3, -1.7, -2.2, -2.9, -3.7, -4.5, -5.5]}
    for name, (a, b) in systems.vehicles().items():
        phi, gamma = systems.zoh(a, b)
        q, r = systems.weights(a)
        qd, rd, sd = sampled_cost(a, b, q, r)
        lqr = control.dlqr(phi, gamma, qd, rd, sd)[0]
        wanted = np.exp(np.array(poles[a.shape[0]]) * PERIOD)
        ppc = place_poles(phi, gamma, wanted, method="YT", maxiter=100).gain_matrix
        for law, k in (("lqr", lqr), ("ppc", ppc)):
            case = {"name": name, "law": law, "gain": rows(k)} | figures(phi, gamma, k)
            if law == "lqr":
                case |= {"q": [float(v) for v in np.diag(q)], "r": [float(v) for v in np.diag(r)]}
            print(name, law, case["loops"], case["min_return_difference"], case["disk"])
            cases.append(case)
    text = json.dumps({"control": control.__version__, "cases": cases}, separators=(",", ":"))
    pathlib.Path(__file__).with_name("design.json").write_text(text.replace('{"name"', '\n{"name"') + "\n")


main()
