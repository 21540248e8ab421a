// What came out of measuring: a place, a length or an area, each with its sigma.

import { el, facts } from "./dom.js";
import { draft, point } from "./draft.js";
import {
  angle,
  area,
  axes,
  coordinate,
  fixed,
  inMapUnit,
  measured,
  plural,
  short,
} from "./format.js";
import { state } from "./store.js";

/** What came out; null while nothing has. */
export function resultView() {
  const lengths = draft.result?.lengths;
  const why = draft.result?.lengths_why_not;
  if (why) return el("p", { class: "bad" }, why);
  if (!lengths) return draft.shape === "point" ? pointResult() : null;
  const { ground, grid, slope, area_ground: areaGround, area_grid: areaGrid } = lengths;
  const [leg] = lengths.legs;
  const isArea = draft.shape === "polygon";
  const better = ground.sigma > 0 ? ground.apart / ground.sigma : 1;
  return el(
    "div",
    { class: "result" },
    isArea ? el("p", { class: "value" }, area(areaGround.value, areaGround.sigma)) : null,
    isArea
      ? el(
          "p",
          { class: "note" },
          `on the ground; on the map ${area(areaGrid.value, areaGrid.sigma)}`,
        )
      : null,
    el("p", { class: "value" }, measured(ground.value, ground.sigma)),
    el("p", { class: "note" }, `${isArea ? "perimeter" : "length"} on the ground, level`),
    facts([
      ...inOtherUnit(lengths),
      ["On the map (grid)", measured(grid.value, grid.sigma)],
      ["In space (slope)", measured(slope.value, slope.sigma)],
      ["Grid over ground", fixed(lengths.scale, 7)],
      lengths.legs.length === 1 && [
        "Height difference",
        measured(leg.height_difference.value, leg.height_difference.sigma),
      ],
      lengths.legs.length === 1 && [
        "Bearing (grid)",
        angle(leg.bearing_grid.value, leg.bearing_grid.sigma),
      ],
      lengths.legs.length === 1 && [
        "Bearing (true)",
        angle(leg.bearing_true.value, leg.bearing_true.sigma),
      ],
    ]),
    better >= 1.5
      ? el(
          "p",
          { class: "note" },
          `${better.toFixed(1)} times better than the places themselves (they alone would give ` +
            `± ${short(ground.apart)}): the points share most of their errors.`,
        )
      : null,
    lengths.legs.length > 1 ? legs(lengths) : null,
  );
}

/** The same in the unit of the map, where that is feet. */
function inOtherUnit({ ground, area_ground: areaGround }) {
  const { crs } = state.facts;
  if (crs.metres_per_unit === 1) return [];
  return [
    areaGround && [`Area in ${crs.unit}²`, inMapUnit(areaGround.value, areaGround.sigma, crs, 2)],
    [
      `${areaGround ? "Perimeter" : "Length"} in ${crs.unit}`,
      inMapUnit(ground.value, ground.sigma, crs),
    ],
  ];
}

function legs(lengths) {
  return el(
    "details",
    {},
    el("summary", {}, plural(lengths.legs.length, "leg")),
    el(
      "ul",
      { class: "rays" },
      lengths.legs.map((leg, i) =>
        el(
          "li",
          {},
          el("span", { class: "name" }, `${i + 1} – ${((i + 1) % draft.vertices.length) + 1}`),
          el("span", {}, measured(leg.ground.value, leg.ground.sigma)),
          el("span", { class: "note" }, angle(leg.bearing_grid.value)),
        ),
      ),
    ),
  );
}

function pointResult() {
  const one = point(0);
  if (!one) return null;
  return el(
    "div",
    { class: "result" },
    el(
      "p",
      { class: "value" },
      `± ${short(Math.hypot(one.sigma_e_m, one.sigma_n_m) / Math.SQRT2)}`,
    ),
    el("p", { class: "note" }, "one sigma of each axis in the plane"),
    place(one),
  );
}

/** One sigma of the clicks as they were counted, px. */
function clickSigmas(rays) {
  const all = rays.map((ray) => ray.sigma_px);
  const [least, most] = [Math.min(...all), Math.max(...all)].map((px) => fixed(px, 1));
  return least === most ? least : `${least} to ${most}`;
}

function place(one) {
  const { unit } = state.facts.crs;
  return facts([
    ["Easting", `${coordinate(one.easting, 3)} ${unit}`],
    ["Northing", `${coordinate(one.northing, 3)} ${unit}`],
    ["Ellips. height", measured(one.height_ellipsoidal_m, one.sigma_u_m)],
    ["σ east, north", `${short(one.sigma_e_m)}, ${short(one.sigma_n_m)}`],
    [
      "95 % ellipse",
      axes(one.semi_major_m, one.semi_minor_m, one.azimuth_deg),
    ],
    ["Lat, lon", `${fixed(one.lat_deg, 7)}, ${fixed(one.lon_deg, 7)}`],
    ["Clicks", `± ${clickSigmas(one.rays)} px each`],
    one.dof > 0 && ["σ₀", `${fixed(one.sigma0, 2)} (${plural(one.dof, "degree")} of freedom)`],
  ]);
}
