// The last play: its receipt.

import { call, last, text } from "./api.js";
import { $, facts, refuse, saveFile, say, write } from "./control.js";
import { part } from "./views.js";

// The play that is shown.
let shown = null;
const NONE = $("receipt-summary").textContent;

function show(receipt) {
  const { counts: { bursts, lateness }, duration_ms: ms, items, pins } = receipt;
  // A running play has no counts yet.
  if (!bursts) return;
  shown = receipt.id;
  const lost = bursts.late + bursts.dropped + bursts.refused;
  $("receipt-summary").textContent = `Play ${receipt.id}, ${receipt.name}: ${receipt.state}${receipt.cause ? ` (${receipt.cause})` : ""}. `
    + (lost ? `${lost} of ${bursts.planned} bursts were not played.` : `All ${bursts.planned} bursts were played.`);
  const rest = pins?.rest_error_um.length ? Math.max(...pins.rest_error_um.map(Math.abs)) : null;
  facts($("receipt-facts"), [
    ["Bursts played, late, dropped, refused", `${bursts.played}, ${bursts.late}, ${bursts.dropped}, ${bursts.refused}`],
    ...(items?.length > 1 ? [["Items", states(items)]] : []),
    ["Corrected by feedback", bursts.amended],
    ["Largest lateness", `${lateness.worst_ms.toFixed(2)} ms`],
    ["Duration played, ordered", `${ms.played?.toFixed(1) ?? "-"} ms, ${ms.ordered?.toFixed(1) ?? "without end"} ms`],
    ["Largest offset from rest at the end", rest === null ? "not known" : `${rest.toFixed(1)} µm`],
  ]);
  $("receipt-keep").hidden = false;
}

// How many items ended in which state.
function states(items) {
  return Object.entries(Object.groupBy(items, (item) => item.state)).map(([state, of]) => `${of.length} ${state}`).join(", ");
}

// The whole receipt: an event has the item of a play of one.
const whole = (id) => call("GET", `/v1/plays/${id}`);

// The newest play that has begun, of the newest few: one that was removed from the queue is not the last one that was felt.
async function newest(id, tries = 8) {
  if (!id || !tries) return null;
  const receipt = await whole(id).catch((error) => {
    if (error.code !== "not-found") throw error;
    return { onset: null };
  });
  return receipt.onset ? receipt : newest(id - 1, tries - 1);
}

async function load() {
  const receipt = await newest(last()?.newest.play);
  if (receipt) return show(receipt);
  // A daemon that was started again has none.
  shown = null;
  write($("receipt-summary"), NONE);
  facts($("receipt-facts"), []);
  $("receipt-keep").hidden = true;
}

export function bindReceipt() {
  $("receipt-keep").addEventListener("click", async () => {
    try {
      const id = shown;
      saveFile([await text(`/v1/plays/${id}`)], "application/json", `play-${id}.json`);
      say($("receipt-keep"), "");
    } catch (error) {
      refuse($("receipt-keep"), error);
    }
  });
  part({
    view: "play",
    at: "receipt-title",
    load,
    on: {
      ended: async ({ receipt }) => receipt.onset && show(receipt.order.items === 1 ? receipt : await whole(receipt.id)),
    },
  });
}
