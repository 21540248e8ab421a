// A hint, never a refusal: what is being stored may be stored already.

import { unit } from "./assets.js";
import { classOf } from "./assetform.js";
import { button, el, fill, say } from "./dom.js";
import { draft, point } from "./draft.js";
import { short } from "./format.js";
import { on, select, state } from "./store.js";

// Clicks of one thing in one photo lie so close together, px: a photo tells things apart that lie
// within the sigmas of their places.
const ONE_THING_PX = 12;
const SIGMAS = 3;
// m; sigmas may be smaller than a hand is steady on a cone, and so large that all is near to all
const LEAST = 0.1;
const MOST = 3;

/** How near a vertex of the draft is to a vertex of an asset, m; null if it is another thing. */
function distance(vertex, place, asset, number) {
  const [x, y] = asset.vertices[number];
  const away = Math.hypot(place.easting - x, place.northing - y) * unit();
  const clicks = asset.clicks.filter((click) => (click.vertex ?? 0) === number);
  const both = vertex.clicks.flatMap((mine) =>
    clicks
      .filter(({ photo }) => photo === mine.photo)
      .map((theirs) => Math.hypot(mine.u - theirs.u, mine.v - theirs.v)),
  );
  if (both.length) return Math.min(...both) <= ONE_THING_PX ? away : null;
  const { sigma_e: east = 0, sigma_n: north = 0 } = asset.quality ?? {};
  const sigma = Math.hypot(place.sigma_e_m, place.sigma_n_m, east ?? 0, north ?? 0);
  return away <= Math.min(Math.max(SIGMAS * sigma, LEAST), MOST) ? away : null;
}

/** The largest distance of the draft's vertices from those of an asset; null if one has none. */
function apart(asset) {
  let largest = 0;
  for (const [i, vertex] of draft.vertices.entries()) {
    const place = point(i);
    if (!place) return null;
    const each = asset.vertices.map((_, number) => distance(vertex, place, asset, number));
    const near = each.filter((one) => one !== null);
    if (!near.length) return null;
    largest = Math.max(largest, Math.min(...near));
  }
  return largest;
}

/** The stored asset of a class that what is being measured may be. */
function alike(kind) {
  if (draft.editing || !draft.vertices.length) return null;
  const found = state.assets
    .filter((asset) => asset.kind === kind && asset.shape === draft.shape)
    .map((asset) => ({ asset, away: apart(asset) }))
    .filter(({ away }) => away !== null)
    .sort((a, b) => a.away - b.away);
  return found[0] ?? null;
}

let last = null;

function show() {
  const place = document.querySelector("#panel-measure .alike");
  if (!place) return;
  const kind = document.querySelector("#panel-measure select.kind").value;
  const found = alike(kind);
  if (!found) fill(place);
  else {
    const name = found.asset.name ? `“${found.asset.name}”` : "one without a name";
    const title = classOf(kind)?.title ?? kind;
    fill(
      place,
      el("p", { class: "doubt" }, `${title} ${name} is stored ${short(found.away)} from here: is it the same?`),
      button("Look at it", () => select("asset", found.asset.id), { class: "small" }),
    );
    // The form may be out of sight.
    if (last !== found.asset.id) say(`${title} ${name} is stored here already`);
  }
  last = found?.asset.id ?? null;
}

on("draft", show);
on("assets", show);
on("asset-kind", show);
