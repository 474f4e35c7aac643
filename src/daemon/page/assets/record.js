// The view Record: the recorded sessions, and one of them with its plays and answers.
//
// A session may have thousands of plays. The daemon answers with some of them, and the table has a page of these.

import { call, DISK_MS } from "./api.js";
import { $, element, facts, refuse, say, write } from "./control.js";
import { number, right } from "./number.js";
import { bindSession } from "./session.js";
import { part } from "./views.js";

// Plays of a page, and sessions of the list.
const PAGE = 100;
const LISTED = 100;

let sessions = [];
// The session that the table shows, its first play, counted from 0, and the first one of the next page: `{ id, from, to }`.
let shown = null;
// What is to be shown: what a person has asked for last. As long as the daemon has not answered, or has failed to, it is not shown.
let wanted = null;
// Plays of the shown session, as the daemon answered: `{ from, plays, more, ... }`. Null: they must be fetched.
let rows = null;

const when = (instant) => instant.slice(0, 19).replace("T", " ");

async function load() {
  const { sessions: all, unreadable, problems } = await call("GET", "/v1/sessions", undefined, DISK_MS);
  sessions = all.reverse();
  write($("sessions-problem"), unreadable ? `The session record has ${unreadable} problems: ${problems.slice(0, 5).join("; ")}${unreadable > 5 ? "; …" : ""}` : "");
  list();
  await refresh();
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
      const isShown = session.id === shown?.id;
      if (isShown) rows = null;
      await turn(session.id, isShown ? shown.from : 0);
      say(show, "");
      $("plays-title").focus();
    } catch (error) {
      refuse(show, error);
    }
  });
  if (session.id === shown?.id) row.ariaSelected = "true";
  row.append(...[when(session.started), session.participant, session.experiment ?? "", session.plays, session.reason ?? "runs"].map((text) => element("td", String(text))), element("td"));
  row.lastChild.append(show);
  return row;
}

// Shows what has come to the session.
async function refresh() {
  rows = null;
  if (wanted) await turn(wanted.id, wanted.from);
}

// Shows a session from a play on. Until the daemon has answered, the table is that of before; and an answer counts only
// if nothing else was asked for meanwhile.
async function turn(id, from) {
  const mine = (wanted = { id, from });
  const isThere = id === shown?.id && rows && from >= rows.from && (from + PAGE <= rows.from + rows.plays.length || !rows.more);
  if (!isThere) {
    let found;
    try {
      found = await call("GET", `/v1/sessions/${encodeURIComponent(id)}/plays?from=${from}`, undefined, DISK_MS);
    } catch (error) {
      if (mine !== wanted) return;
      wanted = shown;
      throw error;
    }
    if (mine !== wanted) return;
    rows = { ...found, from };
  }
  const before = shown;
  shown = mine;
  if (id !== before?.id || from !== before.from) $("plays-from").value = from + 1;
  showPlays(mine);
  if (id !== before?.id) list();
}

function showPlays(page, from = page.from) {
  const { session, missing } = rows;
  $("plays").hidden = false;
  write($("plays-title"), `Session of ${session.participant}`);
  facts($("plays-facts"), [
    ["Experiment", session.experiment ?? "none named"], ["Started, ended", `${when(session.started)}, ${session.ended ? when(session.ended) : session.reason ? "not known" : "it runs"}`],
    ["Plays, vibration", `${session.plays}, ${session.vibration_s.toFixed(1)} s`], ["Seed", session.seed ?? "none"],
    ["Missing in the record", missing.length ? missing.join("; ") : "nothing"],
  ]);
  write($("csv-command"), `meissner session export ${session.id} -o session.csv`);
  write($("bids-command"), `python3 -c 'import meissner; meissner.connect().export_bids("${session.id}", "dataset")'`);
  const plays = rows.plays.slice(from - rows.from, from - rows.from + PAGE);
  page.to = from + plays.length;
  $("play-rows").tBodies[0].replaceChildren(...plays.map(playRow));
  write($("plays-none"), plays.length ? `Plays ${from + 1} to ${page.to}.` : from ? `There is no play ${from + 1}.` : "No play is recorded.");
  $("plays-back").disabled = from === 0;
  $("plays-next").disabled = !rows.more && page.to >= rows.from + rows.plays.length;
}

function playRow({ receipt, answer }) {
  const { name, items, order: { trial, labels: given }, counts: { lateness } } = receipt;
  // The first patterns of several.
  const patterns = items?.length > 1 ? `: ${items.slice(0, 5).map((item) => item.pattern).join(", ")}${items.length > 5 ? ", …" : ""}` : "";
  const judged = { true: "right", false: "wrong" }[answer?.correct] ?? "";
  const row = element("tr");
  const labels = Object.entries(given ?? {}).map(([key, value]) => `${key}=${value}`).join("; ");
  const cells = [
    receipt.id, trial ?? "", name + patterns, labels, receipt.cause ? `${receipt.state} (${receipt.cause})` : receipt.state,
    receipt.duration_ms.played?.toFixed(1) ?? "", lateness.host + lateness.link + lateness.device, answer?.response ?? "", judged, answer?.rt_ms?.toFixed(0) ?? "", answer?.level ?? "",
  ];
  row.append(...cells.map((text) => element("td", String(text))));
  return row;
}

export function bindRecord() {
  bindSession();
  part({ view: "record", at: "record-title", load, on: { "session-started": load, "session-ended": load, ended: ({ receipt }) => receipt.order.session === wanted?.id && refresh() } });
  $("record-filter").addEventListener("input", list);
  const page = (from) => turn(shown.id, Math.max(0, from)).then(() => say($("plays-next"), ""), (error) => {
    $("plays-from").value = shown.from + 1;
    refuse($("plays-next"), error);
  });
  // The page that was asked for last, if it is one of the shown session.
  const last = () => (wanted.id === shown.id ? wanted : shown);
  $("plays-back").addEventListener("click", () => page(last().from - PAGE));
  $("plays-next").addEventListener("click", () => page(last().to ?? last().from + PAGE));
  $("plays-from").addEventListener("change", () => right("plays-from") && page(number("plays-from") - 1));
}
