"use strict";
(async () => {
  // Plotly and the data are gzip as base64; the browser inflates them after it has shown text and tables.
  async function unpacked(id) {
    const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(plain).text();
  }

  // Lets the browser show what there is before the next piece of work.
  const pause = () => new Promise((resume) => setTimeout(resume));

  await pause();
  const plotly = document.createElement("script");
  plotly.textContent = await unpacked("plotly");
  const { columns, plots } = JSON.parse(await unpacked("data"));
  document.head.append(plotly);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  // A phone has no pointer to hover with and no width to spare: a double tap resets, the legend gets rows.
  const narrow = window.matchMedia("(max-width: 640px)").matches;
  const config = { responsive: true, displaylogo: false, displayModeBar: narrow ? false : "hover",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d", "hoverClosestCartesian", "hoverCompareCartesian", "toggleSpikelines"] };
  // What is drawn, for a spreadsheet; every sample is in the log.
  function asCsv(plot) {
    const quoted = (text) => '"' + String(text).replaceAll('"', '""') + '"';
    const rows = plot.traces.flatMap((trace) => columns[trace.x].map((x, i) =>
      [quoted(trace.name), x, columns[trace.y][i] ?? ""].join(",")));
    return [["line", plot.x, plot.y].map(quoted).join(","), ...rows].join("\n") + "\n";
  }

  function save(name, text) {
    const link = document.createElement("a");
    link.download = name;
    link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
    link.click();
    URL.revokeObjectURL(link.href);
  }

  const meaning = { disturbance: "disturbance", held: "command held", failsafe: "failsafe", worst: "greatest error", held_out: "held out" };

  // The legend says what a shade means: a text at the shade itself would lie on lines or on other texts.
  function key(kind) {
    return { type: "scatter", mode: "markers", x: [null], y: [null], name: meaning[kind], hoverinfo: "skip",
      marker: { symbol: "square", size: 12, color: colour(kind), line: { width: 1, color: colour(kind) } } };
  }

  function lines(plot) {
    const known = new Set();
    const all = plot.traces.map((trace) => drawn(trace, plot));
    for (const trace of all) {
      trace.legendgroup = trace.name;
      trace.showlegend = !known.has(trace.name);
      known.add(trace.name);
    }
    return (plot.heat ? [heat(plot)] : []).concat(all, [...new Set(plot.spans.map((span) => span.kind))].map(key));
  }

  function line(trace) {
    const own = colour("v" + (trace.variant % 6));
    switch (trace.look) {
      case "second": return { color: own, width: 1.5, dash: "5px,3px" };
      case "estimate": return { color: colour("estimate"), width: 1.5, dash: "5px,3px" };
      case "sensor": return { color: colour("sensor"), width: 0.9 };
      case "wanted": return { color: colour("wanted"), width: 1.3, dash: "6px,4px", shape: "hv" };
      case "limit": return { color: colour("soft"), width: 1.1, dash: "dot" };
      case "held": return { color: own, width: 1.5, shape: "hv" };
      default: return { color: own, width: 1.9 };
    }
  }

  function heat(plot) {
    const { x, y, z, unit } = plot.heat;
    return { type: "heatmap", x: columns[x], y: columns[y], z, zsmooth: false, name: "",
      colorscale: [[0, colour("heat-0")], [0.5, colour("heat-1")], [1, colour("heat-2")]],
      hovertemplate: `%{x:.4~g}, %{y:.4~g}: %{z:.3~g} ${unit}<extra></extra>`,
      colorbar: { thickness: 10, outlinewidth: 0, tickfont: { size: 11 } } };
  }

  // The unit of an axis is what stands behind the last comma of its label, or the whole label.
  const unit = (label) => (label ? " " + label.split(", ").pop() : "");

  function drawn(trace, plot) {
    const common = { name: trace.name, x: columns[trace.x], y: columns[trace.y],
      visible: trace.hidden ? "legendonly" : true, hovertemplate: "%{y:.5~g}" + unit(plot.y) };
    if (trace.look === "histogram") {
      return { ...common, type: "scatter", mode: "lines", fill: "tozeroy", line: { ...line(trace), shape: "hv", width: 1.3 } };
    }
    if (trace.look === "cloud") {
      return { ...common, type: "scatter", mode: "markers", marker: { color: colour("cloud"), size: 3 }, hoverinfo: "skip", hovertemplate: null };
    }
    if (trace.look === "points" || trace.look === "crosses") {
      const symbol = trace.look === "crosses" ? "x-thin" : "circle";
      const own = colour("v" + (trace.variant % 6));
      return { ...common, type: "scatter", mode: "markers",
        marker: { color: own, size: trace.look === "crosses" ? 10 : 6.5, symbol, line: { width: trace.look === "crosses" ? 2 : 0, color: own } } };
    }
    return { ...common, type: "scatter", mode: "lines", line: line(trace), connectgaps: false,
      opacity: trace.look === "sensor" ? 0.75 : 1 };
  }

  // A label a decade where there are some: those between would stand without their power.
  function decades(plot, axis) {
    if (!plot["log_" + axis]) return {};
    const values = plot.traces.filter((trace) => !trace.hidden).flatMap((trace) => columns[trace[axis]]).filter((v) => v > 0);
    const [low, high] = values.reduce(([l, h], v) => [Math.min(l, v), Math.max(h, v)], [Infinity, 0]);
    return high > 30 * low ? { dtick: Math.max(1, Math.round(Math.log10(high / low) / 6)) } : {};
  }

  function layout(plot) {
    const axis = { gridcolor: colour("grid"), linecolor: colour("line"), zerolinecolor: colour("line"),
      tickcolor: colour("line"), ticks: "outside", ticklen: 4, automargin: true, exponentformat: "power" };
    const shapes = [], annotations = [];
    for (const span of plot.spans) {
      const mark = span.until <= span.from;
      const line = { width: mark ? 1.4 : 0, color: colour(span.kind === "disturbance" ? "disturbance-line" : "soft"), dash: "dot" };
      shapes.push({ type: mark ? "line" : "rect", xref: "x", yref: "paper", x0: span.from, x1: span.until, y0: 0, y1: 1,
        line, fillcolor: colour(span.kind), layer: "below" });
    }
    for (const [x, y, text] of plot.notes) {
      annotations.push({ x: plot.log_x ? Math.log10(x) : x, y: plot.log_y ? Math.log10(y) : y, text, showarrow: true,
        arrowhead: 0, arrowwidth: 1, arrowcolor: colour("soft"), ax: 0, ay: -22, font: { size: 11, color: colour("ink") } });
    }
    return {
      font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: colour("ink") },
      paper_bgcolor: colour("card"), plot_bgcolor: colour("card"),
      margin: { l: narrow ? 44 : 56, r: narrow ? 8 : 34, t: 30, b: 40 }, height: height(plot),
      xaxis: { ...axis, title: { text: plot.x, standoff: 6 }, type: plot.log_x ? "log" : "linear", zeroline: plot.square,
        hoverformat: ".4~g", ticksuffix: unit(plot.x), showticksuffix: "last", ...decades(plot, "x") },
      yaxis: { ...axis, title: { text: plot.y, standoff: 4 }, type: plot.log_y ? "log" : "linear", zeroline: !plot.log_y,
        fixedrange: false, ...decades(plot, "y"), ...(plot.y_range ? { range: plot.y_range } : {}),
        ...(plot.square ? { scaleanchor: "x", scaleratio: 1 } : {}) },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1.02, yanchor: "bottom", font: { size: 12 }, bgcolor: "rgba(0,0,0,0)" },
      // Upright in the margin, where it covers neither lines nor legend.
      modebar: { orientation: "v", bgcolor: "rgba(0,0,0,0)", color: colour("sensor"), activecolor: colour("accent") },
      showlegend: plot.traces.length + plot.spans.length > 1, hovermode: plot.heat || plot.square ? "closest" : "x unified", bargap: 0.08,
      hoverlabel: { bgcolor: colour("card"), bordercolor: colour("line"), font: { color: colour("ink") } },
      shapes, annotations,
    };
  }

  function height(plot) {
    return plot.height + (narrow ? 40 : 0);
  }

  let following = false;
  function link(plot, element) {
    element.on("plotly_relayout", (event) => {
      if (following || !plot.group) return;
      const change = {};
      if ("xaxis.range[0]" in event) change["xaxis.range"] = [event["xaxis.range[0]"], event["xaxis.range[1]"]];
      else if ("xaxis.range" in event) change["xaxis.range"] = event["xaxis.range"];
      else if (event["xaxis.autorange"]) change["xaxis.autorange"] = true;
      else return;
      following = true;
      const others = plots.filter((p) => p !== plot && p.group === plot.group)
        .map((p) => Plotly.relayout("plot-" + p.id, change));
      Promise.all(others).finally(() => { following = false; });
    });
  }

  const settings = (plot) => ({ ...config, modeBarButtonsToAdd: plot.traces.length === 0 ? [] :
    [{ name: "csv", title: "Save what is drawn as CSV", icon: Plotly.Icons.disk, click: () => save(plot.id + ".csv", asCsv(plot)) }] });
  const draw = (act) => plots.forEach((plot) => act("plot-" + plot.id, lines(plot), layout(plot), settings(plot)));
  for (const plot of plots) {
    document.getElementById("plot-" + plot.id).style.height = height(plot) + "px";
  }
  for (const plot of plots) {
    link(plot, await Plotly.newPlot("plot-" + plot.id, lines(plot), layout(plot), settings(plot)));
    await pause();
  }
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", () => draw(Plotly.react));
  window.addEventListener("beforeprint", () => plots.forEach((plot) => Plotly.Plots.resize("plot-" + plot.id)));
})().catch((error) => {
  document.getElementById("undrawn").hidden = false;
  throw error;
});
