// What this window may do. An access token that may only read plays, stores and removes nothing: controls that do so are off, and a line
// says why.

import { known } from "./api.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);

export const mayOperate = () => known()?.role !== "observe";

// Turns a control off while the window may only read.
export function operates(control) {
  control.dataset.operates = "";
  control.disabled = !mayOperate();
  return control;
}

export function bindRole() {
  let was = true;
  part({
    view: "play",
    at: "patterns-title",
    state: () => {
      // An old state says nothing new.
      if (!known() || mayOperate() === was) return;
      was = mayOperate();
      $("play-role").hidden = was;
      for (const control of document.querySelectorAll('[data-view="play"] [data-operates]')) control.disabled = !was;
    },
  });
}
