// The image on the page, and the box that is drawn on it by mouse, finger or pen.

const canvas = document.getElementById("canvas");
const context = canvas.getContext("2d");

let shown = null; // the bitmap, or null
let marked = null; // the box [left, top, right, bottom] in the image's pixels, or null
let tell = () => {};

/** Show an image with its box; without an image (null) the stage is empty. */
export function show(bitmap, box) {
  shown = bitmap;
  marked = box;
  draw();
}

/** Call `changed` with a box [left, top, right, bottom], in pixels of the image, whenever one has been drawn. */
export function onBox(changed) {
  tell = changed;
}

/** Where the image lies on the canvas: as large as it fits, in the middle. */
function placement() {
  const scale = Math.min(canvas.width / shown.width, canvas.height / shown.height);
  const x = (canvas.width - scale * shown.width) / 2;
  const y = (canvas.height - scale * shown.height) / 2;
  return { scale, x, y };
}

function draw() {
  const density = window.devicePixelRatio;
  canvas.width = Math.max(1, Math.round(canvas.clientWidth * density));
  canvas.height = Math.max(1, Math.round(canvas.clientHeight * density));
  if (!shown) {
    return;
  }
  const { scale, x, y } = placement();
  context.imageSmoothingQuality = "high";
  context.drawImage(shown, x, y, scale * shown.width, scale * shown.height);
  if (marked) {
    const [left, top, right, bottom] = marked;
    const place = [x + scale * left, y + scale * top, scale * (right - left), scale * (bottom - top)];
    // Two lines, so that it stands out from any image.
    context.strokeStyle = "#fff";
    context.lineWidth = 4 * density;
    context.strokeRect(...place);
    context.strokeStyle = "#d55e00";
    context.lineWidth = 2 * density;
    context.strokeRect(...place);
  }
}

/** The point of the image, in its pixels, that is nearest to the pointer. */
function pointed(event) {
  const { scale, x, y } = placement();
  const density = canvas.width / canvas.clientWidth;
  const column = (event.offsetX * density - x) / scale;
  const row = (event.offsetY * density - y) / scale;
  return [Math.round(Math.min(Math.max(column, 0), shown.width)), Math.round(Math.min(Math.max(row, 0), shown.height))];
}

function between([x0, y0], [x1, y1]) {
  return [Math.min(x0, x1), Math.min(y0, y1), Math.max(x0, x1), Math.max(y0, y1)];
}

let corner = null; // where drawing began
canvas.addEventListener("pointerdown", (event) => {
  if (shown && event.isPrimary && event.button === 0) {
    canvas.setPointerCapture(event.pointerId);
    corner = pointed(event);
  }
});
canvas.addEventListener("pointermove", (event) => {
  if (corner) {
    marked = between(corner, pointed(event));
    draw();
  }
});
canvas.addEventListener("pointerup", (event) => {
  if (corner) {
    marked = between(corner, pointed(event));
    corner = null;
    draw();
    tell(marked);
  }
});
canvas.addEventListener("pointercancel", () => {
  corner = null;
});
new ResizeObserver(draw).observe(canvas);
