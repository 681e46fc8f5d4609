const host = document.currentScript.previousElementSibling;
const C = { ink: "#1c2430", soft: "#8893a1", line: "#dfe4ea", accent: "#e06a00", blue: "#0a6ebd", ground: "#f4f6f8" };
function element(tag, parent, style) { const e = document.createElement(tag); Object.assign(e.style, style || {}); parent.appendChild(e); return e; }
Object.assign(host.style, { border: "1px solid " + C.line, borderRadius: "8px", padding: "10px", margin: "14px 0", background: "#fff" });
const top_ = element("div", host, { display: "flex", flexWrap: "wrap", gap: "10px" });
function panel(basis, ratio, label) {
  const box = element("div", top_, { flex: "1 1 " + basis + "px", minWidth: "0" });
  const note = element("div", box, { font: "13px system-ui", color: C.soft }); note.textContent = label;
  const canvas = element("canvas", box, { width: "100%", display: "block", aspectRatio: String(ratio), touchAction: "none" });
  return canvas;
}
const scene = panel(480, 4 / 3, "drag to turn, wheel to come nearer");
const side = element("div", top_, { flex: "1 1 300px", minWidth: "0" });
const aboveNote = element("div", side, { font: "13px system-ui", color: C.soft });
aboveNote.textContent = DATA.enlarged === 1 ? "the path, seen flat" : "the path, seen flat, error enlarged " + DATA.enlarged + " times";
const above = element("canvas", side, { width: "100%", display: "block", aspectRatio: "1.6" });
let inset = null;
if (DATA.pictures.length) {
  const note = element("div", side, { font: "13px system-ui", color: C.soft }); note.textContent = "the camera's picture";
  inset = element("img", side, { width: "100%", maxWidth: "320px", display: "block", imageRendering: "pixelated" });
}
const plot = element("canvas", host, { width: "100%", display: "block", aspectRatio: "7", minHeight: "110px", marginTop: "8px" });
const bar = element("div", host, { display: "flex", gap: "10px", alignItems: "center", font: "14px system-ui", marginTop: "6px", flexWrap: "wrap" });
const button = element("button", bar, { minWidth: "64px", padding: "4px 8px" }); button.textContent = "play";
const slider = element("input", bar, { flex: "1 1 160px" }); slider.type = "range"; slider.min = 0; slider.max = DATA.t.length - 1; slider.step = 1; slider.value = 0;
const speed = element("select", bar); for (const s of [0.1, 0.25, 0.5, 1, 2]) { const o = element("option", speed); o.value = s; o.textContent = s + " ×"; if (s === 0.5) o.selected = true; }
const said = element("span", bar, { fontVariantNumeric: "tabular-nums", minWidth: "190px" });
host.dataset.frames = DATA.t.length;

let yaw = 0.9, pitch = 0.42, zoom = 1, k = 0;
const all = DATA.tool.concat(...Object.values(DATA.curves));
let low = [0, 0, 0], high = [0.2, 0.2, 0.9];
// Corners of the arm's shapes where it begins, in between and where it ends: all of them are to be seen.
const seen = all.slice();
for (const i of [0, 0.3, 0.6, 1].map(x => Math.floor(x * (DATA.t.length - 1)))) for (const shape of DATA.shapes) {
  const T = DATA.links[i][shape.link];
  for (const face of shape.faces) for (const p of face) seen.push([0, 1, 2].map(a => T[3 * a] * p[0] + T[3 * a + 1] * p[1] + T[3 * a + 2] * p[2] + T[9 + a]));
}
for (const p of seen) for (let a = 0; a < 3; a++) { low[a] = Math.min(low[a], p[a]); high[a] = Math.max(high[a], p[a]); }
const centre = low.map((v, a) => 0.5 * (v + high[a])), size = Math.hypot(...high.map((v, a) => v - low[a]));
const known = DATA.error.filter(e => e !== null), largest = Math.max(...known.map(Math.abs), 1e-9);

