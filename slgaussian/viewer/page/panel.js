// The page: queries and their display, the panel, and input by mouse, keys and touch.

const $ = (id) => document.getElementById(id);
const MODES = ["colour", "depth", "objects", "relevancy", "guesses"];
const HUES = [[242, 184, 75], [86, 180, 233], [0, 178, 130], [230, 110, 60], [204, 121, 167],
  [240, 228, 66], [120, 130, 255], [170, 170, 170]];

const MOST_PIXELS = 2.5e6;
const SLOW = 90, REST = 250; // milliseconds: a slow frame; pause of input that ends a movement
const later = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

/** Create an element with a text, which is never markup. */
function element(tag, text = "", values = {}) {
  const created = Object.assign(document.createElement(tag), values);
  created.textContent = text;
  return created;
}

const BASELINE = "0.5 means no better than a neutral phrase";
const css = ([r, g, b]) => `rgb(${r}, ${g}, ${b})`;
const percent = (share) => `${Math.round(100 * share)}%`;

/** Return the verdict and confidence of an answer, for the legend. */
function brief({ taken, confidence, verdict, summary }) {
  if (!confidence || !taken.length || verdict === "cannot tell") return summary.split(":")[0];
  const [mask, point] = confidence;
  return verdict === "not here" ? `probably ${verdict} ${point.toFixed(2)}` : `${verdict} ${mask.toFixed(2)}`;
}

class Page {
  constructor(gaussians, words, drawing) {
    Object.assign(this, { gaussians, words, drawing });
    this.viewpoint = new Viewpoint(about.views[0], about.views[0].distance, about.up);
    this.mode = 0;
    this.picked = 0;
    this.asked = []; // answers to the texts that are not refused, each with its hue
    this.answers = []; // results of Words.answer
    this.question = 0;
    this.typed = "";
    this.pressed = new Set();
    this.moved = -Infinity;
    this.frame = 0;
    this.slow = false;
    this.fill();
    this.listen();
    this.repaint();
  }

  // --- Drawing ------------------------------------------------------------------------------

  /** Return the size of the canvas, and its rectangle that the panel leaves free, in pixels. */
  place(scale) {
    const width = innerWidth, height = innerHeight;
    const box = $("panel").getBoundingClientRect();
    const free = { left: 0, top: 0, width, height };
    if (!$("panel").hidden && $("fold").open) {
      if (box.width < 0.6 * width) Object.assign(free, { left: box.right, width: width - box.right });
      else free.height = Math.max(0.3 * height, box.top);
    }
    for (const name of Object.keys(free)) free[name] *= scale;
    return { width: Math.round(width * scale), height: Math.round(height * scale), free };
  }

