// What is being measured, drawn on the map and in the photo.

import { latest } from "./api.js";
import { say } from "./dom.js";
import { activeVertex, draft, point, sent } from "./draft.js";
import * as map from "./mapview.js";
import { getProposal, taken } from "./matching.js";
import * as photo from "./photoview.js";
import { on, state } from "./store.js";
import * as styles from "./styles.js";

const guides = latest("measure", "guides");

const label = (i) => (draft.shape === "point" ? "" : String(i + 1));

function styled(geometry, style) {
  const made = new ol.Feature(geometry);
  made.setStyle(style);
  return made;
}

function path(points) {
  if (draft.shape === "line" && points.length > 1) {
    return styled(new ol.geom.LineString(points), styles.draftLine);
  }
  if (draft.shape === "polygon" && points.length > 2) {
    return styled(new ol.geom.Polygon([[...points, points[0]]]), styles.draftArea);
  }
  return null;
}

function drawMap() {
  const places = draft.vertices.map((_, i) => point(i));
  const known = places.filter(Boolean);
  const features = known.map((one) =>
    styled(new ol.geom.Polygon([one.ellipse]), styles.ellipse(styles.COLOURS.draft)),
  );
  const line = path(known.map((one) => [one.easting, one.northing]));
  if (line) features.push(line);
  places.forEach((one, i) => {
    if (!one) return;
    const place = new ol.geom.Point([one.easting, one.northing]);
    features.push(styled(place, styles.cross(styles.COLOURS.draft, label(i))));
  });
  const after = getProposal()?.after;
  if (after) {
    const ring = new ol.geom.Polygon([after.ellipse]);
    features.push(styled(ring, styles.ellipse(styles.COLOURS.proposed)));
  }
  map.showDraft(features);
}

let revealed = "";

/** The map follows what is clicked in a photo, once for each place. */
function follow() {
  const one = point(draft.active);
  const place = one ? `${one.easting} ${one.northing}` : "";
  if (one && place !== revealed) map.reveal(one.easting, one.northing);
  revealed = place;
}

function drawPhoto() {
  const shown = state.photo?.photo;
  if (!shown) return;
  const clicks = draft.vertices.map(({ clicks: all }) => all.find((one) => one.photo === shown));
  const features = [];
  const line = path(clicks.filter(Boolean).map(({ u, v }) => [u, -v]));
  if (line) features.push(line);
  clicks.forEach((click, i) => {
    if (!click) return;
    const ray = point(i)?.rays.find((one) => one.photo === shown);
    const colour = ray && !ray.used ? "#a61b1b" : styles.COLOURS.draft;
    const text = ray && !ray.used ? "left out" : label(i);
    features.push(styled(new ol.geom.Point([click.u, -click.v]), styles.cross(colour, text)));
  });
  for (const one of getProposal() ? taken() : []) {
    if (one.photo !== shown) continue;
    const text = `found, ${Math.round(100 * one.quality)} %`;
    const place = new ol.geom.Point([one.u, -one.v]);
    features.push(styled(place, styles.cross(styles.COLOURS.proposed, text)));
  }
  photo.showDraft(features);
}

/** Where the active vertex must be in this photo, by its clicks in others. */
async function drawGuides() {
  const shown = state.photo?.photo;
  const vertex = activeVertex();
  const others = vertex?.clicks.filter((click) => click.photo !== shown) ?? [];
  if (!shown || !others.length || vertex.clicks.some((click) => click.photo === shown)) {
    photo.showGuides([]);
    return;
  }
  const predicted = draft.sights.find((sight) => sight.photo === shown);
  try {
    const found = await guides({ photo: shown, clicks: sent(others) });
    if (!found || state.photo?.photo !== shown) return;
    photo.showGuides([...found.guides, ...(predicted ? [{ predicted }] : [])]);
  } catch (error) {
    photo.showGuides([]);
    say(error.message, "error");
  }
}

on("draft", () => {
  drawMap();
  follow();
  drawPhoto();
  drawGuides();
});
on("sights", drawGuides);
on("match", () => {
  drawMap();
  drawPhoto();
});
on("photo", () => {
  drawPhoto();
  drawGuides();
});
