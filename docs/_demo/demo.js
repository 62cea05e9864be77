// The agent in the browser: a photo becomes a goal of the viewer (viewer.js), whose episodes are computed here by ONNX models.
import * as ort from "./ort.wasm.bundle.min.mjs";

const facts = JSON.parse(document.getElementById("demo").textContent);
const SIZE = 224, HEADINGS = 4;
const HERE = "It runs in this page, on your device; no photo leaves it.";
const said = (text) => { byId("photo-said").textContent = text; };

async function fetched(file) {
  const answer = await fetch(file);
  if (!answer.ok) throw new Error(`${file} is missing`);
  return file.endsWith(".gz") ? new Response(answer.body.pipeThrough(new DecompressionStream("gzip"))).arrayBuffer()
    : answer.arrayBuffer();
}
let loading = null;
const models = () => (loading ??= load().catch((error) => { loading = null; throw error; }));
async function load() {
  said(`Loading the agent, 10 MB. ${HERE}`);
  ort.env.wasm.numThreads = 1;  // more need headers that a static page does not have
  const names = ["camera", "place", "mind", "memory"];
  const [wasm, views, ...files] = await Promise.all(["ort-wasm-simd-threaded.wasm.gz", `${facts.name}.f16.gz`,
    ...names.map((name) => `${name}.onnx`)].map(fetched));
  ort.env.wasm.wasmBinary = wasm;
  const found = { views: tensor(halves(new Uint16Array(views)), facts.states, facts.width) };
  for (const [i, name] of names.entries()) found[name] = await ort.InferenceSession.create(new Uint8Array(files[i]));
  const around = whole(D.surrounding.flat(), facts.states, HEADINGS);
  found.seen = (await found.place.run({ views: found.views, surrounding: around })).seen;  // whatever the photo
  const { logits } = await decided(found, new Float32Array(SIZE * SIZE * 3));  // this and the rest compile what they need
  await planned({ logits: logits.data, stops: new Set(D.surrounding.keys()) }, path[0], found.memory);
  resized({ data: new Uint8ClampedArray(4 * SIZE * SIZE), width: SIZE, height: SIZE });
  return found;
}
async function decided({ camera, mind, views, seen }, pixels) {
  const { photo } = await camera.run({ pixels: tensor(pixels, SIZE, SIZE, 3) });
  return mind.run({ views, seen, photo });
}
function halves(bits) {  // float16 to float32
  return Float32Array.from(bits, (h) => {
    const sign = h >> 15 ? -1 : 1, exponent = (h >> 10) & 31, fraction = (h & 1023) / 1024;
    return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction) : 2 ** -14 * fraction);
  });
}
const tensor = (values, ...shape) => new ort.Tensor(values, shape);
const whole = (values, ...shape) => new ort.Tensor("int64", BigInt64Array.from(values, BigInt), shape);
const truth = (values, ...shape) => new ort.Tensor("bool", Uint8Array.from(values, Number), shape);

// Resized as Pillow does it (bilinear, over all pixels that fall into one), as the features of the places were made.
function weights(from, to) {
  const scale = from / to, reach = Math.max(1, scale);
  return Array.from({ length: to }, (_, i) => {
    const middle = (i + 0.5) * scale, first = Math.max(0, Math.trunc(middle - reach + 0.5));
    const last = Math.min(from, Math.trunc(middle + reach + 0.5));
    const taps = Array.from({ length: last - first }, (_, k) => Math.max(0, 1 - Math.abs((first + k + 0.5 - middle) / reach)));
    const sum = taps.reduce((a, b) => a + b);
    return { first, taps: taps.map((tap) => tap / sum) };
  });
}
function resized({ data, width, height }) {
  const rows = new Uint8ClampedArray(height * SIZE * 3), pixels = new Uint8ClampedArray(SIZE * SIZE * 3);
  weights(width, SIZE).forEach(({ first, taps }, x) => {
    for (let y = 0; y < height; y++) for (let c = 0; c < 3; c++) {
      rows[(y * SIZE + x) * 3 + c] = taps.reduce((sum, tap, k) => sum + tap * data[(y * width + first + k) * 4 + c], 0);
    }
  });
  weights(height, SIZE).forEach(({ first, taps }, y) => {
    for (let x = 0; x < SIZE; x++) for (let c = 0; c < 3; c++) {
      pixels[(y * SIZE + x) * 3 + c] = taps.reduce((sum, tap, k) => sum + tap * rows[((first + k) * SIZE + x) * 3 + c], 0);
    }
  });
  return Float32Array.from(pixels);
}
function cropped(image) {  // the middle, in the shape of a view; a large one is made smaller
  const width = Math.min(image.width, image.height * facts.aspect), height = width / facts.aspect;
  const canvas = document.createElement("canvas"), smaller = Math.min(1, 1024 / width);
  canvas.width = Math.round(width * smaller);
  canvas.height = Math.round(height * smaller);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(image, (image.width - width) / 2, (image.height - height) / 2, width, height, 0, 0, canvas.width, canvas.height);
  return { shown: canvas.toDataURL("image/jpeg", 0.9), pixels: context.getImageData(0, 0, canvas.width, canvas.height) };
}

