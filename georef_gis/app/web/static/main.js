// Starts the page, and ties its parts together.

import { ask, get } from "./api.js";
import * as assets from "./assets.js";
import * as control from "./control.js";
import "./cursor.js";
import { button, byId, el, fill, isTyping, say } from "./dom.js";
import * as drafts from "./draft.js";
import "./draftviews.js";
import { fixed, short } from "./format.js";
import { showHelp } from "./help.js";
import * as layers from "./layerspanel.js";
import * as map from "./mapview.js";
import * as matching from "./matching.js";
import * as measure from "./measurepanel.js";
// After the panel: it fills a place in its form.
import "./duplicates.js";
import * as photo from "./photoview.js";
import { loadReport, showReport } from "./report.js";
import { on, select, setTool, state, tell } from "./store.js";
import * as table from "./table.js";
import * as tools from "./tools.js";

const TOOLS = [
  ["look", "Look", "V"],
  ["point", "Point", "P"],
  ["line", "Line", "L"],
  ["area", "Area", "A"],
  ["see", "Who sees", "W"],
];
const SIDES = [
  ["map", "Map", "M"],
  ["both", "Both", "B"],
  ["photo", "Photo", "O"],
];
const TABS = [
  ["layers", "Layers", layers],
  ["measure", "Measure", measure],
  ["assets", "Assets", assets],
  ["control", "Control", control],
  ["tools", "Tools", tools],
];
// ms between two looks for what others changed
const PULSE = 4000;
let side = "both";

// -- radio groups and tabs: one stop of the Tab key each, arrows inside ---------------------------

function arrows(group, event) {
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  if (!step) return;
  const all = [...group.querySelectorAll("button")];
  const next = all[(all.indexOf(document.activeElement) + step + all.length) % all.length];
  next.click();
  next.focus();
  event.preventDefault();
}

function radioGroup(id, options, chosen, choose) {
  const group = byId(id);
  group.addEventListener("keydown", (event) => arrows(group, event));
  fill(
    group,
    options.map(([value, title, key]) =>
      button(title, () => choose(value), {
        role: "radio",
        dataset: { value },
        title: `${title} (${key})`,
      }),
    ),
  );
  mark(id, chosen);
}

/** Choose what a click does, where there is something to click. */
function chooseTool(tool) {
  if (tool === "look" || state.facts?.photos_in_order?.length) setTool(tool);
  else say("no photo has a pose yet: make the products first (Tools)", "error");
}

function mark(id, value) {
  const all = [...byId(id).children];
  const chosen = all.find((one) => one.dataset.value === value);
  for (const one of all) {
    one.setAttribute("aria-checked", one === chosen);
    one.tabIndex = one === (chosen ?? all[0]) ? 0 : -1;
  }
}

function makeTabs() {
  const list = byId("tabs");
  list.addEventListener("keydown", (event) => arrows(list, event));
  fill(
    list,
    TABS.map(([name, title], i) =>
      button(title, () => showTab(name), {
        id: `tab-${name}`,
        role: "tab",
        "aria-controls": `panel-${name}`,
        title: `${title} (${i + 1})`,
      }),
    ),
  );
  for (const [name] of TABS) byId(`panel-${name}`).setAttribute("aria-labelledby", `tab-${name}`);
  showTab("layers");
}

function showTab(name) {
  for (const [one] of TABS) {
    const isShown = one === name;
    byId(`tab-${one}`).setAttribute("aria-selected", isShown);
    byId(`tab-${one}`).tabIndex = isShown ? 0 : -1;
    byId(`panel-${one}`).hidden = !isShown;
  }
  TABS.find(([one]) => one === name)[2].drawPanel();
}

const isNarrow = () => window.matchMedia("(max-width: 920px)").matches;

function showSide(name) {
  side = name;
  document.querySelector("main").dataset.side = name;
  mark("sides", name);
  map.getMap()?.updateSize();
  photo.getViewer()?.updateSize();
}

// -- photo ----------------------------------------------------------------------------------------

function makePhotoBar() {
  const choice = byId("photo-choice");
  const order = state.facts.photos_in_order ?? [];
  fill(
    choice,
    el("option", { value: "" }, order.length ? "choose a photo" : "no photo has a pose yet"),
    order.map((id) => el("option", { value: id }, id)),
  );
  choice.value = state.photo?.photo ?? "";
  fill(
    byId("photo-empty"),
    order.length ? "Click a photo point on the map, or choose a photo above." : "No photo to show.",
  );
}

function listenToPhotoBar() {
  const choice = byId("photo-choice");
  choice.addEventListener(
    "change",
    () => choice.value && tell("open-photo", { photo: choice.value }),
  );
  byId("photo-before").addEventListener("click", () => photo.step(-1));
  byId("photo-after").addEventListener("click", () => photo.step(1));
  byId("photo-fit").addEventListener("click", photo.fitPhoto);
  byId("photo-native").addEventListener("click", () =>
    // A screen may have several pixels for one of CSS.
    photo.getViewer().getView().setResolution(window.devicePixelRatio || 1),
  );
  byId("north-up").addEventListener("click", photo.toggleNorth);
}

on("open-photo", ({ photo: id, at }) => {
  if (side === "map") showSide(isNarrow() ? "photo" : "both");
  photo.openPhoto(id, at);
});
on("photo", (facts) => {
  byId("photo-choice").value = facts.photo;
  byId("photo-empty").hidden = true;
  byId("photo-facts").hidden = false;
  fill(
    byId("photo-facts"),
    `${facts.name}: tilt ${fixed(facts.tilt_deg, 1)}°, pose ± ${short(facts.sigma_h_m)}`,
  );
});

