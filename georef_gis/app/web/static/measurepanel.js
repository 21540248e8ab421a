// The panel of what is being measured: places, lengths, photos that show it, storing it.

import { assetForm, classOf } from "./assetform.js";
import { addAsset, measureAnew } from "./assets.js";
import { button, byId, el, fill, say } from "./dom.js";
import * as drafts from "./draft.js";
import { draft } from "./draft.js";
import { fixed, pixel, plural, short } from "./format.js";
import { getProposal } from "./matching.js";
import { matchView } from "./matchview.js";
import { resultView } from "./measureresult.js";
import { seenView } from "./sees.js";
import { on, select, state, tell } from "./store.js";

const HINTS = {
  look: "Choose Point, Line or Area above, then click in a photo or on the map.",
  point:
    "Click the object in a photo. Click it in further photos too: the place becomes better, " +
    "and a wrong click is found.",
  line:
    "Click along the line: each click is a vertex. To better one, choose it below and click it " +
    "in another photo.",
  area:
    "Click the corners in their order. To better one, choose it below and click it in another " +
    "photo.",
  mark: "Click the control point in the photo.",
  see: "Click a place on the map or in a photo: the photos that show it are listed, best first.",
};
const WORDS = { point: "point", line: "line", polygon: "area" };

// What was entered last for a shape is proposed for the next one.
const entered = {};
let form = null;
let storing = false;

export function drawPanel() {
  const panel = byId("panel-measure");
  if (panel.hidden) return;
  if (!panel.childElementCount) {
    // The form stays where it is while one types into it; the buttons are always in sight.
    panel.append(el("div"), el("div"), el("div", { class: "actions" }));
  }
  const [top, bottom, actions] = panel.children;
  const hint = el("p", { class: "hint" }, HINTS[state.tool]);
  if (state.tool === "see" || !draft.vertices.length) {
    form = null;
    fill(top, hint, state.tool === "see" ? seenView() : null);
    fill(bottom);
    actions.hidden = true;
    return;
  }
  // Who has clicked knows how: the room is needed for what came of it.
  fill(top, resultView(), vertices(), nextClick(), sights());
  store(bottom, actions);
}

// -- vertices and their clicks --------------------------------------------------------------------

function vertices() {
  return el(
    "section",
    { class: "part" },
    el("h2", {}, draft.shape === "point" ? "Clicks" : "Vertices"),
    el(
      "ul",
      { class: "list" },
      draft.vertices.map((vertex, i) => {
        const one = drafts.point(i);
        const title =
          draft.shape === "point"
            ? methodOf(one)
            : `${i + 1}: ${one ? `± ${short(one.semi_major_m / 2.4477)}` : "…"}`;
        return el(
          "li",
          { class: i === draft.active ? "active" : "" },
          el(
            "div",
            { class: "top" },
            el("strong", {}, title),
            draft.shape === "point"
              ? null
              : button(i === draft.active ? "chosen" : "choose", () => drafts.activate(i), {
                  class: "small",
                  "aria-pressed": i === draft.active,
                }),
            draft.shape === "point"
              ? null
              : button("×", () => drafts.removeVertex(i), {
                  class: "small",
                  "aria-label": `Remove vertex ${i + 1}`,
                }),
          ),
          drafts.refusal(i) ? el("p", { class: "bad" }, drafts.refusal(i)) : null,
          el(
            "ul",
            { class: "rays" },
            vertex.clicks.map((click) => ray(click, one, i)),
          ),
        );
      }),
    ),
    onGround(),
    doubts(),
  );
}

/** Whether it lies on the ground: asked for where several photos show it. */
function onGround() {
  if (!draft.onGround && draft.vertices.every(({ clicks }) => clicks.length < 2)) return null;
  return el(
    "label",
    {
      class: "check",
      title:
        "The ground's height counts too, unless it contradicts the photos. Not for what stands " +
        "above it: the top of a cone, the face of a sign.",
    },
    el("input", {
      type: "checkbox",
      checked: draft.onGround,
      on: { change: (event) => drafts.setOnGround(event.target.checked) },
    }),
    "Clicked on the ground",
  );
}

/** Each doubt once, with the vertices that it is about. */
function doubts() {
  const about = new Map();
  draft.vertices.forEach((_, i) => {
    for (const line of drafts.point(i)?.doubts ?? []) {
      about.set(line, [...(about.get(line) ?? []), i + 1]);
    }
  });
  return [...about].map(([line, of]) => {
    const all = of.length === draft.vertices.length;
    const head = all ? "" : `${of.length > 1 ? "vertices" : "vertex"} ${of.join(", ")}: `;
    return el("p", { class: "doubt" }, head + line);
  });
}

const methodOf = (one) =>
  !one
    ? "…"
    : one.method === "locate"
      ? "One photo and the ground"
      : `${plural(one.n_rays, "photo")}${one.method === "intersect" ? ", intersected" : " and the ground"}`;

const matchWords = ({ quality }) => `matched ${Math.round(100 * quality)} %`;

