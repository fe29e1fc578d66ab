// The object at a point of the image: blends the Gaussians there front to back, as they are drawn.

/** Return {thing, depth} at (x, y): the object with the largest blending weight (0: none), and z. */
function pick(gaussians, sorted, eye, x, y) {
  const { store, centres } = gaussians, floats = new Float32Array(store.buffer);
  const { R, centre, fx, fy, cx, cy, width, height } = eye;
  const [first, step] = about.scale_logs;
  const mx = MARGIN * width / (2 * fx), my = MARGIN * height / (2 * fy);
  const weights = new Map();
  let transmittance = 1, depth = 0, accumulated = 0;
  for (let k = sorted.length - 1; k >= 0 && transmittance > 1 / 256; k--) {
    const i = sorted[k], j = 3 * i;
    const a = centres[j] - centre[0], b = centres[j + 1] - centre[1], c = centres[j + 2] - centre[2];
    const z = R[6] * a + R[7] * b + R[8] * c;
    const u = (R[0] * a + R[1] * b + R[2] * c) / z, v = (R[3] * a + R[4] * b + R[5] * c) / z;
    const ex = x - fx * u - cx, ey = y - fy * v - cy;
    const codes = store[8 * i + 5];
    const s = [0, 10, 20].map((shift) => Math.exp(first + step * (codes >>> shift & 1023)));
    // Upper bound of the Gaussian's extent in pixels.
    const radius = 5 * (Math.max(...s) * Math.max(fx, fy) * 2 / z + 1);
    if (Math.abs(ex) > radius || Math.abs(ey) > radius) continue;
    const q = quaternion(store[8 * i + 4]);
    const hu = Math.min(Math.max(u, -cx / fx - mx), (width - cx) / fx + mx);
    const hv = Math.min(Math.max(v, -cy / fy - my), (height - cy) / fy + my);
    let xx = LOW_PASS, xy = 0, yy = LOW_PASS;
    for (let axis = 0; axis < 3; axis++) {
      const w = rotationColumn(q, axis);
      const [p0, p1, p2] = [0, 3, 6].map((r) => R[r] * w[0] + R[r + 1] * w[1] + R[r + 2] * w[2]);
      const px = s[axis] * fx * (p0 - hu * p2) / z, py = s[axis] * fy * (p1 - hv * p2) / z;
      xx += px * px;
      xy += px * py;
      yy += py * py;
    }
    const det = xx * yy - xy * xy;
    const power = (yy * ex * ex - 2 * xy * ex * ey + xx * ey * ey) / (2 * det);
    const alpha = (store[8 * i + 3] >>> 24) / 255 * Math.exp(-power);
    if (alpha < CUT) continue;
    const thing = store[8 * i + 6];
    weights.set(thing, (weights.get(thing) || 0) + alpha * transmittance);
    depth += z * alpha * transmittance;
    accumulated += alpha * transmittance;
    transmittance *= 1 - alpha;
  }
  let best = 0, largest = 0, labelled = 0;
  for (const [thing, weight] of weights) {
    if (!thing) continue;
    labelled += weight;
    if (weight > largest) [best, largest] = [thing, weight];
  }
  return {
    thing: labelled >= VISIBLE ? best : 0,
    depth: accumulated >= VISIBLE ? depth / accumulated : 0,
  };
}

function quaternion(code) {
  const largest = code >>> 30, q = [0, 0, 0, 0];
  let left = 1;
  for (let i = 3; i >= 0; i--) {
    if (i === largest) continue;
    const size = (code & 511) / (511 * Math.SQRT2);
    q[i] = code & 512 ? -size : size;
    left -= size * size;
    code >>>= 10;
  }
  q[largest] = Math.sqrt(Math.max(left, 0));
  return q;
}

/** Return a column of the rotation matrix of a quaternion xyzw. */
function rotationColumn([x, y, z, w], axis) {
  if (axis === 0) return [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)];
  if (axis === 1) return [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)];
  return [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)];
}
