// The controls: each is a request to the bench, which answers or refuses it.
class Controls {
  constructor() {
    this.forms = document.getElementById("forms");
    this.answer = document.getElementById("answer");
  }

  // Asks, and says what became of it; whether it was done.
  async ask(control) {
    this.answer.className = "note";
    this.answer.textContent = "sent …";
    const reply = await this.post(control);
    this.told(reply);
    return reply.ok;
  }

  async post(control) {
    try {
      const reply = await fetch("control" + location.search, { method: "POST", headers: { "Content-Type": "application/json" },
        body: JSON.stringify(control) });
      return { ok: reply.ok, text: await reply.text() };
    } catch (error) {
      return { ok: false, text: "no answer: " + error.message };
    }
  }

  told({ ok, text }) {
    this.answer.className = "note";
    this.answer.textContent = text;
    this.answer.classList.add(ok ? "good" : "bad");
  }

  build(scene) {
    this.forms.replaceChildren();
    const kind = scene.controls.kind;
    document.getElementById("controls").hidden = kind === "nothing";
    if (kind === "bench") this.bench(scene);
    if (kind === "log") this.log();
  }

  bench(scene) {
    const { plant_closed: plant, controller_closed: controller } = scene.controls;
    const states = scene.states.map((state) => state.name);
    const unitOf = (name, key) => scene.states.find((state) => state.name === name)[key];
    const limitsOf = (name) => scene.states.find((state) => state.name === name).limits;
    const wanted = scene.outputs.map((output) => output.name).filter((name) => states.includes(name));
    const rates = states.filter((name) => name.endsWith("_rate"));

    this.form("Setpoint", controller, (form) => {
      const state = select("state", [...new Set([...wanted, ...states])]), value = input("value", "0"), unit = label();
      const show = () => {
        unit.textContent = unitOf(state.value, "unit");
        const limits = limitsOf(state.value);
        value.title = limits ? `${limits[0].toPrecision(3)} to ${limits[1].toPrecision(3)} ${unit.textContent}` : "";
      };
      state.addEventListener("change", show);
      form.append(state, value, unit, button("Set"));
      show();
      return () => ({ do: "set", what: `setpoint.${state.value}=${value.value} ${unit.textContent}`.trim() });
    });
    this.form("Gust", plant, (form) => {
      const state = select("state", [...new Set([...rates, ...states])]), size = input("size", "60"), unit = label();
      const length = input("length", "0.2"), seconds = label();
      seconds.textContent = "s";
      const show = () => { unit.textContent = unitOf(state.value, "derivative_unit"); };
      state.addEventListener("change", show);
      form.append(state, size, unit, length, seconds, button("Push"));
      show();
      return () => ({ do: "inject", what: `${state.value}=${size.value} ${unit.textContent}`, for_s: Number(length.value) });
    });
    this.form("Engine", plant, (form) => {
      const engine = select("engine", ["flying", "on", "off"]);
      form.append(engine, button("Set"));
      return () => ({ do: "set", what: `engine=${engine.value}` });
    });
    if (scene.effects.length) {
      this.form("Effect", plant, (form) => {
        const effect = document.createElement("select"), state = select("state", ["on", "off"]);
        effect.setAttribute("aria-label", "effect");
        effect.append(...scene.effects.map(({ number, text }) => new Option(text, number)));
        form.append(effect, state, button("Switch"));
        return () => ({ do: "set", what: `effect.${effect.value}=${state.value}` });
      });
    }
    this.form("Gain of the law", controller, (form) => {
      const gain = input("gain", "1");
      form.append(gain, button("Set"));
      return () => ({ do: "set", what: `gain=${gain.value}` });
    });
    this.form("Stick", controller, (form) => {
      this.stick = new StickControl(this, scene, form);
      return () => null;
    });
    this.form("Run", plant, (form) => {
      const stop = button("Stop the run");
      stop.classList.add("danger");
      form.append(stop);
      return () => (confirm("End the run?") ? { do: "stop" } : null);
    });
  }

  log() {
    this.form("Play", null, (form) => {
      this.place = input("place", "0");
      this.place.type = "range";
      Object.assign(this.place, { min: 0, max: 1, step: "any" });
      this.place.addEventListener("change", () => this.ask({ do: "play", key: "place", value: Number(this.place.value) }));
      this.halt = button("Halt");
      this.halt.type = "button";
      this.halt.addEventListener("click", () => this.ask({ do: "play", key: "paused", value: this.isHalted ? 0 : 1 }));
      const speed = input("speed", "1"), times = label();
      times.textContent = "× real time";
      form.append(this.place, this.halt, speed, times, button("Set"));
      return () => ({ do: "play", key: "speed", value: Number(speed.value) });
    });
  }

  // What the player says of itself.
  played(play) {
    if (!this.place) return;
    this.isHalted = play.paused;
    this.halt.textContent = play.paused ? "Resume" : "Halt";
    this.place.max = play.end_s;
    if (document.activeElement !== this.place) this.place.value = play.at_s;
  }

  form(title, closed, fill) {
    const form = document.createElement("form"), head = document.createElement("b");
    form.id = "form-" + title.split(" ")[0].toLowerCase();
    head.textContent = title;
    form.append(head);
    const request = fill(form);
    if (closed) {
      const why = document.createElement("span");
      why.className = "closed";
      why.textContent = closed;
      form.append(why);
      for (const element of form.elements) element.disabled = true;
    }
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      const control = request();
      if (control) this.ask(control);
    });
    this.forms.append(form);
  }
}

function select(name, values) {
  const element = document.createElement("select");
  element.setAttribute("aria-label", name);
  element.append(...values.map((value) => new Option(value, value)));
  return element;
}

function input(name, value) {
  const element = document.createElement("input");
  element.setAttribute("aria-label", name);
  element.inputMode = "decimal";
  element.value = value;
  return element;
}

function button(text) {
  const element = document.createElement("button");
  element.textContent = text;
  return element;
}

function label() {
  const element = document.createElement("span");
  element.className = "unit";
  return element;
}