  /** Return canvas pixels per CSS pixel at rest; during a movement, a slow page draws fewer. */
  fullScale() {
    return Math.min(devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / (innerWidth * innerHeight)));
  }

  scale() {
    const moving = performance.now() - this.moved < REST;
    return this.slow && moving ? 0.5 * this.fullScale() : this.fullScale();
  }

  look() {
    return {
      mode: this.mode, depths: about.depths, stripes: about.stripes,
      outline: this.picked || (this.asked.length === 1 && this.mode !== 1) ? 2 : 0,
      dashes: this.asked.length === 1 && this.asked[0].verdict === "not sure" ? 1 : 0,
    };
  }

  /** Request a frame; several requests before it is drawn are one. */
  requestFrame() {
    this.stale = true;
    if (!this.busy) this.busy = this.frames().finally(() => { this.busy = null; });
    return this.busy;
  }

  async frames() {
    while (this.stale) {
      await new Promise((done) => requestAnimationFrame(done));
      this.stale = false;
      const start = performance.now(), scale = this.scale();
      const { width, height, free } = this.place(scale);
      this.eye = this.viewpoint.eye(width, height, free);
      this.drawing.draw(this.eye, this.look());
      this.overlay(scale);
      await this.drawing.finished();
      this.frameMilliseconds = performance.now() - start;
      this.frame += 1;
      this.slow = this.frameMilliseconds > SLOW;
      if (this.step()) this.stale = true;
      else if (this.slow && scale < this.fullScale()) {
        // After the movement, draw at full resolution.
        while (!this.stale && performance.now() - this.moved < REST) await later(20);
        this.stale = true;
      }
    }
  }

  /** Render a view of the field at its size; return a PNG as data URL. */
  async snapshot(view) {
    if (this.busy) await this.busy;
    const camera = about.views[view], { width, height } = camera;
    const viewpoint = new Viewpoint(camera, camera.distance, about.up);
    const eye = viewpoint.eye(width, height, { left: 0, top: 0, width, height });
    this.drawing.draw(eye, { ...this.look(), outline: 0 });
    const url = this.drawing.canvas.toDataURL("image/png");
    await this.requestFrame();
    return url;
  }

  /** Update the colours and marks of objects. */
  repaint() {
    const single = this.asked.length === 1 ? this.asked[0] : null;
    const winners = about.things.map((_, k) => {
      const scores = this.asked.map((answer) => answer.scores[k]);
      const highest = Math.max(0.5, ...scores);
      return scores.findIndex((score) => score === highest && score > 0.5);
    });
    const several = this.asked.length > 1;
    this.drawing.paint(about.things.map((thing, k) => ({
      paint: several
        ? (winners[k] < 0 ? [0, 0, 0, 0] : [...this.asked[winners[k]].hue, 190])
        : [...thing.colour, 170],
      relevancy: single ? single.scores[k] : 0,
      taken: single && single.taken.includes(k) && single.shown ? 1 : 0,
      picked: this.picked === k + 1 ? 1 : 0,
    })));
    this.requestFrame();
  }

  setMode(mode) {
    this.mode = mode;
    $("modes").querySelectorAll("button").forEach((button, k) =>
      button.setAttribute("aria-pressed", String(k === mode)));
    this.requestFrame();
  }

  /** Draw the frusta of the photographs' cameras. */
  overlay(scale) {
    const canvas = $("lines"), { width, height } = this.eye;
    canvas.width = width;
    canvas.height = height;
    if (!$("cameras").checked) return;
    const pen = canvas.getContext("2d");
    pen.lineWidth = 1.5 * scale;
    pen.font = `${12 * scale}px system-ui, sans-serif`;
    about.views.forEach((view, k) => {
      const size = 0.12 * view.distance, m = view.c2w;
      const at = (x, y, z) => [0, 1, 2].map((r) => m[r][0] * x + m[r][1] * y + m[r][2] * z + m[r][3]);
      const corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(([i, j]) => at(
        size * (i * view.width - view.cx) / view.fx, size * (j * view.height - view.cy) / view.fy,
        size));
      const apex = projected(this.eye, at(0, 0, 0));
      const outer = corners.map((corner) => projected(this.eye, corner));
      if (apex[2] < 0.02 * view.distance || outer.some((p) => p[2] < NEAR)) return;
      pen.strokeStyle = pen.fillStyle = "#f2b84bcc";
      pen.beginPath();
      outer.forEach((p, i) => {
        const next = outer[(i + 1) % 4];
        pen.moveTo(apex[0], apex[1]);
        pen.lineTo(p[0], p[1]);
        pen.lineTo(next[0], next[1]);
      });
      pen.stroke();
      pen.fillText(String(k), apex[0] + 6 * scale, apex[1] - 6 * scale);
    });
  }

  // --- Queries ------------------------------------------------------------------------------

  /** Ask the text of the search box; a server is not asked again for the text it answered last. */
  search() {
    const typed = $("words").value, refused = this.answers.some((answer) => answer.refused);
    if (!this.live || typed !== this.typed || refused) this.ask(typed);
  }

  /** Ask texts, separated by commas, and show the answers in `mode` (default: that of answers). */
  ask(typed, mode) {
    this.typed = typed;
    const parts = typed.split(",").map((part) => part.trim()).filter(Boolean);
    const number = ++this.question;
    if (!this.live || !parts.length) {
      this.show(parts.map((part) => this.words.answer(part)), mode);
      return;
    }
    $("answer").textContent = "";
    this.live.query(parts).then((answers) => {
      if (number === this.question) this.show(answers, mode);
    });
  }

  show(answers, mode) {
    this.answers = answers;
    const sentences = [];
    $("legend").replaceChildren();
    this.asked = [];
    answers.forEach((answer, k) => {
      if (answer.refused) sentences.push(answer.refused);
      else this.asked.push({ ...answer, hue: HUES[k % HUES.length] });
    });
    if (!this.asked.length && this.mode === 3) this.setMode(0);
    if (this.asked.length === 1) {
      sentences.push(this.describe(this.asked[0]));
      this.setMode(mode ?? 3);
    } else if (this.asked.length) {
      this.asked.forEach((answer) => {
        const item = element("li");
        const swatch = element("span", "", { className: "swatch" });
        swatch.style.background = css(answer.hue);
        item.append(swatch, element("span", answer.text, { className: "grow" }),
          element("span", brief(answer), { className: "number" }));
        $("legend").append(item);
      });
      sentences.push("Each object has the colour of its best text, if that scores above 0.5.");
      this.setMode(mode ?? 2);
    }
    $("answer").textContent = sentences.join(" ");
    this.repaint();
  }

  /** Describe the answer to one text in a sentence. */
  describe({ text, kind, unknown, score, taken, verdict, shown, summary }) {
    if (!about.things.length) return "There are no objects in this file.";
    const kinds = { taught: " (taught by example)", named: " (the name of an object)" };
    const asked = `“${text}”${kinds[kind] || ""}`;
    const ignored = unknown.length ? ` Ignored unknown words: ${unknown.join(", ")}.` : "";
    if (verdict === "cannot tell") return `${asked}: ${summary}.`;
    if (!taken.length) return `${asked}: ${summary} (${BASELINE}).${ignored}`;
    const objects = `${taken.length === 1 ? "object" : "objects"} `
      + taken.map((k) => this.label(k + 1)).join(", ");
    const link = shown ? ", " : "; most similar: ";
    return `${asked}: ${summary}; score ${score.toFixed(3)} (${BASELINE})${link}${objects}.${ignored}`;
  }

  label(thing) {
    const { id, name, words } = about.things[thing - 1];
    return `${id} ${name || (words.length && words[0][1] > 0.5 ? words[0][0] : "")}`.trim();
  }

  /** Select an object by its number in about.things, from 1; 0 for none. */
  choose(thing) {
    this.picked = thing;
    const card = $("card");
    card.replaceChildren();
    card.hidden = !thing;
    if (thing) {
      const selected = about.things[thing - 1];
      const words = selected.words.map(([word, score]) => `${word} ${score.toFixed(2)}`).join(", ");
      card.append(
        element("h3", `Object ${selected.id}${selected.name ? `: ${selected.name}` : ""}`),
        element("p", words ? `Best words: ${words}` : "No word was compared with it."),
        element("p", `Confidence ${percent(selected.confidence)}: how clearly pixels belong to it.`,
          { className: "small" }),
        ...(selected.size.length ? [element("p", `Size ${selected.size.join(" × ")} `
          + (selected.metres ? "scene units" : "scene units, not metres"),
        { className: "small" })] : []),
        element("p", `${selected.gaussians.toLocaleString("en")} Gaussians`
          + (selected.guessed > 0.005 ? `, ${percent(selected.guessed)} with a guessed depth` : "")
          + "; visible in "
          + (selected.views.map((view) => about.views[view].name).join(", ") || "no photograph"),
        { className: "small" }),
      );
    }
    $("objects").querySelectorAll("button").forEach((button) =>
      button.setAttribute("aria-pressed", String(Number(button.dataset.thing) === thing)));
    this.live?.chosen(thing);
    this.repaint();
  }

  /** Select the object at (x, y) of the window, and orbit that point from then on. */
  clicked(x, y) {
    const scale = this.eye.width / innerWidth;
    const { thing, depth } = pick(this.gaussians, this.drawing.sorted, this.eye, x * scale, y * scale);
    if (depth) this.viewpoint.distance = depth;
    this.choose(thing);
    if (!thing) {
      $("card").hidden = false;
      $("card").append(element("p", depth ? "This point belongs to no object."
        : "No photograph shows this area."));
    }
    return thing;
  }

  goTo(view) {
    this.viewpoint.goTo(about.views[view], about.views[view].distance);
    this.requestFrame();
  }

  // --- The panel ----------------------------------------------------------------------------

  fill() {
    MODES.forEach((name, k) => {
      if (k === 4 && !about.guesses) return;
      if ((k === 2 || k === 3) && !about.things.length) return;
      const button = element("button", name, { type: "button" });
      button.setAttribute("aria-pressed", String(k === 0));
      button.addEventListener("click", () => this.setMode(k));
      $("modes").append(button);
    });
    this.suggest(Object.keys(about.words));
    about.views.forEach((view, k) => {
      const button = element("button", "", { type: "button", title: `${k}: ${view.caption}` });
      if (view.picture) button.append(element("img", "", { src: view.picture, alt: view.caption }));
      else button.textContent = view.name;
      button.addEventListener("click", () => this.goTo(k));
      $("views").append(button);
    });
    this.list();
    for (const id of ["search", "things", "vocabulary"]) {
      $(id).hidden = !about.things.length || !Object.keys(about.words).length;
    }
    $("words-note").textContent = about.words_note;
    $("scene-note").textContent = about.scene_note;
    if (innerWidth <= 640) $("help").open = false;
  }

  /** Set the suggestions of the search box. */
  suggest(words) {
    $("suggestions").replaceChildren(...[...new Set(words)].sort().map((word) =>
      element("option", "", { value: word })));
  }

  /** Fill the list of objects. */
  list() {
    $("objects").replaceChildren(...about.things.map((thing, k) => {
      const button = element("button", "", {
        type: "button", className: thing.removed ? "gone" : "",
      });
      button.dataset.thing = k + 1;
      button.setAttribute("aria-pressed", "false");
      const swatch = element("span", "", { className: "swatch" });
      swatch.style.background = css(thing.colour);
      const score = thing.words.length ? thing.words[0][1].toFixed(2) : "";
      button.append(swatch, element("span", this.label(k + 1), { className: "grow" }),
        element("span", score, { className: "number" }));
      button.addEventListener("click", () => this.choose(k + 1));
      const item = element("li");
      item.append(button);
      return item;
    }));
  }

  listen() {
    const canvas = $("picture"), pointers = new Map();
    let start = null, last = null;
    addEventListener("resize", () => this.requestFrame());
    $("fold").addEventListener("toggle", () => this.requestFrame());
    $("cameras").addEventListener("change", () => this.requestFrame());
    $("search").addEventListener("submit", (event) => {
      event.preventDefault();
      this.search();
    });
    $("clear").addEventListener("click", () => this.clear());
    $("save").addEventListener("click", () => this.save());
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      if (pointers.size === 1) start = [event.clientX, event.clientY, performance.now()];
      else start = null;
      last = gesture(pointers);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!pointers.has(event.pointerId)) return;
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      const now = gesture(pointers);
      const dx = (now.x - last.x) / innerHeight, dy = (now.y - last.y) / innerHeight;
      const sliding = pointers.size > 1 || event.buttons & 2 || event.shiftKey;
      if (sliding) this.slide(dx, dy);
      else this.viewpoint.turn(-3 * dx, -3 * dy);
      if (pointers.size > 1 && now.spread && last.spread) {
        this.viewpoint.approach(last.spread / now.spread);
      }
      last = now;
      this.touched();
    });
    const release = (event) => {
      if (!pointers.delete(event.pointerId)) return;
      if (start && event.type === "pointerup" && event.button === 0
        && Math.hypot(event.clientX - start[0], event.clientY - start[1]) < 4) {
        this.clicked(event.clientX, event.clientY);
      }
      start = null;
      if (pointers.size) last = gesture(pointers);
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      this.viewpoint.approach(Math.exp(Math.max(-200, Math.min(200, event.deltaY * lines)) / 700));
      this.touched();
    }, { passive: false });
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("keyup", (event) => this.pressed.delete(event.key.toLowerCase()));
    addEventListener("blur", () => this.pressed.clear());
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      $("waiting").textContent = "The browser lost its connection to the GPU; reload the page.";
    });
  }

  slide(dx, dy) {
    const { lens } = this.viewpoint, tall = lens.height / lens.fy;
    this.viewpoint.move(-dx * tall, -dy * tall, 0);
  }

  touched() {
    this.moved = performance.now();
    this.requestFrame();
  }

  key(event) {
    const typing = event.target.tagName === "INPUT" && event.target.type !== "checkbox";
    if (event.key === "Escape") {
      this.clear();
      $("picture").focus();
    }
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "/") {
      event.preventDefault();
      $("fold").open = true;
      $("words").focus();
    } else if (/^[0-9]$/.test(event.key) && about.views[Number(event.key)]) {
      this.goTo(Number(event.key));
    } else if (MOVES[event.key.toLowerCase()]) {
      if (event.target.tagName !== "CANVAS" && event.target !== document.body) return;
      event.preventDefault();
      if (event.repeat) return;
      // A tap moves a little; `step` continues while a key is pressed.
      MOVES[event.key.toLowerCase()](this.viewpoint, 0.05);
      this.pressed.add(event.key.toLowerCase());
      this.stepped = performance.now();
      this.touched();
    }
  }

  /** Continue the movement of the pressed keys; return whether there are any. */
  step() {
    if (!this.pressed.size) return false;
    const now = performance.now(), seconds = Math.min(0.1, (now - this.stepped) / 1000);
    this.stepped = now;
    for (const key of this.pressed) MOVES[key](this.viewpoint, seconds);
    this.moved = now;
    return true;
  }

  clear() {
    $("words").value = "";
    this.picked = 0;
    $("card").hidden = true;
    this.ask("");
    this.choose(0);
    this.setMode(0);
  }

  async save() {
    if (this.busy) await this.busy;
    this.drawing.draw(this.eye, this.look());
    const link = element("a", "", {
      href: this.drawing.canvas.toDataURL("image/png"), download: "scene.png",
    });
    link.click();
  }
}

