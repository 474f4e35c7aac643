// Facts about the device, its link and clock, the array, and the daemon.

import { known, last } from "./api.js";
import { array } from "./array.js";
import { $, facts } from "./control.js";
import { part } from "./views.js";

const plural = (count, one, more = `${one}s`) => `${count} ${count === 1 ? one : more}`;

/** The device's counters: what the status names beside these. */
function counters({ reset, uptime_s, slack_ticks, high_at_boot, ...counters }) {
  return Object.entries(counters).map(([name, count]) => `${count ?? "no count of"} ${name.replaceAll("_", " ")}`).join(", ");
}

function link(status) {
  const { device, line_bytes_per_s: line, board } = status;
  // Without an estimate and a known position, 0 means nothing.
  const isKnown = status.position === "known" || status.motors.every((motor) => motor.source !== "none");
  const offsets = isKnown ? status.motors.map((motor) => Math.abs(motor.rest_error_um)) : [];
  const worst = Math.max(0, ...offsets);
  return [
    ["Device", device ? `${device.kind}${device.simulated ? ", simulated" : ""}, firmware ${device.firmware}, ${device.telemetry ? "with" : "without"} telemetry` : status.missing ?? "none"],
    ["Largest offset from rest", offsets.length ? `${worst.toFixed(1)} µm, pin ${offsets.indexOf(worst)}, of at most ${status.drift_limit_um} µm` : "not known"],
    ["Position", status.position],
    ["Line", line === null ? "not measured" : `${(line / 1000).toFixed(0)} kB/s`],
    ["Messages that cannot be true", status.contradictions],
    ["Clock", status.clock_uncertainty_us === null ? "not synchronised" : `synchronised to ±${status.clock_uncertainty_us.toFixed(1)} µs`],
    ["Host watchdog", `${status.lease_ms.toFixed(0)} ms without the daemon stop the device; strokes are sent ${status.lead_ms.toFixed(0)} ms ahead`],
    ["Device runs", board ? `for ${(board.uptime_s / 60).toFixed(0)} min, started by ${board.reset}; ${counters(board)}` : "not known"],
  ];
}

function daemon(status) {
  const { fifo, mlock } = status.realtime ?? {};
  const { participant: limit, session, armed } = status;
  const silence = armed && (armed.silence_s === null ? "the motors stay armed without it" : `${armed.silence_s} s without a sign of it disarm`);
  return [
    ["Version", `meissner ${status.version}, pid ${status.pid}`],
    ["Armed by", armed ? `${armed.by}; ${silence}` : "nobody"],
    ["Session", session ? `${session.participant}, ${plural(session.plays, "play")}` : "none"],
    ["Real time", fifo && mlock ? "granted" : `missing: ${[fifo ? "" : "SCHED_FIFO", mlock ? "" : "locked memory"].filter(Boolean).join(" and ")}; strokes may come late`],
    ["Vibration left", limit ? `${limit.continuous_left_s.toFixed(0)} s without a pause, ${limit.day_left_s.toFixed(0)} s today` : "not counted"],
    ["Emergency stops since the start", status.estops],
    ["Session record", status.logbook_problem ?? (status.logbook_lost ? `${status.logbook_lost} entries were lost` : "no problem")],
  ];
}

function showStatus() {
  const status = known();
  for (const [id, describe] of [["facts", link], ["daemon-facts", daemon]]) {
    // Keep the rows in place.
    const rows = last() ? describe(last()) : [];
    facts($(id), status ? rows : rows.map(([name]) => [name, "not known"]));
  }
}

function showArray() {
  const { name, hash, positions_mm: places, grid, pitch_mm: pitch, pin_radius_mm: radius, motor, duty, rails, chips, tick_hz: hz } = array();
  const isRun = (motors) => motors.length > 2 && motors.every((motor, i) => motor === motors[0] + i);
  const groups = (list) => list.map((motors) => (isRun(motors) ? `${motors[0]} to ${motors.at(-1)}` : motors.join(", ")));
  facts($("array-facts"), [
    ["Name", `${name}, hash ${hash}`],
    ["Pins", `${places.length}${grid ? `, ${grid.rows} rows of ${grid.columns}` : ""}, ${pitch.toFixed(1)} mm apart, ${(2 * radius).toFixed(1)} mm wide`],
    ["Travel", `${motor.travel_um.toFixed(0)} µm, ${motor.um_per_pulse.toFixed(3)} µm per pulse`],
    ["Speed", `${motor.speed_mm_s.toFixed(1)} mm/s; bursts of ${motor.least_pulses} to ${motor.most_pulses} pulses`],
    ["A shaft follows", `a moving average over ${motor.window_ms} ms`],
    ["Rails", `${rails.length}, motors ${groups(rails).join("; ")}`],
    ["Driver chips", `${chips.length}, motors ${groups(chips).join("; ")}`],
    ["Carrier", `${(hz / 1000).toFixed(0)} kHz, high for ${duty.up} of a tick up, ${duty.down} down`],
  ]);
}

export function bindDevice() {
  part({ view: "device", at: "facts-title", state: showStatus });
  document.addEventListener("array", showArray);
}
