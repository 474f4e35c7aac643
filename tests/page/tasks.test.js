// No task of the page's main thread is long, within the product's own limits: between two tasks E-STOP is heard. The tests count what a task
// makes, not how long it takes; the longest one is only printed.

import assert from "node:assert/strict";
import { test } from "node:test";
import { arm, browsing, Daemon, press, proxied, shows, view, WAIT } from "./daemon.js";
import { choose, get } from "./play.js";

const { blank } = browsing();
// Elements, and thousands of characters of JSON and texts that a task makes, at most.
const ELEMENTS = 1600;
const THOUSANDS = 1000;

// A window that counts what its tasks make.
async function counting(url, name) {
  const page = await blank();
  page.setDefaultTimeout(WAIT.timeout);
  await page.evaluateOnNewDocument(() => {
    const most = { elements: 0, thousands: 0, ms: 0 };
    let now = null;
    globalThis.tasks = most;
    const count = (kind, number) => {
      if (!now) {
        now = { elements: 0, thousands: 0 };
        // It runs before every other task.
        scheduler.postTask(() => {
          for (const key of Object.keys(now)) most[key] = Math.max(most[key], now[key]);
          now = null;
        }, { priority: "user-blocking" });
      }
      now[kind] += number;
    };
    for (const name of ["createElement", "createElementNS"]) {
      const make = Document.prototype[name];
      Document.prototype[name] = function (...all) {
        count("elements", 1);
        return make.apply(this, all);
      };
    }
    const { stringify } = JSON;
    JSON.stringify = (...all) => {
      const text = stringify(...all);
      count("thousands", (text?.length ?? 0) / 1000);
      return text;
    };
    const { get, set } = Object.getOwnPropertyDescriptor(Node.prototype, "textContent");
    Object.defineProperty(Node.prototype, "textContent", { get, set(text) {
      count("thousands", String(text).length / 1000);
      set.call(this, text);
    }, configurable: true });
    new PerformanceObserver((list) => list.getEntries().forEach(({ duration }) => (most.ms = Math.max(most.ms, duration)))).observe({ type: "longtask", buffered: true });
  });
  await page.setViewport({ width: 1400, height: 1000 });
  await page.goto(`${url}/#${name}`);
  return page;
}

async function judge(page, what) {
  const { elements, thousands, ms } = await page.evaluate(() => tasks);
  console.log(`${what}: at most ${elements} elements and ${thousands.toFixed(0)} 000 characters in a task; the longest one took ${ms.toFixed(0)} ms`);
  assert.ok(elements > 0 && elements <= ELEMENTS && thousands <= THOUSANDS, `${what}: ${elements} elements, ${thousands.toFixed(0)} 000 characters`);
}

// Answers of the daemon in place of its own, by path.
const answering = (answers) => (request, response, forward) => {
  const found = answers[request.url] ?? answers[request.url.replace(/\?.*/, "")];
  if (!found) return forward();
  response.writeHead(200, { "content-type": "application/json" });
  response.end(JSON.stringify(found));
};

test("the receipt of a sequence of 4096 items is shown in short tasks", async () => {
  const daemon = await new Daemon().start();
  await proxied(daemon, answering({}), async (url) => {
    const page = await counting(url, "play");
    await arm(page);
    const items = Array.from({ length: 4096 }, (_, i) => ({ pattern: i % 2 ? "pin-60" : "edge-45", seconds: 0.05, gap_ms: i % 3 }));
    assert.ok((await fetch(`${daemon.url}/v1/play`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ name: "long", items }) })).ok);
    await shows(page, "queue", "4096 items; began");
    await fetch(`${daemon.url}/v1/stop`, { method: "POST" });
    await shows(page, "receipt-facts", "not-begun");
    await judge(page, "sequence");
    await page.close();
  });
});

