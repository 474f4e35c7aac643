// The view Design in a real browser, against a real daemon with the simulated array: things that are drawn, rendered and felt.
//
// No test asserts on real time; the time limits only end a test that hangs.

import assert from "node:assert/strict";
import { test } from "node:test";
import { crc32, deflateSync } from "node:zlib";
import { answers, arm, browsing, Daemon, press, shows, text, view, WAIT } from "./daemon.js";

const { open } = browsing("design");
const get = async (daemon, path) => (await fetch(`${daemon.url}${path}`)).json();
const ask = async (daemon, method, path, body) => (await fetch(`${daemon.url}${path}`, { method, headers: { "content-type": "application/json" }, body: JSON.stringify(body) })).json();
const faults = (page) => page.complaints.filter((line) => !line.includes("409"));

// Places on the pad, mm, as places in the window.
async function places(page, mm) {
  await page.$eval("#pad .pad", (pad) => pad.scrollIntoView({ block: "center" }));
  return page.$eval("#pad .pad", (pad, mm) => {
    const matrix = pad.getScreenCTM();
    return mm.map(([x, y]) => new DOMPoint(x, -y).matrixTransform(matrix)).map(({ x, y }) => [x, y]);
  }, mm);
}

// Draws a line on the pad from one place to another, in mm, and lifts the pen.
async function draw(page, from, to) {
  const [begin, end] = await places(page, [from, to]);
  await page.mouse.move(...begin);
  await page.mouse.down();
  await page.mouse.move(...end, { steps: 5 });
  await page.mouse.up();
}

// Enters a value as a person does who then leaves the field.
const enter = (page, id, value) => page.$eval(`#${id}`, (field, value) => {
  field.value = value;
  field.dispatchEvent(new Event("input", { bubbles: true }));
  field.dispatchEvent(new Event("change", { bubbles: true }));
}, value);

// Waits until a rendering that fulfils a condition is judged and shown, and returns it.
async function rendered(page, daemon, condition = () => true) {
  for (;;) {
    const found = await get(daemon, "/v1/renderings/last").catch(() => ({}));
    assert.notEqual(found.state, "failed", found.problem);
    if (found.state === "done" && condition(found)) {
      await page.waitForSelector("#thing-result:not([hidden], .older)", WAIT);
      return found;
    }
    await new Promise((done) => setTimeout(done, 50));
  }
}

// Waits until a live play's line tells a place beyond another one, within 0.3 mm, and returns the line and the place. Without an answer for a
// second the line tells none.
const at = async (page, id, ...beyond) => (await page.waitForFunction((id, x, y) => {
  const found = /At ([\d.]+), ([\d.]+) mm, turned by 0°/.exec(document.getElementById(id).textContent);
  return found && found[1] > x - 0.3 && found[2] > y - 0.3 && [...found];
}, WAIT, id, ...beyond)).jsonValue();

test("a bar that is drawn is rendered, compared with the real thing, felt and saved", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await draw(page, [-4, 0.5], [4, 0.5]);
  const rendering = await rendered(page, daemon);
  const { rendered: result } = rendering;
  const { length_mm: length, width_mm: width, center_mm: middle, touch } = result.object;
  assert.ok(Math.abs(length - 8) < 0.3 && width === 0.8 && Math.hypot(middle[0], middle[1] - 0.5) < 0.3, JSON.stringify(result.object));
  assert.equal(touch.press.depth_um, 500);
  // Maps of the thing and of the display for each class, with all afferents; a raster of each.
  const maps = await page.$$eval("#thing-maps .pair", (pairs) => pairs.map((pair) => [pair.querySelector("h4").firstChild.textContent, [...pair.querySelectorAll("figure")].map((figure) => [figure.querySelector("strong").textContent, figure.querySelectorAll(".dot").length])]));
  assert.deepEqual(maps, [["SA1", 200], ["RA", 306], ["PC", 60]].map(([kind, count]) => [kind, [["Real thing", count], ["Display", count]]]));
  assert.deepEqual(await page.$$eval("#thing-rasters .raster", (all) => all.map((svg) => [...svg.querySelectorAll(".spikes")].every((path) => path.getAttribute("d").length > 20))), [true, true]);
  // The best of each column is bold.
  const bold = await page.$$eval("#thing-figures tbody tr", (rows) => rows.map((row) => [...row.querySelectorAll("td")].map((cell) => cell.firstElementChild?.textContent ?? null)));
  const best = Math.min(...result.judged.map((of) => of.error_by_class[1])).toFixed(2);
  assert.deepEqual([...new Set(bold.map((row) => row[6]).filter(Boolean))], [best]);
  assert.ok(bold[0].every((_, column) => bold.some((row) => row[column] !== null)), "a column without its best");
  assert.equal(await page.$$eval("#thing-figures tbody tr", (all) => all.length), result.judged.length);
  await shows(page, "speak", "Found a pattern for drawn.");
  await press(page, "#thing-feel");
  await view(page, "play");
  await shows(page, "receipt-summary", "drawn: done");
  assert.equal((await get(daemon, "/v1/plays/last")).sha256, result.sha256);
  await view(page, "design");
  await enter(page, "thing-name", "my-bar");
  await press(page, "#thing-save");
  await answers(page, "#thing-save", "Saved the pattern my-bar.");
  assert.equal((await get(daemon, "/v1/patterns/my-bar")).pattern.name, "my-bar");
  // It replaces none unseen.
  await press(page, "#thing-save");
  await answers(page, "#thing-save", "The name is taken");
  await press(page, "#thing-replace");
  await press(page, "#thing-save");
  await answers(page, "#thing-save", "Saved the pattern my-bar.");
  await view(page, "play");
  await page.waitForSelector('li[data-name="my-bar"]');
  assert.deepEqual(faults(page), []);
});

