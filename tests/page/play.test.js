// The view Play: what the finger shows, pin test, chosen pattern, comparison, queue, files and receipt, against a real daemon with the
// simulated array.

import assert from "node:assert/strict";
import { mkdtempSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { answers, arm, browsing, Daemon, press, proxied, shows, WAIT } from "./daemon.js";
import { choose, get, quiet, set } from "./play.js";

let folder;
const { open } = browsing();

before(() => (folder = mkdtempSync(join(tmpdir(), "meissner-files-"))));
after(() => rmSync(folder, { recursive: true, force: true }));

const post = (daemon, path, body) => fetch(`${daemon.url}${path}`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) }).then((answer) => answer.json());
// A file on the disk.
const file = (name, text) => {
  const path = join(folder, name);
  writeFileSync(path, text);
  return path;
};
const take = async (page, id, ...paths) => (await page.$(`#${id}`)).uploadFile(...paths);
// Drops a file somewhere on the page.
const drop = (page, selector, name, text) => page.$eval(selector, (place, name, text) => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([text], name));
  return ["dragover", "drop"].map((kind) => {
    const event = new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true });
    place.dispatchEvent(event);
    return event.defaultPrevented;
  });
}, name, text);
// The text of the file that a control gives.
async function downloaded(page, control) {
  const own = mkdtempSync(join(folder, "download-"));
  const session = await page.createCDPSession();
  const ended = new Promise((done) => session.on("Browser.downloadProgress", ({ state }) => state === "completed" && done()));
  await session.send("Browser.setDownloadBehavior", { behavior: "allow", browserContextId: page.browserContext().id, downloadPath: own, eventsEnabled: true });
  await press(page, control);
  await ended;
  const [name] = readdirSync(own);
  return [name, readFileSync(join(own, name), "utf8")];
}

// What the finger says of its pins.
const says = (page, pattern) => page.waitForFunction((pattern) => new RegExp(pattern).test(document.querySelector(".finger").ariaLabel), WAIT, pattern);
// The heights that are drawn, µm, once they fulfil a condition.
const drawn = async (page, condition, ...more) => (await page.waitForFunction(new Function("...more", `const { drawn } = document.querySelector(".finger"); return drawn && (${condition})(drawn, ...more) && drawn;`), WAIT, ...more)).jsonValue();

test("the table of pins and the finger's words tell whether a pin moves or stands, and a frequency only where there is one", async () => {
  const daemon = await new Daemon().start();
  const real = await daemon.status();
  const of = (height_um, swing_um, hz) => ({ height_um, swing_um, hz });
  // Held, a press in its middle and at its end, a scan, a live play's turn, a slow stroke, vibration, still, not known.
  const all = [of(100, 0, 0), of(40, 80, 0), of(35, 70, 2.5), of(30, 60, 7.5), of(25, 50, 5), of(20, 40, 0.1), of(15, 30, 60), of(0.1, 0.2, 0), null];
  const status = { ...real, state: "armed", position: "known", motors: real.motors.map((motor, i) => ({ ...motor, now: all[i] ?? all[7] })) };
  status.motors[8].now = null;
  await proxied(daemon, (request, response, forward) => (request.url === "/v1/status" ? response.end(JSON.stringify(status)) : forward()), async (url) => {
    const page = await open({ url });
    await says(page, "^6 of 24 pins move, up to 80 µm above rest. 1 stand above rest, up to 100 µm. What 1 do is not known.$");
    await page.$eval("#pins", (table) => (table.closest("details").open = true));
    await page.waitForFunction(() => document.querySelectorAll("#pins tbody tr").length, WAIT);
    const cells = await page.$$eval("#pins tbody tr", (rows) => rows.map((row) => [...row.cells].slice(1, 3).map((cell) => cell.textContent)));
    assert.deepEqual(cells.slice(0, 9), [["stands", "100.0"], ["0 to 80 µm", "80.0"], ["0 to 70 µm", "70.0"], ["0 to 60 µm", "60.0"], ["0 to 50 µm", "50.0"], ["0 to 40 µm", "40.0"], ["0 to 30 µm at 60 Hz", "30.0"], ["still", "0.2"], ["not known", ""]]);
  });
});

