// The daemon's page in a real browser, against a real daemon with the simulated array. `run` installs what it needs.
//
// No test asserts on real time; the time limits only end a test that hangs.

import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { answers, arm, browsing, CALIBRATION, Daemon, press, proxied, shows, stopsOf, text, UM, view, WAIT } from "./daemon.js";

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
  await page.waitForFunction((moving) => [...document.querySelectorAll(".finger .pin")].every((pin, i) => (pin.getAttribute("fill") !== "none") === moving.includes(i)), WAIT, moving);
  const stops = stopsOf(page);
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  const first = await daemon.status();
  assert.ok(first.state === "faulted" && first.estops >= 1 && first.estops <= stops.sent, JSON.stringify(first));
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
  const { estops } = await daemon.status();
  assert.ok(estops > first.estops && estops <= stops.sent);
  await shows(page, "daemon-facts", `Emergency stops since the start${estops}`);
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

test("an emergency stop that the daemon does not confirm says so", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await daemon.end();
  await shows(page, "state-text", "Not connected");
  await page.click("#estop");
  await shows(page, "estop-note", "NOT CONFIRMED: the daemon does not answer. Use the switch of the supply.");
  // The page reconnects when the daemon is back, and the unconfirmed stop is carried out.
  await daemon.start();
  await shows(page, "estop-note", "All lines are off.");
  await shows(page, "state-text", "Stopped: estop");
  await page.waitForFunction(() => document.getElementById("alert").hidden, WAIT);
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
    writeFileSync(join(daemon.dir, "calibration.toml"), CALIBRATION);
    await daemon.start();
    const { positions_mm: places, pitch_mm: pitch, grid } = await get(daemon, "/v1/array");
    const page = await open(daemon, 360, 640, "device");
    await shows(page, "array-facts", `Name${name},`);
    // The pins are drawn at their places, in units of which the pitch has 29, on the skin.
    const pins = await page.$$eval(".finger > g", (groups) => groups.map((group) => {
      const [x, y] = group.getAttribute("transform").match(/-?[\d.]+/g).map(Number);
      return [x, y, document.querySelector(".finger .skin").isPointInFill(new DOMPoint(x, y))];
    }));
    assert.equal(pins.length, places.length);
    pins.forEach(([x, y, isOnSkin], i) => {
      const [right, down] = [places[i][0] - places[0][0], places[0][1] - places[i][1]].map((mm) => (29 * mm) / pitch);
      assert.ok(Math.hypot(x - pins[0][0] - right, y - pins[0][1] - down) < 1e-6 && isOnSkin, `pin ${i} at ${x}, ${y}`);
    });
    // The pad shows all pins, also those outside of the finger.
    const onPad = await page.$$eval("#pad .pin-place", (pins) => pins.map((pin) => {
      const { x, y, width, height } = pin.ownerSVGElement.viewBox.baseVal;
      const [cx, cy, r] = ["cx", "cy", "r"].map((name) => Number(pin.getAttribute(name)));
      return [cx, -cy, cx - r > x && cx + r < x + width && cy - r > y && cy + r < y + height];
    }));
    onPad.forEach(([x, y, isSeen], i) => assert.ok(Math.hypot(x - places[i][0], y - places[i][1]) < 1e-6 && isSeen, `pin ${i} of the pad at ${x}, ${y}`));
    assert.equal(onPad.length, places.length);
    assert.equal(await page.$$eval("#calibrate-motor option", (options) => options.length), places.length + 1);
    await shows(page, "calibration-note", `of ${places.length} motors`);
    assert.equal(await page.$$eval("#fit-grid .fit", (buttons) => buttons.length), places.length);
    const columns = await page.$eval("#fit-grid", (plots) => getComputedStyle(plots).gridTemplateColumns.split(" ").length);
    assert.equal(columns, grid?.columns ?? 3);
    assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 360);
    await view(page, "design");
    // The dots of a Braille letter stand above pins, if there are rows and columns enough.
    await page.select("#shape", "braille");
    const dots = await page.$$eval("#pad .shape-dot", (dots) => dots.map((dot) => [Number(dot.getAttribute("cx")), -dot.getAttribute("cy")]));
    const isAbove = ([x, y]) => places.some((place) => Math.hypot(x - place[0], y - place[1]) < 1e-6);
    assert.equal(dots.length, 3);
    if (grid?.rows >= 5 && grid.columns >= 3) assert.ok(dots.every(isAbove), JSON.stringify(dots));
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
      await answers(page, `${play} button`, `pin-60 is for the array tula35-6x4, and this one is ${name}.`);
    } else {
      await shows(page, "receipt-summary", "pin-60: done");
      const receipt = await get(daemon, "/v1/plays/last");
      assert.deepEqual([receipt.id, receipt.array], [1, name]);
    }
    assert.deepEqual(page.complaints, []);
  });
}

