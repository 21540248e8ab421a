// What is being measured: clicks, vertices, and what the server makes of them.

import { ask, latest } from "./api.js";
import { say } from "./dom.js";
import { on, setTool, state, tell } from "./store.js";

export const draft = {
  // "point", "line" or "polygon"
  shape: "point",
  // each {clicks: [{photo, u, v}]}; one that was found by matching, or is what it was found by, has
  // `sigma_px` and `shared_px` too
  vertices: [],
  active: 0,
  // whether the next click shows the active vertex in another photo, not a new vertex
  same: false,
  // whether what is clicked is said to lie on the ground; it stays so for the next thing
  onGround: false,
  result: null,
  sights: [],
  // the stored asset that is measured anew
  editing: null,
};
const SHAPES = { point: "point", line: "line", area: "polygon" };
const TOOLS = { point: "point", line: "line", polygon: "area" };
const figure = latest("measure", "figure");
const sightsOf = latest("measure", "sights_of");
let before = [];
// What is being stored. Clicks and another tool wait for it: they are of the next thing.
let storing = Promise.resolve();
let waiting = 0;

export const point = (i) => draft.result?.points[String(i)] ?? null;
export const refusal = (i) => draft.result?.refused[String(i)] ?? null;
/** Clicks as the server takes them: what the page notes of them stays here. */
export const sent = (clicks) =>
  clicks.map((click) => ({
    ...bare(click),
    ...(draft.onGround ? { on_ground: true } : {}),
  }));
const bare = ({ photo, u, v, sigma_px: sigma, shared_px: shared }) => ({
  photo,
  u,
  v,
  ...(sigma ? { sigma_px: sigma } : {}),
  ...(shared ? { shared_px: shared } : {}),
});
export const sentVertices = (vertices) => vertices.map(({ clicks }) => ({ clicks: sent(clicks) }));

export const activeVertex = () => draft.vertices[draft.active] ?? null;
export const isComplete = () =>
  draft.vertices.length >= { point: 1, line: 2, polygon: 3 }[draft.shape] &&
  draft.vertices.every((_, i) => point(i));

function remember() {
  before.push(JSON.stringify([draft.vertices, draft.active]));
  if (before.length > 100) before.shift();
}

/** Take the last click back. */
export function stepBack() {
  const kept = before.pop();
  if (!kept) return;
  [draft.vertices, draft.active] = JSON.parse(kept);
  changed();
}

export function clear() {
  draft.vertices = [];
  draft.active = 0;
  draft.same = false;
  draft.editing = null;
  before = [];
  changed();
}

/** Let what comes next wait until a promise is settled. */
export function holdUntil(promise) {
  storing = promise.catch(() => {});
}

/** Whether the next thing has been begun meanwhile. */
export const isNextBegun = () => waiting > 0;

const afterStoring = (action) => async (event) => {
  waiting += 1;
  await storing;
  waiting -= 1;
  action(event);
};

/** Begin with the vertices of a stored asset, to measure it anew. */
export function edit(asset) {
  clear();
  draft.shape = asset.shape;
  for (const click of asset.clicks) {
    draft.vertices[click.vertex] ??= { clicks: [] };
    draft.vertices[click.vertex].clicks.push(bare(click));
  }
  draft.onGround = asset.clicks.some((click) => click.on_ground);
  draft.editing = asset;
  draft.same = true;
  setTool(TOOLS[asset.shape]);
  changed();
}

function addVertex(click) {
  draft.vertices.push({ clicks: [click] });
  draft.active = draft.vertices.length - 1;
}

/** A click in a photo: of the active vertex, or of a new one. */
export function addClick(click, { fromMap = false } = {}) {
  remember();
  const vertex = activeVertex();
  const isPoint = draft.shape === "point";
  if (!vertex) addVertex(click);
  else if (isPoint && fromMap && !draft.editing) {
    draft.vertices = [];
    addVertex(click);
  } else if (isPoint || draft.same) {
    vertex.clicks = [...vertex.clicks.filter(({ photo }) => photo !== click.photo), click];
  } else addVertex(click);
  changed();
}

/** Put clicks in place of those of a vertex. */
export function setClicks(i, clicks) {
  remember();
  draft.vertices[i] = { clicks };
  changed();
}

export function removeClick(i, photo) {
  remember();
  const vertex = draft.vertices[i];
  vertex.clicks = vertex.clicks.filter((click) => click.photo !== photo);
  if (!vertex.clicks.length) draft.vertices.splice(i, 1);
  draft.active = Math.min(draft.active, Math.max(0, draft.vertices.length - 1));
  changed();
}

export function removeVertex(i) {
  remember();
  draft.vertices.splice(i, 1);
  draft.active = Math.min(draft.active, Math.max(0, draft.vertices.length - 1));
  changed();
}

export function activate(i) {
  draft.active = i;
  draft.same = true;
  tell("draft");
  loadSights();
}

export function setSame(same) {
  draft.same = same;
  tell("draft");
}

/** Say whether all that is clicked lies on the ground. */
export function setOnGround(on) {
  draft.onGround = on;
  changed();
}

/** The next click begins a new point or vertex. */
export function next() {
  if (draft.shape === "point") clear();
  else setSame(false);
}

async function changed() {
  if (!draft.vertices.length) {
    draft.result = null;
    draft.sights = [];
    tell("draft");
    return;
  }
  tell("draft");
  try {
    const result = await figure({ shape: draft.shape, vertices: sentVertices(draft.vertices) });
    if (!result) return;
    draft.result = result;
  } catch (error) {
    draft.result = null;
    say(error.message, "error");
  }
  tell("draft");
  loadSights();
}

/** Which photos show the active vertex. */
async function loadSights() {
  const vertex = activeVertex();
  if (!vertex || !point(draft.active)) {
    draft.sights = [];
    tell("sights");
    return;
  }
  try {
    const found = await sightsOf({ clicks: sent(vertex.clicks) });
    if (!found) return;
    draft.sights = found.sights;
  } catch {
    // Why the vertex has no place is told with the vertex.
    draft.sights = [];
  }
  tell("sights");
}

/** A click on the mosaic stands for a pixel of the photo that it was made of there. */
async function addMapClick({ x, y }) {
  try {
    const { photo, u, v } = await ask("measure", "pick", { x, y });
    addClick({ photo, u, v }, { fromMap: true });
    if (!state.photo) tell("open-photo", { photo, at: { u, v, zoom: 1 } });
  } catch (error) {
    say(error.message, "error");
  }
}

function begin(tool) {
  const shape = SHAPES[tool];
  if (!shape || shape === draft.shape) return;
  draft.shape = shape;
  clear();
}

on("tool", afterStoring(begin));
on("photo-click", afterStoring((click) => state.tool in SHAPES && addClick(click)));
on("map-click", afterStoring((place) => state.tool in SHAPES && addMapClick(place)));
