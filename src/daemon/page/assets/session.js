// The running session: start one, end it, and whose it is.
//
// The daemon gives the window that starts a session its token. `estop.js` sends it with each request, also after a reload. When the
// session is over it is forgotten, because the daemon refuses all changes of a client that still shows it.

import { call, known, poll } from "./api.js";
import { $, element, facts, open, refuse, say, write } from "./control.js";
import { optional, right } from "./number.js";
import { part } from "./views.js";
import { sentence } from "./words.js";

// Where `estop.js` finds the token, and whose it is.
const TOKEN = "meissner-session";
const ABOUT = "meissner-session-about";

// Whether a state has shown the session: one that was requested before the start does not know it.
let isSeen = true;

const about = () => JSON.parse(sessionStorage.getItem(ABOUT));

function forget() {
  for (const key of [TOKEN, ABOUT]) sessionStorage.removeItem(key);
}

// Forgets the token of a session that is over.
function watch() {
  const [status, mine] = [known(), about()];
  if (!status || !mine) return;
  if (status.session?.id === mine.id) isSeen = true;
  if (status.session?.id === mine.id || !isSeen) return;
  forget();
  say($("session-start"), `The session of ${mine.participant} is over.`, "bad");
}

// What is left of the participant's limits, and which of them is the nearest.
function leftWords({ session_left_s: session, day_left_s: day, continuous_left_s: continuous, pause_s: pause }) {
  const whole = session !== null && session < day ? `${session.toFixed(0)} s in this session` : `${day.toFixed(0)} s today`;
  return `${whole}; ${continuous.toFixed(0)} s before a pause of ${pause.toFixed(0)} s`;
}

function describe(session, limits) {
  const { participant, experiment, owner, mine, exclusive, released, release_in_s: left } = session;
  const who = mine ? "this window" : `another client${owner ? `, ${owner}` : ""}`;
  const share = !exclusive ? "no: every client may change things"
    : released ? "no longer: its owner was silent, so others may act"
      : `only ${mine ? "this window" : "its owner"} may change things${mine || left === null ? "" : `, until it is silent for ${left.toFixed(0)} s more`}`;
  return [
    ["Participant", participant], ["Experiment", experiment ?? "none named"], ["Started", session.started.slice(0, 19).replace("T", " ")], ["Started by", who],
    ["Exclusive", share], ["Seed", session.seed ?? "none"], ...(session.labels.note ? [["Note", session.labels.note]] : []), ["Plays", session.plays],
    ["Vibration", `${session.vibration_s.toFixed(1)} s`], ["Vibration left", leftWords(limits)],
  ];
}

function show() {
  const status = known();
  const session = status?.session;
  $("session-form").hidden = !status || Boolean(session);
  $("session-running").hidden = !session;
  write($("session-note"), !status ? "Whether a session runs is not known." : !session ? "No session runs." : session.record_problem ? `The daemon cannot record this session now: ${sentence(session.record_problem)}` : "");
  if (!session) return;
  facts($("session-facts"), describe(session, status.participant));
  const isBusy = Boolean(status.play || status.queued.length);
  $("session-end").disabled = isBusy;
  write($("session-end-note"), isBusy ? "A play runs or waits: stop it to end the session." : "");
}

async function start() {
  if (!right("participant", "experiment", "session-seed", "remark")) return;
  const [participant, experiment, note] = ["participant", "experiment", "remark"].map((id) => $(id).value.trim());
  const seed = optional("session-seed");
  try {
    const { id, token, record_problem: problem } = await call("POST", "/v1/sessions", { participant, exclusive: $("exclusive").checked, ...(experiment ? { experiment } : {}), ...(note ? { labels: { note } } : {}), seed });
    isSeen = false;
    sessionStorage.setItem(TOKEN, token);
    sessionStorage.setItem(ABOUT, JSON.stringify({ id, participant }));
    say($("session-start"), "");
    say($("session-end"), problem ? `The daemon does not record this session: ${sentence(problem)}` : "", "bad");
  } catch (error) {
    refuse($("session-start"), error);
  }
  poll();
}

// Ends the session that the page shows.
async function end(id) {
  try {
    await call("POST", `/v1/sessions/${encodeURIComponent(id)}/end`, {});
    if (about()?.id === id) forget();
    for (const button of ["session-start", "session-end"]) say($(button), "");
  } catch (error) {
    refuse($("session-end"), error);
  }
  poll();
}

export function bindSession() {
  part({ view: "record", at: "session-title", state: show });
  document.addEventListener("state", watch);
  $("session-form").addEventListener("submit", (event) => (event.preventDefault(), start()));
  const dialog = $("session-dialog");
  $("session-end").addEventListener("click", () => {
    const session = known()?.session;
    if (!session) return;
    if (session.mine) return end(session.id);
    dialog.dataset.id = session.id;
    $("session-dialog-text").replaceChildren("Another client has started the session of ", element("strong", session.participant), ". Its program may still play. Ending it cannot be taken back.");
    open(dialog);
  });
  dialog.addEventListener("close", () => dialog.returnValue === "end" && end(dialog.dataset.id));
}
