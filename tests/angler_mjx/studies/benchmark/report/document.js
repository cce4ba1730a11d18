// Enough of a browser's document to run the page's script in Node: an element tree without layout.
// Input on stdin: {"page": text of the page, "hash": address behind #, "ids": elements to print}.

const { page, hash, ids } = JSON.parse(require("fs").readFileSync(0, "utf8"));

class Element {
  constructor(name) {
    Object.assign(this, { name, children: [], attributes: {}, dataset: {}, style: {}, hidden: false, value: "" });
    this.classList = { toggle() {}, contains: () => false };
  }
  append(...nodes) { this.children.push(...nodes); }
  replaceChildren(...nodes) { this.children = nodes; }
  setAttribute(key, value) { this.attributes[key] = String(value); }
  addEventListener() {}
  querySelector() { return null; }
  set innerHTML(text) { this.children = [new Element("svg")]; }
  get firstChild() { return this.children[0]; }
  get textContent() { return this.children.map((node) => node.textContent ?? String(node)).join(""); }
  set textContent(text) { this.children = [String(text)]; }
  toJSON() { return { name: this.name, class: this.attributes.class, d: this.attributes.d, children: this.children }; }
}

const elements = new Map();
for (const [, name, id] of page.matchAll(/<(\w+)\b[^>]*\bid="([^"]+)"/g)) elements.set(id, new Element(name));
elements.get("data").textContent = page.match(/id="data">(.*?)<\/script>/s)[1];
Object.assign(globalThis, {
  document: {
    body: new Element("body"), activeElement: null,
    getElementById: (id) => elements.get(id) ?? null,
    createElement: (name) => new Element(name),
    createElementNS: (space, name) => new Element(name),
    querySelectorAll: () => [],
  },
  location: { hash: `#${hash}` },
  history: { replaceState() {} },
  matchMedia: () => ({ matches: false }),
  addEventListener() {},
});
(0, eval)(page.match(/<script>\n"use strict";(.*?)<\/script>/s)[1]);
console.log(JSON.stringify(Object.fromEntries(ids.map((id) => [id, elements.get(id)]))));
