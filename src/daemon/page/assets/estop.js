// The part that works even if the rest of the page fails: the emergency stop, the access token, and the state in words, with its
// age.
//
// This is the first script, and needs no other one. The others read `meissner`. The document gets the event `state` when the state,
// or its age, changes what the page may show, and `token` when a person has entered an access token that the daemon accepts.
//
// Invariant: the shown state comes from an answer of the daemon whose request was sent less than a second ago. An older state
// counts as unknown, so a delayed answer does not look fresh.

"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  // The words are derived ten times a second, so a state is shown for a second at most.
  const FRESH_MS = 900;
  const TURN_MS = 100;
  const POLL_MS = 250;
  const REFUSED_MS = 5000;
  // The time limit of a poll, and of an attempt at an emergency stop.
  const ANSWER_MS = 1500;
  // The time limit of the question whether the port for emergency stops answers.
  const CHECK_MS = 5000;
  // The time to the next attempt, if an emergency stop was not answered, or its answer does not say that the lines are off.
  const AGAIN_MS = 250;
  const ANSWERED_AGAIN_MS = 2000;
  // The daemon takes emergency stops at the port above the API's, too, where no other request keeps them waiting.
  const PORT = Number(location.port || (location.protocol === "https:" ? 443 : 80));
  const OWN = `//${location.hostname}:${PORT + 1}/v1/estop`;
  // Two presses of Escape within this time stop.
  const TWICE_MS = 1000;
  // The shortest time between two sentences for screen readers.
  const SAY_MS = 1000;

  // The access token, for as long as the window is open. A link never holds it.
  const TOKEN = "meissner-token";
  const token = { get: () => sessionStorage.getItem(TOKEN), set: (value) => sessionStorage.setItem(TOKEN, value) };
  // The token of the session that this window has started.
  const SESSION = "meissner-session";
  // This name tells the daemon that a request comes from this window.
  const CLIENT = "meissner-client";
  if (!sessionStorage.getItem(CLIENT)) sessionStorage.setItem(CLIENT, crypto.getRandomValues(new Uint32Array(4)).join("-"));
  const headers = (value = token.get()) => {
    const session = sessionStorage.getItem(SESSION);
    return { "meissner-client": sessionStorage.getItem(CLIENT), ...(value ? { authorization: `Bearer ${value}` } : {}), ...(session ? { [SESSION]: session } : {}) };
  };

  // A clock stands still while the computer sleeps, and the other may be set back: the longer time counts.
  const instant = () => [performance.now(), Date.now()];
  const since = ([steady, wall]) => Math.max(performance.now() - steady, Date.now() - wall);

  // The last answer, and when its request was sent.
  let last = null;
  let sent = [-Infinity, -Infinity];
  // The token that the daemon has refused, as `{ token, mayStop }`: without it, this window may stop nevertheless.
  let refused = null;

  const known = () => (last && since(sent) < FRESH_MS ? last : null);
  // A proxy or gateway may answer in the daemon's place.
  const isStatus = (body) => typeof body?.state === "string" && Array.isArray(body.motors) && Array.isArray(body.queued);
  const isTold = (status) => status.device !== null && status.clock !== null;

  function take(status, at) {
    if (at[0] < sent[0]) return;
    [last, sent] = [status, at];
    show(true);
  }

  // Every request of this script but the emergency stop.
  let pending = new AbortController();
  let asked = -Infinity;
  async function ask() {
    const [at, value] = [instant(), token.get()];
    asked = at[0];
    try {
      const signal = AbortSignal.any([pending.signal, AbortSignal.timeout(ANSWER_MS)]);
      const response = await fetch("/v1/status", { headers: headers(value), cache: "no-store", signal });
      const body = response.ok ? await response.json() : null;
      if (isStatus(body)) take(body, at);
      const isLetIn = refused && response.ok;
      const mayStop = value && response.status === 401 && (await fetch("/v1/status", { headers: headers(null), cache: "no-store", signal })).ok;
      refused = response.status === 401 ? { token: value, mayStop } : null;
      if (isLetIn) document.dispatchEvent(new Event("token"));
    } catch {
      // Ignore an error: the shown state grows old.
    }
    show();
  }

  // Asks for the state. When the promise resolves, the state is newer than the call.
  let running = null;
  let next = null;
  function poll() {
    if (running) return (next ??= running.then(() => ((next = null), poll())));
    return (running = ask().finally(() => (running = null)));
  }

  const NOT_KNOWN = "The state is not known: pins may vibrate. Do not touch them.";
  // The meaning of a state for a person with a finger on the pins.
  const WORDS = { disarmed: "Disarmed", armed: "Armed", returning: "Returning", faulted: "Stopped", "no-device": "No device" };
  // Beyond it the daemon, too, wants a person to look.
  const CHECK_UM = 20;
  function touch(status) {
    if (!status) return NOT_KNOWN;
    const off = Math.max(0, ...(status.motors ?? []).map((motor) => Math.abs(motor.rest_error_um)));
    const standing = status.standing ? `Pins stand up to ${Math.ceil(status.standing.height_um)} µm above rest${status.standing.age_s < 0.5 ? "" : `, for ${Math.round(status.standing.age_s)} s`}. ` : "";
    if (status.play) return status.play.name === "calibration" ? "Calibration: do not touch the pins." : "Pins vibrate.";
    switch (status.state) {
      case "disarmed":
        if (status.position !== "known") return `${standing}The motors are off, but the place of the pins is not known: look at them first.`;
        if (standing) return `${standing}The motors are off. Arm returns the pins.`;
        return off > CHECK_UM ? `The motors are off, but pins may be ${Math.ceil(off)} µm from rest: look at them first.` : "Safe to touch: the motors are off.";
      case "armed":
        return "The motors are on: a play may begin at any moment.";
      case "returning":
        return "Pins move to rest. Do not touch.";
      case "faulted":
        return isTold(status) ? `${standing}All lines are off. Find out why before you reset.` : "The stop is latched, but no device answers: whether the lines are off is not known.";
      case "no-device":
        return "No device is connected: the pins are not under control.";
      default:
        return NOT_KNOWN;
    }
  }

  // How a state looks: green is safe, amber is on or to be checked, blue moves, red is stopped, hatched is not known.
  function look(status, name, safe) {
    if (status?.play || name === "returning") return "moving";
    if (name === "armed") return "armed";
    if (name === "faulted") return isTold(status) ? "stopped" : "unknown";
    if (name !== "disarmed" || status.position !== "known") return "unknown";
    return safe ? "safe" : "armed";
  }

  function write(element, text) {
    if (element && element.textContent !== text) element.textContent = text;
  }

  // Reads the state to screen readers, without the time played, which changes all the time.
  let said = -Infinity;
  function say(status, text) {
    if (!$("state-say") || performance.now() - said < SAY_MS) return;
    const line = `${status?.play ? `Playing ${status.play.name}` : text}. ${$("touch").textContent}`;
    if ($("state-say").textContent === line) return;
    said = performance.now();
    $("state-say").textContent = line;
  }

  let wasKnown = false;
  function show(isNew = false) {
    const status = known();
    const name = status && status.state in WORDS ? status.state : "unknown";
    // The rest of the document may not have loaded yet.
    const meaning = touch(status);
    if ($("state")) $("state").dataset.state = status?.play ? "playing" : name;
    $("bar").dataset.look = look(status, name, meaning.startsWith("Safe"));
    const text = status?.play ? `Playing ${status.play.name}, ${status.play.played_s.toFixed(1)} s`
      : name === "unknown" ? "Not connected: state not known" : name === "faulted" ? `Stopped: ${status.cause}` : WORDS[name];
    write($("state-text"), status?.queued.length ? `${text}; ${status.queued.length} wait` : text);
    write($("touch"), meaning);
    // The tab tells it, too.
    const title = `${status?.play ? `Playing ${status.play.name}` : WORDS[name] ?? "State not known"} · ${$("view-title")?.textContent ?? ""} · meissner`;
    if (document.title !== title) document.title = title;
    say(status, text);
    const device = status?.device;
    write($("link"), device ? `${device.kind}${device.simulated ? ", simulated" : ""}` : last && !status ? `last known ${Math.floor(since(sent) / 1000)} s ago` : "");
    if ($("sign-in")) $("sign-in").hidden = !refused && !order?.refused;
    // Says before the press that it does nothing. It may be pressed all the same: the daemon may have another opinion by then.
    cannot = refused && !refused.mayStop && refused.token === token.get();
    button.toggleAttribute("data-cannot", Boolean(cannot));
    write(button.querySelector(".shortcut"), cannot ? "needs a token" : "or Escape twice");
    showOrder(status);
    const changed = isNew || wasKnown !== (status !== null);
    wasKnown = status !== null;
    if (changed) document.dispatchEvent(new Event("state"));
  }

  // Why E-STOP has the API's port alone.
  let lacks = "";
  fetch(OWN, { mode: "no-cors", credentials: "omit", cache: "no-store", signal: AbortSignal.timeout(CHECK_MS) }).catch(() => {
    lacks = `E-STOP has port ${PORT} alone: port ${PORT + 1} of ${location.hostname}, its own, does not answer. Behind a proxy or a tunnel that is expected; else open it in the firewall.`;
  });

  // The unconfirmed emergency stop: its message, and whether the daemon has refused its token.
  let order = null;
  const button = $("estop");
  const note = $("estop-note");
  let cannot = false;
  const CANNOT = "E-STOP does nothing: the daemon takes none from this window without a valid access token. Enter one, or use the switch of the supply.";

  function showOrder(status) {
    note.dataset.failed = String(Boolean(order?.failed || cannot));
    write(note, order ? order.text : cannot ? CANNOT : status?.state === "faulted" && isTold(status) ? "All lines are off." : lacks);
  }

  // A browser has six connections to a host for all its windows: the stop needs one of them. Ends the requests and event streams of all
  // windows of the page in this browser; they begin again by themselves.
  const windows = new BroadcastChannel("estop");
  const free = () => {
    pending.abort();
    pending = new AbortController();
  };
  windows.onmessage = free;

  // A message of the daemon without its backticks.
  const words = (detail) => detail?.replace(/`([^`]*)`/g, "“$1”");

  // Sends an emergency stop once, to both ports. Returns nothing if one says that the lines are off, else why the API's leaves a doubt.
  async function attempt(value) {
    // It has no header of its own, so the browser sends no question ahead of it.
    const own = send(OWN, { body: value ?? "", credentials: "omit" }, value);
    const api = send("/v1/estop", { headers: headers(value) }, value);
    // The second is the first to get a connection that becomes free.
    windows.postMessage("");
    free();
    const confirmed = [own, api].map(async (sending) => (await sending) && Promise.reject());
    return Promise.any(confirmed).catch(() => api);
  }

  async function send(url, init, value) {
    const at = instant();
    try {
      const response = await fetch(url, { method: "POST", keepalive: true, priority: "high", signal: AbortSignal.timeout(ANSWER_MS), ...init });
      const body = await response.json().catch(() => null);
      const answered = true;
      if (response.status === 401) return { answered, refused: true, why: value ? "the access token is not valid any more" : "the daemon asks for an access token" };
      if (response.status === 403) return { answered, refused: true, why: words(body?.detail) ?? "the access token does not allow it" };
      if (!response.ok) return { answered, why: words(body?.detail) ?? response.statusText };
      if (!isStatus(body) || body.state !== "faulted") return { answered, why: "the answer does not say that the lines are off" };
      take(body, at);
      return isTold(body) ? null : { answered, why: "the stop is latched, but no device answers" };
    } catch {
      return { why: "the daemon does not answer" };
    }
  }

  // Sends an emergency stop again and again until the daemon confirms it. After a refusal it waits for another token.
  let presses = 0;
  async function stop() {
    const press = ++presses;
    const pause = (ms) => new Promise((done) => setTimeout(done, ms));
    button.dataset.sent = "";
    setTimeout(() => delete button.dataset.sent, 300);
    order = { text: "Ordered …" };
    show();
    while (press === presses) {
      const value = token.get();
      let failure = await attempt(value);
      // Where no token is needed, try without the wrong one.
      if (failure?.refused && value) failure = (await attempt(null)) && failure;
      if (press !== presses) return;
      const advice = failure?.refused ? "Enter another access token; it is sent again then." : "It is sent again until the daemon confirms it.";
      const isNew = failure?.refused && !order.refused;
      order = failure && { failed: true, refused: failure.refused, text: `NOT CONFIRMED: ${failure.why}. Use the switch of the supply. ${advice}` };
      show();
      if (!failure) return;
      if (isNew) {
        // A dialog would keep the person from the field.
        for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close("cancel");
        $("sign-in")?.scrollIntoView({ block: "center" });
      }
      do await pause(failure.answered ? ANSWERED_AGAIN_MS : AGAIN_MS);
      while (press === presses && failure.refused && token.get() === value);
    }
  }

  // React to the press, not the release: a finger that slips off has still pressed the button.
  button.addEventListener("pointerdown", stop);
  button.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") stop();
  });
  // Escape twice stops, wherever the focus is: no other thing takes the key from here. It types nothing, so no text contains it. Another
  // key or a click between them means that a person does something else.
  let escaped = -Infinity;
  addEventListener("pointerdown", () => (escaped = -Infinity), { capture: true });
  addEventListener("keydown", (event) => {
    if (event.repeat || event.isComposing) return;
    const isTwice = event.key === "Escape" && event.timeStamp - escaped < TWICE_MS;
    escaped = event.key === "Escape" && !isTwice ? event.timeStamp : -Infinity;
    if (isTwice) stop();
  }, { capture: true });
  button.disabled = false;

  document.addEventListener("submit", (event) => {
    if (event.target.id !== "sign-in-form") return;
    event.preventDefault();
    token.set($("token").value.trim());
    $("token").value = "";
    poll();
  });

  // A hidden window holds no connection. A refused token is tried again now and then.
  function turn() {
    show();
    const pause = refused?.token === token.get() ? REFUSED_MS : POLL_MS;
    if (!running && !document.hidden && performance.now() - asked >= pause) poll();
  }
  document.addEventListener("visibilitychange", turn);
  document.addEventListener("DOMContentLoaded", show);
  setInterval(turn, TURN_MS);
  turn();

  globalThis.meissner = { token, headers, known, last: () => last, poll };
})();
