// What tests of the view Play share: the chosen pattern, and what the daemon says.

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
