// What the parts of the page share, and how they tell each other of changes.

export const state = {
  facts: null,
  // facts of the photo in the viewer
  photo: null,
  // "look", "point", "line", "area", "see" or "mark"
  tool: "look",
  // control point that is being marked
  marking: null,
  domain: [],
  assets: [],
  control: [],
  // {kind: "asset" | "control", id}
  selected: null,
};

const listeners = new Map();

export function on(event, listener) {
  if (!listeners.has(event)) listeners.set(event, []);
  listeners.get(event).push(listener);
}

export function tell(event, content) {
  for (const listener of listeners.get(event) ?? []) listener(content);
}

export function setTool(tool) {
  state.tool = tool;
  if (tool !== "mark") state.marking = null;
  tell("tool", tool);
}

export function select(kind, id) {
  state.selected = id === null || id === undefined ? null : { kind, id };
  tell("selected", state.selected);
}

export const isSelected = (kind, id) => state.selected?.kind === kind && state.selected.id === id;

// Other tabs of this browser hear of changes at once; other programs' are found by asking.
const channel = "BroadcastChannel" in window ? new BroadcastChannel("georef") : null;
channel?.addEventListener("message", (event) => tell(`other:${event.data}`));

export function tellOthers(event) {
  channel?.postMessage(event);
}