const MOVES = {
  w: (camera, s) => camera.move(0, 0, 0.6 * s), s: (camera, s) => camera.move(0, 0, -0.6 * s),
  a: (camera, s) => camera.move(-0.6 * s, 0, 0), d: (camera, s) => camera.move(0.6 * s, 0, 0),
  q: (camera, s) => camera.move(0, 0.6 * s, 0), e: (camera, s) => camera.move(0, -0.6 * s, 0),
  arrowleft: (camera, s) => camera.turn(s, 0, true),
  arrowright: (camera, s) => camera.turn(-s, 0, true),
  arrowup: (camera, s) => camera.turn(0, s, true),
  arrowdown: (camera, s) => camera.turn(0, -s, true),
};

/** Return the centre of the pointers, and the distance between the first two (`spread`). */
function gesture(pointers) {
  const all = [...pointers.values()];
  const x = all.reduce((sum, p) => sum + p[0], 0) / all.length;
  const y = all.reduce((sum, p) => sum + p[1], 0) / all.length;
  const spread = all.length > 1 ? Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1]) : 0;
  return { x, y, spread };
}

async function open() {
  if (typeof DecompressionStream === "undefined") {
    throw new Error("This browser is too old to unpack the scene; use a version from 2023 or later.");
  }
  const gaussians = gaussiansOf(arraysOf(await unpack("gaussians"), about.layout));
  const maps = Uint8Array.from(atob(about.maps), (c) => c.charCodeAt(0));
  const answers = JSON.parse(new TextDecoder().decode(await unpack("answers")));
  performance.mark("unpacked");
  const drawing = new Drawing($("picture"), gaussians, about.things.length, maps);
  performance.mark("ready");
  $("panel").hidden = false;
  const page = new Page(gaussians, new Words(answers), drawing);
  if ("live" in document.documentElement.dataset) {
    page.live = new Live(page);
    page.live.show(await post("state"));
  }
  await page.requestFrame();
  performance.mark("shown");
  $("waiting").textContent = "";
  // For scripts: all functions of the page are methods of this object.
  globalThis.slgaussian = page;
}

open().catch((error) => {
  $("panel").hidden = true;
  $("waiting").textContent = error.message;
});
