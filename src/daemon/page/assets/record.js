// The recorded sessions.

import { call } from "./api.js";
import { element, refuse, say } from "./control.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);
// Plays that an answer of the daemon has, at most.
const ROWS = 2000;

let sessions = [];

async function load() {
  ({ sessions } = await call("GET", "/v1/sessions"));
  list();
}

function list() {
  const words = $("record-filter").value.toLowerCase().split(/\s+/);
  const about = (session) => `${session.participant} ${session.experiment ?? ""} ${session.started}`.toLowerCase();
  const found = sessions.filter((session) => words.every((word) => about(session).includes(word))).reverse();
  $("sessions").tBodies[0].replaceChildren(...found.slice(0, 200).map((session) => {
    const row = document.createElement("tr");
    const save = element("button", "JSON");
    save.setAttribute("aria-label", `Download session of ${session.participant}, ${session.started}`);
    save.addEventListener("click", () => download(session).then(
      (missing) => say(save, missing.length ? `Incomplete: ${missing.join("; ")}` : "", "bad"),
      (error) => refuse(save, error),
    ));
    const cells = [session.started.slice(0, 19).replace("T", " "), session.participant, session.experiment ?? "", session.plays, session.reason ?? "runs"];
    row.append(...cells.map((text) => element("td", String(text))), document.createElement("td"));
    row.lastChild.append(save);
    return row;
  }));
  $("sessions-none").hidden = found.length > 0;
  $("sessions-none").textContent = sessions.length ? "No session fits." : "No session is recorded.";
}

async function download(session) {
  const plays = [];
  let part;
  do {
    part = await call("GET", `/v1/sessions/${encodeURIComponent(session.id)}/plays?from=${plays.length}`);
    plays.push(...part.plays);
  } while (part.plays.length === ROWS);
  const { complete, missing, plays_missing, lost, left_out } = part;
  const text = JSON.stringify({ session: part.session, complete, missing, plays_missing, lost, left_out, plays }, null, 1);
  const url = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  element("a", "", { href: url, download: `session-${session.id}${complete ? "" : "-incomplete"}.json` }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
  return missing;
}

export function bindRecord() {
  part({ view: "record", at: "record-title", load, on: { "session-started": load, "session-ended": load } });
  $("record-filter").addEventListener("input", list);
}
