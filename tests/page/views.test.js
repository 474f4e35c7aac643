// The page's shell: the header, the views, dialogs, the shortcut of E-STOP, and answers beside their controls. The tests use a real
// browser and a real daemon with the simulated array.

import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { test } from "node:test";
import { plain } from "../../src/daemon/page/assets/words.js";
import { answers, arm, browsing, CALIBRATION, Daemon, press, proxied, shows, stopsOf, text, view, WAIT } from "./daemon.js";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

const { open } = browsing();

async function post(daemon, path, body) {
  const response = await fetch(`${daemon.url}${path}`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) });
  assert.ok(response.ok, `${path}: ${(await response.json()).detail}`);
}

const shownViews = (page) => page.$$eval("[data-view]", (views) => views.filter((view) => !view.hidden).map((view) => view.dataset.view));
const current = (page) => page.$$eval("#views [aria-current]", (links) => links.map((link) => [link.hash, link.ariaCurrent]));

test("each view has an address, the browser goes back and forward, and only the shown view asks for what it shows (smoke)", async () => {
  const daemon = await new Daemon().start();
  await daemon.run("arm", "--assume-rest");
  await daemon.run("play", "pin-60", "--seconds", "0.1");
  await fetch(`${daemon.url}/v1/plays/1?wait=60`);
  const asked = [];
  const through = (request, response, forward) => {
    asked.push(request.url);
    forward();
  };
  await proxied(daemon, through, async (url) => {
    // Without a drawing, the view Design asks for nothing.
    const asks = { play: "/v1/plays/1", design: null, record: "/v1/sessions", device: "/v1/doctor" };
    const loaded = async (name) => {
      const until = Date.now() + WAIT.timeout;
      while (asks[name] && !asked.includes(asks[name])) {
        assert.ok(Date.now() < until, `${name}: ${asked}`);
        await new Promise((done) => setTimeout(done, 20));
      }
    };
    for (const [name, path] of Object.entries(asks)) {
      asked.length = 0;
      const page = await open({ url }, 1400, 1000, name);
      await loaded(name);
      const others = Object.values(asks).filter((other) => other !== path);
      assert.deepEqual(others.filter((other) => asked.includes(other)), [], name);
      assert.deepEqual([await shownViews(page), await current(page)], [[name], [[`#${name}`, "page"]]]);
      const title = name[0].toUpperCase() + name.slice(1);
      assert.deepEqual([await page.title(), await page.$$eval("h1", (all) => all.map((one) => one.textContent))], [`${title} · meissner`, [title]]);
      assert.ok(await page.$eval(".finger", (finger) => finger.getBoundingClientRect().height > 100), "no view hides the finger");
      await page.close();
    }
    const page = await open({ url }, 1400, 1000, "record");
    await view(page, "device");
    await view(page, "play");
    await page.goBack();
    await page.waitForSelector('[data-view="device"]:not([hidden])');
    await page.goForward();
    await page.waitForSelector('[data-view="play"]:not([hidden])');
    await page.goBack();
    await page.reload();
    await page.waitForSelector('[data-view="device"]:not([hidden])');
    assert.deepEqual(await shownViews(page), ["device"]);
    // What is no view is the first one.
    await page.goto(`${url}/#nothing`);
    await page.reload();
    await page.waitForSelector('[data-view="play"]:not([hidden])');
    assert.deepEqual(page.complaints, []);
  });
});