const forces = (DATA.force || []).map(f => Math.hypot(...f)).sort((a, b) => a - b);
const perNewton = forces.length ? 0.25 / Math.max(forces[Math.floor(0.99 * (forces.length - 1))], 1e-9) : 0;
function curveColour(i) { return [C.ink, C.blue, "#784ea0", "#2b8a3e"][i % 4]; }
const legend = element("div", scene.parentNode, { font: "13px system-ui" });
Object.keys(DATA.curves).forEach((name, i) => { const s = element("span", legend, { color: curveColour(i), marginRight: "14px", display: "inline-block" }); s.textContent = "— " + name; });
{ const s = element("span", legend, { color: "#2b8a3e", marginRight: "14px", display: "inline-block" }); s.textContent = "— tool, green to red: " + DATA.errorName; }
if (DATA.force) { const s = element("span", legend, { color: C.blue, display: "inline-block" }); s.textContent = "→ force on the tool"; }
function sized(canvas) {
  const r = window.devicePixelRatio || 1, w = Math.max(1, Math.round(canvas.clientWidth * r)), h = Math.max(1, Math.round(canvas.clientHeight * r));
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const g = canvas.getContext("2d"); g.setTransform(r, 0, 0, r, 0, 0); g.clearRect(0, 0, w, h);
  return [g, canvas.clientWidth, canvas.clientHeight];
}
function camera(w, h) {
  const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
  const right = [-sy, cy, 0], back = [cy * cp, sy * cp, sp], up = [-cy * sp, -sy * sp, cp];
  const far = 1.55 * size / zoom, f = 1.25 * Math.min(w, h * 1.2);
  return p => {
    const d = [p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]];
    const z = far - (d[0] * back[0] + d[1] * back[1] + d[2] * back[2]);
    const s = f / Math.max(z, 0.05);
    return [w / 2 + s * (d[0] * right[0] + d[1] * right[1]), h / 2 - s * (d[0] * up[0] + d[1] * up[1] + d[2] * up[2]), z];
  };
}
// As near as all that is to be seen allows, beginning from where the arm and its path just fit.
for (let i = 0; i < 4; i++) {
  const see = camera(4, 3), out = Math.max(...seen.map(p => { const s = see(p); return Math.max(Math.abs(s[0] - 2) / 2, Math.abs(s[1] - 1.5) / 1.5); }));
  zoom *= 0.96 / out;
}
function colour(e) { if (e === null) return C.soft; const x = Math.min(1, Math.abs(e) / largest); return `hsl(${Math.round(130 * (1 - x))},75%,42%)`; }
function polyline(g, points, style, width) {
  g.beginPath(); points.forEach((p, i) => i ? g.lineTo(p[0], p[1]) : g.moveTo(p[0], p[1])); g.strokeStyle = style; g.lineWidth = width; g.lineJoin = "round"; g.stroke();
}
const light = [0.45, -0.35, 0.82];
function arm(faces, poses, see) {
  for (const shape of DATA.shapes) {
    const T = poses[shape.link];
    for (const face of shape.faces) {
      const w = face.map(p => [T[0] * p[0] + T[1] * p[1] + T[2] * p[2] + T[9], T[3] * p[0] + T[4] * p[1] + T[5] * p[2] + T[10], T[6] * p[0] + T[7] * p[1] + T[8] * p[2] + T[11]]);
      const a = [w[1][0] - w[0][0], w[1][1] - w[0][1], w[1][2] - w[0][2]], b = [w[2][0] - w[0][0], w[2][1] - w[0][1], w[2][2] - w[0][2]];
      const n = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]], l = Math.hypot(...n) || 1;
      const shade = 0.62 + 0.38 * Math.abs((n[0] * light[0] + n[1] * light[1] + n[2] * light[2]) / l);
      const s = w.map(see), z = s.reduce((sum, p) => sum + p[2], 0) / s.length;
      const c = shape.colour.map(v => Math.round(v * shade));
      faces.push([z, s, `rgb(${c[0]},${c[1]},${c[2]})`]);
    }
  }
}
function drawScene() {
  const [g, w, h] = sized(scene), see = camera(w, h);
  g.fillStyle = C.ground; g.fillRect(0, 0, w, h);
  for (let i = -4; i <= 6; i++) {
    polyline(g, [see([i * 0.25, -1.2, 0]), see([i * 0.25, 1.2, 0])], C.line, 1);
    if (i <= 4) polyline(g, [see([-1, i * 0.3, 0]), see([1.5, i * 0.3, 0])], C.line, 1);
  }
  const faces = [];
  if (DATA.surface) {
    const s = DATA.surface.map(see); g.beginPath(); s.forEach((p, i) => i ? g.lineTo(p[0], p[1]) : g.moveTo(p[0], p[1])); g.closePath();
    g.fillStyle = "#fbfbf7"; g.fill(); g.strokeStyle = C.soft; g.lineWidth = 1; g.stroke();
  }
  Object.values(DATA.curves).forEach((c, i) => polyline(g, c.map(see), curveColour(i), i ? 1.2 : 2.2));
  for (let i = 1; i <= k; i++) polyline(g, [see(DATA.tool[i - 1]), see(DATA.tool[i])], colour(DATA.error[i]), 2.5);
  arm(faces, DATA.links[k], see);
  faces.sort((a, b) => b[0] - a[0]);
  for (const [, s, c] of faces) {
    g.beginPath(); s.forEach((p, i) => i ? g.lineTo(p[0], p[1]) : g.moveTo(p[0], p[1])); g.closePath();
    g.fillStyle = c; g.fill(); g.strokeStyle = c; g.lineWidth = 0.6; g.stroke();
  }
  const p = see(DATA.tool[k]); g.beginPath(); g.arc(p[0], p[1], 4, 0, 7); g.fillStyle = C.accent; g.fill();
  if (DATA.force && Math.hypot(...DATA.force[k]) * perNewton > 0.01) {
    // The arrow ends at the tool.
    const q = see(DATA.tool[k].map((x, a) => x - perNewton * DATA.force[k][a])), l = Math.hypot(p[0] - q[0], p[1] - q[1]) || 1;
    const u = [(p[0] - q[0]) / l, (p[1] - q[1]) / l], back = Math.min(10, l);
    polyline(g, [q, p], C.blue, 2.5);
    polyline(g, [-1, 0, 1].map(s => s ? [p[0] - back * u[0] - 0.5 * s * back * u[1], p[1] - back * u[1] + 0.5 * s * back * u[0]] : p), C.blue, 2.5);
  }
}
// The two directions in which the path spreads most, so that any path is seen flat.
const mean = [0, 1, 2].map(a => DATA.wanted.reduce((s, p) => s + p[a], 0) / DATA.wanted.length);
function spread(without) {
  let v = without ? [0.3, 1, 0.2] : [1, 0.3, 0.2];
  for (let i = 0; i < 60; i++) {
    const n = [0, 0, 0];
    for (const p of DATA.wanted) { const d = p.map((x, a) => x - mean[a]), s = d[0] * v[0] + d[1] * v[1] + d[2] * v[2]; for (let a = 0; a < 3; a++) n[a] += s * d[a]; }
    if (without) { const s = n[0] * without[0] + n[1] * without[1] + n[2] * without[2]; for (let a = 0; a < 3; a++) n[a] -= s * without[a]; }
    const l = Math.hypot(...n); if (l < 1e-12) break; v = n.map(x => x / l);
  }
  return v;
}
const first = spread(null); let second = spread(first);
if (Math.abs(first[0] * second[0] + first[1] * second[1] + first[2] * second[2]) > 0.1) second = [-first[1], first[0], 0];
const flat = p => [0, 1].map(i => { const e = i ? second : first; return (p[0] - mean[0]) * e[0] + (p[1] - mean[1]) * e[1] + (p[2] - mean[2]) * e[2]; });
const wanted2 = DATA.wanted.map(flat);
const shown2 = DATA.wanted.map((p, i) => flat(p.map((x, a) => x + DATA.enlarged * (DATA.tool[i][a] - x))));
const box2 = [0, 1].map(a => { const v = wanted2.concat(shown2).map(p => p[a]).sort((x, y) => x - y); return [v[Math.floor(0.01 * v.length)], v[Math.floor(0.99 * v.length)]]; });
function drawAbove() {
  const [g, w, h] = sized(above); g.fillStyle = C.ground; g.fillRect(0, 0, w, h);
  const s = 0.88 * Math.min(w / Math.max(box2[0][1] - box2[0][0], 1e-6), h / Math.max(box2[1][1] - box2[1][0], 1e-6));
  const to = p => [w / 2 + s * (p[0] - 0.5 * (box2[0][0] + box2[0][1])), h / 2 - s * (p[1] - 0.5 * (box2[1][0] + box2[1][1]))];
  polyline(g, wanted2.map(to), C.ink, 1.5);
  for (let i = 1; i < shown2.length; i++) { g.globalAlpha = i <= k ? 1 : 0.15; polyline(g, [to(shown2[i - 1]), to(shown2[i])], colour(DATA.error[i]), 2); }
  g.globalAlpha = 1; const p = to(shown2[k]); g.beginPath(); g.arc(p[0], p[1], 4, 0, 7); g.fillStyle = C.accent; g.fill();
}
function drawPlot() {
  const [g, w, h] = sized(plot), left = 52, bottom = 20, end = DATA.t[DATA.t.length - 1] || 1;
  g.font = "12px system-ui"; g.fillStyle = C.soft;
  const X = t => left + (w - left - 8) * t / end, lowest = Math.min(0, ...known), Y = e => 6 + (h - bottom - 8) * (1 - (e - lowest) / (1.05 * (Math.max(...known, 1e-9) - lowest)));
  g.fillText("time [s]", w - 52, h - 4); g.fillText("0", X(0) - 2, h - 4); g.fillText(end.toFixed(1), Math.max(X(end) - 90, X(0) + 20), h - 4);
  for (const e of [0, largest / 2, largest]) { polyline(g, [[left, Y(e)], [w - 8, Y(e)]], C.line, 1); g.fillText(e ? e.toPrecision(2) : "0", 16, Y(e) + 4); }
  let piece = [];
  DATA.t.forEach((t, i) => { if (DATA.error[i] === null) { if (piece.length) polyline(g, piece, C.accent, 1.5); piece = []; } else piece.push([X(t), Y(DATA.error[i])]); });
  if (piece.length) polyline(g, piece, C.accent, 1.5);
  polyline(g, [[X(DATA.t[k]), 4], [X(DATA.t[k]), h - bottom]], C.ink, 1);
  g.save(); g.translate(10, h / 2 + 8); g.rotate(-Math.PI / 2); g.fillText(DATA.unit, 0, 0); g.restore();
}
function draw() {
  drawScene(); drawAbove(); drawPlot();
  if (inset) { let best = DATA.pictures[0]; for (const p of DATA.pictures) if (Math.abs(p[0] - DATA.t[k]) < Math.abs(best[0] - DATA.t[k])) best = p; if (inset.src !== best[1]) inset.src = best[1]; }
  said.textContent = DATA.t[k].toFixed(2) + " s, " + (DATA.error[k] === null ? "" : DATA.errorName + " " + DATA.error[k].toPrecision(3) + " " + DATA.unit) + (DATA.force ? ", force " + Math.hypot(...DATA.force[k]).toPrecision(3) + " N" : "");
  slider.value = k; host.dataset.frame = k;
}
let running = false, started = 0, from = 0;
function tick(now) {
  if (!running) return;
  const t = from + (now - started) / 1000 * speed.value, end = DATA.t[DATA.t.length - 1];
  if (t >= end) { from = 0; started = now; k = 0; } else { let i = 0; while (i < DATA.t.length - 1 && DATA.t[i + 1] <= t) i++; k = i; }
  draw(); requestAnimationFrame(tick);
}
function run(on) { running = on; button.textContent = on ? "pause" : "play"; if (on) { from = DATA.t[k]; started = performance.now(); requestAnimationFrame(tick); } }
button.onclick = () => run(!running); speed.onchange = () => { if (running) run(true); };
slider.oninput = () => { k = Number(slider.value); if (running) run(true); draw(); };
let held = null;
scene.onpointerdown = e => { held = [e.clientX, e.clientY]; scene.setPointerCapture(e.pointerId); };
scene.onpointermove = e => { if (!held) return; yaw -= 0.008 * (e.clientX - held[0]); pitch = Math.min(1.5, Math.max(-0.1, pitch + 0.006 * (e.clientY - held[1]))); held = [e.clientX, e.clientY]; draw(); };
scene.onpointerup = () => { held = null; };
scene.onwheel = e => { e.preventDefault(); zoom = Math.min(8, Math.max(0.4, zoom * Math.exp(-0.001 * e.deltaY))); draw(); };
window.addEventListener("resize", draw);
k = Math.floor(0.6 * (DATA.t.length - 1)); draw();
