// Says that its window is there while the window is hidden: a browser slows a hidden window's timers to one in a minute, but not those of
// a worker. When the window is closed, or the computer sleeps, it says nothing, and the daemon disarms.
//
// It gets the headers of the window's requests when the window is hidden, and null when it is in sight.

const SIGN_MS = 2500;
let headers = null;
self.onmessage = ({ data }) => (headers = data);
setInterval(async () => {
  if (!headers) return;
  try {
    const response = await fetch("/v1/status", { headers, cache: "no-store" });
    const { state } = await response.json();
    // Motors that are off need no sign.
    if (state !== "armed" && state !== "returning") headers = null;
  } catch {
    // The next sign may arrive.
  }
}, SIGN_MS);
