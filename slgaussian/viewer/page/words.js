// Answers to the words that were asked when the file was written: gaps [texts, things].

/** Asks them; `gaps` are rows of about.things.length numbers, in the order of about.texts. */
class Words {
  constructor(gaps) {
    this.gaps = gaps;
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
      return { why: `${unknown.map((w) => `“${w}”`).join(", ")}: not among the words of this file, `
        + "which are listed below" };
    }
    const once = [...new Set(found)];
    const things = once.filter((word) => this.kinds.get(word) === "thing");
    const text = [...once.filter((word) => !things.includes(word)), ...things].join(" ");
    if (this.rows.has(text)) return { text };
    if (!once.length) return { why: "type one of the words that are listed below" };
    const asks = about.pairs ? "one word, or one describing word and one thing" : "the listed texts";
    return { why: `this file answers ${asks}; for “${typed.trim()}” ask the field itself: `
      + "slgaussian query" };
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

  /**
   * What `text` takes by the rule of a query: all whose gap is above 0 and at least about.share of
   * the best. {scores, taken, best}.
   */
  ask(text) {
    const count = about.things.length, row = this.rows.get(text);
    const gaps = Array.from(this.gaps.subarray(row * count, (row + 1) * count));
    const top = Math.max(-Infinity, ...gaps);
    return {
      scores: gaps.map((gap) => 1 / (1 + Math.exp(-about.temperature * gap))),
      taken: gaps.map((gap) => gap > 0 && gap >= about.share * top),
      best: gaps.indexOf(top),
    };
  }
}

/** A word and what it may be the plural of. */
function singulars(word) {
  const forms = [word];
  for (const [ending, singular] of [["ies", "y"], ["ves", "f"], ["s", ""], ["es", ""]]) {
    if (word.endsWith(ending) && word.length > ending.length + 1) {
      forms.push(word.slice(0, -ending.length) + singular);
    }
  }
  return forms;
}
