// The artificial horizon, from the estimate, or from what is measured or simulated where there is none.
class Horizon {
  constructor(store) {
    this.store = store;
    const place = document.getElementById("horizon");
    // 3 units a degree; the sky ends above what a vehicle near level ever shows.
    const rungs = [-30, -20, -10, -5, 5, 10, 20, 30].map((angle) => {
      const half = angle % 10 ? 14 : 28;
      const label = angle % 10 ? "" : `<text x="${half + 4}" y="${-3 * angle + 3.5}">${Math.abs(angle)}</text>`;
      return `<line x1="${-half}" x2="${half}" y1="${-3 * angle}" y2="${-3 * angle}"/>${label}`;
    }).join("");
    place.innerHTML = `<svg viewBox="-100 -80 200 160" role="img" aria-label="artificial horizon">
      <g id="world"><rect x="-400" y="-700" width="800" height="700" fill="#3f83c9"/><rect x="-400" y="0" width="800" height="700" fill="#8a6238"/>
      <line x1="-400" x2="400" y1="0" y2="0" stroke="#fff" stroke-width="1.6"/>
      <g stroke="#fff" stroke-width="1" fill="#fff" font-size="9" style="stroke-linecap:round">${rungs}</g></g>
      <g stroke="#ffd23f" stroke-width="3.4" fill="none"><path d="M-62 0H-24L-14 9"/><path d="M62 0H24L14 9"/></g><circle r="2.6" fill="#ffd23f"/></svg>`;
    for (const text of place.querySelectorAll("text")) text.setAttribute("stroke", "none");
    this.world = place.querySelector("#world");
  }

  build(scene) {
    this.outputs = scene.outputs;
    const has = (name) => scene.outputs.some((output) => output.name === name);
    document.getElementById("horizon").hidden = !has("roll") && !has("pitch");
    this.list = document.getElementById("angles");
    this.list.replaceChildren(...scene.outputs.map(({ name }) => {
      const row = document.createElement("div"), dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = name;
      row.append(dt, dd);
      return row;
    }));
  }

  value(name) {
    for (const kind of ["e.", "y.", "s."]) {
      const value = this.store.newest(kind + name);
      if (value !== null) return value;
    }
    return null;
  }

  draw() {
    const roll = this.value("roll") ?? 0, pitch = this.value("pitch") ?? 0;
    this.world.setAttribute("transform", `rotate(${-roll.toFixed(2)}) translate(0 ${(3 * pitch).toFixed(2)})`);
    this.world.dataset.roll = roll.toFixed(3);
    this.outputs.forEach(({ name, unit }, i) => {
      const value = this.value(name);
      this.list.children[i].lastChild.textContent = value === null ? "–" : `${value.toFixed(2)} ${unit}`;
    });
  }
}
