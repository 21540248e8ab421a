// How features look on the map and in the photo. The colours are told apart without red and green,
// and classes differ by shape and label too.

const { Style, Fill, Stroke, Circle, RegularShape, Text } = ol.style;

export const COLOURS = {
  photo: "#1f6fb2",
  footprint: "#1f6fb2",
  trajectory: "#7a5195",
  control: "#d9480f",
  check: "#8a5a00",
  draft: "#d6006e",
  cursor: "#0b7285",
  selected: "#ffd400",
  guide: "#00b3c4",
  proposed: "#6a3fc4",
};
const GROUP_COLOURS = ["#e8590c", "#1971c2", "#2b8a3e", "#9c36b5", "#c2255c", "#0b7285", "#5f3dc4"];
const HALO = new Stroke({ color: "rgba(255,255,255,0.92)", width: 3.5 });

const groups = [];

/** Colour of a group of classes: the same on the map, in the photo and in the table. */
export function groupColour(group) {
  if (!groups.includes(group)) groups.push(group);
  return GROUP_COLOURS[groups.indexOf(group) % GROUP_COLOURS.length];
}

// characters of a name beside its place; the panel and the table have all of it
const LONGEST = 28;

function label(text, colour, dy = -13) {
  const all = String(text);
  return new Text({
    text: all.length > LONGEST ? `${all.slice(0, LONGEST - 1)}…` : all,
    font: "600 12px system-ui, sans-serif",
    offsetY: dy,
    fill: new Fill({ color: colour }),
    stroke: HALO,
    overflow: true,
  });
}

const white = (width) => new Stroke({ color: "rgba(255,255,255,0.9)", width });

/** A line that is seen on dark and on light ground. */
function cased(colour, width, dash = undefined) {
  return [
    new Style({ stroke: white(width + 2.5) }),
    new Style({ stroke: new Stroke({ color: colour, width, lineDash: dash }) }),
  ];
}

export const footprint = new Style({
  stroke: new Stroke({ color: "rgba(31,111,178,0.55)", width: 1.2 }),
  fill: new Fill({ color: "rgba(31,111,178,0.02)" }),
});
export const seam = new Style({
  stroke: new Stroke({ color: "rgba(255,255,255,0.85)", width: 1.2 }),
});
export const current = cased(COLOURS.selected, 2.5);
export const trajectory = [
  new Style({ stroke: white(3) }),
  new Style({ stroke: new Stroke({ color: COLOURS.trajectory, width: 1.4 }) }),
];

export function photoPoint(isCurrent, doubtful) {
  return new Style({
    image: new Circle({
      radius: isCurrent ? 7 : 4.5,
      fill: new Fill({ color: isCurrent ? COLOURS.selected : COLOURS.photo }),
      stroke: new Stroke({ color: doubtful ? COLOURS.control : "white", width: 1.6 }),
    }),
    zIndex: isCurrent ? 2 : 1,
  });
}

export function controlPoint(name, role, isSelected) {
  const colour = role === "check" ? COLOURS.check : role === "off" ? "#666" : COLOURS.control;
  const shape = {
    fill: new Fill({ color: isSelected ? COLOURS.selected : "rgba(255,255,255,0.85)" }),
    stroke: new Stroke({ color: colour, width: 2 }),
  };
  return new Style({
    image:
      role === "check"
        ? new Circle({ radius: 6, ...shape })
        : new RegularShape({ points: 3, radius: 8, ...shape }),
    text: label(name, colour, -15),
    zIndex: 4,
  });
}

const SHAPES = { point: 4, line: 2, polygon: 0 };

/** A frame around a point whose middle is free: in a photo the object itself must be seen. */
function frame(colour, ring) {
  const square = (stroke, width) =>
    new Style({
      image: new RegularShape({
        points: 4,
        radius: 13,
        angle: Math.PI / 4,
        stroke: new Stroke({ color: stroke, width }),
      }),
    });
  return [square(ring, 5), square(colour, 2.2)];
}

/** Style of an asset: by its group's colour, with its name; `isOpen` leaves its middle free. */
export function asset(colour, text, shape, isSelected, showLabel, isOpen = false) {
  const ring = isSelected ? COLOURS.selected : "white";
  const styles = [];
  if (SHAPES[shape] === 4 && isOpen) styles.push(...frame(colour, ring));
  else if (SHAPES[shape] === 4) {
    styles.push(
      new Style({
        image: new RegularShape({
          points: 4,
          radius: isSelected ? 9 : 7,
          angle: Math.PI / 4,
          fill: new Fill({ color: colour }),
          stroke: new Stroke({ color: ring, width: isSelected ? 3 : 1.6 }),
        }),
      }),
    );
  } else {
    styles.push(new Style({ stroke: new Stroke({ color: ring, width: isSelected ? 7 : 5 }) }));
    styles.push(
      new Style({
        stroke: new Stroke({ color: colour, width: 2.4 }),
        fill: shape === "polygon" ? new Fill({ color: `${colour}22` }) : undefined,
      }),
    );
  }
  const up = isOpen ? -18 : -13;
  if (showLabel && text) styles.push(new Style({ text: label(text, colour, up), zIndex: 5 }));
  return styles;
}

export function ellipse(colour) {
  return [
    new Style({ stroke: white(3) }),
    new Style({
      stroke: new Stroke({ color: colour, width: 1.4 }),
      fill: new Fill({ color: `${colour}1f` }),
    }),
  ];
}

const crosses = new Map();

/** A cross whose middle is free: what lies there must be seen. */
function crossImage(colour, size) {
  const key = `${colour} ${size}`;
  if (crosses.has(key)) return crosses.get(key);
  const ratio = Math.max(2, Math.ceil(window.devicePixelRatio));
  const half = size + 4;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 2 * half * ratio;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  for (const [stroke, width] of [
    ["rgba(255,255,255,0.9)", 4],
    [colour, 1.8],
  ]) {
    pen.strokeStyle = stroke;
    pen.lineWidth = width;
    pen.beginPath();
    for (const [dx, dy] of [
      [1, 0],
      [-1, 0],
      [0, 1],
      [0, -1],
    ]) {
      pen.moveTo(half + 3.5 * dx, half + 3.5 * dy);
      pen.lineTo(half + size * dx, half + size * dy);
    }
    pen.stroke();
  }
  const made = new ol.style.Icon({ img: canvas, scale: 1 / ratio });
  crosses.set(key, made);
  return made;
}

export function cross(colour, text = "", size = 12) {
  return new Style({
    image: crossImage(colour, size),
    text: text ? label(text, colour, -size - 7) : undefined,
    zIndex: 9,
  });
}

export const draftLine = cased(COLOURS.draft, 2);
export const draftArea = [
  ...draftLine,
  new Style({ fill: new Fill({ color: "rgba(214,0,110,0.10)" }) }),
];
export const guide = cased(COLOURS.guide, 1.8);
export const guideBand = new Style({ fill: new Fill({ color: "rgba(0,179,196,0.20)" }) });

/** A place that is told, not clicked. */
export function predicted(colour, text) {
  return [
    new Style({
      image: new Circle({ radius: 6.5, stroke: white(3.5) }),
      zIndex: 6,
    }),
    new Style({
      image: new Circle({
        radius: 6.5,
        stroke: new Stroke({ color: colour, width: 1.6, lineDash: [3, 2] }),
      }),
      text: text ? label(text, colour, -16) : undefined,
      zIndex: 7,
    }),
  ];
}
