// A viewpoint drawn as the page of `viewnet demo` draws it: the object from above, its front below, and from the side.
//
// Hypotheses differ by number, width and dashes as well as by colour. Colours come from style.css, by class.

const SIDE = 260; // width and height of what is drawn, in its own units
const RING = 84; // radius of the camera's circle, from above
const ARC = 104; // radius of the camera's arc, from the side
const MIDDLE = [SIDE / 2, SIDE / 2];
const BESIDE = [82, SIDE / 2]; // the object's place from the side

/** An <svg> of the object from above, with the camera of each hypothesis (none: the empty compass). */
export function fromAbove(ranked) {
  const drawn = canvas(`Seen from above: ${placed(ranked, "azimuth")}`);
  drawn.append(shape("circle", { cx: MIDDLE[0], cy: MIDDLE[1], r: RING, class: "line" }));
  const sides = [
    [0, "front", "middle", 0, 30],
    [90, "left", "start", 18, 0],
    [180, "back", "middle", 0, -33],
    [270, "right", "end", -18, 0],
  ];
  for (const [azimuth, name, anchor, x, y] of sides) {
    const [startX, startY] = polar(MIDDLE, RING - 4, azimuth - 90);
    const [endX, endY] = polar(MIDDLE, RING + 4, azimuth - 90);
    drawn.append(shape("line", { x1: startX, y1: startY, x2: endX, y2: endY, class: "tick" }));
    const [atX, atY] = polar(MIDDLE, RING, azimuth - 90);
    drawn.append(label(atX + x, atY + y - 3, `${azimuth}°`, anchor, "label"));
    drawn.append(label(atX + x, atY + y + 11, name, anchor, "label strong"));
  }
  // A body with a nose at the front.
  drawn.append(shape("path", { d: "M 110 100 h 40 v 44 l -20 20 l -20 -20 z", class: "body" }));
  drawn.append(...arrows(ranked, MIDDLE, RING, (each) => each.azimuth - 90));
  return drawn;
}

/** An <svg> of the horizon from the side, with the height of each hypothesis's camera. */
export function fromTheSide(ranked) {
  const drawn = canvas(`Seen from the side: ${placed(ranked, "elevation")}`);
  const [x, y] = BESIDE;
  drawn.append(shape("path", { d: `M ${x} ${y - ARC} A ${ARC} ${ARC} 0 0 1 ${x} ${y + ARC}`, class: "line" }));
  drawn.append(shape("line", { x1: 4, y1: y, x2: x + ARC + 24, y2: y, class: "line dashed" }));
  for (const elevation of [-90, -45, 0, 45, 90]) {
    const [startX, startY] = polar(BESIDE, ARC - 4, elevation);
    const [endX, endY] = polar(BESIDE, ARC + 4, elevation);
    drawn.append(shape("line", { x1: startX, y1: startY, x2: endX, y2: endY, class: "tick" }));
    const [atX, atY] = polar(BESIDE, ARC + 20, elevation);
    const upright = Math.abs(elevation) === 90; // beside the end of the arc
    const place = upright ? [x - 8, endY + 4, "end"] : [atX, atY + 4, "middle"];
    drawn.append(label(place[0], place[1], `${elevation}°`, place[2], "label"));
  }
  drawn.append(shape("rect", { x: x - 22, y: y - 16, width: 44, height: 32, rx: 7, class: "body" }));
  drawn.append(label(0, y - 6, "horizon", "start", "label"));
  drawn.append(...arrows(ranked, BESIDE, ARC, (each) => each.elevation));
  return drawn;
}

function placed(ranked, angle) {
  const chosen = ranked.find((each) => each.chosen);
  return chosen ? `the camera stands at ${angle} ${Math.round(chosen[angle])} degrees` : "no camera yet";
}

function canvas(title) {
  // Wider than high, so that no arrow or label is cut off.
  return shape("svg", { viewBox: `-24 -4 308 ${SIDE + 8}`, role: "img", "aria-label": title });
}

/** Each hypothesis as an arrow from its camera towards the object, the most probable on top. */
function arrows(ranked, centre, radius, degreesOf) {
  return [...ranked].reverse().map((each) => {
    const [x, y] = polar(centre, radius, degreesOf(each));
    const [stepX, stepY] = polar([0, 0], -1, degreesOf(each));
    const endX = x + 38 * stepX;
    const endY = y + 38 * stepY;
    const tip = `${x + 48 * stepX} ${y + 48 * stepY}`;
    const wings = `${endX - 6 * stepY} ${endY + 6 * stepX} L ${endX + 6 * stepY} ${endY - 6 * stepX}`;
    const width = each.chosen ? 4 : 1.2 + 3 * each.probability;
    const group = shape("g", { class: each.chosen ? "hypothesis chosen" : "hypothesis other" });
    group.append(
      shape("line", { x1: x, y1: y, x2: endX, y2: endY, "stroke-width": width }),
      shape("path", { d: `M ${tip} L ${wings} z` }),
      shape("circle", { cx: x, cy: y, r: each.chosen ? 11 : 9 }),
      label(x, y + 4, `${each.number}`, "middle", "number"),
    );
    return group;
  });
}

/** The point at a radius and an angle, counter-clockwise from the right. */
function polar([x, y], radius, degrees) {
  const angle = (degrees * Math.PI) / 180;
  return [x + radius * Math.cos(angle), y - radius * Math.sin(angle)];
}

function label(x, y, text, anchor, kind = "label") {
  const found = shape("text", { x, y, "text-anchor": anchor, class: kind });
  found.textContent = text;
  return found;
}

function shape(name, attributes) {
  const found = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [attribute, value] of Object.entries(attributes)) {
    found.setAttribute(attribute, value);
  }
  return found;
}
