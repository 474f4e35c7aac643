// Patterns for other arrays than the daemon's: they play only if a person wants that.

import { array } from "./array.js";

const $ = (id) => document.getElementById(id);

// Whether a pattern is for another array than the daemon's.
export const isForeign = (pattern) => pattern.array !== array().name;

// The key of a play that maps a foreign pattern. Throws unless a person has ticked the box.
export function mapping(pattern) {
  if (!isForeign(pattern)) return {};
  if (!$("nearest").checked) throw new Error(`\`${pattern.name}\` is for the array ${pattern.array}, and this one is ${array().name}. To play it all the same, tick “Play patterns for other arrays by position”.`);
  return { map: "nearest" };
}
