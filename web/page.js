// The page: an image and its box in, the viewpoint out.

import { fromAbove, fromTheSide } from "./compass.js";
import { networkInput } from "./crop.js";
import { readImage } from "./image.js";
import { hypotheses, load } from "./network.js";
import { onBox, show } from "./stage.js";
import { inWords, rotationAs, viewpointOf } from "./viewpoint.js";

const EDGES = ["x0", "y0", "x1", "y1"];
const element = (id) => document.getElementById(id);
const edge = (name) => document.querySelector(`#box [name=${name}]`);

let about = null; // models.json
let image = null; // of readImage
let reading = null; // the promise that `image` is there, broken where its file is none
let answer = null; // of viewpointOf
let newest = 0; // number of the latest question: what earlier ones bring comes too late

/** Answer for what is on the page now; whatever goes wrong is told in one sentence, and no answer is left. */
async function ask() {
  newest += 1;
  const question = newest;
  element("message").textContent = "";
  element("answer").ariaBusy = "true";
  let found = null;
  let problem = "";
  try {
    await reading;
    if (image && question === newest) {
      const model = chosenModel();
      const input = networkInput(image, typedBox(), model.framing);
      found = viewpointOf(await hypotheses(model, input), model, about.answers);
    }
  } catch (error) {
    problem = error.message;
  }
  if (question === newest) {
    answer = found;
    element("message").textContent = problem;
    element("answer").ariaBusy = "false";
    showAnswer();
  }
}

/** Take a file, or the promise of one, for the new image, with a box or, by null, all of it. */
function take(file, box = null) {
  answer = null;
  showAnswer();
  setImage(null, null);
  const mine = Promise.resolve(file)
    .then((content) => readImage(content, about.largest))
    .then((read) => {
      if (reading === mine) {
        setImage(read, box);
      } else {
        read.bitmap.close(); // another file has been chosen meanwhile
      }
    });
  reading = mine;
  ask();
}

function setImage(read, box) {
  image?.bitmap.close();
  image = read;
  element("box").disabled = !image;
  element("hint").hidden = Boolean(image);
  element("canvas").ariaLabel = image ? `The image, ${image.width} x ${image.height} pixels` : "No image yet";
  setBox(box);
}

function setBox(box) {
  EDGES.forEach((name, i) => {
    edge(name).value = box ? box[i] : "";
  });
  show(image?.bitmap ?? null, box);
}

/** The box in the fields, null where all are empty. Throws an Error for anything that is no box. */
function typedBox() {
  const typed = EDGES.map((name) => edge(name));
  if (typed.every((field) => field.value === "" && !field.validity.badInput)) {
    return null;
  }
  const box = typed.map((field) => field.valueAsNumber);
  if (box.some(Number.isNaN)) {
    throw new Error("The box needs four numbers, in pixels: left, top, right and bottom.");
  }
  if (box[2] <= box[0] || box[3] <= box[1]) {
    throw new Error("The box has no area: left has to be below right, and top below bottom.");
  }
  return box;
}

function chosenModel() {
  return about.models[element("model").value];
}

function showAnswer() {
  const ranked = answer ? answer.ranked : [];
  element("words").textContent = answer ? sentence() : "The answer appears here.";
  number("azimuth", answer?.azimuth, "°");
  number("elevation", answer?.elevation, "°");
  number("confidence", answer && 100 * answer.confidence, " %");
  element("compass").replaceChildren(fromAbove(ranked), fromTheSide(ranked));
  const rows = [0, 1, 2].map((i) => hypothesisRow(ranked[i]));
  document.querySelector("#hypotheses tbody").replaceChildren(...rows);
  showRotation();
}

function sentence() {
  const rival = answer.rival ? `, or azimuth ${answer.rival.azimuth.toFixed(1)}°` : "";
  return `The camera sees ${inWords(answer, about.words)}${rival}.`;
}

