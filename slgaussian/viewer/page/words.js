// Answers to words that were asked when the file was written.

/**
 * Asks them; `packed` are gaps float32 [texts, things], in the order of about.texts, and after them a
 * byte each, whether the answer takes the thing.
 */
class Words {
  constructor(packed) {
    const count = about.texts.length * about.things.length;
    this.gaps = new Float32Array(packed, 0, count);
    this.taken = new Uint8Array(packed, 4 * count, count);
    this.rows = new Map(about.texts.map((text, row) => [text, row]));
    this.kinds = new Map(Object.entries(about.words));
    this.spellings = new Map(Object.entries(about.spellings));
    this.longest = Math.max(1, ...[...this.spellings.keys()].map((s) => s.split(" ").length));
    this.skipped = new Set(about.skipped);
  }

  /** The text among those answered that a typed one means: {text} or {why}. */
  read(typed) {
    const plain = typed.normalize("NFKC").toLowerCase().split(/\s+/).filter(Boolean).join(" ");
    if (this.rows.has(plain)) return { text: plain };
    const left = plain.match(/[\p{L}\p{N}]+(?:['’][\p{L}\p{N}]+)*/gu) || [];
    const found = [], unknown = [];
    while (left.length) {
      const [word, length] = this.first(left);
      if (word) found.push(word);
      else if (!this.skipped.has(left[0])) unknown.push(left[0]);
      left.splice(0, length);
    }
    if (unknown.length) {
      return { why: `This file does not know ${unknown.map((w) => `“${w}”`).join(", ")}: it answers `
        + "only the words that are listed below, as no encoder of words is in it." };
    }
    const once = [...new Set(found)];
    const things = once.filter((word) => this.kinds.get(word) === "thing");
    const text = [...once.filter((word) => !things.includes(word)), ...things].join(" ");
    if (this.rows.has(text)) return { text };
    if (!once.length) return { why: "Type one of the words that are listed below." };
    const asks = about.pairs
      ? "one word, a colour and a thing, or another describing word and a common thing"
      : "the listed texts";
    return { why: `This file answers ${asks}; for “${typed.trim()}” ask the field itself with `
      + "slgaussian query." };
  }

  /** The word that a list of spellings begins with, and how many of them it takes. */
  first(spelled) {
    for (let length = Math.min(this.longest, spelled.length); length > 0; length--) {
      const begin = spelled.slice(0, length - 1), last = spelled[length - 1];
      for (const form of singulars(last)) {
        const word = this.spellings.get([...begin, form].join(" "));
        if (word) return [word, length];
      }
    }
    return [null, 1];
  }

  /** The answer to what was typed: {text, kind, gaps, taken, measurements, named}, or {refused}. */
  answer(typed) {
    const { text, why } = this.read(typed);
    return why ? { refused: why } : this.baked(text);
  }

  baked(text) {
    const count = about.things.length, row = this.rows.get(text);
    const own = [row * count, (row + 1) * count];
    return {
      text, kind: this.kinds.get(text), measurements: about.measurements[row],
      named: about.named[row],
      gaps: Array.from(this.gaps.subarray(...own)),
      taken: Array.from(this.taken.subarray(...own), Boolean),
    };
  }

  ask(text) { return this.judged(this.baked(text)); }

  /**
   * What an answer says: {scores, taken, best, sure, verdict, shown, summary}; sure as of
   * confidence(), null where that is not known: of a name, or where it was not measured. The last
   * three are those of QueryResult (slgaussian/language/query.py).
   */
  judged({ kind, gaps, taken, measurements, named: seen = 0, alone = "", untold = "" }) {
    const top = Math.max(-Infinity, ...gaps);
    const named = kind === "named";
    const doubted = about.calibration && !named && top > -Infinity;
    const sure = doubted ? confidence(gaps, taken, top, measurements, seen) : null;
    const scores = gaps.map((gap) => 1 / (1 + Math.exp(-about.temperature * gap)));
    const best = gaps.indexOf(top), any = taken.includes(true);
    const verdict = untold ? "cannot tell" : any ? verdictOf(sure) : "not here";
    let summary = named || !about.uncalibrated ? verdict : `found, uncalibrated for ${about.uncalibrated}`;
    if (untold) summary = `cannot tell: ${untold}`;
    else if (!any) summary = `not here: the best object scores ${(scores[best] || 0).toFixed(3)}`;
    else if (verdict === "not here") {
      summary = `probably not here: ${sure.point.toFixed(2)} that the best object is it`;
    } else if (sure) {
      summary = `${verdict}: ${sure.mask.toFixed(2)} that the mask is right, `
        + `${sure.point.toFixed(2)} that the point is${alone}`;
    }
    const shown = verdict === "found" || verdict === "not sure";
    return { scores, taken, best, sure, verdict, shown, summary };
  }
}

/** The verdict of Confidence (slgaussian/language/confidence.py). */
function verdictOf(sure) {
  if (!sure) return "found";
  if (sure.point < about.calibration.absent) return "not here";
  return sure.mask >= 0.5 ? "found" : "not sure";
}

/**
 * How likely an answer is right, {mask, point}: slgaussian/language/confidence.py, whose constants
 * are in about.calibration.
 */
function confidence(gaps, taken, top, measurements, named) {
  const { mask, point, typical, even_out: evenOut } = about.calibration;
  const any = taken.includes(true);
  const own = [], rest = [];
  gaps.forEach((gap, k) => {
    if (gap > -Infinity) ((any ? taken[k] : gap === top) ? own : rest).push(gap);
  });
  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
  let apart = typical;
  if (rest.length > 1) {
    const middle = mean(rest);
    const spread = Math.sqrt(mean(rest.map((gap) => (gap - middle) ** 2)));
    apart = (mean(own) - middle) / (spread + evenOut);
  }
  const signs = [top * measurements, apart, Math.log(Math.max(parts(taken), 1)), named, 1];
  const chance = (curve) => 1 / (1 + Math.exp(-curve.reduce((sum, c, k) => sum + c * signs[k], 0)));
  return { mask: chance(mask), point: chance(point) };
}

/** Of how many groups of things that touch, in the first view, those `taken` are. */
function parts(taken) {
  const first = taken.map((_, thing) => thing);
  const group = (thing) => (first[thing] === thing ? thing : group(first[thing]));
  for (const [one, other] of about.touching) {
    if (taken[one] && taken[other]) first[group(one)] = group(other);
  }
  return first.filter((other, thing) => taken[thing] && other === thing).length;
}

/** A word and what it may be the plural of. */
function singulars(word) {
  const forms = [word];
  for (const [ending, singular] of [["ies", "y"], ["ves", "f"], ["ves", "fe"], ["s", ""], ["es", ""]]) {
    if (word.endsWith(ending) && word.length > ending.length + 1) {
      forms.push(word.slice(0, -ending.length) + singular);
    }
  }
  return forms;
}