test("each thing and touch becomes its object, and numbers take a comma", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  const object = async (condition) => (await rendered(page, daemon, ({ rendered }) => condition(rendered.object))).rendered.object;
  await enter(page, "width", "1,25");
  await enter(page, "points", "-3,5 0; 3,5 0");
  const bar = await object(({ shape }) => shape === "bar");
  assert.deepEqual([bar.width_mm, bar.length_mm, bar.center_mm], [1.25, 7, [0, 0]]);
  await page.select("#shape", "edge");
  await press(page, "#turn");
  assert.equal(Math.abs((await object(({ shape, angle_deg }) => shape === "edge" && angle_deg)).angle_deg), 180);
  await page.select("#shape", "polyline");
  await enter(page, "points", "-3 3; 3 3 / 0 3; 0 -3");
  const lines = await object(({ shape }) => shape === "lines");
  assert.deepEqual(lines.lines, [[[-3, 3], [3, 3]], [[0, 3], [0, -3]]]);
  await page.select("#method", "trace");
  assert.equal((await rendered(page, daemon, ({ method }) => method === "trace")).rendered.method, "trace");
  await shows(page, "method-note", "A press follows the lines");
  await page.select("#contact", "scan");
  await enter(page, "speed", "20,5");
  await enter(page, "direction", "90");
  const scan = await rendered(page, daemon, ({ rendered: { object } }) => object.touch.scan?.direction_deg === 90);
  assert.deepEqual([scan.method, scan.rendered.object.touch.scan.speed_mm_s, scan.rendered.object.touch.scan.distance_mm], ["auto", 20.5, 20], "a trace does not scan");
  await page.select("#contact", "press");
  await page.select("#shape", "braille");
  await enter(page, "text", "Hi");
  await enter(page, "pitch", "2.34");
  const braille = await object(({ shape, text }) => shape === "braille" && text === "hi");
  assert.deepEqual([braille.dot_pitch_mm, braille.diameter_mm], [2.34, 2]);
  assert.equal(await page.$$eval("#pad .shape-dot", (dots) => dots.length), 5);
  assert.deepEqual(faults(page), []);
});

// A PNG of one grey level or colour per pixel.
function png(width, height, channels, pixel) {
  const chunk = (kind, data) => {
    const body = Buffer.concat([Buffer.from(kind), data]);
    const [length, sum] = [Buffer.alloc(4), Buffer.alloc(4)];
    length.writeUInt32BE(data.length);
    sum.writeUInt32BE(crc32(body) >>> 0);
    return Buffer.concat([length, body, sum]);
  };
  const head = Buffer.alloc(13);
  head.writeUInt32BE(width);
  head.writeUInt32BE(height, 4);
  head.set([8, channels === 1 ? 0 : 2], 8);
  const rows = Array.from({ length: height }, (_, y) => [0, ...Array.from({ length: width }, (_, x) => pixel(x, y)).flat()]);
  return Buffer.concat([Buffer.from([137, 80, 78, 71, 13, 10, 26, 10]), chunk("IHDR", head), chunk("IDAT", deflateSync(Buffer.from(rows.flat()))), chunk("IEND", Buffer.alloc(0))]);
}

