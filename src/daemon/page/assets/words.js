// The daemon's messages are those of its command line and of its API. `plain` turns one into the page's words: buttons in place of
// commands, labels in place of keys, no backticks and no options.

// Keys of the API, and the labels that the page has for them.
const LABELS = {
  amplitude_um: "Amplitude", character: "Letter", motor: "Motor", name: "Name", points: "Points", scale: "Amplitude scale",
  seconds: "Seconds", participant: "Participant", experiment: "Experiment",
};

// Why a sensor is not trusted, by the API's names.
export const SENSOR_FAULTS = {
  jumps: "it jumps where nothing moved", gain: "it shows far less or more travel than bursts make", scatter: "equal bursts differ too much",
  limit: "corrections at their limit have not helped",
};

// Commands for which the page has a button.
const BUTTONS = [
  [/(run )?`meissner arm --assume-rest --checked NAME`(, or\s+"checked": "NAME")?/g, "press Arm and enter your name"],
  [/(run )?`meissner arm( --assume-rest)?`/g, "press Arm"],
  [/(run )?`meissner (disarm|home|reset|calibrate)`/g, (_, __, name) => `press ${name[0].toUpperCase()}${name.slice(1)}`],
  [/(run )?`meissner stop`/g, "press Stop play"],
];
const OPTION = [/(^|[^\w-])--([a-z][a-z-]*)/g, "$1the option “$2”"];

// From the special to the general: the last ones take what is left.
const WORDS = [
  [/: add `seconds` \(--seconds S\), or allow a play without end.*/, ": enter its seconds"],
  [/: `--replace`, or `\?replace=true`, stores/, ": “Replace older ones” stores"],
  [/, or use `?--replace`?/, ""],
  [/, or play (it|the sequence) without `strict`/, ""],
  [/`session` is not the running one, (\S+): name that, or leave the key out/, "the session that the page showed does not run any more, but $1 does: look who feels the pins, then order again"],
  [/no session runs: start one with `meissner session start`, or leave out `session`/, "the session that the page showed does not run any more: look who feels the pins, then order again"],
  [/: start it without --no-record, and see `logbook_days`/, ": it was started without one"],
  [/send a valid token .*/, "enter a valid access token"],
  [/more than drift_limit_um = (\S+):/, "more than the limit of $1 µm:"],
  ...BUTTONS,
  [/, or see `meissner status`/, ""],
  [/`meissner status` shows/, "“Each pin as a table” shows"],
  [/`meissner list` shows all/, "the list shows all"],
  [/`meissner receipt`/, "“Last play”"],
  [/`meissner session list` shows/, "the view Record shows"],
  [/ with `meissner session end`/, ""],
  [/`(meissner [a-z]+( [a-z]+)?)[^`]*`( on the daemon's machine)?/g, "“$1” on the daemon's machine"],
  [/`([a-z_]+)`/g, (text, key) => LABELS[key] ?? text],
  [/`/g, ""],
  OPTION,
  [/(\d) um\b/g, "$1 µm"],
];

// Advice for the daemon's machine: its commands stay, between backticks, but for those that the page has a button for.
export function advice(text) {
  const words = BUTTONS.reduce((text, [from, to]) => text.replace(from, to), text);
  return words.split("`").map((part, i) => (i % 2 ? part : part.replace(...OPTION))).join("`");
}

// A sentence in the page's words. `text`: the `detail` of a problem.
export function plain(text) {
  const words = WORDS.reduce((text, [from, to]) => text.replace(from, to), text.trim());
  // A name at the beginning stays as it is, such as that of a file.
  const begins = text.startsWith("`") ? words : words.replace(/^\p{Ll}+(?=[\s,:]|$)/u, (word) => word.charAt(0).toUpperCase() + word.slice(1));
  return /[.!?…]$/.test(begins) ? begins : `${begins}.`;
}
