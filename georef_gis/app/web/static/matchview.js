// What was found in the other photos: to look at, to accept or to reject, and what it would change.

import { button, el } from "./dom.js";
import { activeVertex, draft } from "./draft.js";
import { fixed, plural, short } from "./format.js";
import * as matching from "./matching.js";
import { state, tell } from "./store.js";

/** Button and answer for the active vertex. */
export function matchView() {
  if (!activeVertex()) return null;
  const looking = matching.isLooking();
  return el(
    "div",
    { class: "matching" },
    button(looking ? "Looking in the photos …" : "Find it in the other photos", matching.find, {
      disabled: looking,
      title: "Look for this click in the other photos (G)",
    }),
    proposalView(),
  );
}

function proposalView() {
  const found = matching.getProposal();
  if (!found || found.vertex !== draft.active) return null;
  const count = matching.taken().length;
  return el(
    "div",
    { class: "proposal", role: "group", "aria-label": "Found in other photos" },
    found.whyNot ? el("p", { class: "hint" }, found.whyNot) : null,
    found.doubts.map((line) => el("p", { class: "doubt" }, line)),
    found.found.length ? change(found) : null,
    el("ul", { class: "rays" }, found.found.map(row)),
    refusals(found.refused),
    el(
      "div",
      { class: "row" },
      found.found.length
        ? button(`Take ${plural(count, "click")}`, matching.take, {
            class: "main small",
            disabled: !count,
          })
        : null,
      button(found.found.length ? "Discard" : "Close", matching.discard, { class: "small" }),
    ),
  );
}

const row = (click) =>
  el(
    "li",
    {},
    el("input", {
      type: "checkbox",
      checked: click.taken,
      "aria-label": `Accept the click in ${click.photo}`,
      on: { change: () => matching.toggle(click) },
    }),
    button(
      click.photo,
      () => tell("open-photo", { photo: click.photo, at: { u: click.u, v: click.v, zoom: 3 } }),
      {
        class: "small quiet name",
        title: "Open this photo there",
        "aria-pressed": click.photo === state.photo?.photo,
      },
    ),
    el(
      "span",
      { class: "note", title: "Correlation of the pictures; one sigma of the match" },
      `${Math.round(100 * click.quality)} %, ± ${fixed(click.sigma_match_px, 2)} px`,
    ),
  );

/** The place before and after, and how far it moves. */
function change({ before, after }) {
  if (!after) return el("p", { class: "note" }, "None is accepted: the place stays as it is.");
  const level = (one) => Math.hypot(one.sigma_e_m, one.sigma_n_m) / Math.SQRT2;
  if (!before) return el("p", { class: "value" }, `± ${short(level(after))}`);
  return el(
    "div",
    {},
    el("p", { class: "value" }, `± ${short(level(before))} → ± ${short(level(after))}`),
    el("p", { class: "note" }, `${moved(before, after)}; up ± ${short(after.sigma_u_m)}`),
  );
}

function moved(before, after) {
  const unit = state.facts.crs.metres_per_unit;
  const away = [after.easting - before.easting, after.northing - before.northing];
  const length = Math.hypot(...away) * unit;
  const expected = Math.hypot(before.sigma_e_m, before.sigma_n_m);
  const how = length > 2.5 * expected ? ", more than its sigma lets expect" : "";
  const up = after.height_ellipsoidal_m - before.height_ellipsoidal_m;
  return `moves ${short(length)} level${how}, ${short(Math.abs(up))} ${up < 0 ? "down" : "up"}`;
}

function refusals(refused) {
  if (!refused.length) return null;
  return el(
    "details",
    {},
    el("summary", {}, `Not found in ${plural(refused.length, "photo")}`),
    el(
      "ul",
      { class: "told-list" },
      refused.map(({ photo, why }) => el("li", { class: "note" }, `${photo}: ${why}`)),
    ),
  );
}
