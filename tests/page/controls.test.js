// Controls that the tests of the views do not use on their way: each is used as a person does, and the test looks at what the daemon got. And the
// view Design in a window that may not change anything. Against a real daemon with the simulated array.

import assert from "node:assert/strict";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { answers, arm, browsing, Daemon, press, shows, text, view, WAIT } from "./daemon.js";
import { get } from "./play.js";

const { open } = browsing("design");
const value = (page, id) => page.$eval(`#${id}`, (field) => field.value);
const line = (page, id) => page.$eval(`#${id}`, (field) => field.parentElement.querySelector(".wrong")?.textContent ?? "");

// Enters a value as a person does who then leaves the field.
async function enter(page, id, text) {
  await page.$eval(`#${id}`, (field) => {
    for (let part = field.closest("details"); part; part = part.parentElement.closest("details")) part.open = true;
    field.scrollIntoView({ block: "center" });
    field.focus();
    field.select();
  });
  await page.keyboard.press("Backspace");
  await page.keyboard.type(text);
  await page.keyboard.press("Tab");
}

// The bodies that the page sends to a path.
function sent(page, path) {
  const bodies = [];
  page.on("request", (request) => request.method() === "POST" && new URL(request.url()).pathname === path && bodies.push(JSON.parse(request.postData())));
  return bodies;
}

// Waits until the daemon has judged a rendering whose object fulfils a condition, and returns that.
async function rendered(daemon, condition) {
  for (const until = Date.now() + WAIT.timeout; Date.now() < until; await new Promise((done) => setTimeout(done, 50))) {
    const { state, problem, rendered: found } = await get(daemon, "/v1/renderings/last");
    assert.notEqual(state, "failed", problem);
    if (state === "done" && condition(found.object)) return found.object;
  }
  throw new Error("no such rendering");
}

test("Home, and each field of a thing and of its touch, reach the daemon", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  const home = async () => {
    const answer = page.waitForResponse((response) => response.url().endsWith("/v1/home"));
    await page.waitForSelector("#home:not([disabled])");
    await press(page, "#home");
    return (await answer).status();
  };
  assert.equal(await home(), 409);
  await answers(page, "#home", "level them by hand");
  // After a play telemetry says where the pins are.
  await daemon.run("play", "pin-60", "--seconds", "0.3");
  await get(daemon, "/v1/plays/1?wait=60");
  assert.equal(await home(), 200);
  await page.waitForFunction(() => [...document.querySelectorAll("header .say")].every((line) => line.hidden), WAIT);
  // What is chosen, fields with what a person types, and the keys of the object with their values.
  const cases = [
    [{ shape: "dots", contact: "press" }, { points: "0 0; 2,9 0", diameter: "1,5", rise: "20", hold: "100,5", fall: "30" },
      { diameter_mm: 1.5, "touch.press.rise_s": 0.02, "touch.press.hold_s": 0.1005, "touch.press.fall_s": 0.03 }],
    [{ shape: "braille", contact: "scan" }, { angle: "-30", diameter: "2.5", distance: "12,5" },
      { angle_deg: -30, diameter_mm: 2.5, "touch.scan.distance_mm": 12.5 }],
  ];
  for (const [chosen, typed, keys] of cases) {
    for (const [id, option] of Object.entries(chosen)) await page.select(`#${id}`, option);
    for (const [id, text] of Object.entries(typed)) await enter(page, id, text);
    const at = (object, path) => path.split(".").reduce((of, key) => of?.[key], object);
    await rendered(daemon, (object) => Object.entries(keys).every(([path, wanted]) => Math.abs(at(object, path) - wanted) < 1e-9));
  }
  assert.deepEqual(page.complaints.filter((line) => !line.includes("409")), []);
});

test("Clear and Redo change the drawing, and a height map comes from the file chooser", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await enter(page, "points", "-3 0; 3 0");
  await press(page, "#clear");
  assert.deepEqual([await value(page, "points"), await page.$eval("#clear", (button) => button.disabled)], ["", true]);
  await press(page, "#undo");
  assert.equal(await value(page, "points"), "-3 0; 3 0");
  await press(page, "#redo");
  assert.deepEqual([await value(page, "points"), await page.$eval("#redo", (button) => button.disabled)], ["", true]);
  await page.select("#shape", "heightmap");
  const folder = mkdtempSync(join(tmpdir(), "meissner-map-"));
  // 16 x 16 integers of 16 bits, with a ridge.
  const head = "{'descr': '<i2', 'fortran_order': False, 'shape': (16, 16), }".padEnd(117) + "\n";
  const cells = Buffer.alloc(2 * 16 * 16);
  for (let i = 0; i < 256; i++) cells.writeInt16LE(i % 16 > 5 && i % 16 < 10 ? 1 : 0, 2 * i);
  writeFileSync(join(folder, "ridge.npy"), Buffer.concat([Buffer.from([0x93, ...Buffer.from("NUMPY"), 1, 0, 118, 0]), Buffer.from(head), cells]));
  await (await page.$("#picture")).uploadFile(join(folder, "ridge.npy"));
  await shows(page, "picture-note", "ridge.npy: 1.6 × 1.6 mm.");
  assert.equal((await rendered(daemon, ({ file }) => file === "ridge.npy")).um_per_level, 500);
  rmSync(folder, { recursive: true });
});

