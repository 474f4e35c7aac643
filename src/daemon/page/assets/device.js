// Facts about the device, its link and clock, the daemon, and the array.

import { known, last } from "./api.js";
import { array } from "./array.js";
import { facts, write } from "./control.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);

function describe(status) {
  const offsets = status.motors.map((motor) => Math.abs(motor.rest_error_um));
  const worst = Math.max(0, ...offsets);
  const { fifo, mlock } = status.realtime ?? {};
  const limit = status.participant;
  const { by, silence_s: silence } = status.armed ?? {};
  const { device, line_bytes_per_s: line } = status;
  return [
    ["Device", device ? `${device.kind}${device.simulated ? ", simulated" : ""}, firmware ${device.firmware}, ${device.telemetry ? "with" : "without"} telemetry` : status.missing ?? "none"],
    ...(by ? [["Armed by", `${by}; ${silence === null ? "the motors stay armed without it" : `${silence} s without a sign of it disarm`}`]] : []),
    ["Largest offset from rest", `${worst.toFixed(1)} µm, pin ${offsets.indexOf(worst)}, of at most ${status.drift_limit_um} µm`],
    ["Position", status.position],
    ["Link", `${line === null ? "not measured" : `${(line / 1000).toFixed(0)} kB/s`}; impossible messages: ${status.contradictions || "none"}`],
    ["Host watchdog", `the device stops after ${status.lease_ms.toFixed(0)} ms without the daemon; strokes are sent ${status.lead_ms.toFixed(0)} ms ahead`],
    ["Clock", status.clock_uncertainty_us === null ? "not synchronised" : `synchronised to ±${status.clock_uncertainty_us.toFixed(1)} µs`],
    ["Real time", fifo && mlock ? "granted" : `missing: ${[fifo ? "" : "SCHED_FIFO", mlock ? "" : "locked memory"].filter(Boolean).join(" and ")}; strokes may come late`],
    ["Emergency stops since the start", status.estops],
    ["Session", status.session ? `${status.session.participant}, ${status.session.plays} plays` : "none"],
    ["Vibration left", limit ? `${limit.continuous_left_s.toFixed(0)} s without a pause, ${limit.day_left_s.toFixed(0)} s today` : "not counted"],
    ...(status.logbook_problem ? [["Session record", status.logbook_problem]] : []),
  ];
}

function show() {
  const status = known();
  // Keep the rows in place.
  const rows = last() ? describe(last()) : [];
  facts($("facts"), status ? rows : rows.map(([name]) => [name, "not known"]));
  write($("about"), status ? `meissner ${status.version}, pid ${status.pid}` : "");
}

function showArray() {
  const { name, positions_mm: places, grid, pitch_mm: pitch, pin_radius_mm: radius, motor, rails, chips, tick_hz: hz } = array();
  facts($("array-facts"), [
    ["Array", name],
    ["Pins", `${places.length}${grid ? `, ${grid.rows} rows of ${grid.columns}` : ""}, ${pitch.toFixed(1)} mm apart, ${(2 * radius).toFixed(1)} mm wide`],
    ["Travel", `${motor.travel_um.toFixed(0)} µm, ${motor.um_per_pulse.toFixed(3)} µm per pulse`],
    ["Wiring", `${rails.length} rails, ${chips.length} driver chips`],
    ["Device clock", `${(hz / 1000).toFixed(0)} kHz`],
  ]);
}

export function bindDevice() {
  part({ view: "device", at: "facts-title", state: show });
  document.addEventListener("array", showArray);
}