let photos = 0;
async function look(blob) {
  try {
    const image = await createImageBitmap(blob), loaded = await models();
    const begun = performance.now(), { shown, pixels } = cropped(image);
    const { logits, scores } = await decided(loaded, resized(pixels));
    const best = scores.data.indexOf(Math.max(...scores.data));
    const found = { state: null, name: `your photo ${++photos}`, image: shown, logits: logits.data, values: null,
      scores: scores.data, stops: new Set(), walks: D.agents.map(() => ({})), ask: (state) => answer(found, state), best };
    setThreshold(found);
    await answer(found, path[0], false);
    goals.push(found);
    offerGoal(found);
    chooseGoal(goals.length - 1, path[0]);
    play();
    document.body.dataset.answered = Math.round(performance.now() - begun);
    said(`The view most like it: state ${best}, with a match of ${scores.data[best].toFixed(2)}. Answered in `
      + `${document.body.dataset.answered} ms; ${goal.stops.size ? "the map shows the walk" : "nothing matches enough to stop: move the slider down"}.`);
  } catch (error) {
    said(`That did not work: ${error.message}`);
  }
}
function setThreshold(found) {
  const threshold = Number(byId("photo-threshold").value);
  byId("photo-threshold-value").textContent = threshold.toFixed(2);
  if (!found?.ask) return;
  found.threshold = threshold;
  found.stops = new Set([...found.scores.keys()].filter((state) => found.scores[state] > threshold));
  found.walks.forEach((walks) => Object.keys(walks).forEach((start) => delete walks[start]));
}
async function answer(found, start, shows = true) {  // what the agents do from a state
  const walks = [await planned(found, start, (await models()).memory), greedy(found, start)];
  walks.forEach((actions, who) => { found.walks[who][start] = actions; });
  if (shows && goal === found) began(start);
}
function greedy(found, start) {
  let state = start, actions = "";
  while (actions.length < D.max_steps && !(actions && found.stops.has(state))) {
    const likely = found.logits.subarray(4 * state, 4 * state + 4), action = likely.indexOf(Math.max(...likely));
    actions += action;
    state = after(state, action);
  }
  return actions;
}
async function planned(found, start, memory) {  // see docs/demo.py: Memory
  let state = start, actions = "", action = -1, seen = Array(HEADINGS).fill(null), used = Array(HEADINGS).fill(false);
  let known = { cost: tensor(new Float32Array(4 * HEADINGS).fill(Infinity), 1, HEADINGS, 4),
    after: whole(Array(4 * HEADINGS).fill(-1), 1, HEADINGS, 4), ring: whole(Array(4 * HEADINGS).fill(-1), 1, HEADINGS, 4),
    taken: truth(Array(4 * HEADINGS).fill(0), 1, HEADINGS, 4), goal: truth(Array(HEADINGS).fill(0), 1, HEADINGS),
    here: whole([-1], 1) };
  while (actions.length < D.max_steps && !(actions && found.stops.has(state))) {
    const around = D.surrounding[state], like = facts.alike[state];
    const same = seen.map((node, i) => used[i] && like.includes(node));
    const results = await memory.run({ ...known, same: truth(same, 1, same.length), action: whole([action], 1),
      logits: tensor(Float32Array.from(around.flatMap((s) => [...found.logits.subarray(4 * s, 4 * s + 4)])), 1, HEADINGS, 4),
      seen: truth(around.map((s) => found.stops.has(s)), 1, HEADINGS), quarter: truth([facts.quarter], 1) });
    known = Object.fromEntries(Object.keys(known).map((name) => [name, results[`next_${name}`]]));
    seen = [...seen, ...around];
    used = [...used, ...Array(HEADINGS).fill(!same.includes(true))];
    action = results.plan.data.indexOf(Math.max(...results.plan.data));
    actions += action;
    state = after(state, action);
  }
  return actions;
}

byId("photo").addEventListener("change", (e) => { if (e.target.files.length) look(e.target.files[0]); });
facts.photos.forEach((file, i) => {
  const button = byId("photos").appendChild(document.createElement("button")), image = document.createElement("img");
  image.src = file;
  image.alt = button.title = `photo ${i + 1}`;
  image.width = 76;
  button.appendChild(image);
  button.addEventListener("click", async () => look(await (await fetch(file)).blob()));
});
byId("photo-threshold").value = facts.threshold;
byId("photo-threshold").addEventListener("input", () => { setThreshold(goal); if (goal.ask) begin(path[0]); });
byId("photo-threshold").addEventListener("change", (e) => { e.target.blur(); if (goal.ask) play(); });
setThreshold(null);
models().then(() => said(`The agent is ready. ${HERE}`), (error) => said(`The agent cannot be loaded: ${error.message}`));
