// The form of an asset, made from its class.

import { el, field, select } from "./dom.js";
import { state, tell } from "./store.js";

export const classOf = (name) => state.domain.find((one) => one.name === name);

/** Options of a select: the classes of a shape by group. */
function classOptions(shape) {
  const fitting = state.domain.filter((one) => one.geometry === shape);
  const groups = [...new Set(fitting.map((one) => one.group))];
  return groups.map((group) => ({
    title: group,
    options: fitting.filter((one) => one.group === group).map((one) => [one.name, one.title]),
  }));
}

function control(attribute, value) {
  const given = value === undefined || value === null ? "" : String(value);
  const { type, min, max, choices, suggestions, required } = attribute;
  if (type === "flag") {
    const shown = given === "true" ? "yes" : given === "false" ? "no" : "";
    return select(
      [
        ["", "–"],
        ["yes", "yes"],
        ["no", "no"],
      ],
      shown,
      { required },
    );
  }
  if (type === "choice") {
    return select([["", "–"], ...choices.map((one) => [one, one])], given, { required });
  }
  const kind = { number: "number", integer: "number", date: "date" }[type] ?? "text";
  const input = el("input", {
    type: kind,
    value: given,
    required,
    min,
    max,
    autocomplete: "off",
    step: type === "integer" ? "1" : type === "number" ? "any" : undefined,
  });
  if (suggestions) {
    const list = el(
      "datalist",
      { id: `suggestions-${attribute.name}-${Math.random().toString(36).slice(2)}` },
      suggestions.map((one) => el("option", { value: one })),
    );
    input.setAttribute("list", list.id);
    input.suggestionList = list;
  }
  return input;
}

/** Select of the classes of a shape. None is proposed: a class that nobody chose is a wrong one. */
function classSelect(shape, chosen) {
  const isGone = chosen && classOf(chosen)?.geometry !== shape;
  const first = isGone ? [[chosen, `${chosen} (not known)`]] : [];
  if (!chosen) first.push(["", "choose a class"]);
  return select([...first, ...classOptions(shape)], chosen, { required: true });
}

/** Form for a shape: `content()` gives what was entered. */
export function assetForm(shape, values, onKind = () => {}) {
  const kind = classSelect(shape, values.kind ?? "");
  const name = el("input", { type: "text", value: values.name ?? "", autocomplete: "off" });
  const note = el("textarea", { rows: 2, value: values.note ?? "" });
  const place = el("div");
  let inputs = new Map();

  function showAttributes(kept) {
    inputs = new Map();
    const rows = (classOf(kind.value)?.attributes ?? []).map((attribute) => {
      const input = control(attribute, kept[attribute.name]);
      inputs.set(attribute.name, input);
      const unit = attribute.unit ? `, ${attribute.unit}` : "";
      const star = attribute.required ? " *" : "";
      const made = field(`${attribute.title}${unit}${star}`, input, attribute.help ?? "");
      if (input.suggestionList) made.append(input.suggestionList);
      return made;
    });
    place.replaceChildren(...rows);
  }

  const entered = () =>
    Object.fromEntries(
      [...inputs]
        .map(([key, input]) => [key, input.value.trim()])
        .filter(([, value]) => value !== ""),
    );
  kind.addEventListener("change", () => {
    showAttributes(entered());
    onKind(kind.value);
    tell("asset-kind");
  });
  showAttributes(values.attributes ?? {});
  // Of a new asset: what may be the same thing, see duplicates.js.
  const alike = values.id ? null : el("div", { class: "alike", role: "status" });
  kind.classList.add("kind");
  const node = el(
    "div",
    {},
    field("Class", kind),
    alike,
    field("Name", name),
    place,
    field("Note", note),
  );
  return {
    node,
    nameInput: name,
    content: () => ({
      kind: kind.value,
      name: name.value.trim(),
      note: note.value.trim(),
      attributes: entered(),
    }),
    isValid: () => {
      // The buttons lie over the foot of the form, and over what the browser would show there.
      if (!kind.value) kind.scrollIntoView({ block: "center" });
      return [kind, ...inputs.values()].every((input) => input.reportValidity());
    },
  };
}
