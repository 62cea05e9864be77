// An agent's episodes in a scene, and what the page shows of them; the map is drawn by viewer_map.js.
const LOOKS = ["left", "ahead", "right", "back"].map((name) => [D.looks.indexOf(name), name]);  // as they are laid out
const NAMES = { ahead: "↑ ahead", right: "→ turn right", left: "← turn left", back: "↓ back" };
const floats = (text) => text && new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
// A goal's `walks` are what each agent does from each start until it stops or fails, computed by the evaluation itself:
// a digit for an action; null where no episode begins.
const goals = D.goals.map((g) => ({ ...g, logits: floats(g.logits), values: floats(g.values), scores: floats(g.scores),
  stops: new Set(g.stops) }));

// An episode: its states, the actions between, who took each ("policy" or "hand"), and the step that is shown.
let goal = goals[0], path = [], taken = [], by = [], blocked = [], at = 0, timer = null, rival = null, written = null;
let plan = { from: 0, actions: "" };  // what the agent does from a step on, until another hand leads it

const agent = () => Number(byId("agent").value);
const walkFrom = (state, who = agent()) => goal.walks[who]?.[state] ?? null;
const after = (state, action) => (D.graph[state][action] < 0 ? state : D.graph[state][action]);
const along = (start, actions) => Array.from(actions).reduce((all, a) => [...all, after(all.at(-1), Number(a))], [start]);
const probabilities = (logits) => {
  const weights = Array.from(logits, (x) => Math.exp(x - Math.max(...logits))), sum = weights.reduce((a, b) => a + b);
  return weights.map((w) => w / sum);
};
const stopped = (step, of = path) => step > 0 && goal.stops.has(of[step]);
const ended = (step) => stopped(step) || step >= D.max_steps;
const nextAction = () => plan.actions[at - plan.from];

function take(action, who) {
  const next = D.graph[path[at]][action];
  path.length = taken.length = by.length = blocked.length = at + 1;
  path.push(after(path[at], action));
  taken.push(action);
  by.push(who);
  blocked.push(next < 0);
  at++;
  if (who === "hand") follow();  // the agent goes on as if it began there
}
function forward() {  // along what has been walked already, then on as the agent does
  if (at < path.length - 1) at++;
  else take(Number(nextAction()), "policy");
}
function follow() {
  const state = path[at];
  plan = { from: at, actions: walkFrom(state) ?? "" };
  if (goal.ask && goal.walks[0][state] === undefined) goal.ask(state);  // an agent that runs in this page
}
function began(state) {  // what such an agent does from there is known now
  if (at === 0 && path[0] === state) begin(state);
  else if (at === plan.from && path[at] === state) { follow(); show(); }
}
const canGoOn = () => at < path.length - 1 || (!ended(at) && nextAction() !== undefined);
function begin(state) {
  pause();
  path = [state]; taken = [null]; by = [null]; blocked = [false]; at = 0;
  follow();
  const who = byId("beside").value, walked = who === "" ? null : walkFrom(state, Number(who));
  rival = walked === null ? null : { path: along(state, walked) };
  byId("start").value = state;
  say(invalid(state));
  show();
}
function invalid(state) {
  if (walkFrom(state) !== null || goal.ask) return "";
  return goal.distances[state] < 0 ? `No episode begins at ${state}: the goal cannot be reached from there. Walk by hand, or choose another.`
    : `No episode begins at ${state}: it is the goal. Walk by hand, or choose another.`;
}
function say(text) { byId("note").textContent = text; }
function walk(action) { pause(); take(action, "hand"); say(""); show(); }
function pause() { clearInterval(timer); timer = null; }
function play() {
  if (timer !== null) { pause(); return show(); }
  if (!canGoOn()) at = 0;
  if (!canGoOn()) return show();
  timer = setInterval(() => { forward(); if (!canGoOn()) pause(); show(); }, 1000 / Number(byId("speed").value));
  return show();
}
const starts = () => D.graph.flatMap((_, state) => (goal.ask || walkFrom(state) !== null ? [state] : []));
const farthest = () => (goal.distances ? goal.distances.indexOf(Math.max(...goal.distances)) : path[0]);
const randomStart = () => starts()[Math.floor(Math.random() * starts().length)] ?? path[0];

