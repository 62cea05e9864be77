"use strict";
const D = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const LOOKS = [[3, "left"], [0, "ahead"], [1, "right"], [2, "behind"]];  // columns of `surrounding`, as they are laid out
const NAMES = { ahead: "↑ ahead", right: "→ turn right", left: "← turn left", back: "↓ back" };
const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const goals = D.goals.map((g) => ({ ...g, logits: floats(g.logits), values: floats(g.values),
  scores: floats(g.scores), stops: new Set(g.stops) }));

// An episode: its states, the actions between, who took each ("policy" or "hand"), and the step that is shown.
let goal = goals[0], path = [], taken = [], by = [], blocked = [], at = 0, timer = null;

const OPPOSITE = [3, 2, 1, 0], SURE = 10;
const logitsAt = (state) => Float32Array.from(goal.logits.subarray(4 * state, 4 * state + 4));
const looksLike = (a, b) => D.memory.alike[a].includes(b);
function logitsNow(m = byId("memory").checked && D.memory) {
  return !m ? logitsAt(path[at]) : m.repeated === undefined ? counted(m) : planned(m);
}
// The same as dirl.models.EpisodicMemory: what was done here in this episode is less likely to be done again.
function counted(m) {
  const state = path[at], logits = logitsAt(state);
  for (let i = 0; i < at; i++) {
    const [before, action, after] = [path[i], taken[i + 1], path[i + 1]], moved = !looksLike(before, after);
    if (looksLike(before, state)) logits[action] -= m.penalty * (moved ? 1 : m.blocked);
    if (moved && looksLike(after, state)) logits[OPPOSITE[action]] -= m.penalty * m.opposite;
  }
  return logits;
}
// The same as dirl.models.PlanningMemory: minus the cost of the cheapest path to an action that was not tried.
function planned(m) {
  const { nodes, here } = walkedNodes(), seen = nodes.some((node) => node.goal);
  if (seen) nodes.forEach((node) => { node.after = node.after.map((to, action) => to < 0 ? node.ring[action] : to); });
  const step = (node, action) => seen ? (node.after[action] < 0 ? Infinity : SURE)
    : node.cost[action] + (node.after[action] < 0 ? 0 : action % 3 ? m.turn : m.repeated);
  let values = nodes.map((node) => node.goal ? 0 : Infinity), before, ways;
  do {
    before = values;
    ways = nodes.map((node) => node.after.map((to, action) => step(node, action) + (to < 0 ? 0 : before[to])));
    values = nodes.map((node, i) => node.goal ? 0 : Math.min(...ways[i]));
  } while (values.some((value, i) => value !== before[i]));
  return (ways[here].every((way) => way === Infinity) ? nodes[here].cost : ways[here]).map((way) => -way);
}
function walkedNodes() {  // four for each place of the episode, one for each heading, clockwise
  const nodes = [], turned = (node, right) => node - node % 4 + (node + right) % 4, around = (node) => turned(node, 2);
  let before = -1, here = -1;
  for (let i = 0; i <= at; i++) {
    here = nodes.findIndex((node) => looksLike(node.state, path[i]));
    const isNew = here < 0;
    if (isNew) {
      here = nodes.length;
      D.surrounding[path[i]].forEach((state, heading) => {
        const ring = [-1, here + (heading + 1) % 4, here + (heading + 3) % 4, -1];
        nodes.push({
          state, goal: goal.stops.has(state), cost: probabilities(logitsAt(state)).map((p) => -Math.log(p)),
          ring, after: D.turns === 4 ? [...ring] : [-1, -1, -1, -1],
        });
      });
    }
    nodes[here].goal = false;
    const action = taken[i], moved = here !== before;
    if (i) {
      nodes[before].after[action] = here;
      if (moved) nodes[here].after[OPPOSITE[action]] = before;
    }
    if (i && action % 3 === 0) {  // ahead is back for who faces the other way
      nodes[around(before)].after[OPPOSITE[action]] = around(here);
      if (moved) nodes[around(here)].after[action] = around(before);
    }
    if (i && action % 3 && moved && D.turns !== 4) {  // so do turns from the other three views
      for (let right = 0; right < 4; right++) {
        const start = turned(before, right), end = turned(here, right), beyond = nodes[start].ring[action];
        if (isNew) [nodes[end].ring[action], nodes[beyond].ring[OPPOSITE[action]]] = [beyond, end];
        nodes[start].after[action] = nodes[start].ring[action] = end;
        nodes[end].after[OPPOSITE[action]] = nodes[end].ring[OPPOSITE[action]] = start;
      }
    }
    before = here;
  }
  return { nodes, here };
}
// The same as dirl.evaluation.protocol: the first of the most probable actions; stop only after a step.
function chosenAction() {
  const logits = logitsNow();
  return logits.indexOf(Math.max(...logits));
}
function probabilities(logits) {
  const top = Math.max(...logits);
  const weights = Array.from(logits, (x) => Math.exp(x - top)), sum = weights.reduce((a, b) => a + b);
  return weights.map((w) => w / sum);
}
const stopped = (step) => step > 0 && goal.stops.has(path[step]);
const ended = (step) => stopped(step) || step >= D.max_steps;

