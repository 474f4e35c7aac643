// The page: connects the daemon's events and status with the parts that show them. Events carry no state: they say when to request
// it.

import { known, last, listen, poll } from "./api.js";
import { array, loadArray } from "./array.js";
import { $, bindControls, element, say, showControls, write } from "./control.js";
import { Designer } from "./designer.js";
import { bindDevice } from "./device.js";
import { bindDoctor } from "./doctor.js";
import { bindFiles } from "./files.js";
import { bindEvents } from "./events.js";
import { Feed } from "./feed.js";
import { Patterns } from "./patterns.js";
import { bindPinTest } from "./pin-test.js";
import { gradient, heightOf, highest, movement } from "./pins.js";
import { bindQueue } from "./queue.js";
import { bindReceipt } from "./receipt.js";
import { bindRecord } from "./record.js";
import { Replay } from "./replay.js";
import { Stage } from "./stage.js";
import { connected, disconnected, handleEvent, showStatus, startViews } from "./views.js";
import { SENSOR_FAULTS, plain } from "./words.js";

const stage = new Stage(new Feed((take) => replay.set(take)));
const replay = new Replay(stage);
const patterns = new Patterns();
new Designer(() => patterns.refresh());

// Says what is wrong with the connection; nothing else stands there.
function alertConnection(text) {
  $("alert").hidden = !text;
  write($("alert"), text);
}

function showState() {
  showControls();
  showStatus();
  showPins();
}

function handle(event) {
  switch (event.event) {
    case "began":
      replay.now();
      break;
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
    alertConnection(plain(problem));
    return;
  }
  await poll();
  try {
    await loadArray();
  } catch (error) {
    alertConnection(plain(error));
    return;
  }
  // The connection may be lost again by now.
  if (!isLinked) return;
  alertConnection("");
  await connected();
}

const sourceWords = ({ source, sensor_fault: fault }) => (fault ? `${source}; sensor fault: ${SENSOR_FAULTS[fault] ?? fault}` : source);

function pinRows(status) {
  $("pins").tBodies[0].replaceChildren(...(last()?.motors ?? []).map((motor, i) => {
    const isPlaced = status && (motor.source !== "none" || status.position === "known");
    const now = status && motor.now;
    const cells = [movement(now), now ? highest(now).toFixed(1) : "", isPlaced ? motor.rest_error_um.toFixed(1) : "not known", status ? sourceWords(motor) : ""];
    const row = document.createElement("tr");
    row.append(element("th", String(i), { scope: "row" }), ...cells.map((text) => element("td", text)));
    return row;
  }));
}

// Each pin as a table.
function showPins() {
  if ($("pins").closest("details").open) pinRows(known());
}

bindControls();
bindFiles(() => patterns.refresh());
bindPinTest((motor) => stage.choose(motor));
bindEvents();
bindQueue();
bindReceipt();
bindRecord();
bindDevice();
bindDoctor();
startViews();
document.querySelector(".colours").style.backgroundImage = gradient();
document.addEventListener("state", showState);
document.addEventListener("array", () => {
  const { travel_um: most } = array().motor;
  $("scale-most").textContent = `${most} µm`;
  $("scale-middle").textContent = heightOf(0.5).toFixed(0);
});
document.addEventListener("token", listen(handle, linked));
showState();
