// The view Record: sessions, and plays by pages. The tests use a real browser and a real daemon with the simulated array.

import assert from "node:assert/strict";
import { test } from "node:test";
import { answers, arm, browsing, Daemon, press, shows, text, view, WAIT } from "./daemon.js";

const { open } = browsing("record");

// What another client asks for, or orders.
async function other(daemon, method, path, body, headers = {}) {
  const answer = await fetch(daemon.url + path, { method, headers, body: body && JSON.stringify(body) });
  return { status: answer.status, ...(await answer.json()) };
}

const gone = (page, selector) => page.waitForFunction((selector) => !document.querySelector(selector).checkVisibility(), WAIT, selector);
const there = (page, selector) => page.waitForFunction((selector) => document.querySelector(selector).checkVisibility(), WAIT, selector);
const rows = (page, table) => page.$$eval(`#${table} tbody tr`, (rows) => rows.map((row) => [...row.cells].map((cell) => cell.textContent)));

async function type(page, id, value) {
  // On a busy machine the state grows old at times; then the form is hidden and takes no keys.
  do {
    await page.waitForFunction((id) => document.getElementById(id).checkVisibility(), WAIT, id);
    await page.$eval(`#${id}`, (field) => (field.value = ""));
    await page.type(`#${id}`, String(value));
  } while ((await page.$eval(`#${id}`, (field) => field.value)) !== String(value));
}

async function start(page, participant, { experiment = "edges", exclusive = false } = {}) {
  await there(page, "#session-form");
  await type(page, "participant", participant);
  await type(page, "experiment", experiment);
  await page.$eval("#exclusive", (box, is) => (box.checked = is), exclusive);
  await press(page, "#session-start");
  await shows(page, "session-facts", participant);
}

test("a window starts a session, owns it, also after a reload, and ends it (smoke)", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "session-note", "No session runs.");
  await shows(page, "sessions-none", "No session is recorded.");
  // Nothing is sent without a pseudonym.
  await press(page, "#session-start");
  await page.waitForSelector("#session-form .wrong");
  assert.equal((await daemon.status()).session, null);
  await type(page, "session-seed", 42);
  await type(page, "remark", "left-handed");
  await start(page, "P07", { exclusive: true });
  await shows(page, "owner", "Session of P07, by this window, exclusive");
  for (const part of ["P07", "edges", "this window", "only this window may change things", "42", "left-handed", "3600 s in this session; 600 s before a pause of 10 s"]) await shows(page, "session-facts", part);
  assert.equal((await other(daemon, "POST", "/v1/arm", { assume_rest: true })).code, "session-exclusive");
  await page.reload();
  await shows(page, "owner", "by this window");
  await arm(page);
  await view(page, "play");
  await page.type("#search", "pin-60");
  await page.$eval("#seconds", (field) => (field.value = "600"));
  await press(page, 'li[data-name="pin-60"]:not([hidden]) button');
  await shows(page, "state-text", "Playing pin-60");
  await view(page, "record");
  await shows(page, "session-end-note", "A play runs or waits: stop it to end the session.");
  assert.equal(await page.$eval("#session-end", (button) => button.disabled), true);
  await press(page, "#stop");
  await page.waitForSelector("#session-end:not([disabled])");
  await press(page, "#session-end");
  await there(page, "#session-form");
  await shows(page, "owner", "No session: plays belong to no participant");
  assert.equal((await rows(page, "sessions")).length, 1);
  // Its token is forgotten: the daemon would refuse every change with it.
  await press(page, "#disarm");
  await shows(page, "state-text", "Disarmed");
  await arm(page);
  // What the daemon says stands beside the button.
  await other(daemon, "POST", "/v1/sessions", { participant: "P08" });
  await page.evaluate(() => (document.getElementById("participant").value = "P09"));
  await shows(page, "session-facts", "P08");
  await page.evaluate(() => document.getElementById("session-form").requestSubmit());
  await answers(page, "#session-start", "Another session runs");
  assert.deepEqual(page.complaints.filter((line) => !line.includes("409")), []);
});

