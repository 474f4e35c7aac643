// The page's words for what the daemon refuses and says.

// Why a sensor is not trusted, by the API's names.
export const SENSOR_FAULTS = {
  jumps: "it jumps where nothing moved", gain: "it shows far less or more travel than bursts make", scatter: "equal bursts differ too much",
  limit: "corrections at their limit have not helped",
};

// What to do here, by the code of a problem whose `detail` names commands: the page has buttons.
const WORDS = {
  disarmed: "The motors are disarmed: press Arm first.",
  faulted: "An emergency stop or fault is latched: find out why, then press Reset and Arm.",
  playing: "A play runs or waits: wait for its end, or press Stop play.",
  "queue-full": "The queue is full: wait, or press Stop play.",
  "behind-endless": "The play before it has no end: press Stop play first.",
  "no-device": "No device is connected: plug it in.",
  "position-unknown": "The device does not know where the pins are: see that all are at rest, then press Arm.",
  "level-not-checked": "Pins may have drifted from rest: look at them, level them, then press Arm and enter your name.",
  "drift-limit": "Pins may be further from rest than the limit: press Home if the motors are calibrated, or level the pins by hand, then press Arm and enter your name.",
  "nothing-to-go-by": "No telemetry and no calibration say where the pins are: level them by hand, then press Disarm and Arm.",
  "not-home": "Not all pins are at rest: “Each pin as a table” shows how far off each is. Level those by hand, then press Disarm and Arm.",
  "session-running": "Another session runs than the page showed, or none: look who feels the pins, then try again.",
  exists: "The name is taken: choose another one. “Replace an older one” replaces a pattern of this site, and none of the library.",
  unauthorized: "Enter a valid access token.",
};

// A problem in the page's words: an error with the `code` of the API, or one of the page.
export const plain = ({ code, message }) => WORDS[code] ?? sentence(message);

// A text of the daemon as a sentence.
export function sentence(text) {
  const quoted = text.trim().replace(/`([^`]*)`/g, "“$1”");
  // A name at the beginning stays as it is, such as that of a file.
  const begins = quoted.replace(/^\p{Ll}+(?=[\s,:]|$)/u, (word) => word.charAt(0).toUpperCase() + word.slice(1));
  return /[.!?…]$/.test(begins) ? begins : `${begins}.`;
}