// Drops a file on the pad.
const drop = (page, name, bytes) => page.evaluate((name, data) => {
  const files = new DataTransfer();
  files.items.add(new File([Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0))], name));
  document.querySelector("#pad svg").dispatchEvent(new DragEvent("drop", { dataTransfer: files, bubbles: true, cancelable: true }));
}, name, bytes.toString("base64"));

test("a picture that is dropped is a height map", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await enter(page, "mm", "0,5");
  await enter(page, "white", "400");
  const ridge = (x) => (x >= 8 && x < 12 ? 255 : 0);
  await drop(page, "my ridge.png", png(20, 20, 1, (x) => [ridge(x)]));
  const grey = await rendered(page, daemon);
  const { shape, file, mm_per_pixel: mm, um_per_level: um } = grey.rendered.object;
  assert.deepEqual([shape, file, mm], ["heightmap", "my-ridge.png", 0.5]);
  assert.ok(Math.abs(um - 400 / 255) < 1e-6);
  await shows(page, "picture-note", "my-ridge.png: 10 × 10 mm.");
  assert.equal(await page.$eval("#method [value=trace]", (option) => option.disabled), true);
  await shows(page, "thing-live-why", "A height map cannot move live");
  assert.equal(await page.$eval("#thing-live-start", (button) => button.disabled), true);
  // Of colours the brightness counts: the same ridge has the same response.
  await drop(page, "colours.png", png(20, 20, 3, (x) => [ridge(x), ridge(x), ridge(x)]));
  const coloured = await rendered(page, daemon, ({ rendered }) => rendered.object.file === "colours.npy");
  assert.deepEqual(coloured.rendered.response.real_s, grey.rendered.response.real_s);
  await shows(page, "picture-note", "Its brightness counts");
  // A photograph is scaled to what the daemon takes.
  const { size, note } = await page.evaluate(async () => {
    const canvas = Object.assign(document.createElement("canvas"), { width: 4000, height: 3000 });
    canvas.getContext("2d").fillRect(0, 0, 2000, 3000);
    const blob = await new Promise((done) => canvas.toBlob(done, "image/jpeg"));
    const { picture } = await import("/page/picture.js");
    return picture(new File([blob], "photo.jpg"));
  });
  assert.ok(size[0] * size[1] <= 1.5e6 && size[0] * size[1] > 1e6 && note.includes(`scaled from 4000 × 3000 to ${size.join(" × ")} pixels`), `${size}: ${note}`);
  // What is no picture says so, and the one before stays.
  await drop(page, "letter.txt", Buffer.from("no picture"));
  await answers(page, "#shape", "letter.txt is no image that this browser can read");
  await shows(page, "picture-note", "colours.npy");
  assert.deepEqual(faults(page), []);
});

test("a thing plays as soon as the pen lifts, if a person wants that and the motors are armed", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await press(page, "#thing-at-once");
  await draw(page, [0, -4], [0, 4]);
  await answers(page, "#thing-feel", "The motors are disarmed: press Arm first.");
  await rendered(page, daemon);
  await arm(page);
  await draw(page, [-2, -4], [-2, 4]);
  const { id, rendered: { sha256 } } = await rendered(page, daemon, ({ id }) => id > 1);
  await view(page, "play");
  await shows(page, "receipt-summary", "drawn: done");
  const play = await get(daemon, "/v1/plays/last");
  assert.deepEqual([id, play.id, play.sha256], [2, 1, sha256]);
});

test("a drawing can be undone, and survives a reload with its result", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await enter(page, "points", "-3 0; 3 0");
  await enter(page, "width", "1.5");
  await draw(page, [0, -4], [0, 4]);
  const points = () => page.$eval("#points", (field) => field.value);
  const drawn = await points();
  await page.$eval("#pad svg", (pad) => pad.focus());
  const undo = async (...keys) => {
    await page.keyboard.down("Control");
    for (const key of keys) await page.keyboard.press(key);
    await page.keyboard.up("Control");
  };
  await undo("z");
  assert.equal(await points(), "-3 0; 3 0");
  await undo("z");
  assert.equal(await page.$eval("#width", (field) => field.value), "0.8");
  await undo("y", "y");
  assert.deepEqual([await points(), await page.$eval("#width", (field) => field.value)], [drawn, "1.5"]);
  assert.equal(await page.$eval("#redo", (button) => button.disabled), true);
  await press(page, "#undo");
  const { id } = await rendered(page, daemon, ({ rendered: { object } }) => object.width_mm === 1.5 && object.length_mm === 6);
  await page.reload();
  await page.waitForSelector("#thing-result:not([hidden])");
  assert.deepEqual([await points(), await page.$eval("#width", (field) => field.value)], ["-3 0; 3 0", "1.5"]);
  // The result is that of before.
  assert.equal((await get(daemon, "/v1/renderings/last")).id, id);
  assert.equal((await page.evaluate(() => JSON.stringify(localStorage))).includes("token"), false);
});

