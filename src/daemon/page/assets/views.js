// The four views and their parts. A view has an address (`#play`), and one is shown. A hidden view does no work.
//
// A module adds each thing that it shows as a `part` of a view. The page then calls what the part has: see `part`.

import { $, refuse, say } from "./control.js";

const VIEWS = ["play", "design", "record", "device"];

const parts = [];
let current = null;
// Whether parts can be loaded: the page has a connection, and knows the array.
let isReady = false;

// Adds a part, and returns a function that loads it again: at once (the promise resolves then), or when its view is shown next.
//
// `view`: its view. `at`: the id of its heading or control; a failed load says so below it. `load`: fetches what the part shows. It
// runs when the view is shown first, and again when events may have been missed: after a new connection, or after an event of `on`
// that came while the view was hidden. `again`: what it fetches may change without an event, so it is also loaded each time that its
// view comes into sight, or the window gets the focus. `state`: shows the status (`known()` of `api.js`), at each status while the
// view is shown. `on`: handlers of the daemon's events, by name, for the time in which the view is shown.
// `always`: handlers that also run while it is hidden. `hide`: called when a person leaves the view.
export function part(what) {
  const mine = { on: {}, always: {}, ...what, fresh: false };
  parts.push(mine);
  return () => {
    mine.fresh = false;
    return mine.view === current ? load(mine) : undefined;
  };
}

async function load(mine) {
  if (mine.fresh || !mine.load || !isReady) return;
  mine.fresh = true;
  try {
    await mine.load();
    say($(mine.at), "");
  } catch (error) {
    mine.fresh = false;
    refuse($(mine.at), error);
  }
}

const shown = () => parts.filter((part) => part.view === current);

// Loads what the shown view needs. What may have changed meanwhile is loaded again.
function loadShown() {
  for (const part of shown()) {
    if (part.again) part.fresh = false;
    load(part);
  }
}

// Loads what the shown view needs, and marks the rest as out of date. The promise resolves when the shown view is loaded.
export function connected() {
  isReady = true;
  for (const part of parts) part.fresh = false;
  return Promise.all(shown().map(load));
}

export function disconnected() {
  isReady = false;
}

// Shows the status in the shown view.
export function showStatus() {
  for (const part of shown()) part.state?.();
}

// Gives an event of the daemon to the parts.
export function handleEvent(event) {
  for (const part of parts) {
    const isShown = part.view === current;
    const run = part.always[event.event] ?? (isShown ? part.on[event.event] : null);
    // A handler may fetch something.
    if (run) Promise.resolve(run(event)).catch((error) => refuse($(part.at), error));
    else if (event.event in part.on) part.fresh = false;
  }
}

function show() {
  const wanted = location.hash.slice(1);
  // An address of a place within the page is no view.
  const next = VIEWS.includes(wanted) ? wanted : (current ?? VIEWS[0]);
  if (next === current) return;
  for (const part of shown()) part.hide?.();
  // A reload keeps its place.
  if (current) scrollTo(0, 0);
  current = next;
  for (const view of document.querySelectorAll("[data-view]")) view.hidden = view.dataset.view !== next;
  for (const link of document.querySelectorAll("#views a")) link.ariaCurrent = link.hash === `#${next}` ? "page" : null;
  const name = document.querySelector(`#views a[href="#${next}"]`).textContent;
  $("view-title").textContent = name;
  showStatus();
  loadShown();
}

// Shows the view of the address, now and when it changes. All parts have been added.
export function startViews() {
  addEventListener("hashchange", show);
  // A window that was hidden connects again, and loads everything. One beside it was only left.
  addEventListener("focus", loadShown);
  // The height of what stays at the top, for what stands below it.
  const [header, bar] = [$("header"), $("bar")];
  const measure = () => {
    const fixed = getComputedStyle(header).display === "contents" ? bar : header;
    document.documentElement.style.setProperty("--header", `${fixed.offsetHeight}px`);
  };
  const observer = new ResizeObserver(measure);
  for (const part of [header, bar]) observer.observe(part);
  // The address stays that of the view.
  document.querySelector(".skip").addEventListener("click", (event) => {
    event.preventDefault();
    $("main").focus();
  });
  show();
}
