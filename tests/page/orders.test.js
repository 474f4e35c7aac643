// What a person types, changes and orders, against a real daemon with the simulated array: numbers with a comma or a point, one play for one
// order, patterns that others replace, and changes that are not saved.

import assert from "node:assert/strict";
import { test } from "node:test";
import { answers, arm, browsing, Daemon, press, proxied, shows, text, WAIT } from "./daemon.js";
import { choose, field, get, quiet, rows, set, type } from "./play.js";

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

test("numbers take a comma or a point and no text, whole ones take neither, and arrow keys count (smoke)", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  const line = (selector) => page.$eval(selector, (field) => field.parentElement.querySelector(".wrong")?.textContent ?? "");
  const played = async (id) => {
    await shows(page, "receipt-summary", `Play ${id}, `);
    const { scale, duration_ms: ms, drives } = await get(daemon, `/v1/plays/${id}`);
    return { scale, ms: ms.ordered, um: drives.map((drive) => drive.ordered_um) };
  };
  await page.select("#pin-what", "seconds");
  await enter(page, "#pin-um", "12,5");
  await enter(page, "#pin-hz", "62.5");
  await enter(page, "#pin-seconds", "0,4");
  for (const [wrong, says] of [["3,5", "Enter a whole number, 0 to 23."], ["two", "Enter a whole number, 0 to 23."], ["24", "Enter a whole number, 0 to 23."]]) {
    await enter(page, "#pin-motor", wrong);
    await press(page, "#pin-play");
    assert.equal(await line("#pin-motor"), says);
  }
  await enter(page, "#pin-motor", "3");
  await press(page, "#pin-play");
  assert.deepEqual(await played(1), { scale: 1, ms: 400, um: [12.5] });
  await page.waitForSelector('li[data-name="edge-45"]');
  await enter(page, "#seconds", "0,5");
  await enter(page, "#scale", "1,5");
  await press(page, 'li[data-name="edge-45"] button');
  assert.equal(await line("#scale"), "Enter a number, 0.05 to 1.");
  await enter(page, "#scale", "0,5");
  // The arrow keys count by the field's step, with the person's own sign, and no further than the bounds.
  for (const key of ["ArrowUp", "ArrowUp", "ArrowDown"]) await page.keyboard.press(key);
  assert.equal(await page.$eval("#scale", (field) => field.value), "0,55");
  await press(page, 'li[data-name="edge-45"] button');
  const { scale, ms } = await played(2);
  assert.deepEqual([scale, ms], [0.55, 500]);
  await choose(page, "edge-45");
  await enter(page, field(1, 3), "12,5");
  await enter(page, field(1, 5), "0,1");
  await enter(page, field(1, 4), "0");
  await page.keyboard.press("ArrowDown");
  assert.equal(await page.$eval(field(1, 4), (input) => input.value), "0");
  await enter(page, "#chosen-duration", "0,25");
  await enter(page, "#chosen-count", "2,");
  await press(page, "#chosen-play");
  const changed = await played(3);
  assert.deepEqual([changed.ms, changed.um[0]], [500, 12.5]);
  assert.equal((await get(daemon, `/v1/patterns/edge-45?sha256=${(await get(daemon, "/v1/plays/3")).pattern_sha256}`)).pattern.drive[0].start_s, 0.1);
  await enter(page, "#sequence-gap", "0,5");
  for (const count of [1, 2]) {
    await press(page, "#chosen-add");
    await answers(page, "#chosen-add", `It is item ${count} of the sequence.`);
  }
  assert.equal(await page.evaluate(() => JSON.parse(sessionStorage.getItem("meissner-sequence")).request.items[1].gap_ms), 0.5);
  const preview = page.waitForRequest((request) => request.url().includes("/preview?from_s=0.2&"));
  await enter(page, "#preview-from", "0,2");
  await page.keyboard.press("Tab");
  await preview;
  assert.equal(await page.$$eval("input[type=number]", (all) => all.length), 0, "such a field drops a comma, or a point");
  assert.ok(await page.$$eval("input[inputmode]", (all) => all.length) > 40);
  assert.deepEqual(quiet(page), []);
});

test("the record's numbers take a comma or a point, and whole ones neither", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon, 1400, 1000, "record");
  await page.waitForSelector("#session-form:not([hidden])");
  await enter(page, "#participant", "P20");
  const line = (id) => page.$eval(`#${id}`, (field) => field.parentElement.querySelector(".wrong")?.textContent ?? "");
  await enter(page, "#session-seed", "1,5");
  await press(page, "#session-start");
  assert.equal(await line("session-seed"), "Enter a whole number, 0 to 9007199254740991.");
  assert.equal((await daemon.status()).session, null);
  await enter(page, "#session-seed", "9007199254740991");
  await press(page, "#session-start");
  await shows(page, "session-facts", "9007199254740991");
  await arm(page);
  await page.waitForSelector("#choice-start:not([disabled])");
  await page.select("#asked", "pin-60");
  await page.select("#other", "edge-45");
  for (const [id, wrong, right, says] of [
    ["trials", "2.5", "1", "Enter a whole number, 1 to 1000."], ["choice-seed", "-1", "7", "Enter a whole number, 0 to 4294967295."], ["stimulus-s", "0,01", "0,25", "Enter a number, 0.05 to 60."],
    ["between-ms", "", "20,5", "Enter a number, 0 to 10000."], ["pause-s", "1.2.3", "0,0", "Enter a number, 0 to 60."],
  ]) {
    await enter(page, `#${id}`, wrong);
    await press(page, "#choice-start");
    assert.equal(await line(id), says);
    assert.equal(await page.evaluate(() => document.activeElement.id), id);
    await enter(page, `#${id}`, right);
    assert.equal(await line(id), "");
  }
  assert.equal((await daemon.status()).last_play, null, "nothing was ordered");
  await press(page, "#choice-start");
  await shows(page, "choice-prompt", "Which interval had pin-60?");
  const { items } = await get(daemon, "/v1/plays/last");
  assert.deepEqual(items.map(({ ordered_ms: ms }) => ms), [250, 250]);
  // The second begins 20.5 ms after the first one's end, on the array's clock.
  const { tick_hz: hz } = await get(daemon, "/v1/array");
  assert.ok(Math.abs(items[1].planned_onset_ticks - items[0].planned_onset_ticks - 0.2705 * hz) <= 1, JSON.stringify(items));
});

