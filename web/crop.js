// From an image and a box to the network's input, number for number as viewnet.data.crop, viewnet.estimator.preprocess
// and Pillow compute it. A browser's own scaling differs from Pillow's, and viewpoints with it, by degrees.
//
// Images are {width, height, pixels}: red, green, blue and alpha of each pixel, 8 bits each, not multiplied by alpha.
// Once cut they are opaque, and {width, height, pixels} has three bytes a pixel.

const PRECISION = 22; // bits after the binary point of Pillow's weights
const REDUCING_GAP = 4; // cut() in viewnet.data.crop: large images are averaged over whole pixels first
const MOST_PIXELS = 2 ** 28; // of a crop before it is resized

/**
 * The input of a network, of shape (1, 3, size, size) in [0, 1].
 *
 * image    as above
 * box      [left, top, right, bottom] in pixels, or null: the whole image or, with transparency, what is opaque
 * framing  {size, crop, margin, square, around, opaque, between} from models.json
 *
 * Throws an Error with one sentence for people where the box has no part in the image, or nothing in it is opaque.
 */
export function networkInput(image, box, framing) {
  let margin = framing.margin;
  let size = framing.crop;
  const transparent = isTransparent(image);
  if (transparent && box) {
    box = opaqueBounds(image, widened(box, framing.around, image));
  } else if (transparent) {
    box = opaqueBounds(image, [0, 0, image.width, image.height]);
    image = overGrey(image, framing.opaque);
  } else if (!box) {
    margin = 0;
    // An image of exactly the input's size is taken as cut already.
    const ready = image.width === framing.size && image.height === framing.size;
    size = ready ? framing.size : framing.crop;
  }
  const cropped = cut(image, box, { size, margin, square: framing.square });
  return scaled(cropped, framing.size, framing.between);
}

/** The box's part of an image, [left, top, right, bottom]. Throws an Error for less than a pixel of it. */
function clipped(box, width, height) {
  const left = Math.max(box[0], 0);
  const top = Math.max(box[1], 0);
  const right = Math.min(box[2], width);
  const bottom = Math.min(box[3], height);
  if (right - left < 1 || bottom - top < 1) {
    throw new Error(`The box has no part in the image (${width} x ${height} pixels).`);
  }
  return [left, top, right, bottom];
}

/** An image cut to a box (null: all of it), with black beyond the image's edges, {size} pixels along a side. */
export function cut(image, box, { size, margin, square }) {
  const [x0, y0, x1, y1] = clipped(box ?? [0, 0, image.width, image.height], image.width, image.height);
  let halfX = (x1 - x0) / 2;
  let halfY = (y1 - y0) / 2;
  const beyond = 2 * margin * Math.max(halfX, halfY);
  halfX += beyond;
  halfY += beyond;
  if (square) {
    halfX = Math.max(halfX, halfY);
    halfY = halfX;
  }
  const centreX = (x0 + x1) / 2;
  const centreY = (y0 + y1) / 2;
  // Whole pixels around what is seen; resizing cuts the exact edges.
  const left = Math.floor(centreX - halfX);
  const top = Math.floor(centreY - halfY);
  const right = Math.ceil(centreX + halfX);
  const bottom = Math.ceil(centreY + halfY);
  if ((right - left) * (bottom - top) > MOST_PIXELS) {
    throw new Error(`The box is too large to be cut (${right - left} x ${bottom - top} pixels with its margin).`);
  }
  const exact = [centreX - halfX - left, centreY - halfY - top, centreX + halfX - left, centreY + halfY - top];
  return resized(part(image, left, top, right, bottom), size, exact);
}

/** Colours of the pixels from left and top to right and bottom, black where the image has none. */
function part(image, left, top, right, bottom) {
  const width = right - left;
  const pixels = new Uint8Array(width * (bottom - top) * 3);
  for (let y = Math.max(top, 0); y < Math.min(bottom, image.height); y++) {
    for (let x = Math.max(left, 0); x < Math.min(right, image.width); x++) {
      const from = (y * image.width + x) * 4;
      const to = ((y - top) * width + x - left) * 3;
      pixels[to] = image.pixels[from];
      pixels[to + 1] = image.pixels[from + 1];
      pixels[to + 2] = image.pixels[from + 2];
    }
  }
  return { width, height: bottom - top, pixels };
}