test("an array of two pins that nearly touch and of pins far away is drawn as small as another, with discs that are seen", async () => {
  const daemon = new Daemon('[array]\ndescription = "far.toml"\n');
  const places = [[0, 0], [0.2, 0], [40, -40], [-0.5, -30]];
  writeFileSync(join(daemon.dir, "far.toml"), SCATTERED.replace('"scattered"', '"far"').replace(/\[\[.*\]\], radius_mm = 0.4/, `${JSON.stringify(places)}, radius_mm = 0.08`));
  const drive = (motor) => `[[drive]]\nmotor = ${motor}\nfrequency_hz = 60.0\namplitude_um = 40.0\nphase = 0.0\n`;
  writeFileSync(join(daemon.dir, "patterns", "ends.toml"), `format = 1\nname = "ends"\narray = "far"\n${drive(0)}${drive(2)}`);
  await daemon.start();
  const page = await open(daemon);
  await page.type("#search", "ends");
  await page.waitForSelector('li[data-name="ends"] .thumbnail');
  // The drawing's size in its own units, and the discs' places and radii.
  const drawn = (selector) => page.$eval(selector, (svg) => {
    const { width, height } = svg.viewBox.baseVal;
    const discs = [...svg.querySelectorAll("circle:not(.sensor-fault)")].map((disc) => {
      const [, x, y] = disc.parentNode.getAttribute("transform")?.match(/(-?[\d.e-]+) (-?[\d.e-]+)/) ?? [];
      return [Number(x ?? disc.getAttribute("cx")), Number(y ?? disc.getAttribute("cy")), Number(disc.getAttribute("r"))];
    });
    return { size: [width, height], discs };
  });
  for (const [selector, most, least] of [[".finger", 12 * 29 + 48, 2], ['li[data-name="ends"] .thumbnail', 6 * 10 + 10, 1]]) {
    const { size, discs } = await drawn(selector);
    assert.equal(discs.length, places.length);
    size.forEach((side) => assert.ok(side < most + 1e-3, `${selector}: ${size}`));
    discs.forEach(([x, y, r], i) => {
      const [right, down] = [places[i][0] - places[0][0], places[0][1] - places[i][1]];
      const unit = (discs[2][0] - discs[0][0]) / 40;
      assert.ok(Math.hypot(x - discs[0][0] - unit * right, y - discs[0][1] - unit * down) < 1e-6 && r >= least, `${selector}: pin ${i} at ${x}, ${y} has ${r}`);
    });
  }
  const pad = await drawn("#pad svg");
  assert.ok(pad.discs.every(([x, y], i) => Math.hypot(x - places[i][0], y + places[i][1]) < 1e-6), "the pad is in mm");
  assert.deepEqual(page.complaints, []);
});

