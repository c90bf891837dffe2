// From a file to pixels as Pillow decodes them: upright, colours as they are in the file, not multiplied by alpha.

import { isTransparent } from "./crop.js";

const STRIP = 2 ** 22; // pixels that are read at once: some browsers have small canvases

/**
 * A file as {width, height, pixels, bitmap}: red, green, blue and alpha of each pixel, and what a canvas can draw.
 *
 * Throws an Error with one sentence for people where the browser cannot decode it or it has more than `largest` pixels.
 */
export async function readImage(file, largest) {
  const { width, height } = await sizeOf(file);
  if (width * height > largest) {
    throw new Error(`${file.name} has more than ${largest / 1e6} million pixels (${width} x ${height}).`);
  }
  let bitmap;
  let pixels;
  try {
    bitmap = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
    pixels = drawnPixels(bitmap);
    if (isTransparent({ pixels })) {
      pixels = (await straightPixels(bitmap)) ?? pixels;
    }
  } catch {
    throw undecoded(file);
  }
  return { width: bitmap.width, height: bitmap.height, pixels, bitmap };
}

function undecoded(file) {
  return new Error(`${file.name} is not an image that this browser can read, or it is damaged.`);
}

/** Width and height from the file's header, before anything large is decoded. */
async function sizeOf(file) {
  const address = URL.createObjectURL(file);
  const image = new Image();
  image.src = address;
  try {
    await new Promise((found, failed) => {
      image.onload = found;
      image.onerror = failed;
    });
  } catch {
    throw undecoded(file);
  } finally {
    URL.revokeObjectURL(address);
  }
  return { width: image.naturalWidth, height: image.naturalHeight };
}

/** Pixels by way of a canvas, which multiplies colours by alpha and loses those of transparent pixels. */
function drawnPixels(bitmap) {
  const { width, height } = bitmap;
  const pixels = new Uint8ClampedArray(width * height * 4);
  const rows = Math.max(1, Math.floor(STRIP / width));
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = Math.min(rows, height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  for (let top = 0; top < height; top += rows) {
    const count = Math.min(rows, height - top);
    context.clearRect(0, 0, width, count);
    context.drawImage(bitmap, 0, -top);
    pixels.set(context.getImageData(0, 0, width, count).data, top * width * 4);
  }
  return pixels;
}

/** Pixels by way of a video frame, which keeps the colours of transparent ones; null where a browser has none. */
async function straightPixels(bitmap) {
  if (!("VideoFrame" in window)) {
    return null;
  }
  const frame = new VideoFrame(bitmap, { timestamp: 0 });
  try {
    const reversed = frame.format === "BGRA";
    if (!reversed && frame.format !== "RGBA") {
      return null;
    }
    // Not converted to another format while it is copied: that multiplies colours by alpha.
    const pixels = new Uint8ClampedArray(bitmap.width * bitmap.height * 4);
    await frame.copyTo(pixels, { layout: [{ offset: 0, stride: bitmap.width * 4 }] });
    for (let i = 0; reversed && i < pixels.length; i += 4) {
      [pixels[i], pixels[i + 2]] = [pixels[i + 2], pixels[i]];
    }
    return pixels;
  } finally {
    frame.close();
  }
}