// Sizes of windows, and the last ones as with a zoom of 400 %. The third: what the header may take, px.
for (const [width, height, most] of [[1400, 1000, 250], [390, 844, 422], [360, 640, 320], [640, 360, 180], [320, 256, 128]]) {
  test(`the header does not scroll at ${width} x ${height} px, and leaves half of the screen`, async () => {
    const daemon = await new Daemon().start();
    const page = await open(daemon, width, height, "device");
    // Not armed by the page, whose signs of life may be late beside a build.
    await post(daemon, "/v1/arm", { assume_rest: true, checked: "a test" });
    await post(daemon, "/v1/play", { pattern: "edge-45-rendered", seconds: 300 });
    await shows(page, "state-text", "Playing edge-45-rendered");
    await shows(page, "calibration-note", "Nothing was calibrated yet");
    await page.evaluate(() => scrollTo(0, document.documentElement.scrollHeight));
    // What stays is at its place, and nothing lies over it.
    const parts = height >= 640 ? ["#estop", "#state-text", "#disarm", '#views a[href="#play"]'] : ["#estop", "#state-text"];
    for (const part of parts) {
      assert.ok(await page.$eval(part, (element) => {
        const { x, y, width, height } = element.getBoundingClientRect();
        return y >= 0 && element.contains(document.elementFromPoint(x + width / 2, y + height / 2));
      }), part);
    }
    const covered = await page.evaluate(() => parseFloat(getComputedStyle(document.documentElement).getPropertyValue("--header")));
    const bottom = await page.$eval(height >= 640 ? "#header" : "#bar", (part) => part.getBoundingClientRect().bottom);
    assert.ok(Math.abs(covered - bottom) <= 1 && bottom <= most, `${bottom} px, measured as ${covered} px`);
    // What has the focus is not behind it.
    await page.evaluate(() => document.getElementById("doctor-again").focus());
    await page.keyboard.down("Shift");
    for (let i = 0; i < 4; i++) await page.keyboard.press("Tab");
    await page.keyboard.up("Shift");
    const [top, isInHeader] = await page.evaluate(() => [document.activeElement.getBoundingClientRect().top, Boolean(document.activeElement.closest("header"))]);
    assert.ok(isInHeader || top >= bottom - 1, `${top} px`);
    assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), width);
  });
}

// The words beside E-STOP are as long as they may be, and longer.
const LONG = "a cause of many words that tells about all motors and rails of the array, and about what to look at before anybody touches a pin; ".repeat(4);
const SESSION = { participant: "P".repeat(40), owner: "somebody with a long name on another machine", mine: false, exclusive: true, released: false };
const STATES = [
  ["disarmed", { state: "disarmed", position: "known" }], ["nobody has looked", { state: "disarmed", position: "unknown" }], ["armed", { state: "armed" }],
  ["armed by a long name", { state: "armed", armed: { by: LONG } }], ["playing", { state: "armed", play: { id: 1, pattern: "a".repeat(64), played_s: 12345.6 } }],
  ["waiting", { state: "armed", play: { id: 1, pattern: "b", played_s: 1 }, queued: [{ id: 2, pattern: "c" }] }], ["returning", { state: "returning" }],
  ["e-stopped", { state: "faulted", cause: "estop" }], ["a fault", { state: "faulted", cause: LONG }], ["no device", { state: "no-device", device: null, tick: null }],
  ["pins that stand", { state: "disarmed", position: "known", standing: { height_um: 400, age_s: 123456 } }], ["a state of a newer daemon", { state: "novel" }], ["another's session", { state: "armed", session: SESSION }], ["an observer", { state: "armed", role: "observe" }],
];