test("the doctor's findings come with verdicts and remedies", async () => {
  const daemon = await new Daemon().start();
  const page = await openView(daemon, "device");
  await shows(page, "doctor-note", "passed, at");
  const listed = () => page.$$eval("#findings li", (items) => items.map((item) => [item.dataset.level, item.querySelector(".verdict").textContent, item.textContent]));
  const { findings } = await get(daemon, "/v1/doctor");
  const shown = await listed();
  assert.equal(shown.length, findings.length);
  const words = { ok: "OK", warn: "Warning", fail: "Failure" };
  // The page's words for what it has buttons for.
  const said = (text) => page.evaluate(async (text) => (await import(document.querySelector("script[src$='app.js']").src.replace("app.js", "words.js"))).advice(text).replaceAll("`", ""), text);
  assert.match(shown.find(([, , text]) => text.startsWith("state"))[2], /check that all pins are at rest, then press Arm$/);
  // The clock's estimate changes meanwhile.
  for (const { what, level, found, advice } of findings.filter(({ what }) => what !== "clock")) {
    const item = shown.find(([, , text]) => text.startsWith(`${what} ${words[level]}`));
    assert.deepEqual(item.slice(0, 2), [level, words[level]]);
    assert.ok(item[2].includes(await said(found)), `${item[2]}: ${found}`);
    assert.ok(item[2].endsWith(await said(advice)) && item[2].includes("Remedy: ") === (level !== "ok"), item[2]);
  }
  const outside = await page.$$eval("#findings li", (items) => items.map((item) => [...item.querySelectorAll("p")].flatMap((line) => [...line.childNodes].filter((part) => part.nodeName !== "CODE").map((part) => part.textContent)).join(" ")));
  for (const text of outside) assert.ok(!/`|(^|\s)--\w/.test(text), text);
  assert.deepEqual(shown.map(([level]) => level), shown.map(([level]) => level).sort((a, b) => "fwo".indexOf(a[0]) - "fwo".indexOf(b[0])));
  // After a stop a new check reports it; the worst finding comes first.
  await page.click("#estop");
  await shows(page, "state-text", "Stopped: estop");
  const stopped = (await get(daemon, "/v1/doctor")).findings;
  const failures = stopped.filter(({ level }) => level === "fail").length;
  await shows(page, "doctor-note", `${failures} failure${failures === 1 ? "" : "s"}, `);
  const [level, verdict, state] = (await listed())[0];
  assert.deepEqual([level, verdict], ["fail", "Failure"]);
  assert.ok(state.startsWith("state ") && state.includes("press Reset"), state);
});

test("calibration plots show what the API says, and a person can calibrate", async () => {
  const daemon = await new Daemon("[mock]\ngain_sd = 0.01\nasymmetry_sd = 0.05\n").start();
  const page = await openView(daemon, "device");
  await shows(page, "calibration-note", "Nothing was calibrated yet");
  await shows(page, "calibrate-note", "Arm first");
  await arm(page);
  const plan = { pulses: [14, 70, 140], repetitions: 1 };
  await fetch(`${daemon.url}/v1/calibrate`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(plan) });
  await shows(page, "calibrate-note", "Calibrating for ");
  await shows(page, "calibrate-result", "Stored: 24 motors.", WAIT);
  await shows(page, "calibration-note", "The daemon uses these gains.");
  await shows(page, "calibration-facts", "just now");
  const { motors } = await get(daemon, "/v1/calibration");
  assert.equal(await page.$$eval("#fit-grid .fit", (cells) => cells.length), 24);
  // The places of a plot's points and of its lines' ends.
  const drawn = (plot) => page.$eval(plot, (svg) => Object.fromEntries(["up", "down"].map((direction) => [direction, {
    points: [...svg.querySelectorAll(`.${direction} .point`)].map((point) => point.getAttribute("transform").match(/-?[\d.]+/g).slice(0, 2).map(Number)),
    ends: svg.querySelector(`.${direction} .fit-line`).getAttribute("d").match(/-?[\d.]+ -?[\d.]+/g).map((at) => at.split(" ").map(Number)).filter((_, i, all) => i === 0 || i === all.length - 1),
  }])));
  // The lowest and the highest value give the scale of an axis; all others must agree with it.
  const agree = (shown, values, what) => [0, 1].forEach((axis) => {
    const pairs = values.map((value, i) => [value[axis], shown[i][axis]]).sort(([a], [b]) => a - b);
    const [[low, from], [high, to]] = [pairs[0], pairs.at(-1)];
    assert.ok(axis ? to < from : to > from, `${what}: the axis points the right way`);
    for (const [value, at] of pairs) {
      const expected = from + ((value - low) / (high - low)) * (to - from);
      assert.ok(Math.abs(at - expected) < 0.3, `${what}, axis ${axis}: ${value} at ${at}, not ${expected}`);
    }
  });
  for (const motor of [3, 17]) {
    await press(page, `#fit-grid .fit[value="${motor}"]`);
    await shows(page, "fit-title", `Motor ${motor}`);
    assert.equal(await page.evaluate(() => document.activeElement.value), String(motor), "the button keeps the focus");
    const fit = motors.find((of) => of.motor === motor);
    assert.ok((await text(page, "fit-facts")).includes(fit.gain_up.toFixed(3)));
    const plots = [["#fit-plots .plot:nth-child(1)", 0, () => 1], ["#fit-plots .plot:nth-child(2)", 14, (pulses) => pulses * UM], [`#fit-grid .fit[value="${motor}"] .plot`, 14, (pulses) => pulses * UM]];
    for (const [plot, first, unit] of plots) {
      const places = await drawn(plot);
      const of = (direction) => {
        const { points, offset_um: offset, slope_um_per_pulse: slope } = fit[direction];
        const ends = [first, 147].map((pulses) => [pulses, (offset + pulses * slope) / unit(pulses)]);
        return [...points.map(({ pulses, travel_um }) => [pulses, travel_um / unit(pulses)]), ...ends];
      };
      agree(["up", "down"].flatMap((direction) => [...places[direction].points, ...places[direction].ends]), [...of("up"), ...of("down")], `motor ${motor}, ${plot}`);
    }
  }
  const row = await page.$eval("#fit-table tbody tr:nth-child(4)", (row) => row.textContent);
  assert.ok(row.startsWith(`3${motors[3].gain_up.toFixed(3)} ± `), row);
  // A calibration from the page shows a warning, and can be stopped.
  await page.waitForSelector("#calibrate:not([disabled])");
  await page.select("#calibrate-motor", "7");
  await press(page, "#calibrate");
  await shows(page, "calibrate-what", "Motor 7 is measured.");
  await page.select("#calibrate-motor", "");
  await press(page, "#calibrate-yes");
  assert.equal(await page.$eval("#calibrate-dialog", (dialog) => dialog.open), true, "nothing touches the pins must be ticked");
  await press(page, "#calibrate-clear");
  await press(page, "#calibrate-yes");
  await shows(page, "state-text", "Playing calibration");
  await shows(page, "touch", "Calibration: do not touch the pins.");
  await page.waitForSelector("#stop:not([disabled])");
  await press(page, "#stop");
  await shows(page, "calibrate-result", "Calibration failed: the calibration was cut (stop)");
  assert.deepEqual((await get(daemon, "/v1/calibration")).motors, motors);
});