/** Image.resize of Pillow to a square, of a box, by Hamming's window and with a gap for reduction. */
function resized(image, size, box) {
  const factorX = Math.trunc((box[2] - box[0]) / size / REDUCING_GAP) || 1;
  const factorY = Math.trunc((box[3] - box[1]) / size / REDUCING_GAP) || 1;
  if (factorX > 1 || factorY > 1) {
    // The window reaches half a resulting pixel beyond the box.
    const reachX = (0.5 * (box[2] - box[0])) / size;
    const reachY = (0.5 * (box[3] - box[1])) / size;
    const safe = [
      Math.max(0, Math.trunc(box[0] - reachX)),
      Math.max(0, Math.trunc(box[1] - reachY)),
      Math.min(image.width, Math.ceil(box[2] + reachX)),
      Math.min(image.height, Math.ceil(box[3] + reachY)),
    ];
    image = reduced(image, factorX, factorY, safe);
    box = [
      (box[0] - safe[0]) / factorX,
      (box[1] - safe[1]) / factorY,
      (box[2] - safe[0]) / factorX,
      (box[3] - safe[1]) / factorY,
    ];
  }
  box = box.map(Math.fround); // Pillow takes its box in single precision
  const wide = size !== image.width || box[0] !== 0 || box[2] !== size;
  const high = size !== image.height || box[1] !== 0 || box[3] !== size;
  if (wide) {
    image = resampledRows(image, weights(image.width, box[0], box[2], size));
  }
  if (high) {
    image = transposed(resampledRows(transposed(image), weights(image.height, box[1], box[3], size)));
  }
  return image;
}

/** Image.reduce of Pillow: averages of blocks of factorX by factorY pixels; blocks at the far edges may be smaller. */
function reduced(image, factorX, factorY, box) {
  const [left, top, right, bottom] = box;
  const width = Math.ceil((right - left) / factorX);
  const height = Math.ceil((bottom - top) / factorY);
  const pixels = new Uint8Array(width * height * 3);
  for (let y = 0; y < height; y++) {
    const startY = top + y * factorY;
    const endY = Math.min(startY + factorY, bottom);
    for (let x = 0; x < width; x++) {
      const startX = left + x * factorX;
      const endX = Math.min(startX + factorX, right);
      const count = (endX - startX) * (endY - startY);
      // Pillow divides by a multiplication with 24 bits after the binary point, of a quotient in single precision.
      const share = Math.trunc(Math.fround(2 ** 24 / count));
      const sums = [count >> 1, count >> 1, count >> 1];
      for (let row = startY; row < endY; row++) {
        for (let at = (row * image.width + startX) * 3; at < (row * image.width + endX) * 3; at += 3) {
          sums[0] += image.pixels[at];
          sums[1] += image.pixels[at + 1];
          sums[2] += image.pixels[at + 2];
        }
      }
      for (let channel = 0; channel < 3; channel++) {
        pixels[(y * width + x) * 3 + channel] = Math.floor((sums[channel] * share) / 2 ** 24);
      }
    }
  }
  return { width, height, pixels };
}

/** For each of `size` resulting pixels the first pixel that counts, and the weights from there on, as whole numbers. */
function weights(length, start, end, size) {
  const scale = Math.fround(end - start) / size;
  const reach = Math.max(scale, 1); // enlarging, the window is a pixel wide to either side
  const found = [];
  for (let i = 0; i < size; i++) {
    const centre = start + (i + 0.5) * scale;
    const first = Math.max(Math.trunc(centre - reach + 0.5), 0);
    const last = Math.min(Math.trunc(centre + reach + 0.5), length);
    const shares = [];
    let total = 0;
    for (let x = first; x < last; x++) {
      const share = hamming((x - centre + 0.5) / reach);
      shares.push(share);
      total += share;
    }
    const whole = shares.map((share) => {
      const value = (total === 0 ? share : share / total) * 2 ** PRECISION;
      return Math.trunc(value < 0 ? value - 0.5 : value + 0.5);
    });
    found.push({ first, whole });
  }
  return found;
}

/** Hamming's window at x, in units of its half width; its numbers are in single precision in Pillow. */
function hamming(x) {
  x = Math.abs(x);
  if (x === 0) {
    return 1;
  }
  if (x >= 1) {
    return 0;
  }
  x *= Math.PI;
  return (Math.sin(x) / x) * (Math.fround(0.54) + Math.fround(0.46) * Math.cos(x));
}

/** Each row of an image as weighted sums of its pixels, rounded to 8 bits. */
function resampledRows(image, weighted) {
  const width = weighted.length;
  const pixels = new Uint8ClampedArray(width * image.height * 3);
  for (let y = 0; y < image.height; y++) {
    for (let x = 0; x < width; x++) {
      const { first, whole } = weighted[x];
      for (let channel = 0; channel < 3; channel++) {
        let sum = 2 ** (PRECISION - 1);
        let at = (y * image.width + first) * 3 + channel;
        for (const weight of whole) {
          sum += image.pixels[at] * weight;
          at += 3;
        }
        pixels[(y * width + x) * 3 + channel] = sum >> PRECISION;
      }
    }
  }
  return { width, height: image.height, pixels };
}