test("E-STOP is the same rectangle in all states, whatever stands beside it, and nothing lies over it (smoke)", async () => {
  const daemon = await new Daemon().start();
  const real = await daemon.status();
  // What the daemon's status is: another one than the real one, an answer, or none.
  let answer = (response) => response.end(JSON.stringify(real));
  await proxied(daemon, (request, response, forward) => (request.url === "/v1/status" ? answer(response) : request.url === "/v1/estop" ? response.destroy() : forward()), async (url) => {
    const page = await open({ url });
    await shows(page, "state-text", "Disarmed");
    const windows = [[320, 480], [375, 667], [768, 1024], [1280, 720], [1920, 1080], [3000, 900]];
    // In pixels of the page, a zoom of 200 % halves a window. Its text alone may be twice as large, too.
    const looks = [...windows, ...windows.map((of) => of.map((px) => px / 2)).filter(([width]) => width >= 320)].flatMap((of) => [[...of, 100], [...of, 200]]);
    const boxes = new Map();
    const measure = async (what) => {
      for (const look of looks) {
        const [width, height, percent] = look;
        await page.setViewport({ width, height });
        const [box, over] = await page.evaluate((percent) => {
          document.documentElement.style.fontSize = `${(16 * percent) / 100}px`;
          const button = document.getElementById("estop");
          const { left, top, right, bottom } = button.getBoundingClientRect();
          const corners = [[left + 9, top + 9], [right - 9, top + 9], [left + 9, bottom - 9], [right - 9, bottom - 9], [(left + right) / 2, (top + bottom) / 2]];
          const texts = [...document.querySelectorAll("#state-text, #touch, #estop-note, #link, #owner, #armed-by, .tools button, #may-not, #views a, dialog[open] button")].filter((one) => one.checkVisibility());
          const isOver = (one) => [...one.getClientRects()].some((of) => of.left < right && of.right > left && of.top < bottom && of.bottom > top);
          return [[left, top, right, bottom], [...corners.filter(([x, y]) => !button.contains(document.elementFromPoint(x, y))), ...texts.filter(isOver).map((one) => one.outerHTML)]];
        }, percent);
        assert.deepEqual(over, [], `${what} at ${look}`);
        if (!boxes.has(String(look))) boxes.set(String(look), box);
        assert.deepEqual(box, boxes.get(String(look)), `${what} at ${look}`);
        const [left, top, right, bottom] = box;
        assert.ok(left >= 0 && top >= 0 && right <= width && bottom <= height && right - left >= 120 && bottom - top >= 60, `${look}: ${box}`);
      }
    };
    for (const [what, more] of STATES) {
      answer = (response) => response.end(JSON.stringify({ ...real, ...more }));
      // The state that the page has is this one.
      await page.waitForFunction((more) => Object.entries(more).every(([key, value]) => JSON.stringify(meissner.known()?.[key]) === JSON.stringify(value)), WAIT, more);
      await measure(what);
    }
    for (const dialog of ["arm-dialog", "reset-dialog", "calibrate-dialog"]) {
      await page.$eval(`#${dialog}`, (one) => one.show());
      await measure(dialog);
      await page.$eval(`#${dialog}`, (one) => one.close("cancel"));
    }
    await page.focus(".skip");
    await measure("the link to the view has the focus");
    answer = (response) => response.destroy();
    await shows(page, "touch", "The state is not known");
    await measure("unreachable");
    await page.click("#estop");
    await shows(page, "estop-note", "NOT CONFIRMED");
    await measure("not confirmed");
    answer = (response) => response.writeHead(401, { "content-type": "application/json" }).end(JSON.stringify({ code: "unauthorized", detail: LONG }));
    await page.waitForSelector("#sign-in:not([hidden])");
    await measure("a token is asked for");
  });
});

test("a dialog takes clicks and keys, but not those of E-STOP, and gives the focus back", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await page.click("#estop");
  await page.waitForSelector("#reset:not([disabled])");
  await page.focus("#reset");
  await page.keyboard.press("Enter");
  assert.equal(await page.$eval("#reset-dialog", (dialog) => dialog.open), true);
  // Clicks on what lies below do nothing.
  const box = await (await page.$('#views a[href="#device"]')).boundingBox();
  await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
  assert.deepEqual(await shownViews(page), ["play"]);
  // The Tab key reaches the dialog and E-STOP, and nothing else of the page.
  const reached = new Set();
  for (let i = 0; i < 8; i++) {
    await page.keyboard.press("Tab");
    reached.add(await page.evaluate(() => document.activeElement.closest("dialog")?.id ?? document.activeElement.id));
  }
  reached.delete("");
  assert.deepEqual([...reached].sort(), ["estop", "reset-dialog"]);
  const { estops } = await daemon.status();
  const stops = stopsOf(page);
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  const got = (await daemon.status()).estops - estops;
  assert.ok(got >= 1 && got <= stops.sent);
  assert.equal(await page.$eval("#reset-dialog", (dialog) => dialog.open), true);
  // Escape closes it, wherever the focus is. On a busy machine the state grows old at times: then Reset is off, and cannot have the focus.
  await page.waitForFunction(() => {
    if (document.getElementById("reset").disabled) return false;
    document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key: "Escape", bubbles: true }));
    return true;
  }, WAIT);
  await page.waitForFunction(() => !document.getElementById("reset-dialog").open && document.activeElement.id === "reset", WAIT);
  await view(page, "device");
});