function take(action, who) {
  const next = D.graph[path[at]][action];
  path.length = taken.length = by.length = blocked.length = at + 1;
  path.push(next < 0 ? path[at] : next);
  taken.push(action);
  by.push(who);
  blocked.push(next < 0);
  at++;
}
function forward() {  // along what has been walked already, then on as the policy says
  if (at < path.length - 1) at++;
  else if (!ended(at)) take(chosenAction(), "policy");
}
const canGoOn = () => at < path.length - 1 || !ended(at);
function toTheEnd() { while (canGoOn()) forward(); }
function begin(state) {
  pause();
  path = [state]; taken = [null]; by = [null]; blocked = [false]; at = 0;
  byId("start").value = state;
  show();
}
function walk(action) { pause(); take(action, "hand"); show(); }
function pause() { clearInterval(timer); timer = null; }
function play() {
  if (timer !== null) { pause(); return show(); }
  if (!canGoOn()) at = 0;
  timer = setInterval(() => { forward(); if (!canGoOn()) pause(); show(); }, 1000 / Number(byId("speed").value));
  show();
}
function farthest() { return goal.distances.indexOf(Math.max(...goal.distances)); }
function randomStart() {
  const starts = goal.distances.flatMap((d, state) => (d > 0 ? [state] : []));
  return starts[Math.floor(Math.random() * starts.length)];
}

const plural = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
function outcome() {
  const state = path[at], here = state === goal.state, shortest = goal.distances[path[0]];
  const hand = by.slice(1, at + 1).filter((who) => who === "hand").length;
  const length = plural(at, "step") + (hand ? `, ${hand} by hand` : "");
  const least = shortest < 0 ? "" : ` (shortest path: ${shortest})`;
  if (stopped(at) && here) return ["good", `Stopped at the goal after ${length}${least}`];
  if (stopped(at)) return ["bad", `False stop after ${length}: this is not the goal`];
  if (at >= D.max_steps) return ["bad", `Failed: not at the goal after ${length}`];
  if (here && at > 0) return ["bad", `Missed: at the goal after ${length}, but not recognised`];
  if (blocked[at]) return ["", `On the way: ${length}; the last move was blocked`];
  return ["", at === 0 ? `At the start${least}` : `On the way: ${length}`];
}

