// The order in which Gaussians are drawn: far ones first, as by float32 z.

/** Sorts by z; its arrays are kept between calls. `room` numbers are in its `order`, at least n. */
class Order {
  constructor(centres, room) {
    this.centres = centres;
    const n = centres.length / 3;
    this.z = new Float32Array(n);
    this.bits = new Uint32Array(this.z.buffer);
    this.keys = new Uint32Array(n);
    this.other = new Uint32Array(n);
    this.between = new Uint32Array(n);
    this.order = new Uint32Array(room);
    this.counts = [new Uint32Array(2049), new Uint32Array(2049)];
  }

  /**
   * Numbers of those past `near` that may be in the picture, far ones first: Uint32 [count].
   *
   * z > 0, so its bits are in the order of z. Two passes of 11 bits sort what is left of them once
   * the least was taken off: to 8 digits in a room.
   */
  of(eye, near) {
    const { centres, bits, z, keys, between, order } = this;
    const { R, centre } = eye, [a, b, c] = [R[6], R[7], R[8]];
    // Cones about the picture, wider by half of it on each side, for what reaches into it.
    const { fx, fy, cx, cy, width, height } = eye;
    const left = -(cx + width / 2) / fx, right = (1.5 * width - cx) / fx;
    const top = -(cy + height / 2) / fy, bottom = (1.5 * height - cy) / fy;
    let count = 0, least = 0xffffffff, most = 0;
    for (let i = 0, j = 0; j < centres.length; i++, j += 3) {
      const x = centres[j] - centre[0], y = centres[j + 1] - centre[1];
      const w = centres[j + 2] - centre[2], depth = a * x + b * y + c * w;
      if (!(depth > near)) continue;
      const u = R[0] * x + R[1] * y + R[2] * w, v = R[3] * x + R[4] * y + R[5] * w;
      if (u < left * depth || u > right * depth || v < top * depth || v > bottom * depth) continue;
      z[i] = depth;
      keys[count++] = i;
      if (bits[i] < least) least = bits[i];
      if (bits[i] > most) most = bits[i];
    }
    const shift = Math.max(0, 32 - Math.clz32(Math.max(most - least, 1)) - 22);
    const [low, high] = this.counts;
    low.fill(0);
    high.fill(0);
    // Turned round: what is far comes first.
    const top22 = (1 << 22) - 1;
    for (let k = 0; k < count; k++) {
      const key = top22 - ((bits[keys[k]] - least) >>> shift);
      this.other[keys[k]] = key;
      low[(key & 2047) + 1]++;
      high[(key >>> 11) + 1]++;
    }
    for (let k = 1; k <= 2048; k++) {
      low[k] += low[k - 1];
      high[k] += high[k - 1];
    }
    for (let k = 0; k < count; k++) between[low[this.other[keys[k]] & 2047]++] = keys[k];
    for (let k = 0; k < count; k++) order[high[this.other[between[k]] >>> 11]++] = between[k];
    return order.subarray(0, count);
  }
}
