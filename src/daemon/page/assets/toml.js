// Tables as TOML text.

const isTable = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
const isTables = (value) => Array.isArray(value) && value.length > 0 && value.every(isTable);
const has = ([, value]) => value !== null && value !== undefined;
const name = (key) => (/^[A-Za-z0-9_-]+$/.test(key) ? key : quoted(key));
const quoted = (text) => JSON.stringify(text).replaceAll("\u007f", "\\u007f");

// A value on one line.
function inline(value) {
  if (Array.isArray(value)) return `[${value.map(inline).join(", ")}]`;
  if (isTable(value)) return `{ ${Object.entries(value).filter(has).map(([key, of]) => `${name(key)} = ${inline(of)}`).join(", ")} }`;
  if (typeof value === "string") return quoted(value);
  // A browser has read an integer of this size with an error.
  if (Number.isInteger(value) && !Number.isSafeInteger(value)) throw new Error(`A browser cannot hold the number ${value} exactly: use “meissner show” in place of this page.`);
  return String(value);
}

// A file of TOML: lists of tables as `[[key]]`, tables as `[key]`, what they hold on one line each. Keys without a value are left out.
export function toml(table) {
  const entries = Object.entries(table).filter(has);
  const lines = (of) => Object.entries(of).filter(has).map(([key, value]) => `${name(key)} = ${inline(value)}\n`).join("");
  const flat = entries.filter(([, value]) => !isTable(value) && !isTables(value));
  const lists = entries.filter(([, value]) => isTables(value)).flatMap(([key, all]) => all.map((of) => `\n[[${name(key)}]]\n${lines(of)}`));
  const tables = entries.filter(([, value]) => isTable(value)).map(([key, of]) => `\n[${name(key)}]\n${lines(of)}`);
  return [lines(Object.fromEntries(flat)), ...lists, ...tables].join("");
}
