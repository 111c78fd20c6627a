"""Writes place.json: how near to the wanted poles scipy.signal.place_poles comes, and how robust its gain is.

Run with numpy and scipy installed:  python place.py

`error` is the largest distance between a wanted and a placed pole, `condition` the condition number of the unit
eigenvectors of A - B K.
"""

import json
import pathlib
import warnings

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import place_poles

import systems
from systems import rows

warnings.filterwarnings("ignore")


def attempt(a, b, poles):
    """(error, condition) of SciPy's gain, or (None, None) when it refuses."""
    try:
        method = "YT"
        k = place_poles(a, b, poles, method=method, maxiter=100).gain_matrix
    except ValueError:
        return None, None
    values, vectors = np.linalg.eig(a - b @ k)
    cost = np.abs(values[:, None] - np.asarray(poles)[None, :])
    i, j = linear_sum_assignment(cost)
    return float(cost[i, j].max()), float(np.linalg.cond(vectors))


def named():
    """(name, A, B, poles, continuous or discrete matters not)."""
    # python-control issue 117: its transposed pair, four independent inputs.
    a = np.array([[0, 0, 0, 1], [-42.7207306947135, 0, 0, 0], [0, 0, 0, 0], [47.0334901743703, 0, 0, 0]]).T
    yield "python-control-117", a, np.eye(4), [-31, -21, -20, -30]
    # python-control issue 177: a pair on the place of a real eigenvalue.
    yield "python-control-177", np.array([[0.0, 1], [100, 0]]), np.array([[0.0], [1]]), [-20 + 10j, -20 - 10j]
    # The reactor of Kautsky, Nichols and Van Dooren's first example, as in SciPy's documentation and the
    # python-control change that resolved both issues.
    a = np.array([[1.38, -0.2077, 6.715, -5.676], [-0.5814, -4.29, 0, 0.675], [1.067, 4.273, -6.654, 5.893],
                  [0.048, 4.273, 1.343, -2.104]])
    b = np.array([[0, 5.679], [1.136, 1.136], [0, 0], [-3.146, 0]])
    yield "reactor", a, b, [-0.2, -0.5, -5.0566, -8.6659]
    yield "reactor-repeated", a, b, [-0.5, -0.5, -5.0566, -5.0566]
    yield "reactor-pairs", a, b, [-0.5 + 1j, -0.5 - 1j, -5 + 3j, -5 - 3j]
    sets = {
        4: {"real": [-3, -4, -5, -6], "pairs": [-2 + 2j, -2 - 2j, -4 + 3j, -4 - 3j]},
        8: {"real": [-1, -1.3, -1.7, -2.2, -2.9, -3.7, -4.5, -5.5],
            "pairs": [-1 + 0.5j, -1 - 0.5j, -1.5 + 1j, -1.5 - 1j, -3 + 2j, -3 - 2j, -4, -5]},
    }
    for name, (a, b) in systems.vehicles().items():
        phi, gamma = systems.zoh(a, b)
        for kind, poles in sets[a.shape[0]].items():
            yield f"{name}-{kind}", a, b, poles
            yield f"{name}-{kind}-discrete", phi, gamma, list(np.exp(np.array(poles) * systems.PERIOD))
    # python-control issue 157's kind of plant, with a singular A: here by a delay in the state.
    for name, (a, b) in systems.vehicles().items():
        phi, gamma = systems.zoh(a, b)
        n, m = b.shape
        big = np.zeros((n + m, n + m))
        big[:n, :n], big[:n, n:] = phi, gamma
        poles = list(np.exp(np.array(sets[n]["real"]) * systems.PERIOD)) + [0.1, 0.2]
        yield f"{name}-delayed", big, np.vstack([np.zeros((n, m)), np.eye(m)]), poles


def main():
    cases = []
    for name, a, b, poles in named():
        error, condition = attempt(a, b, np.asarray(poles))
        print(f"{name:40s} error {error} condition {condition}")
        pairs = [[complex(p).real, complex(p).imag] for p in poles]
        cases.append({"name": name, "a": rows(a), "b": rows(b), "poles": rows(pairs), "error": error, "condition": condition})
    random = []
    for k in range(200):
        a, b, _, _, poles = systems.random_system(k)
        random.append(attempt(a, b, poles))
    errors = np.array([e for e, _ in random if e is not None])
    print("random: refused", 200 - errors.size, "median", np.median(errors), "largest", errors.max())
    text = json.dumps({"scipy": __import__("scipy").__version__, "cases": cases, "random": random}, separators=(",", ":"))
    pathlib.Path(__file__).with_name("place.json").write_text(text.replace('{"name"', '\n{"name"') + "\n")


main()
