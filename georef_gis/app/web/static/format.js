// Numbers as people read them: every one with its unit and, where there is one, its sigma.

export const NOTHING = "–";

const isNumber = (value) => typeof value === "number" && Number.isFinite(value);

export function fixed(value, digits) {
  return isNumber(value) ? value.toFixed(digits) : NOTHING;
}

/** Digits such that the sigma shows two of its own, at most four behind the point. */
function digitsFor(sigma) {
  if (!isNumber(sigma) || sigma <= 0) return 3;
  return Math.min(4, Math.max(0, 1 - Math.floor(Math.log10(sigma))));
}

/** "12.345 ± 0.021 m" */
export function measured(value, sigma, unit = "m") {
  if (!isNumber(value)) return NOTHING;
  if (!isNumber(sigma)) return `${value.toFixed(3)} ${unit}`;
  const digits = digitsFor(sigma);
  return `${value.toFixed(digits)} ± ${sigma.toFixed(digits)} ${unit}`;
}

/** Lengths in the unit of a map that is not in metres; null where it is. */
export function inMapUnit(value, sigma, crs, power = 1) {
  const factor = crs.metres_per_unit ** power;
  if (crs.metres_per_unit === 1 || !isNumber(value)) return null;
  return measured(value / factor, sigma / factor, crs.unit + (power === 2 ? "²" : ""));
}

/** A sigma or another small length: in cm below a metre. */
export function short(length) {
  if (!isNumber(length)) return NOTHING;
  if (Math.abs(length) < 0.01) return `${(length * 1000).toFixed(1)} mm`;
  if (Math.abs(length) < 1) return `${(length * 100).toFixed(1)} cm`;
  return `${length.toFixed(length < 10 ? 2 : 1)} m`;
}

/** "23.9 × 11.6 cm at 67°": the semi-axes of an ellipse in one unit, and where the major points. */
export function axes(major, minor, azimuth) {
  if (!isNumber(major) || !isNumber(minor)) return NOTHING;
  const [size, unit] = short(major).split(" ");
  const factor = { mm: 1000, cm: 100, m: 1 }[unit];
  const digits = size.split(".")[1]?.length ?? 0;
  return `${size} × ${(minor * factor).toFixed(digits)} ${unit} at ${Math.round(azimuth)}°`;
}

export function area(value, sigma) {
  return measured(value, sigma, "m²");
}

export function angle(degrees, sigma) {
  if (!isNumber(degrees)) return NOTHING;
  if (!isNumber(sigma)) return `${degrees.toFixed(2)}°`;
  const digits = digitsFor(sigma);
  return `${degrees.toFixed(digits)}° ± ${sigma.toFixed(digits)}°`;
}

/** "1 693 904.85": groups of three, as coordinates have many digits. */
export function coordinate(value, digits = 2) {
  if (!isNumber(value)) return NOTHING;
  const [whole, part] = value.toFixed(digits).split(".");
  const grouped = whole.replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f");
  return part ? `${grouped}.${part}` : grouped;
}

export function degrees(lat, lon) {
  if (!isNumber(lat) || !isNumber(lon)) return NOTHING;
  const ns = lat < 0 ? "S" : "N";
  const ew = lon < 0 ? "W" : "E";
  return `${Math.abs(lat).toFixed(7)}° ${ns}, ${Math.abs(lon).toFixed(7)}° ${ew}`;
}

export function pixel(u, v, digits = 1) {
  return `${fixed(u, digits)}, ${fixed(v, digits)} px`;
}

export function seconds(value) {
  if (!isNumber(value)) return NOTHING;
  if (value < 60) return `${value.toFixed(1)} s`;
  return `${Math.floor(value / 60)} min ${Math.round(value % 60)} s`;
}

export function plural(count, one, many = `${one}s`) {
  return `${count} ${count === 1 ? one : many}`;
}
