// The calibration: its origin, the fit of each motor as numbers, and controls to measure again.

import { call, known, last, order } from "./api.js";
import { array, loadArray } from "./array.js";
import { $, CALIBRATION, element, facts, open, refuse, say } from "./control.js";
import { worded } from "./doctor.js";
import { part } from "./views.js";
import { sentence } from "./words.js";

const SOURCES = { plant: "the simulated motors themselves", device: "the device's telemetry", laser: "a laser" };
const DIRECTIONS = ["up", "down"];

let report = null;
// The play of the calibration that this window has started last.
let mine = null;

const gain = (motor, direction) => `${motor[`gain_${direction}`].toFixed(3)} ± ${motor[`gain_${direction}_se`].toFixed(3)}`;

async function loadCalibration() {
  if (!array()) await loadArray();
  try {
    report = await call("GET", "/v1/calibration");
  } catch (error) {
    if (error.code !== "not-found") throw error;
    report = null;
    worded($("calibration-note"), `No calibration is in use: ${error.message}.`);
  }
  $("fit-values").hidden = !report;
  if (!report) {
    facts($("calibration-facts"), []);
    return;
  }
  const { motors, used, unused, provenance, file } = report;
  worded($("calibration-note"), `${motors.length} of ${array().positions_mm.length} motors are calibrated. ${used ? "The daemon uses these gains." : `Not in use: ${unused}.`}`);
  facts($("calibration-facts"), [
    ["Measured (the last motor)", provenance.date ? provenance.date.replace("T", " ").replace("Z", " UTC") : "without a date"],
    ["Measured by", SOURCES[provenance.telemetry] ?? provenance.telemetry],
    ["Device", `${provenance.device}, ${provenance.identity}`],
    ["Firmware", provenance.firmware],
    ["Plan", `bursts of ${provenance.pulses.join(", ")} pulses, ${provenance.repetitions} ${provenance.repetitions === 1 ? "round" : "rounds"}`],
    ["File", file],
  ]);
  $("fit-table").tBodies[0].replaceChildren(...motors.map(row));
}

function row(motor) {
  const row = element("tr");
  const cells = DIRECTIONS.flatMap((direction) => [gain(motor, direction), motor[direction].slope_um_per_pulse.toFixed(4), motor[direction].offset_um.toFixed(3), `${(100 * motor[`relative_sd_${direction}`]).toFixed(1)}`, String(motor[direction].bursts)]);
  row.append(element("th", String(motor.motor), { scope: "row" }), ...cells.map((text) => element("td", text)));
  return row;
}

// Why motors cannot be calibrated in a state.
const STATES = { disarmed: "Arm first: the pins move.", faulted: "Reset first.", returning: "Pins move to rest: wait.", "no-device": "No device is connected." };

// Whether motors can be calibrated now, and if not, why.
function showCalibrating() {
  const status = known();
  const { play, device } = status ?? {};
  const why = !status ? "The state is not known."
    : play?.pattern === CALIBRATION ? `Calibrating for ${play.played_s.toFixed(0)} s. Keep the finger off.`
    : !device ? STATES["no-device"]
    : !device.telemetry ? "This device has no telemetry. A laser measures one motor after the other: `meissner calibrate` on the daemon's machine."
    : status.state !== "armed" ? STATES[status.state] ?? `The state is ${status.state}.`
    : play || status.queued.length ? "A play runs or waits."
    : "";
  $("calibrate").disabled = why !== "";
  const text = why || "Pins move for about a minute.";
  if ($("calibrate-note").textContent !== text.replaceAll("`", "")) worded($("calibrate-note"), text);
}

// The event `calibrated`.
function handleCalibrated({ motors, problem }) {
  $("calibrate-result").textContent = problem ? sentence(`Calibration failed: ${problem}`) : `Stored: ${motors.length} ${motors.length === 1 ? "motor" : "motors"}. Home brings the pins back to rest.`;
}

// A choice for each motor.
function arrange() {
  $("calibrate-motor").replaceChildren($("calibrate-motor").options[0], ...array().positions_mm.map((_, motor) => element("option", `Motor ${motor}`, { value: String(motor) })));
}

export function bindCalibration() {
  const refresh = part({
    view: "device",
    at: "calibration-title",
    load: loadCalibration,
    state: showCalibrating,
    on: { connected: loadCalibration },
    always: { calibrated: (event) => (handleCalibrated(event), refresh()) },
  });
  document.addEventListener("array", arrange);
  // Warn: nobody would be at E-STOP.
  addEventListener("beforeunload", (event) => mine !== null && last()?.play?.id === mine && event.preventDefault());
  const dialog = $("calibrate-dialog");
  let motor = "";
  $("calibrate").addEventListener("click", () => {
    motor = $("calibrate-motor").value;
    $("calibrate-what").textContent = motor ? `Motor ${motor} is measured.` : "All motors are measured.";
    $("calibrate-clear").checked = false;
    open(dialog);
  });
  dialog.addEventListener("close", async () => {
    if (dialog.returnValue !== "calibrate") return;
    $("calibrate-result").textContent = "";
    try {
      mine = (await order("/v1/calibrate", motor ? { motor: Number(motor) } : {})).id;
      say($("calibrate"), "");
    } catch (error) {
      refuse($("calibrate"), error);
    }
  });
}
