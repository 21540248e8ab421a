// The form of a tool, made from its declaration in the manifest.

import { button, el, field, fill, select } from "./dom.js";
import { getMap } from "./mapview.js";
import { state } from "./store.js";

const HELPS = {
  Length: "a number, or with a unit: 2.5 cm, 30 ft",
  Angle: "a number, or with a unit: 12 deg, 0.2 rad",
  MapPoint: "x,y in the project's CRS",
  PhotoPixel: "photo:u,v",
  Extent: "west,south,east,north in the project's CRS",
  PhotoSet: "names of photos, one a line; none = all",
  File: "path on this machine; relative to the project",
  Folder: "path on this machine; relative to the project",
};

const isList = (parameter) => parameter.multiple || parameter.type === "PhotoSet";
const shown = (value) =>
  value === null || value === undefined || (Array.isArray(value) && !value.length) || value === ""
    ? ""
    : Array.isArray(value)
      ? value.join(", ")
      : String(value);

/** Form of a tool: `values()` holds what was entered, nothing else. */
export function formOf(tool) {
  const inputs = new Map();
  const rows = tool.parameters.map((parameter) => {
    const preset = tool.stored[parameter.name] ?? parameter.default;
    const [input, row] =
      parameter.type === "Flag" ? flag(parameter, preset) : other(parameter, preset);
    inputs.set(parameter, input);
    return [parameter, row];
  });
  const rare = rows.filter(([parameter]) => parameter.advanced).map(([, row]) => row);
  const message = el("p", { class: "bad", hidden: true, role: "alert" });
  return {
    node: el(
      "div",
      {},
      rows.filter(([parameter]) => !parameter.advanced).map(([, row]) => row),
      rare.length ? el("details", {}, el("summary", {}, "More"), rare) : null,
      rows.length ? null : el("p", { class: "note" }, "It has no parameters."),
      message,
    ),
    isValid: () => [...inputs.values()].every((input) => input.reportValidity()),
    values: () =>
      Object.fromEntries(
        [...inputs]
          .map(([parameter, input]) => [parameter.name, entered(parameter, input)])
          .filter(([, value]) => value !== undefined),
      ),
    tell: (text) => {
      message.hidden = !text;
      fill(message, text);
    },
  };
}

function flag(parameter, preset) {
  const input = el("input", { type: "checkbox", checked: Boolean(preset) });
  input.dataset.preset = Boolean(preset);
  const note = parameter.help ? el("small", {}, parameter.help) : null;
  return [
    input,
    el(
      "label",
      { class: "check" },
      input,
      el("span", {}, parameter.title, note ? [el("br"), note] : null),
    ),
  ];
}

function other(parameter, preset) {
  const { type, unit, choices, suggestions, required, title, help } = parameter;
  const before = shown(preset);
  let input;
  if (suggestions && !isList(parameter)) {
    input = suggested(parameter, before);
  } else if (choices) {
    const options = choices.map((one) => [one, one]);
    input = select([["", before ? `as set: ${before}` : "–"], ...options], "", { required });
  } else if (isList(parameter)) {
    input = el("textarea", { rows: 2, required, placeholder: before, spellcheck: false });
  } else {
    input = el("input", {
      type: "text",
      required,
      placeholder: before,
      autocomplete: "off",
      spellcheck: false,
      inputmode: ["Number", "Integer"].includes(type) ? "decimal" : undefined,
    });
  }
  const told = [help?.replace(/\.$/, ""), limits(parameter), HELPS[type]].filter(Boolean);
  const label = `${title}${unit ? `, ${unit}` : ""}${required ? " *" : ""}`;
  const row = field(label, input.choice ?? input, told.join("; "));
  input.choice?.after(input.other);
  if (type === "Extent")
    row.append(button("Take what the map shows", () => takeExtent(input), { class: "small" }));
  return [input, row];
}

// value of the line of a list behind which one types
const OTHER = "another …";

/** A list whose last line lets one type something else. */
function suggested({ suggestions, required, title }, before) {
  const typed = el("input", {
    type: "text",
    hidden: true,
    disabled: true,
    required: true,
    autocomplete: "off",
    spellcheck: false,
    "aria-label": `${title}: another`,
  });
  const choice = select(
    [
      ["", before ? `as set: ${before}` : "–"],
      ...suggestions.map((one) => [one, one]),
      [OTHER, OTHER],
    ],
    "",
    { required: required && !before },
  );
  choice.addEventListener("change", () => {
    typed.hidden = typed.disabled = choice.value !== OTHER;
    if (!typed.hidden) typed.focus();
  });
  return {
    choice,
    other: typed,
    reportValidity: () => choice.reportValidity() && typed.reportValidity(),
    get value() {
      return choice.value === OTHER ? typed.value : choice.value;
    },
  };
}

function limits({ minimum, maximum, above, below, unit }) {
  const low = minimum ?? above;
  const high = maximum ?? below;
  const tail = unit ? ` ${unit}` : "";
  if (low !== undefined && high !== undefined) return `${low} to ${high}${tail}`;
  if (low !== undefined) return `${above === undefined ? "at least" : "above"} ${low}${tail}`;
  if (high !== undefined) return `${below === undefined ? "at most" : "below"} ${high}${tail}`;
  return "";
}

function takeExtent(input) {
  const view = getMap()?.getView().calculateExtent();
  if (view && state.facts.crs) input.value = view.map((value) => value.toFixed(3)).join(",");
}

function entered(parameter, input) {
  if (parameter.type === "Flag") {
    return String(input.checked) === input.dataset.preset ? undefined : input.checked;
  }
  const text = input.value.trim();
  if (!text) return undefined;
  if (isList(parameter))
    return text
      .split(/\n/)
      .map((one) => one.trim())
      .filter(Boolean);
  return text;
}
