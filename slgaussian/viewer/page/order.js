// Drawing order of Gaussians: by depth (float32 z), farthest first.

/** Sorter by depth, which reuses its arrays. `capacity` is the length of `order`, at least n. */
class Order {
  constructor(centres, capacity) {
    this.centres = centres;
    const n = centres.length / 3;
    this.z = new Float32Array(n);
    this.bits = new Uint32Array(this.z.buffer);
    this.indices = new Uint32Array(n);
    this.keys = new Uint32Array(n);
    this.byLowDigit = new Uint32Array(n);
    this.order = new Uint32Array(capacity);
    this.counts = [new Uint32Array(2049), new Uint32Array(2049)];
  }

  /**
   * Return the indices of Gaussians beyond `near` that the image may show, farthest first: Uint32
   * [count].
   *
   * The bits of a positive float32 sort as the number does. A radix sort of two passes of 11 bits
   * sorts their differences from the smallest; in a room this is exact to 8 digits.
   */
  sort(eye, near) {
    const { centres, bits, z, indices, byLowDigit, order } = this;
    const { R, centre } = eye, [a, b, c] = [R[6], R[7], R[8]];
    // The view frustum, wider by half an image on each side for Gaussians that reach into it.
    const { fx, fy, cx, cy, width, height } = eye;
    const left = -(cx + width / 2) / fx, right = (1.5 * width - cx) / fx;
    const top = -(cy + height / 2) / fy, bottom = (1.5 * height - cy) / fy;
    let count = 0, smallest = 0xffffffff, largest = 0;
    for (let i = 0, j = 0; j < centres.length; i++, j += 3) {
      const x = centres[j] - centre[0], y = centres[j + 1] - centre[1];
      const w = centres[j + 2] - centre[2], depth = a * x + b * y + c * w;
      if (!(depth > near)) continue;
      const u = R[0] * x + R[1] * y + R[2] * w, v = R[3] * x + R[4] * y + R[5] * w;
      if (u < left * depth || u > right * depth || v < top * depth || v > bottom * depth) continue;
      z[i] = depth;
      indices[count++] = i;
      if (bits[i] < smallest) smallest = bits[i];
      if (bits[i] > largest) largest = bits[i];
    }
    const shift = Math.max(0, 32 - Math.clz32(Math.max(largest - smallest, 1)) - 22);
    const [low, high] = this.counts;
    low.fill(0);
    high.fill(0);
    // Inverted keys: the farthest comes first.
    const top22 = (1 << 22) - 1;
    for (let k = 0; k < count; k++) {
      const key = top22 - ((bits[indices[k]] - smallest) >>> shift);
      this.keys[indices[k]] = key;
      low[(key & 2047) + 1]++;
      high[(key >>> 11) + 1]++;
    }
    for (let k = 1; k <= 2048; k++) {
      low[k] += low[k - 1];
      high[k] += high[k - 1];
    }
    for (let k = 0; k < count; k++) byLowDigit[low[this.keys[indices[k]] & 2047]++] = indices[k];
    for (let k = 0; k < count; k++) order[high[this.keys[byLowDigit[k]] >>> 11]++] = byLowDigit[k];
    return order.subarray(0, count);
  }
}
