// The plots: which lines each has, and drawing what can be seen of them.
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
const narrow = window.matchMedia("(max-width: 640px)").matches;

const STYLES = {
  measured: () => ({ color: colour("sensor"), width: 1 }),
  estimated: () => ({ color: colour("estimate"), width: 1.5 }),
  simulated: () => ({ color: colour("v0"), width: 1.9 }),
  wanted: () => ({ color: colour("wanted"), width: 1.3, dash: "6px,4px", shape: "hv" }),
  limit: () => ({ color: colour("soft"), width: 1.1, dash: "dot" }),
  command: () => ({ color: colour("v1"), width: 1.4, shape: "hv" }),
  applied: () => ({ color: colour("v0"), width: 1.7, shape: "hv" }),
};

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
// The screen's next picture; a page that nobody sees has none.
const shown = () => new Promise((done) => {
  requestAnimationFrame(() => setTimeout(done));
  setTimeout(done, 1000);
});

class Plots {
  constructor(store, view) {
    this.store = store;
    this.view = view;
    this.plots = [];
    this.drawn = null;
    this.seen = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        const plot = this.plots.find((p) => p.element === entry.target);
        if (plot) plot.isSeen = entry.isIntersecting;
      }
    }, { rootMargin: "200px" });
  }

  build(scene) {
    for (const plot of this.plots) {
      Plotly.purge(plot.element);
      plot.element.parentElement.remove();
    }
    this.plots = [];
    for (const { name, unit } of scene.outputs) {
      this.add("outputs", `output-${name}`, name, unit, [
        ["y." + name, "measured"], ["e." + name, "estimated"], ["s." + name, "simulated"], ["w." + name, "wanted", "setpoint"]]);
    }
    for (const { name, unit, limits } of scene.inputs) {
      this.add("inputs", `input-${name}`, name, unit, [["u." + name, "command"], ["a." + name, "applied"]], limits);
    }
    for (const { name, unit } of scene.outputs) {
      const lines = [["r." + name, "measured", "residual"], ["b." + name, "limit", "95 % of it", 1], ["b." + name, "limit", "95 % of it", -1]];
      this.add("residuals", `residual-${name}`, name, unit, lines);
    }
    this.add("residuals", "nis", "normalised innovation squared", "",
      [["nis", "measured", "NIS per degree of freedom"], ["nis_low", "limit", "95 % of it"], ["nis_high", "limit", "95 % of it"]]);
  }

  add(place, id, title, unit, lines, limits) {
    const figure = document.createElement("figure");
    const caption = document.createElement("figcaption");
    caption.textContent = title;
    const element = document.createElement("div");
    element.className = "plot";
    element.id = "plot-" + id;
    element.style.height = (narrow ? 190 : 215) + "px";
    figure.append(caption, element);
    document.getElementById(place).append(figure);
    const plot = { element, title, unit, lines, limits, isSeen: true, isNew: true, isZoomed: false };
    this.plots.push(plot);
    this.seen.observe(element);
  }

  // Draws for as long as the page lives, a few times a second where the machine can. One plot at a time, and after each a pause
  // as long as it took until it was on the screen: what else the page does, the stick above all, is never late by more than a plot.
  async run(sweepMs) {
    for (;;) {
      const began = performance.now();
      // A plot that could not be drawn is told to the console, and tried again.
      if (!document.hidden) await this.sweep().catch((error) => console.error(error));
      await pause(Math.max(began + sweepMs - performance.now(), 0));
    }
  }

  // Draws all plots that can be seen over the same time; one whose time axis is held, once.
  async sweep() {
    const held = this.view.held, plots = this.plots, [from, until] = this.view.range();
    if (held && held === this.drawn && this.store.t.length > 1) return;
    this.drawn = held;
    for (const plot of plots) {
      if (!plot.isSeen) continue;
      // Another scene, or a zoom by hand: the rest is of no use.
      if (plots !== this.plots || held !== this.view.held) return;
      const began = performance.now();
      this.drawOne(plot, from, until);
      await shown();
      await pause(performance.now() - began);
    }
  }

  // Draws all again, also what is held.
  redraw() {
    this.drawn = null;
  }

  drawOne(plot, from, until) {
    const pieces = Math.max(100, plot.element.clientWidth || 400) / 2;
    const known = new Set();
    const traces = plot.lines.map(([column, style, name = style, sign = 1]) => {
      const { x, y } = this.store.line(column, from, until, pieces);
      const showlegend = !known.has(name) && x.length > 0;
      known.add(name);
      return { type: "scatter", mode: "lines", x, y: sign === 1 ? y : y.map((v) => -v), name, legendgroup: name, showlegend,
        line: STYLES[style](), hovertemplate: "%{y:.4~g}" };
    });
    for (const limit of plot.limits ?? []) {
      traces.push({ type: "scatter", mode: "lines", x: [from, until], y: [limit, limit], name: "limit", legendgroup: "limit",
        showlegend: limit === plot.limits[0], line: STYLES.limit(), hoverinfo: "skip" });
    }
    const layout = this.layout(plot, from, until);
    if (plot.isNew) {
      plot.isNew = false;
      Plotly.newPlot(plot.element, traces, layout, { responsive: true, displaylogo: false, displayModeBar: false });
      plot.element.on("plotly_relayout", (change) => this.moved(plot, change));
    } else {
      plot.isDrawing = true;
      Plotly.react(plot.element, traces, layout).finally(() => { plot.isDrawing = false; });
    }
  }

  layout(plot, from, until) {
    const axis = { gridcolor: colour("grid"), linecolor: colour("line"), zerolinecolor: colour("line"), tickcolor: colour("line"),
      ticks: "outside", ticklen: 4, automargin: true, exponentformat: "power" };
    const lines = this.store.events.filter((event) => event.t >= from && event.t <= until).slice(-40);
    const shapes = lines.map((event) => ({ type: "line", xref: "x", yref: "paper", x0: event.t, x1: event.t, y0: 0, y1: 1, layer: "below",
      line: { width: 1.3, dash: "dot", color: colour(event.kind === "warning" ? "bad" : "disturbance-line") } }));
    return {
      font: { family: getComputedStyle(document.body).fontFamily, size: 11.5, color: colour("ink") }, shapes,
      paper_bgcolor: colour("card"), plot_bgcolor: colour("card"), margin: { l: narrow ? 40 : 50, r: 12, t: 24, b: 28 },
      xaxis: { ...axis, range: [from, until], autorange: false, ticksuffix: " s", showticksuffix: "last" },
      yaxis: { ...axis, title: { text: plot.unit, standoff: 4 }, ...(plot.yRange ? { range: plot.yRange, autorange: false } : { autorange: true }) },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1.02, yanchor: "bottom", font: { size: narrow ? 10 : 11 }, itemwidth: 30, bgcolor: "rgba(0,0,0,0)" },
      showlegend: true, hovermode: "x unified", dragmode: "zoom", uirevision: "kept",
      hoverlabel: { bgcolor: colour("card"), bordercolor: colour("line"), font: { color: colour("ink") } },
    };
  }

  // A zoom or a shift by hand holds all plots at the same time; a double-click lets them go on.
  moved(plot, change) {
    if (plot.isDrawing) return;
    if (change["xaxis.autorange"] || change["yaxis.autorange"]) {
      for (const other of this.plots) delete other.yRange;
      this.view.follow();
      return;
    }
    if ("yaxis.range[0]" in change) plot.yRange = [change["yaxis.range[0]"], change["yaxis.range[1]"]];
    if ("xaxis.range[0]" in change) this.view.hold([change["xaxis.range[0]"], change["xaxis.range[1]"]]);
  }

  release() {
    for (const plot of this.plots) delete plot.yRange;
  }
}
