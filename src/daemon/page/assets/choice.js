// A two-interval forced choice: the order of its trials, and what its answers say.

// Numbers from 0 to below 1 that a seed determines: mulberry32 (T. Ettinger, 2017). `seed`: 0 to 2^32 - 1.
function random(seed) {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 2 ** 32;
  };
}

// For each of `trials`, whether the pattern that is asked for comes first. It does in half of them; of an odd number the seed decides
// about the last one.
export function order(trials, seed) {
  const next = random(seed);
  const more = trials % 2 && next() < 0.5 ? 1 : 0;
  const firsts = Array.from({ length: trials }, (_, trial) => trial < Math.floor(trials / 2) + more);
  // Fisher and Yates.
  for (let i = trials - 1; i > 0; i--) {
    const j = Math.floor(next() * (i + 1));
    [firsts[i], firsts[j]] = [firsts[j], firsts[i]];
  }
  return firsts;
}

// The 95 % interval of a share of `right` in `all`, after Wilson (J. Am. Stat. Assoc. 22, 209-212, 1927). `all`: 1 or more.
export function wilson(right, all) {
  const z = 1.959964;
  const middle = (right + z ** 2 / 2) / (all + z ** 2);
  const half = (z / (all + z ** 2)) * Math.sqrt((right * (all - right)) / all + z ** 2 / 4);
  return [Math.max(0, middle - half), Math.min(1, middle + half)];
}
