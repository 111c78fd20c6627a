"""How much of a measured signal's derivative a simulation has, in a band: 100 (1 - |error| / |measured|), %.

    band-fit.py MEASURED.csv SIMULATED.csv SIGNAL LOW_HZ HIGH_HZ

Both files have the time in s in their first column; `SIGNAL` may be in deg/s or rad/s. Needs NumPy and SciPy.
"""

import csv
import sys

import numpy as np
from scipy.signal import butter, sosfiltfilt

RATE_HZ = 500.0


def column(path, signal):
    with open(path, newline="") as file:
        head = next(csv.reader(file))
    values = np.genfromtxt(path, delimiter=",", skip_header=1)
    index = [name.split("[")[0] for name in head].index(signal)
    degrees = "[deg" in head[index]
    return values[:, 0], np.deg2rad(values[:, index]) if degrees else values[:, index]


def main():
    measured, simulated, signal, low, high = sys.argv[1:]
    (t, y), (ts, ys) = column(measured, signal), column(simulated, signal)
    grid = np.arange(max(t[0], ts[0]), min(t[-1], ts[-1]), 1.0 / RATE_HZ)
    band = butter(2, [float(low), float(high)], "band", fs=RATE_HZ, output="sos")

    def change(times, values):
        return sosfiltfilt(band, np.gradient(np.interp(grid, times, values), grid))

    a, b = change(t, y), change(ts, ys)
    print(f"{100.0 * (1.0 - np.linalg.norm(a - b) / np.linalg.norm(a)):.1f} %")


if __name__ == "__main__":
    main()
