// Fields for numbers, with a decimal comma or a point. A browser's own fields for numbers take only one of the two and drop the other, so
// that 12,5 would become 125. These are fields of text with `inputmode="decimal"`, or `numeric` for whole numbers. They have `min` and `max`;
// without `required` they may be empty.

import { $, element } from "./control.js";

const NUMBER = /^[-+−]?(\d+([.,]\d*)?|[.,]\d+)(e[-+]?\d+)?$/i;

const isNumeric = ({ inputMode }) => inputMode === "decimal" || inputMode === "numeric";
const isEmpty = ({ value }) => value.trim() === "";

// The number that a text is; NaN if it is none.
function parse(text) {
  return NUMBER.test(text.trim()) ? Number(text.trim().replace(",", ".").replace("−", "-")) : NaN;
}

const bounds = ({ min, max }) => [min === "" ? -Infinity : Number(min), max === "" ? Infinity : Number(max)];

// The number of a field; NaN if there is none, or one out of range, or a fraction in a field for whole numbers.
export function number(id) {
  const field = $(id);
  const [least, most] = bounds(field);
  const read = parse(field.value);
  return read >= least && read <= most && (field.inputMode === "decimal" || Number.isInteger(read)) ? read : NaN;
}

// The number of a field that may be empty; undefined if it is, so that JSON leaves its key out.
export const optional = (id) => (isEmpty($(id)) ? undefined : number(id));

function check(field) {
  if (!isNumeric(field)) return;
  const isWrong = Number.isNaN(number(field.id)) && (field.required || !isEmpty(field));
  field.setCustomValidity(isWrong ? `Enter a ${field.inputMode === "numeric" ? "whole " : ""}number, ${field.min} to ${field.max}.` : "");
}

// Says at a field what is wrong with it, or takes that away. Returns whether the field is right.
function show(field) {
  check(field);
  field.parentElement.querySelector(".wrong")?.remove();
  if (field.checkValidity()) return true;
  field.after(element("span", field.validationMessage, { className: "wrong", role: "alert" }));
  return false;
}

// Whether these fields are right, of numbers or not. If not, the first wrong one says why until it is changed, and gets the focus.
export function right(...ids) {
  const fields = ids.map($);
  fields.forEach(check);
  const wrong = fields.find((field) => !field.checkValidity());
  if (!wrong) return true;
  // A field that is folded away must be seen.
  const folded = wrong.closest("details:not([open])");
  if (folded) folded.open = true;
  show(wrong);
  wrong.addEventListener("input", () => wrong.parentElement?.querySelector(".wrong")?.remove(), { once: true });
  wrong.focus();
  return false;
}

// As `right`, but all wrong fields say why, and none takes the focus from where the person works.
export function complain(...ids) {
  return ids.map($).map(show).every(Boolean);
}

// Takes away what fields said.
export function forgive(...ids) {
  for (const id of ids) $(id).parentElement.querySelector(".wrong")?.remove();
}

// All numbers of a text, with commas or points.
export function numbers(text) {
  return (text.match(/[-−]?\d+([.,]\d+)?/g) ?? []).map((part) => Number(part.replace(",", ".").replace("−", "-")));
}
