// The view Record: sessions, the two-interval experiment, plays by pages, and files. The tests use a real browser and a real daemon with
// the simulated array.

import assert from "node:assert/strict";
import { test } from "node:test";
import { order, wilson } from "../../src/daemon/page/assets/choice.js";
import { answers, arm, browsing, Daemon, press, proxied, shows, text, view, WAIT } from "./daemon.js";

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

// The files that the page has saved, as texts with their names.
async function collect(page) {
  await page.evaluateOnNewDocument(() => {
    globalThis.saved = [];
    URL.createObjectURL = (blob) => (saved.push(blob), "blob:kept");
    HTMLAnchorElement.prototype.click = function () {
      saved.at(-1).named = this.download;
    };
  });
  await page.reload();
}
const saved = (page, count) => page.waitForFunction((count) => saved.length === count, WAIT, count).then(() => page.evaluate(() => Promise.all(saved.map(async (blob) => [blob.named, await blob.text()]))));

test("the order of trials is balanced and that of its seed, and the interval is Wilson's", () => {
  for (const trials of [1, 2, 7, 20, 101]) {
    const firsts = order(trials, 5);
    const count = firsts.filter(Boolean).length;
    assert.deepEqual([firsts.length, Math.abs(2 * count - trials) <= 1], [trials, true]);
    assert.deepEqual(order(trials, 5), firsts);
  }
  assert.notDeepEqual(order(40, 1), order(40, 2));
  // Of an odd number either is the more frequent one.
  const more = Array.from({ length: 20 }, (_, seed) => order(3, seed).filter(Boolean).length);
  assert.deepEqual([...new Set(more)].sort(), [1, 2]);
  // Newcombe (Stat. Med. 17, 857-872, 1998), table I: 81 of 263, and 0 of 20.
  assert.deepEqual(wilson(81, 263).map((share) => share.toFixed(4)), ["0.2553", "0.3662"]);
  assert.deepEqual(wilson(0, 20).map((share) => share.toFixed(4)), ["0.0000", "0.1611"]);
});

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
  for (const hidden of ["#arm", "#home", "#reset", "#session-end", "#choice-title"]) await gone(page, hidden);
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
  await page.$eval("#stimulus-s", (field) => (field.value = "0.1"));
  await press(page, "#choice-start");
  await shows(page, "choice-prompt", "Which interval");
  await page.keyboard.press("ArrowLeft");
  await shows(page, "choice-count", "1 of 20");
  await shows(page, "choice-prompt", "Which interval");
  await daemon.end("SIGKILL");
  await page.keyboard.press("ArrowLeft");
  await shows(page, "choice-prompt", "The daemon does not answer.");
  await shows(page, "session-note", "Whether a session runs is not known.");
  await daemon.start();
  await shows(page, "owner", "No session");
  await answers(page, "#session-start", "The session of P03 is over.");
  await shows(page, "choice-prompt", "The experiment has ended: its session is over.");
  await gone(page, "#choice-go");
  await shows(page, "choice-result", "of 1 answers right");
  await page.waitForFunction(() => document.querySelector("#sessions tbody tr")?.cells[4].textContent === "unknown", WAIT);
  await arm(page);
  await press(page, "#choice-new");
  await there(page, "#choice-form");
});

