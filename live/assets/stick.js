// The stick: armed first, then taken over; a pointer on the pad or the browser's gamepad moves it. It is said 20 times a second
// for as long as it is held; whoever falls silent gives it back to the law.
const STICK_MS = 50, DEAD_BAND = 0.08;

class StickControl {
  constructor(controls, scene, form) {
    Object.assign(this, { controls, names: scene.inputs.map((i) => i.name), at: [0, 0], more: [0, 0], hand: null, plugged: false });
    const [x, y = x] = this.names;
    this.x = select("horizontal input", this.names);
    this.y = select("vertical input", this.names);
    [this.x.value, this.y.value] = [x, y];
    this.share = select("maximum deflection", ["10 %", "25 %", "50 %", "100 %"]);
    this.share.value = "25 %";
    this.armed = document.createElement("input");
    Object.assign(this.armed, { type: "checkbox", id: "stick-armed" });
    const armed = document.createElement("label");
    armed.append(this.armed, " armed");
    this.take = button("Take over");
    this.take.type = "button";
    this.pad = document.createElement("div");
    this.pad.id = "stick-pad";
    this.knob = document.createElement("i");
    this.pad.append(this.knob);
    form.append(this.x, this.y, this.share, armed, this.take, this.pad);
    this.armed.addEventListener("change", () => (this.armed.checked ? this.show() : this.give()));
    this.take.addEventListener("click", () => (this.hand === null ? this.takeOver() : this.give()));
    for (const kind of ["pointerdown", "pointermove"]) this.pad.addEventListener(kind, (event) => this.drag(event));
    for (const kind of ["pointerup", "pointercancel"]) this.pad.addEventListener(kind, () => this.move([0, 0]));
    this.show();
  }

  drag(event) {
    if (!event.buttons) return;
    event.preventDefault();
    if (event.type === "pointerdown") this.pad.setPointerCapture(event.pointerId);
    const box = this.pad.getBoundingClientRect();
    const part = (at, from, length) => Math.max(-1, Math.min(1, (2 * (at - from)) / length - 1));
    this.move([part(event.clientX, box.left, box.width), -part(event.clientY, box.top, box.height)]);
    this.pointed = event.type !== "pointerup";
  }

  move(at) {
    this.at = at;
    this.pointed = at[0] !== 0 || at[1] !== 0;
    this.knob.style.left = `${50 + 50 * at[0]}%`;
    this.knob.style.top = `${50 - 50 * at[1]}%`;
  }

  // Right stick: the pad; left stick: the third and fourth input. A gamepad's axes point down. One that is unplugged lets go:
  // where it was last is nobody's wish.
  gamepad() {
    const pad = [...(navigator.getGamepads?.() ?? [])].find((p) => p?.connected);
    const gone = this.plugged && !pad;
    this.plugged = Boolean(pad);
    if (gone) this.give();
    if (!pad || this.pointed) return;
    const axis = (i) => (Math.abs(pad.axes[i] ?? 0) < DEAD_BAND ? 0 : pad.axes[i]);
    this.move([axis(2), -axis(3)]);
    this.pointed = false;
    this.more = [axis(0), -axis(1)];
  }

  deflections() {
    const share = parseFloat(this.share.value) / 100, at = {};
    const others = this.names.filter((name) => name !== this.x.value && name !== this.y.value);
    others.slice(0, 2).forEach((name, i) => { at[name] = share * this.more[i]; });
    at[this.y.value] = share * this.at[1];
    at[this.x.value] = share * this.at[0];
    return at;
  }

  async takeOver() {
    const hand = crypto.getRandomValues(new Uint32Array(1))[0] + 1;
    if (!(await this.controls.ask({ do: "take", hand }))) return;
    this.hand = hand;
    this.timer = setInterval(() => this.say(), STICK_MS);
    this.show();
  }

  async say() {
    this.gamepad();
    // One at a time: a slow network makes it coarser, not late.
    if (this.busy || this.hand === null) return;
    this.busy = true;
    const reply = await this.controls.post({ do: "stick", hand: this.hand, at: this.deflections() });
    this.busy = false;
    if (!reply.ok && this.hand !== null) {
      this.controls.told(reply);
      this.letGo();
    }
  }

  letGo() {
    clearInterval(this.timer);
    this.hand = null;
    this.armed.checked = false;
    this.move([0, 0]);
    this.show();
  }

  give() {
    const hand = this.hand;
    this.letGo();
    if (hand !== null) this.controls.ask({ do: "give", hand });
  }

  show() {
    this.take.disabled = !this.armed.checked;
    this.take.textContent = this.hand === null ? "Take over" : "Give back";
    this.pad.classList.toggle("held", this.hand !== null);
  }
}
