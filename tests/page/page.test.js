// The daemon's page in a real browser, against a real daemon with the simulated array. `run` installs what it needs.
//
// No test asserts on real time; the time limits only end a test that hangs.

import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { answers, arm, browsing, Daemon, press, proxied, shows, stopsOf, view, WAIT } from "./daemon.js";

const { open } = browsing();
const openView = (daemon, shown) => open(daemon, 1400, 1000, shown);

test("a person arms, plays, stops in an emergency, and resets (smoke)", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await page.$eval("#seconds", (input) => (input.value = "600"));
  await page.type("#search", "edge-45");
  await page.waitForSelector('li[data-name="edge-45"]:not([hidden]) .thumbnail');
  const found = await page.$$eval("#pattern-list li:not([hidden])", (items) => items.map((item) => item.dataset.name));
  assert.deepEqual(found, ["edge-45", "edge-45-paper", "edge-45-rendered"]);
  await press(page, 'li[data-name="edge-45"] button');
  await shows(page, "state-text", "Playing edge-45");
  const moving = (await (await fetch(`${daemon.url}/v1/patterns/edge-45`)).json()).drives.map((drive) => drive.motor);
  // On a busy machine the state grows old at times; then nothing is drawn.
  await page.waitForFunction((moving) => document.querySelector(".finger").drawn.every((um, i) => um !== null && (um > 1) === moving.includes(i)), WAIT, moving);
  const stops = stopsOf(page);
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  const first = await daemon.status();
  assert.ok(first.state === "faulted" && first.estop.orders >= 1 && first.estop.orders <= stops.sent, JSON.stringify(first));
  await shows(page, "state-text", "Stopped: estop");
  await shows(page, "receipt-summary", "edge-45: stopped (estop)");
  await page.waitForSelector("#reset:not([disabled])");
  await press(page, "#reset");
  // The dialog leaves the emergency stop within reach.
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  await press(page, '#reset-dialog button[value="reset"]');
  await answers(page, "#reset", "An emergency stop came after those that this reset knows of");
  await view(page, "device");
  const { estop: { orders } } = await daemon.status();
  assert.ok(orders > first.estop.orders && orders <= stops.sent);
  await shows(page, "daemon-facts", `Emergency stops since the start${orders}`);
  await press(page, "#reset");
  await press(page, '#reset-dialog button[value="reset"]');
  await shows(page, "state-text", "Disarmed");
  assert.deepEqual(page.complaints.filter((line) => !line.includes("409")), []);
});

test("the keyboard alone orders an emergency stop", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await page.reload();
  await shows(page, "state-text", "Armed");
  await page.keyboard.press("Tab");
  assert.equal(await page.evaluate(() => document.activeElement.id), "estop");
  await page.keyboard.press("Enter");
  await shows(page, "estop-note", "All lines are off.");
  assert.equal((await daemon.status()).state, "faulted");
});

const get = async (daemon, path) => (await fetch(`${daemon.url}${path}`)).json();

// Its pins stand in no rows, some of them outside of the finger.
const SCATTERED = `name = "scattered"
pins = { positions_mm = [[-1.4, 1.5], [1.2, 0.0], [-13.0, 2.0], [14.0, -16.0], [0.5, 19.0]], radius_mm = 0.4 }
tick_hz = 60000
duty = { up = 0.25, down = 0.75 }
[motor]
step_um = 0.1
window_ms = 5.0
travel_um = 100.0
most_pulses = 1500
`;

for (const name of ["tula35-6x4", "tula35-2x3", "ubi-pen-3x3", "simulated-8x8", "scattered"]) {
  test(`the page shows the array ${name}, and plays no pattern of another array`, async () => {
    const daemon = new Daemon(`[array]\ndescription = "${name}${name === "scattered" ? ".toml" : ""}"\n`);
    writeFileSync(join(daemon.dir, "scattered.toml"), SCATTERED);
    await daemon.start();
    const { positions_mm: places } = await get(daemon, "/v1/array");
    const page = await open(daemon, 360, 640, "device");
    await shows(page, "array-facts", `Name${name},`);
    // The pins have their places on the finger, in mm.
    const pins = await page.$$eval(".finger-pins circle", (all) => all.map((pin) => [Number(pin.getAttribute("cx")), -pin.getAttribute("cy")]));
    assert.equal(pins.length, places.length);
    pins.forEach(([x, y], i) => assert.ok(Math.hypot(x - places[i][0], y - places[i][1]) < 1e-6, `pin ${i} at ${x}, ${y}`));
    assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 360);
    await view(page, "design");
    const onPad = await page.$$eval("#pad .pin-place", (pins) => pins.map((pin) => [Number(pin.getAttribute("cx")), -pin.getAttribute("cy")]));
    onPad.forEach(([x, y], i) => assert.ok(Math.hypot(x - places[i][0], y - places[i][1]) < 1e-6, `pin ${i} of the pad at ${x}, ${y}`));
    assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 360);
    // The shipped patterns are for the paper's array.
    await view(page, "play");
    await page.waitForSelector("#pattern-list li");
    await arm(page);
    await page.$eval("#seconds", (input) => (input.value = "0.2"));
    await page.type("#search", "pin-60");
    const isForeign = name !== "tula35-6x4";
    const play = 'li[data-name="pin-60"]:not([hidden])';
    await page.waitForSelector(play);
    assert.equal((await page.$eval(play, (item) => item.textContent)).includes("for the array tula35-6x4"), isForeign);
    await press(page, `${play} button`);
    if (isForeign) {
      await answers(page, `${play} button`, `“pin-60” is for the array tula35-6x4, and this one is ${name}.`);
    } else {
      await shows(page, "receipt-summary", "pin-60: done");
      const receipt = await get(daemon, "/v1/plays/last");
      assert.deepEqual([receipt.id, receipt.device.array], [1, name]);
    }
    assert.deepEqual(page.complaints, []);
  });
}

