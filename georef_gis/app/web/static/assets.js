// Assets: what the server holds, edits of them, and the panel that shows the chosen one.

import { ask } from "./api.js";
import { assetForm, classOf } from "./assetform.js";
import { button, byId, el, facts, fill, say } from "./dom.js";
import { edit, sentVertices } from "./draft.js";
import { axes, coordinate, measured, NOTHING, plural, short } from "./format.js";
import { goTo, inView, setVisible, show } from "./mapview.js";
import { on, select, state, tell, tellOthers } from "./store.js";
import { groupColour } from "./styles.js";

let steps = [];
let revision = null;
const hidden = new Set();
// of the form that is open: id, and the asset it was made from
let form = null;

export const unit = () => state.facts.crs?.metres_per_unit ?? 1;
const colourOf = (kind) => groupColour(classOf(kind)?.group ?? "other");
const titleOf = (kind) => classOf(kind)?.title ?? kind;

/** Read classes and assets anew. */
export async function loadAssets() {
  try {
    if (!state.domain.length) state.domain = (await ask("measure", "classes")).classes;
    const found = await ask("measure", "assets");
    revision = found.revision;
    steps = found.steps;
    state.assets = found.assets.map((asset) => ({
      ...asset,
      colour: colourOf(asset.kind),
      title: titleOf(asset.kind),
      label: asset.name || titleOf(asset.kind),
    }));
  } catch (error) {
    say(error.message, "error");
    return;
  }
  drawAssets();
  tell("assets", state.assets);
}

/** Whether the server's file has changed since it was read. */
export const isBehind = (now) => revision !== null && now !== revision;

function drawAssets() {
  const shown = state.assets.filter((asset) => !hidden.has(asset.kind) && asset.vertices.length);
  const features = shown.map((asset) => {
    const points = asset.vertices.map(([x, y]) => [x, y]);
    const coordinates =
      asset.shape === "point"
        ? points[0]
        : asset.shape === "line"
          ? points
          : [[...points, points[0]]];
    const type = { point: "Point", line: "LineString", polygon: "Polygon" }[asset.shape];
    const { colour, label, shape } = asset;
    return {
      type: "Feature",
      id: asset.id,
      geometry: { type, coordinates },
      properties: { colour, label, shape },
    };
  });
  show("assets", { type: "FeatureCollection", features });
  const rings = shown
    .filter((asset) => asset.ellipse)
    .map((asset) => ({
      type: "Feature",
      geometry: { type: "Polygon", coordinates: [asset.ellipse] },
      properties: { colour: asset.colour },
    }));
  show("ellipses", { type: "FeatureCollection", features: rings });
}

/** Do an edit, then read what came of it. */
async function edited(name, content, words) {
  const answer = await ask("measure", name, content);
  tellOthers("assets");
  await loadAssets();
  say(words, "good");
  return answer;
}

export async function addAsset(content, vertices) {
  const done = await edited(
    "add_asset",
    { ...content, vertices: sentVertices(vertices) },
    `${titleOf(content.kind)} stored`,
  );
  return done.asset.id;
}

export async function measureAnew(asset, vertices) {
  const { id, revision: from } = asset;
  const content = { id, revision: from, vertices: sentVertices(vertices) };
  await edited("change_asset", content, `${asset.label} measured anew`);
}

async function turn(name, words) {
  try {
    const { step } = await ask("measure", name);
    tellOthers("assets");
    await loadAssets();
    say(step ? `${words}: ${step.title}` : `nothing to ${name}`, step ? "good" : "told");
  } catch (error) {
    say(error.message, "error");
  }
}
export const undo = () => turn("undo", "undone");
export const redo = () => turn("redo", "done again");

// -- the panel ------------------------------------------------------------------------------------

export function drawPanel() {
  const panel = byId("panel-assets");
  if (panel.hidden) return;
  const chosen = selectedAsset();
  fill(panel, chosen ? details(chosen) : null, classes(), history());
}

const selectedAsset = () =>
  state.selected?.kind === "asset"
    ? state.assets.find((asset) => asset.id === state.selected.id)
    : null;

function classes() {
  const counts = new Map();
  for (const asset of state.assets) counts.set(asset.kind, (counts.get(asset.kind) ?? 0) + 1);
  const rows = [...counts].map(([kind, count]) => {
    const box = el("input", {
      type: "checkbox",
      checked: !hidden.has(kind),
      on: {
        change: () => {
          if (box.checked) hidden.delete(kind);
          else hidden.add(kind);
          drawAssets();
        },
      },
    });
    const swatch = el("span", { class: "swatch" });
    swatch.style.setProperty("background", colourOf(kind));
    return el(
      "label",
      { class: "check" },
      box,
      swatch,
      titleOf(kind),
      el("span", { class: "count" }, count),
    );
  });
  const none =
    "No assets yet. Choose Point, Line or Area above and click an object in a photo or on the map.";
  return el(
    "section",
    { class: "part" },
    el("h2", {}, "Classes on the map"),
    rows.length ? rows : el("p", { class: "note" }, none),
  );
}

function history() {
  const done = steps.filter((step) => step.state === "done").length;
  const undone = steps.filter((step) => step.state === "undone").length;
  return el(
    "section",
    { class: "part" },
    el("h2", {}, "History"),
    el(
      "div",
      { class: "row" },
      button("Undo", undo, { disabled: !done, title: "Undo the last edit (Ctrl Z)" }),
      button("Redo", redo, { disabled: !undone, title: "Do it again (Ctrl Shift Z)" }),
    ),
    el(
      "ul",
      { class: "rays" },
      steps
        .slice(0, 8)
        .map((step) =>
          el(
            "li",
            {},
            el("span", { class: "name" }, step.title),
            el(
              "span",
              { class: "note" },
              step.state === "done" ? step.at.slice(0, 16).replace("T", " ") : step.state,
            ),
          ),
        ),
    ),
  );
}

