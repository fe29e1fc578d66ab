// The camera of the page. OpenCV axes: x right, y down, z forward.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0]];
const unit = (a) => {
  const length = Math.hypot(...a) || 1;
  return a.map((x) => x / length);
};
/** Rotate `v` by `angle` about the unit vector `axis` (Rodrigues' formula). */
const rotated = (v, axis, angle) => {
  const c = Math.cos(angle), s = Math.sin(angle);
  const across = cross(axis, v), along = dot(axis, v) * (1 - c);
  return v.map((x, k) => x * c + across[k] * s + axis[k] * along);
};

/** A movable camera: axes, centre, intrinsics (`lens`), and distance of the point it orbits. */
class Viewpoint {
  constructor(camera, distance, up) {
    this.up = up;
    this.goTo(camera, distance);
  }

  goTo(camera, distance) {
    const m = camera.c2w;
    this.right = [m[0][0], m[1][0], m[2][0]];
    this.down = [m[0][1], m[1][1], m[2][1]];
    this.forward = [m[0][2], m[1][2], m[2][2]];
    this.centre = [m[0][3], m[1][3], m[2][3]];
    this.lens = camera;
    this.distance = distance;
  }

  get target() { return plus(this.centre, this.forward, this.distance); }

  /** Rotate about `target`, or about the camera (`onTheSpot`), by angles in radians. */
  turn(yaw, pitch, onTheSpot = false) {
    const target = this.target;
    const elevation = Math.asin(Math.max(-1, Math.min(1, dot(this.forward, this.up))));
    const limit = 1.45;
    const angle = Math.max(-limit - elevation, Math.min(limit - elevation, pitch));
    this.right = unit(rotated(this.right, this.up, yaw));
    this.forward = unit(rotated(rotated(this.forward, this.up, yaw), this.right, angle));
    this.down = unit(cross(this.forward, this.right));
    if (!onTheSpot) this.centre = plus(target, this.forward, -this.distance);
  }

  /** Move by fractions of the distance to `target`. */
  move(right, down, forward) {
    const unitLength = this.distance;
    this.centre = plus(plus(plus(this.centre, this.right, right * unitLength), this.down,
      down * unitLength),
      this.forward, forward * unitLength);
  }

  /** Multiply the distance to `target` by a factor. */
  approach(factor) {
    const target = this.target;
    this.distance = Math.max(NEAR / 10, this.distance * factor);
    this.centre = plus(target, this.forward, -this.distance);
  }

  /** Return the camera for drawing, whose image fits into the rectangle `free` of a canvas. */
  eye(width, height, free) {
    const { lens } = this;
    const scale = Math.min(free.width / lens.width, free.height / lens.height);
    return {
      R: new Float32Array([...this.right, ...this.down, ...this.forward]),
      centre: this.centre, width, height,
      fx: lens.fx * scale, fy: lens.fy * scale,
      cx: free.left + free.width / 2 + (lens.cx - lens.width / 2) * scale,
      cy: free.top + free.height / 2 + (lens.cy - lens.height / 2) * scale,
    };
  }
}

/** Project a point: [x, y] in pixels, and depth z. */
function projected(eye, point) {
  const p = plus(point, eye.centre, -1), { R } = eye;
  const [x, y, z] = [0, 3, 6].map((k) => R[k] * p[0] + R[k + 1] * p[1] + R[k + 2] * p[2]);
  return [eye.fx * x / z + eye.cx, eye.fy * y / z + eye.cy, z];
}
