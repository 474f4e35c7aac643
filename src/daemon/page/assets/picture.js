// Files of height maps: PNG in grey with 8 or 16 bits, and NPY, go to the daemon as they are. The daemon takes no colours, so the brightness
// of any other image becomes an array.

import { element } from "./control.js";

// The daemon takes requests of 4 MiB, and base64 adds a third.
const MOST_BYTES = 3_000_000;
const MOST_NAME = 60;
// Pixels that one task reads.
const PIECE = 200_000;
// Cells of the drawing on the pad, along the longer side.
const CELLS = 40;
const PNG = [0x89, 0x50, 0x4e, 0x47];
const GREY = 0;

async function base64(bytes) {
  const url = await new Promise((done, fail) => {
    const reader = new FileReader();
    reader.onload = () => done(reader.result);
    reader.onerror = () => fail(new Error("the file cannot be read: choose it again"));
    reader.readAsDataURL(new Blob([bytes]));
  });
  return url.slice(url.indexOf(",") + 1);
}

// The brightness of an image's pixels at a size, row by row, as bytes: in pieces, between which E-STOP is heard.
async function brightness(image, width, height) {
  const context = element("canvas", "", { width, height }).getContext("2d", { willReadFrequently: true });
  context.fillRect(0, 0, width, height);
  context.drawImage(image, 0, 0, width, height);
  const grey = new Uint8ClampedArray(width * height);
  const rows = Math.ceil(PIECE / width);
  for (let from = 0; from < height; from += rows) {
    const { data } = context.getImageData(0, from, width, Math.min(rows, height - from));
    for (let i = 0; i < data.length / 4; i += 1) grey[from * width + i] = 0.2126 * data[4 * i] + 0.7152 * data[4 * i + 1] + 0.0722 * data[4 * i + 2];
    await new Promise((done) => setTimeout(done));
  }
  return grey;
}

// An NPY file of bytes, as integers of 16 bits, which the daemon takes.
function npy(rows, columns, bytes) {
  const head = `{'descr': '<i2', 'fortran_order': False, 'shape': (${rows}, ${columns}), }`;
  // The data begins at a multiple of 64 bytes; ten of them stand before the header.
  const length = Math.ceil((head.length + 11) / 64) * 64 - 10;
  const text = `${head.padEnd(length - 1)}\n`;
  const start = [0x93, ...new TextEncoder().encode("NUMPY"), 1, 0, length & 255, length >> 8, ...new TextEncoder().encode(text)];
  const file = new Uint8Array(start.length + 2 * bytes.length);
  file.set(start);
  bytes.forEach((byte, i) => (file[start.length + 2 * i] = byte));
  return file;
}

// Columns and rows of an NPY file; the daemon reads the rest.
function shape(bytes) {
  const found = /'shape':\s*\((\d+),\s*(\d+)/.exec(new TextDecoder("latin1").decode(bytes.slice(0, 1000)));
  if (!found) throw new Error("the file is no NPY array of two dimensions: choose another one");
  return [Number(found[2]), Number(found[1])];
}

// A height map of a file: `name` and `data` (base64) for the daemon, `size` in pixels, `levels` (the number of white; 1 for arrays),
// `cells` (a coarse drawing: columns, rows and brightness) or null, and `note`, what the person should know.
export async function picture(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const isLarge = file.size > MOST_BYTES;
  const name = file.name.replace(/[^\w.-]/g, "-").slice(-MOST_NAME);
  if (/\.npy$/i.test(name)) {
    if (isLarge) throw new Error(`${file.name} has ${(file.size / 1e6).toFixed(1)} MB: at most ${MOST_BYTES / 1e6} MB, make it smaller`);
    return { name, data: await base64(bytes), size: shape(bytes), levels: 1, cells: null, note: "" };
  }
  let image;
  try {
    image = await createImageBitmap(new Blob([bytes]));
  } catch {
    throw new Error(`${file.name} is no image that this browser can read: choose a PNG or NPY file`);
  }
  const size = [image.width, image.height];
  const [columns, rows] = size.map((pixels) => Math.max(1, Math.min(pixels, Math.round((CELLS * pixels) / Math.max(...size)))));
  const cells = { columns, rows, grey: [...(await brightness(image, columns, rows))] };
  // Behind the signature, the head of the first chunk, width and height.
  const [bits, colours] = bytes.slice(3 * 8);
  if (PNG.every((byte, i) => bytes[i] === byte) && colours === GREY && !isLarge && (bits === 8 || bits === 16)) {
    return { name: name.replace(/(\.png)?$/i, ".png"), data: await base64(bytes), size, levels: 2 ** bits - 1, cells, note: "" };
  }
  const shrink = Math.min(1, Math.sqrt(MOST_BYTES / (2.1 * size[0] * size[1])));
  const fit = size.map((pixels) => Math.max(1, Math.floor(shrink * pixels)));
  const scaled = shrink < 1 ? ` It is scaled from ${size.join(" × ")} to ${fit.join(" × ")} pixels.` : "";
  return { name: `${name.replace(/\.\w+$/, "")}.npy`, data: await base64(npy(fit[1], fit[0], await brightness(image, ...fit))), size: fit, levels: 255, cells, note: `Its brightness counts, not its colours.${scaled}` };
}
