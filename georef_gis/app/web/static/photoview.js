// The photo viewer: tiles to the photo's own pixels, a north arrow, predicted places, clicks.
//
// Its coordinates are (u, -v): (0, 0) is the middle of the first pixel, v runs down.

import { ask, latest, picture } from "./api.js";
import { byId, fill, say, throttled } from "./dom.js";
import { nearest } from "./hits.js";
import * as styles from "./styles.js";
import { isSelected, on, select, state, tell } from "./store.js";

// screen pixels per photo pixel, at most
const CLOSEST = 16;
// photo pixels per screen pixel from which on single objects are looked at
const NEAR = 1.5;

let viewer = null;
let northUp = false;
let opening = 0;
const sources = {};
const layers = {};
const inPhoto = latest("measure", "in_photo");

const NAMES = ["guides", "seen", "assets", "control", "cursor", "draft"];

/** Make the empty viewer. */
export function makeViewer() {
  viewer?.setTarget(null);
  for (const [order, name] of NAMES.entries()) {
    sources[name] = new ol.source.Vector({ wrapX: false });
    layers[name] = new ol.layer.Vector({ source: sources[name], zIndex: 10 + order });
  }
  layers.photo = new ol.layer.Tile({ zIndex: 0 });
  viewer = new ol.Map({
    target: byId("photo"),
    layers: [layers.photo, ...NAMES.map((name) => layers[name])],
    controls: ol.control.defaults.defaults({ attribution: false, rotate: false }),
    interactions: ol.interaction.defaults.defaults({
      altShiftDragRotate: false,
      pinchRotate: false,
      doubleClickZoom: false,
    }),
    view: new ol.View({ center: [0, 0], resolution: 1 }),
  });
  viewer.on("click", clicked);
  viewer.on("pointermove", moved);
  byId("photo").addEventListener("pointerleave", () => tell("photo-cursor", null));
  return viewer;
}

export const getViewer = () => viewer;

/** Open a photo; `at` is a pixel to look at. */
export async function openPhoto(id, at = null) {
  const mine = ++opening;
  if (state.photo?.photo === id) {
    if (at) lookAt(at.u, at.v, at.zoom);
    return;
  }
  let facts;
  try {
    facts = await ask("view", "photo", { photo: id });
  } catch (error) {
    say(error.message, "error");
    return;
  }
  if (mine !== opening) return;
  state.photo = facts;
  for (const name of NAMES) sources[name].clear(true);
  showTiles(facts);
  if (at) lookAt(at.u, at.v, at.zoom);
  else fitPhoto();
  if (!facts.there)
    say(`the file of photo ${facts.name} is not where it was; put it back`, "error");
  tell("photo", facts);
  loadPredictions();
}

function showTiles(facts) {
  const { width, height, levels, tile_size: tileSize } = facts;
  const extent = [-0.5, 0.5 - height, width - 0.5, 0.5];
  const projection = new ol.proj.Projection({
    code: `photo:${facts.photo}`,
    units: "pixels",
    extent,
    getPointResolution: (r) => r,
  });
  const resolutions = Array.from({ length: levels }, (_, z) => 2 ** (levels - 1 - z));
  layers.photo.setExtent(extent);
  layers.photo.setSource(
    new ol.source.TileImage({
      projection,
      tileGrid: new ol.tilegrid.TileGrid({
        origin: [-0.5, 0.5],
        extent,
        resolutions,
        tileSize,
      }),
      tileUrlFunction: ([z, x, y]) =>
        picture("view", "photo_tile", { photo: facts.photo, z: levels - 1 - z, x, y, v: "1" }),
      // Pixels must be seen as what they are where one is clicked.
      interpolate: false,
      transition: 0,
      wrapX: false,
    }),
  );
  viewer.setView(
    new ol.View({
      projection,
      center: [width / 2, -height / 2],
      minResolution: 1 / CLOSEST,
      maxResolution: 2 ** levels,
      resolution: 2 ** (levels - 1),
      rotation: northUp ? rotation(facts) : 0,
      constrainRotation: false,
    }),
  );
  viewer.getView().on("change:rotation", turnArrow);
  turnArrow();
}

const rotation = (facts) => (-(facts.north_deg ?? 0) * Math.PI) / 180;

