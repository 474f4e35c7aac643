// The page: connects the daemon's events and status with the parts that show them. Events carry no state: they say when to request
// it.

import { call, known, last, listen, poll } from "./api.js";
import { array, loadArray } from "./array.js";
import { bindCalibration } from "./calibration.js";
import { bindControls, say, showControls, write } from "./control.js";
import { Designer } from "./designer.js";
import { bindDevice } from "./device.js";
import { bindDoctor } from "./doctor.js";
import { Finger, drivesAt } from "./finger.js";
import { Patterns } from "./patterns.js";
import { bindQueue } from "./queue.js";
import { bindReceipt } from "./receipt.js";
import { bindRecord } from "./record.js";
import { connected, disconnected, handleEvent, showStatus, startViews } from "./views.js";
import { plain } from "./words.js";

const $ = (id) => document.getElementById(id);
const FRAME_MS = 1000 / 30;

// The running play: its onset on this window's clock, and its pins once they are known.
let play = { id: null, onset: 0, pins: null };
const doubted = new Set();
const finger = new Finger($("finger"));
const patterns = new Patterns();
const designer = new Designer(() => patterns.refresh());

// Says what is wrong with the connection; nothing else stands there.
function alertConnection(text) {
  $("alert").hidden = !text;
  write($("alert"), text);
}

function showState() {
  const status = known();
  if (status) setPlay(status.play);
  showControls();
  showStatus();
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
    case "doubted":
      doubted.add(event.motor);
      break;
    case "connected":
      doubted.clear();
      poll();
      break;
    case "owner-silent":
      say($("arm"), `The daemon disarmed: it had no sign of ${event.by} for ${event.silence_s} s.`, "bad");
      poll();
      break;
    case "ended":
    case "session-started":
    case "session-ended":
    case "disconnected":
    case "queued":
      poll();
      break;
  }
  handleEvent(event);
}

let isLinked = false;
async function linked(is, problem) {
  isLinked = is;
  if (!is) {
    disconnected();
    alertConnection(plain(problem.message));
    return;
  }
  await poll();
  try {
    await loadArray();
  } catch (error) {
    alertConnection(plain(error.message));
    return;
  }
  // The connection may be lost again by now.
  if (!isLinked) return;
  alertConnection("");
  await connected();
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
  write($("finger-note"), note);
}

bindControls();
bindQueue();
bindReceipt();
bindRecord();
bindDevice();
bindDoctor();
bindCalibration();
startViews();
document.addEventListener("state", showState);
document.addEventListener("token", listen(handle, linked));
showState();
requestAnimationFrame(frame);
