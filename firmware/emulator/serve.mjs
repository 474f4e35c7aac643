#!/usr/bin/env node
// serve.mjs ELF [--port N | --unix PATH] [--vcd FILE] [--pace real|free]: the emulated board's USB serial port on a socket, one
// client at a time. A connection is an open tty: DTR is up while it lasts. serial_port.py turns the socket into a serial device.
// With --pace real it never runs ahead of the wall clock; on a slow machine it falls behind, and prints by how much at the end.

import net from 'node:net';
import fs from 'node:fs';
import { parseArgs } from 'node:util';
import { BOARD_OPTIONS, boardOf } from './bench.mjs';
import { Vcd } from './vcd.mjs';

const SLICE_NS = 1e6;
/** Bytes waiting for the device above which the client is paused, and below which it is resumed. */
const FULL = 65536;
const LOW = 16384;

function listen(server, { port, unix }) {
  const where = unix ? [unix] : [Number(port), '127.0.0.1'];
  if (unix) fs.rmSync(unix, { force: true });
  server.listen(...where, () => console.log(`listening ${unix ?? server.address().port}`));
}

function main() {
  const { positionals, values } = parseArgs({
    allowPositionals: true,
    options: {
      ...BOARD_OPTIONS,
      port: { type: 'string', default: '0' },
      unix: { type: 'string' },
      vcd: { type: 'string' },
      pace: { type: 'string', default: 'real' },
    },
  });
  if (!['real', 'free'].includes(values.pace)) throw new Error(`--pace ${values.pace}: real or free`);
  const board = boardOf(positionals[0], values);
  const { host, clock } = board;
  const vcd = values.vcd ? new Vcd(values.vcd) : null;
  let client = null;
  let stopping = false;

  host.onConfigured = () => {
    console.log('usb configured');
    if (client) host.setDtr(true);
  };
  host.onIn = (pipe, bytes) => pipe === 'cdc' && client?.write(bytes);
  const server = net.createServer((socket) => {
    if (client) return socket.destroy();
    client = socket.setNoDelay(true);
    host.setDtr(true);
    socket.on('data', (data) => {
      host.send('cdc', data);
      if (host.out.cdc.queued > FULL) socket.pause();
    });
    socket.on('error', () => {});
    socket.on('close', () => {
      client = null;
      host.setDtr(false);
    });
  });
  listen(server, values);
  for (const signal of ['SIGTERM', 'SIGINT']) process.on(signal, () => (stopping = true));

  const started = process.hrtime.bigint();
  const slice = () => {
    const wall = Number(process.hrtime.bigint() - started);
    if (stopping) return finish(wall);
    if (values.pace === 'real' && clock.nanos > wall) return setTimeout(slice, Math.max(1, (clock.nanos - wall) / 1e6));
    board.run(Math.ceil((SLICE_NS * clock.hz) / 1e9));
    if (vcd) vcd.take(board.recorder, clock);
    else board.recorder.clear();
    if (client?.isPaused() && host.out.cdc.queued < LOW) client.resume();
    setImmediate(slice);
  };
  const finish = (wall) => {
    console.log(`emulated ${(clock.nanos / 1e9).toFixed(2)} s in ${(wall / 1e9).toFixed(2)} s`);
    vcd?.close();
    client?.destroy();
    server.close();
    if (values.unix) fs.rmSync(values.unix, { force: true });
  };
  slice();
}

try {
  main();
} catch (e) {
  console.error(`serve: ${e.message}`);
  process.exitCode = 1;
}
