"use strict";
// Surfaces that can be turned: drag, wheel, arrow keys. WebGL 2, nothing loaded. Without it the still picture stays.

const RAMPS = {
  height: ["440154", "482878", "3e4989", "31688e", "26828e", "1f9e89", "35b779", "6ece58", "fde725"],
  residual: ["053061", "2a71b2", "6bacd1", "c2ddec", "f7f7f7", "fbccb4", "e58267", "b92732", "67001f"],
};
const VERTEX = `#version 300 es
in vec2 place; in float height; in float tint;
uniform mat3 turn; uniform vec2 zoom; uniform float lift;
out vec3 at; out float colour;
void main() {
  at = vec3(place, height * lift);
  colour = tint;
  vec3 seen = turn * at;
  gl_Position = vec4(seen.xy * zoom, -seen.z * 0.2, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 at; in float colour;
uniform vec3 ramp[9]; uniform vec3 light;
out vec4 pixel;
void main() {
  float place = clamp(colour, 0.0, 1.0) * 8.0;
  int low = int(min(floor(place), 7.0));
  vec3 tint = colour < -0.5 ? vec3(0.6) : mix(ramp[low], ramp[low + 1], place - float(low));
  vec3 normal = normalize(cross(dFdx(at), dFdy(at)));
  pixel = vec4(tint * (0.62 + 0.38 * abs(dot(normal, light))), 1.0);
}`;
const VIEWS = { oblique: [-60, 32], above: [-90, 90], along_x: [0, 4], along_y: [-90, 4] };

function bytes(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

function fractions(text) {
  return Float32Array.from(new Uint16Array(bytes(text).buffer), (value) => value / 65535);
}

// Two triangles between four neighbours of one facet, one where the fourth is missing.
function triangles(labels, rows, columns) {
  const found = [];
  for (let row = 0; row + 1 < rows; row++) {
    for (let column = 0; column + 1 < columns; column++) {
      const first = row * columns + column;
      const corners = [first, first + 1, first + columns + 1, first + columns];
      for (const facet of new Set(corners.map((corner) => labels[corner]))) {
        const own = corners.filter((corner) => labels[corner] === facet);
        if (facet === 0 || own.length < 3) continue;
        found.push(own[0], own[1], own[2]);
        if (own.length === 4) found.push(own[0], own[2], own[3]);
      }
    }
  }
  return new Uint32Array(found);
}

// What is shown as height, and its colours: the surface itself, or what is left of it beside the fitted facets.
function layers(mesh) {
  const count = mesh.rows * mesh.columns;
  const points = fractions(mesh.points);
  const span = mesh.high_mm.map((high, axis) => Math.max(high - mesh.low_mm[axis], 1e-6));
  const side = Math.max(span[0], span[1]);
  const place = new Float32Array(2 * count), height = new Float32Array(count), tint = new Float32Array(count);
  for (let k = 0; k < count; k++) {
    place[2 * k] = (points[3 * k] - 0.5) * span[0] / side;
    place[2 * k + 1] = (points[3 * k + 1] - 0.5) * span[1] / side;
    height[k] = (points[3 * k + 2] - 0.5) * span[2] / side;
    tint[k] = points[3 * k + 2];
  }
  const axes = [0, 1].map((axis) => ({
    name: "xy"[axis] + " (mm)", low: mesh.low_mm[axis], high: mesh.high_mm[axis], half: span[axis] / side / 2 }));
  const made = { place, side, axes, height: { height, tint, axis: {
    name: "z (mm)", low: mesh.low_mm[2], high: mesh.high_mm[2], half: span[2] / side / 2 } } };
  if (mesh.residuals) {
    const value = fractions(mesh.residuals);
    const reach = mesh.residual_reach_um;
    made.residual = { height: value.map((v) => (v - 0.5) * 0.2), tint: value, axis: {
      name: "residual (µm)", low: -reach, high: reach, half: 0.1 } };
  }
  return made;
}

function program(gl) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  return gl.getProgramParameter(made, gl.LINK_STATUS) ? made : null;
}

