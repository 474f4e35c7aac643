// The page shows the true state of the display, or that it is unknown. The tests use a real browser and a real daemon with the
// simulated array, over a network that delays and loses messages.
//
// Time is counted in turns of the page's event loop, so a machine that stands still does not count.

import assert from "node:assert/strict";
import { test } from "node:test";
import { answers, arm, browsing, Daemon, networked, press, proxied, shows, stopsOf, text, view, WAIT } from "./daemon.js";

const { open, blank } = browsing();

// Another client's request.
async function other(daemon, path, body = {}) {
  const response = await fetch(`${daemon.url}${path}`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) });
  const answer = await response.json();
  assert.ok(response.ok, `${path}: ${answer.detail}`);
  return answer;
}

// What the finger says, the pins that are drawn above rest, and how many are drawn as not known.
const finger = (page) => page.$eval(".finger", (canvas) => ({
  label: canvas.ariaLabel, up: canvas.drawn.flatMap((um, i) => (um >= 0.5 ? [i] : [])), unknown: canvas.drawn.filter((um) => um === null).length,
}));
const labelled = (page, part) => page.waitForFunction((part) => document.querySelector(".finger").getAttribute("aria-label").includes(part), WAIT, part);

// Lists what the page says about touching, each with the number of preceding turns of the page's event loop, of 100 ms.
const listen = (page) => page.evaluate(() => {
  const touch = document.getElementById("touch");
  // Only the last one that listens is heard.
  const said = [];
  globalThis.said = said;
  let turns = 0;
  setInterval(() => (turns += 1), 100);
  const say = () => said.push([turns, touch.textContent]);
  new MutationObserver(say).observe(touch, { childList: true, characterData: true, subtree: true });
  say();
});

test("what stands beside E-STOP follows the state", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await shows(page, "armed-by", "armed by 127.0.0.1, for ");
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  await page.waitForFunction(() => /^stopped by 127\.0\.0\.1.* ago$/.test(document.getElementById("armed-by").textContent), WAIT);
  await other(daemon, "/v1/reset", { force: true });
  await shows(page, "state-text", "Disarmed");
  assert.equal(await text(page, "estop-note"), "");
  await other(daemon, "/v1/arm", { assume_rest: true, checked: "a test" });
  await other(daemon, "/v1/play", { pattern: "pin-60", seconds: 300 });
  await shows(page, "state-text", "Playing pin-60");
  assert.equal(await text(page, "estop-note"), "");
  // A stop of another client counts, too.
  await other(daemon, "/v1/estop");
  await shows(page, "estop-note", "All lines are off.");
});

test("a state that is older than a second is not known, and an answer that was held up is no news (smoke)", async () => {
  const daemon = await new Daemon().start();
  await networked(daemon, async (network) => {
    const page = await open(network);
    await shows(page, "state-text", "Disarmed");
    await shows(page, "touch", "the place of the pins is not known");
    await other(daemon, "/v1/arm", { assume_rest: true });
    await other(daemon, "/v1/disarm");
    await shows(page, "touch", "Safe to touch");
    await view(page, "device");
    // On a busy machine the state grows old before the network is held: then begin again.
    for (;;) {
      await shows(page, "touch", "Safe to touch");
      await listen(page);
      network.hold();
      const heard = await page.evaluate(() => said);
      if (heard.length === 1 && heard[0][1].startsWith("Safe")) break;
      network.letGo();
    }
    await other(daemon, "/v1/arm");
    await other(daemon, "/v1/play", { pattern: "pin-60", seconds: 300 });
    await shows(page, "touch", "The state is not known");
    assert.equal(await page.$eval("#state", (state) => state.dataset.state), "unknown");
    await shows(page, "facts", "Positionnot known");
    assert.deepEqual(await finger(page), { label: "What the pins do is not known.", up: [], unknown: 24 });
    // The answers that arrive now are from before the play.
    network.letGo();
    await shows(page, "touch", "Pins vibrate.");
    const [safe, unknown, ...later] = await page.evaluate(() => said);
    assert.ok(safe[1].startsWith("Safe") && unknown[1].startsWith("The state is not known"), JSON.stringify([safe, unknown]));
    assert.ok(unknown[0] < 30, `safe for ${unknown[0]} turns of 100 ms`);
    assert.deepEqual(later.filter(([, said]) => said.startsWith("Safe")), []);
    // Repeat this: a state counts as safe only while it is fresh.
    await other(daemon, "/v1/disarm");
    // Safe, or with pins that may be more than 20 µm from rest, by the phase in which the play was cut.
    await shows(page, "touch", "otors are off");
  });
});

