// The page: what is asked and shown, and what the mouse, the keys and fingers do.

const $ = (id) => document.getElementById(id);
const MODES = ["colour", "depth", "objects", "relevancy", "guesses"];
const HUES = [[242, 184, 75], [86, 180, 233], [0, 178, 130], [230, 110, 60], [204, 121, 167],
  [240, 228, 66], [120, 130, 255], [170, 170, 170]];

const MOST_PIXELS = 2.5e6;
const SLOW = 90, REST = 250; // milliseconds: of a frame that is slow, and without input
const later = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

/** An element with text, never markup, in it. */
function element(tag, text = "", values = {}) {
  const made = Object.assign(document.createElement(tag), values);
  made.textContent = text;
  return made;
}

const css = ([r, g, b]) => `rgb(${r}, ${g}, ${b})`;
const percent = (share) => `${Math.round(100 * share)}%`;

/** How sure an answer is, in a word or two, for a legend. */
function brief({ taken, sure, verdict, summary }) {
  if (!sure || !taken.includes(true) || verdict === "cannot tell") return summary.split(":")[0];
  return verdict === "not here" ? `probably ${verdict} ${sure.point.toFixed(2)}`
    : `${verdict} ${sure.mask.toFixed(2)}`;
}

class Page {
  constructor(gaussians, words, drawing) {
    Object.assign(this, { gaussians, words, drawing });
    this.stand = new Standpoint(about.views[0], about.views[0].distance, about.up);
    this.mode = 0;
    this.picked = 0;
    this.asked = []; // of {text, hue} and what Words.ask gives
    this.answers = []; // as Words.answer gives them
    this.question = 0;
    this.typed = "";
    this.held = new Set();
    this.moved = -Infinity;
    this.frame = 0;
    this.slow = false;
    this.fill();
    this.listen();
    this.repaint();
  }

  // --- What is drawn ------------------------------------------------------------------------

  /** The part of the window that the panel leaves free, and the size of the canvas, in pixels. */
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