test("a calibration that is damaged, refused or cut says so beside its button", async () => {
  const daemon = new Daemon();
  writeFileSync(join(daemon.dir, "calibration.toml"), "format = 7\n");
  await daemon.start();
  const page = await openView(daemon, "device");
  await shows(page, "calibration-note", "No calibration is in use: ");
  await arm(page);
  const start = async (before) => {
    await page.waitForSelector("#calibrate:not([disabled])");
    await press(page, "#calibrate");
    await press(page, "#calibrate-clear");
    await before?.();
    await press(page, "#calibrate-yes");
  };
  await start(() => daemon.run("disarm"));
  await answers(page, "#calibrate", "The motors are disarmed: press Arm first.");
  await shows(page, "calibrate-note", "Arm first");
  await arm(page);
  const asks = () => page.evaluate(() => {
    const event = new Event("beforeunload", { cancelable: true });
    dispatchEvent(event);
    return event.defaultPrevented;
  });
  assert.equal(await asks(), false);
  await start();
  await shows(page, "touch", "Calibration: do not touch the pins.");
  assert.equal(await asks(), true, "nobody would be at E-STOP");
  // The stop ends the event stream, too: the page learns of the end from an event only if it comes after the stream began again.
  await page.click("#estop");
  await shows(page, "calibrate-result", "nothing was stored");
  assert.equal(await asks(), false);
  await shows(page, "calibrate-note", "Reset first.");
  // A check keeps the focus, and a screen reader reads it if a person requested it.
  assert.equal(await text(page, "doctor-say"), "");
  await page.focus("#doctor-again");
  await page.keyboard.press("Enter");
  await shows(page, "doctor-say", "passed, at");
  assert.equal(await page.evaluate(() => document.activeElement.id), "doctor-again");
});