test("lists of 10 000 patterns and sessions are shown in short tasks", async () => {
  const daemon = await new Daemon().start();
  const many = (one) => Array.from({ length: 10000 }, (_, i) => ({ ...one, name: `many-${i}`, id: `s-${i}` }));
  const { patterns: [pattern] } = await get(daemon, "/v1/patterns");
  const session = { id: "s", participant: "P", experiment: "e", started: "2026-11-20T10:00:00Z", plays: 3, reason: "ended" };
  const through = answering({
    "/v1/patterns": { patterns: many(pattern), errors: [] }, "/v1/sessions": { sessions: many(session), unreadable: 0 },
  });
  await proxied(daemon, (request, response, forward) => {
    request.url = request.url.replace(/many-\d+/, pattern.name);
    through(request, response, forward);
  }, async (url) => {
    const page = await counting(url, "play");
    await shows(page, "pattern-none", "The first 200 of 10000");
    await page.type("#search", "many-77");
    await page.waitForSelector('li[data-name="many-7700"]');
    await view(page, "record");
    await shows(page, "sessions-none", "The newest 100 of 10000");
    await judge(page, "lists");
    await page.close();
  });
});

test("4096 events that come at once are taken in short tasks", async () => {
  const daemon = await new Daemon().start();
  const event = `data: ${JSON.stringify({ event: "late", id: 7, motor: 3, late_ms: 1.8, tick: 5 })}\n\n`;
  await proxied(daemon, (request, response, forward) => {
    if (request.url !== "/v1/events") return forward();
    response.writeHead(200, { "content-type": "text/event-stream" });
    response.write(event.repeat(4096));
  }, async (url) => {
    const page = await counting(url, "play");
    await shows(page, "events-newest", "Play 7: 4096 strokes came too late");
    await judge(page, "events");
    await page.close();
  });
});

test("a pattern of 4096 drives is shown in short tasks", async () => {
  const daemon = await new Daemon().start();
  const drives = Array.from({ length: 4096 }, (_, i) => `[[drive]]\nmotor = ${i % 24}\nfrequency_hz = 60.0\namplitude_um = 50.0\nphase = 0.0\nstart_s = ${(Math.floor(i / 24) / 10).toFixed(1)}\nstop_s = ${(Math.floor(i / 24) / 10 + 0.09).toFixed(2)}\n`).join("");
  const stored = await fetch(`${daemon.url}/v1/patterns/long`, { method: "PUT", headers: { "content-type": "application/toml" }, body: `format = 1\nname = "long"\narray = "tula35-6x4"\nduration_s = 18.0\n${drives}` });
  assert.ok(stored.ok, await stored.text());
  await proxied(daemon, answering({}), async (url) => {
    const page = await counting(url, "play");
    await choose(page, "long");
    await page.waitForSelector("#previews .traces");
    await judge(page, "drives");
    await page.close();
  });
});

test("a session of 5000 plays is shown in short tasks", async () => {
  const daemon = await new Daemon().start();
  await daemon.run("arm", "--assume-rest");
  const post = async (path, body) => (await fetch(`${daemon.url}${path}`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) })).json();
  const { id } = await post("/v1/sessions", { participant: "P06", exclusive: false });
  await post("/v1/play", { pattern: "pin-60", seconds: 0.1 });
  await get(daemon, "/v1/plays/1?wait=60");
  await post(`/v1/sessions/${id}/end`, {});
  const real = await get(daemon, `/v1/sessions/${id}/plays`);
  await proxied(daemon, (request, response, forward) => {
    const from = Number(/\/plays\?from=(\d+)/.exec(request.url)?.[1] ?? -1);
    const plays = Array.from({ length: Math.max(0, Math.min(1000, 5000 - from)) }, (_, i) => ({ ...real.plays[0], receipt: { ...real.plays[0].receipt, id: from + i + 1 } }));
    answering(from < 0 ? {} : { [request.url]: { ...real, plays, more: from + plays.length < 5000 } })(request, response, forward);
  }, async (url) => {
    const page = await counting(url, "record");
    await page.waitForSelector("#sessions button");
    await press(page, "#sessions button");
    await shows(page, "plays-none", "Plays 1 to 100.");
    await judge(page, "session");
    await page.close();
  });
});
