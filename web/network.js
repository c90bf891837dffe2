// The viewpoint networks, run by ONNX Runtime in WebAssembly on one thread.

import { env, InferenceSession, Tensor } from "./ort.wasm.bundle.min.mjs";

const sessions = new Map(); // of a model's file: a network is loaded once, when it is first asked for
let runtime = null;

/** Load a model of models.json, so that its first answer comes at once. Throws an Error where a file is missing. */
export async function load(model) {
  if (!sessions.has(model.file)) {
    sessions.set(model.file, started(model.file));
  }
  try {
    return await sessions.get(model.file);
  } catch (error) {
    sessions.delete(model.file); // the next time may be luckier
    throw error;
  }
}

/** The hypotheses for an input of `networkInput`: {vectors, logits}, in the network's own frame. */
export async function hypotheses(model, input) {
  const session = await load(model);
  const { size } = model.framing;
  const found = await session.run({ images: new Tensor("float32", input, [1, 3, size, size]) });
  const flat = Array.from(found.vectors.data);
  const logits = Array.from(found.logits.data);
  return { vectors: logits.map((_, i) => flat.slice(3 * i, 3 * i + 3)), logits };
}

async function started(file) {
  runtime ??= prepared();
  runtime.catch(() => {
    runtime = null;
  });
  const [content] = await Promise.all([fetched(file), runtime]);
  return InferenceSession.create(new Uint8Array(await content.arrayBuffer()), { executionProviders: ["wasm"] });
}

/** Hand the runtime its WebAssembly. It is kept compressed, a fourth of its size. */
async function prepared() {
  env.wasm.numThreads = 1; // more would need headers that not every server can send
  const file = await fetched("ort.wasm.gz");
  const content = new Uint8Array(await file.arrayBuffer());
  // Some servers call it compressed content, and then the browser has expanded it already.
  const compressed = content[0] === 0x1f && content[1] === 0x8b;
  const expanded = compressed ? new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip")) : content;
  env.wasm.wasmBinary = await new Response(expanded).arrayBuffer();
}

async function fetched(file) {
  const answer = await fetch(file);
  if (!answer.ok) {
    throw new Error(`${file} is missing beside this page.`);
  }
  return answer;
}