test("recorded sessions are filtered, and one shows its plays, answers and the command's files (smoke)", async () => {
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
  await collect(page);
  await page.waitForFunction(() => document.querySelectorAll("#sessions tbody tr").length === 2, WAIT);
  await page.type("#record-filter", "P05 edges");
  assert.deepEqual((await rows(page, "sessions")).map((row) => row[1]), ["P05"]);
  await page.type("#record-filter", "x");
  assert.deepEqual([await rows(page, "sessions"), await text(page, "sessions-none")], [[], "No session fits."]);
  await type(page, "record-filter", "P05");
  await press(page, "#sessions button");
  await shows(page, "plays-title", "Session of P05");
  const shown = await rows(page, "play-rows");
  assert.deepEqual(shown.map(([play, trial, pattern, labels]) => [play, trial, pattern, labels]), [["1", "1", "pin-60", "side=left"], ["2", "2", "sequence", ""], ["2, item 0", "2", "pin-60", ""], ["2, item 1", "2", "edge-45", ""], ["3", "", "edge-45", ""]]);
  assert.deepEqual(shown.map((row) => row.slice(7)), [["left, then right", "right", "512", "1e-7"], ...Array(3).fill(["no", "wrong", "", ""]), ["", "", "", ""]]);
  assert.deepEqual(await page.$$eval("#plays-back, #plays-next", (buttons) => buttons.map((button) => button.disabled)), [true, true]);
  assert.ok((await text(page, "bids-command")).includes(`export_bids("${id}", "dataset")`));
  await press(page, "#save-csv");
  await answers(page, "#save-csv", `Saved as session-${id}.csv.`);
  await press(page, "#save-json");
  await answers(page, "#save-json", `Saved as session-${id}.json.`);
  const [[csvName, csv], [jsonName, json]] = await saved(page, 2);
  assert.deepEqual([csvName, jsonName], [`session-${id}.csv`, `session-${id}.json`]);
  assert.equal(csv.trim(), await daemon.run("session", "export", id));
  // Integers beyond 2^53 are in both as they are.
  const [fromPage, fromCommand] = [json, await daemon.run("session", "export", id, "--json")].map((text) => text.replace(/(?<![\d."])\d{16,}(?![\d."])/g, '"$&"'));
  assert.match(fromPage, /"\d{19}"/);
  assert.deepEqual(JSON.parse(fromPage), JSON.parse(fromCommand));
});

// Sets the experiment up, with short stimuli.
async function setUp(page, settings = {}, [asked, other] = ["pin-60", "edge-45"]) {
  const values = { trials: 4, "choice-seed": 7, "stimulus-s": 0.1, "between-ms": 20, "pause-s": 0, ...settings };
  await page.waitForFunction(() => document.querySelectorAll("#asked option").length > 1, WAIT);
  for (const [id, value] of Object.entries(values)) await page.$eval(`#${id}`, (field, value) => (field.value = value), String(value));
  await page.select("#asked", asked);
  await page.select("#other", other);
  await page.waitForSelector("#choice-start:not([disabled])");
  await press(page, "#choice-start");
}
const KEYS = { true: "ArrowLeft", false: "ArrowRight" };
// Answers a trial, right or wrong, and waits until the daemon has the answer.
async function answer(page, isRight, isFirst, count) {
  // On a busy machine the state grows old at times, which pauses the experiment.
  await page.waitForFunction(() => {
    const [prompt, go] = ["choice-prompt", "choice-go"].map((id) => document.getElementById(id));
    if (prompt.textContent.startsWith("Paused. The state is not known.") && !go.disabled) go.click();
    return prompt.textContent.includes("Which interval had pin-60?");
  }, WAIT);
  await page.keyboard.press(KEYS[isFirst === isRight]);
  await shows(page, "choice-count", `${count} of`);
}