const plural = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
function outcome(states, step, hand = 0) {
  const state = states[step], here = state === goal.state, shortest = goal.distances?.[states[0]] ?? -1;
  const length = plural(step, "step") + (hand ? `, ${hand} by hand` : "");
  const least = shortest < 0 ? "" : ` (shortest path: ${shortest})`;
  if (stopped(step, states) && goal.state === null) return ["good", `Stopped after ${length}: this looks like the photo`];
  if (stopped(step, states) && here) return ["good", `Stopped at the goal after ${length}${least}`];
  if (stopped(step, states)) return ["bad", `False stop after ${length}: this is not the goal`];
  if (step >= D.max_steps && goal.state === null) return ["bad", `Gave up after ${length}: nothing looked enough like the photo`];
  if (step >= D.max_steps) return ["bad", `Failed: not at the goal after ${length}`];
  if (here && step > 0) return ["bad", `Missed: at the goal after ${length}, but not recognised`];
  if (states === path && blocked[step]) return ["", `On the way: ${length}; the last move was blocked`];
  return ["", step === 0 ? `At the start${least}` : `On the way: ${length}`];
}

function makeViews(parent, looks = LOOKS) {
  return looks.map(([column, name]) => {
    const figure = parent.appendChild(document.createElement("figure"));
    figure.className = name;
    const image = figure.appendChild(document.createElement(D.views ? "img" : "div"));
    figure.appendChild(document.createElement("figcaption")).textContent = name;
    return (state) => {
      if (!D.views) return;
      image.src = state === null ? goal.image : picture(D.surrounding[state][column]);
      image.alt = state === null ? "your photo" : `view ${name}, of state ${state}`;
    };
  });
}
const picture = (state) => `data:image/webp;base64,${D.views[state]}`;
const photo = D.goal_view === "front";
const agentViews = makeViews(byId("views")), goalViews = makeViews(byId("goal-views"), photo ? [LOOKS[1]] : LOOKS);
const rivalViews = makeViews(byId("views-beside"));
const rows = D.actions.map((name, action) => {
  const row = byId("actions").appendChild(document.createElement("button"));
  row.className = "act";
  row.innerHTML = '<span></span><span class="bar"><i></i></span><span class="number"></span>';
  row.children[0].textContent = NAMES[name];
  row.addEventListener("click", () => walk(action));
  return row;
});
const percent = (p) => `${(100 * p).toFixed(1)}%`;
const onBar = (score) => `${100 * Math.min(1, Math.max(0, score))}%`;

