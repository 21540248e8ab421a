// The panel of layers, and what is to be known of the project.

import { byId, el, facts, fill } from "./dom.js";
import { plural, short } from "./format.js";
import { symbol } from "./legend.js";
import { count, isVisible, LAYERS, setVisible } from "./mapview.js";
import { on, state } from "./store.js";

const POSES = { tags: "from the photos' tags", navigation: "from the logs", adjusted: "adjusted" };

export function drawPanel() {
  const panel = byId("panel-layers");
  if (panel.hidden || !state.facts) return;
  fill(panel, layers(), project(), doubts());
}

function layers() {
  const rows = LAYERS.map(([name, title]) => {
    const isThere = name === "mosaic" ? Boolean(state.facts.map) : count(name) > 0;
    const box = el("input", {
      type: "checkbox",
      checked: isVisible(name),
      disabled: !isThere,
      name,
      on: { change: () => setVisible(name, box.checked) },
    });
    const told = name === "mosaic" ? (isThere ? "" : "not made yet") : count(name);
    return el(
      "label",
      { class: "check" },
      box,
      symbol(name),
      title,
      el("span", { class: "count" }, told),
    );
  });
  return el("section", { class: "part" }, el("h2", {}, "Layers"), rows);
}

function project() {
  const { facts: all } = state;
  if (!all.crs) return null;
  const poses = Object.entries(all.poses)
    .map(([kind, n]) => `${n} ${POSES[kind] ?? kind}`)
    .join(", ");
  return el(
    "section",
    { class: "part" },
    el("h2", {}, "Project"),
    facts([
      ["CRS", `${all.crs.name}${all.crs.code ? ` (EPSG:${all.crs.code})` : ""}`],
      ["Unit of the map", all.crs.unit],
      ["Datum", all.crs.datum],
      ["Photos", plural(all.photos, "photo")],
      ["Poses", poses || "none yet"],
      ["GSD (median)", short(all.gsd_m)],
    ]),
  );
}

function doubts() {
  const lines = state.facts.doubts ?? [];
  if (!lines.length) return null;
  return el(
    "details",
    {},
    el("summary", {}, `${plural(lines.length, "doubt")} of the last runs`),
    lines.map((line) => el("p", { class: "doubt" }, line)),
  );
}

on("layers", drawPanel);
on("assets", drawPanel);
on("control", drawPanel);
