// Drawing with WebGL 2. Gaussians are projected as in slgaussian/rasterize/project.py: by the affine
// approximation of perspective, taken at most 0.3 of half an image outside it, and with a low-pass
// filter of 0.3 px^2.

const NEAR = about.near, LOW_PASS = 0.3, MARGIN = 0.3, CUT = 1 / 1024, VISIBLE = 0.5;
// Alpha by which colour is divided at least: a splat of another program was trained on black.
const LEAST = about.on_black ? "1.0" : VISIBLE;
const WIDE = 1024; // Gaussians in a row of the texture, two texels each
// Gaussians an instance. In software rendering each instance costs some 10 us.
const BATCH = 256;

const SPLAT_VERTEX = `#version 300 es
precision highp float; precision highp int;
uniform highp usampler2D store; uniform highp usampler2D order;
uniform highp sampler2D palette;
uniform mat3 R; uniform vec3 centre; uniform vec4 lens; uniform vec2 size; uniform vec4 edges;
uniform vec2 logs; uniform int mode; uniform int count;
flat out vec4 colour; flat out vec4 mark; out vec2 local;

vec4 unpack_quaternion(uint code) {
  uint largest = code >> 30;
  vec4 q = vec4(0.0);
  float left = 1.0;
  uint rest = code;
  for (int i = 3; i >= 0; i--) {
    if (uint(i) == largest) continue;
    float size = float(rest & 511u) / (511.0 * 1.4142135623730951);
    q[i] = (rest & 512u) != 0u ? -size : size;
    left -= size * size;
    rest >>= 10;
  }
  q[largest] = sqrt(max(left, 0.0));
  return q;
}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  int place = gl_InstanceID * ${BATCH} + (gl_VertexID >> 2);
  if (place >= count) return;
  uint index = texelFetch(order, ivec2(place % ${WIDE}, place / ${WIDE}), 0).r;
  ivec2 at = ivec2(int(index % ${WIDE}u) * 2, int(index / ${WIDE}u));
  uvec4 a = texelFetch(store, at, 0), b = texelFetch(store, at + ivec2(1, 0), 0);
  vec3 p = R * (uintBitsToFloat(a.xyz) - centre);
  ivec2 entry = ivec2(int(b.z % ${WIDE}u) * 2, int(b.z / ${WIDE}u));
  vec4 tint = texelFetch(palette, entry, 0), state = texelFetch(palette, entry + ivec2(1, 0), 0);
  if (p.z <= ${NEAR}) return;
  vec4 rgba = vec4(uvec4(a.w, a.w >> 8, a.w >> 16, a.w >> 24) & 255u) / 255.0;
  float inverse = 1.0 / p.z;
  vec2 flat_ = p.xy * inverse, clamped = clamp(flat_, edges.xz, edges.yw);
  // Rows of the Jacobian of image x and y by the position in camera axes.
  vec3 ax = vec3(lens.x, 0.0, -lens.x * clamped.x) * inverse;
  vec3 ay = vec3(0.0, lens.y, -lens.y * clamped.y) * inverse;
  vec4 q = unpack_quaternion(b.x);
  float x = q.x, y = q.y, z = q.z, w = q.w;
  mat3 rotation = mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
  vec3 s = exp(logs.x + logs.y * vec3(uvec3(b.y, b.y >> 10, b.y >> 20) & 1023u));
  mat3 M = R * rotation;
  vec3 px = vec3(dot(ax, M[0]), dot(ax, M[1]), dot(ax, M[2])) * s;
  vec3 py = vec3(dot(ay, M[0]), dot(ay, M[1]), dot(ay, M[2])) * s;
  float xx = dot(px, px) + ${LOW_PASS}, xy = dot(px, py), yy = dot(py, py) + ${LOW_PASS};
  float mean = 0.5 * (xx + yy), radius = length(vec2(0.5 * (xx - yy), xy));
  float major = mean + radius, minor = max(mean - radius, 0.5 * ${LOW_PASS});
  vec2 axis = abs(xy) > 1e-6 * mean ? normalize(vec2(xy, major - xx))
    : (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
  if (rgba.a <= ${CUT}) return;
  float extent = sqrt(2.0 * log(rgba.a / ${CUT}));
  vec2 corner = vec2((gl_VertexID & 1) == 0 ? -1.0 : 1.0, (gl_VertexID & 2) == 0 ? -1.0 : 1.0);
  local = extent * corner;
  vec2 pixel = lens.xy * flat_ + lens.zw + local.x * sqrt(major) * axis
    + local.y * sqrt(minor) * vec2(-axis.y, axis.x);
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
  float grey = dot(rgba.rgb, vec3(0.299, 0.587, 0.114));
  vec3 shown = rgba.rgb;
  if (mode == 2) shown = mix(vec3(grey), tint.rgb, tint.a);
  if (mode == 4) shown = mix(vec3(0.6 * grey), vec3(0.95, 0.45, 0.1), b.w != 0u ? 0.75 : 0.0);
  colour = vec4(shown, rgba.a);
  mark = vec4(mode == 1 ? p.z : state.r, state.g, state.b, 0.0);
}`;

