// The page: takes frames in as they come, and shows them a few times a second.
const DRAW_MS = 200, KEPT_S = 60, KEPT_WHILE_HELD_S = 1800, SILENT_MS = 3000;

// What part of the time axis is shown: the last seconds, or what somebody holds.
class View {
  constructor(store) {
    this.store = store;
    this.held = null;
    this.seconds = 20;
  }

  range() {
    if (this.held) return this.held;
    const until = Math.max(this.store.last, this.seconds);
    return [until - this.seconds, until];
  }

  hold(range) {
    this.held = range ?? this.range();
    show("follow", true);
    document.getElementById("pause").textContent = "Paused";
  }

  follow() {
    this.held = null;
    show("follow", false);
    document.getElementById("pause").textContent = "Pause";
  }
}

function show(id, is) {
  document.getElementById(id).hidden = !is;
}

function text(id, words) {
  const element = document.getElementById(id);
  if (element.textContent !== words) element.textContent = words;
}

const store = new Store(), view = new View(store), plots = new Plots(store, view), horizon = new Horizon(store), controls = new Controls();
let scene = null, over = null, missed = 0, lost = 0, thinned = 1, came = 0, eventsShown = [];
const pace = [];

function take(message) {
  came = performance.now();
  if (message.scene) return begin(message);
  if (message.missed) {
    missed += message.missed;
    return;
  }
  if (message.over !== undefined) {
    over = message.over;
    return;
  }
  if (message.anew) [store.clear(), pace.splice(0)];
  store.append(message.rows, message.events ?? []);
  lost = message.lost;
  if (message.rows.step.length) {
    thinned = message.rows.thinned;
    pace.push([message.wall_s, store.last]);
    while (pace.length > 2 && message.wall_s - pace[0][0] > 3) pace.shift();
  }
  if (message.events) eventsShown = message.events.concat().reverse().concat(eventsShown).slice(0, 200);
  if (message.anew) eventsShown = message.events ?? [];
  if (message.nodes) nodes(message.nodes);
  if (message.play) controls.played(message.play);
  store.forget(view.held ? KEPT_WHILE_HELD_S : KEPT_S + 5);
}

function begin(message) {
  scene = message.scene;
  [over, missed, eventsShown] = [null, 0, []];
  store.begin(message.columns, scene.period_s);
  text("title", scene.title);
  text("subtitle", scene.subtitle);
  document.title = scene.title + " · Whirlstand live";
  plots.build(scene);
  horizon.build(scene);
  controls.build(scene);
}

function nodes(list) {
  const body = document.getElementById("nodes");
  const figure = (value, unit = "") => (value === null || value === undefined ? "–" : value.toLocaleString("en", { maximumFractionDigits: 1 }) + unit);
  body.replaceChildren(...list.map((node) => {
    const row = document.createElement("tr");
    row.dataset.node = node.node;
    const cells = [node.state, figure(node.steps), figure(node.misses), figure(node.lost), figure(node.rejected), figure(node.restarts),
      figure(node.cpu_percent, " %"), figure(node.median_us, " us"), figure(node.p99_us, " us"), figure(node.max_us, " us")];
    const head = document.createElement("th");
    head.textContent = node.node;
    row.append(head, ...cells.map((words, i) => {
      const cell = document.createElement("td");
      cell.className = i ? "figure" : node.state === "running" ? "good" : "warn";
      if (i > 0 && i < 6 && i !== 1 && words !== "0") cell.classList.add("warn");
      cell.textContent = words;
      return cell;
    }));
    const cell = document.createElement("td");
    cell.append(bars(node.latency));
    row.append(cell);
    return row;
  }));
}

// A histogram of latencies; counts on a root scale, so that rare late ones are seen beside the many.
function bars(counts) {
  const most = Math.max(1, ...counts), width = 4, height = 22, space = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(space, "svg");
  svg.setAttribute("class", "bars");
  svg.setAttribute("width", counts.length * width);
  svg.setAttribute("height", height);
  counts.forEach((count, i) => {
    if (!count) return;
    const rect = document.createElementNS(space, "rect"), size = Math.max(1, Math.sqrt(count / most) * height);
    for (const [name, value] of Object.entries({ x: i * width, y: height - size, width: width - 1, height: size })) rect.setAttribute(name, value);
    svg.append(rect);
  });
  return svg;
}

function status() {
  const silent = performance.now() - came > SILENT_MS;
  const state = document.getElementById("state");
  const [words, kind] = over !== null ? ["over", "warn"] : !scene ? ["connecting", ""] : silent ? ["no connection", "bad"]
    : store.t.length === 0 ? ["waiting for the bench", "warn"] : ["flying", "good"];
  text("state", words);
  state.className = "chip " + kind;
  text("time", store.t.length ? `t ${store.last.toFixed(2)} s` : "");
  const [first, last] = [pace[0], pace[pace.length - 1]];
  const speed = pace.length > 2 ? (last[1] - first[1]) / (last[0] - first[0]) : 0;
  const parts = [];
  if (speed > 0) parts.push(speed > 0.95 && speed < 1.05 ? "real time" : speed.toPrecision(2) + " × real time");
  if (thinned > 1.01) parts.push(`one row per ${thinned.toFixed(0)} steps`);
  text("pace", parts.join(", "));
  const notices = [];
  if (over) notices.push(over);
  if (missed) notices.push(`This page was too slow for ${missed} frames, which are missing from the plots; the log has everything.`);
  if (lost) notices.push(`${lost} messages came faster than they could be shown; the log has everything.`);
  text("notice", notices.join(" "));
  show("notice", notices.length > 0);
  Object.assign(document.body.dataset, { state: words, rows: store.t.length, t: store.last, missed, events: eventsShown.length });
}

function events() {
  const list = document.getElementById("events"), key = `${eventsShown.length} ${eventsShown[0]?.t} ${eventsShown[0]?.text}`;
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...eventsShown.map((event) => {
    const row = document.createElement("li"), time = document.createElement("span"), words = document.createElement("div");
    row.className = event.kind;
    time.textContent = event.t.toFixed(2) + " s";
    words.textContent = event.text;
    row.append(time, words);
    return row;
  }));
}

function draw() {
  status();
  if (!scene || document.hidden) return;
  events();
  horizon.draw();
}

async function start() {
  const bytes = Uint8Array.from(atob(document.getElementById("plotly").textContent), (c) => c.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(plain).text();
  document.head.append(script);

  document.getElementById("pause").addEventListener("click", () => (view.held ? view.follow() : view.hold()));
  document.getElementById("follow").addEventListener("click", () => { plots.release(); view.follow(); });
  document.getElementById("window").addEventListener("change", (event) => { view.seconds = Number(event.target.value); });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plots.redraw());
  const source = new EventSource("events" + location.search);
  source.onmessage = (event) => take(JSON.parse(event.data));
  // After the end there is nobody to ask again.
  source.onerror = () => { if (over !== null) source.close(); };
  // A timer instead of the screen's own pace: a few times a second is enough to see, and leaves the processors to the bench.
  setInterval(draw, DRAW_MS);
  plots.run(DRAW_MS);
}

start().catch((error) => {
  show("undrawn", true);
  throw error;
});
