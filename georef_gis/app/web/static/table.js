// The table of assets: sorted and filtered here, linked with the map.

import { methodWords, openIn, sizeOf } from "./assets.js";
import { button, byId, el, fill } from "./dom.js";
import { coordinate, fixed, NOTHING, plural, short } from "./format.js";
import { goTo } from "./mapview.js";
import { isSelected, on, select, state } from "./store.js";

const number = (value) => (typeof value === "number" ? value : Infinity);

const COLUMNS = () => {
  const unit = state.facts.crs?.unit ?? "units of the map";
  return [
    { title: "Class", key: (a) => a.title, text: (a) => a.title },
    { title: "Name", key: (a) => a.name, text: (a) => a.name, long: true },
    {
      title: `Easting, ${unit}`,
      key: (a) => number(a.vertices[0]?.[0]),
      text: (a) => coordinate(a.vertices[0]?.[0]),
      number: true,
    },
    {
      title: `Northing, ${unit}`,
      key: (a) => number(a.vertices[0]?.[1]),
      text: (a) => coordinate(a.vertices[0]?.[1]),
      number: true,
    },
    {
      title: "Height, m",
      key: (a) => number(a.vertices[0]?.[2]),
      text: (a) => fixed(a.vertices[0]?.[2], 2),
      number: true,
    },
    {
      title: "σ E",
      key: (a) => number(a.quality?.sigma_e),
      text: (a) => short(a.quality?.sigma_e),
      number: true,
    },
    {
      title: "σ N",
      key: (a) => number(a.quality?.sigma_n),
      text: (a) => short(a.quality?.sigma_n),
      number: true,
    },
    {
      title: "σ up",
      key: (a) => number(a.quality?.sigma_u),
      text: (a) => short(a.quality?.sigma_u),
      number: true,
    },
    {
      title: "Size on map",
      key: (a) => parseFloat(sizeOf(a)) || 0,
      text: (a) => sizeOf(a) || NOTHING,
      number: true,
    },
    {
      title: "Measured by",
      key: (a) => methodWords(a.quality),
      text: (a) => methodWords(a.quality),
    },
    { title: "Attributes", key: attributes, text: attributes, long: true },
    { title: "Note", key: (a) => a.note, text: (a) => a.note, long: true },
  ];
};
const attributes = (asset) =>
  Object.entries(asset.attributes)
    .map(([name, value]) => `${name} = ${value}`)
    .join(", ");

let sorted = 0;
let downwards = false;
let filter = "";
let parts = null;

export function toggleTable() {
  const side = byId("tableside");
  side.hidden = !side.hidden;
  byId("table-button").setAttribute("aria-pressed", !side.hidden);
  drawTable();
  if (!side.hidden) parts.filter.focus();
}

function makeParts() {
  const input = el("input", {
    type: "search",
    placeholder: "Filter: words that must occur",
    "aria-label": "Filter the table",
    on: {
      input: () => {
        filter = input.value;
        drawRows();
      },
    },
  });
  parts = {
    filter: input,
    count: el("span", { class: "note", role: "status" }),
    head: el("tr"),
    body: el("tbody"),
  };
  const table = el("table", {}, el("thead", {}, parts.head), parts.body);
  byId("tableside").append(
    el(
      "div",
      { class: "bar" },
      el("h2", {}, "Assets"),
      input,
      parts.count,
      el("span", { class: "spacer" }),
      button("Close", toggleTable, { class: "small" }),
    ),
    el("div", { class: "grid", tabIndex: 0, role: "region", "aria-label": "Assets" }, table),
  );
}

function drawTable() {
  if (byId("tableside").hidden) return;
  if (!parts) makeParts();
  fill(
    parts.head,
    COLUMNS().map((column, i) => {
      const sign = i === sorted ? (downwards ? " ▾" : " ▴") : "";
      const order = i === sorted ? (downwards ? "descending" : "ascending") : "none";
      return el(
        "th",
        { class: column.number ? "number" : "", scope: "col", "aria-sort": order },
        button(
          column.title + sign,
          () => {
            downwards = i === sorted ? !downwards : false;
            sorted = i;
            drawTable();
          },
          { "aria-label": `Sort by ${column.title}` },
        ),
      );
    }),
  );
  drawRows();
}

function drawRows() {
  const columns = COLUMNS();
  const words = filter.toLowerCase().split(/\s+/).filter(Boolean);
  const shown = state.assets.filter((asset) => {
    const text = columns
      .map((column) => column.text(asset))
      .join(" ")
      .toLowerCase();
    return words.every((word) => text.includes(word));
  });
  const { key } = columns[sorted];
  shown.sort((a, b) => {
    const [x, y] = [key(a), key(b)];
    const order =
      typeof x === "number"
        ? x - y
        : String(x).localeCompare(String(y), undefined, { numeric: true });
    return downwards ? -order : order;
  });
  fill(
    parts.count,
    words.length
      ? `${shown.length} of ${plural(state.assets.length, "asset")}`
      : plural(shown.length, "asset"),
  );
  const none = state.assets.length
    ? "No asset has these words."
    : "No assets yet: choose Point, Line or Area, click an object, and store it.";
  fill(
    parts.body,
    shown.length
      ? shown.map((asset) => row(asset, columns))
      : el("tr", { class: "none" }, el("td", { colSpan: columns.length, class: "note" }, none)),
  );
}

function row(asset, columns) {
  const choose = () => {
    select("asset", asset.id);
    if (asset.vertices.length) goTo(asset.vertices[0][0], asset.vertices[0][1]);
  };
  const open = () => asset.clicks.length && openIn(asset);
  return el(
    "tr",
    {
      tabIndex: 0,
      "aria-selected": isSelected("asset", asset.id),
      dataset: { asset: asset.id },
      on: {
        click: choose,
        dblclick: open,
        keydown: (event) => {
          if (event.key === "Enter") choose();
          else if (event.key === "ArrowDown") event.currentTarget.nextElementSibling?.focus();
          else if (event.key === "ArrowUp") event.currentTarget.previousElementSibling?.focus();
          else return;
          event.preventDefault();
          event.stopPropagation();
        },
      },
    },
    columns.map((column) =>
      el(
        "td",
        { class: [column.number && "number", column.long && "long"].filter(Boolean).join(" ") },
        column.long ? el("div", {}, column.text(asset)) : column.text(asset),
      ),
    ),
  );
}

on("assets", drawTable);
on("selected", () => {
  if (!parts || byId("tableside").hidden) return;
  for (const line of parts.body.children) {
    const isChosen = isSelected("asset", line.dataset.asset);
    line.setAttribute("aria-selected", isChosen);
    if (isChosen) line.scrollIntoView({ block: "nearest" });
  }
});
