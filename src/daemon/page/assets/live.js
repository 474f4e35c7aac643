// A live play: a thing follows the pen, the wheel or the keys on the pad, and the daemon finds the pins' heights at each place. Meanwhile nothing is drawn on the pad.
//
// The page sends signs of life while its window is visible. When hidden, closed or hung it sends none, and the daemon ends the
// play.

import { order, Problem } from "./api.js";
import { $, refuse, say, speak } from "./control.js";
import { make } from "./pins.js";
import { FINE_STEP, HALF_LENGTH, HALF_WIDTH, KEY_STEP, penAt } from "./pad.js";

// The daemon ends the play after such a silence.
const TIMEOUT_MS = 1000;
const TURN_MS = 20;
const SIGN_MS = TIMEOUT_MS / 4;
// The most unanswered messages; the daemon refuses more than 32.
const MOST_UNANSWERED = 8;
const STEP_DEG = 5;
const KEYS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], q: [0, 0, 1], e: [0, 0, -1] };
const CAUSES = { stop: "Ended.", estop: "Ended: an emergency stop.", "client-silent": "Ended: the daemon heard nothing from this page for a second." };

const within = (value, most) => Math.min(most, Math.max(-most, value));

export class Live {
  #pad;
  #id;
  #request;
  #check;
  #thing;
  #ordered;
  #changed;
  #socket = null;
  #timer = 0;
  #pose = { x_mm: 0, y_mm: 0, angle_deg: 0 };
  // How deep the thing presses, µm.
  #depth = null;
  #isLifted = false;
  // Where the pen and the shape were when the pen came down.
  #grip = null;
  #seq = 0;
  #unanswered = 0;
  #applied = 0;
  #hasChanged = false;
  #sentAt = 0;
  #answeredAt = 0;
  #ended = null;
  #shape = make("g", { class: "live-shape" });

