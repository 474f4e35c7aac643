// The pin test: one pin, one stroke or some seconds.

import { order } from "./api.js";
import { array } from "./array.js";
import { $, orders } from "./control.js";
import { number, right } from "./number.js";

// The pattern that moves one pin. One stroke lasts a period.
function pattern() {
  const [motor, hz, um] = ["pin-motor", "pin-hz", "pin-um"].map(number);
  const seconds = $("pin-what").value === "stroke" ? 1 / hz : number("pin-seconds");
  return { format: 1, name: "pin-test", duration_s: seconds, drive: [{ motor, frequency_hz: hz, amplitude_um: um }] };
}

async function play() {
  const isStroke = $("pin-what").value === "stroke";
  if (!right("pin-motor", "pin-hz", "pin-um", ...(isStroke ? [] : ["pin-seconds"]))) return;
  await order("/v1/play", { pattern: pattern() });
}

// `chosen(motor)`: called when a person has chosen a pin here; null for no such pin.
export function bindPinTest(chosen) {
  const mark = () => chosen(Number.isNaN(number("pin-motor")) ? null : number("pin-motor"));
  document.addEventListener("array", () => {
    const { positions_mm: pins, motor } = array();
    [$("pin-motor").max, $("pin-um").max] = [pins.length - 1, motor.travel_um];
    $("pin-um").value = Math.min($("pin-um").value, motor.travel_um);
    chosen(null);
  });
  document.addEventListener("pin", ({ detail }) => {
    $("pin-motor").value = detail;
    $("pin-motor").dispatchEvent(new Event("input"));
  });
  $("pin-motor").addEventListener("input", mark);
  $("pin-what").addEventListener("change", () => ($("pin-seconds-label").hidden = $("pin-what").value === "stroke"));
  orders($("pin-play"), play);
}
