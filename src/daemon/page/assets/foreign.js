// Patterns for other arrays than the daemon's: they do not play.

import { array } from "./array.js";

// Whether a pattern is for another array than the daemon's.
export const isForeign = (pattern) => pattern.array !== array().name;

// Throws for a pattern of another array: the daemon would refuse it.
export function checkArray(pattern) {
  if (isForeign(pattern)) throw new Error(`\`${pattern.name}\` is for the array ${pattern.array}, and this one is ${array().name}. Render or design one for this array.`);
}
