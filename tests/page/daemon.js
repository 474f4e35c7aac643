// A real daemon with the simulated array, and windows of its page. MEISSNER_PROGRAM: the program. CHROMIUM: the browser.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, mkdirSync, rmSync, writeFileSync } from "node:fs";
import { createServer, request as httpRequest } from "node:http";
import { connect, createServer as createNetwork } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, afterEach, before } from "node:test";
import puppeteer from "puppeteer-core";

const PROGRAM = process.env.MEISSNER_PROGRAM;
// It only ends a test that hangs: beside a build a rendering may take minutes.
export const WAIT = { timeout: 200000, polling: 50 };

const daemons = [];

export const launch = () => puppeteer.launch({ executablePath: process.env.CHROMIUM, args: ["--no-sandbox", "--disable-gpu"] });

// Ends all daemons that were started, and removes their files.
export async function endAll() {
  for (const daemon of daemons.splice(0)) {
    await daemon.end();
    rmSync(daemon.dir, { recursive: true, force: true });
  }
}

// A browser for the tests of a file. `open(daemon, width, height, view)` opens a window of the page, `blank()` an empty one. After each test
// its windows are closed and its daemons ended: a window that stays open draws on, and slows all tests after it.
export function browsing(view = "play") {
  let browser;
  before(async () => {
    browser = await launch();
  });
  afterEach(async () => {
    const own = browser.browserContexts().filter((context) => context !== browser.defaultBrowserContext());
    await Promise.all(own.map((context) => context.close()));
    await endAll();
  });
  after(() => browser?.close());
  return {
    open: (daemon, width, height, shown = view) => open(browser, daemon, width, height, shown),
    blank: async () => (await browser.createBrowserContext()).newPage(),
  };
}

export class Daemon {
  constructor(config = "") {
    this.dir = mkdtempSync(join(tmpdir(), "meissner-page-"));
    mkdirSync(join(this.dir, "patterns"));
    this.config = config;
    this.port = 0;
    daemons.push(this);
  }

  async start() {
    const socket = join(this.dir, "m.sock");
    // The longest lead: a machine that stands still for a second makes no stroke late.
    const lead = this.config.includes("lead_ms") ? "" : "lead_ms = 1000\n";
    const text = `${lead}lease_ms = 10000\nsocket = "${socket}"\npatterns_dir = "${this.dir}/patterns"\nlisten = "127.0.0.1:${this.port}"\n${this.config}`;
    writeFileSync(join(this.dir, "m.toml"), text);
    const env = { ...process.env, XDG_STATE_HOME: this.dir, MEISSNER_SOCKET: socket };
    this.child = spawn(PROGRAM, ["daemon", "--device", "mock", "--config", join(this.dir, "m.toml")], { env, stdio: ["ignore", "ignore", "pipe"] });
    this.log = "";
    this.env = env;
    await new Promise((done, fail) => {
      this.child.once("exit", () => fail(new Error(this.log)));
      this.child.stderr.on("data", (data) => {
        this.log += data;
        const found = /listening on (http:\/\/127\.0\.0\.1:(\d+))/.exec(this.log);
        if (found && this.log.includes("device connected")) {
          [, this.url, this.port] = found;
          done();
        }
      });
    });
    return this;
  }

  async end(signal = "SIGTERM") {
    if (this.child?.exitCode !== null || this.child.signalCode) return;
    const ended = new Promise((done) => this.child.once("exit", done));
    this.child.kill(signal);
    await ended;
  }

  async status() {
    return (await fetch(`${this.url}/v1/status`)).json();
  }

  async run(...args) {
    const child = spawn(PROGRAM, args, { env: this.env, stdio: ["ignore", "pipe", "inherit"] });
    let out = "";
    child.stdout.on("data", (data) => (out += data));
    assert.equal(await new Promise((done) => child.once("exit", done)), 0);
    return out.trim();
  }
}

// A window of the page, and the errors in its console.
export async function open(browser, daemon, width = 1400, height = 1000, view = "play") {
  const context = await browser.createBrowserContext();
  const page = await context.newPage();
  // What a selector waits for may follow a rendering, as the first pose of a live play does.
  page.setDefaultTimeout(WAIT.timeout);
  page.complaints = [];
  // The port for emergency stops refuses the question whether it is there, and a proxy has none.
  const isExpected = (message) =>
    `${message.text()} ${message.location().url}`.includes("/v1/estop") && /405|Content Security Policy|ERR_CONNECTION_REFUSED/.test(message.text());
  page.on("console", (message) => message.type() === "error" && !isExpected(message) && page.complaints.push(`${message.text()} ${message.location().url}`));
  page.on("pageerror", (error) => page.complaints.push(String(error)));
  // The daemon ends a live play of a page that is silent for a second: beside a build, pages are.
  await page.evaluateOnNewDocument(() => {
    const fetch = window.fetch;
    window.fetch = (url, options) =>
      fetch(url, typeof options?.body === "string" ? { ...options, body: options.body.replace('"timeout_ms":1000', '"timeout_ms":20000') } : options);
  });
  await page.setViewport({ width, height });
  await page.goto(`${daemon.url}/#${view}`);
  return page;
}

