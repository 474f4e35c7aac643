#!/usr/bin/env node
// bench.mjs ELF [--seed N] [--slow F] [--serial HEX] [--revision R] [--pio-late N] [--vbus-sense yes|no]: runs the emulated board on request.
// One JSON request per line on stdin, one JSON answer per line on stdout, each followed by its binary tail (README.md has the
// table). Nothing advances between requests, so a test decides what happens in which cycle. Needs no network and no real time.

import { parseArgs } from 'node:util';
import fs from 'node:fs';
import { Board } from './board.mjs';

/** One run of a board: carries out requests, and collects what the board sends between two answers. */
export class Bench {
  constructor(board) {
    this.board = board;
    this.clear();
    const { host } = board;
    host.onIn = (pipe, bytes) => {
      this.received[pipe].push(bytes);
      if (this.until === pipe) board.stop();
    };
    host.onOut = (pipe, bytes) => this.packets.push([pipe, board.clock.cycle, bytes]);
    host.onSetup = () => this.packets.push(['control', board.clock.cycle, 8]);
    host.onControl = () => this.until === 'control' && board.stop();
    host.onConfigured = () => this.until === 'configured' && board.stop();
  }
  clear() {
    this.received = { cdc: [], bulk: [] };
    this.packets = [];
    this.transfers = [];
    this.board.recorder.clear();
  }
  /** Carries out one request; returns the answer's line and tail as one buffer. */
  answer(line) {
    let extra;
    try {
      extra = this.perform(JSON.parse(line));
    } catch (e) {
      return Buffer.from(`${JSON.stringify({ error: e.message })}\n`);
    }
    const { board } = this;
    const cdc = Buffer.concat(this.received.cdc);
    const bulk = Buffer.concat(this.received.bulk);
    const head = {
      cycle: board.clock.cycle,
      levels: board.recorder.length,
      cdc: cdc.length,
      bulk: bulk.length,
      packets: this.packets,
      transfers: this.transfers,
      configured: board.host.configured,
      resets: board.resets,
      asleep: board.asleep,
      ...extra,
    };
    const answer = Buffer.concat([Buffer.from(`${JSON.stringify(head)}\n`), this.levels(), cdc, bulk]);
    this.clear();
    return answer;
  }
  levels() {
    const { length, cycles, levels } = this.board.recorder;
    const tail = Buffer.alloc(12 * length);
    for (let i = 0; i < length; i++) {
      tail.writeUIntLE(cycles[i], 12 * i, 6); // 48 bits of 64: enough for 25 days of clk_sys
      tail.writeUInt32LE(levels[i], 12 * i + 8);
    }
    return tail;
  }
  perform(request) {
    const { board } = this;
    const { host } = board;
    // The verb is the key that is not an argument of another verb, at any place.
    const verb = Object.keys(request).find((key) => !['until', 'hex', 'bytes', 'to', 'data'].includes(key));
    const value = request[verb];
    switch (verb) {
      case 'run':
        return this.run(value, request.until ?? null);
      case 'cdc':
      case 'bulk':
        if (!host.plugged) throw new Error('unplugged');
        host.send(verb, bytesOf(value));
        return {};
      case 'control': {
        const setup = bytesOf(value);
        if (setup.length !== 8 || setup[0] & 0x80 || setup[6] || setup[7]) throw new Error('control: a SETUP packet of 8 bytes to the device, without data');
        host.program(setup);
        return {};
      }
      case 'transfer': {
        const done = (got) => this.transfers.push(got && Buffer.from(got).toString('hex'));
        const setup = bytesOf(value);
        if (setup.length !== 8) throw new Error('transfer: a SETUP packet of 8 bytes');
        host.transfer(setup, request.data ? bytesOf(request.data) : null, done);
        return {};
      }
      case 'dtr':
        host.setDtr(!!value);
        return {};
      case 'usb':
        pick(
          {
            unplug: () => host.unplug(),
            plug: () => host.plug(),
            reset: () => host.resetBus(),
            abandon: () => host.abandon(),
            suspend: () => host.suspend(),
            resume: () => host.resume(),
            hang: () => host.hang(),
          },
          value,
        )();
        return {};
      case 'cpu':
        pick({ die: () => board.die(), panic: () => board.panic(), hardfault: () => board.hardfault(), run: () => board.runPin() }, value)();
        return {};
      case 'poke': {
        const bytes = bytesOf(request.hex);
        board.memory(value, bytes.length).set(bytes);
        return {};
      }
      case 'wiring':
        board.wiring.set(value);
        board.mcu.pins.update();
        return {};
      case 'register':
        board.bus.write32(value, request.to);
        return {};
      case 'read':
        return { hex: Buffer.from(board.memory(value, request.bytes)).toString('hex') };
      default:
        throw new Error(`unknown request ${verb}`);
    }
  }
  run(cycles, until) {
    if (!Number.isSafeInteger(cycles) || cycles < 0) throw new Error('run: a whole number of cycles, please');
    if (![null, 'configured', 'control', 'cdc', 'bulk'].includes(until)) throw new Error(`run: until ${until}?`);
    this.until = until;
    // the awaited event may have happened already
    const there = until === 'configured' ? this.board.host.configured : this.received[until]?.length > 0;
    if (!there) this.board.run(cycles);
    this.until = null;
    return {};
  }
}

function bytesOf(hex) {
  if (typeof hex !== 'string' || !/^([0-9a-fA-F]{2})*$/.test(hex)) throw new Error('bytes come as pairs of hex digits');
  return Uint8Array.from(Buffer.from(hex, 'hex'));
}
function pick(choices, name) {
  if (!Object.hasOwn(choices, name)) throw new Error(`one of ${Object.keys(choices).join(', ')}, not ${name}`);
  return choices[name];
}

/** Options that every command of the emulator takes. */
export const BOARD_OPTIONS = {
  seed: { type: 'string', default: '1' },
  slow: { type: 'string', default: '1' },
  serial: { type: 'string' },
  revision: { type: 'string', default: '2' },
  'pio-late': { type: 'string', default: '0' },
  'vbus-sense': { type: 'string', default: 'yes' },
};
export function boardOf(elf, { seed, slow, serial, revision, 'pio-late': pioLate, 'vbus-sense': vbusSense }) {
  if (!elf) throw new Error('which ELF?');
  if (!(Number(slow) > 0)) throw new Error(`--slow ${slow}: a factor above 0, please`);
  return new Board({ elf, seed: Number(seed), slow: Number(slow), revision: Number(revision), pioLate: Number(pioLate), vbusSense: vbusSense === 'yes', ...(serial ? { serial } : {}) });
}

function writeAll(buffer) {
  for (let at = 0; at < buffer.length; ) {
    try {
      at += fs.writeSync(1, buffer, at);
    } catch (e) {
      if (e.code !== 'EAGAIN') throw e;
    }
  }
}

async function main() {
  const { positionals, values } = parseArgs({ allowPositionals: true, options: BOARD_OPTIONS });
  const bench = new Bench(boardOf(positionals[0], values));
  let rest = '';
  for await (const chunk of process.stdin.setEncoding('utf8')) {
    const lines = (rest + chunk).split('\n');
    rest = lines.pop();
    for (const line of lines) if (line.trim()) writeAll(bench.answer(line));
  }
}

if (process.argv[1] && fs.realpathSync(process.argv[1]) === fs.realpathSync(new URL(import.meta.url))) {
  main().catch((e) => {
    console.error(`bench: ${e.message}`);
    process.exitCode = 1;
  });
}
