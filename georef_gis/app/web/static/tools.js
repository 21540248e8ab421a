// Tools: their list, forms made from the manifest, and runs with progress.

import { get, post } from "./api.js";
import { button, byId, el, fill, say } from "./dom.js";
import { formOf } from "./toolform.js";
import { seconds } from "./format.js";
import { tell } from "./store.js";

const PIPELINE = {
  full_id: "run",
  name: "Make the products",
  group: "project",
  needs_project: true,
  help: "All steps that are not up to date, as `georef run` does.",
  parameters: [
    {
      name: "quick",
      type: "Flag",
      title: "Quick: a first answer, from the poses alone",
      default: false,
    },
    { name: "force", type: "Flag", title: "Run steps that are up to date too", default: false },
  ],
  stored: {},
};
// of lines shown; all are with the run in the database
const MOST_LINES = 300;

let tools = [];
let chosen = null;
let form = null;
let run = null;
let filter = "";

async function loadTools() {
  try {
    const content = await get("/api/tools");
    tools = [PIPELINE, ...content.tools];
    const going = content.jobs.find((job) => job.state === "runs");
    if (going) follow(going);
  } catch (error) {
    say(error.message, "error");
  }
  drawPanel();
}

export function drawPanel() {
  const panel = byId("panel-tools");
  if (panel.hidden) return;
  if (!tools.length) {
    fill(panel, el("p", { class: "note" }, "Loading …"));
    loadTools();
    return;
  }
  fill(panel, runView(), chosen ? toolForm() : toolList());
}

function toolList() {
  const input = el("input", {
    type: "search",
    value: filter,
    placeholder: "Find a tool",
    "aria-label": "Find a tool",
    on: {
      input: () => {
        filter = input.value;
        fill(place, rows());
      },
    },
  });
  const place = el("div", { class: "tool-list" }, rows());
  return el("div", {}, el("div", { class: "field" }, input), place);
}

function rows() {
  const words = filter.toLowerCase().split(/\s+/).filter(Boolean);
  const fitting = tools.filter((tool) => {
    const text = `${tool.name} ${tool.full_id} ${tool.help}`.toLowerCase();
    return words.every((word) => text.includes(word));
  });
  const own = fitting.filter((tool) => tool.needs_project);
  const others = fitting.filter((tool) => !tool.needs_project);
  if (!fitting.length) return el("p", { class: "note" }, "No tool has these words.");
  return [
    grouped(own),
    others.length
      ? el(
          "details",
          { open: words.length > 0 || !own.length },
          el("summary", {}, `Tools that need no project${words.length ? ", found" : ""}`),
          grouped(others),
        )
      : null,
  ];
}

function grouped(some) {
  const groups = [...new Set(some.map((tool) => tool.group))];
  return groups.map((group) => [
    el("h3", {}, group),
    some
      .filter((tool) => tool.group === group)
      .map((tool) => {
        const made = button(tool.name, () => choose(tool));
        made.append(el("small", {}, tool.help.split("\n")[0]));
        return made;
      }),
  ]);
}

function choose(tool) {
  chosen = tool;
  form = tool ? formOf(tool) : null;
  drawPanel();
  if (tool) byId("panel-tools").scrollTop = 0;
}

export const choosePipeline = () => choose(PIPELINE);

function toolForm() {
  const going = run?.state === "runs";
  return el(
    "section",
    { class: "part" },
    el(
      "div",
      { class: "row" },
      button("‹ All tools", () => choose(null), { class: "small" }),
    ),
    el("h2", {}, chosen.name),
    chosen.help
      .split(/\n\s*\n/)
      .map((part) => el("p", { class: "help-text" }, part.replace(/\s+/g, " "))),
    form.node,
    el(
      "div",
      { class: "row" },
      button("Run", start, { class: "main", disabled: going }),
      going ? el("span", { class: "note" }, "wait for the run above, or cancel it") : null,
    ),
  );
}

/** Start a tool from elsewhere on the page; its progress is in the panel of tools. */
export async function startTool(id, name, values = {}) {
  follow({ ...(await post("/api/jobs", { tool: id, values })), name });
  drawPanel();
}

async function start() {
  if (!form.isValid()) return;
  form.tell("");
  try {
    await startTool(chosen.full_id, chosen.name, form.values());
    byId("panel-tools").scrollTop = 0;
  } catch (error) {
    form.tell(error.message);
    say(error.message, "error");
  }
}

// -- the run --------------------------------------------------------------------------------------