const SVG = "http://www.w3.org/2000/svg";
function draw(parent, name, attributes) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  return parent.appendChild(node);
}
const unit = 60 / D.side;  // a place is 60 units wide
const point = (state) => [unit * D.positions[state][0], -unit * D.positions[state][1]];
const beside = (state, length, turn = 0) => {  // a point in the direction of the heading, turned by radians
  const [x, y] = point(state), [dx, dy] = [D.directions[state][0], -D.directions[state][1]];
  return [x + length * (dx * Math.cos(turn) - dy * Math.sin(turn)), y + length * (dx * Math.sin(turn) + dy * Math.cos(turn))];
};
const join = (points) => points.map((p) => p.map((v) => v.toFixed(1)).join(",")).join(" ");
let overlay, nodes = [];
const isTour = D.source.startsWith("tour");
function drawLinks(map, pairs, place) {
  for (const [a, b] of pairs) {
    const [[x1, y1], [x2, y2]] = [place(a), place(b)];
    draw(map, "line", { class: "link", x1, y1, x2, y2 });
  }
}
function waysBetween(places) {  // a pair of states for each two places with a move between them, in whichever direction
  const ways = new Map(), key = (state) => join([places[state]]);
  D.graph.forEach((next, state) => [0, 3].filter((a) => next[a] >= 0 && next[a] !== state).forEach((a) => {
    ways.set([key(state), key(next[a])].sort().join(" "), [state, next[a]]);
  }));
  return [...ways.values()];
}
function drawRoom() {
  const all = D.positions.map((_, state) => point(state)), xs = all.map((p) => p[0]), ys = all.map((p) => p[1]);
  const left = Math.min(...xs) - 50, top = Math.min(...ys) - 50;
  const box = [left, top, Math.max(...xs) + 50 - left, Math.max(...ys) + 50 - top];
  const map = draw(byId("map"), "svg", { viewBox: box.join(" "), role: "img", "aria-label": "map of the room" });
  // Of a tour nothing is known of what lies between its places: only the ways are drawn.
  if (isTour) drawLinks(map, waysBetween(all), point);
  byId("about-map").hidden = D.source !== "tour, laid out";
  byId("about-map").textContent = "The places of this tour are known only by their links: distances on the map mean nothing.";
  const seen = new Set();
  all.forEach(([x, y], state) => {
    const key = join([[x, y]]);
    if (seen.has(key)) return;
    seen.add(key);
    const cell = isTour ? draw(map, "circle", { class: "cell", cx: x, cy: y, r: 16 })
      : draw(map, "rect", { class: "cell", x: x - 30, y: y - 30, width: 60, height: 60 });
    cell.dataset.state = state;
    cell.addEventListener("click", () => begin(state));
  });
  overlay = draw(map, "g", { class: "overlay" });
  if (D.image_graph) drawNodes(box, all);
}
function drawNodes(box, all) {  // each of its places in the middle of the states that look like it most
  const { place, places, links } = D.image_graph;
  const of = Array.from({ length: places }, (_, i) => all.filter((_, state) => place[state] === i));
  const mean = (list, axis) => list.reduce((sum, p) => sum + p[axis], 0) / list.length;
  const middle = (i) => [mean(of[i], 0), mean(of[i], 1)];
  const shown = (i) => of[i].length > 0;
  byId("image-graph").hidden = false;
  const map = draw(byId("nodes"), "svg", { viewBox: box.join(" "), role: "img", "aria-label": "topological map" });
  drawLinks(map, links.filter(([a, b]) => shown(a) && shown(b)), middle);
  nodes = of.map((_, i) => shown(i) && draw(map, "circle", { class: "node", cx: middle(i)[0], cy: middle(i)[1], r: 14 }));
  byId("about-graph").textContent = `${plural(places, "place")} that it tells apart, ${plural(links.length, "link")} between `
    + "them. It knows no positions: each is drawn where what it shows is. Blue: where it takes the agent to be; yellow: the goal.";
}
function drawEpisode() {
  overlay.replaceChildren();
  for (const over of ["", "over"]) {
    const [x1, y1] = point(goal.state), [x2, y2] = beside(goal.state, 38);
    draw(overlay, "line", { class: `toward ${over}`, x1, y1, x2, y2 });
  }
  const [gx, gy] = point(goal.state);  // as dirl.reporting.style.star_points
  const star = Array.from({ length: 10 }, (_, i) => [gx + (i % 2 ? 10.5 : 25) * Math.sin((i * Math.PI) / 5),
    gy - (i % 2 ? 10.5 : 25) * Math.cos((i * Math.PI) / 5)]);
  draw(overlay, "polygon", { class: "goal", points: join(star) });
  draw(overlay, "polyline", { class: "path later", points: join(path.map(point)) });
  const passed = path.slice(0, at + 1);
  draw(overlay, "polyline", { class: "path", points: join(passed.map(point)) });
  for (const state of new Set(passed)) {
    const heading = [beside(state, 13), beside(state, 9, 2.3), beside(state, 9, -2.3)];
    draw(overlay, "polygon", { class: "tick", points: join(heading) });
  }
  const [cx, cy] = point(path[0]), state = path[at];
  draw(overlay, "circle", { class: "start", cx, cy, r: 22 });
  draw(overlay, "polygon", { class: "agent",
    points: join([beside(state, 22), beside(state, 17, 2.5), beside(state, 8, Math.PI), beside(state, 17, -2.5)]) });
}

