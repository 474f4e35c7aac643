// The page: joins the daemon's events and status with the parts that show them.

import { Problem, call, listen, token } from "./api.js";
import { bindCalibration, handleCalibrated, loadAfterGap, loadCalibration, showCalibrating } from "./calibration.js";
import { bindControls, show as showControl } from "./control.js";
import { Designer } from "./designer.js";
import { bindDoctor, checkSoon } from "./doctor.js";
import { Finger, drivesAt } from "./finger.js";
import { Patterns } from "./patterns.js";
import { loadSessions, showReceipt } from "./record.js";

const $ = (id) => document.getElementById(id);
const STATUS_MS = 1000;
const FRAME_MS = 1000 / 30;

const now = { linked: false, state: null, status: null, play: null, details: null, onset: 0, late: 0, doubted: new Set() };
const finger = new Finger($("finger"));
const patterns = new Patterns(report);
const designer = new Designer(report, () => patterns.load());

// Shows an error in one line; none clears it.
function report(error) {
  $("alert").hidden = !error;
  $("alert").textContent = error ? error.message : "";
  if (error?.code === "unauthorized") $("sign-in").hidden = false;
}

function showStatus() {
  showControl(now);
  showCalibrating(now.status);
}

async function poll() {
  if (document.hidden || !now.linked) return;
  try {
    now.status = await call("GET", "/v1/status");
    setPlay(now.status.play);
    patterns.showQueue(now.status);
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    if (error.code === "stopped") return;
    now.status = null;
  }
  showStatus();
}

// A play's pins as the daemon compiled it: its receipt has the amplitudes, the pattern the times.
async function setPlay(play) {
  if (!play) {
    now.play = now.details = null;
    return;
  }
  const onset = performance.now() - 1000 * play.played_s;
  if (now.play?.id === play.id) {
    // News travels with a delay: the earliest onset is the truest.
    now.onset = Math.min(now.onset, onset);
    return;
  }
  [now.play, now.onset, now.details, now.late] = [play, onset, null, 0];
  try {
    const receipt = await call("GET", `/v1/plays/${play.id}`);
    const details = designer.details(receipt.pattern_sha256) ?? (await patterns.details(play.pattern));
    if (now.play?.id === play.id) now.details = receipt.drives.length ? { ...details, drives: receipt.drives } : details;
  } catch {
    // A sequence, or a pattern that is gone: the play goes on, and its pins are not known here.
  }
}

function handle(event) {
  switch (event.event) {
    case "state":
      if (event.state !== now.state) checkSoon();
      now.state = event.state;
      if (now.status) Object.assign(now.status, { state: event.state, cause: event.cause, position: event.position, play: event.play });
      setPlay(event.play);
      showStatus();
      break;
    case "ended":
      showReceipt(event.receipt);
      poll();
      break;
    case "felt":
      call("GET", `/v1/plays/${event.id}`).then(showReceipt, () => {});
      break;
    case "late":
      if (event.id === now.play?.id) now.late += 1;
      break;
    case "doubted":
      now.doubted.add(event.motor);
      break;
    case "connected":
      now.doubted.clear();
      loadCalibration().catch(report);
      checkSoon();
      poll();
      break;
    case "session-started":
    case "session-ended":
      loadSessions().catch(report);
      poll();
      break;
    case "search":
      designer.handle(event);
      break;
    case "calibrated":
      handleCalibrated(event).catch(report);
      break;
    case "disconnected":
      checkSoon();
      poll();
      break;
    case "queued":
      poll();
      break;
  }
}

async function linked(is, problem) {
  const again = now.linked;
  [now.linked, now.state] = [is, null];
  if (!is) {
    now.status = null;
    showStatus();
    report(problem);
    return;
  }
  // After an emergency stop the stream begins again: what the daemon has refused since stays.
  if (!again) report(null);
  $("sign-in").hidden = true;
  await poll();
  const loads = [patterns.load(), designer.start(), loadSessions(), loadAfterGap(now.status), call("GET", "/v1/plays/last").then(showReceipt, () => {})];
  await Promise.all(loads).catch(report);
}

function pinRows(drives, rest) {
  const motors = now.status?.motors ?? [];
  $("pins").tBodies[0].replaceChildren(...motors.map((motor, i) => {
    const drive = drives.get(i);
    const row = document.createElement("tr");
    const cells = [drive?.reached_um.toFixed(1) ?? "still", drive?.frequency_hz ?? "", drive?.phase ?? "", rest[i].toFixed(1), motor.source];
    const head = Object.assign(document.createElement("th"), { scope: "row", textContent: String(i) });
    row.append(head, ...cells.map((text) => Object.assign(document.createElement("td"), { textContent: String(text) })));
    return row;
  }));
}

let drawn = 0;
let tabled = 0;
function frame(at) {
  requestAnimationFrame(frame);
  if (at - drawn < FRAME_MS - 2) return;
  drawn = at;
  const seconds = now.play ? Math.max(0, (performance.now() - now.onset) / 1000) : null;
  const drives = now.details ? drivesAt(now.details, seconds) : new Map();
  const rest = (now.status?.motors ?? []).map((motor) => motor.rest_error_um);
  finger.draw(drives, rest, now.doubted, seconds);
  if (at - tabled > 1000 && $("pins").closest("details").open) {
    tabled = at;
    pinRows(drives, rest);
  }
  const unknown = now.play && !now.details ? "The pins of this play are not known here. " : "";
  const note = `${unknown}Size and colour: amplitude reached. Hand: phase, drawn 20 times slower. Bar on the left of a pin: offset from rest. Dashed ring: sensor in doubt.`;
  if ($("finger-note").textContent !== note) $("finger-note").textContent = note;
}

bindControls(now, report, poll);
bindCalibration(report, poll);
bindDoctor();
const start = listen(handle, linked);
$("sign-in-form").addEventListener("submit", (event) => {
  event.preventDefault();
  token.set($("token").value.trim());
  $("token").value = "";
  start();
});
showStatus();
setInterval(poll, STATUS_MS);
requestAnimationFrame(frame);
