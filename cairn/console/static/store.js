// Observable values, and the hooks by which components of the page read them.

import { useEffect, useState } from "./vendor/preact-htm.js";

/** A value that can be observed. */
export class Store {
  #listeners = new Set();

  constructor(value) {
    this.value = value;
  }

  set(value) {
    if (Object.is(value, this.value)) return;
    this.value = value;
    for (const listener of [...this.#listeners]) listener(value);
  }

  update(change) {
    this.set(change(this.value));
  }

  /** Call `listener` with each new value; returns a function that ends this. */
  subscribe(listener) {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  }
}

/** A store that a reload of the page keeps, in this browser. `key` names it. */
export class SavedStore extends Store {
  constructor(key, initial) {
    super(load(key, initial));
    this.subscribe((value) => {
      try {
        localStorage.setItem(`cairn.${key}`, JSON.stringify(value));
      } catch {
        // Storage is full or forbidden: the value lasts as long as the page.
      }
    });
  }
}

function load(key, initial) {
  try {
    const saved = localStorage.getItem(`cairn.${key}`);
    return saved === null ? initial : JSON.parse(saved);
  } catch {
    return initial;
  }
}

/** Return the value of a store, and render again when it changes. */
export function useStore(store) {
  const [, render] = useState(0);
  const rendered = store.value;
  useEffect(() => {
    const end = store.subscribe(() => render((count) => count + 1));
    if (!Object.is(rendered, store.value)) render((count) => count + 1);
    return end;
  }, [store]);
  return store.value;
}
