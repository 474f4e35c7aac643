// The view Device, and what a window may not do. The tests use a real browser and a real daemon with the simulated array.

import assert from "node:assert/strict";
import { test } from "node:test";
import { arm, browsing, Daemon, press, shows, text, view, WAIT } from "./daemon.js";

const { open } = browsing("device");

const fact = (page, list, name) => page.$eval(`#${list}`, (list, name) => [...list.children].find((term) => term.textContent === name)?.nextElementSibling.textContent, name);
// Waits until a fact includes a text.
async function becomes(page, list, name, part) {
  const test = (list, name, part) => [...document.getElementById(list).children].find((term) => term.textContent === name)?.nextElementSibling.textContent.includes(part);
  await page.waitForFunction(test, WAIT, list, name, part).catch(async () => assert.fail(`${name}: ${await text(page, list)}`));
}

test("the array, the link and the daemon are shown as the daemon tells them (smoke)", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "array-facts", "tula35-6x4");
  const array = await (await fetch(`${daemon.url}/v1/array`)).json();
  for (const part of [array.hash, "24, 6 rows of 4, 2.9 mm apart", "400 µm", "a moving average over 4.3 ms", "4, motors 0 to 5; 6 to 11; 12 to 17; 18 to 23", "12, motors 0, 1; 2, 3;", "85 kHz", `${array.motor.least_pulses} to ${array.motor.most_pulses} pulses`]) await shows(page, "array-facts", part);
  for (const [list, name, part] of [
    ["facts", "Device", "mock, simulated, firmware"], ["facts", "Line", "kB/s"], ["facts", "Clock", "synchronised to ±"],
    ["facts", "Messages that cannot be true", "0"], ["facts", "Device runs", "started by program"], ["facts", "Position", "unknown"], ["facts", "Largest offset from rest", "not known"],
    ["daemon-facts", "Armed by", "nobody"], ["daemon-facts", "Version", `pid ${daemon.child.pid}`], ["daemon-facts", "Session", "none"],
  ]) await becomes(page, list, name, part);
  await arm(page);
  await becomes(page, "daemon-facts", "Armed by", "10 s without a sign of it disarm");
  await becomes(page, "facts", "Position", "known");
  await becomes(page, "facts", "Largest offset from rest", " µm, pin ");
  await daemon.end("SIGKILL");
  await becomes(page, "daemon-facts", "Armed by", "not known");
  assert.equal(await fact(page, "facts", "Clock"), "not known");
  await daemon.start();
  await becomes(page, "daemon-facts", "Armed by", "nobody");
});

// What the simulated sensors show is right, so the page is told otherwise.
test("a sensor fault is marked also after a reload, until motors are armed again", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await page.evaluateOnNewDocument(() => {
    const fetch = window.fetch;
    window.fetch = async (url, options) => {
      const answer = await fetch(url, options);
      if (url !== "/v1/status" || !answer.ok) return answer;
      const status = await answer.json();
      if (status.state === "disarmed") status.motors[3].sensor_fault = "gain";
      return new Response(JSON.stringify(status), { status: 200 });
    };
  });
  const says = (fault) => page.waitForFunction((fault) => document.querySelector(".finger").ariaLabel.includes("Sensor fault of pin 3: it shows far less or more travel than bursts make.") === fault, WAIT, fault);
  for (let times = 0; times < 2; times += 1) {
    await page.reload();
    await says(true);
  }
  await arm(page);
  await says(false);
});

test("wiring that is not in the motors' order is shown motor by motor", async () => {
  const daemon = await new Daemon('[array]\ndescription = "ubi-pen-3x3"\n').start();
  const page = await open(daemon);
  await shows(page, "array-facts", "5, motors 0, 1; 2, 3; 4, 5; 6, 7; 8");
});

// The buttons that a view offers, by what they say.
// Which patterns are looked at is anybody's choice.
const offered = (page) => page.$$eval("button, input[type=checkbox], form", (all) => all.filter((one) => one.checkVisibility() && one.closest("main, header") && !one.matches("#pattern-list .choose")).map((one) => (one.matches("form") ? `form ${one.id}` : one.id || one.textContent)));

// What a window that may only read may do in each view.
const READS = { play: [], design: ["undo", "redo", "clear"], record: ["Show", "plays-back", "plays-next"], device: ["doctor-again"] };

test("a token that may only read is offered nothing that it may not do, and told why", async () => {
  const daemon = await new Daemon('listen_token = "always"\n').start();
  const create = (role) => daemon.run("token", "create", "--role", role, "--name", role);
  const tokens = { observe: await create("observe"), operate: await create("operate") };
  const headers = { authorization: `Bearer ${tokens.operate}` };
  await fetch(`${daemon.url}/v1/sessions`, { method: "POST", headers, body: JSON.stringify({ participant: "P07" }) });
  const page = await open(daemon, undefined, undefined, "play");
  const addresses = [];
  page.on("request", (request) => addresses.push(request.url()));
  const enter = async (role) => {
    await page.waitForSelector("#sign-in:not([hidden])");
    await page.$eval("#token", (field) => (field.value = ""));
    await page.type("#token", tokens[role]);
    await press(page, "#sign-in-form button");
  };
  await enter("observe");
  await shows(page, "may-not", "This window may only read");
  // The window keeps the token, and sends it in no address.
  await page.reload();
  await shows(page, "may-not", "This window may only read");
  assert.ok(addresses.length > 5 && addresses.every((address) => !address.includes(tokens.observe)));
  await page.waitForSelector("#pattern-list .thumbnail");
  for (const [name, reads] of Object.entries(READS)) {
    await view(page, name);
    if (name === "design") {
      await page.waitForSelector("#pad .pin-place");
      await page.evaluate(() => document.querySelectorAll("details").forEach((details) => (details.open = true)));
    }
    if (name === "record") {
      await page.waitForSelector("#sessions button");
      await press(page, "#sessions button");
      await shows(page, "plays-title", "Session of P07");
    }
    const others = (await offered(page)).filter((one) => one !== "estop" && !reads.includes(one));
    assert.deepEqual(others, [], name);
  }
  // An observer may stop.
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  // With another token everything is offered.
  await page.evaluate(() => meissner.token.set(""));
  await enter("operate");
  await page.waitForFunction(() => document.getElementById("may-not").hidden, WAIT);
  const all = await offered(page);
  for (const one of ["arm", "disarm", "stop", "home", "reset"]) assert.ok(all.includes(one), `${one}: ${all}`);
});