test("Escape twice stops from wherever the focus is, and nothing that a person types does (smoke)", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  assert.ok((await text(page, "estop")).includes("Escape twice"));
  // A key between the two, a key that is held, and text.
  await page.focus("#search");
  await page.keyboard.press("Escape");
  await page.keyboard.type("e.E>");
  await page.keyboard.press("Escape");
  await page.keyboard.press("a");
  await page.keyboard.down("Escape");
  await page.keyboard.down("Escape");
  await page.keyboard.up("Escape");
  await page.keyboard.press("b");
  await page.keyboard.press("Escape");
  await press(page, "#search");
  await page.keyboard.press("Escape");
  await page.keyboard.press("b");
  assert.equal((await daemon.status()).estops, 0);
  await page.evaluate(() => {
    globalThis.stops = 0;
    const fetch = window.fetch;
    window.fetch = (url, options) => ((stops += Number(url === "/v1/estop")), fetch(url, options));
  });
  // The two presses are too far apart if the machine stands still between them: then a person presses again.
  const twice = async (what, first) => {
    const { estops } = await daemon.status();
    const until = Date.now() + WAIT.timeout;
    do {
      assert.ok(Date.now() < until, what);
      await page.evaluate(() => (stops = 0));
      await first();
      await page.keyboard.press("Escape");
    } while (!(await page.evaluate(() => stops)));
    await shows(page, "estop-note", "All lines are off.");
    while ((await daemon.status()).estops <= estops) assert.ok(Date.now() < until, what);
  };
  for (const field of ["#search", "#views a", "#seconds"]) {
    await twice(field, async () => {
      await page.focus(field);
      await page.keyboard.press("b");
      await page.keyboard.press("Escape");
    });
  }
  // In a dialog the first press closes it.
  await twice("dialog", async () => {
    await press(page, "#reset");
    await page.keyboard.press("Escape");
    assert.equal(await page.$eval("#reset-dialog", (dialog) => dialog.open), false);
  });
});

test("an answer stands beside its control, in the page's words, and is read to screen readers", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await page.waitForSelector("#pattern-list li");
  const play = 'li[data-name="pin-60"] button';
  await page.type("#seconds", "5");
  await press(page, play);
  await answers(page, play, "The motors are disarmed: press Arm first.");
  await shows(page, "speak", "The motors are disarmed: press Arm first.");
  const [line, button] = await page.$eval(play, (button) => [button.closest("li").querySelector(".say"), button].map((part) => part.getBoundingClientRect().toJSON()));
  assert.ok(Math.abs(line.top - button.bottom) < 60, `${line.top} and ${button.bottom}`);
  assert.equal(await page.$eval("#alert", (alert) => alert.hidden), true, "that is for the connection");
  // A success takes the line away.
  await arm(page);
  await press(page, play);
  await shows(page, "state-text", "Playing pin-60");
  await page.waitForFunction((play) => document.querySelector(play).closest("li").querySelector(".say").hidden, WAIT, play);
});

test("live regions speak at most once a second, and not of the time played", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon, 1400, 1000, "design");
  await post(daemon, "/v1/arm", { assume_rest: true, checked: "a test" });
  // A clock and timers that stand still.
  const [delays, spoken] = await page.evaluate(() => {
    const [timer, now] = [globalThis.setTimeout, performance.now];
    const waiting = [];
    const delays = [];
    performance.now = () => 1e9;
    globalThis.setTimeout = (run, ms) => (waiting.push(run), delays.push(ms));
    const press = (times) => {
      for (let i = 0; i < times; i++) document.querySelector("#pad svg").dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
      while (waiting.length) waiting.pop()();
      return document.getElementById("speak").textContent;
    };
    const spoken = [press(10), press(3)];
    [globalThis.setTimeout, performance.now] = [timer, now];
    return [delays, spoken];
  });
  assert.deepEqual([delays, spoken], [[0, 1000], ["-5, 0 mm", "-6.5, 0 mm"]]);
  await post(daemon, "/v1/play", { pattern: "pin-60", seconds: 300 });
  await shows(page, "state-say", "Playing pin-60. Pins vibrate.");
  const [shown, said] = await page.evaluate(() => new Promise((done) => {
    const counts = [0, 0];
    ["state-text", "state-say"].forEach((id, i) => new MutationObserver(() => {
      counts[i] += 1;
      if (counts[0] === 5) done(counts);
    }).observe(document.getElementById(id), { childList: true, characterData: true, subtree: true }));
  }));
  assert.deepEqual([shown, said], [5, 0]);
});

