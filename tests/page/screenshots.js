// Pictures of the page, for the book and for a review: node screenshots.js FOLDER. It prints how soon the page was painted.
//
// Each view while `edge-45` plays, with a thing that was rendered, and the dialog of Arm; 390, 1400 and 3000 px wide, light and dark.

import { mkdirSync } from "node:fs";
import { join } from "node:path";
import { arm, Daemon, endAll, launch, open, shows, view, WAIT } from "./daemon.js";

const [folder] = process.argv.slice(2);
mkdirSync(folder, { recursive: true });
const browser = await launch();
const daemon = await new Daemon().start();
const first = await open(browser, daemon);
await arm(first);
await (await fetch(`${daemon.url}/v1/play`, { method: "POST", body: JSON.stringify({ pattern: "edge-45", seconds: 300 }) })).json();
// What is to be seen in each view.
const READY = { play: ".thumbnail", design: "#thing-result:not([hidden], .older)", record: "#sessions-none:not([hidden])", device: "#findings li" };
for (const width of [390, 1400, 3000]) {
  for (const scheme of ["light", "dark"]) {
    const page = await open(browser, daemon, width, width === 390 ? 844 : Math.max(1000, Math.round(width / 2)));
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
    await shows(page, "state-text", "Playing edge-45");
    await page.waitForFunction(() => document.querySelector(".finger").drawn?.some((um) => um > 1), WAIT);
    const paint = await page.evaluate(() => performance.getEntriesByType("paint").map((entry) => `${entry.name} ${entry.startTime.toFixed(0)} ms`).join(", "));
    console.log(`${width} px, ${scheme}: ${paint}`);
    for (const [name, ready] of Object.entries(READY)) {
      await view(page, name);
      if (name === "design") {
        await page.$eval("#points", (field) => ((field.value = "-4 -4; 4 4"), field.dispatchEvent(new Event("change"))));
      }
      await page.waitForSelector(ready, WAIT);
      await page.screenshot({ path: join(folder, `${name}-${width}-${scheme}.png`) });
      await page.screenshot({ path: join(folder, `${name}-whole-${width}-${scheme}.png`), fullPage: true });
    }
    await page.close();
  }
}
await browser.close();
await endAll();
