// The report in its dialog, and whether it is older than what it reports.

import { ask } from "./api.js";
import { button, byId, el, fill, say } from "./dom.js";
import { dialogHead } from "./help.js";
import { on, state } from "./store.js";
import { startTool } from "./tools.js";

const TOOL = "report";
// what the server says: whether there is one, which one, and what changed since
let told = { revision: "", older_than: [] };
let making = false;

/** Ask how old the report is; the button says so where it is too old. */
export async function loadReport() {
  try {
    told = await ask("view", "report_state");
  } catch {
    // What is wrong with the server is told by those who ask for more.
    return;
  }
  const isOld = told.older_than.length > 0;
  const at = byId("report-button");
  at.classList.toggle("older", isOld);
  at.title = `The project's report page${isOld ? `, older than ${newer()}` : ""}`;
  if (byId("report").open) draw();
}

const newer = () => told.older_than.join(" and ");

export function showReport() {
  draw();
  byId("report").showModal();
  loadReport();
}

function draw() {
  const dialog = byId("report");
  const [, hint, page] = dialog.children;
  const key = `${state.facts.name} ${told.revision}`;
  if (dialog.dataset.shown !== key) {
    // A page that one reads is not loaded again for nothing.
    dialog.dataset.shown = key;
    fill(
      dialog,
      dialogHead("report-title", `Report: ${state.facts.name}`, dialog),
      hint ?? el("div", { class: "hintbar", role: "status" }),
      frame(),
    );
  } else if (!page) return;
  drawHint(dialog.children[1]);
}

function frame() {
  if (!told.revision) {
    return el(
      "p",
      { class: "body" },
      "There is no report yet. “Make the report” makes it of what there is; all steps together " +
        "are “Make the products” (Tools).",
    );
  }
  return el("iframe", {
    src: `/report?v=${encodeURIComponent(told.revision)}`,
    title: "Report of the project",
    // It may do nothing but be looked at.
    sandbox: "",
  });
}

function drawHint(place) {
  const isOld = told.older_than.length > 0;
  place.hidden = !isOld && Boolean(told.revision);
  fill(
    place,
    isOld && told.revision ? el("span", {}, `This report is older than ${newer()}.`) : null,
    button(
      making ? "Is being made …" : told.revision ? "Make it again" : "Make the report",
      make,
      { class: "main", disabled: making },
    ),
  );
}

async function make() {
  making = true;
  drawHint(byId("report").children[1]);
  try {
    await startTool(TOOL, "Report page");
    say("the report is being made: its progress stands under Tools");
  } catch (error) {
    making = false;
    say(error.message, "error");
    const place = byId("report").children[1];
    drawHint(place);
    place.append(el("span", { class: "bad", role: "alert" }, error.message));
  }
}

on("project-changed", () => {
  making = false;
});
on("assets", loadReport);
on("control", loadReport);