  /** Pixels of the canvas a CSS pixel, at rest; while something moves, a slow page draws fewer. */
  fine() {
    return Math.min(devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / (innerWidth * innerHeight)));
  }

  scale() {
    const moving = performance.now() - this.moved < REST;
    return this.slow && moving ? 0.5 * this.fine() : this.fine();
  }

  look() {
    return {
      mode: this.mode, depths: about.depths, stripes: about.stripes,
      outline: this.picked || (this.asked.length === 1 && this.mode !== 1) ? 2 : 0,
      dashes: this.asked.length === 1 && this.asked[0].verdict === "not sure" ? 1 : 0,
    };
  }

  /** Draw soon; many wishes within a frame are one. */
  wish() {
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
      this.eye = this.stand.eye(width, height, free);
      this.drawing.draw(this.eye, this.look());
      this.overlay(scale);
      await this.drawing.finished();
      this.took = performance.now() - start;
      this.frame += 1;
      this.slow = this.took > SLOW;
      if (this.step()) this.stale = true;
      else if (this.slow && scale < this.fine()) {
        // Once nothing moves any more, the whole picture.
        while (!this.stale && performance.now() - this.moved < REST) await later(20);
        this.stale = true;
      }
    }
  }

  /** The picture at a view of the field, in that view's own size: a PNG as data URL. */
  async snapshot(view) {
    if (this.busy) await this.busy;
    const camera = about.views[view], { width, height } = camera;
    const stand = new Standpoint(camera, camera.distance, about.up);
    const eye = stand.eye(width, height, { left: 0, top: 0, width, height });
    this.drawing.draw(eye, { ...this.look(), outline: 0 });
    const url = this.drawing.canvas.toDataURL("image/png");
    await this.wish();
    return url;
  }

  /** Give things their colours and marks. */
  repaint() {
    const single = this.asked.length === 1 ? this.asked[0] : null;
    const winners = about.things.map((_, k) => {
      const scores = this.asked.map((one) => one.scores[k]);
      const most = Math.max(0.5, ...scores);
      return scores.findIndex((score) => score === most && score > 0.5);
    });
    const several = this.asked.length > 1;
    this.drawing.paint(about.things.map((thing, k) => ({
      paint: several
        ? (winners[k] < 0 ? [0, 0, 0, 0] : [...this.asked[winners[k]].hue, 190])
        : [...thing.colour, 170],
      relevancy: single ? single.scores[k] : 0,
      taken: single && single.taken[k] && single.shown ? 1 : 0,
      picked: this.picked === k + 1 ? 1 : 0,
    })));
    this.wish();
  }

  setMode(mode) {
    this.mode = mode;
    $("modes").querySelectorAll("button").forEach((button, k) =>
      button.setAttribute("aria-pressed", String(k === mode)));
    this.wish();
  }

  /** Frusta of the cameras of the photographs. */
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
      const seen = corners.map((corner) => projected(this.eye, corner));
      if (apex[2] < 0.02 * view.distance || seen.some((p) => p[2] < NEAR)) return;
      pen.strokeStyle = pen.fillStyle = "#f2b84bcc";
      pen.beginPath();
      seen.forEach((p, i) => {
        const next = seen[(i + 1) % 4];
        pen.moveTo(apex[0], apex[1]);
        pen.lineTo(p[0], p[1]);
        pen.lineTo(next[0], next[1]);
      });
      pen.stroke();
      pen.fillText(String(k), apex[0] + 6 * scale, apex[1] - 6 * scale);
    });
  }

  // --- What is asked ------------------------------------------------------------------------

  /** Ask what stands in the search box; a server only what it did not answer last. */
  search() {
    const typed = $("words").value, refused = this.answers.some((one) => one.refused);
    if (!this.live || typed !== this.typed || refused) this.ask(typed);
  }

  /** Ask texts with commas between them, and show the answers in `mode`, or in that of answers. */
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
    const answer = $("answer"), said = [];
    $("legend").replaceChildren();
    this.asked = [];
    answers.forEach((one, k) => {
      if (one.refused) said.push(one.refused);
      else this.asked.push({ ...one, ...this.words.judged(one), hue: HUES[k % HUES.length] });
    });
    if (!this.asked.length && this.mode === 3) this.setMode(0);
    if (this.asked.length === 1) {
      said.push(this.said(this.asked[0]));
      this.setMode(mode ?? 3);
    } else if (this.asked.length) {
      this.asked.forEach((one) => {
        const item = element("li");
        const swatch = element("span", "", { className: "swatch" });
        swatch.style.background = css(one.hue);
        item.append(swatch, element("span", one.text, { className: "grow" }),
          element("span", brief(one), { className: "number" }));
        $("legend").append(item);
      });
      said.push("Each object has the colour of the word that fits it best, above 0.5.");
      this.setMode(mode ?? 2);
    }
    answer.textContent = said.join(" ");
    this.repaint();
  }

  /** What one text found, in a sentence. */
  said({ text, kind, unknown, scores, taken, best, verdict, shown, summary }) {
    if (best < 0) return "There are no objects in this file.";
    const kinds = { taught: " (taught by example)", named: " (a name that was given)" };
    const asked = `“${text}”${kinds[kind] || ""}`;
    const rest = unknown?.length ? ` Not known and left out: ${unknown.join(", ")}.` : "";
    const found = taken.flatMap((own, k) => (own ? [k] : [])).sort((a, b) => scores[b] - scores[a]);
    if (verdict === "cannot tell") return `${asked}: ${summary}.`;
    if (!found.length) return `${asked}: ${summary} (0.5 is as good as any phrase).${rest}`;
    const objects = `${found.length === 1 ? "object" : "objects"} `
      + found.map((k) => this.called(k + 1)).join(", ");
    const score = `${scores[best].toFixed(3)} (0.5 is as good as any phrase)`;
    const like = shown ? ", " : "; most like it: ";
    return `${asked}: ${summary}; score ${score}${like}${objects}.${rest}`;
  }

  called(thing) {
    const { id, name, words } = about.things[thing - 1];
    return `${id} ${name || (words.length && words[0][1] > 0.5 ? words[0][0] : "")}`.trim();
  }

  /** Pick a thing by its place among about.things from 1; 0 for none. */
  choose(thing) {
    this.picked = thing;
    const card = $("card");
    card.replaceChildren();
    card.hidden = !thing;
    if (thing) {
      const known = about.things[thing - 1];
      const words = known.words.map(([word, score]) => `${word} ${score.toFixed(2)}`).join(", ");
      card.append(
        element("h3", `Object ${known.id}${known.name ? `: ${known.name}` : ""}`),
        element("p", words ? `Looks most like: ${words}` : "No word of this file was asked of it."),
        element("p", `Confidence ${percent(known.confidence)}: how clearly its pixels are its own.`,
          { className: "small" }),
        ...(known.size.length ? [element("p", `Size ${known.size.join(" × ")} `
          + (known.metres ? "scene units" : "scene units, which are no metres"),
        { className: "small" })] : []),
        element("p", `${known.gaussians.toLocaleString("en")} Gaussians`
          + (known.guessed > 0.005 ? `, ${percent(known.guessed)} of them of a guessed depth` : "")
          + "; in the photographs "
          + (known.views.map((view) => about.views[view].name).join(", ") || "of none"),
        { className: "small" }),
      );
    }
    $("objects").querySelectorAll("button").forEach((button) =>
      button.setAttribute("aria-pressed", String(Number(button.dataset.thing) === thing)));
    this.live?.chosen(thing);
    this.repaint();
  }

  /** Say what is under (x, y) of the window, and turn about it from then on. */
  clicked(x, y) {
    const scale = this.eye.width / innerWidth;
    const { thing, depth } = pick(this.gaussians, this.drawing.sorted, this.eye, x * scale, y * scale);
    if (depth) this.stand.distance = depth;
    this.choose(thing);
    if (!thing) {
      $("card").hidden = false;
      $("card").append(element("p", depth ? "Here is no object that was told apart."
        : "No photograph shows what is here: it is open."));
    }
    return thing;
  }

  goTo(view) {
    this.stand.goTo(about.views[view], about.views[view].distance);
    this.wish();
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
    this.offer(Object.keys(about.words));
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
    $("listed").textContent = about.said_words;
    $("honest").textContent = about.honest;
    if (innerWidth <= 640) $("help").open = false;
  }

  /** Words to choose from where one types. */
  offer(words) {
    $("known").replaceChildren(...[...new Set(words)].sort().map((word) =>
      element("option", "", { value: word })));
  }

  /** The objects, each to choose. */
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
      button.append(swatch, element("span", this.called(k + 1), { className: "grow" }),
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
    addEventListener("resize", () => this.wish());
    $("fold").addEventListener("toggle", () => this.wish());
    $("cameras").addEventListener("change", () => this.wish());
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
      else this.stand.turn(-3 * dx, -3 * dy);
      if (pointers.size > 1 && now.apart && last.apart) this.stand.approach(last.apart / now.apart);
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
      this.stand.approach(Math.exp(Math.max(-200, Math.min(200, event.deltaY * lines)) / 700));
      this.touched();
    }, { passive: false });
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("keyup", (event) => this.held.delete(event.key.toLowerCase()));
    addEventListener("blur", () => this.held.clear());
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      $("waiting").textContent = "The graphics processor gave up; load the page again.";
    });
  }

  slide(dx, dy) {
    const { lens } = this.stand, tall = lens.height / lens.fy;
    this.stand.move(-dx * tall, -dy * tall, 0);
  }

  touched() {
    this.moved = performance.now();
    this.wish();
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
      // A tap moves a little; what is held goes on (step).
      MOVES[event.key.toLowerCase()](this.stand, 0.05);
      this.held.add(event.key.toLowerCase());
      this.stepped = performance.now();
      this.touched();
    }
  }

  /** Go on as the keys that are held say; whether any is. */
  step() {
    if (!this.held.size) return false;
    const now = performance.now(), seconds = Math.min(0.1, (now - this.stepped) / 1000);
    this.stepped = now;
    for (const key of this.held) MOVES[key](this.stand, seconds);
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
  w: (stand, s) => stand.move(0, 0, 0.6 * s), s: (stand, s) => stand.move(0, 0, -0.6 * s),
  a: (stand, s) => stand.move(-0.6 * s, 0, 0), d: (stand, s) => stand.move(0.6 * s, 0, 0),
  q: (stand, s) => stand.move(0, 0.6 * s, 0), e: (stand, s) => stand.move(0, -0.6 * s, 0),
  arrowleft: (stand, s) => stand.turn(s, 0, true), arrowright: (stand, s) => stand.turn(-s, 0, true),
  arrowup: (stand, s) => stand.turn(0, s, true), arrowdown: (stand, s) => stand.turn(0, -s, true),
};