function makeViews(parent, looks = LOOKS) {
  return looks.map(([column, name]) => {
    const figure = parent.appendChild(document.createElement("figure"));
    figure.className = name;
    const image = figure.appendChild(document.createElement(D.views ? "img" : "div"));
    figure.appendChild(document.createElement("figcaption")).textContent = name;
    return (state) => {
      if (!D.views) return;
      image.src = `data:image/webp;base64,${D.views[D.surrounding[state][column]]}`;
      image.alt = `view ${name}, of state ${state}`;
    };
  });
}
const photo = D.goal_view === "front";
const agentViews = makeViews(byId("views")), goalViews = makeViews(byId("goal-views"), photo ? [LOOKS[1]] : LOOKS);
const rows = D.actions.map((name, action) => {
  const row = byId("actions").appendChild(document.createElement("button"));
  row.className = "act";
  row.innerHTML = '<span></span><span class="bar"><i></i><b hidden></b></span><span class="number"></span>';
  row.children[0].textContent = NAMES[name];
  row.addEventListener("click", () => walk(action));
  return row;
});
const percent = (p) => `${(100 * p).toFixed(1)}%`;
const onBar = (score) => `${100 * Math.min(1, Math.max(0, score))}%`;

function show() {
  const state = path[at], [kind, text] = outcome(), left = goal.distances[state];
  byId("outcome").className = kind;
  byId("outcome").textContent = text;
  byId("where").textContent = `Step ${at} of at most ${D.max_steps} · state ${state} · `
    + (left < 0 ? "the goal cannot be reached from here" : `${left} by the shortest path to the goal`);
  document.body.dataset.state = state;
  document.body.dataset.step = at;
  byId("time").max = path.length - 1;
  byId("time").value = at;
  byId("play").textContent = timer === null ? "Play" : "Pause";
  byId("back").disabled = at === 0;
  byId("step").disabled = byId("end").disabled = !canGoOn();
  const chosen = chosenAction(), alone = probabilities(logitsNow(null)), remembers = D.memory && byId("memory").checked;
  probabilities(logitsNow()).forEach((p, action) => {
    rows[action].classList.toggle("chosen", action === chosen);
    rows[action].querySelector("i").style.width = percent(p);
    rows[action].querySelector("b").style.left = percent(alone[action]);
    rows[action].querySelector("b").hidden = !remembers;
    rows[action].children[2].textContent = percent(p);
  });
  byId("actions-title").textContent = `What the ${D.image_graph ? "map or the policy" : "policy"} would do (press one to do it yourself)`
    + (remembers ? "; the marks: without its memory" : "");
  const score = goal.scores[state];
  byId("score").textContent = score.toFixed(3);
  byId("score-bar").style.width = onBar(score);
  byId("verdict").textContent = goal.stops.has(state) ? "stop" : "no stop";
  byId("value").textContent = `Value of this state: ${goal.values[state].toFixed(3)}`;
  agentViews.forEach((draw) => draw(state));
  drawEpisode();
  nodes.forEach((node, i) => {
    if (!node) return;
    node.classList.toggle("here", i === D.image_graph.place[state]);
    node.classList.toggle("goal-node", i === D.image_graph.place[goal.state]);
  });
}
function chooseGoal(index) {
  goal = goals[index];
  byId("goal-title").textContent = `The goal, state ${goal.state}` + (photo ? ": one photo is all that the policy has" : "");
  goalViews.forEach((draw) => draw(goal.state));
  begin(farthest());
}