const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
flat in vec4 colour; flat in vec4 mark; in vec2 local;
layout(location = 0) out vec4 drawn; layout(location = 1) out vec4 marked;
void main() {
  float alpha = colour.a * exp(-0.5 * dot(local, local));
  if (alpha < ${CUT}) discard;
  drawn = vec4(colour.rgb * alpha, alpha);
  marked = vec4(mark.xyz * alpha, alpha);
}`;

const PAGE_VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

const PAGE_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D drawn; uniform sampler2D marked; uniform sampler2D maps;
uniform int mode; uniform vec2 depths; uniform float stripes; uniform float outline;
uniform float dashes;
out vec4 shown;

vec2 marks(ivec2 at) {
  ivec2 inside = clamp(at, ivec2(0), textureSize(marked, 0) - 1);
  vec4 m = texelFetch(marked, inside, 0);
  return m.yz / max(m.a, ${VISIBLE});
}

vec3 painted(float x, int row) {
  return texelFetch(maps, ivec2(int(255.0 * clamp(x, 0.0, 1.0) + 0.5), row), 0).rgb;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 c = texelFetch(drawn, at, 0), m = texelFetch(marked, at, 0);
  vec3 rgb = clamp(c.rgb / max(c.a, ${LEAST}), 0.0, 1.0);
  float grey = dot(rgb, vec3(0.299, 0.587, 0.114));
  if (mode == 1) {
    float z = m.x / max(m.a, 1e-4), inverse = 1.0 / max(z, ${NEAR / 100});
    float share = (inverse - 1.0 / depths.y) / max(1.0 / depths.x - 1.0 / depths.y, 1e-20);
    rgb = m.a < ${VISIBLE} ? vec3(0.11) : painted(share, 0);
  } else if (mode == 3) {
    rgb = clamp(0.72 * painted(m.x / max(m.a, ${VISIBLE}), 1) + 0.34 * grey, 0.0, 1.0);
  }
  if (stripes > 0.0 && c.a < ${VISIBLE} && mode != 1) {
    int row = textureSize(drawn, 0).y - 1 - at.y;
    rgb = vec3(((row + at.x) / 5) % 2 == 0 ? 96.0 / 255.0 : 160.0 / 255.0);
  }
  if (outline > 0.0) {
    int d = int(outline);
    vec2 here = step(0.5, marks(at)), edge = vec2(0.0);
    for (int k = 0; k < 4; k++) {
      ivec2 to = ivec2((k & 1) * 2 - 1, (k >> 1) * 2 - 1) * d;
      edge = max(edge, abs(here - step(0.5, marks(at + to))));
    }
    bool dash = dashes < 0.5 || (at.x + at.y) / 8 % 2 == 0;
    if (edge.x > 0.5 && dash) rgb = vec3(0.95, 0.72, 0.29);
    if (edge.y > 0.5) rgb = vec3(1.0);
  }
  shown = vec4(rgb, 1.0);
}`;

