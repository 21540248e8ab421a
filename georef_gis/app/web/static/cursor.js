// What is told of the place under the cursor, and its mark in the other view.

import { latest } from "./api.js";
import { byId, fill, say } from "./dom.js";
import { coordinate, degrees, measured, pixel, short } from "./format.js";
import * as map from "./mapview.js";
import * as photo from "./photoview.js";
import { on, state } from "./store.js";

const at = latest("measure", "at");
const placeOf = latest("measure", "place");
const lines = { place: "", height: "" };

function showPlace(place, height) {
  lines.place = place;
  lines.height = height;
  fill(byId("place"), place);
  fill(byId("height"), height);
}

const mapText = (x, y) => `E ${coordinate(x)}  N ${coordinate(y)} ${state.facts.crs.unit}`;

on("map-cursor", ({ x, y }) => state.facts.crs && showPlace(mapText(x, y), lines.height));
on("map-place", async ({ x, y }) => {
  if (!state.facts.crs) return;
  try {
    const found = await at({ x, y, photo: state.photo?.photo ?? null });
    if (!found) return;
    const height = measured(found.height_ellipsoidal_m, found.sigma_u_m);
    const trust = found.sigma_e_m
      ? `   ± ${short(found.sigma_e_m)} E, ${short(found.sigma_n_m)} N`
      : "";
    showPlace(
      mapText(x, y),
      found.why_not
        ? "no height known here"
        : `${degrees(found.lat_deg, found.lon_deg)}${trust}   h ${height}`,
    );
    photo.showCursor(found.seen ?? null);
  } catch (error) {
    say(error.message, "error");
  }
});
on("photo-cursor", (place) => {
  if (place) return;
  map.showCursor(null);
});
on("photo-place", async (place) => {
  try {
    const found = await placeOf(place);
    if (!found) return;
    if (found.why_not) {
      showPlace(pixel(place.u, place.v), found.why_not);
      map.showCursor(null);
      return;
    }
    showPlace(
      `${pixel(place.u, place.v)}   ${mapText(found.x, found.y)}`,
      `± ${short(found.sigma_e_m)} E, ${short(found.sigma_n_m)} N` +
        `   h ${measured(found.height_ellipsoidal_m, found.sigma_u_m)}`,
    );
    map.showCursor(found);
  } catch (error) {
    say(error.message, "error");
  }
});
on("map-scale", () => {
  if (!state.facts.crs) return;
  // 96 pixels to the inch, as CSS counts
  const scale = map.groundResolution() / 0.000264583;
  fill(byId("scale"), `1 : ${coordinate(Number(scale.toPrecision(2)), 0)}`);
});
