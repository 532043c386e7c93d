// The map of directions and the histogram of distances, as rows to show. Pure.

const NAMES = {0: "front", 45: "front right", 90: "right", 135: "back right", 180: "back", "-45": "front left", "-90": "left", "-135": "back left", "-180": "back"};

export const nameOf = (azimuth) => NAMES[Math.round(azimuth / 45) * 45];

/** Columns with the side that one looks at from there, neighbours of one name joined: [{name, span}]. */
export function sides(edges) {
  const found = [];
  for (let i = 0; i + 1 < edges.length; i += 1) {
    const name = nameOf((edges[i] + edges[i + 1]) / 2);
    if (found.at(-1)?.name === name) found.at(-1).span += 1;
    else found.push({name, span: 1});
  }
  return found;
}

/** 0 none, 1 one, 2 two or three, 3 up to seven, 4 more: one hue, light to dark; the number stands in the cell too. */
export const level = (count) => (count <= 0 ? 0 : count === 1 ? 1 : count <= 3 ? 2 : count <= 7 ? 3 : 4);

/** Rows from the top down: [{from, to, cells: [{count, wanted, now, level, row, column, words}]}]. */
export function rows({bins, counts, wanted}, now = null) {
  return counts.map((line, row) => ({
    from: bins.elevation[row],
    to: bins.elevation[row + 1],
    cells: line.map((count, column) => ({
      count, row, column,
      wanted: wanted?.[row]?.[column] ?? true,
      now: Boolean(now && now[0] === row && now[1] === column),
      level: level(count),
      words: words(bins, row, column),
    })),
  })).reverse();
}

function words(bins, row, column) {
  const side = nameOf((bins.azimuth[column] + bins.azimuth[column + 1]) / 2);
  return `${side}, ${bins.elevation[row]} to ${bins.elevation[row + 1]}° up`;
}

/** Bars of the histogram: share of the fullest, and whether the present distance is in it. */
export function bars({edges_mm, counts}, distance_mm = null) {
  const most = Math.max(1, ...counts);
  return counts.map((count, i) => ({
    from: edges_mm[i], to: edges_mm[i + 1], count, share: count / most,
    now: distance_mm !== null && distance_mm >= edges_mm[i] && distance_mm < edges_mm[i + 1],
  })).filter((bar, i, all) => bar.count || bar.now || (all.slice(0, i).some((b) => b.count) && all.slice(i).some((b) => b.count)));
}

/** A point of the unit sphere as seen from azimuth/elevation (deg): [x right, y up, z towards the viewer]. */
export function project(azimuth, elevation, view) {
  const [a, e] = [((azimuth - view.azimuth) * Math.PI) / 180, (elevation * Math.PI) / 180];
  const tilt = (view.elevation * Math.PI) / 180;
  const [x, y, z] = [Math.cos(e) * Math.sin(a), Math.sin(e), Math.cos(e) * Math.cos(a)];
  return [x, y * Math.cos(tilt) - z * Math.sin(tilt), y * Math.sin(tilt) + z * Math.cos(tilt)];
}