// The simulated array is never late, so a proxy adds the events.
test("late strokes are counted while a play runs", async () => {
  const daemon = await new Daemon("lead_ms = 900\n").start();
  const streams = [];
  const through = (request, response, forward) => {
    if (request.url === "/v1/events") streams.push(response);
    forward();
  };
  await proxied(daemon, through, async (url) => {
    const page = await open({ url });
    await arm(page);
    await daemon.run("play", "pin-60", "--seconds", "600");
    await shows(page, "play-facts", "Late strokes that this window has heard ofnone");
    const { id } = (await daemon.status()).play;
    for (const play of [id, id + 1, id]) {
      const data = { event: "late", id: play, motor: 9, tick: 1, late_ms: 1.8, cause: "host" };
      streams.at(-1).write(`event: late\ndata: ${JSON.stringify(data)}\n\n`);
    }
    await shows(page, "play-facts", "Late strokes that this window has heard of2");
    await press(page, "#stop");
    await page.waitForFunction(() => !document.getElementById("play-facts").textContent, WAIT);
    assert.deepEqual(page.complaints, []);
  });
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
    assert.equal((await daemon.status()).estops, 1);
    holds = false;
    for (const page of pages) await shows(page, "state-text", "Stopped: estop");
  });
});

for (const [width, height] of [[640, 360], [360, 640]]) {
  test(`dialogs leave their buttons and the emergency stop within reach at ${width} x ${height} px`, async () => {
    const daemon = await new Daemon().start();
    const page = await open(daemon, width, height);
    await shows(page, "state-text", "Disarmed");
    for (const id of ["arm-dialog", "calibrate-dialog", "reset-dialog"]) {
      await page.$eval(`#${id}`, (dialog) => dialog.show());
      const hit = (selector) => page.$eval(selector, (element) => {
        element.scrollIntoView({ block: "nearest" });
        const { x, y, width, height } = element.getBoundingClientRect();
        return document.elementFromPoint(x + width / 2, y + height / 2) === element;
      });
      for (const button of [`#${id} button:first-child`, `#${id} button:last-child`, "#estop"]) assert.ok(await hit(button), button);
      await page.$eval(`#${id}`, (dialog) => dialog.close("cancel"));
    }
  });
}

test("two windows see the same, and each may stop", async () => {
  const daemon = await new Daemon().start();
  const [one, other] = [await open(daemon), await open(daemon, 390, 844)];
  await arm(one);
  await shows(other, "state-text", "Armed");
  await other.click("#estop");
  await shows(one, "state-text", "Stopped: estop");
});

test("a token is asked for, kept for the window, and sent in no address", async () => {
  const daemon = await new Daemon('listen_token = "always"\n').start();
  const page = await open(daemon);
  const addresses = [];
  page.on("request", (request) => addresses.push(request.url()));
  await page.waitForSelector("#sign-in:not([hidden])");
  const token = await daemon.run("token", "create", "--role", "observe", "--name", "page");
  await page.type("#token", token);
  await press(page, "#sign-in-form button");
  await shows(page, "state-text", "Disarmed");
  await page.reload();
  await shows(page, "state-text", "Disarmed");
  assert.equal(await page.$eval("#sign-in", (section) => section.hidden), true);
  // This token may only read, and stop.
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  assert.equal((await page.evaluate(() => document.body.textContent)).includes(token), false);
  assert.ok(addresses.length > 5 && addresses.every((address) => !address.includes(token)));
});