// What stands on the page's backgrounds in the shown view: lines, dots and marks, each with its contrast.
const contrasts = (page) => page.evaluate(() => {
  const canvas = Object.assign(document.createElement("canvas"), { width: 1, height: 1 }).getContext("2d", { willReadFrequently: true });
  const light = (colour) => {
    canvas.fillStyle = colour;
    canvas.fillRect(0, 0, 1, 1);
    const [r, g, b] = [...canvas.getImageData(0, 0, 1, 1).data].map((value) => value / 255).map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const contrast = (a, b) => (Math.max(light(a), light(b)) + 0.05) / (Math.min(light(a), light(b)) + 0.05);
  // Colours of the system are names, which the canvas does not know as this page's.
  const probe = document.body.appendChild(document.createElement("span"));
  const resolved = (name) => ((probe.style.color = `var(${name})`), getComputedStyle(probe).color);
  const [paper, panel] = ["--paper", "--panel"].map(resolved);
  // A dot is seen by its outline, or by itself.
  const drawn = ".dot, .finger .pin, .shape-dot, .shape-line, .cursor, .handle, .spikes, .pin-place, .trace-line, .offset";
  const dots = [...document.querySelectorAll(drawn)].filter((dot) => dot.checkVisibility()).map((dot) => getComputedStyle(dot)).map(({ stroke, fill }) => (stroke === "none" ? fill : stroke));
  const marks = ["--good", "--accent", "--stop", "--warn", "--fail", "--soft", "--up", "--down"].map(resolved);
  probe.remove();
  return [...new Set([...dots, ...marks])].flatMap((colour) => [paper, panel].map((back) => [colour, back, contrast(colour, back)]));
});

test("every dot and mark is seen on light, on dark and in forced colours", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await page.waitForSelector('li[data-name="all-in-phase"] .dot');
  await press(page, 'li[data-name="all-in-phase"] .choose');
  await page.waitForSelector(".preview .spikes");
  await view(page, "design");
  await page.select("#shape", "braille");
  await page.waitForSelector("#thing-rasters .spikes", WAIT);
  const media = await page.createCDPSession();
  for (const features of [{ "prefers-color-scheme": "light" }, { "prefers-color-scheme": "dark" }, { "forced-colors": "active" }]) {
    await media.send("Emulation.setEmulatedMedia", { features: Object.entries(features).map(([name, value]) => ({ name, value })) });
    for (const name of ["play", "design"]) {
      await view(page, name);
      const found = await contrasts(page);
      // Forced colours are few.
      assert.ok(found.length >= (features["forced-colors"] ? 4 : 12), `${found.length}`);
      assert.deepEqual(found.filter(([, , ratio]) => ratio < 3), [], `${name}, ${JSON.stringify(features)}`);
    }
  }
  // In forced colours E-STOP stays red, with words that are seen on it.
  const estop = await page.$eval("#estop", (button) => [getComputedStyle(button).backgroundColor, getComputedStyle(button).color]);
  const [[r, g, b], words] = estop.map((colour) => colour.match(/\d+/g).map(Number));
  assert.ok(r > 2 * g && r > 2 * b && Math.min(...words) > 200, estop.join());
});

// The daemon's refusals, from its source.
const REFUSALS = readFileSync(new URL("../../crates/stream/src/queues/error.rs", import.meta.url), "utf8");
const OTHERS = [
  "`pin-60` has no end: add `seconds` (--seconds S), or allow a play without end with `endless` (--endless)",
  "`a` is stored already (sha256 12ab): `--replace`, or `?replace=true`, stores the new one in its place",
  "this daemon keeps no session record: start it without --no-record, and see `logbook_days`",
  "session 1 with participant `P07` runs since 10:00: end it first with `meissner session end`",
  "`session` is not the running one, abc: name that, or leave the key out",
  "unknown: use --some-thing X",
];