/** The middle of the fingers, and how far they are apart. */
function gesture(pointers) {
  const all = [...pointers.values()];
  const x = all.reduce((sum, p) => sum + p[0], 0) / all.length;
  const y = all.reduce((sum, p) => sum + p[1], 0) / all.length;
  const apart = all.length > 1 ? Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1]) : 0;
  return { x, y, apart };
}

async function open() {
  if (typeof DecompressionStream === "undefined") {
    throw new Error("This browser is too old to unpack the scene; take one of 2023 or later.");
  }
  const gaussians = gaussiansOf(arraysOf(await unpacked("gaussians"), about.layout));
  const maps = Uint8Array.from(atob(about.maps), (c) => c.charCodeAt(0));
  const answers = await unpacked("answers");
  performance.mark("unpacked");
  const drawing = new Drawing($("picture"), gaussians, about.things.length, maps);
  performance.mark("ready");
  $("panel").hidden = false;
  const page = new Page(gaussians, new Words(answers), drawing);
  if ("live" in document.documentElement.dataset) {
    page.live = new Live(page);
    page.live.show(await post("state"));
  }
  await page.wish();
  performance.mark("shown");
  $("waiting").textContent = "";
  // For scripts that drive the page: everything it does, it does through this.
  globalThis.slgaussian = page;
}

open().catch((error) => {
  $("panel").hidden = true;
  $("waiting").textContent = error.message;
});
