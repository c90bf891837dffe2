// From a network's hypotheses to angles, probabilities and rotations, as viewnet.geometry and viewnet.estimator have it.
//
// The object's axes: x its front, y its left side, z up. Angles are in degrees.

/**
 * The viewpoint that hypotheses {vectors, logits} of a model of models.json amount to.
 *
 * {azimuth, elevation, confidence, chosen, ranked, rival}: `ranked` has every hypothesis by falling probability,
 * {number, azimuth, elevation, probability, camera, chosen}; `camera` is its frame, rows right, up and back; `rival` is
 * the likeliest hypothesis of the object's other side where that side has enough of the probability, else null. So many
 * `turns` of the model's objects look alike: 1 the whole one, 2 half turns, 0 those by any angle.
 */
export function viewpointOf({ vectors, logits }, { rotation, turns }, { doubt, right }) {
  const most = Math.max(...logits);
  const shares = logits.map((logit) => Math.exp(logit - most));
  const total = shares.reduce((sum, share) => sum + share);
  const choice = logits.indexOf(most);
  const found = vectors.map((own, i) => {
    const vector = rotation.map((row) => dot(row, own));
    return { ...anglesOf(vector), probability: shares[i] / total, camera: lookAt(vector), chosen: i === choice };
  });
  const answer = found[choice];
  // Among equals the chosen one comes first.
  const ranked = [...found].sort((a, b) => b.probability - a.probability || b.chosen - a.chosen);
  ranked.forEach((each, i) => {
    each.number = i + 1;
  });
  const near = found.filter((each) => angleBetween(each.camera, answer.camera, turns) < right);
  const opposite = ranked.filter((each) => dot(each.camera[2], answer.camera[2]) < 0);
  return {
    ...answer,
    ranked,
    confidence: probabilityOf(near),
    rival: turns === 1 && probabilityOf(opposite) >= doubt ? opposite[0] : null,
  };
}

/** The rotation between object and camera as a program of models.json's frames has it: three rows. */
export function rotationAs(camera, { signs, columns }) {
  const rows = camera.map((axis, i) => axis.map((value) => value * signs[i] + 0)); // no negative zeros
  return columns ? [0, 1, 2].map((i) => rows.map((row) => row[i])) : rows;
}

/** What a viewpoint shows, in words: "the left, from a little above". */
export function inWords({ azimuth, elevation }, { sectors, levels, above }) {
  const sector = sectors[Math.round((azimuth * sectors.length) / 360) % sectors.length];
  const level = levels.find(([limit]) => elevation < limit);
  return `the ${sector}, ${level ? level[1] : above}`;
}

function probabilityOf(hypotheses) {
  return hypotheses.reduce((sum, each) => sum + each.probability, 0);
}

/** Azimuth in [0, 360) and elevation in [-90, 90]. */
function anglesOf([x, y, z]) {
  const azimuth = degrees(Math.atan2(y, x));
  return { azimuth: azimuth < 0 ? azimuth + 360 : azimuth, elevation: degrees(Math.atan2(z, Math.hypot(x, y))) };
}

/** The frame of a level camera along a view vector: rows right, up and back. */
function lookAt(vector) {
  const back = normalised(vector);
  let right = cross([0, 0, 1], back);
  if (Math.hypot(...right) < 1e-6) {
    // From straight above or below every right is level: the object's left side.
    right = [0, 1, 0].map((value, i) => value - back[1] * back[i]);
  }
  right = normalised(right);
  return [right, cross(back, right), back];
}

/** The least angle between two frames after so many turns; exact at 0 and 180, where the arc cosine of the trace is not. */
function angleBetween(still, b, turns) {
  const a = turns === 1 ? still : turnedTowards(still, b, turns);
  const relative = [0, 1, 2].map((i) => [0, 1, 2].map((j) => dot(a[i], b[j])));
  const trace = relative[0][0] + relative[1][1] + relative[2][2];
  const axis = [
    relative[2][1] - relative[1][2],
    relative[0][2] - relative[2][0],
    relative[1][0] - relative[0][1],
  ];
  return degrees(Math.atan2(Math.hypot(...axis), trace - 1));
}

/** A frame turned about the vertical as often as brings it nearest to another one, see viewnet.geometry. */
function turnedTowards(a, b, turns) {
  const product = (i, j) => a.reduce((sum, axis, k) => sum + b[k][i] * axis[j], 0);
  const peak = Math.atan2(product(1, 0) - product(0, 1), product(0, 0) + product(1, 1));
  const angle = turns ? (Math.round((peak * turns) / (2 * Math.PI)) * 2 * Math.PI) / turns : peak;
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return a.map(([x, y, z]) => [cos * x - sin * y, sin * x + cos * y, z]);
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function normalised(vector) {
  const length = Math.hypot(...vector);
  return vector.map((value) => value / length);
}

function degrees(radians) {
  return (radians * 180) / Math.PI;
}