test("no view claims a state that is older than it may be", async () => {
  const daemon = await new Daemon().start();
  await networked(daemon, async (network) => {
    const page = await open(network);
    await arm(page);
    await other(daemon, "/v1/sessions", { participant: "P-mayfly", experiment: "age", exclusive: false });
    await other(daemon, "/v1/play", { name: "ageing", items: [{ pattern: "pin-60", seconds: 300 }] });
    await other(daemon, "/v1/play", { pattern: "edge-45", seconds: 7 });
    await shows(page, "state-text", "; 1 wait");
    await shows(page, "queue", "edge-45 (play 2)");
    // What only a known state lets a view say, and the view that says it.
    const claims = [["play", "Playing ageing"], ["play", "Pins vibrate."], ["play", "armed by"], ["play", "Stop, clear 1"], ["play", "ageing (play 1)"], ["play", "edge-45 (play 2)"],   ["play", "pins move, up to"], ["record", "P-mayfly"], ["record", "A play runs or waits"], ["record", "s before a pause"], ["device", "Positionknown"]];
    const claimed = async (name) => {
      await view(page, name);
      // What is recorded is no state.
      return page.evaluate((claims) => {
        const shown = [...document.querySelectorAll("header *, main *")].filter((one) => !one.closest("#sessions, #plays") && one.checkVisibility());
        const texts = shown.flatMap((one) => [one.matches("dl, svg, p, li, span, button, h3") ? one.textContent : "", one.getAttribute("aria-label") ?? ""]);
        return claims.filter(([, words]) => texts.some((text) => text.includes(words))).map(([, words]) => words);
      }, claims);
    };
    for (const [name, words] of claims) {
      const until = Date.now() + WAIT.timeout;
      while (!(await claimed(name)).includes(words)) assert.ok(Date.now() < until, `${name} never says: ${words}`);
    }
    network.hold();
    // No answer to an earlier request comes any more.
    await page.evaluate(() => meissner.poll());
    await shows(page, "touch", "The state is not known");
    for (const name of ["play", "design", "record", "device"]) assert.deepEqual(await claimed(name), [], name);
    network.letGo();
    await shows(page, "state-text", "Playing ageing");
  });
});

// The daemon is killed in what `begin` begins in a view, and started again. `says`: where the page tells of it, and what, before, without the
// daemon and with the next one. Sessions have a test of their own.
const killed = (name, begin, [before, dead, after]) => async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await view(page, name);
  await begin(page, daemon);
  await shows(page, ...before);
  await daemon.end("SIGKILL");
  await labelled(page, "not known");
  assert.deepEqual(await finger(page), { label: "What the pins do is not known.", up: [], unknown: 24 });
  await shows(page, "touch", "The state is not known");
  assert.equal(await page.$eval("#state", (state) => state.dataset.state), "unknown");
  await shows(page, "finger-note", "What the pins do is not known.");
  await shows(page, ...dead);
  assert.equal(await page.$eval("#disarm", (button) => button.disabled), false, "what makes pins still may be tried");
  await daemon.start();
  await shows(page, "state-text", "Disarmed");
  await shows(page, ...after);
  assert.deepEqual((await finger(page)).up, []);
  await arm(page);
};

const playing = async (page, daemon) => {
  await daemon.run("play", "pin-60", "--seconds", "600");
  await labelled(page, "1 of 24 pins move");
};
test("the finger stops and is marked when the daemon dies in a play, and the next daemon has no play", killed("play", playing, [
  ["touch", "Pins vibrate."], ["touch", "The state is not known"], ["touch", "the place of the pins is not known"],
]));

