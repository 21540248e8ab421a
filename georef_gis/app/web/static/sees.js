// Who sees it: the photos that show a place, best first.

import { latest } from "./api.js";
import { button, el, say } from "./dom.js";
import { coordinate, fixed, plural, short } from "./format.js";
import * as map from "./mapview.js";
import * as photo from "./photoview.js";
import { on, state, tell } from "./store.js";

const sightsAt = latest("measure", "sights");
const placeOf = latest("measure", "place");
let seen = null;

async function ask({ x, y, height = null }) {
  try {
    const found = await sightsAt({ x, y, height });
    if (!found) return;
    seen = { x, y, sights: found.sights };
    show();
  } catch (error) {
    say(error.message, "error");
  }
}

function show() {
  map.showSeen(seen);
  photo.showSeen(seen?.sights.find((sight) => sight.photo === state.photo?.photo) ?? null);
  tell("seen");
}

const open = (sight) =>
  tell("open-photo", { photo: sight.photo, at: { u: sight.u, v: sight.v, zoom: 1 } });

/** What the panel says of the place. */
export function seenView() {
  if (!seen) return null;
  const { unit } = state.facts.crs;
  return el(
    "section",
    { class: "part" },
    el(
      "h2",
      {},
      seen.sights.length ? `Seen in ${plural(seen.sights.length, "photo")}` : "No photo shows it",
    ),
    el(
      "p",
      { class: "note" },
      `E ${coordinate(seen.x)}  N ${coordinate(seen.y)} ${unit}, on the ground`,
    ),
    el(
      "div",
      { class: "sights" },
      seen.sights.map((sight) => {
        const made = button(sight.photo, () => open(sight), {
          class: "small",
          "aria-pressed": sight.photo === state.photo?.photo,
        });
        made.append(
          el(
            "span",
            { class: "note" },
            `± ${fixed(sight.semi_major, 1)} px, ${short(sight.gsd_m)}/px`,
          ),
        );
        return made;
      }),
    ),
  );
}

on("map-click", (place) => state.tool === "see" && ask(place));
on("photo-click", async (click) => {
  if (state.tool !== "see") return;
  try {
    const place = await placeOf(click);
    if (place?.why_not) say(place.why_not, "error");
    else if (place) ask(place);
  } catch (error) {
    say(error.message, "error");
  }
});
on("photo", () => seen && show());
on("tool", (tool) => {
  if (tool === "see" || !seen) return;
  seen = null;
  show();
});