function follow(job) {
  run?.source?.close();
  const name = job.name ?? tools.find((tool) => tool.full_id === job.tool)?.name ?? job.tool;
  run = {
    id: job.id,
    name,
    state: "runs",
    fraction: 0,
    step: "",
    lines: [],
    since: Date.now(),
    view: null,
  };
  const mine = run;
  mine.source = new EventSource(`/api/jobs/${job.id}/events`);
  mine.source.addEventListener("message", (message) => take(mine, JSON.parse(message.data)));
  mine.source.addEventListener("open", () => {
    // After a break the server tells everything from the begin on.
    mine.lines = [];
  });
  mine.source.addEventListener("error", () => {
    if (mine.state === "runs")
      say("the run's progress cannot be seen: does `georef serve` still run?", "error");
  });
  tell("job", mine);
}

function take(mine, event) {
  if (event.event === "progress") {
    mine.fraction = event.fraction;
    mine.step = event.message;
  } else if (event.event === "end") {
    mine.source.close();
    mine.state = event.state;
    mine.took = (Date.now() - mine.since) / 1000;
    say(`${mine.name}: ${WORDS[mine.state]}`, mine.state === "done" ? "good" : "error");
    tell("job", mine);
    tell("project-changed");
    drawPanel();
    return;
  } else mine.lines.push(line(event));
  if (mine.lines.length > MOST_LINES) mine.lines.shift();
  if (mine === run) showRun();
}
const WORDS = { runs: "running", done: "done", failed: "failed", cancelled: "cancelled" };

function line(event) {
  if (event.event === "result") return { kind: "result", ...event };
  return { kind: event.event, text: event.message ?? "" };
}

function runView() {
  if (!run) return null;
  run.view = {
    bar: el("progress", { max: 1, "aria-label": `Progress of ${run.name}` }),
    step: el("p", { class: "note", role: "status" }),
    log: el("div", { class: "log", tabIndex: 0, role: "log", "aria-label": "Messages of the run" }),
  };
  const going = run.state === "runs";
  const section = el(
    "section",
    { class: "part" },
    el(
      "div",
      { class: "row title" },
      el("h2", {}, `${run.name}: ${WORDS[run.state]}`),
      going
        ? button("Cancel", cancel, { class: "small" })
        : button(
            "Close",
            () => {
              run = null;
              drawPanel();
            },
            { class: "small" },
          ),
    ),
    going ? run.view.bar : el("p", { class: "note" }, `took ${seconds(run.took)}`),
    going ? run.view.step : null,
    run.view.log,
  );
  showRun();
  return section;
}

function showRun() {
  if (!run?.view) return;
  const { bar, step, log } = run.view;
  // Without a value the bar says that work goes on.
  if (run.fraction > 0) bar.value = run.fraction;
  else bar.removeAttribute("value");
  fill(step, run.fraction > 0 ? `${Math.round(100 * run.fraction)} %  ${run.step}` : "begins …");
  const atEnd = log.scrollTop + log.clientHeight >= log.scrollHeight - 20;
  log.hidden = !run.lines.length;
  fill(
    log,
    run.lines.map((one) =>
      one.kind === "result" ? resultLines(one) : el("p", { class: one.kind }, one.text),
    ),
  );
  if (atEnd) log.scrollTop = log.scrollHeight;
}

const figure = (value) => (typeof value === "number" ? Number(value.toPrecision(6)) : value);

/** Files of a tool, each once. */
const written = ({ summary, outputs }) => [
  ...new Set([...(summary?.products ?? []), ...Object.values(outputs ?? {})].map(String)),
];

/** A file with its folder: the project is known. */
const shortPath = (path) => path.split(/[\\/]/).slice(-2).join("/");

/** Products and figures of a tool that is done. */
function resultLines(event) {
  const summary = event.summary ?? {};
  const figures = Object.entries(summary)
    .filter(([, value]) => ["number", "string", "boolean"].includes(typeof value))
    .map(([name, value]) => `${name.replaceAll("_", " ")}: ${figure(value)}`);
  return [
    el("p", {}, `${event.tool ?? run.name}: ${event.skipped ? "unchanged" : "done"}`),
    written(event).map((path) => el("p", { title: path }, `wrote ${shortPath(path)}`)),
    figures.map((text) => el("p", { class: "note" }, text)),
    (summary.doubts ?? []).map((text) => el("p", { class: "warning" }, text)),
  ];
}

async function cancel() {
  try {
    await post(`/api/jobs/${run.id}/cancel`);
    say("cancelling: what is finished stays");
  } catch (error) {
    say(error.message, "error");
  }
}
