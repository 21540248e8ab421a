// The map: mosaic, layers of the project, what is being measured.

import { ask, picture } from "./api.js";
import { byId, say, throttled } from "./dom.js";
import { nearest } from "./hits.js";
import { scaleBar } from "./scalebar.js";
import * as styles from "./styles.js";
import { isSelected, on, select, state, tell } from "./store.js";

const CODE = "georef-map";
// names of layers and what the panel calls them, from the top down
export const LAYERS = [
  ["control", "Control and check points"],
  ["assets", "Assets"],
  ["ellipses", "Error ellipses (95 %) of assets"],
  ["photos", "Photos (orange rim: doubtful)"],
  ["trajectory", "Flight track"],
  ["footprints", "Footprints"],
  ["seams", "Seams of the mosaic"],
  ["mosaic", "Mosaic"],
];
const HIDDEN = new Set(["seams"]);

let map = null;
const layers = {};
const sources = {};
const json = new ol.format.GeoJSON();

/** Make the map of a project. */
export function makeMap() {
  const { facts } = state;
  const metres = facts.crs?.metres_per_unit ?? 1;
  const projection = new ol.proj.Projection({
    code: CODE,
    units: "m",
    getPointResolution: (resolution) => resolution * metres,
  });
  map?.setTarget(null);
  for (const [name] of [...LAYERS].reverse()) layers[name] = makeLayer(name, projection);
  layers.draft = vector("draft", 30);
  layers.seen = vector("seen", 29);
  layers.cursor = vector("cursor", 31);
  const extent = facts.map?.extent ?? facts.extent ?? [0, 0, 1, 1];
  const size = Math.max(extent[2] - extent[0], extent[3] - extent[1]);
  map = new ol.Map({
    target: byId("map"),
    layers: [
      ...LAYERS.map(([name]) => layers[name]).reverse(),
      layers.seen,
      layers.draft,
      layers.cursor,
    ],
    controls: ol.control.defaults
      .defaults({ attribution: false, rotate: false })
      .extend([scaleBar(groundResolution)]),
    interactions: ol.interaction.defaults.defaults({
      altShiftDragRotate: false,
      pinchRotate: false,
      doubleClickZoom: false,
    }),
    view: new ol.View({
      projection,
      center: [(extent[0] + extent[2]) / 2, (extent[1] + extent[3]) / 2],
      minResolution: size / 400000,
      maxResolution: size / 100,
      resolution: size / 600,
    }),
  });
  map.on("click", clicked);
  map.on("pointermove", moved);
  map.getView().on("change:resolution", () => tell("map-scale"));
  fit();
  return map;
}

function vector(name, zIndex) {
  sources[name] = new ol.source.Vector({ wrapX: false });
  return new ol.layer.Vector({ source: sources[name], zIndex, declutter: false });
}

function makeLayer(name, projection) {
  if (name === "mosaic") return new ol.layer.Tile({ source: mosaicSource(projection), zIndex: 0 });
  const order = LAYERS.length - LAYERS.findIndex(([one]) => one === name);
  const layer = vector(name, order);
  layer.setVisible(!HIDDEN.has(name));
  layer.setStyle(STYLES[name]);
  return layer;
}

/** The mosaic's own pyramid is the tile grid: nothing is resampled on the way. */
function mosaicSource(projection) {
  const { map: raster, revisions } = state.facts;
  if (!raster) return null;
  const levels = [...raster.levels].reverse();
  return new ol.source.TileImage({
    projection,
    tileGrid: new ol.tilegrid.TileGrid({
      origin: raster.origin,
      extent: raster.extent,
      resolutions: levels.map((level) => level.factor * raster.resolution),
      tileSize: raster.tile_size,
    }),
    tileUrlFunction: ([z, x, y]) =>
      picture("view", "map_tile", {
        name: raster.name,
        z: levels.length - 1 - z,
        x,
        y,
        v: revisions.mosaic,
      }),
    transition: 0,
    wrapX: false,
  });
}

const STYLES = {
  photos: (feature) =>
    styles.photoPoint(
      feature.getId() === state.photo?.photo,
      feature.get("doubts")?.length > 0 || !feature.get("pose"),
    ),
  footprints: (feature) =>
    feature.getId() === state.photo?.photo ? styles.current : styles.footprint,
  trajectory: styles.trajectory,
  seams: styles.seam,
  control: (feature) =>
    styles.controlPoint(
      feature.get("name"),
      feature.get("role"),
      isSelected("control", feature.getId()),
    ),
  assets: (feature, resolution) =>
    styles.asset(
      feature.get("colour"),
      feature.get("label"),
      feature.get("shape"),
      isSelected("asset", feature.getId()),
      resolution * (state.facts.crs?.metres_per_unit ?? 1) < 0.35,
    ),
  ellipses: (feature) => styles.ellipse(feature.get("colour")),
};