test("a double click, a held key, and a click before the answer are no second play", async () => {
  const daemon = await new Daemon().start();
  let held = null;
  const ordered = [];
  const through = (request, response, forward) => {
    if (request.method === "POST" && /^\/v1\/(play|sequence)$/.test(request.url)) {
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
    await choose(page, "edge-45");
    await set(page, "chosen-count", 0.05);
    await press(page, "#chosen-add");
    await shows(page, "sequence-what", "1 items");
    const buttons = [button, "#chosen-play", "#sequence-play", "#pin-play"];
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
    await shows(page, "receipt-summary", "Play 5, ");
    await press(page, button);
    await shows(page, "receipt-summary", "Play 6, ");
    assert.equal((await get(daemon, "/v1/plays/last")).id, 6);
    assert.equal(ordered.length, 6);
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
  const drawn = (um) => page.waitForFunction((um) => [...document.querySelectorAll("#drives input")].some((input) => input.value === um), WAIT, um);
  await choose(page, "own");
  await line("up to 50 µm");
  assert.equal((await rows(page))[0][2], "50");
  await page.waitForSelector(".preview .trace-line", WAIT);
  await store(daemon, "own", 70);
  await press(page, button);
  await answers(page, button, "own was replaced by another pattern, which the page shows now. Look at it, then press again.");
  await line("up to 64 µm");
  await drawn("70");
  await page.waitForFunction(() => /up to (6\d|7\d) µm/.test(document.querySelector(".preview")?.textContent), WAIT);
  await page.waitForSelector('li[data-name="own"] .map .thumbnail');
  assert.equal((await daemon.status()).last_play ?? null, null, "nothing was played");
  await press(page, button);
  await shows(page, "receipt-summary", "Play 1, own: done");
  const um = async (id) => (await get(daemon, `/v1/plays/${id}`)).drives.map((drive) => drive.ordered_um);
  assert.deepEqual(await um(1), [70]);
  // A pattern that was played before is in the record, and is not played in place of the stored one.
  await store(daemon, "own", 90);
  await press(page, "#chosen-add");
  await answers(page, "#chosen-add", "own was replaced by another pattern");
  await drawn("90");
  await store(daemon, "own", 80);
  await press(page, "#chosen-play");
  await answers(page, "#chosen-play", "own was replaced by another pattern");
  await drawn("80");
  await press(page, "#chosen-play");
  await shows(page, "receipt-summary", "Play 2, own: done");
  assert.deepEqual(await um(2), [80]);
  // Changes that are not saved stay, and the page says of which pattern they are. Undo shows the one that is stored.
  await type(page, field(1, 3), "33");
  await store(daemon, "own", 60);
  await fetch(`${daemon.url}/v1/patterns/gone`, { method: "DELETE" });
  const before = await page.$("li[data-name='edge-45']");
  await press(page, 'li[data-name="gone"] button');
  await shows(page, "patterns-title", "Patterns");
  await answers(page, "#patterns-title", "gone was removed meanwhile.");
  await answers(page, "#chosen-title", "Another pattern was stored under this name meanwhile.");
  assert.deepEqual([(await rows(page))[0][2], await page.$('li[data-name="gone"]')], ["33", null]);
  await press(page, "#chosen-undo");
  await drawn("60");
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

test("changes that are not saved survive a reload, and go only after a question", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await choose(page, "edge-45");
  const stored = await rows(page);
  await type(page, field(1, 3), "33");
  await type(page, field(2, 1), "");
  await type(page, "#chosen-duration", "0,5");
  const edited = await rows(page);
  await page.reload();
  await shows(page, "chosen-title", "Pattern edge-45");
  await page.waitForSelector("#chosen-edited:not([hidden])");
  assert.deepEqual([await rows(page), await page.$eval("#chosen-duration", (field) => field.value)], [edited, "0,5"]);
  const isOpen = () => page.$eval("#discard-dialog", (dialog) => dialog.open);
  await press(page, 'li[data-name="pin-60"] .choose');
  await shows(page, "discard-text", "What you have changed in edge-45 is not saved.");
  await press(page, '#discard-dialog [value="cancel"]');
  assert.deepEqual([await text(page, "chosen-title"), await rows(page)], ["Pattern edge-45", edited]);
  await press(page, 'li[data-name="pin-60"] .choose');
  assert.equal(await isOpen(), true);
  await press(page, '#discard-dialog [value="discard"]');
  await shows(page, "chosen-title", "Pattern pin-60");
  await page.waitForSelector("#chosen-body:not([hidden])");
  // Without changes nothing is asked, and a reload chooses nothing.
  await choose(page, "edge-45");
  assert.deepEqual([await isOpen(), await rows(page)], [false, stored]);
  await type(page, field(1, 3), "33");
  await press(page, "#chosen-undo");
  await page.reload();
  await page.waitForSelector('li[data-name="edge-45"] .choose');
  assert.equal(await page.$eval("#chosen-body", (body) => body.hidden), true);
});

