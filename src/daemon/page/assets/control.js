// The state in words, facts about the device, and the buttons that change it.

import { call } from "./api.js";

const $ = (id) => document.getElementById(id);
const HOME_MS = 30000;
// The name of the play that calibrates.
export const CALIBRATION = "calibration";

// What a state means to a person with a finger on the pins.
const STATES = {
  disarmed: ["Disarmed", "Safe to touch: the motors are off."],
  armed: ["Armed", "The motors are on: a play may begin at any moment."],
  returning: ["Returning", "Pins move to rest. Do not touch."],
  faulted: ["Stopped", "All lines are off. Find out why before you reset."],
  "no-device": ["No device", "No device is connected: the pins are not under control."],
  unknown: ["Not connected", "The state is not known: the page does not reach the daemon."],
};

export function show(now) {
  const { status } = now;
  const name = status?.state in STATES ? status.state : "unknown";
  const [word, touch] = STATES[name];
  const shown = status?.play ? "playing" : name;
  $("state").dataset.state = shown;
  const text = status?.play ? `Playing ${status.play.pattern}, ${status.play.played_s.toFixed(1)} s` : name === "faulted" ? `Stopped: ${status.cause}` : word;
  write($("state-text"), text);
  write($("touch"), !status?.play ? touch : status.play.pattern === CALIBRATION ? "Calibration: do not touch the pins." : "Pins vibrate.");
  const device = status?.device;
  write($("link"), device ? `${device.kind}${device.simulated ? ", simulated" : ""}` : "");
  $("arm").disabled = !(status && name === "disarmed");
  $("disarm").disabled = !(status && name === "armed");
  $("home").disabled = !(status && name === "armed" && !status.play);
  $("stop").disabled = !(status && (status.play || status.queued.length));
  $("reset").disabled = !(status && name === "faulted");
  facts($("facts"), status ? describe(status, now.late) : []);
  write($("about"), status ? `meissner ${status.version}, pid ${status.pid}` : "");
}

function describe(status, late) {
  const offsets = status.motors.map((motor) => Math.abs(motor.rest_error_um));
  const worst = Math.max(0, ...offsets);
  const { fifo, mlock } = status.realtime ?? {};
  const limit = status.participant;
  return [
    ["Largest offset from rest", `${worst.toFixed(1)} µm, pin ${offsets.indexOf(worst)}, of at most ${status.drift_limit_um} µm`],
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

export function bindControls(now, report, poll) {
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
    const known = now.status?.position === "known";
    $("arm-text").textContent = known
      ? "The device knows where its pins are. Take the finger off the pins."
      : "The device does not know where its pins are. Look at them: all must be at rest.";
    $("arm-rest").hidden = $("arm-who").hidden = known;
    $("arm-checked").required = $("arm-name").required = !known;
    $("arm-dialog").returnValue = "";
    open($("arm-dialog"));
  });
  $("arm-dialog").addEventListener("close", () => {
    if ($("arm-dialog").returnValue !== "arm") return;
    const known = now.status?.position === "known";
    command("/v1/arm", known ? {} : { assume_rest: true, checked: $("arm-name").value }, HOME_MS);
    $("arm-checked").checked = false;
  });
  button("reset", () => {
    $("reset-why").textContent = `Cause: ${now.status?.cause ?? "unknown"}.`;
    $("reset-dialog").returnValue = "";
    // A stop that comes while a person reads this is not cleared with the one that it is about.
    $("reset-dialog").dataset.seen = now.status?.estops ?? 0;
    open($("reset-dialog"));
  });
  $("reset-dialog").addEventListener("close", () => {
    if ($("reset-dialog").returnValue !== "reset") return;
    command("/v1/reset", { force: true, estops_seen: Number($("reset-dialog").dataset.seen) });
  });
}
