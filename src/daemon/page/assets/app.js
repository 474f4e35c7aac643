// The page: connects the daemon's events and status with the parts that show them. Events carry no state: they say when to request
// it.

import { call, known, last, listen, poll } from "./api.js";
import { array, loadArray } from "./array.js";
import { bindCalibration, handleCalibrated, loadAfterGap, loadCalibration, showCalibrating } from "./calibration.js";
import { bindControls, show as showControl } from "./control.js";
import { Designer } from "./designer.js";
import { bindDoctor, checkSoon } from "./doctor.js";
import { Finger, drivesAt } from "./finger.js";
import { Patterns } from "./patterns.js";
import { loadSessions, showReceipt } from "./record.js";

const $ = (id) => document.getElementById(id);
const FRAME_MS = 1000 / 30;

// The running play: its onset on this window's clock, and its pins once they are known.
let play = { id: null, onset: 0, pins: null };
// Late strokes, by play.
const late = new Map();
const doubted = new Set();
const finger = new Finger($("finger"));
const patterns = new Patterns(report);
const designer = new Designer(report, () => patterns.load());

// Shows an error in one line; none clears it.
function report(error) {
  $("alert").hidden = !error;
  $("alert").textContent = error ? error.message : "";
}

let checked = null;
function showState() {
  const status = known();
  if (status && status.state !== checked) checkSoon();
  if (status) checked = status.state;
  if (status) setPlay(status.play);
  showControl(late.get(status?.play?.id) ?? 0);
  showCalibrating();
  patterns.showQueue();
}

async function setPlay(running) {
  const id = running?.id ?? null;
  const onset = performance.now() - 1000 * (running?.played_s ?? 0);
  if (play.id === id) {
    // Messages arrive with a delay, so the earliest onset is the most accurate.
    play.onset = Math.min(play.onset, onset);
    return;
  }
  const mine = (play = { id, onset, pins: null });
  if (id === null) return;
  try {
    mine.pins = await pinsOf(running);
  } catch ({ code }) {
    // The connection failed: the next state requests it again.
    if (["unreachable", "slow", "stopped"].includes(code)) mine.id = undefined;
  }
}

// A play's pins as the daemon compiled it: its receipt has the amplitudes, the pattern the times. Null: a sequence, a live play, a pattern of
// another array that was mapped by position, or one that is gone or has changed.
async function pinsOf({ id, pattern }) {
  const receipt = await call("GET", `/v1/plays/${id}`);
  if (receipt.mapped_from !== null) return null;
  const details = designer.details(receipt.pattern_sha256) ?? (await call("GET", `/v1/patterns/${encodeURIComponent(pattern)}`));
  if (details.sha256 !== receipt.pattern_sha256 || receipt.items_planned !== null) return null;
  // A receipt lists only the first drives.
  const listed = receipt.drives;
  const scaled = details.drives.slice(listed.length).map((drive) => ({ ...drive, reached_um: drive.reached_um * (receipt.scale ?? 1) }));
  return { pattern: details.pattern, reached: [...listed, ...scaled] };
}

function handle(event) {
  switch (event.event) {
    case "state": {
      const { state, position, play: running } = last() ?? {};
      if (event.state !== state || event.position !== position || event.play?.id !== running?.id) poll();
      break;
    }
    case "ended":
      late.delete(event.receipt.id);
      showReceipt(event.receipt);
      poll();
      break;
    case "felt":
      call("GET", `/v1/plays/${event.id}`).then(showReceipt, () => {});
      break;
    case "late":
      late.set(event.id, (late.get(event.id) ?? 0) + 1);
      break;
    case "doubted":
      doubted.add(event.motor);
      break;
    case "connected":
      doubted.clear();
      loadCalibration().catch(report);
      checkSoon();
      poll();
      break;
    case "session-started":
    case "session-ended":
      loadSessions().catch(report);
      poll();
      break;
    case "owner-silent":
      report(new Error(`The daemon disarmed: it had no sign of ${event.by} for ${event.silence_s} s.`));
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

let isLinked = false;
async function linked(is, problem) {
  const again = isLinked;
  isLinked = is;
  if (!is) {
    report(problem);
    return;
  }
  // After an emergency stop the stream begins again; keep the errors that the daemon has sent since.
  if (!again) report(null);
  checkSoon();
  await poll();
  const arrayKnown = await loadArray().then(() => true, report);
  if (!arrayKnown) return;
  const loads = [patterns.load(), designer.start(), loadSessions(), loadAfterGap(), call("GET", "/v1/plays/last").then(showReceipt, () => {})];
  await Promise.all(loads).catch(report);
}

function pinRows(pins, rest) {
  const motors = last()?.motors ?? [];
  $("pins").tBodies[0].replaceChildren(...motors.map((motor, i) => {
    const drive = pins?.get(i);
    const row = document.createElement("tr");
    const cells = [drive?.reached_um.toFixed(1) ?? (pins ? "still" : "not known"), drive?.frequency_hz ?? "", drive?.phase ?? "", rest[i]?.toFixed(1) ?? "not known", motor.source];
    const head = Object.assign(document.createElement("th"), { scope: "row", textContent: String(i) });
    row.append(head, ...cells.map((text) => Object.assign(document.createElement("td"), { textContent: String(text) })));
    return row;
  }));
}

// The drives by pin, or null and why they are not known.
function pinsNow(status, seconds) {
  if (!status || !array()) return [null, "What the pins do is not known."];
  if (status.play) return play.pins ? [drivesAt(play.pins, seconds), ""] : [null, "Pins vibrate. Which ones is not known here."];
  const isStill = status.tick !== null && ["disarmed", "armed", "faulted"].includes(status.state);
  return isStill ? [new Map(), ""] : [null, "Pins may move. Which ones is not known."];
}

let drawn = 0;
let tabled = 0;
function frame(at) {
  requestAnimationFrame(frame);
  if (at - drawn < FRAME_MS - 2) return;
  drawn = at;
  const status = known();
  const seconds = Math.max(0, (performance.now() - play.onset) / 1000);
  const [pins, why] = pinsNow(status, seconds);
  const rest = (status?.motors ?? []).map((motor) => motor.rest_error_um);
  finger.draw(pins, why, rest, doubted, seconds);
  if (at - tabled > 1000 && $("pins").closest("details").open) {
    tabled = at;
    pinRows(pins, rest);
  }
  const note = pins ? "Size and colour: amplitude reached. Hand: phase, drawn 20 times slower. Bar on the left of a pin: offset from rest. Dashed ring: sensor in doubt." : why;
  if ($("finger-note").textContent !== note) $("finger-note").textContent = note;
}

bindControls(report);
bindCalibration(report);
bindDoctor();
document.addEventListener("state", showState);
document.addEventListener("token", listen(handle, linked));
showState();
requestAnimationFrame(frame);