const dragging = async (page) => {
  await page.select("#shape", "dots");
  await page.$eval("#points", (field) => ((field.value = "0 0"), field.dispatchEvent(new Event("change"))));
  await press(page, "#thing-live-start");
  await shows(page, "state-text", "Playing live");
};
test("a live play has lost its connection when the daemon dies, and the next daemon is disarmed", killed("design", dragging, [
  ["thing-live-note", "pressed by 500 µm"], ["thing-live-note", "The connection is lost"], ["state-text", "Disarmed"],
]));

test("a refusal goes when the state that it was about has changed, and not before", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  const play = (name) => `li[data-name="${name}"] button`;
  await page.waitForSelector(play("pin-60"));
  await shows(page, "state-text", "Disarmed");
  // Not because of the state: it stays.
  await press(page, play("pin-60"));
  await answers(page, play("pin-60"), "has no end");
  await press(page, "#pin-play");
  await answers(page, "#pin-play", "press Arm");
  // Two more states of the same kind.
  for (let states = 0; states < 2; states += 1) await page.evaluate(() => meissner.poll());
  await answers(page, "#pin-play", "press Arm");
  await arm(page);
  await page.waitForFunction(() => document.getElementById("pin-play").closest(".row").nextElementSibling.hidden, WAIT);
  await answers(page, play("pin-60"), "has no end");
});

test("a wrong field orders nothing, and says so beside itself", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await page.type("#search", "pin-60");
  const play = 'li[data-name="pin-60"]:not([hidden]) button';
  await page.waitForSelector(play);
  const line = (id) => page.$eval(`#${id}`, (field) => field.parentElement.querySelector(".wrong")?.textContent ?? "");
  for (const [id, wrong, right, says] of [["scale", "", "1", "Enter a number, 0.05 to 1."], ["seconds", "0", "9", "Enter a number, 0.05 to 3600."]]) {
    await page.$eval(`#${id}`, (field, wrong) => (field.value = wrong), wrong);
    await press(page, play);
    assert.equal(await line(id), says);
    assert.equal(await page.evaluate(() => document.activeElement.id), id);
    await page.$eval(`#${id}`, (field) => (field.value = ""));
    await page.type(`#${id}`, right);
    assert.equal(await line(id), "");
  }
  // Nothing was ordered: this is the first play.
  await press(page, play);
  await shows(page, "state-text", "Playing pin-60");
  assert.equal((await daemon.status()).play.id, 1);
});

test("an emergency stop is sent again until the daemon says that the lines are off (smoke)", async () => {
  const daemon = await new Daemon().start();
  // A proxy or gateway may answer in the daemon's place.
  const fates = {
    lost: (response) => response.destroy(),
    page: (response) => response.writeHead(200, { "content-type": "text/html" }).end("<p>Sign in to the network"),
    old: (response) => response.writeHead(200, { "content-type": "application/json" }).end(JSON.stringify({ state: "armed", motors: [], queued: [] })),
  };
  let fate = "lost";
  let forwarded = 0;
  const through = (request, response, forward) => {
    if (request.url !== "/v1/estop") return forward();
    if (fates[fate]) return fates[fate](response);
    forwarded++;
    forward();
  };
  await proxied(daemon, through, async (url) => {
    const page = await open({ url });
    const port = Number(new URL(url).port);
    await shows(page, "estop-note", `E-STOP has port ${port} alone: port ${port + 1} of 127.0.0.1, its own, does not answer. Behind a proxy`);
    await arm(page);
    await page.click("#estop");
    const unsure = "NOT CONFIRMED: the answer does not say that the lines are off. Use the switch of the supply.";
    for (const [next, says] of [["page", "NOT CONFIRMED: the daemon does not answer. Use the switch of the supply."], ["old", unsure], ["", unsure]]) {
      await shows(page, "estop-note", says);
      assert.equal((await daemon.status()).state, "armed");
      fate = next;
    }
    // The page shows this without a second press.
    await shows(page, "estop-note", "All lines are off.");
    const { state, estop: { orders } } = await daemon.status();
    // An order whose answer is late is sent again.
    assert.ok(state === "faulted" && orders >= 1 && orders <= forwarded, `${state}, ${orders}`);
  });
});

