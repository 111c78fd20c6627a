"""The plants that all reference tables share, and a generator that Rust repeats bit for bit."""

import numpy as np
from scipy.linalg import expm

DEGREE = np.pi / 180.0
PERIOD = 0.005


class SplitMix:
    """SplitMix64 (Steele, Lea and Flood 2014); tests/suite/support/mod.rs has the same."""

    MASK = (1 << 64) - 1

    def __init__(self, seed):
        self.state = seed

    def uniform(self):
        """In [-1, 1)."""
        self.state = (self.state + 0x9E3779B97F4A7C15) & self.MASK
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & self.MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & self.MASK
        z ^= z >> 31
        return (z >> 11) / 2.0**52 - 1.0

    def matrix(self, rows, columns):
        """Row after row."""
        return np.array([[self.uniform() for _ in range(columns)] for _ in range(rows)])


def random_system(k):
    """System k of the 200: (A, B, Q, R, poles), 2 to 8 states, 1 to 3 inputs, a third of the poles in pairs."""
    g = SplitMix(1000 + k)
    n, m = 2 + k % 7, 1 + k % 3
    m = min(n, m)
    a, b = g.matrix(n, n), g.matrix(n, m)
    c, d = g.matrix(n, n), g.matrix(m, m)
    q, r = c.T @ c, np.eye(m) + d.T @ d
    poles = []
    while len(poles) < n:
        re, im = -2.0 + g.uniform(), 1.5 + g.uniform()
        if k % 3 == 0 and len(poles) + 2 <= n:
            poles += [complex(re, im), complex(re, -im)]
        else:
            poles.append(complex(re - 0.3 * len(poles), 0.0))
    return a, b, q, r, np.array(poles)


def vehicles():
    """The four vehicles of the paper's tables, SI: {name: (A, B)}."""
    a = np.array([
        [0, 1, 0, 0],
        [-1.1132, -0.7118, 0.0001, 0],
        [0, 0, 0, 1],
        [7.2721, 6.1794, -7.9908, -5.2474],
    ])
    b = np.array([[0, 0], [-1.1045, 0], [0, 0], [-4.5267, -14.4146]]) * DEGREE
    out = {"quadrotor": (a, b)}
    table = {
        "helicopter-hover": [
            -0.0897, -1.0211, 1.8807, 0.7150, -1.0785, -2.6725, -1.1095, -2.0666, 0.3604, 0.0213,
            -1.1681, 1.2946, 3.0741, -4.4571, -0.2156, 0.3313, 1.2969, 0.8092, -3.6516, -1.3202],
        "helicopter-longitudinal": [
            -4.9522, -0.1898, 1.5900, 5.0240, -3.6885, -1.8418, -4.4536, -3.4587, -0.7884, 0.8237,
            -0.1264, -0.4601, 0.5184, -0.9718, -1.8407, 0.0961, -5.0342, 2.8049, -4.4360, -4.0981],
        "helicopter-lateral": [
            -9.4286, -2.8422, 6.1920, -4.6793, -0.0641, 0.4656, -8.1002, -5.5487, 0.2680, 0.5478,
            -0.9287, -1.3005, 0.3482, -0.1548, -0.4067, 1.1147, -12.7259, -0.0557, 1.8356, -3.6725],
    }
    for name, p in table.items():
        a = np.zeros((8, 8))
        a[0, 1] = a[2, 3] = 1.0
        a[1, :4], a[3, :4] = p[0:4], p[4:8]
        a[4, [0, 1]], a[4, 4] = np.array(p[8:10]) / DEGREE, p[10]
        a[5, [2, 3]], a[5, 5] = np.array(p[11:13]) / DEGREE, p[13]
        a[6, 5], a[7, 4] = p[14], p[15]
        b = np.zeros((8, 2))
        b[1], b[3] = np.array(p[16:18]) * DEGREE, np.array(p[18:20]) * DEGREE
        out[name] = (a, b)
    return out


def zoh(a, b, dt=PERIOD):
    """Zero-order-hold discretisation."""
    n, m = b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a, b
    e = expm(block * dt)
    return e[:n, :n], e[:n, n:]


def weights(a):
    """LQR weights of the vehicles: excursions of 0.1 rad, 0.5 rad/s, 1 m/s and 1 m against inputs of 20."""
    scale = [0.1, 0.5, 0.1, 0.5, 1.0, 1.0, 1.0, 1.0][: a.shape[0]]
    return np.diag([1.0 / s**2 for s in scale]), np.diag([1.0 / 400.0] * 2)


def rows(m):
    """A matrix as lists, whole numbers without a point."""
    def short(v):
        return int(v) if v == int(v) and abs(v) < 1e15 else float(v)
    return [[short(v) for v in row] for row in np.atleast_2d(m)]