function ray(click, one, i) {
  const found = one?.rays.find(({ photo }) => photo === click.photo);
  const isOut = found && !found.used;
  const off =
    found && one.method !== "locate"
      ? `off ${fixed(Math.hypot(...found.residual_px), 2)} px`
      : pixel(click.u, click.v, 0);
  return el(
    "li",
    {},
    button(
      click.photo,
      () => tell("open-photo", { photo: click.photo, at: { u: click.u, v: click.v, zoom: 1 } }),
      { class: "small quiet name", title: "Open this photo there" },
    ),
    isOut ? el("span", { class: "left-out" }, "left out") : null,
    click.matched
      ? el("span", { class: "note", title: "Found by its picture" }, `${matchWords(click)},`)
      : null,
    el("span", {}, off),
    button("×", () => drafts.removeClick(i, click.photo), {
      class: "small",
      "aria-label": `Remove the click in ${click.photo}`,
    }),
  );
}

function nextClick() {
  if (draft.shape === "point") return null;
  const option = (same, text) =>
    el(
      "label",
      { class: "check" },
      el("input", {
        type: "radio",
        name: "same",
        checked: draft.same === same,
        on: { change: () => drafts.setSame(same) },
      }),
      text,
    );
  return el(
    "fieldset",
    {},
    el("legend", {}, "The next click is"),
    option(false, "a new vertex (N)"),
    option(true, `vertex ${draft.active + 1} in another photo (S)`),
  );
}

/** Photos that show the active vertex, best first. */
function sights() {
  const clicked = new Set(drafts.activeVertex()?.clicks.map(({ photo }) => photo));
  for (const { photo } of getProposal()?.found ?? []) clicked.add(photo);
  const others = draft.sights.filter(({ photo }) => !clicked.has(photo));
  const found = matchView();
  if (!others.length) return found;
  const row = (sight) =>
    button(
      sight.photo,
      () => {
        if (draft.shape !== "point") drafts.setSame(true);
        tell("open-photo", { photo: sight.photo, at: { u: sight.u, v: sight.v, zoom: 1 } });
      },
      { class: "small" },
    );
  return el(
    "section",
    { class: "part" },
    el(
      "h2",
      {},
      draft.shape === "point" ? "Also seen in" : `Vertex ${draft.active + 1} is also seen in`,
    ),
    found,
    el(
      "div",
      { class: "sights" },
      others.slice(0, 8).map((sight) => {
        const made = row(sight);
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
    others.length > 8 ? el("p", { class: "note" }, `and ${others.length - 8} more`) : null,
    el("p", { class: "note" }, "Click it there too, best in a photo from well apart: a wrong click or height then shows."),
  );
}

// -- storing --------------------------------------------------------------------------------------

function store(place, actions) {
  actions.hidden = false;
  const key = draft.editing ? `anew ${draft.editing.id}` : draft.shape;
  if (form?.key !== key) {
    form = draft.editing ? anewForm() : newForm();
    form.key = key;
    fill(place, form.node);
    fill(
      actions,
      form.button,
      button("Step back", drafts.stepBack, { title: "Take the last click back (Backspace)" }),
      button(
        draft.editing ? "Stop" : draft.shape === "point" ? "New point" : "Clear",
        drafts.clear,
      ),
    );
  }
  form.button.disabled = storing || !drafts.isComplete();
}

function anewForm() {
  return {
    button: button("Store the new place", saveAnew, { class: "main" }),
    node: el("section", { class: "part" }, el("h2", {}, `Measure “${draft.editing.label}” anew`)),
  };
}

function newForm() {
  const store = button("", save, { class: "main", title: "Ctrl Enter" });
  // The form may be out of sight: what is stored is said where it is stored.
  const name = (kind) => fill(store, `Store as ${classOf(kind)?.title ?? "…"}`);
  const made = assetForm(draft.shape, entered[draft.shape] ?? {}, name);
  name(made.content().kind);
  const title = el("h2", {}, `Store the ${WORDS[draft.shape]} as an asset`);
  return { ...made, button: store, node: el("section", { class: "part" }, title, made.node) };
}

export async function save() {
  if (storing || !drafts.isComplete()) return;
  if (draft.editing) {
    await saveAnew();
    return;
  }
  if (!form?.isValid()) return;
  const content = form.content();
  await stored(async () => {
    const id = await addAsset(content, draft.vertices);
    entered[draft.shape] = { ...content, name: "", note: "" };
    drafts.clear();
    if (!drafts.isNextBegun()) select("asset", id);
  });
}

async function saveAnew() {
  await stored(async () => {
    const { id } = draft.editing;
    const now = state.assets.find((asset) => asset.id === id) ?? draft.editing;
    await measureAnew(now, draft.vertices);
    drafts.clear();
    if (!drafts.isNextBegun()) select("asset", id);
  });
}

async function stored(action) {
  storing = true;
  const work = action();
  drafts.holdUntil(work);
  try {
    await work;
  } catch (error) {
    say(error.message, "error");
  } finally {
    storing = false;
    drawPanel();
  }
}

on("draft", drawPanel);
on("sights", drawPanel);
on("tool", drawPanel);
on("seen", drawPanel);
on("match", () => {
  drawPanel();
  // What was found is looked at next, and may lie below the panel's edge.
  document.querySelector(".proposal")?.scrollIntoView({ block: "nearest" });
});