test("what lies off the pad or off the pins is named", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await page.select("#shape", "dots");
  await enter(page, "points", "0 0; 20 0; 0 11");
  await shows(page, "where-note", "1 of 3 points lies off the finger's pad. 2 of 3 points are off the pins, more than 2.9 mm from any.");
  await enter(page, "points", "0 0; 1");
  await answers(page, "#points", "The last point has no y");
  // A line has the points that it needs to be within 0.05 mm of the pen's way, and more than the drawing can hold are refused.
  const [count, worst] = await page.evaluate(async () => {
    const { simplified } = await import("/page/pad.js");
    const way = Array.from({ length: 400 }, (_, i) => [5 * Math.cos(i / 64), 5 * Math.sin(i / 64)]);
    const line = simplified(way);
    const off = ([x, y], [ax, ay], [bx, by]) => {
      const t = Math.min(1, Math.max(0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)));
      return Math.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay));
    };
    return [line.length, Math.max(...way.map((place) => Math.min(...line.slice(1).map((end, i) => off(place, line[i], end)))))];
  });
  assert.ok(count > 20 && count < 60 && worst <= 0.05 + 1e-9, `${count} points, ${worst} mm`);
  await enter(page, "points", Array.from({ length: 201 }, (_, i) => `${i % 10} ${(i / 40).toFixed(2)}`).join("; "));
  await answers(page, "#points", "at most 200 points");
  await page.select("#shape", "edge");
  await enter(page, "points", "-4 11; 4 11");
  await shows(page, "where-note", "All pins lie under the edge's covered half");
});

test("a rendering takes the place of another one", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await shows(page, "state-text", "Disarmed");
  await enter(page, "points", "-3 0; 3 0");
  await rendered(page, daemon);
  // Three changes at once: the last one is rendered, and the others are cancelled or were never asked for.
  const rendering = await ask(daemon, "POST", "/v1/renderings", { object: "rotating-edge" });
  for (const width of ["1", "2", "3"]) await enter(page, "width", width);
  await rendered(page, daemon, ({ rendered: { object } }) => object.width_mm === 3);
  assert.equal((await get(daemon, `/v1/renderings/${rendering.id}`)).state, "cancelled");
  // A long one says its time, and can be cancelled.
  await enter(page, "hold", "20000");
  await shows(page, "thing-note", " s …");
  await press(page, "#thing-cancel");
  await shows(page, "thing-note", "Cancelled.");
  assert.equal((await get(daemon, "/v1/renderings/last")).state, "cancelled");
  assert.deepEqual(faults(page), []);
});

test("a thing is dragged live on its pad, and pressed and lifted (smoke)", async () => {
  const daemon = await new Daemon("lead_ms = 100\n").start();
  const page = await open(daemon);
  await arm(page);
  await page.select("#shape", "dots");
  assert.equal(await page.$eval("#thing-live-start", (button) => button.disabled), true);
  await enter(page, "points", "0 0");
  const live = async () => {
    await press(page, "#thing-live-start");
    await shows(page, "thing-live-note", "At 0.0, 0.0 mm, turned by 0°, pressed by 500 µm");
    await shows(page, "state-text", "Playing live");
  };
  await live();
  assert.equal(await page.$$eval("#pad .live-shape .shape-dot", (dots) => dots.length), 1);
  await draw(page, [0, 0], [2, 3]);
  const [note, right, up] = await at(page, "thing-live-note", 2, 3);
  assert.ok(Math.abs(right - 2) < 0.3 && Math.abs(up - 3) < 0.3, note);
  for (const key of ["ArrowLeft", "q", "q", " "]) await page.keyboard.press(key);
  await shows(page, "thing-live-note", "turned by 10°, lifted");
  await page.keyboard.press(" ");
  await enter(page, "depth", "250");
  await shows(page, "thing-live-note", "pressed by 250 µm");
  await page.waitForFunction(() => /; [1-9]\d* changes on the pins/.test(document.getElementById("thing-live-note").textContent), WAIT);
  await press(page, "#thing-live-end");
  await shows(page, "thing-live-note", "Ended.");
  const { live: updates } = await get(daemon, "/v1/plays/last");
  assert.ok(updates.applied > 1, JSON.stringify(updates));
  // The drawing is where it was.
  assert.equal(await page.$eval("#points", (field) => field.value), "0 0");
  await enter(page, "depth", "500");
  await live();
  await view(page, "play");
  await page.waitForFunction(() => document.getElementById("thing-live-note").textContent === "Ended.", WAIT);
  assert.deepEqual(faults(page), []);
});

