// Reads transforms in fewer bytes (version 2 of a message), in JavaScript alone.
//
//     node examples/wire/transforms.js DESCRIPTION MESSAGE    # two files
//
// It prints a line for each: parent, child, stamp in ns, x y z, qx qy qz qw. docs/reference/wire.md,
// "Frames by numbers", has the forms.
"use strict";

const { readFileSync } = require("fs");

function unpack(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  const take = (size) => {
    if (size > bytes.length - at) throw new RangeError("the message ends too early");
    return (at += size) - size;
  };
  // Epochs and stamps have more digits than a Number.
  const whole = (size) => {
    const from = take(size);
    return size === 8 ? view.getBigUint64(from) : view[`getUint${8 * size}`](from);
  };
  const text = (size) => new TextDecoder("utf-8", { fatal: true }).decode(binary(size));
  const binary = (size) => bytes.subarray(take(size), at);
  const array = (size, item = value) => {
    if (size > bytes.length - at) throw new RangeError("the message ends too early");
    return Array.from({ length: size }, item);
  };
  const map = (size) => new Map(array(size, () => [value(), value()]));
  function value() {
    const head = whole(1);
    if (head < 0x80) return head;
    if (head < 0x90) return map(head & 15);
    if (head < 0xa0) return array(head & 15);
    if (head < 0xc0) return text(head & 31);
    if (head >= 0xe0) return head - 256;
    if (head === 0xc0) return null;
    if (head === 0xc2 || head === 0xc3) return head === 0xc3;
    if (head >= 0xc4 && head < 0xc7) return binary(whole(1 << (head - 0xc4)));
    if (head === 0xca) return view.getFloat32(take(4));
    if (head === 0xcb) return view.getFloat64(take(8));
    if (head >= 0xcc && head < 0xd0) return whole(1 << (head - 0xcc));
    if (head === 0xd0) return view.getInt8(take(1));
    if (head === 0xd1) return view.getInt16(take(2));
    if (head === 0xd2) return view.getInt32(take(4));
    if (head === 0xd3) return view.getBigInt64(take(8));
    if (head >= 0xd9 && head < 0xdc) return text(whole(1 << (head - 0xd9)));
    if (head === 0xdc || head === 0xdd) return array(whole(2 << (head - 0xdc)));
    if (head === 0xde || head === 0xdf) return map(whole(2 << (head - 0xde)));
    throw new RangeError(`0x${head.toString(16)} begins no value of a message`);
  }
  const found = value();
  if (at !== bytes.length) throw new RangeError("bytes follow the message");
  return found;
}

const viewOf = (bytes) => new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
const sizeOf = (form) =>
  form < 8 ? [0, 6, 9, 12][form & 3] + (form & 4 ? 6 : 0) : { 8: 28, 9: 56 }[form];
const floats = (view, at, size) =>
  Array.from({ length: 7 }, (_, i) =>
    size === 4 ? view.getFloat32(at + 4 * i, true) : view.getFloat64(at + 8 * i, true));

// A signed integer of 2 to 4 bytes.
function signed(view, at, size) {
  let number = 0;
  for (let i = size - 1; i >= 0; i--) number = number * 256 + view.getUint8(at + i);
  return number >= 2 ** (8 * size - 1) ? number - 2 ** (8 * size) : number;
}

function rotation(view, at) {
  let bits = 0n;
  for (let i = 5; i >= 0; i--) bits = bits * 256n + BigInt(view.getUint8(at + i));
  const others = [2n, 17n, 32n].map(
    (from) => (Number((bits >> from) & 32767n) - 16383) / (16383 * Math.SQRT2));
  const square = 1 - others.reduce((sum, each) => sum + each * each, 0);
  if (square < 0) throw new RangeError("bits that are no rotation");
  others.splice(Number(bits & 3n), 0, Math.sqrt(square));
  return others;
}

function poseOf(view, at, form, origin) {
  if (form === 9) return floats(view, at, 8);
  if (form === 8) return floats(view, at, 4).map((each, i) => (i < 3 ? each + origin[i] : each));
  const size = [0, 2, 3, 4][form & 3];
  const xyz = [0, 1, 2].map(
    (i) => origin[i] + (size ? signed(view, at + i * size, size) * 0.0001 : 0));
  return [...xyz, ...(form & 4 ? rotation(view, at + 3 * size) : origin.slice(3))];
}

function transformsOf(message, description) {
  if (message.get("v") !== 2) throw new RangeError(`version ${message.get("v")}, not 2`);
  if (message.get("epoch") !== description.get("epoch")) {
    throw new RangeError("the description is of another epoch");
  }
  const origins = viewOf(description.get("origins"));
  const named = new Map(description.get("numbered").map(([number, parent, child], i) =>
    [number, { parent, child, origin: floats(origins, 56 * i, 8) }]));
  const numbers = [];
  const runs = message.get("runs");
  for (let i = 0; i < runs.length; i += 2) {
    for (let n = 0; n < runs[i + 1]; n++) {
      if (numbers.length === 300000) throw new RangeError("too many rows");
      numbers.push(runs[i] + n);
    }
  }
  const { stamps, forms, poses } = Object.fromEntries(message);
  const view = viewOf(poses);
  let at = 0;
  const found = [];
  numbers.forEach((number, row) => {
    const form = forms[forms.length === 1 ? 0 : row];
    const size = sizeOf(form);
    if (size === undefined || at + size > poses.length) throw new RangeError("no such form");
    const frame = named.get(number); // One that is not there: the description is older, or newer.
    if (frame) {
      const place = stamps.length === 8 ? 0 : 8 * row; // One is that of all rows.
      const stamp = stamps instanceof Uint8Array ? viewOf(stamps).getBigInt64(place, true) : stamps;
      found.push([frame.parent, frame.child, stamp, ...poseOf(view, at, form, frame.origin)]);
    }
    at += size;
  });
  if (at !== poses.length) throw new RangeError("bytes follow the poses");
  return found;
}

const [description, message] = process.argv.slice(2, 4).map((path) => unpack(readFileSync(path)));
for (const row of transformsOf(message, description)) console.log(row.join(" "));
