// The calibration: its origin, the measured points and fitted lines of each motor, and controls to measure again.
//
// The small plots are arranged like the motors in the array, if these stand in rows and columns. They show the measured travel
// divided by the motor model's, so a motor like the model's lies at 1. The distance of a point from the line is the residual. The
// large plots show the chosen motor, and also its travel.

import { call, known, last, order, poll } from "./api.js";
import { array, loadArray } from "./array.js";
import { CALIBRATION, built, element, facts, open, refuse, say } from "./control.js";
import { worded } from "./doctor.js";
import { plot } from "./plot.js";
import { part } from "./views.js";
import { plain } from "./words.js";

const $ = (id) => document.getElementById(id);
const SOURCES = { plant: "the simulated motors themselves", device: "the device's telemetry", laser: "a laser" };
const DIRECTIONS = ["up", "down"];
// Plots that are drawn in one task.
const PLOTS = 8;

let report = null;
let chosen = 0;
// Play ids of the calibration whose end this window waits for (0: none), and of the last one whose end it knows.
let awaited = 0;
let ended = 0;
// Whether this window started it.
let mine = false;

// How long ago an instant was, in words.
function age(date) {
  const seconds = (Date.now() - Date.parse(date)) / 1000;
  if (!(seconds >= 0)) return "";
  const [size, unit] = [[86400, "day"], [3600, "hour"], [60, "minute"], [0, ""]].find(([size]) => seconds >= size);
  const count = Math.floor(seconds / size);
  return unit ? `${count} ${unit}${count === 1 ? "" : "s"} ago` : "just now";
}

const gain = (motor, direction) => `${motor[`gain_${direction}`].toFixed(3)} ± ${motor[`gain_${direction}_se`].toFixed(3)}`;
// One standard error of the mean of a point, µm.
const error = (point) => point.sd_um / Math.sqrt(point.bursts);

// The series of a motor: travel in µm, or divided by the model's.
function series(motor, over) {
  return DIRECTIONS.map((direction) => {
    const { slope_um_per_pulse: slope, offset_um: offset, points } = motor[direction];
    const share = (pulses) => (over ? pulses * report.provenance.um_per_pulse : 1);
    // Near 0 pulses only the offset of the line is left, so the ratio grows.
    const from = over ? Math.min(...report.provenance.pulses, ...points.map((point) => point.pulses)) : 0;
    return {
      name: direction,
      from,
      line: (pulses) => (offset + slope * pulses) / share(pulses),
      points: points.map((point) => [point.pulses, point.travel_um / share(point.pulses), error(point) / share(point.pulses)]),
    };
  });
}

// The ranges that hold the lines and points of all motors, so that their plots can be compared.
function ranges(motors) {
  const lengths = motors.flatMap((motor) => DIRECTIONS.flatMap((direction) => motor[direction].points.map((point) => point.pulses)));
  const longest = Math.max(...report.provenance.pulses, ...lengths);
  const x = [0, longest * 1.05];
  const values = (over) => motors.flatMap((motor) => series(motor, over)).flatMap(({ from, line, points }) => [line(from), line(x[1]), ...points.flatMap(([, value, error]) => [value - error, value + error])]);
  const [shares, um] = [values(true), values(false)];
  const step = 0.05;
  return {
    x,
    share: [Math.min(0.95, Math.floor(Math.min(...shares) / step) * step), Math.max(1.05, Math.ceil(Math.max(...shares) / step) * step)],
    um: [Math.min(0, ...um), Math.max(...um) * 1.05],
    longest,
  };
}

async function loadCalibration() {
  if (!array()) await loadArray();
  try {
    report = await call("GET", "/v1/calibration");
  } catch (error) {
    if (error.code !== "not-found") throw error;
    report = null;
    const none = error.message.startsWith("nothing was calibrated yet");
    worded($("calibration-note"), none ? "Nothing was calibrated yet: every motor has gain 1." : `No calibration is in use: ${error.message}.`);
  }
  $("fits").hidden = $("fit-values").hidden = !report;
  if (!report) {
    facts($("calibration-facts"), []);
    return;
  }
  const { motors, used, unused } = report;
  worded($("calibration-note"), `${motors.length} of ${array().positions_mm.length} motors are calibrated. ${used ? "The daemon uses these gains." : `Not in use: ${unused}.`}`);
  showFacts();
  $("fit-table").tBodies[0].replaceChildren(...motors.map(row));
  if (!motors.some((motor) => motor.motor === chosen)) chosen = motors[0].motor;
  draw();
}

