// Answers to texts, computed when the file was written.

/** The stored answers, as PageAnswers.ask (slgaussian/viewer/page/answers.py) returns them. */
class Words {
  constructor(answers) {
    this.answers = new Map(answers.map((answer) => [answer.text, answer]));
    this.kinds = new Map(Object.entries(about.words));
    this.spellings = new Map(Object.entries(about.spellings));
    this.longest = Math.max(1, ...[...this.spellings.keys()].map((s) => s.split(" ").length));
    this.skipped = new Set(about.skipped);
  }

  /** Find the stored text that a typed text means: {text}, or {reason} if there is none. */
  read(typed) {
    const plain = typed.normalize("NFKC").toLowerCase().split(/\s+/).filter(Boolean).join(" ");
    if (this.answers.has(plain)) return { text: plain };
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
    if (this.answers.has(text)) return { text };
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

  /** Answer a typed text: a stored answer, or {refused}. */
  answer(typed) {
    const { text, reason } = this.read(typed);
    return reason ? { refused: reason } : this.answers.get(text);
  }
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
