// A live play: the target's shape follows the pen, the wheel or the keys, and the daemon finds the drives at each place.
//
// The page sends signs of life while its window is visible. When hidden, closed or hung it sends none, and the daemon ends the
// play.

import { order } from "./api.js";
import { refuse, say, speak, valid } from "./control.js";
import { make } from "./finger.js";
import { arrange, drawing, FINE_STEP, HALF_LENGTH, HALF_WIDTH, KEY_STEP, line, penAt } from "./pad.js";

const $ = (id) => document.getElementById(id);
// The daemon ends the play after such a silence.
const TIMEOUT_MS = 1000;
const TURN_MS = 20;
const SIGN_MS = TIMEOUT_MS / 4;
// The most unanswered messages; the daemon refuses more than 32.
const MOST_UNANSWERED = 8;
const STEP_DEG = 5;
const KEYS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], q: [0, 0, 1], e: [0, 0, -1] };
const CAUSES = { stop: "Ended.", estop: "Ended: an emergency stop.", "client-silent": "Ended: the daemon heard nothing from this page for a second." };

// The changing line of the live play.
function note(text) {
  $("live-note").textContent = text;
  if (text) speak(text, "live");
}

const within = (value, most) => Math.min(most, Math.max(-most, value));

export class Live {
  #request;
  #outline;
  #socket = null;
  #timer = 0;
  #pose = { x_mm: 0, y_mm: 0, angle_deg: 0 };
  // Where the pen and the shape were when the pen came down.
  #grip = null;
  #seq = 0;
  #unanswered = 0;
  #applied = 0;
  #changed = false;
  #sentAt = 0;
  #answeredAt = 0;
  #ended = null;
  #shape = make("g", { class: "live-shape" });

