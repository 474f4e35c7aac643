// What tests of the view Play share: the chosen pattern, its table, and what the daemon says.

import { press, shows, WAIT } from "./daemon.js";

export const get = async (daemon, path) => (await fetch(`${daemon.url}${path}`)).json();
export const set = (page, id, value) => page.$eval(`#${id}`, (field, value) => {
  field.value = value;
  for (const event of ["input", "change"]) field.dispatchEvent(new Event(event));
}, value);
export const choose = async (page, name) => {
  await page.waitForSelector(`li[data-name="${name}"] .choose`);
  await press(page, `li[data-name="${name}"] .choose`);
  await shows(page, "chosen-title", `Pattern ${name}`);
  await page.waitForSelector("#chosen-body:not([hidden])");
};
export const quiet = (page) => page.complaints.filter((line) => !/40[49]|422/.test(line));
export const rows = (page) => page.$$eval("#drives tbody tr", (rows) => rows.map((row) => [...row.querySelectorAll("input")].map((input) => input.value)));
export const field = (row, column) => `#drives tbody tr:nth-child(${row}) td:nth-child(${column}) input`;
export const type = (page, selector, value) => page.$eval(selector, (input, value) => ((input.value = value), input.dispatchEvent(new Event("input"))), value);