// -- tools, keys ----------------------------------------------------------------------------------

on("tool", (tool) => {
  mark("tools", tool);
  if (["point", "line", "area", "see"].includes(tool)) showTab("measure");
});
// The next object is clicked while the last one is still shown.
for (const click of ["photo-click", "map-click"]) {
  on(click, () => ["point", "line", "area", "see"].includes(state.tool) && showTab("measure"));
}
on("selected", (selected) => {
  if (selected?.kind === "asset") showTab("assets");
  if (selected?.kind === "control") showTab("control");
});

function stop() {
  if (state.tool !== "look") setTool("look");
  else select(null);
}

const KEYS = {
  "?": showHelp,
  v: () => setTool("look"),
  escape: stop,
  p: () => chooseTool("point"),
  l: () => chooseTool("line"),
  a: () => chooseTool("area"),
  w: () => chooseTool("see"),
  n: drafts.next,
  s: () => drafts.setSame(true),
  g: () => (showTab("measure"), matching.find()),
  backspace: drafts.stepBack,
  "[": () => photo.step(-1),
  "]": () => photo.step(1),
  r: photo.toggleNorth,
  f: () => (map.fit(), photo.fitPhoto()),
  t: table.toggleTable,
  m: () => showSide("map"),
  b: () => showSide("both"),
  o: () => showSide("photo"),
  ...Object.fromEntries(
    TABS.map(([name], i) => [
      String(i + 1),
      () => {
        showTab(name);
        byId(`tab-${name}`).focus();
      },
    ]),
  ),
};
const WITH_CTRL = { z: assets.undo, y: assets.redo, enter: measure.save };

function pressed(event) {
  if (document.querySelector("dialog[open]")) return;
  const key = event.key.toLowerCase();
  const ctrl = event.ctrlKey || event.metaKey;
  if (ctrl && key === "enter") measure.save();
  else if (isTyping(event)) {
    if (key === "escape") event.target.blur();
    return;
  } else if (ctrl) {
    const action = key === "z" && event.shiftKey ? assets.redo : WITH_CTRL[key];
    if (!action) return;
    action();
  } else if (key === "enter" && event.target.id === "map") map.clickMiddle();
  else if (key === "enter" && event.target.id === "photo") photo.clickMiddle();
  else if (!event.altKey && KEYS[key]) KEYS[key]();
  else return;
  event.preventDefault();
}

// -- start ----------------------------------------------------------------------------------------

let revisions = {};

async function loadProject() {
  // Of before what is read, so that nothing that changes meanwhile is missed.
  revisions = (await get("/api/state")).revisions;
  state.facts = await ask("view", "facts");
  document.title = `${state.facts.name} – georef`;
  fill(byId("title"), state.facts.name);
  fill(byId("subtitle"), state.facts.crs?.name ?? "");
  const none = byId("map-empty");
  none.hidden = !state.facts.why_not;
  byId("map").classList.toggle("no-scale", !state.facts.crs);
  fill(
    none,
    el("p", {}, "Nothing was made of this project's photos yet."),
    el("small", {}, state.facts.why_not ?? ""),
    el("br"),
    button(
      "Make the products …",
      () => {
        showTab("tools");
        tools.choosePipeline();
      },
      { class: "main" },
    ),
  );
  makePhotoBar();
  layers.drawPanel();
  loadReport();
}

/** Everything that a run may have changed; what is being measured stays. */
async function reload() {
  try {
    const before = JSON.stringify([
      state.facts.map,
      state.facts.extent,
      state.facts.revisions.mosaic,
    ]);
    await loadProject();
    const after = JSON.stringify([
      state.facts.map,
      state.facts.extent,
      state.facts.revisions.mosaic,
    ]);
    if (before !== after) map.makeMap();
    await loadContent();
    photo.loadPredictions();
  } catch (error) {
    say(error.message, "error");
  }
}

async function loadContent() {
  if (state.facts.why_not) return;
  await Promise.all([map.loadLayers(), assets.loadAssets(), control.loadControl()]);
  tell("layers");
  tell("draft");
}

// why the last look failed; empty where it did not
let lost = "";

/** Other tabs, runs and programs change things too. */
async function look() {
  if (document.hidden) return;
  try {
    const now = await get("/api/state");
    if (lost) say("the server answers again", "good");
    lost = "";
    if (now.revisions.project !== revisions.project && !now.job) await reload();
    else if (!state.facts.why_not) {
      if (assets.isBehind(now.revisions.assets)) await assets.loadAssets();
      if (now.revisions.control !== revisions.control) await control.loadControl();
    }
    revisions = now.revisions;
  } catch (error) {
    // Once is enough: it would be read out again and again.
    if (lost !== error.message) say(error.message, "error");
    lost = error.message;
  }
}

async function start() {
  radioGroup("tools", TOOLS, "look", chooseTool);
  radioGroup("sides", SIDES, side, showSide);
  byId("table-button").addEventListener("click", table.toggleTable);
  byId("help-button").addEventListener("click", showHelp);
  byId("report-button").addEventListener("click", showReport);
  document.addEventListener("keydown", pressed);
  listenToPhotoBar();
  makeTabs();
  if (isNarrow()) showSide("map");
  try {
    await loadProject();
  } catch (error) {
    say(error.message, "error");
    return;
  }
  photo.makeViewer();
  map.makeMap();
  tell("map-scale");
  await loadContent();
  layers.drawPanel();
  document.body.dataset.ready = "true";
  setInterval(look, PULSE);
}

on("project-changed", reload);
start();