test("the finger shows what the daemon says that pins do: sequences and live plays too (smoke)", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  // Nobody has looked at the pins yet.
  await drawn(page, "(all) => all.length === 24 && all.every((um) => um === null)");
  await shows(page, "finger-note", "What the pins do is not known.");
  await arm(page);
  const only = "(all, motors) => all.every((um, i) => um !== null && um > 1 === motors.includes(i))";
  await drawn(page, only, []);
  const plays = [
    ["/v1/play", { name: "edge-45", items: [{ pattern: "pin-60", seconds: 300 }] }, [9]],
    ["/v1/live", { drives: [{ motor: 4, frequency_hz: 60, amplitude_um: 80 }], timeout_ms: 60000, replace: true }, [4]],
    ["/v1/play", { pattern: { format: 1, name: "two", drive: [{ motor: 2, frequency_hz: 40, amplitude_um: 60, phase: 0.25 }, { motor: 20, frequency_hz: 80, amplitude_um: 20 }] }, seconds: 300, replace: true }, [2, 20]],
  ];
  for (const [path, body, motors] of plays) {
    const { id } = await post(daemon, path, body);
    assert.ok(id, path);
    await drawn(page, only, motors);
  }
  await page.$eval("#pins", (table) => (table.closest("details").open = true));
  await page.waitForFunction(() => document.querySelector("#pins tbody tr:nth-child(3)")?.textContent.includes(" at 40 Hz"), WAIT);
  // A press is drawn as it rises and falls, and a pin that is held stands.
  const press = (rise_s, hold_s) => ({ pattern: { format: 1, name: "held", ramp: [{ motor: 9, to_um: 100, rise_s, hold_s, fall_s: rise_s }] }, replace: true });
  await post(daemon, "/v1/play", press(3, 50));
  await drawn(page, "(all) => all[9] > 20 && all[9] < 80");
  await says(page, "^No pin moves. 1 stand above rest, up to 100 µm. Largest");
  await drawn(page, "(all) => Math.abs(all[9] - 100) < 1");
  // An emergency stop leaves it up: the page says so, until a reset has returned it.
  await page.click("#estop");
  await shows(page, "touch", "Pins stand up to 10");
  await drawn(page, "(all) => Math.abs(all[9] - 100) < 1");
  await post(daemon, "/v1/reset", { force: true });
  // After its hold the pin came down in one burst, which falls short: it may be more than 20 µm from rest.
  await shows(page, "touch", "otors are off");
  await says(page, "^No pin moves. Largest");
  await drawn(page, only, []);
  // What they did is shown again.
  await page.waitForSelector("#replay:not([hidden])");
  await page.$eval("#at", (slider) => ((slider.value = slider.max / 2), slider.dispatchEvent(new Event("input"))));
  await shows(page, "finger-note", "What the pins did, ");
  await drawn(page, "(all) => all.some((um) => um > 1)");
  await page.click("#now");
  await drawn(page, only, []);
  await page.click("#slowly");
  await page.waitForFunction(() => Number(document.getElementById("at").value) > 20, WAIT);
  await page.click("#slowly");
  await drawn(page, only, []);
  assert.deepEqual(quiet(page), []);
});

test("the pin test plays one stroke or some seconds of one pin, and needs armed motors", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await press(page, "#pin-play");
  await answers(page, "#pin-play", "press Arm first");
  await arm(page);
  await page.$$eval(".finger-pins > g", (groups) => groups[13].dispatchEvent(new MouseEvent("click", { bubbles: true })));
  assert.equal(await page.$eval("#pin-motor", (field) => field.value), "13");
  assert.deepEqual(await page.$$eval(".finger-pins > g", (groups) => groups.flatMap((group, i) => (group.classList.contains("chosen") ? [i] : []))), [13]);
  await press(page, "#pin-play");
  await shows(page, "receipt-summary", "Play 1, pin-test: done");
  const stroke = await get(daemon, "/v1/plays/1");
  assert.deepEqual([stroke.counts.bursts.played, stroke.reach.drives.map(({ motor, strokes }) => [motor, strokes])], [2, [[13, 1]]]);
  await page.select("#pin-what", "seconds");
  await set(page, "pin-motor", 5);
  await set(page, "pin-seconds", 0.5);
  await set(page, "pin-hz", 40);
  await set(page, "pin-um", 50);
  await press(page, "#pin-play");
  await shows(page, "receipt-summary", "Play 2, pin-test: done");
  const seconds = await get(daemon, "/v1/plays/2");
  assert.deepEqual([seconds.duration_ms.ordered, seconds.reach.drives.map(({ motor, strokes, ordered_um }) => [motor, strokes, ordered_um])], [500, [[5, 20, 50]]]);
  await set(page, "pin-motor", 24);
  await press(page, "#pin-play");
  assert.equal(await page.$eval("#pin-motor", (field) => field.parentElement.querySelector(".wrong").textContent), "Enter a whole number, 0 to 23.");
  assert.equal((await get(daemon, "/v1/plays/last")).id, 2);
});

