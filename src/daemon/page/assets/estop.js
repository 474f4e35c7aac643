// The emergency stop. It needs `api.js` alone, so that it works when the rest of the page does not.

import { freeConnections, headers } from "./api.js";

const button = document.getElementById("estop");
const note = document.getElementById("estop-note");
const ANSWER_MS = 1500;

async function stop() {
  button.dataset.sent = "";
  note.textContent = "Ordered …";
  try {
    const request = fetch("/v1/estop", {
      method: "POST",
      headers: headers(),
      keepalive: true,
      priority: "high",
      signal: AbortSignal.timeout(ANSWER_MS),
    });
    // It is the first to take a connection that becomes free.
    freeConnections();
    const response = await request;
    const body = await response.json().catch(() => ({}));
    note.textContent = response.ok ? "All lines are off." : `NOT CONFIRMED: ${body.detail ?? response.statusText}`;
    note.dataset.failed = String(!response.ok);
  } catch {
    note.dataset.failed = "true";
    note.textContent = "NOT CONFIRMED: the daemon does not answer. Use the switch of the supply.";
  }
  setTimeout(() => delete button.dataset.sent, 300);
}

// On the press, not the release: a finger that slips off has pressed all the same.
button.addEventListener("pointerdown", stop);
button.addEventListener("keydown", (event) => {
  if (event.key === "Enter" || event.key === " ") stop();
});
