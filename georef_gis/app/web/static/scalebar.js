// The scale of the map: a bar of a round length, in the unit in which people say it.

const FEWEST = 80;
const STEPS = [1, 2, 5];

/** The smallest 1, 2 or 5 times a power of ten that is at least so long, m. */
export function roundLength(least) {
  const power = Math.floor(Math.log10(least));
  const found = [power, power + 1]
    .flatMap((exponent) => STEPS.map((step) => [step, exponent]))
    .find(([step, exponent]) => step * 10 ** exponent >= least * (1 - 1e-9));
  // Of 0.001 the digits are exact, of 10 ** -3 they need not be.
  return Number(`${found[0]}e${found[1]}`);
}

/** "2 km", "1 m", "50 cm", "5 mm" */
export function lengthWords(length) {
  if (length >= 1000) return `${length / 1000} km`;
  if (length >= 1) return `${length} m`;
  if (length >= 0.01) return `${Math.round(length * 100)} cm`;
  return `${Number((length * 1000).toPrecision(1))} mm`;
}

/** Control of OpenLayers; `resolution()` gives metres per pixel of the screen. */
export function scaleBar(resolution) {
  const inner = document.createElement("div");
  inner.className = "ol-scale-line-inner";
  const element = document.createElement("div");
  element.className = "ol-scale-line ol-unselectable";
  element.append(inner);
  function render() {
    const size = resolution();
    if (!(size > 0)) return;
    const length = roundLength(FEWEST * size);
    const words = lengthWords(length);
    const width = `${Math.round(length / size)}px`;
    if (inner.textContent !== words) inner.textContent = words;
    if (inner.style.width !== width) inner.style.setProperty("width", width);
  }
  return new ol.control.Control({ element, render });
}