function turnArrow() {
  const arrow = byId("north");
  const north = state.photo?.north_deg;
  // An element of SVG has no property `hidden`.
  arrow.toggleAttribute("hidden", north === null || north === undefined);
  const turned = ((north ?? 0) * Math.PI) / 180 + viewer.getView().getRotation();
  byId("needle").setAttribute("transform", `rotate(${(turned * 180) / Math.PI})`);
  // The letter stands before the tip, and upright.
  byId("north-letter").setAttribute("x", 29 * Math.sin(turned));
  byId("north-letter").setAttribute("y", 5 - 29 * Math.cos(turned));
  const text = `Grid north, ${Math.round(north ?? 0)}° clockwise from the top of the photo`;
  fill(arrow.querySelector("title"), text);
}

export function fitPhoto() {
  if (!state.photo) return;
  const { width, height } = state.photo;
  viewer.updateSize();
  viewer.getView().fit([-0.5, 0.5 - height, width - 0.5, 0.5], { padding: [8, 8, 8, 8] });
}

/** Show a pixel, at `zoom` screen pixels per photo pixel or closer. */
export function lookAt(u, v, zoom = 1) {
  const view = viewer.getView();
  view.setCenter([u, -v]);
  view.setResolution(Math.min(view.getResolution(), 1 / zoom));
}

export function toggleNorth() {
  northUp = !northUp;
  byId("north-up").setAttribute("aria-pressed", northUp);
  if (!state.photo) return;
  viewer.getView().animate({ rotation: northUp ? rotation(state.photo) : 0, duration: 250 });
}

/** The photo before or after the open one, in the order of the project. */
export function step(by) {
  const order = state.facts.photos_in_order ?? [];
  if (!order.length) return;
  const at = order.indexOf(state.photo?.photo);
  tell("open-photo", { photo: order[(at + by + order.length) % order.length] });
}

// -- what is shown over the photo -----------------------------------------------------------------

/** Control points and assets where the photo should show them. */
export async function loadPredictions() {
  const photo = state.photo?.photo;
  if (!photo) return;
  let found;
  try {
    found = await inPhoto({ photo });
  } catch (error) {
    say(error.message, "error");
    return;
  }
  if (!found || photo !== state.photo?.photo) return;
  sources.control.clear(true);
  sources.control.addFeatures(found.control.flatMap(controlFeatures));
  sources.assets.clear(true);
  sources.assets.addFeatures(found.assets.flatMap(assetFeatures));
}

function controlFeatures(point) {
  const marked = point.marked;
  const made = [];
  if (point.u !== null) {
    const ring = ellipse([point.u, point.v], point, styles.ellipse(styles.COLOURS.control));
    made.push(ring);
    // A mark must not be hidden by where it was expected.
    if (!marked) {
      made.push(
        feature([point.u, point.v], () =>
          styles.predicted(
            isSelected("control", point.name) ? styles.COLOURS.draft : styles.COLOURS.control,
            point.name,
          ),
        ),
      );
    }
  }
  if (marked) {
    const colour = marked.used === false ? "#666" : styles.COLOURS.control;
    made.push(feature(marked.at, styles.cross(colour, point.name)));
  }
  for (const one of made) one.set("control", point.name);
  return made;
}

function assetFeatures(asset) {
  const stored = state.assets.find((one) => one.id === asset.id);
  if (!stored) return [];
  const points = asset.uv.map(([u, v]) => [u, -v]);
  const geometry =
    asset.shape === "point"
      ? new ol.geom.Point(points[0])
      : asset.shape === "line"
        ? new ol.geom.LineString(points)
        : new ol.geom.Polygon([[...points, points[0]]]);
  const made = new ol.Feature(geometry);
  made.setStyle((_, resolution) => {
    const chosen = isSelected("asset", asset.id);
    const isNear = resolution < NEAR;
    return styles.asset(
      stored.colour,
      stored.label,
      asset.shape,
      chosen,
      chosen || isNear,
      isNear,
    );
  });
  made.set("asset", asset.id);
  const rings = asset.semi_major
    ? [ellipse(asset.uv[0], asset, styles.ellipse(stored.colour))]
    : [];
  return [...rings, made];
}

/** Ellipse of a predicted pixel at 95 %: 2.45 times the standard one. */
function ellipse([u, v], { semi_major: major, semi_minor: minor, azimuth_deg: azimuth }, style) {
  const turn = (azimuth * Math.PI) / 180;
  const ring = Array.from({ length: 49 }, (_, i) => {
    const t = (i / 48) * 2 * Math.PI;
    const [along, across] = [2.45 * major * Math.cos(t), 2.45 * minor * Math.sin(t)];
    return [
      u + along * Math.sin(turn) + across * Math.cos(turn),
      -v + along * Math.cos(turn) - across * Math.sin(turn),
    ];
  });
  const made = new ol.Feature(new ol.geom.Polygon([ring]));
  made.setStyle(style);
  return made;
}