test("any pattern has figures", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await choose(page, "press-hold");
  await page.waitForSelector(".preview .trace-line", WAIT);
  const { heights_um: heights, spikes } = await get(daemon, "/v1/patterns/press-hold/preview?from_s=0&seconds=1");
  const moving = heights.flatMap((values, motor) => (values.some((um) => um > 0) ? [motor] : []));
  const drawn = () => page.$$eval(".preview", (figures) => figures.map((figure) => [figure.querySelector("strong").textContent, [...figure.querySelectorAll(".trace")].flatMap((pin) => (pin.querySelector("path") ? [Number(pin.dataset.motor)] : []))]));
  assert.deepEqual(await drawn(), [["press-hold", moving]]);
  assert.deepEqual(moving, [9, 10, 13, 14]);
  const counts = ["SA1", "RA", "PC"].map((name) => `${name} ${spikes.class.reduce((sum, of, i) => sum + (of === name ? spikes.times_s[i].length : 0), 0)}`).join(", ");
  assert.equal(await page.$eval(".raster", (svg) => svg.getAttribute("aria-label")), `press-hold: predicted spikes: ${counts}`);
  // A pin is chosen on the drawing, by its number or on the finger.
  const large = (page) => page.$eval(".preview .plot:not(.raster)", (svg) => svg.getAttribute("aria-label"));
  assert.match(await large(page), /pin 9, up to \d+ µm/);
  await page.$eval('.trace[data-motor="0"]', (pin) => pin.dispatchEvent(new MouseEvent("click")));
  await page.waitForFunction(() => /pin 0, at rest/.test(document.querySelector(".preview .plot").getAttribute("aria-label")), WAIT);
  await set(page, "preview-motor", 14);
  await page.waitForFunction(() => /pin 14, up to/.test(document.querySelector(".preview .plot").getAttribute("aria-label")), WAIT);
  await page.select("#preview-seconds", "0.1");
  await page.waitForFunction(() => [...document.querySelectorAll(".preview .plot")].every((plot) => [...plot.querySelectorAll("text")].some((mark) => mark.textContent === "100") && ![...plot.querySelectorAll("text")].some((mark) => mark.textContent === "1000")), WAIT);
  assert.deepEqual(quiet(page), []);
});

test("the queue shows what runs and waits, and a play can be removed", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "queue-none", "No play runs or waits.");
  await arm(page);
  for (const [name, seconds] of [["edge-45", 300], ["pin-60", 20], ["disc", 30]]) assert.ok((await post(daemon, "/v1/play", { pattern: name, seconds })).id, name);
  await shows(page, "queue", "30 s; begins in about ");
  const [first, second, third] = await page.$$eval("#queue [data-play]", (items) => items.map((item) => item.textContent));
  assert.match(first, /^edge-45 \(play 1\)300 s; began [\d.]+ s ago$/);
  assert.match(second, /^pin-60 \(play 2\)20 s; begins in about \d+ sRemove$/);
  const begin = (text) => Number(/about (\d+) s/.exec(text)[1]);
  assert.ok(begin(third) - begin(second) === 20 && begin(second) <= 300 && begin(second) > 100, `${second} ${third}`);
  await press(page, '#queue [data-play="2"] button');
  await page.waitForFunction(() => !document.querySelector('#queue [data-play="2"]'), WAIT);
  assert.deepEqual((await daemon.status()).queued.map((play) => play.id), [3]);
  await press(page, "#stop");
  await shows(page, "queue-none", "No play runs or waits.");
  // Those that never began do not take its place.
  await shows(page, "receipt-summary", "Play 1, edge-45: stopped");
  await page.reload();
  await shows(page, "receipt-summary", "Play 1, edge-45: stopped");
  // Of a sequence the queue tells how many items it has; when an edge comes, nobody knows.
  await post(daemon, "/v1/play", { name: "two", items: [{ pattern: "pin-60", seconds: 300 }, { pattern: "disc", seconds: 30 }], on_edge_ms: 300000 });
  await post(daemon, "/v1/play", { pattern: "pin-60", seconds: 1 });
  await shows(page, "queue", "330 s, 2 items; waits for an edge of the trigger input");
  await shows(page, "queue", "1.0 s; begins when those before it are over");
  assert.deepEqual(quiet(page), []);
});

