// The page: connects the daemon's events and status with the parts that show them. Events carry no state: they say when to request
// it.

import { call, known, last, listen, poll } from "./api.js";
import { loadArray } from "./array.js";
import { bindCalibration } from "./calibration.js";
import { bindControls, element, say, showControls, write } from "./control.js";
import { Designer } from "./designer.js";
import { bindDevice } from "./device.js";
import { bindDoctor } from "./doctor.js";
import { bindFiles } from "./files.js";
import { bindEvents } from "./events.js";
import { FULL_UM, Finger, drivesAt, gradient, movement } from "./finger.js";
import { bindNumbers } from "./number.js";
import { Patterns } from "./patterns.js";
import { bindPinTest } from "./pin-test.js";
import { bindQueue } from "./queue.js";
import { bindReceipt } from "./receipt.js";
import { bindRecord } from "./record.js";
import { connected, disconnected, handleEvent, showStatus, startViews } from "./views.js";
import { SENSOR_FAULTS, plain } from "./words.js";

const $ = (id) => document.getElementById(id);
const FRAME_MS = 1000 / 30;

// The running play: its onset on this window's clock, and its pattern once that is known.
let play = { id: null, onset: 0, pattern: null };
const finger = new Finger($("finger"));
const patterns = new Patterns();
new Designer(() => patterns.refresh());

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
  const mine = (play = { id, onset, pattern: null });
  if (id === null) return;
  try {
    mine.pattern = await patternOf(running);
  } catch ({ code }) {
    // The connection failed: the next state requests it again.
    if (["unreachable", "slow", "stopped"].includes(code)) mine.id = undefined;
  }
}

// The pattern of a play. Null: a sequence, a live play, or a pattern of another array that was mapped by position. It has the phases: what
// the pins do is in the status.
async function patternOf({ id, pattern: name }) {
  const { pattern_sha256: sha256, mapped_from: from, items_planned: items, live } = await call("GET", `/v1/plays/${id}`);
  if (from !== null || items !== null || live !== null) return null;
  return (await call("GET", `/v1/patterns/${encodeURIComponent(name)}?sha256=${sha256}`)).pattern;
}

function handle(event) {
  switch (event.event) {
    case "state": {
      const { state, position, play: running } = last() ?? {};
      if (event.state !== state || event.position !== position || event.play?.id !== running?.id) poll();
      break;
    }
    case "owner-silent":
      say($("arm"), `The daemon disarmed: it had no sign of ${event.by} for ${event.silence_s} s.`, "bad");
      poll();
      break;
    case "doubted":
    case "connected":
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
  handleEvent({ event: "linked" });
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

const sourceWords = ({ source, sensor_fault: fault }) => (fault ? `${source}; sensor fault: ${SENSOR_FAULTS[fault] ?? fault}` : source);

function pinRows(now, drives) {
  const motors = last()?.motors ?? [];
  $("pins").tBodies[0].replaceChildren(...motors.map((motor, i) => {
    const does = now[i];
    const phase = does?.swing_um ? drives?.get(i)?.phase : "";
    const cells = [movement(does), does?.height_um.toFixed(1) ?? "", phase ?? "", motor.source === "none" && last().position !== "known" ? "not known" : motor.rest_error_um.toFixed(1), sourceWords(motor)];
    const row = document.createElement("tr");
    row.append(element("th", String(i), { scope: "row" }), ...cells.map((text) => element("td", String(text))));
    return row;
  }));
}

const NOTE = "Size and colour: how far a pin moves, as the daemon orders it. Hand: phase, drawn 20 times slower, where it is known. Bar on the left of a pin: offset from rest. Dashed ring: sensor fault. Blue ring: the pin of the pin test.";
let drawn = 0;
let tabled = 0;
function frame(at) {
  requestAnimationFrame(frame);
  if (at - drawn < FRAME_MS - 2) return;
  drawn = at;
  const status = known();
  const motors = status?.motors ?? [];
  const now = motors.map((motor) => motor.now);
  const seconds = Math.max(0, (performance.now() - play.onset) / 1000);
  const drives = status?.play && play.pattern ? drivesAt(play.pattern, seconds) : null;
  finger.draw(now, drives, motors.map((motor) => motor.rest_error_um), motors.map((motor) => motor.sensor_fault), seconds);
  if (at - tabled > 1000 && $("pins").closest("details").open) {
    tabled = at;
    pinRows(now, drives);
  }
  write($("finger-note"), now.some(Boolean) ? NOTE : "What the pins do is not known.");
}

bindControls();
bindNumbers();
bindFiles(() => patterns.refresh());
bindPinTest((motor) => finger.choose(motor));
bindEvents();
bindQueue();
bindReceipt();
bindRecord();
bindDevice();
bindDoctor();
bindCalibration();
startViews();
document.querySelector(".colours").style.backgroundImage = gradient();
$("scale-most").textContent = `${FULL_UM} µm`;
document.addEventListener("state", showState);
document.addEventListener("token", listen(handle, linked));
showState();
requestAnimationFrame(frame);