document.title = `dirl viewer: ${D.scene}`;
byId("title").textContent = `Episodes in ${D.scene}`;
const leader = !D.image_graph ? "Greedy policy" : "Led by the topological map of one walk" + (D.last_steps
  ? `; the greedy policy decides the last ${plural(D.last_steps, "step")}, and where the map knows no path`
  : " to the goal; the greedy policy decides only where it knows no path");
byId("facts").textContent = `${D.title}. ${leader}; ` + (D.stops_by === "match" ? "stopped by template matching."
  : "stopped by the environment, exactly at the goal.")
  + (!D.memory ? "" : D.memory.repeated === undefined
    ? " Episodic memory: what was done in this episode where it looked as it does now is less likely."
    : " Episodic memory: a plan to the best exit that was not tried in this episode.");
byId("with-memory").hidden = !D.memory;
byId("match-title").textContent = `Matching with the goal (${D.match === "front" ? "the view ahead" : "all four views"}; `
  + `threshold ${D.threshold}${D.stops_by === "match" ? "" : ", not used here"})`;
byId("threshold").style.left = onBar(D.threshold);
D.scenes.forEach(({ name, file }) => byId("scene").add(new Option(name, file, name === D.scene, name === D.scene)));
goals.forEach((g, index) => byId("goal").add(new Option(`state ${g.state}`, index)));
byId("start").max = D.graph.length - 1;
byId("scene").addEventListener("change", (e) => { location.href = encodeURIComponent(e.target.value); });
byId("goal").addEventListener("change", (e) => { chooseGoal(Number(e.target.value)); e.target.blur(); });
byId("start").addEventListener("keydown", (e) => { if (e.key === "Enter") e.target.blur(); });
byId("start").addEventListener("change", (e) => {
  const wanted = Number(e.target.value);
  begin(e.target.value !== "" && Number.isInteger(wanted) && wanted in D.graph ? wanted : path[0]);
});
byId("memory").addEventListener("change", () => { begin(path[0]); byId("memory").blur(); });
byId("random").addEventListener("click", () => begin(randomStart()));
byId("speed").addEventListener("change", () => { if (timer !== null) { pause(); play(); } byId("speed").blur(); });
byId("time").addEventListener("pointerup", () => byId("time").blur());  // else the arrow keys would go on moving it
byId("time").addEventListener("input", (e) => { pause(); at = Number(e.target.value); show(); });
// What the buttons and keys of the same name do.
const does = {
  play,
  back: () => { pause(); at = Math.max(0, at - 1); show(); },
  step: () => { pause(); forward(); show(); },
  end: () => { pause(); toTheEnd(); show(); },
  restart: () => begin(path[0]),
};
for (const [id, act] of Object.entries(does)) byId(id).addEventListener("click", act);
const walks = { arrowup: 0, w: 0, arrowright: 1, d: 1, arrowleft: 2, a: 2, arrowdown: 3, s: 3 };
const keys = { " ": "play", n: "step", b: "back", e: "end", r: "restart" };
document.addEventListener("keydown", (event) => {
  const key = event.key.toLowerCase(), tag = event.target.tagName;
  if (event.ctrlKey || event.altKey || event.metaKey || tag === "INPUT" || tag === "SELECT") return;
  if (key === " " && tag === "BUTTON") return;  // the button's own
  if (key in walks) walk(walks[key]);
  else if (key in keys) does[keys[key]]();
  else return;
  event.preventDefault();
});
drawRoom();
chooseGoal(0);
