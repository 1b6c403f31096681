"use strict";
// What all pages draw with: vectors, canvases and a view in space. Points are [x, y, z], a matrix is its rows.
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const column = (R, j) => [R[0][j], R[1][j], R[2][j]];

function stroke(g, points, colour, width, dash = []) {
  g.strokeStyle = colour; g.lineWidth = width; g.setLineDash(dash);
  g.beginPath();
  points.forEach(([x, y], i) => i ? g.lineTo(x, y) : g.moveTo(x, y));
  g.stroke();
  g.setLineDash([]); g.lineWidth = 1;
}
function context(canvas, width, height) {  // sharp on every screen: drawn in CSS pixels, stored in the screen's
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
  const g = canvas.getContext("2d");
  g.scale(ratio, ratio);
  g.fillStyle = "#fff"; g.fillRect(0, 0, width, height);
  return g;
}

// An object in space: its `centre`, how far it goes from there (`reach`), and its frame, whose axes are the columns of
// R: x right, y up, z to the front. The eye {yaw, pitch, zoom, x, y} goes around its up axis.
function viewOf(eye, {centre, reach, R}, width, height) {  // a point -> [x, y on the canvas, distance, pixels a metre]
  const cy = Math.cos(eye.yaw), sy = Math.sin(eye.yaw), cp = Math.cos(eye.pitch), sp = Math.sin(eye.pitch);
  const away = 4 * reach, focal = eye.zoom * 1.75 * Math.min(width, height);
  return p => {
    const q = add(p, centre, -1), [x, y, z] = [0, 1, 2].map(j => dot(column(R, j), q));
    const right = cy * x - sy * z, front = sy * x + cy * z;
    const distance = Math.max(away - (sp * y + cp * front), .1 * reach), scale = focal / distance;
    return [width / 2 + eye.x + scale * right, height / 2 + eye.y - scale * (cp * y - sp * front), distance, scale];
  };
}
function towards(eye, {R}) {  // unit
  const cp = Math.cos(eye.pitch), own = [cp * Math.sin(eye.yaw), Math.sin(eye.pitch), cp * Math.cos(eye.yaw)];
  return [0, 1, 2].map(i => dot(R[i], own));
}
// What is drawn goes into a list of [distance, draw], to be sorted.
function surface(view, toEye, vertices, faces, colour, alpha, list) {  // lit by the eye; edges in the same colour, so that no cracks show
  const seen = vertices.map(view), rgb = [1, 3, 5].map(i => parseInt(colour.slice(i, i + 2), 16));
  for (const face of faces) {
    const corners = face.map(i => seen[i]), [a, b, c] = face.map(i => vertices[i]);
    const u = add(b, a, -1), v = add(c, a, -1), n = [0, 1, 2].map(i => u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3]);
    const light = .45 + .55 * Math.abs(dot(n, toEye)) / Math.max(Math.hypot(...n), 1e-12);
    const shade = `rgb(${rgb.map(value => Math.round(value * light)).join(" ")})`;
    list.push([(corners[0][2] + corners[1][2] + corners[2][2]) / 3, g => {
      g.globalAlpha = alpha; g.fillStyle = shade;
      g.beginPath(); corners.forEach(([x, y], i) => i ? g.lineTo(x, y) : g.moveTo(x, y)); g.closePath(); g.fill();
      g.globalAlpha = .6 * alpha; stroke(g, [...corners, corners[0]], shade, .5); g.globalAlpha = 1;
    }]);
  }
}
function segment(view, ends, list, ...style) {
  const at = ends.map(view);
  list.push([(at[0][2] + at[1][2]) / 2, g => stroke(g, at, ...style)]);
}
const rulers = [1, 2, 5].flatMap(n => [.001, .01, .1, 1].map(tens => n * tens)).sort((a, b) => a - b);
function floorLines(vertices, reach) {  // squares under the base, each as large as a step of the ruler; the object's frame
  const low = vertices.reduce((least, p) => Math.min(least, p[1]), Infinity);
  const cell = rulers.find(length => length > .25 * reach) ?? reach, half = 5 * cell, lines = [];
  for (let i = -5; i <= 5; i++) lines.push([[i * cell, low, -half], [i * cell, low, half]], [[-half, low, i * cell], [half, low, i * cell]]);
  return lines;
}
function drawLegend(g, view, {centre, reach, R}, width, height) {  // a scale bar at the object's distance, and its axes
  const [x, y, , scale] = view(centre), length = rulers.filter(length => length * scale < .25 * width).pop() ?? rulers[0];
  stroke(g, [[14, height - 18], [14, height - 14], [14 + length * scale, height - 14], [14 + length * scale, height - 18]], "#333", 1.5);
  g.fillStyle = "#333"; g.font = "12px sans-serif"; g.textAlign = "left";
  g.fillText(length < 1 ? `${(100 * length).toFixed(length < .01 ? 1 : 0)} cm` : `${length} m`, 14, height - 24);
  ["crimson", "green", "royalblue"].forEach((colour, j) => {
    const [u, v] = view(add(centre, column(R, j), .3 * reach)), size = 26 / (.3 * reach * scale);
    const end = [width - 44 + size * (u - x), height - 44 + size * (v - y)];
    stroke(g, [[width - 44, height - 44], end], colour, 2);
    g.fillStyle = colour; g.textAlign = "center"; g.fillText("xyz"[j], end[0] + .35 * (end[0] - width + 44), end[1] + .35 * (end[1] - height + 44) + 4);
  });
}
const KEYS = {ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, -10], ArrowDown: [0, 10]};  // pixels of a drag
const ZOOMS = {"+": 1.1, "=": 1.1, "-": 1 / 1.1};
function listen(canvas, eye, redraw) {  // to mouse, fingers and keys
  const start = {...eye}, fingers = new Map();
  const reset = () => { Object.assign(eye, start); redraw(); };
  const zoom = times => { eye.zoom = Math.max(.2, Math.min(10, eye.zoom * times)); redraw(); };
  const drag = (shifts, x, y) => {
    if (shifts) { eye.x += x; eye.y += y; }
    else {
      eye.yaw -= .01 * x;
      eye.pitch = Math.max(-1.57, Math.min(1.57, eye.pitch + .01 * y));
    }
    redraw();
  };
  const apart = () => { const [a, b] = fingers.values(); return Math.max(1, Math.hypot(a.x - b.x, a.y - b.y)); };
  canvas.addEventListener("pointerdown", event => { canvas.setPointerCapture(event.pointerId); fingers.set(event.pointerId, event); });
  canvas.addEventListener("lostpointercapture", event => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", event => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    if (fingers.size < 2) return drag(event.shiftKey, event.movementX, event.movementY);
    const before = apart();
    fingers.set(event.pointerId, event);
    zoom(apart() / before);
  });
  canvas.addEventListener("wheel", event => { event.preventDefault(); zoom(Math.exp(-.001 * event.deltaY)); }, {passive: false});
  canvas.addEventListener("dblclick", reset);
  canvas.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;  // the browser's own
    if (event.key in KEYS) drag(event.shiftKey, ...KEYS[event.key]);
    else if (event.key in ZOOMS) zoom(ZOOMS[event.key]);
    else if (event.key === "Home") reset();
    else return;
    event.preventDefault();
  });
}