function fill(gl, made, name, values, size) {
  const at = gl.getAttribLocation(made, name);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
  gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, size, gl.FLOAT, false, 0, 0);
}

// Rows: to the right, upward, toward the eye.
function turned(azimuth, elevation) {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  return [[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]];
}

function ticks(axis) {
  const rough = (axis.high - axis.low) / 4, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough);
  const found = [];
  for (let k = Math.ceil(axis.low / step); k * step <= axis.high + 1e-9 * step; k++) {
    found.push({ text: String(+(k * step).toPrecision(6)), at: (k * step - axis.low) / (axis.high - axis.low) * 2 - 1 });
  }
  return found;
}

// The box around the surface, with numbers along its outer edges.
function drawBox(pen, view, axes, lift, size) {
  const halves = [axes[0].half, axes[1].half, axes[2].half * lift];
  const onto = (place) => {
    const point = place.map((value, axis) => value * halves[axis]);
    const [x, y] = [0, 1].map((row) => view.turn[row].reduce((sum, value, axis) => sum + value * point[axis], 0));
    return [size.width / 2 + x * view.scale, size.height / 2 - y * view.scale];
  };
  pen.clearRect(0, 0, size.width, size.height);
  pen.font = "12px sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (let axis = 0; axis < 3; axis++) {
    const [one, other] = [0, 1, 2].filter((k) => k !== axis);
    const edges = [[-1, -1], [-1, 1], [1, -1], [1, 1]].map(([a, b]) => {
      const ends = [-1, 1].map((end) => {
        const place = [0, 0, 0];
        place[axis] = end; place[one] = a; place[other] = b;
        return place;
      });
      const [from, to] = ends.map(onto);
      pen.strokeStyle = "#0003";
      pen.beginPath(); pen.moveTo(...from); pen.lineTo(...to); pen.stroke();
      return { ends, x: (from[0] + to[0]) / 2, y: (from[1] + to[1]) / 2, long: Math.hypot(to[0] - from[0], to[1] - from[1]) };
    });
    if (edges[0].long < 30) continue;
    const outer = edges.reduce((best, edge) => (axis === 2 ? edge.x < best.x : edge.y > best.y) ? edge : best);
    const away = [outer.x - size.width / 2, outer.y - size.height / 2];
    const far = Math.hypot(...away) || 1;
    const label = (text, along, distance) => {
      const place = outer.ends[0].slice();
      place[axis] = along;
      const [x, y] = onto(place);
      pen.fillText(text, x + away[0] / far * distance, y + away[1] / far * distance);
    };
    pen.fillStyle = "#333";
    const found = ticks(axes[axis]), close = outer.long / found.length < 22;
    for (const tick of close ? [found[0], found[found.length - 1]] : found) label(tick.text, tick.at, 16);
    pen.font = "bold 12px sans-serif";
    label(axes[axis].name, 0, axis === 2 ? 64 : 40);
    pen.font = "12px sans-serif";
  }
}

function legend(element, axis, ramp) {
  const digits = axis.high - axis.low < 10 ? 2 : 1;
  element.querySelector(".ramp").style.background = `linear-gradient(to right, ${ramp.map((c) => "#" + c).join(",")})`;
  element.querySelector(".low").textContent = axis.low.toFixed(digits);
  element.querySelector(".high").textContent = axis.high.toFixed(digits);
  element.querySelector(".unit").textContent = axis.name;
}

