// The view Record: the recorded sessions, and one of them with its plays and answers.
//
// A session may have thousands of plays. The daemon answers with some of them, and the table has a page of these.

import { call } from "./api.js";
import { element, facts, refuse, say, valid, write } from "./control.js";
import { bindExperiment } from "./experiment.js";
import { csv, json, READ_MS, readSession } from "./export.js";
import { bindSession } from "./session.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);
// Rows of a page, and sessions of the list.
const PAGE = 100;
const LISTED = 200;

let sessions = [];
// The chosen session: its id, and rows of its plays as the daemon answered: `{ from, plays, more, ... }`.
let chosen = null;
let rows = null;

const when = (instant) => instant.slice(0, 19).replace("T", " ");

async function load() {
  const { sessions: all, unreadable } = await call("GET", "/v1/sessions", undefined, READ_MS);
  sessions = all.reverse();
  write($("sessions-problem"), unreadable ? `${unreadable} lines of the session record cannot be read.` : "");
  list();
  if (chosen) await choose(chosen);
}

function list() {
  const words = $("record-filter").value.toLowerCase().split(/\s+/);
  const about = (session) => `${session.participant} ${session.experiment ?? ""} ${session.started}`.toLowerCase();
  const found = sessions.filter((session) => words.every((word) => about(session).includes(word)));
  $("sessions").tBodies[0].replaceChildren(...found.slice(0, LISTED).map(sessionRow));
  const more = found.length > LISTED ? `The newest ${LISTED} of ${found.length}: filter for others.` : "";
  write($("sessions-none"), found.length ? more : sessions.length ? "No session fits." : "No session is recorded.");
  $("sessions-none").hidden = found.length > 0 && !more;
}

function sessionRow(session) {
  const row = element("tr");
  const show = element("button", "Show", { type: "button" });
  show.setAttribute("aria-label", `Show the session of ${session.participant}, ${when(session.started)}`);
  show.addEventListener("click", async () => {
    try {
      await choose(session.id);
      say(show, "");
      $("plays-title").focus();
    } catch (error) {
      refuse(show, error);
    }
  });
  if (session.id === chosen) row.ariaSelected = "true";
  row.append(...[when(session.started), session.participant, session.experiment ?? "", session.plays, session.reason ?? "runs"].map((text) => element("td", String(text))), element("td"));
  row.lastChild.append(show);
  return row;
}

// Shows a session from its first row on, or, if it is shown already, from the same row on.
async function choose(id) {
  if (id !== chosen) $("plays-from").value = 1;
  [chosen, rows] = [id, null];
  await turn();
  list();
}

// Shows what has come to the chosen session.
async function refresh() {
  rows = null;
  if (chosen) await turn();
}

// Shows the page of plays that begins with the row that the field names.
async function turn() {
  const [id, from] = [chosen, $("plays-from").valueAsNumber - 1];
  const isThere = rows && from >= rows.from && (from + PAGE <= rows.from + rows.plays.length || !rows.more);
  if (!isThere) {
    const found = await call("GET", `/v1/sessions/${encodeURIComponent(id)}/plays?from=${from}`, undefined, READ_MS);
    if (id !== chosen) return;
    rows = { ...found, from };
  }
  showPlays(from);
}

function showPlays(from) {
  const { session, missing } = rows;
  $("plays").hidden = false;
  write($("plays-title"), `Session of ${session.participant}`);
  facts($("plays-facts"), [
    ["Experiment", session.experiment ?? "none named"], ["Started, ended", `${when(session.started)}, ${session.ended ? when(session.ended) : session.reason ? "not known" : "it runs"}`],
    ["Plays, vibration", `${session.plays}, ${session.vibration_s.toFixed(1)} s`], ["Seed", session.seed ?? "none"],
    ["Missing in the record", missing.length ? missing.join("; ") : "nothing"],
  ]);
  write($("bids-command"), `python3 -c 'import meissner; meissner.connect().export_bids("${session.id}", "dataset")'`);
  const shown = rows.plays.slice(from - rows.from, from - rows.from + PAGE);
  $("play-rows").tBodies[0].replaceChildren(...shown.map(playRow));
  write($("plays-none"), shown.length ? `Rows ${from + 1} to ${from + shown.length}. An item of a sequence has a row of its own.` : from ? `There is no row ${from + 1}.` : "No play is recorded.");
  $("plays-back").disabled = from === 0;
  $("plays-next").disabled = !rows.more && from + PAGE >= rows.from + rows.plays.length;
}

function playRow(play) {
  const { answer } = play;
  const judged = { true: "right", false: "wrong" }[answer?.correct] ?? "";
  const row = element("tr");
  const labels = Object.entries(play.labels).map(([key, value]) => `${key}=${value}`).join("; ");
  const cells = [
    play.item === null ? play.play : `${play.play}, item ${play.item}`, play.trial ?? "", play.pattern, labels, play.cause ? `${play.state} (${play.cause})` : play.state,
    play.played_ms?.toFixed(1) ?? "", play.late_strokes ?? "", answer?.response ?? "", judged, answer?.rt_ms?.toFixed(0) ?? "", answer?.level ?? "",
  ];
  row.append(...cells.map((text) => element("td", String(text))));
  return row;
}

// Saves the chosen session as a file.
async function download(button, kind, write) {
  button.disabled = true;
  say(button, "The daemon reads its record …", "wait");
  try {
    const read = await readSession(chosen);
    const url = URL.createObjectURL(new Blob([write(read)], { type: kind }));
    const name = `session-${read.session.id}${read.complete ? "" : "-incomplete"}.${kind.split("/")[1]}`;
    element("a", "", { href: url, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
    say(button, read.complete ? `Saved as ${name}.` : `Saved as ${name}. It is incomplete: ${read.missing.join("; ")}.`, read.complete ? "good" : "bad");
  } catch (error) {
    refuse(button, error);
  }
  button.disabled = false;
}

export function bindRecord() {
  bindSession();
  bindExperiment();
  part({ view: "record", at: "record-title", load, on: { "session-started": load, "session-ended": load, ended: ({ receipt }) => receipt.session === chosen && refresh() } });
  document.addEventListener("answered", () => refresh().catch((error) => refuse($("plays-next"), error)));
  $("record-filter").addEventListener("input", list);
  const page = (first) => () => {
    if (first !== undefined) $("plays-from").value = Math.max(1, $("plays-from").valueAsNumber + first || 1);
    if (valid("plays-from")) turn().then(() => say($("plays-next"), ""), (error) => refuse($("plays-next"), error));
  };
  $("plays-back").addEventListener("click", page(-PAGE));
  $("plays-next").addEventListener("click", page(PAGE));
  $("plays-from").addEventListener("change", page());
  $("save-csv").addEventListener("click", () => download($("save-csv"), "text/csv", csv));
  $("save-json").addEventListener("click", () => download($("save-json"), "application/json", json));
}