test("patterns of the site come first, are found by that word, and are removed after a question", async () => {
  const daemon = await new Daemon().start();
  const text = '\nduration_s = 1.0\n\n[[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = 50.0\n';
  const put = (name) => fetch(`${daemon.url}/v1/patterns/${name}`, { method: "PUT", headers: { "content-type": "application/toml" }, body: `format = 1\nname = "${name}"${text}` });
  for (const name of ["zebra", "zinc"]) assert.equal((await put(name)).status, 201);
  const page = await open(daemon);
  const shown = () => page.$$eval("#pattern-list li", (items) => items.filter((item) => !item.hidden).map((item) => item.dataset.name));
  await page.waitForSelector('li[data-name="zebra"]');
  assert.deepEqual((await shown()).slice(0, 2), ["zebra", "zinc"]);
  await page.type("#search", "Site");
  assert.deepEqual(await shown(), ["zebra", "zinc"]);
  await page.$eval("#search", (field) => ((field.value = ""), field.dispatchEvent(new Event("input"))));
  await choose(page, "edge-45");
  assert.equal(await page.$eval("#chosen-remove", (button) => button.hidden), true, "the library stays");
  await choose(page, "zebra");
  await press(page, "#chosen-remove");
  await shows(page, "remove-text", "zebra");
  await press(page, '#remove-dialog button[value="cancel"]');
  assert.equal((await fetch(`${daemon.url}/v1/patterns/zebra`)).status, 200);
  await press(page, "#chosen-remove");
  await press(page, '#remove-dialog button[value="remove"]');
  await page.waitForFunction(() => !document.querySelector('li[data-name="zebra"]') && document.querySelector('li[data-name="zinc"]'), WAIT);
  await shows(page, "chosen-none", "Choose a pattern");
  assert.equal((await fetch(`${daemon.url}/v1/patterns/zebra`)).status, 404);
});

test("events of device and session stay in a list, each in a sentence, and pins have their numbers", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await page.waitForSelector(".finger-pins .number");
  assert.deepEqual(await page.$$eval(".finger-pins .number", (all) => all.map((number) => number.textContent)), [...Array(24).keys()].map(String));
  await shows(page, "scale-most", "400 µm");
  // The window gives its parts every event of the API's own examples, and 60 late strokes of a play.
  const { components } = await get(daemon, "/v1/openapi.json");
  const examples = components.schemas.Event.oneOf.flatMap((of) => [of, ...(of.allOf ?? [])].flatMap(({ examples }) => examples ?? []));
  assert.ok(examples.length > 15);
  await page.evaluate(async (events) => {
    const { handleEvent } = await import(document.querySelector("script[src$='app.js']").src.replace("app.js", "views.js"));
    events.forEach(handleEvent);
  }, [...examples, ...Array(60).fill(examples.find(({ event }) => event === "late"))]);
  const told = () => page.$$eval("#events-list li", (items) => items.map((item) => item.textContent.replace(/^\d\d:\d\d:\d\d /, "")));
  const lines = await told();
  assert.ok(lines.length >= 10 && lines.length <= 20, lines.join("\n"));
  for (const line of lines) assert.ok(!/undefined|NaN|null|\[object/.test(line) && /^\p{Lu}.*\.$/u.test(line), line);
  assert.match(lines[0], /^Play 7: 61 strokes came too late .* pin 3, by 1\.8 ms\.$/);
  for (const part of ["Pins may be 22 µm from rest: press Home.", "Sensor fault of pin 3: it jumps where nothing moved.", "“disarm”", "refused a stroke", "Edge 12 of the trigger input starts play 7.", "others may act now"]) assert.ok(lines.some((line) => line.includes(part)), `${part}\n${lines.join("\n")}`);
  await page.reload();
  await page.waitForSelector("#events:not([hidden])");
  assert.deepEqual(await told(), lines);
  // Another daemon has told none of them.
  await daemon.end();
  await daemon.start();
  await page.waitForFunction(() => !document.getElementById("events-list").textContent.includes("came too late"), WAIT);
});

