// A page that is served: its server answers words and changes the field (slgaussian/viewer/server.py).

const PAUSE = 400; // milliseconds without a key after which what was typed is asked

/** The server's answer to a POST; an Error with its sentence if it could not do it. */
async function post(name, body = {}) {
  const base = location.pathname.replace(/\/?$/, "/");
  const response = await fetch(`${base}api/${name}`, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  }).catch(() => {
    throw new Error("The viewer was stopped; start `slgaussian view` again and load this page anew.");
  });
  if (response.ok) return response.json();
  const { error } = await response.json().catch(() => ({ error: response.statusText }));
  throw new Error(error);
}

class Live {
  constructor(page) {
    this.page = page;
    const word = () => $("word").value, object = () => about.things[page.picked - 1].id;
    const waiting = () => clearTimeout(this.timer);
    $("words").addEventListener("input", () => {
      waiting();
      this.timer = setTimeout(() => page.search(), PAUSE);
    });
    $("search").addEventListener("submit", waiting);
    $("clear").addEventListener("click", waiting);
    $("edit").addEventListener("submit", (event) => {
      event.preventDefault();
      this.change("name", { object: object(), word: word() });
    });
    $("teach").addEventListener("click", () =>
      this.change("teach", { object: object(), word: word() }));
    $("remove").addEventListener("click", () => this.change(
      about.things[page.picked - 1].removed ? "restore" : "remove", { object: object() }));
    $("undo").addEventListener("click", () => this.change("undo"));
    $("keep").addEventListener("click", () => this.change("save"));
  }

  /** Answers to texts, as Words.baked gives them. */
  async query(texts) {
    try {
      const { answers } = await post("query", { texts });
      answers.forEach((one) => { one.gaps = one.gaps?.map((gap) => gap ?? -Infinity); });
      return answers;
    } catch (error) {
      return [{ refused: error.message }];
    }
  }

  /** Have the field changed, and show what it is then. */
  async change(name, body) {
    $("status").textContent = "";
    try {
      this.show(await post(name, body));
      if (name === "save") $("status").textContent = "Saved into the folder of the field.";
      if (name === "teach" || name === "name") $("word").value = "";
    } catch (error) {
      $("status").textContent = error.message;
    }
  }

  /** Show a state of the field (LiveField.state). */
  show({ names, words, removed, gone, taught, undo, unsaved }) {
    const { page } = this;
    about.things.forEach((thing, k) => Object.assign(thing, {
      name: names[k], words: words[k], removed: removed.includes(thing.id),
    }));
    about.stripes = removed.length > 0;
    if (gone !== this.gone) {
      page.drawing.hide(Uint8Array.from(atob(gone), (c) => c.charCodeAt(0)));
      this.gone = gone;
    }
    page.offer([...Object.keys(about.words), ...taught, ...names.filter(Boolean)]);
    page.list();
    page.choose(page.picked);
    $("undo").disabled = !undo;
    $("keep").disabled = !unsaved;
    $("status").textContent = unsaved ? "Changes are not saved." : "";
    if (page.typed) page.ask(page.typed, page.mode);
  }

  /** Fit the controls to the object that is chosen, a number from 1, or 0 for none. */
  chosen(thing) {
    $("edit").hidden = !thing;
    if (thing) $("remove").textContent = about.things[thing - 1].removed ? "Bring back" : "Remove";
  }
}