test("the doctor's findings come with verdicts and remedies, the worst first", async () => {
  const daemon = await new Daemon().start();
  const page = await openView(daemon, "device");
  await shows(page, "doctor-note", "passed, at");
  const listed = () => page.$$eval("#findings li", (items) => items.map((item) => [item.dataset.level, item.querySelector(".verdict").textContent, item.textContent]));
  const { findings } = await get(daemon, "/v1/doctor");
  const shown = await listed();
  assert.equal(shown.length, findings.length);
  const words = { ok: "OK", warn: "Warning", fail: "Failure" };
  const plain = (text) => text.replaceAll("`", "");
  // The clock's estimate changes meanwhile.
  for (const { what, level, found, advice } of findings.filter(({ what }) => what !== "clock")) {
    const item = shown.find(([, , text]) => text.startsWith(`${what} ${words[level]}`));
    assert.deepEqual(item.slice(0, 2), [level, words[level]]);
    assert.ok(item[2].includes(plain(found)) && item[2].endsWith(plain(advice)) && item[2].includes("Remedy: ") === (level !== "ok"), item[2]);
  }
  // After a stop a new check reports it.
  await page.click("#estop");
  await shows(page, "state-text", "Stopped: estop");
  const failures = (await get(daemon, "/v1/doctor")).findings.filter(({ level }) => level === "fail").length;
  await shows(page, "doctor-note", `${failures} failure${failures === 1 ? "" : "s"}, `);
  const after = await listed();
  assert.ok(after[0][0] === "fail" && after[0][2].startsWith("state "), after[0][2]);
  assert.deepEqual(after.map(([level]) => level), after.map(([level]) => level).sort((a, b) => "fwo".indexOf(a[0]) - "fwo".indexOf(b[0])));
});

test("an emergency stop waits for no other request of the browser's windows", async () => {
  const daemon = await new Daemon().start();
  // The proxy passes on neither a status nor a check. A stream and such a request of each of three windows take all connections of a browser.
  let holds = false;
  let stops = 0;
  const [held, streams] = [new Set(), new Set()];
  const through = (request, response, forward) => {
    if (request.url === "/v1/estop") stops += 1;
    const slow = /^\/v1\/(doctor|status)$/.test(request.url);
    const group = request.url === "/v1/events" ? streams : slow && holds ? held : null;
    group?.add(response);
    response.on("close", () => group?.delete(response));
    if (group !== held) forward();
  };
  await proxied(daemon, through, async (url) => {
    const first = await openView({ url }, "device");
    const pages = [first];
    const session = await first.createCDPSession();
    const { targetInfo } = await session.send("Target.getTargetInfo");
    for (const _ of [1, 2]) {
      // A separate window is not hidden; it shares the connections of the first.
      const { targetId } = await session.send("Target.createTarget", { url: `${url}/#device`, newWindow: true, browserContextId: targetInfo.browserContextId });
      const target = await first.browserContext().waitForTarget((target) => target._targetId === targetId);
      pages.push(await target.page());
    }
    for (const page of pages) await shows(page, "state-text", "Disarmed");
    for (const page of pages) await shows(page, "doctor-note", "passed, at");
    assert.deepEqual(await Promise.all(pages.map((page) => page.evaluate(() => document.hidden))), [false, false, false]);
    holds = true;
    // All connections are taken.
    await Promise.all(pages.map((page) => page.evaluate(() => document.getElementById("doctor-again").click())));
    const until = Date.now() + WAIT.timeout;
    while (held.size + streams.size < 6) {
      assert.ok(Date.now() < until, `${held.size} requests and ${streams.size} streams`);
      await new Promise((done) => setTimeout(done, 5));
    }
    await pages[2].evaluate(() => document.getElementById("estop").dispatchEvent(new PointerEvent("pointerdown")));
    await shows(pages[2], "estop-note", "All lines are off.");
    assert.equal(stops, 1);
    assert.equal((await daemon.status()).estop.orders, 1);
    holds = false;
    for (const page of pages) await shows(page, "state-text", "Stopped: estop");
  });
});