test("an experiment plays its trials, takes answers after the stimulus, and exports them (smoke)", async () => {
  const daemon = await new Daemon().start();
  const held = [];
  let holds = true;
  const through = (request, response, forward) => (holds && request.url.includes("?wait=") ? held.push(forward) : forward());
  await proxied(daemon, through, async (url) => {
    const page = await open({ url });
    await shows(page, "choice-note", "No session runs: start one.");
    assert.equal(await page.$eval("#choice-start", (button) => button.disabled), true);
    await start(page, "P10");
    await shows(page, "choice-note", "The motors are not armed: press Arm.");
    await arm(page);
    // Keys are chosen by pressing them.
    await page.focus("#key-first");
    await page.keyboard.press("ArrowRight");
    assert.equal(await page.$eval("#key-first", (field) => field.value), "ArrowRight");
    await setUp(page);
    await answers(page, "#choice-start", "Choose two keys that differ.");
    await page.focus("#key-first");
    await page.keyboard.press("ArrowLeft");
    // Without seconds each pattern runs once, so one without end needs them.
    await setUp(page, { "stimulus-s": "" });
    await answers(page, "#choice-start", "pin-60 has no end: enter the seconds of each pattern.");
    await setUp(page);
    const firsts = order(4, 7);
    // What would tell the answer is out of sight, and a key before the end of the stimulus is no answer.
    assert.equal(await page.$eval(".finger", (finger) => getComputedStyle(finger).visibility), "hidden");
    await shows(page, "choice-prompt", "Feel both intervals.");
    const until = Date.now() + WAIT.timeout;
    while (!held.length) {
      assert.ok(Date.now() < until);
      await new Promise((done) => setTimeout(done, 20));
    }
    await page.keyboard.press("ArrowLeft");
    assert.deepEqual(await page.$$eval(".answers button", (buttons) => buttons.map((button) => button.disabled)), [true, true]);
    holds = false;
    held.splice(0).forEach((forward) => forward());
    await shows(page, "choice-prompt", "Which interval had pin-60? ← first, → second.");
    assert.equal(await text(page, "choice-count"), "0 of 4 answers");
    await answer(page, true, firsts[0], 1);
    await answer(page, false, firsts[1], 2);
    await answer(page, true, firsts[2], 3);
    // A button answers, too.
    await page.waitForSelector("#answer-first:not([disabled])");
    await press(page, firsts[3] ? "#answer-first" : "#answer-second");
    await shows(page, "choice-prompt", "All trials are answered.");
    assert.equal(await page.$eval(".finger", (finger) => getComputedStyle(finger).visibility), "visible");
    assert.equal(await text(page, "choice-result"), "3 of 4 answers right: 75.0 %, 95 % interval 30.1 to 95.4 % (Wilson). Chance: 50 %.");
    await press(page, "#session-end");
    await there(page, "#session-form");
    const [{ id }] = (await other(daemon, "GET", "/v1/sessions")).sessions;
    const [head, ...lines] = (await daemon.run("session", "export", id)).split("\n").map((line) => line.split(","));
    const column = (name) => lines.map((line) => line[head.indexOf(name)]);
    const names = firsts.map((first) => (first ? ["pin-60", "edge-45"] : ["edge-45", "pin-60"]));
    // A row for each interval.
    assert.deepEqual(column("pattern"), names.flat());
    assert.deepEqual(column("trial"), ["1", "1", "2", "2", "3", "3", "4", "4"]);
    assert.deepEqual(column("labels"), names.flatMap(([first, second]) => Array(2).fill(`first=${first};second=${second}`)));
    const right = [true, false, true, true];
    assert.deepEqual(column("correct"), right.flatMap((is) => [String(is), String(is)]));
    assert.deepEqual(column("response"), right.flatMap((is, i) => Array(2).fill(is === firsts[i] ? "first" : "second")));
    assert.deepEqual([...new Set(column("factor_asked"))], ["pin-60"]);
    assert.ok(column("response_time").every((time) => Number(time) >= 0 && time !== ""));
    assert.deepEqual(page.complaints, []);
  });
});

