// Answers to texts, computed when the file was written.

/**
 * The stored answers. `packed`: relevancy gaps float32 [texts, things], in the order of about.texts;
 * then one byte for each gap, 1 if the answer selects the object.
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

  /** Find the stored text that a typed text means: {text}, or {reason} if there is none. */
  read(typed) {
    const plain = typed.normalize("NFKC").toLowerCase().split(/\s+/).filter(Boolean).join(" ");
    if (this.rows.has(plain)) return { text: plain };
    const remaining = plain.match(/[\p{L}\p{N}]+(?:['’][\p{L}\p{N}]+)*/gu) || [];
    const known = [], unknown = [];
    while (remaining.length) {
      const [word, length] = this.first(remaining);
      if (word) known.push(word);
      else if (!this.skipped.has(remaining[0])) unknown.push(remaining[0]);
      remaining.splice(0, length);
    }
    if (unknown.length) {
      return { reason: `This file does not know ${unknown.map((w) => `“${w}”`).join(", ")}: it has no `
        + "text encoder and answers only the words listed below." };
    }
    const unique = [...new Set(known)];
    const things = unique.filter((word) => this.kinds.get(word) === "thing");
    const text = [...unique.filter((word) => !things.includes(word)), ...things].join(" ");
    if (this.rows.has(text)) return { text };
    if (!unique.length) return { reason: "Type one of the words listed below." };
    const accepted = about.pairs
      ? "one word, a colour and a noun, or another describing word and a common noun"
      : "the listed texts";
    return { reason: `This file answers ${accepted}; for “${typed.trim()}”, query the field with `
      + "slgaussian query." };
  }

  /** Return the known word at the start of a list of tokens, and its number of tokens. */
  first(tokens) {
    for (let length = Math.min(this.longest, tokens.length); length > 0; length--) {
      const begin = tokens.slice(0, length - 1), last = tokens[length - 1];
      for (const form of singulars(last)) {
        const word = this.spellings.get([...begin, form].join(" "));
        if (word) return [word, length];
      }
    }
    return [null, 1];
  }

  /** Answer a typed text: {text, kind, gaps, taken, measurements, named}, or {refused}. */
  answer(typed) {
    const { text, reason } = this.read(typed);
    return reason ? { refused: reason } : this.stored(text);
  }

  stored(text) {
    const count = about.things.length, row = this.rows.get(text);
    const range = [row * count, (row + 1) * count];
    return {
      text, kind: this.kinds.get(text), measurements: about.measurements[row],
      named: about.named[row],
      gaps: Array.from(this.gaps.subarray(...range)),
      taken: Array.from(this.taken.subarray(...range), Boolean),
    };
  }

  ask(text) { return this.judge(this.stored(text)); }

  /**
   * Judge an answer: {scores, taken, best, confidence, verdict, shown, summary}. The confidence is
   * that of computeConfidence, or null for a name and without a calibration. The last three are
   * those of QueryResult (slgaussian/language/query.py).
   */
  judge({ kind, gaps, taken, measurements, named: evidence = 0, alone = "", untold = "" }) {
    const top = Math.max(-Infinity, ...gaps);
    const named = kind === "named";
    const calibrated = about.calibration && !named && top > -Infinity;
    const confidence = calibrated
      ? computeConfidence(gaps, taken, top, measurements, evidence) : null;
    const scores = gaps.map((gap) => 1 / (1 + Math.exp(-about.temperature * gap)));
    const best = gaps.indexOf(top), any = taken.includes(true);
    const verdict = untold ? "cannot tell" : any ? verdictOf(confidence) : "not here";
    let summary = named || !about.uncalibrated ? verdict : `found, uncalibrated for ${about.uncalibrated}`;
    if (untold) summary = `cannot tell: ${untold}`;
    else if (!any) summary = `not here: the best object scores ${(scores[best] || 0).toFixed(3)}`;
    else if (verdict === "not here") {
      summary = `probably not here: ${confidence.point.toFixed(2)} that the best object is it`;
    } else if (confidence) {
      summary = `${verdict}: ${confidence.mask.toFixed(2)} that the mask is right, `
        + `${confidence.point.toFixed(2)} that the point is${alone}`;
    }
    const shown = verdict === "found" || verdict === "not sure";
    return { scores, taken, best, confidence, verdict, shown, summary };
  }
}

/** Return the verdict, as Confidence does (slgaussian/language/confidence.py). */
function verdictOf(confidence) {
  if (!confidence) return "found";
  if (confidence.point < about.calibration.absent) return "not here";
  return confidence.mask >= 0.5 ? "found" : "not sure";
}

/**
 * Compute the probabilities that an answer's mask and point are right, as
 * slgaussian/language/confidence.py does, with its constants in about.calibration.
 */
function computeConfidence(gaps, taken, top, measurements, named) {
  const { mask, point, typical, even_out: evenOut } = about.calibration;
  const any = taken.includes(true);
  const selected = [], rest = [];
  gaps.forEach((gap, k) => {
    if (gap > -Infinity) ((any ? taken[k] : gap === top) ? selected : rest).push(gap);
  });
  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
  let standOut = typical;
  if (rest.length > 1) {
    const center = mean(rest);
    const spread = Math.sqrt(mean(rest.map((gap) => (gap - center) ** 2)));
    standOut = (mean(selected) - center) / (spread + evenOut);
  }
  standOut *= Math.min(1, (rest.length + 1) / selected.length);
  const features = [top * measurements, standOut, Math.log(Math.max(parts(taken), 1)), named, 1];
  const probability = (curve) =>
    1 / (1 + Math.exp(-curve.reduce((sum, c, k) => sum + c * features[k], 0)));
  return { mask: probability(mask), point: probability(point) };
}

/** Count the connected groups of the selected objects, which touch in the first view. */
function parts(taken) {
  const first = taken.map((_, thing) => thing);
  const group = (thing) => (first[thing] === thing ? thing : group(first[thing]));
  for (const [a, b] of about.touching) {
    if (taken[a] && taken[b]) first[group(a)] = group(b);
  }
  return first.filter((root, thing) => taken[thing] && root === thing).length;
}

/** Return a word and its possible singulars. */
function singulars(word) {
  const forms = [word];
  for (const [ending, singular] of [["ies", "y"], ["ves", "f"], ["ves", "fe"], ["s", ""], ["es", ""]]) {
    if (word.endsWith(ending) && word.length > ending.length + 1) {
      forms.push(word.slice(0, -ending.length) + singular);
    }
  }
  return forms;
}