test("an emergency stop needs no answer of the API: it has a port of its own", async () => {
  const daemon = await new Daemon('listen_token = "always"\n').start();
  const token = await daemon.run("token", "create", "--role", "operate", "--name", "page");
  await networked(daemon, async (network) => {
    const page = await open(network);
    await page.evaluate((token) => meissner.token.set(token), token);
    await arm(page);
    assert.equal(await text(page, "estop-note"), "");
    network.hold();
    await page.click("#estop");
    // Unless it is confirmed, the page says so as long as the API does not answer.
    await page.waitForFunction(() => ["", "All lines are off."].includes(document.getElementById("estop-note").textContent), WAIT);
    assert.equal(JSON.parse(await daemon.run("status", "--json")).state, "faulted");
    network.letGo();
    await shows(page, "estop-note", "All lines are off.");
  });
});

// What E-STOP says of itself before anybody presses it.
const looks = (page) => page.$eval("#estop", (button) => [button.textContent.replace(/\s+/g, " ").trim(), getComputedStyle(button).backgroundColor !== "rgba(0, 0, 0, 0)"]);

test("without a valid token E-STOP says so before it is pressed, asks for one, and is sent with it", async () => {
  const daemon = await new Daemon('listen_token = "always"\n').start();
  const page = await open(daemon);
  const enter = async () => {
    await page.waitForSelector("#sign-in:not([hidden])");
    await page.type("#token", await daemon.run("token", "create", "--role", "operate", "--name", "page"));
    await press(page, "#sign-in-form button");
  };
  const state = async () => JSON.parse(await daemon.run("status", "--json")).state;
  const says = async () => {
    await shows(page, "estop-note", "E-STOP does nothing: the daemon takes none from this window without a valid access token.");
    assert.deepEqual(await looks(page), ["E-STOP needs a token", false]);
  };
  // There is no token yet.
  await says();
  await enter();
  await arm(page);
  assert.deepEqual(await looks(page), ["E-STOP or Escape twice", true]);
  assert.equal(await text(page, "estop-note"), "");
  await daemon.run("token", "revoke", /^\S+/.exec((await daemon.run("token", "list")).split("\n").at(-1))[0]);
  await says();
  await page.click("#estop");
  await shows(page, "estop-note", "NOT CONFIRMED: the access token is not valid any more. Use the switch of the supply. Enter another access token");
  await shows(page, "touch", "The state is not known");
  assert.equal(await state(), "armed");
  await enter();
  await shows(page, "estop-note", "All lines are off.");
  assert.equal(await state(), "faulted");
  await page.waitForSelector("#sign-in[hidden]");
  assert.deepEqual(await looks(page), ["E-STOP or Escape twice", true]);
});

test("where no token is needed a wrong one keeps nobody from E-STOP", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await page.evaluate(() => meissner.token.set("mst_00"));
  await page.waitForSelector("#sign-in:not([hidden])");
  assert.deepEqual(await looks(page), ["E-STOP or Escape twice", true]);
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  assert.equal((await daemon.status()).state, "faulted");
});

test("E-STOP needs no other script, and is off until it works", async () => {
  const daemon = await new Daemon().start();
  // The fate of the scripts: delayed, missing, or wrong.
  let fate = () => "";
  const through = (request, response, forward) => {
    const does = request.url.endsWith(".js") ? fate(request.url) : "";
    if (does === "held") return;
    if (does === "gone") return response.destroy();
    if (does === "wrong") return response.writeHead(200, { "content-type": "text/javascript" }).end("throw new Error('wrong')");
    forward();
  };
  await proxied(daemon, through, async (url) => {
    const isFirst = (script) => script.endsWith("/estop.js");
    for (const others of ["held", "gone", "wrong"]) {
      const { estop: { orders } } = await daemon.status();
      fate = (script) => (isFirst(script) ? "" : others);
      const page = await blank();
      const stops = stopsOf(page);
      page.goto(url).catch(() => {});
      await page.waitForSelector("#estop:not([disabled])", WAIT);
      await page.click("#estop");
      await shows(page, "estop-note", "All lines are off.");
      await shows(page, "state-text", "Stopped: estop");
      const got = (await daemon.status()).estop.orders - orders;
      assert.ok(got >= 1 && got <= stops.sent);
      await page.close();
    }
    for (const fault of ["held", "gone"]) {
      fate = (script) => (isFirst(script) ? fault : "");
      const page = await blank();
      page.goto(url).catch(() => {});
      await page.waitForSelector("#estop", WAIT);
      assert.deepEqual([await page.$eval("#estop", (button) => button.disabled), await text(page, "estop-note")], [true, "E-STOP does not work here yet: use the switch of the supply."]);
      await page.close();
    }
  });
});

