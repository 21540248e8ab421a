// What lies under the pointer: told by distance, not by what was drawn last, so that no name of
// one thing hides another thing.

// pixels of the screen
const REACH = 9;
const RANKS = { Point: 0, LineString: 1, MultiLineString: 1, Polygon: 2, MultiPolygon: 2 };

/**
 * The feature nearest to a coordinate among those of some layers: points go before lines, lines
 * before areas. `counts` says which features can be meant.
 */
export function nearest(viewer, coordinate, layers, counts = () => true) {
  const resolution = viewer.getView().getResolution();
  const extent = ol.extent.buffer([...coordinate, ...coordinate], REACH * resolution);
  let best = null;
  for (const layer of layers) {
    if (!layer.getVisible()) continue;
    for (const feature of layer.getSource().getFeaturesInExtent(extent)) {
      if (!counts(feature)) continue;
      const geometry = feature.getGeometry();
      const rank = RANKS[geometry.getType()] ?? 3;
      const away = distance(geometry, coordinate, rank) / resolution;
      if (away > REACH || (best && (best.rank - rank || best.away - away) <= 0)) continue;
      best = { feature, layer, rank, away };
    }
  }
  return best;
}

function distance(geometry, coordinate, rank) {
  if (rank === 2 && geometry.intersectsCoordinate(coordinate)) return 0;
  const [x, y] = geometry.getClosestPoint(coordinate);
  return Math.hypot(x - coordinate[0], y - coordinate[1]);
}
