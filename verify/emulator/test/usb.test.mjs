// The USB controller in device mode, driven by its registers as a driver would: buffers, toggles, stalls, suspend, frames.

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { chip, idle, read, write } from './chip.mjs';

const DPRAM = 0x50100000;
const USB = 0x50110000;
const OUT1 = DPRAM + 0x8c;
const IN1 = DPRAM + 0x88;
const AVAILABLE = 1 << 10;
const FULL = 1 << 15;

/** Attached, the bus reset over, endpoint 1 a bulk pair that the host knows as `bulk`. */
function device({ double = false } = {}) {
  const b = chip();
  write(b, USB + 0x40, 1);
  write(b, USB + 0x90, 0x1f010 | (1 << 12));
  write(b, USB + 0x4c, (1 << 16) | (1 << 29));
  idle(b, 127500 * 16);
  assert.ok(read(b, USB + 0x50) & (1 << 19), 'BUS_RESET');
  write(b, USB + 0x50, 1 << 19);
  assert.equal(read(b, USB + 0x98) & (1 << 12), 0);
  const control = (1 << 31) | (double ? 1 << 30 : 0) | (1 << 29) | (2 << 26);
  write(b, DPRAM + 0x08, control | 0x180);
  write(b, DPRAM + 0x0c, control | 0x200);
  b.host.stage.cancel();
  Object.assign(b.host, { state: 'configured', configured: true });
  b.host.pipes = { bulk: { name: 'bulk', ep: 1, out: false, size: 64, data1: false }, bulkOut: { name: 'bulk', ep: 1, out: true, size: 64, data1: false } };
  b.got = [];
  b.host.onIn = (pipe, bytes) => b.got.push(...bytes);
  return b;
}

test('OUT waits for the buffer, which stays AVAILABLE until the packet is there', () => {
  const b = device();
  b.host.send('bulk', Uint8Array.of(1, 2, 3));
  idle(b, 127500);
  assert.equal(b.host.out.bulk.queued, 3, 'NAKed');
  write(b, OUT1, AVAILABLE | 64);
  idle(b, 100);
  assert.ok(read(b, OUT1) & AVAILABLE);
  idle(b, 127 * 30);
  assert.equal(read(b, OUT1), FULL | 3);
  assert.equal(read(b, DPRAM + 0x200) & 0xffffff, 0x030201);
  assert.equal(read(b, USB + 0x58), 1 << 3);
  assert.ok(read(b, USB + 0x98) & (1 << 4), 'BUFF_STATUS');
  write(b, USB + 0x58, 1 << 3);
  assert.equal(read(b, USB + 0x98) & (1 << 4), 0);
});

test('a packet with the wrong toggle is acknowledged and forgotten', () => {
  const b = device();
  b.host.send('bulk', Uint8Array.of(1));
  write(b, OUT1, AVAILABLE | (1 << 13) | 64);
  idle(b, 127 * 40);
  assert.ok(read(b, OUT1) & AVAILABLE);
  assert.equal(b.host.toggleErrors, 1);
});

test('IN leaves when it is full and available, at the bus speed', () => {
  const b = device();
  write(b, DPRAM + 0x180, 0x04030201);
  write(b, IN1, FULL | AVAILABLE | 4);
  idle(b, 127 * 13);
  assert.deepEqual(b.got, []);
  idle(b, 127 * 3);
  assert.deepEqual(b.got, [1, 2, 3, 4]);
  assert.equal(read(b, IN1) & (AVAILABLE | FULL), 0);
});

test('two buffers of an endpoint are filled in turn', () => {
  const b = device({ double: true });
  write(b, OUT1, AVAILABLE | 64 | ((AVAILABLE | (1 << 13) | 64) << 16));
  b.host.send('bulk', Uint8Array.of(1));
  b.host.send('bulk', Uint8Array.of(2));
  b.host.send('bulk', Uint8Array.of(3));
  idle(b, 127500);
  assert.equal(read(b, DPRAM + 0x200) & 255, 1);
  assert.equal(read(b, DPRAM + 0x240) & 255, 2);
  assert.equal(b.host.out.bulk.queued, 1);
  write(b, OUT1, (read(b, OUT1) & 0xffff0000) | AVAILABLE | 64);
  idle(b, 127500);
  assert.equal(read(b, DPRAM + 0x200) & 255, 3);
});

test('unplugged means suspended 3 ms later; frames interrupt only if asked', () => {
  const b = device();
  idle(b, 127500 * 4);
  assert.equal(read(b, USB + 0x98) & (1 << 17), 0);
  write(b, USB + 0x90, 1 << 17);
  idle(b, 127500 * 2);
  assert.ok(read(b, USB + 0x98) & (1 << 17), 'DEV_SOF');
  read(b, USB + 0x48);
  assert.equal(read(b, USB + 0x98) & (1 << 17), 0, 'cleared by SOF_RD');
  b.host.unplug();
  idle(b, 127500 * 2);
  assert.equal(read(b, USB + 0x50) & (1 << 4), 0);
  idle(b, 127500 * 2);
  assert.ok(read(b, USB + 0x50) & (1 << 4), 'SUSPENDED');
  assert.ok(read(b, USB + 0x8c) & (1 << 14), 'DEV_SUSPEND');
  b.host.plug();
  idle(b, 127500 * 6);
  assert.ok(read(b, USB + 0x50) & (1 << 19), 'BUS_RESET');
});
