"""What a transport costs, as a table in Markdown and a plot in SVG.

    whirlstand bench transports --repeat 1 --json transports.json
    transports-plot.py transports.json docs/transports.svg > table.md
"""

import json
import math
import re
import sys

LEFT, TOP, ROW, WIDTH = 280, 54, 24, 400
LOW_US, HIGH_US = 1.0, 1e5
KINDS = (("p50", "#2b6cb0"), ("p99", "#b7791f"), ("max", "#c53030"))


def flights(figures):
    """The figures of each flight, by their short names."""
    found = []
    for figure in figures:
        name, value = figure["name"], figure["value"]
        head = re.fullmatch(r"(?:realtime )?(.*): missed deadlines in (\d+) steps", name)
        if head:
            found.append({"name": head[1], "missed": value, "steps": int(head[2])})
            continue
        short = name.strip().replace("command latency, ", "").replace("integral of the error", "error")
        found[-1][short.replace("peak after the gust", "peak")] = value
    return found


def rate(flight):
    """As `200 Hz`."""
    return flight["name"].split(", ")[-1]


def told(us):
    return f"{us:.0f} us" if us < 1000 else f"{us / 1000:.1f} ms"


def table(found):
    print("| | missed | latency p50 | p99 | max | roll: error | peak | pitch: error | peak |")
    print("|---|---|---|---|---|---|---|---|---|")
    for f in found:
        latency = [told(f[kind]) if kind in f else "" for kind, _ in KINDS]
        control = [f"{f[key]:.2f}" if key in f else "-" for key in ("roll: error", "roll: peak", "pitch: error", "pitch: peak")]
        print("|", " | ".join([f["name"], f"{f['missed']:.0f} of {f['steps']}", *latency, *control]), "|")


def plot(found):
    rows = [f for f in found if "p50" in f]
    exact = {rate(f): f for f in found if "p50" not in f}
    at = lambda us: LEFT + WIDTH * math.log(min(max(us, LOW_US), HIGH_US) / LOW_US) / math.log(HIGH_US / LOW_US)
    bottom = TOP + ROW * len(rows)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {LEFT + WIDTH + 190} {bottom + 40}" font-family="system-ui, sans-serif" font-size="13">',
        f'<rect width="{LEFT + WIDTH + 190}" height="{bottom + 40}" fill="#ffffff"/>',
        f'<text x="{LEFT}" y="20" fill="#1a202c">latency of a command:</text>',
    ]
    for i, (kind, colour) in enumerate(KINDS):
        out.append(f'<circle cx="{LEFT + 160 + 60 * i}" cy="16" r="4" fill="{colour}"/><text x="{LEFT + 168 + 60 * i}" y="20" fill="#1a202c">{kind}</text>')
    out.append(f'<text x="{LEFT + WIDTH + 14}" y="{TOP - 12}" fill="#1a202c">missed</text><text x="{LEFT + WIDTH + 80}" y="{TOP - 12}" fill="#1a202c">error in roll</text>')
    for exponent in range(0, 6):
        x = at(10.0**exponent)
        label = ["1 us", "10 us", "100 us", "1 ms", "10 ms", "100 ms"][exponent]
        out.append(f'<path d="M{x:.1f} {TOP - 6} V{bottom}" stroke="#cbd5e0"/><text x="{x:.1f}" y="{bottom + 18}" text-anchor="middle" fill="#4a5568">{label}</text>')
    for i, f in enumerate(rows):
        y = TOP + ROW * i + ROW / 2
        period = at(1e6 / float(rate(f).split()[0]))
        out.append(f'<text x="{LEFT - 10}" y="{y + 4}" text-anchor="end" fill="#1a202c">{f["name"]}</text>')
        out.append(f'<path d="M{at(f["p50"]):.1f} {y} H{at(f["max"]):.1f}" stroke="#a0aec0" stroke-width="2"/>')
        out.append(f'<path d="M{period:.1f} {y - 9} V{y + 9}" stroke="#1a202c" stroke-width="2"/>')
        out += [f'<circle cx="{at(f[kind]):.1f}" cy="{y}" r="4" fill="{colour}"/>' for kind, colour in KINDS]
        change = f'{100 * (f["roll: error"] / exact[rate(f)]["roll: error"] - 1) + 0.0:+.0f} %' if "roll: error" in f else "no figure"
        change = change.replace("-0 %", "+0 %")
        out.append(f'<text x="{LEFT + WIDTH + 14}" y="{y + 4}" fill="#1a202c">{100 * f["missed"] / f["steps"]:.1f} %</text><text x="{LEFT + WIDTH + 80}" y="{y + 4}" fill="#1a202c">{change}</text>')
    out.append(f'<text x="10" y="{bottom + 36}" fill="#4a5568">A black line is the period: a command that takes longer acts late. The error is compared with that in lockstep.</text></svg>')
    return "\n".join(out) + "\n"


def main():
    source, target = sys.argv[1:]
    with open(source) as file:
        found = flights(json.load(file)["figures"])
    table(found)
    with open(target, "w") as file:
        file.write(plot(found))


if __name__ == "__main__":
    main()
