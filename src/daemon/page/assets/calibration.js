// The calibration: where it comes from, the measured points and fitted lines of each motor, and how to measure anew.
//
// The small plots stand where the motors stand in the array. They show travel over the model's travel, so a motor like the model's lies at 1,
// and what a line misses is its residual. The large plot shows the chosen motor, by travel too.

import { call } from "./api.js";
import { closeWithEscape, facts, open } from "./control.js";
import { worded } from "./doctor.js";
import { plot } from "./plot.js";

const $ = (id) => document.getElementById(id);
const MOTORS = 24;
// The default plan: 10 lengths, twice, 3 s each.
const PLAN_S = 60;
const SOURCES = { plant: "the simulated motors themselves", device: "the device's telemetry", laser: "a laser" };
const DIRECTIONS = ["up", "down"];

let report = null;
let chosen = 0;

function element(name, text = "", more = {}) {
  return Object.assign(document.createElement(name), { textContent: text, ...more });
}

// How long ago an instant was, in words.
function age(date) {
  const seconds = (Date.now() - Date.parse(date)) / 1000;
  if (!(seconds >= 0)) return "";
  const [size, unit] = [[86400, "day"], [3600, "hour"], [60, "minute"], [0, ""]].find(([size]) => seconds >= size);
  const count = Math.floor(seconds / size);
  return unit ? `${count} ${unit}${count === 1 ? "" : "s"} ago` : "just now";
}

const gain = (motor, way) => `${motor[`gain_${way}`].toFixed(3)} ± ${motor[`gain_${way}_se`].toFixed(3)}`;
// One standard error of the mean of a point, µm.
const error = (point) => point.sd_um / Math.sqrt(point.bursts);

// The series of a motor: travel in µm, or over the model's.
function series(motor, over) {
  return DIRECTIONS.map((way) => {
    const { slope_um_per_pulse: slope, offset_um: offset, points } = motor[way];
    const share = (pulses) => (over ? pulses * report.provenance.um_per_pulse : 1);
    // Near 0 pulses the offset is all that is left of the line.
    const from = over ? Math.min(...report.provenance.pulses, ...points.map((point) => point.pulses)) : 0;
    return {
      name: way,
      from,
      line: (pulses) => (offset + slope * pulses) / share(pulses),
      points: points.map((point) => [point.pulses, point.travel_um / share(point.pulses), error(point) / share(point.pulses)]),
    };
  });
}

// The ranges that hold all motors, so that their plots can be compared.
function ranges(motors) {
  const all = motors.flatMap((motor) => DIRECTIONS.map((way) => motor[way]));
  const longest = Math.max(...report.provenance.pulses, ...all.flatMap((of) => of.points.map((point) => point.pulses)));
  const shares = motors.flatMap((motor) => series(motor, true)).flatMap(({ line, points }) => [line(longest), ...points.flatMap(([, share, error]) => [share - error, share + error])]);
  const most = Math.max(...all.map((of) => of.offset_um + of.slope_um_per_pulse * longest), ...all.flatMap((of) => of.points.map((point) => point.travel_um + error(point))));
  const step = 0.05;
  return {
    x: [0, longest * 1.05],
    share: [Math.min(0.95, Math.floor(Math.min(...shares) / step) * step), Math.max(1.05, Math.ceil(Math.max(...shares) / step) * step)],
    um: [0, most * 1.05],
    longest,
  };
}

export async function loadCalibration() {
  try {
    report = await call("GET", "/v1/calibration");
  } catch (error) {
    if (error.code !== "not-found") throw error;
    report = null;
    $("calibration-note").textContent = "Nothing was calibrated yet: every motor counts as the model's, with a gain of 1.";
  }
  $("fits").hidden = $("fit-values").hidden = !report;
  if (!report) {
    facts($("calibration-facts"), []);
    return;
  }
  const { provenance, motors, used, unused, file } = report;
  worded($("calibration-note"), `${motors.length} of ${MOTORS} motors are calibrated. ${used ? "The daemon uses these gains." : `Not in use: ${unused}.`}`);
  const date = provenance.date ? `${provenance.date.replace("T", " ").replace("Z", " UTC")}, ${age(provenance.date)}` : "without a date";
  facts($("calibration-facts"), [
    ["Measured (the last motor)", date],
    ["Measured by", SOURCES[provenance.telemetry] ?? provenance.telemetry],
    ["Device", `${provenance.device}, ${provenance.identity}`],
    ["Firmware", provenance.firmware],
    ["Plan", `bursts of ${provenance.pulses.join(", ")} pulses, ${provenance.repetitions} ${provenance.repetitions === 1 ? "round" : "rounds"}`],
    ["File", file],
  ]);
  $("fit-table").tBodies[0].replaceChildren(...motors.map(row));
  if (!motors.some((motor) => motor.motor === chosen)) chosen = motors[0].motor;
  draw();
}

function row(motor) {
  const row = element("tr");
  const cells = DIRECTIONS.flatMap((way) => [gain(motor, way), motor[way].slope_um_per_pulse.toFixed(4), motor[way].offset_um.toFixed(3), `${(100 * motor[`relative_sd_${way}`]).toFixed(1)}`, String(motor[way].bursts)]);
  row.append(element("th", String(motor.motor), { scope: "row" }), ...cells.map((text) => element("td", text)));
  return row;
}

