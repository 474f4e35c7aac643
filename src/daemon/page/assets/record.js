// What was played: the last receipt and the recorded sessions.

import { call } from "./api.js";
import { element, facts } from "./control.js";

const $ = (id) => document.getElementById(id);
// Plays that an answer of the daemon has, at most.
const ROWS = 2000;

export function showReceipt(receipt) {
  // A running play has no counts yet.
  if (!receipt.bursts) return;
  const { bursts, lateness, duration_ms: ms, predicted_response: response } = receipt;
  const lost = bursts.late + bursts.dropped + bursts.refused;
  $("receipt-summary").textContent = `Play ${receipt.id}, ${receipt.pattern}: ${receipt.state}${receipt.cause ? ` (${receipt.cause})` : ""}. `
    + (lost ? `${lost} of ${bursts.planned} bursts were not played.` : `All ${bursts.planned} bursts were played.`);
  const rest = receipt.rest_error_um?.length ? Math.max(...receipt.rest_error_um.map(Math.abs)) : null;
  const worst = lateness.worst_ms ?? 0;
  const hz = ({ contrast, all }) => `${(contrast ?? all).toFixed(1)} impulses/s`;
  const classes = response?.afferents ?? [];
  const what = response?.played_hz?.contrast === null ? "mean rate" : "on-target minus off-target";
  facts($("receipt-facts"), [
    ...(receipt.mapped_from === null ? [] : [["Mapped by position", `from the array ${receipt.mapped_from} to ${receipt.array}`]]),
    ["Bursts played, late, dropped, refused", `${bursts.played}, ${bursts.late}, ${bursts.dropped}, ${bursts.refused}`],
    ["Corrected by feedback", bursts.amended],
    ["Largest lateness", `${worst.toFixed(2)} ms`],
    ["Duration played, ordered", `${ms.played?.toFixed(1) ?? "-"} ms, ${ms.ordered?.toFixed(1) ?? "without end"} ms`],
    ["Largest offset from rest at the end", rest === null ? "not known" : `${rest.toFixed(1)} µm`],
    [`Predicted RA response, ${what}`, response
      ? `${hz(response.played_hz)} (designed: ${hz(response.designed_hz)})`
      : receipt.predicted_response_unknown ?? "not ready"],
    ...classes.map((of) => [
      `Second model, ${of.class}, ${what}`, `${hz(of.played_hz)} (designed: ${hz(of.designed_hz)})`,
    ]),
  ]);
  $("receipt-more").hidden = false;
  $("receipt-json").textContent = JSON.stringify(receipt, null, 1);
}

let sessions = [];

export async function loadSessions() {
  ({ sessions } = await call("GET", "/v1/sessions"));
  listSessions();
}

function listSessions() {
  const words = $("record-filter").value.toLowerCase().split(/\s+/);
  const about = (session) => `${session.participant} ${session.experiment ?? ""} ${session.started}`.toLowerCase();
  const found = sessions.filter((session) => words.every((word) => about(session).includes(word))).reverse();
  $("sessions").tBodies[0].replaceChildren(...found.slice(0, 200).map((session) => {
    const row = document.createElement("tr");
    const save = element("button", "JSON");
    save.setAttribute("aria-label", `Download session of ${session.participant}, ${session.started}`);
    save.addEventListener("click", () => download(session).then(
      (missing) => missing.length > 0 && (save.textContent = `Incomplete: ${missing.join("; ")}`),
      (error) => (save.textContent = error.message),
    ));
    const cells = [session.started.slice(0, 19).replace("T", " "), session.participant, session.experiment ?? "", session.plays, session.reason ?? "runs"];
    row.append(...cells.map((text) => element("td", String(text))), document.createElement("td"));
    row.lastChild.append(save);
    return row;
  }));
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

$("record-filter").addEventListener("input", listSessions);