function show(figure) {
  const viewer = figure.querySelector(".viewer"), canvas = viewer.querySelector(".scene");
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  const made = gl && program(gl);
  if (!made) return;
  const mesh = JSON.parse(figure.querySelector(".mesh").textContent);
  const all = layers(mesh), indices = triangles(bytes(mesh.labels), mesh.rows, mesh.columns);
  const box = viewer.querySelector(".box"), pen = box.getContext("2d");
  const controls = Object.fromEntries([...viewer.querySelectorAll("[name]")].map((one) => [one.name, one]));
  const view = { azimuth: 0, elevation: 0, zoom: 1 };
  gl.useProgram(made);
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(1, 1, 1, 1);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
  fill(gl, made, "place", all.place, 2);
  const uniform = (name) => gl.getUniformLocation(made, name);
  const shown = () => controls.layer.value;
  const lift = () => 2 ** Number(controls.lift.value);

  function draw() {
    const ratio = window.devicePixelRatio || 1, size = { width: canvas.clientWidth, height: canvas.clientHeight };
    for (const one of [canvas, box]) {
      one.width = size.width * ratio;
      one.height = size.height * ratio;
    }
    view.turn = turned(view.azimuth * Math.PI / 180, view.elevation * Math.PI / 180);
    view.scale = 0.78 * Math.min(size.width, size.height * 1.2) * view.zoom;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const columns = [0, 1, 2].flatMap((column) => view.turn.map((row) => row[column]));
    gl.uniformMatrix3fv(uniform("turn"), false, columns);
    gl.uniform2f(uniform("zoom"), 2 * view.scale / size.width, 2 * view.scale / size.height);
    gl.uniform1f(uniform("lift"), lift());
    const [right, up, toward] = view.turn;
    gl.uniform3fv(uniform("light"), [0, 1, 2].map((k) => 0.82 * toward[k] + 0.45 * up[k] - 0.35 * right[k]));
    gl.drawElements(gl.TRIANGLES, indices.length, gl.UNSIGNED_INT, 0);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawBox(pen, view, [...all.axes, all[shown()].axis], lift(), size);
    viewer.querySelector(".lifted").textContent = `${lift().toPrecision(2)} ×`;
  }
  let asked = 0;
  const redraw = () => { cancelAnimationFrame(asked); asked = requestAnimationFrame(draw); };

  function choose() {
    const layer = all[shown()], ramp = RAMPS[shown()];
    fill(gl, made, "height", layer.height, 1);
    fill(gl, made, "tint", layer.tint, 1);
    gl.uniform3fv(uniform("ramp"), ramp.flatMap((c) => [0, 2, 4].map((k) => parseInt(c.slice(k, k + 2), 16) / 255)));
    legend(viewer.querySelector(".legend"), layer.axis, ramp);
    redraw();
  }
  function look(azimuth, elevation) {
    view.azimuth = azimuth;
    view.elevation = Math.max(-90, Math.min(90, elevation));
    redraw();
  }
  function zoom(factor) {
    view.zoom = Math.max(0.3, Math.min(20, view.zoom * factor));
    redraw();
  }

  const held = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, event);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const last = held.get(event.pointerId);
    if (!last) return;
    const other = [...held.values()].find((one) => one.pointerId !== event.pointerId);
    if (other) {
      const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY) || 1;
      zoom(apart(event) / apart(last));
    } else {
      look(view.azimuth - (event.clientX - last.clientX) * 0.4, view.elevation + (event.clientY - last.clientY) * 0.4);
    }
    held.set(event.pointerId, event);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = {
      ArrowLeft: () => look(view.azimuth + 5, view.elevation), ArrowRight: () => look(view.azimuth - 5, view.elevation),
      ArrowUp: () => look(view.azimuth, view.elevation - 5), ArrowDown: () => look(view.azimuth, view.elevation + 5),
      "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  for (const button of viewer.querySelectorAll("button")) {
    button.addEventListener("click", () => { view.zoom = 1; look(...VIEWS[button.value]); });
  }
  controls.lift.addEventListener("input", redraw);
  controls.layer.addEventListener("change", choose);
  controls.layer.closest("label").hidden = !all.residual;
  canvas.addEventListener("webglcontextlost", () => figure.classList.remove("live"));
  figure.classList.add("live");
  look(...VIEWS.oblique);
  choose();
  new ResizeObserver(redraw).observe(canvas);
}

for (const figure of document.querySelectorAll("figure.turnable")) show(figure);
