// What the layers of the map look like, as small pictures beside their names.

import { COLOURS } from "./styles.js";

const SVG = "http://www.w3.org/2000/svg";
const WHITE = "#ffffff";

const circle = (colour, fill = colour) => [
  ["circle", { cx: 11, cy: 8, r: 4.5, fill, stroke: colour, "stroke-width": 1.6 }],
];
const line = (colour, width = 1.8) => [
  ["path", { d: "M2,11 Q8,2 20,7", fill: "none", stroke: colour, "stroke-width": width }],
];
const SYMBOLS = {
  control: [
    [
      "path",
      { d: "M6,3 L11,12 L1,12 Z", fill: WHITE, stroke: COLOURS.control, "stroke-width": 1.8 },
    ],
    ["circle", { cx: 17, cy: 8, r: 4, fill: WHITE, stroke: COLOURS.check, "stroke-width": 1.8 }],
  ],
  assets: [
    ["rect", { x: 1, y: 4, width: 8, height: 8, fill: "#e8590c", stroke: WHITE }],
    ["path", { d: "M11,12 L21,4", stroke: "#1971c2", "stroke-width": 2.4 }],
  ],
  ellipses: [
    ["ellipse", { cx: 11, cy: 8, rx: 9, ry: 5, fill: "#e8590c1f", stroke: "#e8590c" }],
    ["path", { d: "M8,8 h6 M11,5 v6", stroke: "#e8590c" }],
  ],
  photos: circle(COLOURS.photo),
  trajectory: line(COLOURS.trajectory),
  footprints: [
    ["path", { d: "M4,3 L20,5 L17,13 L2,11 Z", fill: "#1f6fb21f", stroke: COLOURS.photo }],
  ],
  seams: [
    ["rect", { x: 0, y: 0, width: 22, height: 16, fill: "#6d7780" }],
    ["path", { d: "M0,5 L8,8 L10,0 M8,8 L13,16 M8,8 L22,11", fill: "none", stroke: WHITE }],
  ],
  mosaic: [
    ["rect", { x: 2, y: 2, width: 18, height: 12, fill: "#7d9a6a" }],
    ["path", { d: "M2,11 L20,6 V9 L2,14 Z", fill: "#9aa0a6" }],
  ],
};

/** Picture of a layer; its name beside it says what it is. */
export function symbol(name) {
  const made = svg("svg", { viewBox: "0 0 22 16", class: "symbol", "aria-hidden": "true" });
  made.append(...(SYMBOLS[name] ?? []).map(([tag, attributes]) => svg(tag, attributes)));
  return made;
}

function svg(tag, attributes) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}