function feature([u, v], style) {
  const made = new ol.Feature(new ol.geom.Point([u, -v]));
  made.setStyle(style);
  return made;
}

/** Crosses and lines of what is being measured, in the open photo. */
export function showDraft(features) {
  sources.draft.clear(true);
  sources.draft.addFeatures(features);
}

/** Where a click in another photo must be seen: a line with its band of one sigma. */
export function showGuides(guides) {
  sources.guides.clear(true);
  for (const { line, sigma_px: sigma, predicted } of guides) {
    if (line?.length > 1) {
      const band = new ol.Feature(new ol.geom.Polygon([around(line, sigma)]));
      band.setStyle(styles.guideBand);
      const middle = new ol.Feature(new ol.geom.LineString(line.map(([u, v]) => [u, -v])));
      middle.setStyle(styles.guide);
      sources.guides.addFeatures([band, middle]);
    }
    if (predicted) {
      const ring = ellipse(
        [predicted.u, predicted.v],
        predicted,
        styles.ellipse(styles.COLOURS.draft),
      );
      const place = feature([predicted.u, predicted.v], styles.predicted(styles.COLOURS.draft, ""));
      sources.guides.addFeatures([ring, place]);
    }
  }
}

/** Where the photo shows the place that was asked for; null takes the mark away. */
export function showSeen(sight) {
  sources.seen.clear(true);
  if (!sight) return;
  const ring = ellipse([sight.u, sight.v], sight, styles.ellipse(styles.COLOURS.draft));
  sources.seen.addFeatures([
    ring,
    feature([sight.u, sight.v], styles.cross(styles.COLOURS.draft, "", 14)),
  ]);
}

function around(line, sigma) {
  const side = (sign) =>
    line.map(([u, v], i) => {
      const [a, b] = [line[Math.max(0, i - 1)], line[Math.min(line.length - 1, i + 1)]];
      const [du, dv] = [b[0] - a[0], b[1] - a[1]];
      const length = Math.hypot(du, dv) || 1;
      const off = (sign * (sigma[i] ?? sigma[0] ?? 1)) / length;
      return [u - dv * off, -(v + du * off)];
    });
  const ring = [...side(1), ...side(-1).reverse()];
  return [...ring, ring[0]];
}

/** Mark where the map's cursor is seen; null takes the mark away. */
export function showCursor(sight) {
  sources.cursor?.clear(true);
  if (sight)
    sources.cursor.addFeature(
      feature([sight.u, sight.v], styles.cross(styles.COLOURS.cursor, "", 12)),
    );
}

on("selected", () => NAMES.forEach((name) => layers[name]?.changed()));
on("tool", (tool) => byId("photo").classList.toggle("aims", tool !== "look"));
on("assets", () => loadPredictions());
on("control", () => loadPredictions());

// -- clicks ---------------------------------------------------------------------------------------

const inside = (u, v) =>
  u >= -0.5 && v >= -0.5 && u < state.photo.width - 0.5 && v < state.photo.height - 0.5;

function clicked(event) {
  if (!state.photo) return;
  const [u, v] = [event.coordinate[0], -event.coordinate[1]];
  if (!inside(u, v)) return;
  if (state.tool !== "look") {
    tell("photo-click", { photo: state.photo.photo, u, v });
    return;
  }
  const hit = nearest(viewer, event.coordinate, [layers.assets, layers.control], nameOf);
  if (hit) select(...nameOf(hit.feature));
}

const nameOf = (one) =>
  one.get("asset")
    ? ["asset", one.get("asset")]
    : one.get("control")
      ? ["control", one.get("control")]
      : null;

const told = throttled((place) => tell("photo-place", place), 120);

function moved(event) {
  if (event.dragging || !state.photo) return;
  const [u, v] = [event.coordinate[0], -event.coordinate[1]];
  const place = inside(u, v) ? { photo: state.photo.photo, u, v } : null;
  tell("photo-cursor", place);
  if (place) told(place);
}

export function clickMiddle() {
  if (!viewer || !state.photo) return;
  clicked({ coordinate: viewer.getView().getCenter() });
}
