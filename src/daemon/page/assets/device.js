// Facts about the device, its link and clock, the array, the daemon, and who may reach it.

import { known, last, text } from "./api.js";
import { array } from "./array.js";
import { $, facts, write } from "./control.js";
import { part } from "./views.js";

const ROLES = { operate: "everything but tokens: role “operate”", observe: "only read: role “observe”" };

// The link's counters by name, from the metrics; null until they are known, and when they are too old.
let counters = null;
let asked = -Infinity;
const COUNTERS_MS = 2000;

const plural = (count, one, more = `${one}s`) => `${count} ${count === 1 ? one : more}`;

// The counters that a device restarts when it is connected.
async function loadCounters() {
  asked = performance.now();
  const lines = (await text("/v1/metrics")).matchAll(/^meissner_(\w+?)(?:_total)?(?:\{[^}]*\})? (\S+)$/gm);
  counters = {};
  for (const [, name, value] of lines) counters[name] = (counters[name] ?? 0) + Number(value);
  showStatus();
}

function link(status) {
  const { device, line_bytes_per_s: line, board } = status;
  // Without an estimate and a known position, 0 means nothing.
  const isKnown = status.position === "known" || status.motors.every((motor) => motor.source !== "none");
  const offsets = isKnown ? status.motors.map((motor) => Math.abs(motor.rest_error_um)) : [];
  const worst = Math.max(0, ...offsets);
  const { sent_bytes: sent, retransmitted_frames: again, bad_frames: bad, device_bad_frames: badThere } = counters ?? {};
  return [
    ["Device", device ? `${device.kind}${device.simulated ? ", simulated" : ""}, firmware ${device.firmware}, ${device.telemetry ? "with" : "without"} telemetry` : status.missing ?? "none"],
    ["Largest offset from rest", offsets.length ? `${worst.toFixed(1)} µm, pin ${offsets.indexOf(worst)}, of at most ${status.drift_limit_um} µm` : "not known"],
    ["Position", status.position],
    ["Line", line === null ? "not measured" : `${(line / 1000).toFixed(0)} kB/s`],
    ["Frames sent again, damaged", counters ? `${again} sent again, ${bad + badThere} damaged, ${(sent / 1e6).toFixed(1)} MB sent` : "not known"],
    ["Messages that cannot be true", status.contradictions],
    ["Clock", status.clock_uncertainty_us === null ? "not synchronised" : `synchronised to ±${status.clock_uncertainty_us.toFixed(1)} µs`],
    ["Host watchdog", `${status.lease_ms.toFixed(0)} ms without the daemon stop the device; strokes are sent ${status.lead_ms.toFixed(0)} ms ahead`],
    ["Device runs", board ? `for ${(board.uptime_s / 60).toFixed(0)} min, started by ${board.reset}; ${plural(board.output_faults, "output fault")}, ${board.stalls ?? "no count of"} stalls` : "not known"],
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

function network({ network, role }) {
  const may = ["This window may", ROLES[role] ?? "not known"];
  if (!network) return [may, ["Listens on", "its socket only"]];
  const { address, problem, operate_tokens: operate, observe_tokens: observe, loopback_without_token: open, denied } = network;
  return [
    may,
    ["Listens on", problem ? `not on ${address}: ${problem}` : address],
    ["Tokens", `${operate} may operate, ${observe} may read`],
    ["Without a token", open ? "clients on the daemon's machine may do everything" : "nobody over the network"],
    ["Requests refused", denied],
  ];
}

function showStatus() {
  const status = known();
  if (status && performance.now() - asked >= COUNTERS_MS) loadCounters().catch(() => ((counters = null), showStatus()));
  for (const [id, describe] of [["facts", link], ["daemon-facts", daemon], ["network-facts", network]]) {
    // Keep the rows in place.
    const rows = last() ? describe(last()) : [];
    facts($(id), status ? rows : rows.map(([name]) => [name, "not known"]));
  }
}

function showArray() {
  const { name, hash, positions_mm: places, grid, pitch_mm: pitch, pin_radius_mm: radius, motor, duty, rails, chips, tick_hz: hz, toml } = array();
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
  write($("array-toml"), toml);
}

export function bindDevice() {
  part({ view: "device", at: "facts-title", load: loadCounters, state: showStatus, on: { connected: loadCounters, ended: loadCounters, disconnected: () => ((counters = null), showStatus()) } });
  document.addEventListener("array", showArray);
}
