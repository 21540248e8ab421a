// Control points: where they show, their marks, and marking them.

import { ask, latest } from "./api.js";
import { button, byId, el, fill, say } from "./dom.js";
import { fixed, plural, short } from "./format.js";
import { goTo, inView } from "./mapview.js";
import { on, select, setTool, state, tell, tellOthers } from "./store.js";

const ROLES = { control: "control", check: "check", off: "off" };
const sightsOf = latest("measure", "control_sights");
let found = null;
let sights = [];

export async function loadControl() {
  try {
    found = await ask("measure", "control");
  } catch (error) {
    found = { points: [], doubts: [], why_not: error.message };
  }
  state.control = found.points;
  await loadSights();
  tell("control", found.points);
  drawPanel();
}

const chosen = () =>
  state.selected?.kind === "control"
    ? state.control.find((point) => point.name === state.selected.id)
    : null;

async function loadSights() {
  const point = chosen();
  if (!point) {
    sights = [];
    return;
  }
  try {
    sights = (await sightsOf({ name: point.name }))?.sights ?? sights;
  } catch (error) {
    sights = [];
    say(error.message, "error");
  }
}

export function drawPanel() {
  const panel = byId("panel-control");
  if (panel.hidden) return;
  if (!found) {
    const why = state.facts?.why_not ?? "Loading …";
    fill(panel, el("p", { class: "hint" }, why));
    return;
  }
  const point = chosen();
  fill(
    panel,
    found.why_not ? el("p", { class: "hint" }, found.why_not) : null,
    point
      ? details(point)
      : found.points.length
        ? el(
            "p",
            { class: "hint" },
            "Choose a point, then a photo that shows it, and click it there. Marks go into the " +
              "project's file of marks; run adjust afterwards.",
          )
        : null,
    found.points.length ? list() : null,
    found.doubts.length
      ? el(
          "details",
          { open: found.doubts.length < 4 },
          el("summary", {}, plural(found.doubts.length, "doubt")),
          found.doubts.map((line) => el("p", { class: "doubt" }, line)),
        )
      : null,
  );
}

function list() {
  return el(
    "section",
    { class: "part" },
    el("h2", {}, "Points"),
    el(
      "ul",
      { class: "list" },
      found.points.map((point) =>
        el(
          "li",
          { class: point === chosen() ? "active" : "" },
          el(
            "div",
            { class: "top" },
            el("strong", {}, point.name),
            el(
              "span",
              { class: "note" },
              `${ROLES[point.role] ?? point.role}, ${plural(point.marks.length, "mark")}`,
            ),
            button("choose", () => select("control", point.name), {
              class: "small",
              "aria-label": `Choose ${point.name}`,
              "aria-pressed": point === chosen(),
            }),
          ),
        ),
      ),
    ),
  );
}

function details(point) {
  const wrong = point.marks.filter((mark) => mark.suspect || !mark.used).length;
  return el(
    "section",
    { class: "part" },
    el(
      "div",
      { class: "row title" },
      el("h2", {}, point.name),
      button("Show on map", () => goTo(point.x, point.y), { class: "small" }),
      button("Close", () => select(null), { class: "small" }),
    ),
    el(
      "p",
      { class: "note" },
      `${ROLES[point.role] ?? point.role} point, surveyed to ${short(point.sigma_h_m)} level`,
      point.sigma_v_m === null ? ", no height" : ` and ${short(point.sigma_v_m)} up`,
      wrong ? `; ${plural(wrong, "mark")} called doubtful` : "",
    ),
    marking(point),
    el("h3", {}, `Seen in ${plural(sights.length, "photo")}, best first`),
    el(
      "ul",
      { class: "list" },
      sights.map((sight) => sightRow(point, sight)),
    ),
  );
}

function marking(point) {
  if (state.tool === "mark" && state.marking === point.name) {
    return el(
      "div",
      { class: "hint" },
      `Click ${point.name} in the photo; a new click replaces the mark there. `,
      button("Stop marking", () => setTool("look"), { class: "small" }),
    );
  }
  return el(
    "div",
    { class: "row" },
    button("Mark in photos", () => begin(point), { class: "main" }),
  );
}

function begin(point) {
  state.marking = point.name;
  setTool("mark");
  state.marking = point.name;
  const first =
    sights.find((sight) => sight.photo === state.photo?.photo) ??
    sights.find((sight) => !sight.mark) ??
    sights[0];
  if (first) open(first);
}

function open(sight) {
  const [u, v] = sight.mark?.at ?? [sight.u, sight.v];
  tell("open-photo", { photo: sight.photo, at: { u, v, zoom: 4 } });
}

function sightRow(point, sight) {
  const { mark } = sight;
  const off = mark?.off_px ? `off ${fixed(Math.hypot(...mark.off_px), 1)} px` : "marked";
  const isOut = mark && (mark.suspect || !mark.used);
  return el(
    "li",
    { class: sight.photo === state.photo?.photo ? "active" : "" },
    el(
      "div",
      { class: "top" },
      button(sight.photo, () => open(sight), {
        class: "small quiet",
        title: "Open this photo there",
      }),
      el("span", { class: "spacer" }),
      mark
        ? el("span", { class: isOut ? "left-out" : "" }, isOut ? `doubtful, ${off}` : off)
        : el("span", { class: "note" }, `expected ± ${fixed(sight.semi_major, 1)} px`),
      mark
        ? button("×", () => unmark(point, sight), {
            class: "small",
            "aria-label": `Remove the mark in ${sight.photo}`,
          })
        : null,
    ),
  );
}

const known = (name, photo) =>
  state.control.find((point) => point.name === name)?.marks.find((mark) => mark.photo === photo)
    ?.at ?? null;

async function changed(name, content, words) {
  try {
    await ask("measure", name, content);
    tellOthers("control");
    say(words, "good");
  } catch (error) {
    say(error.message, "error");
  }
  await loadControl();
}

const unmark = (point, sight) =>
  changed(
    "unmark",
    { name: point.name, photo: sight.photo, before: sight.mark.at },
    `mark of ${point.name} in ${sight.photo} removed`,
  );

on("photo-click", ({ photo, u, v }) => {
  if (state.tool !== "mark" || !state.marking) return;
  const name = state.marking;
  changed("mark", { name, photo, u, v, before: known(name, photo) }, `${name} marked in ${photo}`);
});
on("selected", async (selected) => {
  if (selected?.kind !== "control" && state.tool === "mark") setTool("look");
  await loadSights();
  drawPanel();
  const point = chosen();
  if (point && !inView(point.x, point.y)) goTo(point.x, point.y);
});
on("photo", drawPanel);
on("tool", drawPanel);
on("other:control", loadControl);
