// The page's shell: the header, the views, dialogs, the shortcut of E-STOP, and answers beside their controls. The tests use a real
// browser and a real daemon with the simulated array.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { test } from "node:test";
import { plain } from "../../src/daemon/page/assets/words.js";
import { answers, arm, browsing, Daemon, press, proxied, shows, stopsOf, text, view, WAIT } from "./daemon.js";

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
      assert.deepEqual(await page.$$eval("h1", (all) => all.map((one) => one.textContent)), [title]);
      await page.waitForFunction((title) => document.title === `Armed · ${title} · meissner`, WAIT, title);
      assert.ok(await page.$eval(".finger", (finger) => finger.getBoundingClientRect().height > 100), "no view hides the finger");
      await page.close();
    }
    const page = await open({ url }, 1400, 1000, "record");
    await view(page, "device");
    await page.goBack();
    await page.waitForSelector('[data-view="record"]:not([hidden])');
    await page.goForward();
    await page.waitForSelector('[data-view="device"]:not([hidden])');
    // What is no view is the first one.
    await page.goto(`${url}/#nothing`);
    await page.reload();
    await page.waitForSelector('[data-view="play"]:not([hidden])');
    assert.deepEqual(page.complaints, []);
  });
});

// States, how the band looks in each, and what the status has then. The words beside E-STOP are as long as they may be, and longer.
const LONG = "a cause of many words that tells about all motors and rails of the array, and about what to look at before anybody touches a pin; ".repeat(4);
const SESSION = { participant: "P".repeat(40), owner: "somebody with a long name on another machine", mine: false, exclusive: true, released: false };
const STATES = [
  ["disarmed", "safe", { state: "disarmed", position: "known" }], ["nobody has looked", "unknown", { state: "disarmed", position: "unknown" }], ["armed", "armed", { state: "armed" }],
  ["armed by a long name", "armed", { state: "armed", armed: { by: LONG, for_s: 1234567 } }], ["playing", "moving", { state: "armed", play: { id: 1, name: "a".repeat(64), played_s: 12345.6 } }],
  ["waiting", "moving", { state: "armed", play: { id: 1, name: "b", played_s: 1 }, queued: [{ id: 2, name: "c" }] }], ["returning", "moving", { state: "returning" }],
  ["e-stopped", "stopped", { state: "faulted", cause: "estop", estop: { orders: 1, by: LONG, age_s: 7, off_ms: 1 } }], ["a fault", "stopped", { state: "faulted", cause: LONG }], ["no device", "unknown", { state: "no-device", device: null, clock: null }],
  ["pins that stand", "armed", { state: "disarmed", position: "known", standing: { height_um: 400, age_s: 123456 } }], ["a state of a newer daemon", "unknown", { state: "novel" }], ["another's session", "armed", { state: "armed", session: SESSION }], ["an observer", "armed", { state: "armed", daemon: { role: "observe" } }],
];

test("E-STOP is the same rectangle in all states, whatever stands beside it, and nothing lies over it (smoke)", async () => {
  const daemon = await new Daemon().start();
  let real;
  do real = await daemon.status();
  while (!real.clock);
  // What the daemon's status is: another one than the real one, an answer, or none.
  let answer = (response) => response.end(JSON.stringify(real));
  await proxied(daemon, (request, response, forward) => (request.url === "/v1/status" ? answer(response) : request.url === "/v1/estop" ? response.destroy() : forward()), async (url) => {
    const page = await open({ url });
    await shows(page, "state-text", "Disarmed");
    const windows = [[320, 480], [390, 844], [768, 1024], [1100, 800], [1400, 1000], [3000, 900]];
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
        // It is the same at every width, too; twice as large is its text, with what it stands in.
        if (!boxes.has(percent)) boxes.set(percent, box);
        assert.deepEqual(box, boxes.get(percent), `${what} at ${look}`);
        const [left, top, right, bottom] = box;
        assert.ok(left >= 0 && top >= 0 && right <= width && bottom <= height && right - left >= 120 && bottom - top >= 60, `${look}: ${box}`);
      }
    };
    for (const [what, look, more] of STATES) {
      answer = (response) => response.end(JSON.stringify({ ...real, ...more }));
      // The state that the page has is this one.
      await page.waitForFunction((more) => Object.entries(more).every(([key, value]) => JSON.stringify(meissner.known()?.[key]) === JSON.stringify(value)), WAIT, more);
      await page.waitForFunction((look) => document.getElementById("bar").dataset.look === look, WAIT, look);
      await measure(what);
    }
    for (const dialog of ["arm-dialog", "reset-dialog"]) {
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
  const { estop: { orders } } = await daemon.status();
  const stops = stopsOf(page);
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  const got = (await daemon.status()).estop.orders - orders;
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
  assert.equal((await daemon.status()).estop.orders, 0);
  await page.evaluate(() => {
    globalThis.stops = 0;
    const fetch = window.fetch;
    window.fetch = (url, options) => ((stops += Number(url === "/v1/estop")), fetch(url, options));
  });
  // The two presses are too far apart if the machine stands still between them: then a person presses again.
  const twice = async (what, first) => {
    const { estop: { orders } } = await daemon.status();
    const until = Date.now() + WAIT.timeout;
    do {
      assert.ok(Date.now() < until, what);
      await page.evaluate(() => (stops = 0));
      await first();
      await page.keyboard.press("Escape");
    } while (!(await page.evaluate(() => stops)));
    await shows(page, "estop-note", "All lines are off.");
    while ((await daemon.status()).estop.orders <= orders) assert.ok(Date.now() < until, what);
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

test("a problem is told in the page's words for its code, or in the daemon's without backticks", () => {
  assert.equal(plain({ code: "disarmed", message: "the motors are disarmed: run `meissner arm` first" }), "The motors are disarmed: press Arm first.");
  assert.equal(plain({ code: "bad-request", message: "`scale` is 2: must be 0 to 1" }), "“scale” is 2: must be 0 to 1.");
  assert.equal(plain(new Error("own.toml is no pattern")), "own.toml is no pattern.");
});

for (const scheme of ["light", "dark"]) {
  test(`the ${scheme} page has no fault that axe finds, and fits from 320 to 3840 px`, async () => {
    const daemon = await new Daemon().start();
    const page = await open(daemon, 360, 640);
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }, { name: "prefers-reduced-motion", value: "reduce" }]);
    await arm(page);
    await page.$eval("#seconds", (input) => (input.value = "0.1"));
    await page.waitForSelector("#pattern-list .thumbnail");
    await press(page, "#pattern-list li button");
    await shows(page, "receipt-summary", ": done");
    await view(page, "design");
    await page.select("#shape", "braille");
    await page.waitForSelector("#thing-maps figure", WAIT);
    await view(page, "device");
    await page.waitForSelector("#findings li");
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
        await page.evaluate(() => scrollTo(0, document.documentElement.scrollHeight));
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
