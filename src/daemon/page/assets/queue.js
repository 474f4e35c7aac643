// The queue, and the late strokes of the running play.

import { known } from "./api.js";
import { element, facts } from "./control.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);
// Late strokes, by play.
const late = new Map();
let listed = null;

function show() {
  const status = known();
  const names = status?.queued.map((play) => `${play.pattern} (play ${play.id})`) ?? ["Not known."];
  const lines = names.length ? names : ["No play waits."];
  // Unchanged lines are kept, with what has the focus there.
  if (listed !== lines.join("\n")) $("queue").replaceChildren(...lines.map((line) => element("li", line, { className: names.length && status ? "" : "none" })));
  listed = lines.join("\n");
  facts($("play-facts"), status?.play ? [["Late strokes of this play", late.get(status.play.id) ?? "none"]] : []);
}

export function bindQueue() {
  part({
    view: "play",
    at: "queue-title",
    state: show,
    always: {
      late: ({ id }) => void late.set(id, (late.get(id) ?? 0) + 1),
      ended: ({ receipt }) => void late.delete(receipt.id),
    },
  });
}