/** Renderer of the scene. The constructor throws an Error if this browser cannot draw it. */
class Drawing {
  constructor(canvas, gaussians, things, colourMaps) {
    const gl = canvas.getContext("webgl2", {
      antialias: false, alpha: false, depth: false, powerPreference: "high-performance",
    });
    if (!gl) throw new Error("This browser has no WebGL 2, so it cannot draw the scene.");
    Object.assign(this, { gl, canvas, gaussians, things });
    const fine = gl.getExtension("EXT_color_buffer_float")
      || gl.getExtension("EXT_color_buffer_half_float");
    this.kind = fine ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
    this.order = new Order(gaussians.centres, gaussians.store.length / 8);
    this.splats = this.program(SPLAT_VERTEX, SPLAT_FRAGMENT);
    this.page = this.program(PAGE_VERTEX, PAGE_FRAGMENT);
    const rows = this.rows = gaussians.store.length / (8 * WIDE);
    if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
      throw new Error("The scene has more Gaussians than this GPU can hold.");
    }
    this.store = this.texture(gl.RGBA32UI, 2 * WIDE, rows, gl.RGBA_INTEGER, gl.UNSIGNED_INT,
      gaussians.store);
    this.paletteRows = Math.ceil((things + 1) / WIDE);
    this.state = new Uint8Array(8 * WIDE * this.paletteRows);
    this.palette = this.texture(gl.RGBA8, 2 * WIDE, this.paletteRows, gl.RGBA, gl.UNSIGNED_BYTE,
      this.state);
    this.maps = this.texture(gl.RGBA8, 256, 2, gl.RGBA, gl.UNSIGNED_BYTE, colourMaps);
    this.sequence = this.texture(gl.R32UI, WIDE, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, null);
    this.quads = gl.createVertexArray();
    gl.bindVertexArray(this.quads);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    const corners = Array.from({ length: BATCH }, (_, k) => [0, 1, 2, 2, 1, 3].map((c) => 4 * k + c));
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(corners.flat()), gl.STATIC_DRAW);
    this.empty = gl.createVertexArray();
    this.sortedFor = "";
  }

  program(vertex, fragment) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new Error(`The GPU driver rejects a shader: ${gl.getShaderInfoLog(shader)}`);
      }
    }
    gl.linkProgram(program);
    const places = {};
    const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
    for (let i = 0; i < count; i++) {
      const { name } = gl.getActiveUniform(program, i);
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  texture(internal, width, height, format, kind, data) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, kind, data);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    }
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    }
    return texture;
  }

  /** Set the look of each object, in order: {paint: [r, g, b, opacity], relevancy, taken, picked}. */
  paint(looks) {
    const { gl, state } = this;
    looks.forEach(({ paint, relevancy, taken, picked }, k) => {
      state.set([...paint, 255 * relevancy, 255 * taken, 255 * picked, 255], 8 * (k + 1));
    });
    gl.bindTexture(gl.TEXTURE_2D, this.palette);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 2 * WIDE, this.paletteRows, gl.RGBA,
      gl.UNSIGNED_BYTE, state);
  }

  /** Hide Gaussians whose bit is set, least significant bit first; without bits, hide none. */
  hide(bits) {
    const { gl, gaussians: { n, store, opacity } } = this;
    for (let i = 0; i < n; i++) {
      const shown = bits[i >> 3] >> (i & 7) & 1 ? 0 : opacity[i];
      store[8 * i + 3] = store[8 * i + 3] & 0xffffff | shown << 24;
    }
    gl.bindTexture(gl.TEXTURE_2D, this.store);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 2 * WIDE, this.rows, gl.RGBA_INTEGER,
      gl.UNSIGNED_INT, store);
  }

  /** Resize the canvas and its render targets, in pixels. */
  resize(width, height) {
    const { gl, canvas } = this;
    if (this.frame && canvas.width === width && canvas.height === height) return;
    canvas.width = width;
    canvas.height = height;
    if (this.frame) {
      gl.deleteFramebuffer(this.frame);
      this.targets.forEach((target) => gl.deleteTexture(target));
    }
    this.targets = [0, 1].map(() => this.texture(this.kind[0], width, height, gl.RGBA,
      this.kind[1], null));
    this.frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    this.targets.forEach((target, k) => gl.framebufferTexture2D(gl.FRAMEBUFFER,
      gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, target, 0));
  }

  /** Draw the view of the camera `eye`. `look`: {mode, depths, stripes, outline, dashes}. */
  draw(eye, look) {
    const { gl, splats, page } = this, { width, height, fx, fy, cx, cy } = eye;
    this.resize(width, height);
    const view = [...eye.R, ...eye.centre, fx, fy, cx, cy, width, height].join();
    if (view !== this.sortedFor) {
      this.sorted = this.order.sort(eye, NEAR);
      this.sortedFor = view;
      gl.bindTexture(gl.TEXTURE_2D, this.sequence);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDE, Math.ceil(this.sorted.length / WIDE),
        gl.RED_INTEGER, gl.UNSIGNED_INT, this.order.order);
    }
    gl.viewport(0, 0, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    // Marks (depth, relevancy, selection) cost as much as colours, so draw them only where used.
    const marked = look.outline > 0 || look.mode === 1 || look.mode === 3;
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, marked ? gl.COLOR_ATTACHMENT1 : gl.NONE]);
    gl.useProgram(splats.program);
    this.bind(splats, { store: this.store, palette: this.palette, order: this.sequence });
    gl.uniformMatrix3fv(splats.places.R, true, eye.R);
    gl.uniform3fv(splats.places.centre, eye.centre);
    gl.uniform4f(splats.places.lens, fx, fy, cx, cy);
    gl.uniform2f(splats.places.size, width, height);
    const mx = MARGIN * width / (2 * fx), my = MARGIN * height / (2 * fy);
    gl.uniform4f(splats.places.edges, -cx / fx - mx, (width - cx) / fx + mx,
      -cy / fy - my, (height - cy) / fy + my);
    gl.uniform2fv(splats.places.logs, about.scale_logs);
    gl.uniform1i(splats.places.mode, look.mode);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const { length } = this.sorted;
    gl.uniform1i(splats.places.count, length);
    gl.bindVertexArray(this.quads);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0, Math.ceil(length / BATCH));
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(page.program);
    this.bind(page, { drawn: this.targets[0], marked: this.targets[1], maps: this.maps });
    gl.uniform1i(page.places.mode, look.mode);
    gl.uniform2fv(page.places.depths, look.depths);
    gl.uniform1f(page.places.stripes, look.stripes ? 1 : 0);
    gl.uniform1f(page.places.outline, look.outline);
    gl.uniform1f(page.places.dashes, look.dashes);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  bind({ places }, textures) {
    const { gl } = this;
    Object.entries(textures).forEach(([name, texture], k) => {
      gl.activeTexture(gl.TEXTURE0 + k);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(places[name], k);
    });
    gl.activeTexture(gl.TEXTURE0);
  }

  /** Wait until the GPU has finished drawing. */
  async finished() {
    const { gl } = this, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    while (fence && !gl.isContextLost()) {
      const status = gl.clientWaitSync(fence, 0, 0);
      if (status !== gl.TIMEOUT_EXPIRED) break;
      await new Promise((done) => setTimeout(done, 4));
    }
    gl.deleteSync(fence);
  }
}
