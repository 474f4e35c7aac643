// The files of a recorded session: CSV with the columns of `meissner session export`, and JSON with the keys of its `--json`. The test
// of the page compares both with the command's files.

import { DISK_MS, exact } from "./api.js";
import { built } from "./control.js";

// A column: its name, and its value in a play's row. Null: not known.
const of = (name) => [name, ({ play }) => play[name]];
const COLUMNS = [
  ["session", ({ session }) => session.id],
  ...["participant", "experiment", "seed"].map((name) => [name, ({ session }) => session[name]]),
  ["session_labels", ({ session }) => labels(session.labels)],
  of("trial"),
  ["labels", ({ play }) => labels(play.labels)],
  ...["play", "user", "pattern", "pattern_sha256", "seconds", "state", "cause", "onset_tick", "onset_monotonic_ns", "onset_uncertainty_ns", "onset_wall_ns", "reported_after_s"].map(of),
  ...["planned", "played", "late", "dropped", "refused", "amended"].map((name) => [`bursts_${name}`, ({ play }) => play.bursts?.[name]]),
  ...["planned", "played"].map((name) => [`pulses_${name}`, ({ play }) => play.pulses?.[name]]),
  ...["worst_late_ms", "rest_error_max_um"].map(of),
  ...["started", "ended"].map((name) => [`session_${name}`, ({ session }) => session[name]]),
  ...["item", "scale", "ordered_um", "reached_um", "ordered_ms", "played_ms", "cut_after_ms", "offset_tick", "offset_monotonic_ns"].map(of),
  ["trigger_tick", ({ play }) => play.trigger?.tick],
  ["trigger_code", ({ play }) => play.trigger?.code],
  ["trigger_ms", ({ play }) => play.trigger?.width_ms],
  ...["late_strokes", "refused_strokes", "fit", "estimated", "array", "tick_hz", "first_pulse_tick"].map(of),
  ["response", ({ play }) => play.answer?.response],
  ["correct", ({ play }) => play.answer?.correct],
  ["response_time", ({ play }) => (typeof play.answer?.rt_ms === "number" ? play.answer.rt_ms / 1000 : null)],
  ["level", ({ play }) => play.answer?.level],
  ["start_edge", ({ play }) => play.start_edge?.number],
  ["start_edge_tick", ({ play }) => play.start_edge?.tick],
  ["stop_edge", ({ play }) => play.stop_edge?.number],
  ["stop_edge_tick", ({ play }) => play.stop_edge?.tick],
];

const labels = (of) => Object.entries(of).map(([key, value]) => `${key}=${value}`).join(";");

// A number without an exponent.
function decimal(number) {
  const [, sign, digits, rest = "", power] = /^(-?)(\d)(?:\.(\d+))?e([+-]\d+)$/.exec(String(number)) ?? [];
  if (power === undefined) return String(number);
  if (power > 0) return sign + (digits + rest).padEnd(1 + Number(power), "0");
  return `${sign}0.${(digits + rest).padStart(rest.length - Number(power), "0")}`;
}

function field(value) {
  const text = value === null || value === undefined ? "" : typeof value === "number" ? decimal(value) : String(value).replace(/^\u0000/, "");
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

// All recorded plays of a session, as `GET /v1/sessions/{id}/plays` shows them, with the integers of `exact`.
export async function readSession(id) {
  const plays = [];
  for (;;) {
    const part = await exact(`/v1/sessions/${encodeURIComponent(id)}/plays?from=${plays.length}`, DISK_MS);
    plays.push(...part.plays);
    if (!part.more || !part.plays.length) return { ...part, plays };
  }
}

// The text of a file, in parts.
export async function csv({ session, plays }) {
  const factors = [...new Set(plays.flatMap((play) => Object.keys(play.answer?.factors ?? {})))].sort();
  const columns = [...COLUMNS, ...factors.map((key) => [`factor_${key}`, ({ play }) => play.answer?.factors[key]])];
  const line = (fields) => `${fields.map(field).join(",")}\n`;
  // A sequence as a whole is no stimulus: its items have rows.
  const rows = await built(plays.filter((play) => play.items === 0), (play) => line(columns.map(([, value]) => value({ session, play }))));
  return [line(columns.map(([name]) => name)), ...rows];
}

export async function json({ plays, ...read }) {
  const text = (value, indent = "") => JSON.stringify(value, null, 1).replace(/"\\u0000(-?\d+)"/g, "$1").replaceAll("\n", `\n${indent}`);
  const rows = await built(plays, (play, i) => `${i ? "," : ""}\n  ${text(play, "  ")}`);
  return [text(read).slice(0, -2), ',\n "plays": [', ...rows, rows.length ? "\n ]\n}\n" : "]\n}\n"];
}