/** Show a number with one digit; all of its digits are in the element's value. */
function number(id, value, unit) {
  element(id).value = value ?? "";
  element(id).textContent = value === undefined || value === null ? "–" : value.toFixed(1) + unit;
}

/** A row of the table; its number is marked as in the compass, and the first is the answer. */
function hypothesisRow(each) {
  const row = document.createElement("tr");
  const kind = each?.chosen ? "chosen" : "other";
  const head = document.createElement("th");
  head.scope = "row";
  const badge = document.createElement("span");
  badge.className = each ? `badge ${kind}` : "";
  badge.textContent = each ? each.number : "–";
  head.append(badge);
  row.append(head);
  const cells = each ? [`${each.azimuth.toFixed(1)}°`, `${each.elevation.toFixed(1)}°`] : ["–", "–"];
  for (const text of cells) {
    row.insertCell().textContent = text;
  }
  const share = row.insertCell();
  share.textContent = each ? `${(100 * each.probability).toFixed(1)} %` : "–";
  const bar = document.createElement("span");
  bar.className = `bar ${kind}`;
  bar.style.width = each ? `${100 * each.probability}%` : "0";
  share.append(bar);
  return row;
}

function showRotation() {
  const frame = about.frames[element("frame").value];
  const chosen = answer && rotationAs(answer.camera, frame);
  const rows = [0, 1, 2].map((i) => {
    const row = document.createElement("tr");
    for (let j = 0; j < 3; j++) {
      row.insertCell().textContent = chosen ? fixed(chosen[i][j], 4) : "–";
    }
    return row;
  });
  document.querySelector("#matrix tbody").replaceChildren(...rows);
  element("meaning").textContent = frame.meaning;
}

/** A number with some digits, and no minus sign before zeros. */
function fixed(value, digits) {
  const text = value.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

function showAccuracy() {
  const name = element("model").selectedOptions[0].text;
  const measured = chosenModel().accuracy.map(
    (each) => `${each.acc30.toFixed(1)} % on ${each.on} (median error ${each.median.toFixed(1)}°)`,
  );
  const note = chosenModel().note ? ` ${chosenModel().note}.` : "";
  element("accuracy").textContent = `Measured of the ${name} model, within 30°: ${measured.join("; ")}.${note}`;
}

function listen() {
  element("file").addEventListener("change", (event) => {
    const [file] = event.target.files;
    event.target.value = ""; // so that the same file can be chosen again
    if (file) {
      take(file);
    }
  });
  element("example").addEventListener("click", () => {
    const { file, model, box } = about.example;
    element("model").value = model;
    showAccuracy();
    take(fetchedFile(file), box);
  });
  element("model").addEventListener("change", () => {
    showAccuracy();
    ask();
  });
  for (const name of EDGES) {
    edge(name).addEventListener("change", () => {
      const box = EDGES.map((each) => edge(each).valueAsNumber);
      show(image.bitmap, box.some(Number.isNaN) ? null : box);
      ask();
    });
  }
  element("whole").addEventListener("click", () => {
    setBox(null);
    ask();
  });
  onBox((box) => {
    setBox(box);
    ask();
  });
  element("frame").addEventListener("change", showRotation);
  // Anywhere on the page: elsewhere a dropped file would be opened in place of it.
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    takeFirst(event.dataTransfer);
  });
  document.addEventListener("paste", (event) => takeFirst(event.clipboardData));
}

async function fetchedFile(name) {
  const found = await fetch(name);
  return new File([await found.blob()], name);
}

function takeFirst(transfer) {
  if (transfer.files.length) {
    take(transfer.files[0]);
  }
}

async function start() {
  try {
    about = await (await fetch("models.json")).json();
    showAccuracy();
    showAnswer();
    listen();
    await load(chosenModel());
    document.body.dataset.ready = "";
  } catch (error) {
    element("message").textContent = `The page could not be loaded: ${error.message}`;
  }
}

start();
