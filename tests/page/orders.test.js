// What a person types, changes and orders, against a real daemon with the simulated array: numbers with a comma or a point, one play for one
// order, and patterns that others replace.

import assert from "node:assert/strict";
import { test } from "node:test";
import { answers, arm, browsing, Daemon, press, proxied, shows, WAIT } from "./daemon.js";
import { choose, get, quiet, set } from "./play.js";

const { open } = browsing();

// Types into a field as a person does.
const enter = async (page, selector, value) => {
  await page.$eval(selector, (field) => {
    field.scrollIntoView({ block: "center" });
    field.focus();
    field.select();
  });
  await page.keyboard.press("Backspace");
  await page.keyboard.type(value);
};

test("numbers take a comma or a point and no text, and whole ones take neither (smoke)", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  const line = (selector) => page.$eval(selector, (field) => field.parentElement.querySelector(".wrong")?.textContent ?? "");
  await page.select("#pin-what", "seconds");
  await enter(page, "#pin-um", "12,5");
  await enter(page, "#pin-hz", "62.5");
  await enter(page, "#pin-seconds", "0,4");
  for (const wrong of ["3,5", "two", "24"]) {
    await enter(page, "#pin-motor", wrong);
    await press(page, "#pin-play");
    assert.equal(await line("#pin-motor"), "Enter a whole number, 0 to 23.");
  }
  await enter(page, "#pin-motor", "3");
  await press(page, "#pin-play");
  await shows(page, "receipt-summary", "Play 1, ");
  const { duration_ms: ms, reach: { drives } } = await get(daemon, "/v1/plays/1");
  assert.deepEqual([ms.ordered, drives.map((drive) => drive.ordered_um)], [400, [12.5]]);
  await choose(page, "edge-45");
  const preview = page.waitForRequest((request) => request.url().includes("/preview?from_s=0.2&"));
  await enter(page, "#preview-from", "0,2");
  await page.keyboard.press("Tab");
  await preview;
  assert.equal(await page.$$eval("input[type=number]", (all) => all.length), 0, "such a field drops a comma, or a point");
  assert.deepEqual(quiet(page), []);
});

test("a double click, a held key, and a click before the answer are no second play", async () => {
  const daemon = await new Daemon().start();
  let held = null;
  const ordered = [];
  const through = (request, response, forward) => {
    if (request.method === "POST" && request.url === "/v1/play") {
      ordered.push(request.url);
      if (held) return held.push(forward);
    }
    return forward();
  };
  await proxied(daemon, through, async (url) => {
    const page = await open({ url });
    await arm(page);
    const button = 'li[data-name="edge-45"] button';
    await page.waitForSelector(button);
    await set(page, "seconds", 0.05);
    const buttons = [button, "#pin-play"];
    for (const [i, selector] of buttons.entries()) {
      await page.$eval(selector, (element) => element.scrollIntoView({ block: "center" }));
      await page.click(selector, { count: 2 });
      await shows(page, "receipt-summary", `Play ${i + 1}, `);
    }
    assert.equal(ordered.length, buttons.length);
    held = [];
    await page.focus(button);
    for (let i = 0; i < 4; i++) await page.keyboard.down("Enter");
    await page.keyboard.up("Enter");
    await press(page, button);
    await answers(page, button, "The daemon prepares the play …");
    assert.equal(held.length, 1);
    held.splice(0).forEach((forward) => forward());
    held = null;
    await shows(page, "receipt-summary", "Play 3, ");
    await press(page, button);
    await shows(page, "receipt-summary", "Play 4, ");
    assert.equal((await get(daemon, "/v1/plays/last")).id, 4);
    assert.equal(ordered.length, 4);
  });
});

// Stores a pattern as another client does.
const store = (daemon, name, um) => fetch(`${daemon.url}/v1/patterns/${name}?replace=true`, {
  method: "PUT", headers: { "content-type": "application/toml" }, body: `format = 1\nname = "${name}"\nduration_s = 0.1\n[[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = ${um}.0\n`,
}).then(({ ok }) => assert.ok(ok));

test("a pattern that another client has replaced is drawn before it plays, and new ones appear", async () => {
  const daemon = await new Daemon().start();
  await store(daemon, "own", 50);
  await store(daemon, "gone", 50);
  const page = await open(daemon);
  await arm(page);
  const button = 'li[data-name="own"] button';
  const line = (part) => page.waitForFunction((part) => document.querySelector('li[data-name="own"] .choose').textContent.includes(part), WAIT, part);
  await choose(page, "own");
  await line("up to 50 µm");
  await page.waitForSelector(".preview .trace-line", WAIT);
  await store(daemon, "own", 70);
  await press(page, button);
  await answers(page, button, "“own” was replaced by another pattern, which the page shows now. Look at it, then press again.");
  await line("up to 64 µm");
  await page.waitForFunction(() => /up to (6\d|7\d) µm/.test(document.querySelector(".preview")?.textContent), WAIT);
  await page.waitForSelector('li[data-name="own"] .map .thumbnail');
  assert.equal((await daemon.status()).newest.play, null, "nothing was played");
  await press(page, button);
  await shows(page, "receipt-summary", "Play 1, own: done");
  assert.deepEqual((await get(daemon, "/v1/plays/1")).reach.drives.map((drive) => drive.ordered_um), [70]);
  const before = await page.$("li[data-name='edge-45']");
  await fetch(`${daemon.url}/v1/patterns/gone`, { method: "DELETE" });
  await press(page, 'li[data-name="gone"] button');
  await answers(page, "#patterns-title", "“gone” was removed meanwhile.");
  assert.equal(await page.$('li[data-name="gone"]'), null);
  // What others store comes when the view, or the window beside another one, is shown again. Items that are as before stay.
  await store(daemon, "later", 50);
  await press(page, '#views a[href="#device"]');
  await press(page, '#views a[href="#play"]');
  await page.waitForSelector('li[data-name="later"]');
  await store(daemon, "latest", 50);
  await page.evaluate(() => dispatchEvent(new Event("focus")));
  await page.waitForSelector('li[data-name="latest"]');
  assert.ok(await before.evaluate((item) => item.isConnected));
  assert.deepEqual(quiet(page), []);
});

