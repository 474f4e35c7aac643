// Sends signs of life while the window is hidden: a browser slows a hidden window's timers to one in a minute, but not those of a
// worker. When the window is closed, or the computer sleeps, it sends nothing, and the daemon disarms.
//
// It gets the headers of the window's requests when the window is hidden, and null when the window is visible.

const SIGN_MS = 2500;
let headers = null;
self.onmessage = ({ data }) => (headers = data);
setInterval(async () => {
  if (!headers) return;
  try {
    const response = await fetch("/v1/status", { headers, cache: "no-store" });
    const { state } = await response.json();
    // Motors that are off need no sign of life.
    if (state !== "armed" && state !== "returning") headers = null;
  } catch {
    // Ignore an error: the next sign of life may arrive.
  }
}, SIGN_MS);
