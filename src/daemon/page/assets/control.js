// Facts about the device, and the buttons that change its state.

import { call, headers, known, last, poll } from "./api.js";

const $ = (id) => document.getElementById(id);
const HOME_MS = 30000;
// This long after the window's last sign of life the daemon disarms the motors that the window has armed, s. While the window is
// visible, each poll is a sign of life.
const SILENCE_S = 10;
// The name of the play that calibrates.
export const CALIBRATION = "calibration";

// `late`: strokes of the running play.
export function show(late) {
  const status = known();
  $("arm").disabled = status?.state !== "disarmed";
  $("home").disabled = status?.state !== "armed" || status.play !== null;
  $("reset").disabled = status?.state !== "faulted";
  // The buttons that stop the pins work even while the state is not known.
  $("disarm").disabled = status !== null && status.state !== "armed";
  $("stop").disabled = status !== null && !status.play && !status.queued.length;
  // Keep the rows in place.
  const rows = last() ? describe(last(), late) : [];
  facts($("facts"), status ? rows : rows.map(([name]) => [name, "not known"]));
  write($("about"), status ? `meissner ${status.version}, pid ${status.pid}` : "");
}

function describe(status, late) {
  const offsets = status.motors.map((motor) => Math.abs(motor.rest_error_um));
  const worst = Math.max(0, ...offsets);
  const { fifo, mlock } = status.realtime ?? {};
  const limit = status.participant;
  const { by, silence_s: silence } = status.armed ?? {};
  return [
    ...(by ? [["Armed by", `${by}; ${silence === null ? "the motors stay armed without it" : `${silence} s without a sign of it disarm`}`]] : []),
    ["Largest offset from rest", `${worst.toFixed(1)} µm, pin ${offsets.indexOf(worst)}, of at most ${status.drift_limit_um} µm`],
    ["Array", status.array],
    ["Position", status.position],
    ["Clock", status.clock_uncertainty_us === null ? "not synchronised" : `synchronised to ±${status.clock_uncertainty_us.toFixed(1)} µs`],
    ["Real time", fifo && mlock ? "granted" : `missing: ${[fifo ? "" : "SCHED_FIFO", mlock ? "" : "locked memory"].filter(Boolean).join(" and ")}; strokes may come late`],
    ...(status.play ? [["Late strokes of this play", late || "none"]] : []),
    ["Emergency stops since the start", status.estops],
    ["Session", status.session ? `${status.session.participant}, ${status.session.plays} plays` : "none"],
    ["Vibration left", limit ? `${limit.continuous_left_s.toFixed(0)} s without a pause, ${limit.day_left_s.toFixed(0)} s today` : "not counted"],
    ...(status.missing ? [["Device", status.missing]] : []),
    ...(status.logbook_problem ? [["Session record", status.logbook_problem]] : []),
  ];
}

// An element of HTML.
export function element(name, text = "", more = {}) {
  return Object.assign(document.createElement(name), { textContent: text, ...more });
}

function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// Fills a list of facts; unchanged values are not touched, so that a screen reader does not read them again.
export function facts(list, rows) {
  while (list.children.length > 2 * rows.length) list.lastChild.remove();
  rows.forEach(([name, value], i) => {
    if (!list.children[2 * i]) list.append(document.createElement("dt"), document.createElement("dd"));
    write(list.children[2 * i], name);
    write(list.children[2 * i + 1], String(value));
  });
}

// Opens a dialog that leaves the emergency stop within reach: a modal one would not.
export function open(dialog) {
  dialog.show();
  dialog.querySelector("input:not([hidden]), button").focus();
  // The focus may have scrolled past the warning.
  dialog.scrollTop = 0;
}

export function closeWithEscape(dialog) {
  dialog.addEventListener("keydown", (event) => event.key === "Escape" && dialog.close("cancel"));
}

// Whether these fields are valid. If not, a line at the first invalid one says what is wrong, until it is changed.
export function valid(...ids) {
  return ids.map($).every((field) => {
    if (field.checkValidity()) return true;
    const { type, min, max, validationMessage } = field;
    const wrong = element("span", type === "number" && !field.validity.stepMismatch ? `Enter a number, ${min} to ${max}.` : validationMessage, { className: "wrong", role: "alert" });
    field.parentElement.querySelector(".wrong")?.remove();
    field.after(wrong);
    field.addEventListener("input", () => wrong.remove(), { once: true });
    field.focus();
    return false;
  });
}

export function bindControls(report) {
  const alive = new Worker("page/alive.js");
  document.addEventListener("visibilitychange", () => alive.postMessage(document.hidden ? headers() : null));
  const command = (path, body, ms) => call("POST", path, body, ms).then(
    () => (report(null), poll()),
    (error) => (report(error), poll()),
  );
  closeWithEscape($("arm-dialog"));
  closeWithEscape($("reset-dialog"));
  const button = (id, run) => $(id).addEventListener("click", run);
  button("disarm", () => command("/v1/disarm"));
  button("stop", () => command("/v1/stop"));
  button("home", () => command("/v1/home", undefined, HOME_MS));
  button("arm", () => {
    const isKnown = last().position === "known";
    $("arm-text").textContent = isKnown
      ? "The device knows where its pins are. Take the finger off the pins."
      : "The device does not know where its pins are. Look at them: all must be at rest.";
    $("arm-rest").hidden = $("arm-who").hidden = isKnown;
    $("arm-checked").required = $("arm-name").required = !isKnown;
    $("arm-dialog").returnValue = "";
    open($("arm-dialog"));
  });
  $("arm-dialog").addEventListener("close", () => {
    if ($("arm-dialog").returnValue !== "arm") return;
    // Send what the person has read: if the position is no longer known, the daemon refuses.
    const checked = $("arm-rest").hidden ? {} : { assume_rest: true, checked: $("arm-name").value };
    command("/v1/arm", { ...checked, silence_s: SILENCE_S }, HOME_MS);
    $("arm-checked").checked = false;
  });
  button("reset", () => {
    $("reset-why").textContent = `Cause: ${last().cause}.`;
    $("reset-dialog").returnValue = "";
    // A stop that comes while a person reads this dialog must not be cleared with the one that it shows.
    $("reset-dialog").dataset.seen = last().estops;
    open($("reset-dialog"));
  });
  $("reset-dialog").addEventListener("close", () => {
    if ($("reset-dialog").returnValue !== "reset") return;
    command("/v1/reset", { force: true, estops_seen: Number($("reset-dialog").dataset.seen) });
  });
}
