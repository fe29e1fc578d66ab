// Content of the page: `about` (JSON), and arrays in gzip and base64.

const about = JSON.parse(document.getElementById("about").textContent);

/** Unpack the bytes of an element of the page, and remove the element. */
async function unpack(id) {
  const element = document.getElementById(id);
  const coded = atob(element.textContent.trim());
  element.remove();
  const bytes = new Uint8Array(coded.length);
  for (let i = 0; i < coded.length; i++) bytes[i] = coded.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

const ARRAY_TYPES = { u1: Uint8Array, u4: Uint32Array, f4: Float32Array };

/** Return the arrays of `buffer` by name, from `layout` {name: [type, offset, length]}. */
function arraysOf(buffer, layout) {
  return Object.fromEntries(Object.entries(layout).map(([name, [type, offset, length]]) =>
    [name, new ARRAY_TYPES[type](buffer, offset, length)]));
}

/**
 * Decode Gaussians: centres Float32 [3 N], and the texture of the GPU: 8 Uint32 a Gaussian, padded
 * to whole rows of WIDE Gaussians.
 */
function gaussiansOf(arrays) {
  const n = arrays.opacity.length, block = about.block;
  const centres = new Float32Array(3 * n);
  const store = new Uint32Array(8 * WIDE * Math.max(1, Math.ceil(n / WIDE)));
  const floats = new Float32Array(store.buffer);
  const { low, step, high_byte: high, low_byte: lower, rotation, scales } = arrays;
  const { red, green, blue, opacity, thing } = arrays;
  for (let i = 0; i < n; i++) {
    const b = 3 * Math.floor(i / block);
    for (let k = 0; k < 3; k++) {
      const at = k * n + i;
      centres[3 * i + k] = floats[8 * i + k] =
        low[b + k] + step[b + k] * (256 * high[at] + lower[at]);
    }
    store[8 * i + 3] = red[i] | green[i] << 8 | blue[i] << 16 | opacity[i] << 24;
    store[8 * i + 4] = rotation[i];
    store[8 * i + 5] = scales[i];
    store[8 * i + 6] = thing[i] | thing[n + i] << 8;
    store[8 * i + 7] = arrays.guessed[i];
  }
  return { n, centres, store, opacity };
}