test("the page's words have no backticks, no options and no commands", () => {
  const texts = [...REFUSALS.matchAll(/#\[error\(\s*"((?:[^"\\]|\\[^])*)"/g)].map(([, text]) => text.replace(/\\\n\s*/g, "").replaceAll('\\"', '"'));
  assert.ok(texts.length >= 15);
  for (const text of [...texts, ...OTHERS]) {
    const words = plain(text);
    assert.ok(!/`|(^|[^\w])--\w|meissner /.test(words) && /[.!?]$/.test(words), `${text}\n${words}`);
  }
  assert.equal(plain("the motors are disarmed: run `meissner arm` first"), "The motors are disarmed: press Arm first.");
  assert.equal(plain("`pin-60` has no end: add `seconds` (--seconds S), or allow a play without end with `endless` (--endless)"), "pin-60 has no end: enter its seconds.");
  assert.equal(plain("an emergency stop or fault is latched: find out why, then `meissner reset` and `meissner arm`"), "An emergency stop or fault is latched: find out why, then press Reset and press Arm.");
  assert.equal(plain("`scale` is 2: must be 0 to 1"), "Amplitude scale is 2: must be 0 to 1.");
  // What only a command can do is named.
  assert.equal(plain("calibrate with a laser, `meissner calibrate --plan`"), "Calibrate with a laser, “meissner calibrate” on the daemon's machine.");
});

for (const scheme of ["light", "dark"]) {
  test(`the ${scheme} page has no fault that axe finds, and fits from 320 to 3840 px`, async () => {
    const daemon = new Daemon();
    writeFileSync(join(daemon.dir, "calibration.toml"), CALIBRATION);
    await daemon.start();
    const page = await open(daemon, 360, 640);
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }, { name: "prefers-reduced-motion", value: "reduce" }]);
    await arm(page);
    await page.$eval("#seconds", (input) => (input.value = "0.1"));
    await page.waitForSelector("#pattern-list .thumbnail");
    await press(page, "#pattern-list li button");
    await shows(page, "receipt-summary", ": done");
    await page.$eval("#receipt-more", (details) => (details.open = true));
    await view(page, "design");
    await page.select("#shape", "braille");
    await page.waitForSelector("#thing-maps figure", WAIT);
    await view(page, "device");
    await page.waitForSelector("#fit-grid .plot");
    await page.waitForSelector("#findings li");
    await page.$eval("#fit-values details", (details) => (details.open = true));
    // A session with a play and an answer, which Record shows.
    await post(daemon, "/v1/sessions", { participant: "P07", exclusive: false });
    await post(daemon, "/v1/play", { pattern: "pin-60", seconds: 0.1 });
    await view(page, "record");
    await page.waitForSelector("#sessions button");
    await press(page, "#sessions button");
    await shows(page, "plays-title", "Session of P07");
    await page.evaluate(AXE);
    const tagged = { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"] };
    const faults = (violations) => violations.map((of) => `${of.id}: ${of.nodes.map((node) => node.html).join(" | ")}`);
    for (const dialog of await page.$$("dialog")) {
      const [id, { violations }] = await dialog.evaluate(async (dialog, tagged) => {
        dialog.show();
        const result = [dialog.id, await axe.run(dialog, tagged)];
        dialog.close("cancel");
        return result;
      }, tagged);
      assert.deepEqual(faults(violations), [], id);
    }
    for (const name of ["play", "design", "record", "device"]) {
      await view(page, name);
      for (const width of [320, 360, 768, 1400, 3840]) {
        await page.setViewport({ width, height: 800 });
        const [scroll, client] = await page.evaluate(() => [document.documentElement.scrollWidth, document.documentElement.clientWidth]);
        assert.ok(scroll <= client, `${name}, ${width} px: the page is ${scroll} px wide`);
        const box = await page.$eval("#estop", (button) => button.getBoundingClientRect().toJSON());
        assert.ok(box.top >= 0 && box.bottom <= 800 && box.height >= 44, `${name}, ${width} px: the emergency stop is in sight`);
        // Other widths have the same layout.
        if (width !== 360 && width !== 1400) continue;
        const { violations } = await page.evaluate((tagged) => axe.run(document, tagged), tagged);
        assert.deepEqual(faults(violations), [], `${name}, ${width} px`);
      }
    }
  });
}