  // `pad`: where the shape moves. `id`: its buttons are `ID-start` and `ID-end`, and its line is `ID-note`. `request`: the body of the live
  // play, and null if there is none. `check`: whether its fields are right, and says which is not. `thing`: the shape as elements of SVG. `depth`: how deep an object presses now. `changed`: called when it
  // has begun or ended.
  constructor({ pad, id, request, check, thing, depth, changed }) {
    [this.#pad, this.#id, this.#request, this.#check, this.#thing, this.#ordered, this.#changed] = [pad, id, request, check, thing, depth, changed];
    const on = (place, event, run) => place.addEventListener(event, (event) => this.#isOpen && run(event));
    on(pad.svg, "pointerdown", (event) => this.#press(event));
    on(pad.svg, "pointermove", (event) => this.#drag(event));
    for (const event of ["pointerup", "pointercancel"]) on(pad.svg, event, () => (this.#grip = null));
    on(pad.svg, "wheel", (event) => (event.preventDefault(), this.#move([0, 0, -Math.sign(event.deltaY) * STEP_DEG])));
    on(pad.svg, "keydown", (event) => this.#key(event));
    $(`${id}-start`).addEventListener("click", () => this.#start());
    $(`${id}-end`).addEventListener("click", () => this.end());
    document.addEventListener("visibilitychange", () => document.hidden && this.end());
    pad.svg.append(this.#shape);
  }

  get #isOpen() {
    return this.#socket instanceof WebSocket;
  }

  // The changing line of the live play.
  #note(text) {
    $(`${this.#id}-note`).textContent = text;
    if (text) speak(text, "live");
  }

  buttons() {
    $(`${this.#id}-start`).disabled = this.#socket !== null || this.#pad.isTaken || !this.#request();
    $(`${this.#id}-end`).disabled = !this.#isOpen;
  }

  async #start() {
    if (!this.#check()) return;
    const request = this.#request();
    this.#socket = "asked";
    this.#pad.isTaken = true;
    this.#changed();
    this.#note("Starting …");
    try {
      const thing = this.#thing();
      const { path } = await order("/v1/live", { ...request, timeout_ms: TIMEOUT_MS, replace: true });
      this.#shape.replaceChildren(...thing);
      Object.assign(this.#pose, { x_mm: 0, y_mm: 0, angle_deg: 0 });
      this.#depth = request.object ? this.#ordered() : null;
      this.#isLifted = false;
      // An object touches from its first pose on.
      [this.#seq, this.#unanswered, this.#applied, this.#hasChanged, this.#sentAt, this.#ended] = [0, 0, 0, this.#depth !== null, 0, null];
      this.#open(new WebSocket(new URL(path, location.href.replace(/^http/, "ws"))));
      say($(`${this.#id}-start`), "");
    } catch (error) {
      this.#closed();
      this.#note("");
      refuse($(`${this.#id}-start`), error);
    }
    this.#changed();
  }

  #closed() {
    this.#socket = this.#grip = null;
    this.#pad.isTaken = false;
    this.#shape.replaceChildren();
  }

  #open(socket) {
    this.#socket = socket;
    socket.addEventListener("open", () => {
      this.#answeredAt = performance.now();
      if (document.hidden || !this.#pad.svg.checkVisibility()) this.end();
      this.#show();
      this.#pad.svg.scrollIntoView({ block: "nearest" });
      this.#pad.svg.focus({ focusVisible: false });
      this.#timer = setInterval(() => this.#turn(), TURN_MS);
    });
    socket.addEventListener("message", ({ data }) => this.#answered(JSON.parse(data)));
    socket.addEventListener("close", () => {
      clearInterval(this.#timer);
      this.#closed();
      this.#note(this.#ended === null ? "The connection is lost: the daemon ends the play." : (CAUSES[this.#ended] ?? `Ended: ${this.#ended}.`));
      this.#changed();
    });
  }

  // Sends the newest place, or a sign of life.
  #turn() {
    const now = performance.now();
    if (now - this.#answeredAt > TIMEOUT_MS) this.#note("No answer for a second: whether the play goes on is not known.");
    const isUpdate = this.#hasChanged && this.#unanswered < MOST_UNANSWERED;
    if (!isUpdate && now - this.#sentAt < SIGN_MS) return;
    if (isUpdate) this.#hasChanged = false;
    const depth = this.#depth === null ? {} : { depth_um: this.#isLifted ? 0 : this.#depth };
    this.#send(isUpdate ? { pose: { ...this.#pose, ...depth } } : {});
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
    if (problem) refuse($(`${this.#id}-start`), new Problem(problem.code, problem.detail));
    if (ended !== undefined) this.#ended = ended;
    else this.#show();
  }

  #show() {
    const { x_mm: x, y_mm: y, angle_deg: angle } = this.#pose;
    this.#shape.setAttribute("transform", `translate(${x} ${-y}) rotate(${-angle})`);
    const depth = this.#depth === null ? "" : this.#isLifted ? ", lifted" : `, pressed by ${this.#depth} µm`;
    this.#note(`At ${x.toFixed(1)}, ${y.toFixed(1)} mm, turned by ${angle.toFixed(0)}°${depth}; ${this.#applied} changes on the pins.`);
  }

  // Takes another depth, and lifts the object or presses it again.
  press(isLifted = this.#isLifted) {
    const depth = this.#ordered?.();
    if (this.#depth === null || Number.isNaN(depth)) return;
    [this.#depth, this.#isLifted, this.#hasChanged] = [depth, isLifted, true];
    this.#show();
  }

  #move([x, y, angle]) {
    const { x_mm, y_mm, angle_deg } = this.#pose;
    Object.assign(this.#pose, { x_mm: within(x_mm + x, HALF_WIDTH), y_mm: within(y_mm + y, HALF_LENGTH), angle_deg: angle_deg + angle });
    this.#hasChanged = true;
    this.#show();
  }

  #press(event) {
    if (event.button > 0) return;
    event.preventDefault();
    this.#pad.svg.focus({ focusVisible: false });
    this.#pad.svg.setPointerCapture(event.pointerId);
    this.#grip = { pen: penAt(this.#pad.svg, event), x_mm: this.#pose.x_mm, y_mm: this.#pose.y_mm };
  }

  #drag(event) {
    if (!this.#grip) return;
    const [x, y] = penAt(this.#pad.svg, event);
    const { pen, x_mm, y_mm } = this.#grip;
    this.#move([x_mm + x - pen[0] - this.#pose.x_mm, y_mm + y - pen[1] - this.#pose.y_mm, 0]);
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = KEYS[event.key.length > 1 ? event.key : event.key.toLowerCase()];
    if (event.key === "Escape") this.end();
    else if (event.key === " ") this.press(!this.#isLifted);
    else if (!step) return;
    else {
      const mm = event.shiftKey ? FINE_STEP : KEY_STEP;
      this.#move([mm * step[0], mm * step[1], STEP_DEG * step[2]]);
    }
    event.preventDefault();
  }
}
