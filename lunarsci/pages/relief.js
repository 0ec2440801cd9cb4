"use strict";
// A ground that can be turned: squares painted from the farthest to the nearest, lines over them.
for (const canvas of document.querySelectorAll("canvas[data-relief]")) {
  const scene = JSON.parse(atob(canvas.dataset.relief));
  const bytes = Uint8Array.from(atob(scene.heights), (c) => c.charCodeAt(0));
  const whole = new Int16Array(bytes.buffer);
  const { rows, columns } = scene;
  const width = scene.x[1] - scene.x[0], depth = scene.y[1] - scene.y[0];
  const size = Math.hypot(width, depth), middle = scene.low + 16000 * scene.scale;
  const start = { turn: -0.6, tilt: 0.85, zoom: 1, tall: 1 };
  const view = { ...start };
  const x = (c) => (c / (columns - 1) - 0.5) * width, y = (r) => (r / (rows - 1) - 0.5) * depth;
  const z = (v) => scene.low + v * scene.scale - middle;

  function projection(w, h) {
    const k = (0.92 * view.zoom * Math.min(w, 1.6 * h)) / size;
    const ct = Math.cos(view.turn), st = Math.sin(view.turn), ci = Math.cos(view.tilt), si = Math.sin(view.tilt);
    return (px, py, pz) => {
      const a = ct * px - st * py, b = st * px + ct * py;
      return [w / 2 + k * a, h / 2 - k * (b * ci + pz * view.tall * si)];
    };
  }

  function draw() {
    const w = canvas.clientWidth || 300, h = Math.round(0.62 * w), dots = window.devicePixelRatio || 1;
    canvas.width = w * dots;
    canvas.height = h * dots;
    const ink = canvas.getContext("2d");
    ink.scale(dots, dots);
    ink.fillStyle = "#eef1f3";
    ink.fillRect(0, 0, w, h);
    const at = projection(w, h);
    const up = Math.cos(view.turn) > 0 ? -1 : 1, over = Math.sin(view.turn) > 0 ? -1 : 1;
    const order = (n, sign) => Array.from({ length: n - 1 }, (_, k) => (sign > 0 ? k : n - 2 - k));
    const across = order(columns, over);
    for (const r of order(rows, up)) for (const c of across) square(ink, at, r, c);
    for (const line of scene.lines) stroke(ink, at, line);
    canvas.dataset.view = [view.turn, view.tilt, view.zoom, view.tall].map((v) => v.toFixed(3)).join(" ");
  }

  function square(ink, at, r, c) {
    const corners = [r * columns + c, r * columns + c + 1, (r + 1) * columns + c + 1, (r + 1) * columns + c];
    const v = corners.map((n) => whole[n]);
    if (v.includes(scene.hole)) return;
    const p = [at(x(c), y(r), z(v[0])), at(x(c + 1), y(r), z(v[1])), at(x(c + 1), y(r + 1), z(v[2])), at(x(c), y(r + 1), z(v[3]))];
    const dx = ((v[1] + v[2] - v[0] - v[3]) * scene.scale * (columns - 1)) / (2 * width);
    const dy = ((v[2] + v[3] - v[0] - v[1]) * scene.scale * (rows - 1)) / (2 * depth);
    const steep = 2.5 * view.tall;
    const light = (0.5 * steep * dx - 0.5 * steep * dy + 0.71) / Math.hypot(steep * dx, steep * dy, 1);
    const tone = Math.round(55 + 190 * Math.max(0, Math.min(1, light)));
    ink.fillStyle = ink.strokeStyle = `rgb(${tone},${tone},${Math.min(255, tone + 4)})`;
    ink.lineWidth = 0.7;
    ink.beginPath();
    p.forEach(([a, b], k) => (k ? ink.lineTo(a, b) : ink.moveTo(a, b)));
    ink.closePath();
    ink.fill();
    ink.stroke();
  }

  function stroke(ink, at, line) {
    for (const [color, wide, dash] of [["rgba(255,255,255,.55)", 3, []], [line.color, 1.5, line.dashed ? [6, 3] : []]]) {
      ink.strokeStyle = color;
      ink.lineWidth = wide;
      ink.setLineDash(dash);
      ink.beginPath();
      line.points.forEach(([px, py, pz], k) => {
        const [a, b] = at(px - (scene.x[0] + scene.x[1]) / 2, py - (scene.y[0] + scene.y[1]) / 2, pz - middle);
        if (k) ink.lineTo(a, b); else ink.moveTo(a, b);
      });
      ink.stroke();
    }
    ink.setLineDash([]);
  }

  const clamp = (v, low, high) => Math.max(low, Math.min(high, v));
  function change(turn, tilt, zoom, tall) {
    view.turn += turn;
    view.tilt = clamp(view.tilt + tilt, 0.1, 1.5);
    view.zoom = clamp(view.zoom * zoom, 0.4, 12);
    view.tall = clamp(view.tall * tall, 1, 8);
    draw();
  }
  const steps = {
    left: () => change(0.15, 0, 1, 1), right: () => change(-0.15, 0, 1, 1),
    up: () => change(0, -0.1, 1, 1), down: () => change(0, 0.1, 1, 1),
    nearer: () => change(0, 0, 1.25, 1), farther: () => change(0, 0, 0.8, 1),
    taller: () => change(0, 0, 1, 2), lower: () => change(0, 0, 1, 0.5),
    again: () => { Object.assign(view, start); draw(); },
  };
  const keys = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", "+": "nearer", "=": "nearer", "-": "farther", Home: "again" };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in keys)) return;
    event.preventDefault();
    steps[keys[event.key]]();
  });
  for (const button of canvas.parentElement.querySelectorAll("button[data-step]"))
    button.addEventListener("click", () => steps[button.dataset.step]());
  let from = null;
  canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    change(-0.008 * (event.clientX - from[0]), 0.006 * (event.clientY - from[1]), 1, 1);
    from = [event.clientX, event.clientY];
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { from = null; });
  new ResizeObserver(draw).observe(canvas);
  canvas.parentElement.hidden = false;
  draw();
}
// Pictures grow when they are chosen.
const large = document.querySelector("dialog.large");
for (const button of document.querySelectorAll("button.zoom"))
  button.addEventListener("click", () => {
    const picture = large.querySelector("img"), own = button.querySelector("img");
    picture.src = own.src;
    picture.alt = own.alt;
    picture.style.width = "100%";
    large.showModal();
  });
for (const button of large.querySelectorAll("button[data-zoom]"))
  button.addEventListener("click", () => {
    const picture = large.querySelector("img"), factor = Number(button.dataset.zoom);
    if (!factor) return large.close();
    picture.style.width = `${Math.max(50, Math.min(800, parseFloat(picture.style.width) * factor))}%`;
  });
// Paper shows what is folded away.
let opened = [];
addEventListener("beforeprint", () => {
  opened = [...document.querySelectorAll("details:not([open])")];
  for (const one of opened) one.open = true;
});
addEventListener("afterprint", () => {
  for (const one of opened) one.open = false;
});
