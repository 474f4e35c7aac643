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
  const { device, clock, daemon: { drift_limit_um: limit, lease_ms: lease, lead_ms: lead } } = status;
  const { missing, bytes_per_s: line, contradictions, board } = status.link;
  // Without an estimate and a known position, 0 means nothing.
  const isKnown = status.position === "known" || status.motors.every((motor) => motor.source !== "none");
  const offsets = isKnown ? status.motors.map((motor) => Math.abs(motor.rest_error_um)) : [];
  const worst = Math.max(0, ...offsets);
  return [
    ["Device", device ? `${device.kind}${device.simulated ? ", simulated" : ""}, firmware ${device.firmware}, ${device.telemetry ? "with" : "without"} telemetry` : missing ?? "none"],
    ["Largest offset from rest", offsets.length ? `${worst.toFixed(1)} µm, pin ${offsets.indexOf(worst)}, of at most ${limit} µm` : "not known"],
    ["Position", status.position],
    ["Line", line === null ? "not measured" : `${(line / 1000).toFixed(0)} kB/s`],
    ["Messages that cannot be true", contradictions],
    ["Clock", clock ? `synchronised to ±${clock.uncertainty_us.toFixed(1)} µs` : "not synchronised"],
    ["Host watchdog", `${lease.toFixed(0)} ms without the daemon stop the device; strokes are sent ${lead.toFixed(0)} ms ahead`],
    ["Device runs", board ? `for ${(board.uptime_s / 60).toFixed(0)} min, started by ${board.reset}; ${counters(board)}` : "not known"],
  ];
}

function daemon(status) {
  const { participant: limit, session, armed, estop, daemon: { version, pid, realtime: { fifo, mlock }, logbook_problem: problem, logbook_lost: lost } } = status;
  const silence = armed && (armed.silence_s === null ? "the motors stay armed without it" : `${armed.silence_s} s without a sign of it disarm`);
  return [
    ["Version", `meissner ${version}, pid ${pid}`],
    ["Armed by", armed ? `${armed.by}; ${silence}` : "nobody"],
    ["Session", session ? `${session.participant}, ${plural(session.plays, "play")}` : "none"],
    ["Real time", fifo && mlock ? "granted" : `missing: ${[fifo ? "" : "SCHED_FIFO", mlock ? "" : "locked memory"].filter(Boolean).join(" and ")}; strokes may come late`],
    ["Vibration left", limit ? `${limit.continuous_left_s.toFixed(0)} s without a pause, ${limit.day_left_s.toFixed(0)} s today` : "not counted"],
    ["Emergency stops since the start", estop.orders],
    ["Session record", problem ?? (lost ? `${lost} entries were lost` : "no problem")],
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
