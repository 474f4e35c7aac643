// Pictures of the page, for the book and for a review: node screenshots.js FOLDER. It prints how soon the page was painted.
//
// While `edge-45` plays, and the designer with a pattern that was found; 390, 1400 and 3000 px wide, light and dark.

import { mkdirSync } from "node:fs";
import { join } from "node:path";
import { arm, Daemon, endAll, launch, open, SEARCHED, shows, WAIT } from "./daemon.js";

const [folder] = process.argv.slice(2);
mkdirSync(folder, { recursive: true });
const browser = await launch();
const daemon = await new Daemon().start();
const first = await open(browser, daemon);
await arm(first);
await first.select("#load", "edge-45");
await first.click("#find");
await first.waitForSelector("#feel:not([disabled])", SEARCHED);
await (await fetch(`${daemon.url}/v1/play`, { method: "POST", body: JSON.stringify({ pattern: "edge-45", seconds: 60 }) })).json();
for (const width of [390, 1400, 3000]) {
  for (const scheme of ["light", "dark"]) {
    const page = await open(browser, daemon, width, Math.max(1000, Math.round(width / 2)));
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
    await shows(page, "state-text", "Playing edge-45");
    await page.waitForFunction(() => document.querySelector('.finger .hand[visibility="visible"]'), WAIT);
    await page.waitForSelector("#feel:not([disabled])", WAIT);
    const paint = await page.evaluate(() => performance.getEntriesByType("paint").map((entry) => `${entry.name} ${entry.startTime.toFixed(0)} ms`).join(", "));
    console.log(`${width} px, ${scheme}: ${paint}`);
    await page.screenshot({ path: join(folder, `play-${width}-${scheme}.png`) });
    // So high that the bars at the top and at the bottom do not cover it.
    await first.setViewport({ width, height: 3600 });
    await first.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
    await (await first.$("section.designer")).screenshot({ path: join(folder, `designer-${width}-${scheme}.png`) });
    await page.screenshot({ path: join(folder, `whole-${width}-${scheme}.png`), fullPage: true });
    await page.close();
  }
}
await browser.close();
await endAll();