/** Place, accuracy and form of an asset. */
function details(asset) {
  const { quality } = asset;
  const [x, y, z] = asset.vertices[0] ?? [];
  const rows = [
    ["Easting", `${coordinate(x, 3)} ${state.facts.crs.unit}`],
    ["Northing", `${coordinate(y, 3)} ${state.facts.crs.unit}`],
    ["Ellips. height", measured(z, quality?.sigma_u)],
    asset.shape !== "point" && ["Vertices", asset.vertices.length],
    asset.shape !== "point" && [
      asset.shape === "line" ? "Length on map" : "Area on map",
      sizeOf(asset),
    ],
    quality?.sigma_e != null && [
      "σ east, north",
      `${short(quality.sigma_e)}, ${short(quality.sigma_n)}`,
    ],
    quality?.sigma_u != null && ["σ up", short(quality.sigma_u)],
    quality?.semi_major != null && [
      `${Math.round(100 * (quality.conf ?? 0))} % ellipse`,
      axes(quality.semi_major, quality.semi_minor, quality.azimuth),
    ],
    ["Measured by", methodWords(quality)],
  ];
  const made = formFor(asset);
  return el(
    "section",
    { class: "part" },
    el(
      "div",
      { class: "row title" },
      swatch(asset.kind),
      el("h2", {}, asset.label),
      button("Close", () => select(null), { class: "small" }),
    ),
    asset.problems.map((line) => el("p", { class: "doubt" }, line)),
    made.warning,
    facts(rows),
    el(
      "div",
      { class: "row" },
      button("Show on map", () => goTo(x, y)),
      asset.clicks.length ? button("Show in photo", () => openIn(asset)) : null,
      asset.clicks.length ? button("Measure anew", () => edit(asset)) : null,
    ),
    made.node,
    el(
      "div",
      { class: "row" },
      button("Save changes", () => save(asset), { class: "main" }),
      button("Delete", () => remove(asset)),
    ),
  );
}

function swatch(kind) {
  const made = el("span", { class: "swatch" });
  made.style.setProperty("background", colourOf(kind));
  return made;
}

export function methodWords(quality) {
  if (!quality) return "drawn elsewhere";
  if (quality.method === "locate") return "1 photo and ground";
  if (quality.method === "intersect") return plural(quality.n_rays, "photo");
  if (quality.method === "intersect_ground") return `${plural(quality.n_rays, "photo")}, ground`;
  return quality.method || NOTHING;
}

export function openIn(asset) {
  const { photo, u, v } = asset.clicks[0];
  tell("open-photo", { photo, at: { u, v, zoom: 1 } });
}

/** The form of an asset: kept while the same one is shown, so that nothing typed is lost. */
function formFor(asset) {
  const isOther = form?.id !== asset.id;
  const isUntouched = form && JSON.stringify(form.content()) === form.first;
  if (isOther || (isUntouched && form.base.revision !== asset.revision)) {
    const made = assetForm(asset.shape, asset);
    form = {
      ...made,
      id: asset.id,
      base: asset,
      first: JSON.stringify(made.content()),
      warning: null,
    };
  } else if (form.base.revision !== asset.revision) {
    form.warning = changedElsewhere(asset);
  }
  return form;
}

/** Somebody changed the asset while it was being edited here: both are kept until one is chosen. */
function changedElsewhere(current) {
  return el(
    "div",
    { class: "bad", role: "alert" },
    `Changed meanwhile, in another tab or program: it is now “${current.label}”`,
    ` (${titleOf(current.kind)}). What you typed is kept below.`,
    el(
      "div",
      { class: "row" },
      button(
        "Take theirs",
        () => {
          form = null;
          drawPanel();
        },
        { class: "small" },
      ),
      button(
        "Keep mine: save over it",
        () => {
          form.base = current;
          form.warning = null;
          save(current);
        },
        { class: "small" },
      ),
    ),
  );
}

async function save(asset) {
  if (!form.isValid()) return;
  const { id, revision: from } = form.base;
  try {
    await edited("change_asset", { id, revision: from, ...form.content() }, `${asset.label} saved`);
    form = null;
    drawPanel();
  } catch (error) {
    say(error.message, "error");
    if (error.status === 409) await loadAssets();
  }
}

async function remove(asset) {
  try {
    await edited(
      "delete_asset",
      { id: asset.id, revision: asset.revision },
      `${asset.label} deleted; Undo brings it back`,
    );
    select(null);
  } catch (error) {
    say(error.message, "error");
    if (error.status === 409) await loadAssets();
  }
}

on("selected", (selected) => {
  drawPanel();
  const asset = selected && selectedAsset();
  if (asset?.vertices.length) {
    setVisible("assets", true);
    const [x, y] = asset.vertices[0];
    if (!inView(x, y)) goTo(x, y);
  }
});
on("assets", drawPanel);
on("other:assets", loadAssets);

/** Length or area of an asset on the map, in m and m²: of its vertices, without a sigma. */
export function sizeOf(asset) {
  const points = asset.vertices.map(([x, y]) => [x * unit(), y * unit()]);
  if (asset.shape === "line") {
    const legs = points.slice(1).map(([x, y], i) => Math.hypot(x - points[i][0], y - points[i][1]));
    return `${legs.reduce((sum, leg) => sum + leg, 0).toFixed(2)} m`;
  }
  if (asset.shape !== "polygon") return "";
  const twice = points.reduce((sum, [x, y], i) => {
    const [a, b] = points[(i + 1) % points.length];
    return sum + (x * b - a * y);
  }, 0);
  return `${Math.abs(twice / 2).toFixed(1)} m²`;
}