test("a play of the page belongs to the session that the page shows, or is refused", async () => {
  const daemon = await new Daemon().start();
  // Keep news of another session from the page.
  let shown = null;
  const through = async (request, response, forward) => {
    if (request.url !== "/v1/status" || !shown) return forward();
    response.writeHead(200, { "content-type": "application/json" });
    response.end(JSON.stringify({ ...await daemon.status(), session: shown }));
  };
  await proxied(daemon, through, async (url) => {
    const page = await open({ url });
    await arm(page);
    const start = async (participant) => (await other(daemon, "/v1/sessions", { participant })).id;
    const end = (id) => other(daemon, `/v1/sessions/${id}/end`);
    const first = await start("P07");
    await shows(page, "owner", "Session of P07");
    await page.type("#search", "pin-60");
    const play = 'li[data-name="pin-60"]:not([hidden]) button';
    await page.waitForSelector(play);
    await page.type("#seconds", "1");
    await press(page, play);
    await shows(page, "receipt-summary", "pin-60: done");
    assert.equal((await (await fetch(`${daemon.url}/v1/plays/last`)).json()).order.session, first);
    shown = (await daemon.status()).session;
    await end(first);
    await start("P08");
    await press(page, play);
    await answers(page, play, "Another session runs than the page showed, or none: look who feels the pins");
    assert.equal((await daemon.status()).session.plays, 0);
    assert.equal((await (await fetch(`${daemon.url}/v1/plays/last`)).json()).id, 1);
  });
});

test("motors that a window has armed stay armed while it is open, also hidden, and not when it is closed", async () => {
  const daemon = await new Daemon().start();
  let signs = 0;
  let client;
  const through = async (request, response, forward) => {
    const key = request.headers["meissner-client"];
    if (request.url === "/v1/status" && key === client) signs += 1;
    if (request.url !== "/v1/arm") return forward();
    client = key;
    const body = JSON.parse(Buffer.concat(await request.toArray()));
    assert.equal(body.silence_s, 10);
    // A shorter silence, for a shorter test, but longer than the time between two signs of life.
    const headers = { "content-type": "application/json", "meissner-client": key };
    const answer = await fetch(`${daemon.url}/v1/arm`, { method: "POST", headers, body: JSON.stringify({ ...body, silence_s: 15 }) });
    response.writeHead(answer.status, { "content-type": "application/json" });
    response.end(await answer.text());
  };
  await proxied(daemon, through, async (url) => {
    const page = await open({ url });
    await arm(page);
    await view(page, "device");
    await shows(page, "daemon-facts", "15 s without a sign of it disarm");
    // A hidden window whose timers stand still.
    await page.evaluate(() => {
      Object.defineProperty(document, "hidden", { get: () => true });
      document.dispatchEvent(new Event("visibilitychange"));
      for (let id = setTimeout(() => {}); id > 0; id--) clearTimeout(id);
    });
    signs = 0;
    const until = Date.now() + WAIT.timeout;
    while (signs < 3 && Date.now() < until) await new Promise((done) => setTimeout(done, 100));
    assert.equal((await daemon.status()).state, "armed", `${signs} signs`);
    assert.ok(signs >= 3);
    await page.close();
    while ((await daemon.status()).state !== "disarmed") {
      assert.ok(Date.now() < until + WAIT.timeout, "the daemon disarms");
      await new Promise((done) => setTimeout(done, 100));
    }
  });
});
