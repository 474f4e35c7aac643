// Fields for numbers, with a decimal comma or a point: a browser's own fields take only one of them. Such a field has `inputmode="decimal"`,
// and `min` and `max` of its numbers.

import { element, valid } from "./control.js";

const $ = (id) => document.getElementById(id);
const NUMBER = /^[-+−]?(\d+([.,]\d*)?|[.,]\d+)$/;

// The number of a field; NaN if there is none, or one out of range.
export function number(id) {
  const { value, min, max } = $(id);
  const text = value.trim();
  const read = NUMBER.test(text) ? Number(text.replace(",", ".").replace("−", "-")) : NaN;
  return read >= Number(min) && read <= Number(max) ? read : NaN;
}

function check(field) {
  const isWrong = field.inputMode === "decimal" && Number.isNaN(number(field.id));
  field.setCustomValidity(isWrong ? `Enter a number, ${field.min} to ${field.max}.` : "");
}

// Whether these fields are right. If not, the first wrong one says why and gets the focus.
export function right(...ids) {
  const fields = ids.map($);
  fields.forEach(check);
  // A field that is folded away must be seen.
  const folded = fields.find((field) => !field.checkValidity())?.closest("details:not([open])");
  if (folded) folded.open = true;
  return valid(...ids);
}

// As `right`, without taking the focus from where the person works.
export function complain(...ids) {
  return ids.map($).map((field) => {
    check(field);
    field.parentElement.querySelector(".wrong")?.remove();
    if (field.checkValidity()) return true;
    field.after(element("span", field.validationMessage, { className: "wrong", role: "alert" }));
    return false;
  }).every(Boolean);
}

// All numbers of a text, with commas or points.
export function numbers(text) {
  return (text.match(/[-−]?\d+([.,]\d+)?/g) ?? []).map((part) => Number(part.replace(",", ".").replace("−", "-")));
}