/** An image with its rows as columns. */
function transposed(image) {
  const { width, height } = image;
  const pixels = new Uint8ClampedArray(width * height * 3);
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      for (let channel = 0; channel < 3; channel++) {
        pixels[(x * height + y) * 3 + channel] = image.pixels[(y * width + x) * 3 + channel];
      }
    }
  }
  return { width: height, height: width, pixels };
}

/**
 * A cut image as the network takes it: averages of equal blocks, rounded to 8 bits, in [0, 1], channel by channel.
 *
 * Every step is in single precision, as in PyTorch, since a fourth of all averages lie half way between two numbers.
 */
function scaled(image, size, between) {
  let side = image.width;
  let channels = [0, 1, 2].map((channel) => {
    const values = new Float32Array(side * side);
    for (let i = 0; i < values.length; i++) {
      values[i] = image.pixels[i * 3 + channel] / 255;
    }
    return values;
  });
  if (side > size) {
    channels.forEach((values) => sampleBetween(values, side, between));
  }
  while (side > size) {
    channels = channels.map((values) => halved(values, side));
    side /= 2;
  }
  const input = new Float32Array(3 * size * size);
  channels.forEach((values, channel) => {
    values.forEach((value, i) => {
      input[channel * size * size + i] = roundedToEven(Math.fround(value * 255)) / 255;
    });
  });
  return input;
}

/** Take some columns and rows, [index, place] each, of a square from between two of its own. */
function sampleBetween(values, side, between) {
  for (const [across, along] of [[1, side], [side, 1]]) {
    for (const [index, place] of between) {
      const first = Math.floor(place);
      const second = Math.fround(place - first);
      for (let i = 0; i < side; i++) {
        const at = first * across + i * along;
        // The second product is not rounded before it is added (a fused multiplication and addition).
        values[index * across + i * along] = Math.fround(values[at] * (1 - second)) + values[at + across] * second;
      }
    }
  }
}

/** Averages of blocks of two by two numbers of a square. */
function halved(values, side) {
  const half = side / 2;
  const averages = new Float32Array(half * half);
  for (let y = 0; y < half; y++) {
    for (let x = 0; x < half; x++) {
      const above = 2 * y * side + 2 * x;
      const below = above + side;
      const left = Math.fround(values[above] + values[below]);
      const right = Math.fround(values[above + 1] + values[below + 1]);
      averages[y * half + x] = Math.fround(left + right) / 4;
    }
  }
  return averages;
}

function roundedToEven(value) {
  const down = Math.floor(value);
  if (value - down === 0.5) {
    return down % 2 === 0 ? down : down + 1;
  }
  return Math.round(value);
}

/** Whether any pixel lets something through. */
export function isTransparent(image) {
  for (let i = 3; i < image.pixels.length; i += 4) {
    if (image.pixels[i] < 255) {
      return true;
    }
  }
  return false;
}

/** Whole pixels of a box and a share of its sides around it. */
function widened([x0, y0, x1, y1], around, image) {
  const wide = around * (x1 - x0);
  const high = around * (y1 - y0);
  return [
    Math.max(0, Math.floor(x0 - wide)),
    Math.max(0, Math.floor(y0 - high)),
    Math.min(image.width, Math.ceil(x1 + wide)),
    Math.min(image.height, Math.ceil(y1 + high)),
  ];
}

/** The box around what is opaque within whole pixels. Throws an Error where nothing is. */
function opaqueBounds(image, [left, top, right, bottom]) {
  const found = [Infinity, Infinity, -Infinity, -Infinity];
  for (let y = top; y < bottom; y++) {
    for (let x = left; x < right; x++) {
      if (image.pixels[(y * image.width + x) * 4 + 3] > 127) {
        found[0] = Math.min(found[0], x);
        found[1] = Math.min(found[1], y);
        found[2] = Math.max(found[2], x + 1);
        found[3] = Math.max(found[3], y + 1);
      }
    }
  }
  if (found[0] === Infinity) {
    throw new Error("Everything there is transparent: there is no object to be seen.");
  }
  return found;
}

/** An image over a colour, Image.alpha_composite of Pillow with an opaque background. */
function overGrey(image, colour) {
  const pixels = new Uint8ClampedArray(image.pixels.length);
  for (let i = 0; i < pixels.length; i += 4) {
    const alpha = image.pixels[i + 3];
    for (let channel = 0; channel < 3; channel++) {
      // Pillow blends with 7 further bits, and divides by 255 through shifts.
      const share = alpha * 128;
      const sum = image.pixels[i + channel] * share + colour[channel] * (255 * 128 - share) + (0x80 << 7);
      pixels[i + channel] = ((sum >> 8) + sum) >> 8 >> 7;
    }
    pixels[i + 3] = 255;
  }
  return { ...image, pixels };
}
