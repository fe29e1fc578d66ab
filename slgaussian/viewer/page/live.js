// The live page: its server (slgaussian/viewer/server.py) answers texts and changes the field.

const PAUSE = 400; // milliseconds from the last key until the typed text is sent

/** Send a POST and return the answer; throw an Error with the server's message if it fails. */
async function post(name, body = {}) {
  const base = location.pathname.replace(/\/?$/, "/");
  const response = await fetch(`${base}api/${name}`, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  }).catch(() => {
    throw new Error("The viewer has stopped; start `slgaussian view` again and reload this page.");
  });
  if (response.ok) return response.json();
  const { error } = await response.json().catch(() => ({ error: response.statusText }));
  throw new Error(error);
}

class Live {
  constructor(page) {
    this.page = page;
    const word = () => $("word").value, object = () => about.things[page.picked - 1].id;
    const cancel = () => clearTimeout(this.timer);
    $("words").addEventListener("input", () => {
      cancel();
      this.timer = setTimeout(() => page.search(), PAUSE);
    });
    $("search").addEventListener("submit", cancel);
    $("clear").addEventListener("click", cancel);
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

  /** Return answers to texts, in the form of Words.answer. */
  async query(texts) {
    try {
      return (await post("query", { texts })).answers;
    } catch (error) {
      return [{ refused: error.message }];
    }
  }

  /** Ask the server to change the field, and show the new state. */
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
    page.suggest([...Object.keys(about.words), ...taught, ...names.filter(Boolean)]);
    page.list();
    page.choose(page.picked);
    $("undo").disabled = !undo;
    $("keep").disabled = !unsaved;
    $("status").textContent = unsaved ? "Changes are not saved." : "";
    if (page.typed) page.ask(page.typed, page.mode);
  }

  /** Update the controls for the selected object, a number from 1, or 0 for none. */
  chosen(thing) {
    $("edit").hidden = !thing;
    if (thing) $("remove").textContent = about.things[thing - 1].removed ? "Bring back" : "Remove";
  }
}
