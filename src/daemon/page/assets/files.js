// Files of patterns that a person chooses or drops on the page: they are stored.

import { put } from "./api.js";
import { $, say } from "./control.js";
import { plain } from "./words.js";

// What a body of the API has, at most.
const MOST_BYTES = 80 * 2 ** 20;

// Stores a pattern under the name that it bears, and returns what to say.
async function storeOne(file) {
  const kind = /\.([^.]+)$/.exec(file.name)?.[1].toLowerCase();
  if (["csv", "npy", "wav"].includes(kind)) throw new Error(`${file.name} has samples only: write a pattern that names it (“wave.file”), and pack that with “meissner pattern pack”.`);
  if (kind !== "toml") throw new Error(`${file.name} is no pattern (.toml).`);
  if (file.size > MOST_BYTES) throw new Error(`${file.name} is larger than 80 MiB.`);
  const text = await file.text();
  const name = /^name\s*=\s*["']([^"']*)["']/m.exec(text)?.[1];
  if (name === undefined) throw new Error(`${file.name} has no line “name = …”: a pattern bears the name of its file.`);
  const { warnings } = await put(`/v1/patterns/${encodeURIComponent(name)}${$("import-replace").checked ? "?replace=true" : ""}`, text);
  return [`Stored ${name}.`, ...warnings].join(" ");
}

// Stores patterns, and says of each file what came of it.
async function store(files, stored) {
  const lines = [];
  let areAllStored = true;
  for (const file of files) {
    try {
      lines.push(await storeOne(file));
    } catch (error) {
      areAllStored = false;
      lines.push(files.length > 1 ? `Not stored: ${file.name}. ${plain(error)}` : plain(error));
    }
  }
  say($("import"), lines.join(" "), areAllStored ? "good" : "bad");
  stored();
}

// `stored`: called when a pattern was stored.
export function bindFiles(stored) {
  $("import").addEventListener("change", async () => {
    const files = [...$("import").files];
    if (files.length) await store(files, stored);
    // The same file may be chosen again.
    $("import").value = "";
  });
  // A file that is dropped beside its place would replace the page, and with it E-STOP.
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    const files = [...event.dataTransfer.files];
    if (files.length && $("import").checkVisibility()) store(files, stored);
  });
}