test("the keyboard alone draws a thing and feels it", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  await page.focus("#shape");
  const pressed = async (...keys) => {
    for (const key of keys) await page.keyboard.press(key);
  };
  await pressed("Tab");
  assert.equal(await page.evaluate(() => document.activeElement.getAttribute("role")), "application");
  await pressed("ArrowLeft", "ArrowLeft", "Enter", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowUp", "Enter", "Backspace", "Enter");
  assert.equal(await page.$eval("#points", (input) => input.value), "-1 0; 1 0.5");
  await shows(page, "speak", "2 points, the last at 1, 0.5 mm.");
  await page.waitForSelector("#thing-feel:not([disabled])", WAIT);
  await page.focus("#thing-feel");
  await pressed("Enter");
  await view(page, "play");
  await shows(page, "receipt-summary", "drawn: done");
  await view(page, "design");
  // Lines: N begins another one.
  await page.select("#shape", "polyline");
  await page.$eval("#pad svg", (pad) => pad.focus());
  await pressed("ArrowUp", "n", "ArrowUp", "Enter");
  assert.equal(await page.$eval("#points", (input) => input.value.split(" / ").length), 2);
});

test("an emergency stop works while a play and a rendering run", async () => {
  const daemon = await new Daemon().start();
  const page = await open(daemon);
  await arm(page);
  // A touch of half a minute: it is rendered and judged for long.
  await enter(page, "hold", "20000");
  await enter(page, "points", "-3 0; 3 0");
  await shows(page, "thing-note", "Judging it", WAIT);
  await view(page, "play");
  await page.$eval("#seconds", (input) => (input.value = "600"));
  await page.type("#search", "edge-45");
  await press(page, 'li[data-name="edge-45"] button');
  await shows(page, "state-text", "Playing edge-45");
  await page.click("#estop");
  await shows(page, "estop-note", "All lines are off.");
  const status = await daemon.status();
  assert.deepEqual([status.state, status.play], ["faulted", null]);
});

test("a window that may not change anything asks for no rendering, says so once, and asks when it may", async () => {
  const daemon = await new Daemon('listen_token = "always"\n').start();
  const page = await open(daemon);
  const enterToken = async (role) => {
    await page.waitForSelector("#sign-in:not([hidden])");
    await page.type("#token", await daemon.run("token", "create", "--role", role, "--name", role));
    await press(page, "#sign-in-form button");
  };
  const asked = [];
  page.on("request", (request) => request.method() !== "GET" && asked.push(`${request.method()} ${new URL(request.url()).pathname}`));
  const isRefused = () => page.$$eval('[data-view="design"] .say:not([hidden])', (lines) => lines.map((line) => line.textContent));
  const draws = async () => {
    await page.select("#shape", "bar");
    await enter(page, "points", "-3 0; 3 0");
    for (const width of ["1", "1,5", "2"]) await enter(page, "width", width);
  };
  await enterToken("observe");
  await page.waitForSelector("#thing-may-not:not([hidden])");
  await shows(page, "speak", "This window may change nothing now");
  await draws();
  assert.deepEqual([asked, await isRefused(), await text(page, "thing-note")], [[], [], ""]);
  await page.evaluate(() => sessionStorage.removeItem("meissner-token"));
  await enterToken("operate");
  await page.waitForSelector("#thing-may-not[hidden]");
  // The drawing is as it was, and is rendered now.
  await page.waitForSelector("#thing-result:not([hidden], .older)");
  assert.deepEqual([asked.length > 0 && asked.every((one) => one === "POST /v1/renderings"), await page.$eval("#width", (field) => field.value)], [true, "2"]);
});
