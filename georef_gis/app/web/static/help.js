// Help with the shortcuts.

import { button, byId, el, fill } from "./dom.js";

export const SHORTCUTS = [
  ["?", "this help"],
  ["V, Esc", "look: clicks choose things"],
  ["P", "measure a point"],
  ["L", "measure a line: length, bearing, height difference"],
  ["A", "measure an area"],
  ["W", "who sees: click a place to list the photos that show it, best first"],
  ["N", "new point, or new vertex"],
  ["S", "next click: the chosen vertex in another photo"],
  ["G", "find the click in the other photos"],
  ["Backspace", "take the last click back"],
  ["Ctrl Enter", "store what was measured"],
  ["Ctrl Z, Ctrl Shift Z", "undo, redo edits of assets"],
  ["[ and ]", "photo before, next photo"],
  ["R", "turn the photo north up"],
  ["F", "show everything"],
  ["T", "table of assets"],
  ["1 to 5", "layers, measure, assets, control, tools"],
  ["M, B, O", "show the map, both, the photo"],
  ["Arrow keys, + and −", "move and zoom the map or photo that has the focus"],
  ["Enter", "click at the middle of the map or photo that has the focus"],
];

const WORDS = [
  "Click a photo point on the map to open its photo. Choose Point, Line or Area, then click in a " +
    "photo or on the map. One click meets the ground; clicks of one object in several photos are " +
    "intersected, and a guide line shows where to look. “Find it in the other photos” looks for " +
    "the click by its picture; you accept or reject what it finds.",
  "Every place and length has a sigma (σ): two thirds of results lie within one σ of the truth. " +
    "Ellipses hold 95 %. Points of one photo share most of their errors, so lengths are better " +
    "than places, and the page says by how much.",
  "Heights are above the ellipsoid. Lengths “on the ground” are what a tape gives; “on the map” " +
    "what a GIS measures in the project's CRS.",
  "Assets are kept in assets.gpkg in the project's folder and can be opened in QGIS at the same " +
    "time. Every edit can be undone.",
];

/** Title of a dialog, and what closes it. */
export function dialogHead(id, title, dialog) {
  return el(
    "div",
    { class: "head" },
    el("h2", { id }, title),
    el("span", { class: "spacer" }),
    button("Close", () => dialog.close()),
  );
}

export function showHelp() {
  const dialog = byId("help");
  fill(
    dialog,
    dialogHead("help-title", "Help", dialog),
    el(
      "div",
      { class: "body" },
      WORDS.map((text) => el("p", { class: "told" }, text)),
      el("h2", {}, "Keys"),
      el(
        "dl",
        { class: "shortcuts" },
        SHORTCUTS.map(([keys, text]) => [
          el(
            "dt",
            {},
            keys.split(/(, | and | to )/).map((part, i) => (i % 2 ? part : el("kbd", {}, part))),
          ),
          el("dd", {}, text),
        ]),
      ),
      el(
        "p",
        { class: "note" },
        "OpenLayers 10 draws map and photos (BSD 2-Clause): /static/vendor/ol.LICENSE.md",
      ),
    ),
  );
  dialog.showModal();
}