test("Undo after a wrong number or point takes that back, and no step of the drawing", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await page.waitForSelector("#redo[disabled]");
  // With nothing to undo but what is wrong.
  await enter(page, "depth", "deep");
  assert.equal(await line(page, "depth"), "Enter a number, 1 to 2000.");
  await press(page, "#undo");
  assert.deepEqual([await value(page, "depth"), await line(page, "depth"), await page.$eval("#undo", (button) => button.disabled)], ["500", "", true]);
  await enter(page, "points", "-3 0; 3 0");
  await enter(page, "width", "2");
  const steps = [
    ["depth", "deep", "500", () => line(page, "depth")],
    ["points", "0 0; 1", "-3 0; 3 0", () => page.$eval("#points", ({ nextElementSibling: said }) => (said && !said.hidden ? said.textContent : ""))],
  ];
  for (const [id, wrong, before, said] of steps) {
    await enter(page, id, wrong);
    assert.notEqual(await said(), "", id);
    await press(page, "#undo");
    assert.deepEqual([await value(page, id), await value(page, "width"), await value(page, "points"), await said()], [before, "2", "-3 0; 3 0", ""]);
  }
  await press(page, "#undo");
  assert.equal(await value(page, "width"), "0.8");
  assert.equal((await rendered(daemon, ({ width_mm: mm }) => mm === 0.8)).touch.press.depth_um, 500);
});

test("a window that may not change anything asks for no rendering, says so once, and asks when it may", async () => {
  const daemon = await new Daemon('listen_token = "always"\n').start();
  const page = await open(daemon);
  const enterToken = async (role) => {
    await page.waitForSelector("#sign-in:not([hidden])");
    await page.type("#token", await daemon.run("token", "create", "--role", role, "--name", role));
    await press(page, "#sign-in-form button");
  };
  const asked = [];
  page.on("request", (request) => request.method() !== "GET" && asked.push(`${request.method()} ${new URL(request.url()).pathname}`));
  const isRefused = () => page.$$eval('[data-view="design"] .say:not([hidden])', (lines) => lines.map((line) => line.textContent));
  const draws = async () => {
    await page.select("#shape", "bar");
    await enter(page, "points", "-3 0; 3 0");
    for (const width of ["1", "1,5", "2"]) await enter(page, "width", width);
  };
  await enterToken("observe");
  await page.waitForSelector("#thing-may-not:not([hidden])");
  await shows(page, "speak", "This window may change nothing now");
  await draws();
  assert.deepEqual([asked, await isRefused(), await text(page, "thing-note")], [[], [], ""]);
  await page.evaluate(() => sessionStorage.removeItem("meissner-token"));
  await enterToken("operate");
  await page.waitForSelector("#thing-may-not[hidden]");
  // The drawing is as it was, and is rendered now.
  await page.waitForSelector("#thing-result:not([hidden], .older)");
  assert.deepEqual([asked.length > 0 && asked.every((one) => one === "POST /v1/renderings"), await value(page, "width")], [true, "2"]);
});

test("during the exclusive session of another client a drawing waits for its end", async () => {
  const daemon = await new Daemon().start();
  const post = async (path, body, headers = {}) => (await fetch(daemon.url + path, { method: "POST", headers, body: JSON.stringify(body) })).json();
  const page = await open(daemon);
  const { token } = await post("/v1/sessions", { participant: "P30", exclusive: true });
  await page.waitForSelector("#thing-may-not:not([hidden])");
  const asked = sent(page, "/v1/renderings");
  await enter(page, "points", "-3 0; 3 0");
  await enter(page, "width", "1,5");
  assert.equal(await page.$$eval('[data-view="design"] .say:not([hidden])', (lines) => lines.length), 0);
  assert.equal(asked.length, 0);
  await post("/v1/sessions/running/end", {}, { "meissner-session": token });
  await page.waitForSelector("#thing-may-not[hidden]");
  assert.equal((await rendered(daemon, () => true)).width_mm, 1.5);
});