function draw() {
  const { motors } = report;
  const range = ranges(motors);
  $("fit-grid").replaceChildren(...Array.from({ length: MOTORS }, (_, number) => cell(number, motors.find((motor) => motor.motor === number), range)));
  const [low, high] = range.share;
  const points = motors.some((motor) => motor.up.points.length) ? "Markers: mean travel of the bursts of one length, with its standard error. " : "This file holds no measured points: calibrate again to see them. ";
  $("fit-note").textContent = `${points}Lines: the fit. Filled triangles and full lines: up; open triangles and dashed lines: down. Small plots: travel over the model's, ${low.toFixed(2)} to ${high.toFixed(2)}, against 0 to ${range.longest} pulses, the thin line at 1; they stand as the motors in the array.`;
  show(motors.find((motor) => motor.motor === chosen), range);
}

function cell(number, motor, range) {
  const button = element("button", "", { type: "button", className: "fit" });
  button.dataset.motor = number;
  button.append(element("span", String(number)));
  if (!motor) {
    button.disabled = true;
    button.append(element("span", "not calibrated", { className: "none" }));
    return button;
  }
  button.setAttribute("aria-label", `Motor ${number}: gain up ${gain(motor, "up")}, down ${gain(motor, "down")}`);
  button.setAttribute("aria-pressed", String(number === chosen));
  button.append(plot({ width: 80, height: 60, x: range.x, y: range.share, level: 1, series: series(motor, true) }));
  button.addEventListener("click", () => {
    chosen = number;
    for (const other of $("fit-grid").children) if (!other.disabled) other.setAttribute("aria-pressed", String(other === button));
    show(motor, range);
  });
  return button;
}

function show(motor, range) {
  $("fit-title").textContent = `Motor ${motor.motor}`;
  const wide = { width: 420, height: 230, x: range.x };
  $("fit-plots").replaceChildren(
    plot({ ...wide, title: `Motor ${motor.motor}, travel against pulses`, y: range.um, labels: ["Pulses of a burst", "Travel, µm"], series: series(motor, false) }),
    plot({ ...wide, title: `Motor ${motor.motor}, travel over the model's against pulses`, y: range.share, level: 1, labels: ["Pulses of a burst", "Travel over the model's"], series: series(motor, true) }),
  );
  facts($("fit-facts"), [
    ["Gain up, down", `${gain(motor, "up")}, ${gain(motor, "down")}`],
    ["Slope up, down", `${motor.up.slope_um_per_pulse.toFixed(4)}, ${motor.down.slope_um_per_pulse.toFixed(4)} µm per pulse`],
    ["Offset up, down", `${motor.up.offset_um.toFixed(3)}, ${motor.down.offset_um.toFixed(3)} µm`],
    ["Scatter of a burst up, down", `${(100 * motor.relative_sd_up).toFixed(1)}, ${(100 * motor.relative_sd_down).toFixed(1)} %`],
    ["Bursts up, down", `${motor.up.bursts}, ${motor.down.bursts}`],
  ]);
}

// Whether motors can be calibrated now, and if not, why.
export function showCalibrating(status) {
  const { play, device } = status ?? {};
  const runs = play?.pattern === "calibration";
  const why = !status ? "The page does not reach the daemon."
    : runs ? `Calibrating: ${play.played_s.toFixed(0)} s of about ${PLAN_S} s. Keep the finger off.`
    : !device ? "No device is connected."
    : !device.telemetry ? "This device has no telemetry. A laser measures one motor after the other: `meissner calibrate --plan --motor N` on the daemon's machine."
    : status.state !== "armed" ? "Arm first: the pins move."
    : play || status.queued.length ? "A play runs or waits."
    : "";
  $("calibrate").disabled = why !== "";
  const text = why || "Pins move for about a minute.";
  if ($("calibrate-note").textContent !== text.replaceAll("`", "")) worded($("calibrate-note"), text);
}

// The event `calibrated`.
export function handleCalibrated({ motors, problem }) {
  $("calibrate-result").textContent = problem ? `Nothing was stored: ${problem}.` : `Stored: ${motors.length} ${motors.length === 1 ? "motor" : "motors"}. Home brings the pins back to rest.`;
  return loadCalibration();
}

export function bindCalibration(complain, poll) {
  const numbers = Array.from({ length: MOTORS }, (_, motor) => element("option", `Motor ${motor}`, { value: String(motor) }));
  $("calibrate-motor").append(...numbers);
  const dialog = $("calibrate-dialog");
  closeWithEscape(dialog);
  $("calibrate").addEventListener("click", () => {
    dialog.returnValue = "";
    $("calibrate-clear").checked = false;
    open(dialog);
  });
  dialog.addEventListener("close", () => {
    if (dialog.returnValue !== "calibrate") return;
    const motor = $("calibrate-motor").value;
    $("calibrate-result").textContent = "";
    call("POST", "/v1/calibrate", motor ? { motor: Number(motor) } : {}).then(() => (complain(null), poll()), complain);
  });
}