test("an experiment pauses by Escape, a reload, another view and E-STOP, and repeats the trial without an answer", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await start(page, "P11");
  await arm(page);
  const firsts = order(4, 7);
  const still = async () => {
    const until = Date.now() + WAIT.timeout;
    for (let status = null; !status || status.play || status.queued.length; status = await daemon.status()) assert.ok(Date.now() < until);
  };
  await setUp(page, { "stimulus-s": 60 });
  // Escape in the middle of a stimulus stops the pins.
  await shows(page, "state-text", "Playing trial-1");
  await page.keyboard.press("Escape");
  await shows(page, "choice-prompt", "Paused. Stopped with Escape.");
  await still();
  assert.equal((await daemon.status()).state, "armed", "no emergency stop");
  await press(page, "#choice-new");
  await setUp(page);
  await answer(page, true, firsts[0], 1);
  // While an answer is awaited.
  await shows(page, "choice-prompt", "Which interval");
  await page.reload();
  await shows(page, "choice-prompt", "Paused. The page was loaded again.");
  await shows(page, "choice-count", "1 of 4 answers");
  await page.waitForSelector("#choice-go:not([disabled])");
  await press(page, "#choice-go");
  await answer(page, true, firsts[1], 2);
  await shows(page, "choice-prompt", "Which interval");
  await view(page, "device");
  await view(page, "record");
  await shows(page, "choice-prompt", "Paused. The view was left.");
  await page.waitForSelector("#choice-go:not([disabled])");
  await press(page, "#choice-go");
  await shows(page, "choice-prompt", "Which interval");
  // An emergency stop, while nothing is asked of the daemon.
  await page.keyboard.press("Escape");
  await page.keyboard.press("Escape");
  await shows(page, "state-text", "Stopped: estop");
  await shows(page, "choice-prompt", "The motors are not armed: press Arm.");
  assert.equal(await page.$eval("#choice-go", (button) => button.disabled), true);
  await other(daemon, "POST", "/v1/reset", { force: true });
  await arm(page);
  await page.waitForSelector("#choice-go:not([disabled])");
  await press(page, "#choice-go");
  await answer(page, true, firsts[2], 3);
  await answer(page, true, firsts[3], 4);
  await shows(page, "choice-result", "4 of 4 answers right: 100.0 %");
  const { plays } = await other(daemon, "GET", `/v1/sessions/${(await daemon.status()).session.id}/plays`);
  const answered = plays.filter((play) => play.item === null && play.answer);
  assert.deepEqual(answered.map((play) => play.trial), [1, 2, 3, 4]);
});

test("E-STOP by another client in a stimulus pauses, and a lost reply is no second answer", async () => {
  const daemon = await new Daemon().start();
  let lose = false;
  const through = (request, response, forward) => {
    if (!lose || !request.url.endsWith("/answer")) return forward();
    lose = false;
    // The daemon gets the answer, and its reply breaks off after the head: without one the browser would send the request again.
    response.write = () => response.flushHeaders() ?? true;
    response.end = () => (response.flushHeaders(), setTimeout(() => response.destroy(), 100));
    forward();
  };
  await proxied(daemon, through, async (url) => {
    const page = await open({ url });
    await start(page, "P12");
    await arm(page);
    const firsts = order(2, 7);
    await setUp(page, { trials: 2 });
    await shows(page, "choice-prompt", "Which interval");
    lose = true;
    await page.keyboard.press(KEYS[firsts[0]]);
    await shows(page, "choice-prompt", "Paused. The daemon does not answer.");
    await page.waitForSelector("#choice-go:not([disabled])");
    // Two clicks count one answer, and play one trial.
    await page.$eval("#choice-go", (button) => (button.click(), button.click()));
    await shows(page, "choice-count", "1 of 2 answers");
    await answer(page, false, firsts[1], 2);
    await shows(page, "choice-result", "1 of 2 answers right");
    const { plays } = await other(daemon, "GET", `/v1/sessions/${(await daemon.status()).session.id}/plays`);
    assert.deepEqual(plays.filter((play) => play.item === null).map((play) => [play.trial, play.answer.correct]), [[1, true], [2, false]]);
    await press(page, "#choice-new");
    await setUp(page, { "stimulus-s": 60 });
    await shows(page, "state-text", "Playing trial-1");
    await other(daemon, "POST", "/v1/estop");
    await shows(page, "choice-prompt", "Paused. The trial was cut (estop).");
  });
});