// What was measured, with its age.
function showFacts() {
  const { provenance, file } = report;
  const date = provenance.date ? [provenance.date.replace("T", " ").replace("Z", " UTC"), age(provenance.date)].filter(Boolean).join(", ") : "without a date";
  facts($("calibration-facts"), [
    ["Measured (the last motor)", date],
    ["Measured by", SOURCES[provenance.telemetry] ?? provenance.telemetry],
    ["Device", `${provenance.device}, ${provenance.identity}`],
    ["Firmware", provenance.firmware],
    ["Plan", `bursts of ${provenance.pulses.join(", ")} pulses, ${provenance.repetitions} ${provenance.repetitions === 1 ? "round" : "rounds"}`],
    ["File", file],
  ]);
}

function row(motor) {
  const row = element("tr");
  const cells = DIRECTIONS.flatMap((direction) => [gain(motor, direction), motor[direction].slope_um_per_pulse.toFixed(4), motor[direction].offset_um.toFixed(3), `${(100 * motor[`relative_sd_${direction}`]).toFixed(1)}`, String(motor[direction].bursts)]);
  row.append(element("th", String(motor.motor), { scope: "row" }), ...cells.map((text) => element("td", text)));
  return row;
}

async function draw() {
  const mine = report;
  const { motors } = mine;
  const range = ranges(motors);
  await built([...$("fit-grid").children], (button, number) => mine === report && fill(button, number, motors.find((motor) => motor.motor === number), range), PLOTS);
  if (mine !== report) return;
  const [low, high] = range.share;
  const points = motors.some((motor) => motor.up.points.length) ? "Markers: mean travel of the bursts of one length, with its standard error. " : "This file holds no measured points: calibrate again to see them. ";
  $("fit-note").textContent = `${points}Lines: the fit. Filled triangles and full lines: up; open triangles and dashed lines: down. Small plots: measured / model travel, ${low.toFixed(2)} to ${high.toFixed(2)}, against 0 to ${range.longest} pulses, the thin line at 1${array().grid ? "; they stand as the motors in the array" : ""}.`;
  show(motors.find((motor) => motor.motor === chosen), range);
}

// A motor's button. The button is kept when its motor is measured again, so that it keeps the focus.
function fill(button, number, motor, range) {
  button.disabled = !motor;
  button.ariaLabel = motor ? `Motor ${number}: gain up ${gain(motor, "up")}, down ${gain(motor, "down")}` : null;
  button.ariaPressed = motor ? String(number === chosen) : null;
  button.replaceChildren(
    element("span", String(number)),
    motor
      ? plot({ width: 80, height: 60, x: range.x, y: range.share, level: 1, series: series(motor, true) })
      : element("span", "not calibrated", { className: "none" }),
  );
}

function show(motor, range) {
  $("fit-title").textContent = `Motor ${motor.motor}`;
  const wide = { width: 420, height: 230, x: range.x };
  $("fit-plots").replaceChildren(
    plot({ ...wide, title: `Motor ${motor.motor}, travel against pulses`, y: range.um, labels: ["Pulses of a burst", "Travel, µm"], series: series(motor, false) }),
    plot({ ...wide, title: `Motor ${motor.motor}, measured / model travel against pulses`, y: range.share, level: 1, labels: ["Pulses of a burst", "Measured / model travel"], series: series(motor, true) }),
  );
  facts($("fit-facts"), [
    ["Gain up, down", `${gain(motor, "up")}, ${gain(motor, "down")}`],
    ["Slope up, down", `${motor.up.slope_um_per_pulse.toFixed(4)}, ${motor.down.slope_um_per_pulse.toFixed(4)} µm per pulse`],
    ["Offset up, down", `${motor.up.offset_um.toFixed(3)}, ${motor.down.offset_um.toFixed(3)} µm`],
    ["Scatter of a burst up, down", `${(100 * motor.relative_sd_up).toFixed(1)}, ${(100 * motor.relative_sd_down).toFixed(1)} %`],
    ["Bursts up, down", `${motor.up.bursts}, ${motor.down.bursts}`],
  ]);
}