test("a session of another client is ended only after a question, and while it is exclusive the page offers what reads, stops and disarms", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  const { token } = await other(daemon, "POST", "/v1/sessions", { participant: "P02", exclusive: true });
  const owner = { "meissner-session": token };
  await shows(page, "may-not", "owns the exclusive session with P02: this window may read, stop and disarm.");
  await shows(page, "session-facts", "only its owner may change things, until it is silent for");
  for (const hidden of ["#arm", "#home", "#reset", "#session-end"]) await gone(page, hidden);
  for (const shown of ["#estop", "#stop", "#disarm"]) await there(page, shown);
  await other(daemon, "POST", "/v1/arm", { assume_rest: true }, owner);
  await other(daemon, "POST", "/v1/play", { pattern: "pin-60", seconds: 300 }, owner);
  await shows(page, "state-text", "Playing pin-60");
  await press(page, "#stop");
  await shows(page, "state-text", "Armed");
  await press(page, "#disarm");
  await shows(page, "state-text", "Disarmed");
  await other(daemon, "POST", "/v1/sessions/running/end", {}, owner);
  await there(page, "#session-form");
  await there(page, "#arm");
  const { id } = await other(daemon, "POST", "/v1/sessions", { participant: "P01" });
  await shows(page, "session-facts", "another client");
  await press(page, "#session-end");
  await shows(page, "session-dialog-text", "P01");
  await press(page, '#session-dialog [value="cancel"]');
  assert.equal((await daemon.status()).session.id, id);
  await press(page, "#session-end");
  await press(page, '#session-dialog [value="end"]');
  await shows(page, "session-note", "No session runs.");
  assert.equal((await daemon.status()).session, null);
});

test("a daemon that is killed and restarted ends the session, and the page forgets its token", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await start(page, "P03", { exclusive: true });
  await arm(page);
  await daemon.end("SIGKILL");
  await shows(page, "session-note", "Whether a session runs is not known.");
  await daemon.start();
  await shows(page, "owner", "No session");
  await answers(page, "#session-start", "The session of P03 is over.");
  await page.waitForFunction(() => document.querySelector("#sessions tbody tr")?.cells[4].textContent === "unknown", WAIT);
});

test("recorded sessions are filtered, and one shows its plays and answers (smoke)", async () => {
  const daemon = await new Daemon().start();
  await other(daemon, "POST", "/v1/arm", { assume_rest: true });
  const session = async (participant, plays, more = {}) => {
    const { id } = await other(daemon, "POST", "/v1/sessions", { participant, experiment: "edges", seed: 42, labels: { "a,b": 'x"y' }, ...more });
    for (const [route, body, answer] of plays) {
      const play = await other(daemon, "POST", route, body);
      assert.equal((await other(daemon, "GET", `/v1/plays/${play.id}?wait=60`)).state, "done");
      if (answer) assert.equal((await other(daemon, "POST", `/v1/plays/${play.id}/answer`, answer)).status, 200);
    }
    assert.equal((await other(daemon, "POST", `/v1/sessions/${id}/end`, {})).status, 200);
    return id;
  };
  await session("P04", []);
  const id = await session("P05", [
    ["/v1/play", { pattern: "pin-60", seconds: 0.1, trial: 1, labels: { side: "left" }, trigger: { code: 3 } }, { response: "left, then right", correct: true, rt_ms: 512.3, level: 1e-7, factors: { block: "2", area: "tip" } }],
    ["/v1/play", { items: [{ pattern: "pin-60", seconds: 0.1 }, { pattern: "edge-45", seconds: 0.1, gap_ms: 50 }], trial: 2 }, { response: "no", correct: false, factors: { block: "3" } }],
    ["/v1/play", { pattern: "edge-45", seconds: 0.1, scale: 0.3 }],
  ]);
  const page = await open(daemon);
  await page.waitForFunction(() => document.querySelectorAll("#sessions tbody tr").length === 2, WAIT);
  await page.type("#record-filter", "P05 edges");
  assert.deepEqual((await rows(page, "sessions")).map((row) => row[1]), ["P05"]);
  await page.type("#record-filter", "x");
  assert.deepEqual([await rows(page, "sessions"), await text(page, "sessions-none")], [[], "No session fits."]);
  await type(page, "record-filter", "P05");
  await press(page, "#sessions button");
  await shows(page, "plays-title", "Session of P05");
  const shown = await rows(page, "play-rows");
  assert.deepEqual(shown.map(([play, trial, pattern, labels]) => [play, trial, pattern, labels]), [["1", "1", "pin-60", "side=left"], ["2", "2", "sequence: pin-60, edge-45", ""], ["3", "", "edge-45", ""]]);
  assert.deepEqual(shown.map((row) => row.slice(7)), [["left, then right", "right", "512", "1e-7"], ["no", "wrong", "", ""], ["", "", "", ""]]);
  assert.deepEqual(await page.$$eval("#plays-back, #plays-next", (buttons) => buttons.map((button) => button.disabled)), [true, true]);
  assert.ok((await text(page, "bids-command")).includes(`export_bids("${id}", "dataset")`));
});
