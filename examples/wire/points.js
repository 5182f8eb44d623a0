// Reads the points of a cloud where they lie in a message, in JavaScript alone.
//
//     node examples/wire/points.js < message    # a sensor_msgs/msg/PointCloud2 on the bus
//
// It prints how many points there are, and the mean of x, y and z. docs/reference/messages.md says
// how an array stands in a message. `unpack` leaves binaries as views, and a typed array on one
// gives all its numbers at once.
"use strict";

function unpack(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  const number = (width) => {
    at += width;
    if (width === 8) return Number(view.getBigUint64(at - 8));
    return [0, view.getUint8, view.getUint16, 0, view.getUint32][width].call(view, at - width);
  };
  const binary = (size) => {
    if (size > bytes.length - at) throw new RangeError("the message ends too early");
    return bytes.subarray(at, (at += size));
  };
  const text = (size) => new TextDecoder("utf-8", { fatal: true }).decode(binary(size));
  const array = (size) => {
    if (size > bytes.length - at) throw new RangeError("the message ends too early");
    return Array.from({ length: size }, value);
  };
  const map = (size) => {
    if (size > bytes.length - at) throw new RangeError("the message ends too early");
    return Object.fromEntries(Array.from({ length: size }, () => [value(), value()]));
  };
  function value() {
    const head = number(1);
    if (head < 0x80) return head;
    if (head < 0x90) return map(head & 15);
    if (head < 0xa0) return array(head & 15);
    if (head < 0xc0) return text(head & 31);
    if (head >= 0xe0) return head - 256;
    if (head === 0xc0) return null;
    if (head < 0xc4) return head === 0xc3;
    if (head < 0xc7) return binary(number(1 << (head - 0xc4)));
    if (head === 0xca) return view.getFloat32((at += 4) - 4);
    if (head === 0xcb) return view.getFloat64((at += 8) - 8);
    if (head >= 0xcc && head < 0xd0) return number(1 << (head - 0xcc));
    if (head === 0xd0) return view.getInt8((at += 1) - 1);
    if (head === 0xd1) return view.getInt16((at += 2) - 2);
    if (head === 0xd2) return view.getInt32((at += 4) - 4);
    if (head === 0xd3) return Number(view.getBigInt64((at += 8) - 8));
    if (head >= 0xd9 && head < 0xdc) return text(number(1 << (head - 0xd9)));
    if (head === 0xdc || head === 0xdd) return array(number(2 << (head - 0xdc)));
    if (head === 0xde || head === 0xdf) return map(number(2 << (head - 0xde)));
    throw new RangeError(`0x${head.toString(16)} begins no value of a message`);
  }
  return value();
}

const cloud = unpack(require("fs").readFileSync(0));
const count = cloud.width * cloud.height;
if (cloud.row_step !== cloud.width * cloud.point_step || cloud.data.length < count * cloud.point_step) {
  throw new RangeError("the rows have gaps, or are not whole");
}
// A typed array has to begin at a multiple of its numbers' size: one copy of the block may do that.
const aligned = cloud.data.byteOffset % 4 ? cloud.data.slice() : cloud.data;
const floats = new Float32Array(aligned.buffer, aligned.byteOffset, aligned.byteLength >> 2);
const step = cloud.point_step / 4;
const means = ["x", "y", "z"].map((name) => {
  const field = cloud.fields.find((each) => each.name === name && each.datatype === 7);
  if (!field || field.offset % 4 || step % 1) throw new RangeError(`no float32 ${name} to read`);
  let sum = 0;
  for (let at = field.offset / 4; at < count * step; at += step) sum += floats[at];
  return sum / count;
});
console.log(count, ...means.map((mean) => Number(mean.toPrecision(6))));
