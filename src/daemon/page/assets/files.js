// Files that a person chooses or drops on the page: patterns, which are stored, and sequences, which are loaded.

import { put } from "./api.js";
import { refuse, say } from "./control.js";
import { loadSequence } from "./sequence.js";
import { plain } from "./words.js";

const $ = (id) => document.getElementById(id);
// What a body of the API has, at most.
const MOST_BYTES = 80 * 2 ** 20;

// The text of a file that is of one of these kinds.
async function read(file, ...kinds) {
  const kind = /\.([^.]+)$/.exec(file.name)?.[1].toLowerCase();
  if (["csv", "npy", "wav"].includes(kind)) throw new Error(`${file.name} has samples only: write a pattern that names it (“wave.file”), and pack that with “meissner pattern pack”.`);
  if (!kinds.includes(kind)) throw new Error(`${file.name} is neither a pattern (.toml) nor a sequence (.json).`);
  if (file.size > MOST_BYTES) throw new Error(`${file.name} is larger than 80 MiB.`);
  return file.text();
}

// Stores a pattern under the name that it bears, and returns what to say.
async function storeOne(file) {
  const text = await read(file, "toml");
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
      lines.push(files.length > 1 ? `Not stored: ${file.name}. ${plain(error.message)}` : plain(error.message));
    }
  }
  say($("import"), lines.join(" "), areAllStored ? "good" : "bad");
  stored();
}

async function load(file) {
  await loadSequence(file.name, await read(file, "json"));
  say($("sequence-file"), "");
}

// `stored`: called when a pattern was stored.
export function bindFiles(stored) {
  const imports = (files) => store(files, stored);
  const loads = (file) => load(file).catch((error) => refuse($("sequence-file"), error));
  // The same file may be chosen again.
  const chosen = (id, take) => $(id).addEventListener("change", async () => {
    const files = [...$(id).files];
    if (files.length) await take(files);
    $(id).value = "";
  });
  chosen("import", imports);
  chosen("sequence-file", ([file]) => loads(file));
  // A file that is dropped beside its place would replace the page, and with it E-STOP.
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    const files = [...event.dataTransfer.files];
    if (!files.length || !$("import").checkVisibility()) return;
    const sequences = files.filter((file) => /\.json$/i.test(file.name));
    const patterns = files.filter((file) => !sequences.includes(file));
    if (patterns.length) imports(patterns);
    if (sequences.length) loads(sequences[0]);
  });
}
