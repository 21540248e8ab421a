// Elements of the page. Text always goes in as text: nothing that a user or a file wrote is ever
// read as HTML.

const PROPERTIES = new Set([
  "value",
  "checked",
  "disabled",
  "hidden",
  "selected",
  "open",
  "required",
  "multiple",
  "readOnly",
  "indeterminate",
  "tabIndex",
  "htmlFor",
  "type",
  "name",
  "placeholder",
  "title",
  "min",
  "max",
  "step",
  "rows",
  "spellcheck",
  "autocomplete",
  "id",
  "colSpan",
]);

/** An element: attributes, `on` = listeners, `class`; children are elements or texts. */
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === undefined || value === null) continue;
    if (name === "on") {
      for (const [event, listener] of Object.entries(value)) made.addEventListener(event, listener);
    } else if (name === "class") made.className = value;
    else if (name === "dataset") Object.assign(made.dataset, value);
    else if (PROPERTIES.has(name)) made[name] = value;
    else made.setAttribute(name, value === true ? "" : String(value));
  }
  made.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
  return made;
}

export const byId = (id) => document.getElementById(id);

/**
 * Put children in place of those that an element has; the keyboard's focus stays where it was, and
 * what the user opened or closed stays so.
 */
export function fill(parent, ...children) {
  const focused = parent.contains(document.activeElement) ? document.activeElement : null;
  const again = focused && focused !== parent ? sameIn(parent, focused) : null;
  const opened = new Map(folds(parent).map((one) => [titleOf(one), one.open]));
  parent.replaceChildren(
    ...children.flat(Infinity).filter((child) => child !== null && child !== undefined),
  );
  for (const one of folds(parent)) one.open = opened.get(titleOf(one)) ?? one.open;
  if (focused?.isConnected) focused.focus({ preventScroll: true });
  else again?.()?.focus({ preventScroll: true });
  return parent;
}

const folds = (parent) => [...parent.querySelectorAll("details")];
const titleOf = (one) => one.querySelector("summary")?.textContent;
const told = (one) => `${one.tagName} ${one.getAttribute("aria-label") ?? one.textContent}`;

/** Finds, later, what was made anew for an element: the one that is called the same. */
function sameIn(parent, one) {
  const alike = () =>
    [...parent.querySelectorAll(one.tagName)].filter((other) => told(other) === words);
  const words = told(one);
  const place = alike().indexOf(one);
  return () => alike()[place] ?? alike().at(-1);
}

export function button(text, action, attributes = {}) {
  return el("button", { type: "button", on: { click: action }, ...attributes }, text);
}

/** A labelled field; `note` stands below it. */
export function field(label, input, note = "") {
  input.id ||= `field-${(field.count = (field.count || 0) + 1)}`;
  const parts = [el("label", { htmlFor: input.id }, label), input];
  if (note) {
    const told = el("small", { id: `${input.id}-note` }, note);
    input.setAttribute("aria-describedby", told.id);
    parts.push(told);
  }
  return el("div", { class: "field" }, parts);
}

/** A select of [value, title] pairs, or of groups {title, options}. */
export function select(options, value, attributes = {}) {
  const option = ([key, title]) => el("option", { value: key, selected: key === value }, title);
  return el(
    "select",
    attributes,
    options.map((one) =>
      Array.isArray(one)
        ? option(one)
        : el("optgroup", { label: one.title }, one.options.map(option)),
    ),
  );
}

/** Rows of names and values. */
export function facts(pairs) {
  return el(
    "dl",
    { class: "facts" },
    pairs.filter(Boolean).map(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]),
  );
}

/** Call at most every `pause` ms; the last call always counts. */
export function throttled(action, pause) {
  let last = 0;
  let waiting = null;
  return (...values) => {
    clearTimeout(waiting);
    const left = last + pause - performance.now();
    const go = () => {
      last = performance.now();
      action(...values);
    };
    if (left <= 0) go();
    else waiting = setTimeout(go, left);
  };
}

/** Whether an event comes from something that one types into. */
export function isTyping(event) {
  const at = event.target;
  return (
    at instanceof HTMLElement &&
    (at.isContentEditable ||
      at.tagName === "TEXTAREA" ||
      at.tagName === "SELECT" ||
      (at.tagName === "INPUT" && !["checkbox", "radio", "button", "submit"].includes(at.type)))
  );
}

/** A line at the foot of the page; errors stay longer and are read out at once. */
export function say(text, kind = "told") {
  const place = byId("message");
  place.className = kind;
  place.setAttribute("role", kind === "error" ? "alert" : "status");
  fill(place, text);
  clearTimeout(say.timer);
  if (text && kind !== "error") say.timer = setTimeout(() => say(""), 12000);
}
