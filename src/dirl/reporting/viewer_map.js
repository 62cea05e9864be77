"use strict";
// The map of a scene: its places, the paths of the agents, and the topological map.
const D = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
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
const key = (state) => join([point(state)]);
const isTour = D.source.startsWith("tour");
const places = new Map();  // the states of each place, by where it is
D.positions.forEach((_, state) => places.set(key(state), [...(places.get(key(state)) ?? []), state]));
const cells = new Map();
let overlay, marks, nodes = [], cursor = key(0);

function drawLinks(map, pairs, place) {
  for (const [a, b] of pairs) {
    const [[x1, y1], [x2, y2]] = [place(a), place(b)];
    draw(map, "line", { class: "link", x1, y1, x2, y2 });
  }
}
function waysBetween() {  // a pair of states for each two places with a move between them, in whichever direction
  const ways = new Map(), moves = [D.actions.indexOf("ahead"), D.actions.indexOf("back")];
  D.graph.forEach((next, state) => moves.filter((a) => next[a] >= 0 && next[a] !== state).forEach((a) => {
    ways.set([key(state), key(next[a])].sort().join(" "), [state, next[a]]);
  }));
  return [...ways.values()];
}
function drawRoom() {
  const all = D.positions.map((_, state) => point(state)), xs = all.map((p) => p[0]), ys = all.map((p) => p[1]);
  const left = Math.min(...xs) - 50, top = Math.min(...ys) - 50;
  const box = [left, top, Math.max(...xs) + 50 - left, Math.max(...ys) + 50 - top];
  const map = draw(byId("map"), "svg", { viewBox: box.join(" "), tabindex: 0, role: "application",
    "aria-label": "map of the room: arrows choose a place, enter starts there, g makes it the goal" });
  map.addEventListener("keydown", onMapKey);
  // Of a tour nothing is known of what lies between its places: only the ways are drawn.
  if (isTour) drawLinks(map, waysBetween(), point);
  byId("about-map").hidden = D.source !== "tour, laid out";
  byId("about-map").textContent = "The places of this tour are known only by their links: distances on the map mean nothing.";
  for (const [place, [state]] of places) {
    const [x, y] = point(state);
    const cell = isTour ? draw(map, "circle", { class: "cell", cx: x, cy: y, r: 16 })
      : draw(map, "rect", { class: "cell", x: x - 30, y: y - 30, width: 60, height: 60 });
    cell.dataset.state = state;
    cell.addEventListener("click", () => {
      cursor = place;
      pick(place, document.querySelector("[name=click]:checked").value);
    });
    cells.set(place, cell);
  }
  marks = draw(map, "g", { class: "marks" });
  overlay = draw(map, "g", { class: "overlay" });
  if (D.image_graph) drawNodes(box, all);
}
function pick(place, what) {  // a click on a place, or the key that does the same
  const states = places.get(place);
  if (what === "start") {
    const again = at === 0 ? states.indexOf(path[0]) : -1;  // the same place once more: it turns
    return begin(states[(again + 1) % states.length]);
  }
  const here = goals.flatMap((g, index) => (states.includes(g.state) ? [index] : []));
  if (!here.length) return say("There is no goal at this place. Stars mark the goals of this page.");
  return chooseGoal(here[(here.indexOf(goals.indexOf(goal)) + 1) % here.length]);
}
function onMapKey(event) {
  const step = { ArrowUp: [0, -1], ArrowRight: [1, 0], ArrowDown: [0, 1], ArrowLeft: [-1, 0] }[event.key];
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (step) {
    const [x, y] = point(places.get(cursor)[0]);
    const far = ([state]) => {  // how far a place lies in this direction, and more if aside of it
      const [dx, dy] = [point(state)[0] - x, point(state)[1] - y], along = dx * step[0] + dy * step[1];
      return along > 1 ? along + 3 * Math.abs(dx * step[1] + dy * step[0]) : Infinity;
    };
    const nearest = [...places].map(([place, states]) => [far(states), place]).sort((a, b) => a[0] - b[0])[0];
    if (nearest[0] < Infinity) cursor = nearest[1];
  } else if (event.key === "Enter") pick(cursor, "start");
  else if (event.key.toLowerCase() === "g") pick(cursor, "goal");
  else return;
  cells.forEach((cell, place) => cell.classList.toggle("cursor", place === cursor));
  event.preventDefault();
  event.stopPropagation();
}
function drawNodes(box, all) {  // each of its places in the middle of the states that look like it most
  const { place, places: count, links } = D.image_graph;
  const of = Array.from({ length: count }, (_, i) => all.filter((_, state) => place[state] === i));
  const mean = (list, axis) => list.reduce((sum, p) => sum + p[axis], 0) / list.length;
  const middle = (i) => [mean(of[i], 0), mean(of[i], 1)];
  const shown = (i) => of[i].length > 0;
  byId("image-graph").hidden = false;
  const map = draw(byId("nodes"), "svg", { viewBox: box.join(" "), role: "img", "aria-label": "topological map" });
  drawLinks(map, links.filter(([a, b]) => shown(a) && shown(b)), middle);
  nodes = of.map((_, i) => shown(i) && draw(map, "circle", { class: "node", cx: middle(i)[0], cy: middle(i)[1], r: 14 }));
  byId("about-graph").textContent = `${plural(count, "place")} that it tells apart, ${plural(links.length, "link")} between `
    + "them. It knows no positions: each is drawn where what it shows is. Blue: where it takes the agent to be; yellow: the goal.";
}
function star(parent, [x, y], name, size = 25) {  // five points, the inner corners at 0.42 of the outer ones
  const corners = Array.from({ length: 10 }, (_, i) => [x + size * (i % 2 ? 0.42 : 1) * Math.sin((i * Math.PI) / 5),
    y - size * (i % 2 ? 0.42 : 1) * Math.cos((i * Math.PI) / 5)]);
  return draw(parent, "polygon", { class: name, points: join(corners) });
}
function drawMarks() {  // the goals that can be chosen
  marks.replaceChildren();
  for (const place of new Set(goals.filter((g) => g.state !== null).map((g) => key(g.state)))) {
    star(marks, point(places.get(place)[0]), "choice", 14);
  }
}
function drawAgent(states, step, name) {
  draw(overlay, "polyline", { class: `path later ${name}`, points: join(states.map(point)) });
  draw(overlay, "polyline", { class: `path ${name}`, points: join(states.slice(0, step + 1).map(point)) });
  const state = states[step];
  return draw(overlay, "polygon", { class: `agent ${name}`,
    points: join([beside(state, 22), beside(state, 17, 2.5), beside(state, 8, Math.PI), beside(state, 17, -2.5)]) });
}
function drawEpisode() {
  overlay.replaceChildren();
  if (goal.state !== null) {
    for (const over of ["", "over"]) {
      const [x1, y1] = point(goal.state), [x2, y2] = beside(goal.state, 38);
      draw(overlay, "line", { class: `toward ${over}`, x1, y1, x2, y2 });
    }
    star(overlay, point(goal.state), "goal");
  }
  if (rival) drawAgent(rival.path, Math.min(at, rival.path.length - 1), "rival");
  for (const state of new Set(path.slice(0, at + 1))) {
    draw(overlay, "polygon", { class: "tick", points: join([beside(state, 13), beside(state, 9, 2.3), beside(state, 9, -2.3)]) });
  }
  const [cx, cy] = point(path[0]);
  draw(overlay, "circle", { class: "start", cx, cy, r: 22 });
  drawAgent(path, at, "own");
  nodes.forEach((node, i) => {
    if (!node) return;
    node.classList.toggle("here", i === D.image_graph.place[path[at]]);
    node.classList.toggle("goal-node", i === D.image_graph.place[goal.state]);
  });
}