  // `request`: the live play's target and settings; null if there is none. `outline`: the lines of its shape.
  constructor(request, outline) {
    [this.#request, this.#outline] = [request, outline];
    this.svg = drawing("");
    this.svg.append(this.#shape);
    for (const [name, value] of [["role", "application"], ["tabindex", "0"], ["aria-label", "Move the shape"], ["aria-describedby", "live-help"]]) this.svg.setAttribute(name, value);
    const on = (place, event, run) => place.addEventListener(event, run);
    on(this.svg, "pointerdown", (event) => this.#press(event));
    on(this.svg, "pointermove", (event) => this.#drag(event));
    for (const event of ["pointerup", "pointercancel"]) on(this.svg, event, () => (this.#grip = null));
    on(this.svg, "wheel", (event) => (event.preventDefault(), this.#move([0, 0, -Math.sign(event.deltaY) * STEP_DEG])));
    on(this.svg, "keydown", (event) => this.#key(event));
    on($("live-start"), "click", () => this.#start());
    on($("live-end"), "click", () => this.end());
    on(document, "array", () => arrange(this.svg));
    on(document, "visibilitychange", () => document.hidden && this.end());
    $("live-pad").append(this.svg);
    this.buttons();
  }

  buttons() {
    $("live-start").disabled = this.#socket !== null || !this.#request();
    const isOpen = this.#socket instanceof WebSocket;
    $("live-end").disabled = !isOpen;
    $("live-pad").hidden = !isOpen;
  }

  async #start() {
    if (!valid("target-name", "reach", "amplitude")) return;
    this.#socket = "asked";
    this.buttons();
    note("Starting …");
    try {
      const lines = this.#outline();
      const { path } = await order("/v1/live", { ...this.#request(), timeout_ms: TIMEOUT_MS, replace: true });
      this.#shape.replaceChildren(...lines.map(line));
      Object.assign(this.#pose, { x_mm: 0, y_mm: 0, angle_deg: 0 });
      [this.#seq, this.#unanswered, this.#applied, this.#changed, this.#sentAt, this.#ended] = [0, 0, 0, false, 0, null];
      this.#open(new WebSocket(new URL(path, location.href.replace(/^http/, "ws"))));
      say($("live-start"), "");
    } catch (error) {
      this.#socket = null;
      note("");
      refuse($("live-start"), error);
    }
    this.buttons();
  }

  #open(socket) {
    this.#socket = socket;
    socket.addEventListener("open", () => {
      this.#answeredAt = performance.now();
      if (document.hidden) this.end();
      this.#show();
      this.svg.focus({ focusVisible: false });
      this.#timer = setInterval(() => this.#turn(), TURN_MS);
    });
    socket.addEventListener("message", ({ data }) => this.#answered(JSON.parse(data)));
    socket.addEventListener("close", () => {
      clearInterval(this.#timer);
      this.#socket = this.#grip = null;
      note(this.#ended === null ? "The connection is lost: the daemon ends the play." : (CAUSES[this.#ended] ?? `Ended: ${this.#ended}.`));
      this.buttons();
    });
  }

  // Sends the newest place, or a sign of life.
  #turn() {
    const now = performance.now();
    if (now - this.#answeredAt > TIMEOUT_MS) note("No answer for a second: whether the play goes on is not known.");
    const isUpdate = this.#changed && this.#unanswered < MOST_UNANSWERED;
    if (!isUpdate && now - this.#sentAt < SIGN_MS) return;
    if (isUpdate) this.#changed = false;
    this.#send(isUpdate ? { pose: this.#pose } : {});
    this.#sentAt = now;
  }

  #send(message) {
    if (this.#socket?.readyState !== WebSocket.OPEN) return;
    this.#seq += 1;
    this.#unanswered += 1;
    this.#socket.send(JSON.stringify({ seq: this.#seq, ...message }));
  }

  end() {
    this.#send({ end: true });
  }

  #answered({ applied, problem, ended }) {
    this.#unanswered -= 1;
    this.#answeredAt = performance.now();
    if (applied?.ticks.some((tick) => tick !== null)) this.#applied += 1;
    if (problem) refuse($("live-start"), new Error(problem.detail));
    if (ended !== undefined) this.#ended = ended;
    else this.#show();
  }

  #show() {
    const { x_mm: x, y_mm: y, angle_deg: angle } = this.#pose;
    this.#shape.setAttribute("transform", `translate(${x} ${-y}) rotate(${-angle})`);
    note(`At ${x.toFixed(1)}, ${y.toFixed(1)} mm, turned by ${angle.toFixed(0)}°; ${this.#applied} changes on the pins.`);
  }

  #move([x, y, angle]) {
    if (!this.#socket) return;
    const { x_mm, y_mm, angle_deg } = this.#pose;
    Object.assign(this.#pose, { x_mm: within(x_mm + x, HALF_WIDTH), y_mm: within(y_mm + y, HALF_LENGTH), angle_deg: angle_deg + angle });
    this.#changed = true;
    this.#show();
  }

  #press(event) {
    if (event.button > 0) return;
    event.preventDefault();
    this.svg.focus({ focusVisible: false });
    this.svg.setPointerCapture(event.pointerId);
    this.#grip = { pen: penAt(this.svg, event), x_mm: this.#pose.x_mm, y_mm: this.#pose.y_mm };
  }

  #drag(event) {
    if (!this.#grip) return;
    const [x, y] = penAt(this.svg, event);
    const { pen, x_mm, y_mm } = this.#grip;
    this.#move([x_mm + x - pen[0] - this.#pose.x_mm, y_mm + y - pen[1] - this.#pose.y_mm, 0]);
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = KEYS[event.key.length > 1 ? event.key : event.key.toLowerCase()];
    if (event.key === "Escape") this.end();
    else if (!step) return;
    else {
      const mm = event.shiftKey ? FINE_STEP : KEY_STEP;
      this.#move([mm * step[0], mm * step[1], STEP_DEG * step[2]]);
    }
    event.preventDefault();
  }
}