export const text = (page, id) => page.$eval(`#${id}`, (element) => element.textContent);
export const shows = (page, id, part, wait = WAIT) =>
  page.waitForFunction((id, part) => document.getElementById(id).textContent.includes(part), wait, id, part);

export async function arm(page) {
  await shows(page, "state-text", "Disarmed");
  await press(page, "#arm");
  if (await page.$eval("#arm-rest", (label) => !label.hidden)) {
    await press(page, "#arm-checked");
    await page.type("#arm-name", "a test");
  }
  await press(page, "#arm-yes");
  await shows(page, "state-text", "Armed");
}

// Shows a view, as a person does.
export async function view(page, name) {
  await page.click(`#views a[href="#${name}"]`);
  await page.waitForSelector(`[data-view="${name}"]:not([hidden])`);
}

// Waits until a control's answer, in the line beside it, includes a text.
export const answers = (page, control, part) => page.waitForFunction((control, part) => {
  const place = document.querySelector(control);
  const line = [...document.querySelectorAll(".say")].find((line) => line.previousElementSibling?.contains(place) || line.parentElement.matches("li, td") && line.parentElement.contains(place));
  return line && !line.hidden && line.textContent.includes(part);
}, WAIT, control, part);

// Counts the emergency stops that a page sends from now on. It sends one again whose answer is late, and the daemon gets it twice.
export function stopsOf(page) {
  const stops = { sent: 0 };
  page.on("request", (request) => (stops.sent += Number(new URL(request.url()).pathname === "/v1/estop")));
  return stops;
}

// Clicks where the header does not cover it. On a busy machine the state grows old at times; then controls are off or hidden, and take no click.
// It clicks again only as long as the control has got none, so nothing is ordered twice.
export async function press(page, selector) {
  let problem = "it is hidden or off";
  for (const until = Date.now() + WAIT.timeout; Date.now() < until; await new Promise((done) => setTimeout(done, 50))) {
    const isReady = await page.$eval(selector, (element, selector) => {
      globalThis.isPressed = false;
      const listen = (event) => {
        if (event.target.closest(selector)) globalThis.isPressed = true;
      };
      globalThis.pressing?.abort();
      globalThis.pressing = new AbortController();
      addEventListener("click", listen, { capture: true, signal: pressing.signal });
      element.scrollIntoView({ block: "center" });
      return element.checkVisibility() && !element.disabled;
    }, selector);
    if (!isReady) continue;
    await page.click(selector).catch((error) => (problem = error.message));
    if (await page.evaluate(() => isPressed)) return;
  }
  throw new Error(`${selector} takes no click: ${problem}`);
}

// A proxy before a daemon. `through(request, response, forward)` sees every request.
export async function proxied(daemon, through, run) {
  const proxy = createServer((request, response) => through(request, response, () => {
    const headers = { ...request.headers, host: new URL(daemon.url).host };
    if (headers.origin) headers.origin = daemon.url;
    const onward = httpRequest(daemon.url + request.url, { method: request.method, headers }, (answer) => {
      response.writeHead(answer.statusCode, answer.headers);
      answer.pipe(response);
    });
    onward.on("error", () => response.destroy());
    response.on("close", () => onward.destroy());
    request.pipe(onward);
  }));
  await new Promise((done) => proxy.listen(0, "127.0.0.1", done));
  try {
    await run(`http://127.0.0.1:${proxy.address().port}`);
  } finally {
    proxy.closeAllConnections();
    proxy.close();
  }
}

// A simulated network between browser and daemon. While it is held, requests reach the daemon, but no answer of the API comes back until
// it is released.
export async function networked(daemon, run) {
  const { port } = new URL(daemon.url);
  const back = new Set();
  const all = new Set();
  let held = false;
  const server = createNetwork((browser) => {
    const onward = connect(port, "127.0.0.1");
    for (const socket of [browser, onward]) {
      all.add(socket);
      socket.on("error", () => {});
      socket.on("close", () => (browser.destroy(), onward.destroy(), all.delete(socket), back.delete(socket)));
    }
    back.add(onward);
    browser.pipe(onward);
    onward.pipe(browser);
    if (held) onward.unpipe(browser);
    onward.letGo = () => onward.pipe(browser);
    onward.hold = () => onward.unpipe(browser);
  });
  const estops = createNetwork((browser) => {
    const onward = connect(Number(port) + 1, "127.0.0.1");
    for (const socket of [browser, onward]) socket.on("error", () => (browser.destroy(), onward.destroy()));
    browser.pipe(onward).pipe(browser);
  });
  const listens = (server, port) => new Promise((done) => server.once("error", () => done(false)).listen(port, "127.0.0.1", () => done(true)));
  while (!(await listens(server, 0)) || !(await listens(estops, server.address().port + 1))) await new Promise((done) => server.close(done));
  const network = {
    url: `http://127.0.0.1:${server.address().port}`,
    hold: () => ((held = true), back.forEach((socket) => socket.hold())),
    letGo: () => ((held = false), back.forEach((socket) => socket.letGo())),
  };
  try {
    await run(network);
  } finally {
    all.forEach((socket) => socket.destroy());
    server.close();
    estops.close();
  }
}