/** Read the project's own layers anew. */
export async function loadLayers(
  names = ["photos", "footprints", "trajectory", "seams"],
) {
  await Promise.all(
    names.map(async (name) => {
      try {
        show(name, await ask("view", "layer", { name }));
      } catch (error) {
        say(error.message, "error");
      }
    }),
  );
}

/** Put GeoJSON into a layer. */
export function show(name, collection) {
  sources[name]?.clear(true);
  sources[name]?.addFeatures(json.readFeatures(collection));
}

export function showDraft(features) {
  sources.draft.clear(true);
  sources.draft.addFeatures(features);
}

/** Mark the place whose photos are listed; null takes the mark away. */
export function showSeen(place) {
  sources.seen.clear(true);
  if (!place) return;
  const point = new ol.Feature(new ol.geom.Point([place.x, place.y]));
  point.setStyle(styles.cross(styles.COLOURS.draft, "", 14));
  sources.seen.addFeature(point);
}

/** Mark the place under the photo's cursor; null takes the mark away. */
export function showCursor(place) {
  if (!map) return;
  sources.cursor.clear(true);
  if (!place) return;
  const point = new ol.Feature(new ol.geom.Point([place.x, place.y]));
  point.setStyle(styles.cross(styles.COLOURS.cursor, "", 12));
  sources.cursor.addFeature(point);
  if (place.ellipse?.length) {
    const ring = new ol.Feature(new ol.geom.Polygon([place.ellipse]));
    ring.setStyle(styles.ellipse(styles.COLOURS.cursor));
    sources.cursor.addFeature(ring);
  }
}

export const isVisible = (name) => layers[name]?.getVisible() ?? false;
export const setVisible = (name, visible) => layers[name]?.setVisible(visible);
export const count = (name) => sources[name]?.getFeatures().length ?? 0;
export const getMap = () => map;

/** Metres on the ground per pixel of the screen. */
export function groundResolution() {
  return (map?.getView().getResolution() ?? 1) * (state.facts.crs?.metres_per_unit ?? 1);
}

export function fit() {
  const { facts } = state;
  const extent = facts.map?.extent ?? facts.extent;
  if (extent) map.getView().fit(extent, { padding: [24, 24, 24, 24], size: map.getSize() });
}

/** Show a place, zoomed in if it is seen from afar. */
export function goTo(x, y, metresPerPixel = 0.03) {
  const resolution = metresPerPixel / (state.facts.crs?.metres_per_unit ?? 1);
  const view = map.getView();
  view.animate({
    center: [x, y],
    resolution: Math.min(view.getResolution(), resolution),
    duration: 250,
  });
}

/** Bring a place into sight, as near as the map is. */
export function reveal(x, y) {
  if (!inView(x, y)) map.getView().animate({ center: [x, y], duration: 200 });
}

export const inView = (x, y) => ol.extent.containsXY(map.getView().calculateExtent(), x, y);

function refresh(...names) {
  for (const name of names) layers[name]?.changed();
}

/** Control points as their file has them now, which no tool need have read yet. */
function drawControl(points) {
  const features = points.map(({ name, role, x, y }) => ({
    type: "Feature",
    id: name,
    geometry: { type: "Point", coordinates: [x, y] },
    properties: { name, role },
  }));
  show("control", { type: "FeatureCollection", features });
}

on("control", drawControl);
on("photo", () => refresh("photos", "footprints"));
on("selected", () => refresh("assets", "control"));
on("tool", (tool) => byId("map").classList.toggle("aims", tool !== "look"));

function clicked(event) {
  const [x, y] = event.coordinate;
  if (state.tool !== "look" && state.tool !== "mark") {
    tell("map-click", { x, y });
    return;
  }
  const hit = featureAt(event.coordinate);
  if (!hit) return;
  if (hit.name === "photos") tell("open-photo", { photo: hit.id });
  else select(hit.name === "assets" ? "asset" : "control", hit.id);
}

const CHOSEN = ["assets", "control", "photos"];

function featureAt(coordinate) {
  const hit = nearest(
    map,
    coordinate,
    CHOSEN.map((name) => layers[name]),
  );
  if (!hit) return null;
  return { name: CHOSEN.find((name) => layers[name] === hit.layer), id: hit.feature.getId() };
}

const told = throttled((x, y) => tell("map-place", { x, y }), 120);

function moved(event) {
  if (event.dragging) return;
  const [x, y] = event.coordinate;
  tell("map-cursor", { x, y });
  told(x, y);
  const aims = state.tool !== "look" && state.tool !== "mark";
  byId("map").classList.toggle("hits", !aims && Boolean(featureAt(event.coordinate)));
}

/** What a click at the middle would do: for those who have no mouse. */
export function clickMiddle() {
  clicked({ coordinate: map.getView().getCenter() });
}