test("patterns come from files and become files", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await page.waitForSelector("#pattern-list li");
  const own = (name, um) => `format = 1\nname = "${name}"\nduration_s = 1.0\n\n[[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = ${um}.0\n`;
  await take(page, "import", file("own.toml", own("own", 50)), file("own-2.toml", own("own-2", 60)));
  await answers(page, "#import", "Stored own. Stored own-2.");
  await page.waitForSelector('li[data-name="own-2"]');
  assert.deepEqual(await drop(page, ".finger", "own.toml", own("own", 70)), [true, true]);
  await answers(page, "#import", "The name is taken");
  await press(page, "#import-replace");
  await drop(page, "#pattern-list", "own.toml", own("own", 70));
  await answers(page, "#import", "Stored own.");
  assert.equal((await get(daemon, "/v1/patterns/own")).pattern.drive[0].amplitude_um, 70);
  // Of several files each says what came of it.
  await take(page, "import", file("a.toml", own("file-a", 50)), file("b.toml", own("file-b", 900)), file("c.toml", own("file-c", 50)));
  await answers(page, "#import", "Stored file-c.");
  const said = await page.$eval(".say:not([hidden])", (line) => line.textContent);
  assert.match(said, /^Stored file-a\. Not stored: b\.toml\. .*900.*\. Stored file-c\.$/);
  await page.waitForSelector('li[data-name="file-c"]');
  for (const [name, text, says] of [["x.toml", "format = 1\n", "has no line “name = …”"], ["x.wav", "", "pack that with"], ["x.png", "", "is no pattern (.toml)"], ["own.toml", own("own", 900), "900"]]) {
    await drop(page, "#pattern-list", name, text);
    await answers(page, "#import", says);
  }
  await choose(page, "press-hold");
  const [name, text] = await downloaded(page, "#chosen-keep");
  assert.equal(name, "press-hold.toml");
  const { pattern } = await get(daemon, "/v1/patterns/press-hold");
  const put = (name, text) => fetch(`${daemon.url}/v1/patterns/${name}`, { method: "PUT", headers: { "content-type": "application/toml" }, body: text });
  assert.equal((await put("again", text.replace('name = "press-hold"', 'name = "again"'))).status, 201);
  assert.deepEqual((await get(daemon, "/v1/patterns/again")).pattern, { ...pattern, name: "again" });
  // So does text with all signs.
  const copy = { ...pattern, name: "signs", provenance: { "a key": { "": 'a "quote", \\, \n, \u007f, µ' } } };
  const signs = await page.evaluate(async (copy) => (await import("/page/toml.js")).toml(copy), copy);
  assert.equal((await put("signs", signs)).status, 201);
  assert.deepEqual((await get(daemon, "/v1/patterns/signs")).pattern, copy);
  await assert.rejects(page.evaluate(async () => (await import("/page/toml.js")).toml({ seed: 2 ** 60 })), /cannot hold the number/);
});

test("from the open page to what is felt it is one click and one dialog, which arms", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  const play = (name) => `li[data-name="${name}"] button`;
  await page.waitForSelector(play("press-hold"));
  // What cannot be played asks for nothing.
  await press(page, play("pin-60"));
  await answers(page, play("pin-60"), "has no end");
  assert.equal(await page.$eval("#arm-dialog", (dialog) => dialog.open), false);
  await press(page, play("press-hold"));
  await shows(page, "arm-yes", "Arm and feel");
  await press(page, '#arm-dialog button[value="cancel"]');
  // Arm alone plays nothing.
  await press(page, "#arm");
  await shows(page, "arm-yes", "Arm");
  await press(page, '#arm-dialog button[value="cancel"]');
  assert.deepEqual([(await daemon.status()).state, (await daemon.status()).newest.play], ["disarmed", null]);
  await press(page, play("press-hold"));
  await press(page, "#arm-checked");
  await page.type("#arm-name", "a test");
  await press(page, "#arm-yes");
  await shows(page, "receipt-summary", "Play 1, press-hold: done");
});

test("the list plays one run without seconds, and the receipt becomes a file", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  const play = async (name) => {
    await page.waitForSelector(`li[data-name="${name}"] button`);
    await press(page, `li[data-name="${name}"] button`);
  };
  const { pattern: { duration_s: one } } = await get(daemon, "/v1/patterns/edge-45-rendered");
  await play("edge-45-rendered");
  await shows(page, "receipt-summary", "Play 1, edge-45-rendered: done");
  const [name, text] = await downloaded(page, "#receipt-keep");
  const { id, duration_ms: ms } = JSON.parse(text);
  assert.deepEqual([name, id, ms.ordered], ["play-1.json", 1, 1000 * one]);
  await play("pin-60");
  await answers(page, 'li[data-name="pin-60"] button', "“pin-60” has no end: enter its seconds.");
});