function show() {
  const state = path[at], hand = by.slice(1, at + 1).filter((who) => who === "hand").length;
  const left = goal.distances?.[state];
  [byId("outcome").className, byId("outcome").textContent] = outcome(path, at, hand);
  byId("where").textContent = `Step ${at} of at most ${D.max_steps} · state ${state}` + (left === undefined ? ""
    : left < 0 ? " · the goal cannot be reached from here" : ` · ${left} by the shortest path to the goal`);
  document.body.dataset.state = state;
  document.body.dataset.step = at;
  byId("time").max = path.length - 1;
  byId("time").value = at;
  byId("play").textContent = timer === null ? "Play" : "Pause";
  byId("play").disabled = !canGoOn() && path.length < 2;
  byId("back").disabled = at === 0;
  byId("step").disabled = byId("end").disabled = !canGoOn();
  showRival();
  showDecision(state);
  agentViews.forEach((paint) => paint(state));
  drawEpisode();
  clearTimeout(written);
  written = setTimeout(() => history.replaceState(null, "", `#${address()}`), 300);  // browsers refuse hundreds at once
}
function showRival() {
  byId("outcome-beside").hidden = byId("seen-beside").hidden = !rival;
  if (!rival) return;
  const step = Math.min(at, rival.path.length - 1), name = D.agents[Number(byId("beside").value)];
  byId("outcome-beside").textContent = `${name}: ${outcome(rival.path, step)[1]}`;
  document.querySelector("#seen-beside h2").textContent = `Beside it: ${name}`;
  rivalViews.forEach((paint) => paint(rival.path[step]));
}
function showDecision(state) {
  const over = ended(at), action = at < path.length - 1 ? taken[at + 1] : nextAction();
  const likely = probabilities(goal.logits.subarray(4 * state, 4 * state + 4)), best = likely.indexOf(Math.max(...likely));
  byId("actions").hidden = over;
  rows.forEach((row, index) => {
    row.classList.toggle("chosen", !over && index === Number(action ?? NaN));
    row.querySelector("i").style.width = percent(likely[index]);
    row.children[2].textContent = percent(likely[index]);
  });
  const other = action !== undefined && Number(action) !== best;
  byId("actions-title").textContent = over ? "The episode has ended: restart it, or walk on by the keys"
    : `What the ${D.image_graph ? "map or the policy" : "policy"} would do (press one to do it yourself)`
      + (other ? "; framed: what is done instead" : "");
  const score = goal.scores[state], threshold = goal.threshold ?? D.threshold;
  byId("match-title").textContent = `Matching with the goal (${D.match === "front" ? "the view ahead" : "all four views"}; `
    + `threshold ${threshold}${D.stops_by === "match" ? "" : ", not used here"})`;
  byId("threshold").style.left = onBar(threshold);
  byId("score").textContent = score.toFixed(3);
  byId("score-bar").style.width = onBar(score);
  byId("verdict").textContent = goal.stops.has(state) ? "stop" : "no stop";
  byId("value").textContent = goal.values && !over ? `Value of this state: ${goal.values[state].toFixed(3)}` : "";
}
function chooseGoal(index, start) {
  goal = goals[index];
  byId("goal").value = index;
  byId("goals").childNodes.forEach((button, i) => button.setAttribute("aria-pressed", i === index));
  byId("goal-title").textContent = goal.state === null ? `The goal: ${goal.name}`
    : `The goal, state ${goal.state}` + (photo ? ": one photo is all that the policy has" : "");
  goalViews.forEach((paint) => paint(goal.state));
  begin(start ?? farthest());
}
function offerGoal(g) {  // in the list, and as a picture
  const index = goals.indexOf(g), name = g.name ?? `state ${g.state}`;
  byId("goal").add(new Option(name, index));
  if (!D.views) return;
  const button = byId("goals").appendChild(document.createElement("button")), image = document.createElement("img");
  image.src = g.state === null ? g.image : picture(g.state);
  image.alt = button.title = `goal: ${name}`;
  button.appendChild(image);
  button.addEventListener("click", () => chooseGoal(index));
}