// Why motors cannot be calibrated in a state.
const STATES = { disarmed: "Arm first: the pins move.", faulted: "Reset first.", returning: "Pins move to rest: wait.", "no-device": "No device is connected." };

// Whether motors can be calibrated now, and if not, why.
function showCalibrating() {
  if (report) showFacts();
  const status = known();
  const { play, device } = status ?? {};
  const runs = play?.pattern === CALIBRATION;
  if (runs && play.id !== ended) awaited = play.id;
  const why = !status ? "The state is not known."
    : runs ? `Calibrating for ${play.played_s.toFixed(0)} s. Keep the finger off.`
    : !device ? STATES["no-device"]
    : !device.telemetry ? "This device has no telemetry. A laser measures one motor after the other: `meissner calibrate` on the daemon's machine."
    : status.state !== "armed" ? STATES[status.state] ?? `The state is ${status.state}.`
    : play || status.queued.length ? "A play runs or waits."
    : "";
  $("calibrate").disabled = why !== "";
  const text = why || "Pins move for about a minute.";
  if ($("calibrate-note").textContent !== text.replaceAll("`", "")) worded($("calibrate-note"), text);
}

function tell(text) {
  [ended, awaited, mine] = [awaited, 0, false];
  $("calibrate-result").textContent = text;
}

// The event `calibrated`.
function handleCalibrated({ motors, problem }) {
  tell(problem ? plain(`Calibration failed: ${problem}`) : `Stored: ${motors.length} ${motors.length === 1 ? "motor" : "motors"}. Home brings the pins back to rest.`);
}

// Loads the calibration when events may have been missed, and reports the end of a calibration that ran before.
async function loadAfterGap() {
  const before = report?.provenance.date;
  await loadCalibration();
  const status = last();
  if (!awaited || !status || status.play?.pattern === CALIBRATION) return;
  tell(report?.provenance.date === before ? "The calibration ended, and nothing was stored." : "The calibration ended, and was stored.");
}

// A choice and a button for each motor.
function arrange() {
  const { positions_mm: places, grid } = array();
  $("calibrate-motor").replaceChildren($("calibrate-motor").options[0], ...places.map((_, motor) => element("option", `Motor ${motor}`, { value: String(motor) })));
  $("fit-grid").replaceChildren(...places.map((_, motor) => element("button", "", { type: "button", className: "fit", value: String(motor) })));
  $("fit-grid").style.setProperty("--columns", grid?.columns ?? Math.ceil(Math.sqrt(places.length)));
  chosen = 0;
}

export function bindCalibration() {
  const refresh = part({
    view: "device",
    at: "calibration-title",
    load: loadAfterGap,
    state: showCalibrating,
    on: { connected: loadCalibration },
    always: { calibrated: (event) => (handleCalibrated(event), refresh()) },
  });
  document.addEventListener("array", arrange);
  $("fit-grid").addEventListener("click", (event) => {
    const button = event.target.closest("button:enabled");
    if (!button) return;
    chosen = Number(button.value);
    draw();
  });
  // Warn: nobody would be at E-STOP.
  addEventListener("beforeunload", (event) => mine && event.preventDefault());
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
      mine = true;
      const { id } = await order("/v1/calibrate", motor ? { motor: Number(motor) } : {});
      // A short one may have ended by now.
      if (id !== ended && mine) awaited = id;
      say($("calibrate"), "");
      poll();
    } catch (error) {
      mine = false;
      refuse($("calibrate"), error);
    }
  });
}
