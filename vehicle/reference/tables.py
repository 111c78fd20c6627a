"""Writes the reference tables that the unit tests compare with: python3 reference/tables.py (needs numpy, scipy, mpmath)."""
import json, pathlib
import numpy as np, scipy
from scipy.special import ndtri
import mpmath as mp

here = pathlib.Path(__file__).parent

ps = sorted({*np.round(np.linspace(0.01, 0.99, 49), 4), 1e-16, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-3, 0.0749, 0.075, 0.0751, 0.925, 0.999, 1 - 1e-6, 1 - 1e-10})
mp.mp.dps = 40
quantile = lambda p: float(mp.findroot(lambda x: mp.ncdf(x) - mp.mpf(p), mp.mpf(float(ndtri(p)))))


def uniforms(seed, consumer, count):
    """The documented stream: ChaCha8 (RFC 8439 rounds, 64-bit counter and stream), key from PCG32 (rand_core), FNV-1a."""
    mask32, mask64 = 2**32 - 1, 2**64 - 1
    key, state = [], seed
    for _ in range(8):
        state = (state * 0x5851F42D4C957F2D + 0xA17654E46FBE17F3) & mask64
        x, rot = (((state >> 18) ^ state) >> 27) & mask32, state >> 59
        key.append(((x >> rot) | (x << (32 - rot))) & mask32)
    stream = 0xCBF29CE484222325
    for byte in consumer.encode():
        stream = ((stream ^ byte) * 0x100000001B3) & mask64
    rotate = lambda v, n: ((v << n) | (v >> (32 - n))) & mask32
    def quarter(w, a, b, c, d):
        for x, y, z, n in ((a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)):
            w[x] = (w[x] + w[y]) & mask32
            w[z] = rotate(w[z] ^ w[x], n)
    words, block = [], 0
    while len(words) < 2 * count:
        start = [0x61707865, 0x3320646E, 0x79622D32, 0x6B206574, *key, block & mask32, block >> 32, stream & mask32, stream >> 32]
        w = list(start)
        for _ in range(4):
            for a, b, c, d in ((0, 4, 8, 12), (1, 5, 9, 13), (2, 6, 10, 14), (3, 7, 11, 15), (0, 5, 10, 15), (1, 6, 11, 12), (2, 7, 8, 13), (3, 4, 9, 14)):
                quarter(w, a, b, c, d)
        words += [(x + y) & mask32 for x, y in zip(w, start)]
        block += 1
    draws = [words[2 * i] | words[2 * i + 1] << 32 for i in range(count)]
    return [((d >> 11) + 0.5) * 2.0**-53 for d in draws]

streams = [{"seed": seed, "consumer": name, "uniforms": uniforms(seed, name, 20)}
           for seed, name in ((1, "noise/roll"), (123456789, "turbulence/lateral_speed/0"))]
json.dump({"streams": streams, "source": f"mpmath {mp.__version__}, root of ncdf from scipy {scipy.__version__} ndtri",
           "quantiles": [[float(p), quantile(float(p)) if p != 0.5 else 0.0] for p in ps]},
          open(here / "normal.json", "w"), indent=0)

def exact(m):
    """exp(M) with 60 digits, rounded."""
    mp.mp.dps = 120
    e = mp.expm(mp.matrix(m.tolist()), method="taylor")
    return np.array([[float(e[i, j]) for j in range(m.shape[1])] for i in range(m.shape[0])])

rng = np.random.default_rng(1)
cases = []
def case(name, m, tolerance):
    m = np.array(m, float)
    e = exact(m)
    s = scipy.linalg.expm(m)
    print(f"{name:28} scipy's own relative error {np.linalg.norm(s - e) / np.linalg.norm(e):.1e}")
    cases.append({"name": name, "m": m.tolist(), "expm": e.tolist(), "tolerance": tolerance})
case("one", [[-3.5]], 4e-15)
case("nilpotent", [[0, 1, 2], [0, 0, 3], [0, 0, 0]], 1e-15)
case("rotation", [[0, 7], [-7, 0]], 1e-14)
case("Moler and Van Loan", [[-49, 24], [-64, 31]], 2e-13)
case("Ward 1", [[4, 2, 0], [1, 4, 1], [1, 1, 4]], 1e-14)
case("Ward 2", [[29.87942128909879, 0.7815750847907159, -2.289519314033932], [0.7815750847907159, 25.72656945571064, 8.680737820540137], [-2.289519314033932, 8.680737820540137, 34.39400925519054]], 1e-13)
case("Ward 3", [[-131, 19, 18], [-390, 56, 54], [-387, 57, 52]], 2e-11)
case("badly scaled", [[-1e-3, 1e6, 0], [0, -2e-3, 1e-7], [0, 3e2, -1]], 1e-14)
case("overscaled triangle", [[1, 1e6], [0, -1]], 1e-14)
for n in (4, 8, 12, 20):
    case(f"random {n}", rng.normal(size=(n, n)), 1e-13)
q = np.array([[0, 1, 0, 0], [-1.1132, -.7118, .0001, 0], [0, 0, 0, 1], [7.2721, 6.1794, -7.9908, -5.2474]])
b = np.array([[0, 0], [-1.1045, 0], [0, 0], [-4.5267, -14.4146]])
z = np.zeros((6, 6)); z[:4, :4] = q; z[:4, 4:] = b
case("quadrotor 5 ms", z * 0.005, 1e-15)
case("quadrotor 1 s", z, 1e-14)
lag = np.zeros((5, 5)); lag[:4, :4] = q; lag[:4, 4] = b[:, 1]; lag[4, 4] = -2000
case("stiff", lag * 0.5, 1e-12)
json.dump({"source": f"mpmath {mp.__version__} taylor, 60 digits and more", "cases": cases}, open(here / "expm.json", "w"))