// The address holds what is shown: `walk` has a digit for each action, behind an h where it was done by hand.
function address() {
  const walked = taken.slice(1).map((action, i) => (by[i + 1] === "hand" ? "h" : "") + action).join("");
  const state = { goal: goal.state ?? "", start: path[0], step: at, agent: byId("agent").value, beside: byId("beside").value,
    walk: by.includes("hand") ? walked : "" };
  return new URLSearchParams(Object.entries(state).filter(([, value]) => String(value) !== "")).toString();
}
function fromAddress() {
  const given = new URLSearchParams(location.hash.slice(1)), wanted = (name, among) => {
    const value = given.get(name);
    if (value === null || among(Number(value))) return value === null ? undefined : Number(value);
    say(`The address asks for ${name} ${value}, which this page does not have.`);
    return undefined;
  };
  const has = (number) => Number.isInteger(number) && number in D.graph, other = (i) => i in D.agents;
  byId("agent").value = wanted("agent", other) ?? 0;
  byId("beside").value = wanted("beside", other) ?? "";
  const state = wanted("goal", (s) => goals.some((g) => g.state === s)), start = wanted("start", has);
  const missing = byId("note").textContent;
  chooseGoal(Math.max(0, goals.findIndex((g) => g.state === state)), start);
  if (missing) say(missing);
  for (const [, hand, action] of (given.get("walk") ?? "").matchAll(/(h?)([0-3])/g)) {
    if (!ended(at)) take(Number(action), hand ? "hand" : "policy");
  }
  const step = wanted("step", (s) => Number.isInteger(s) && s >= 0 && s <= D.max_steps) ?? at;
  at = Math.min(at, step);
  while (at < step && canGoOn()) forward();
  show();
}

document.title = `dirl viewer: ${D.scene}`;
byId("title").textContent = `Episodes in ${D.scene}`;
byId("facts").textContent = D.facts;
D.scenes.forEach(({ name, file }) => byId("scene").add(new Option(name, file, name === D.scene, name === D.scene)));
D.agents.forEach((name, i) => ["agent", "beside"].forEach((id) => byId(id).add(new Option(name, i))));
goals.forEach(offerGoal);
byId("start").max = D.graph.length - 1;
byId("scene").addEventListener("change", (e) => { location.href = encodeURIComponent(e.target.value); });
byId("goal").addEventListener("change", (e) => { chooseGoal(Number(e.target.value)); e.target.blur(); });
byId("start").addEventListener("keydown", (e) => { if (e.key === "Enter") e.target.blur(); });
byId("start").addEventListener("change", (e) => {
  const wanted = e.target.value, valid = wanted !== "" && Number.isInteger(Number(wanted)) && Number(wanted) in D.graph;
  begin(valid ? Number(wanted) : path[0]);
  if (!valid) say(`Start '${wanted}': there is no such state; the states are 0 to ${D.graph.length - 1}.`);
});
["agent", "beside"].forEach((id) => byId(id).addEventListener("change", () => { begin(path[0]); byId(id).blur(); }));
byId("random").addEventListener("click", () => begin(randomStart()));
byId("speed").addEventListener("change", () => { if (timer !== null) { pause(); play(); } byId("speed").blur(); });
byId("time").addEventListener("pointerup", () => byId("time").blur());  // else the arrow keys would go on moving it
byId("time").addEventListener("input", (e) => { pause(); at = Number(e.target.value); show(); });
// What the buttons and keys of the same name do.
const does = {
  play,
  back: () => { pause(); at = Math.max(0, at - 1); show(); },
  step: () => { pause(); if (canGoOn()) forward(); show(); },
  end: () => { pause(); while (canGoOn()) forward(); show(); },
  restart: () => begin(path[0]),
};
for (const [id, act] of Object.entries(does)) byId(id).addEventListener("click", act);
const walks = { arrowup: "ahead", w: "ahead", arrowright: "right", d: "right", arrowleft: "left", a: "left",
  arrowdown: "back", s: "back" };
const keys = { " ": "play", n: "step", b: "back", e: "end", r: "restart" };
document.addEventListener("keydown", (event) => {
  const name = event.key.toLowerCase(), { tagName, type } = event.target;
  if (event.ctrlKey || event.altKey || event.metaKey || (tagName === "INPUT" && type !== "radio") || tagName === "SELECT") return;
  if (name === " " && tagName === "BUTTON") return;  // the button's own
  if (name in walks) walk(D.actions.indexOf(walks[name]));
  else if (name in keys) does[keys[name]]();
  else return;
  event.preventDefault();
});
drawRoom();
drawMarks();
addEventListener("hashchange", fromAddress);
fromAddress();
