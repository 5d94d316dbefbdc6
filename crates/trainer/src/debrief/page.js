"use strict";
const D = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const floats = (text) => new Float32Array(bytes(text));
const make = (tag, text, cls) => { const e = document.createElement(tag); if (text !== undefined) e.textContent = text; if (cls) e.className = cls; return e; };
const SVG = "http://www.w3.org/2000/svg";
const draw = (parent, tag, attributes, text) => { const e = document.createElementNS(SVG, tag); for (const k in attributes) e.setAttribute(k, attributes[k]); if (text !== undefined) e.textContent = text; parent.appendChild(e); return e; };
const at = (t) => t.toFixed(2) + " s";
const svg = (parent, width, height, label) => draw(parent, "svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });

// One time for everything on the page.
const listeners = [];
let now = 0;
function setTime(t, from) {
  now = Math.min(Math.max(t, 0), D.seconds);
  if (from !== "slider") $("time").value = now;
  $("time").setAttribute("aria-valuetext", at(now));
  $("clock").textContent = at(now);
  document.documentElement.dataset.time = now.toFixed(2);
  for (const f of listeners) f(now);
}
function jump(t, text) {
  const b = make("button", text || at(t), "jump");
  b.type = "button";
  b.setAttribute("aria-label", "Show " + at(t) + " in the replay");
  b.onclick = () => { setTime(t); $("h-replay").scrollIntoView(); };
  return b;
}

const lower = (text) => text.charAt(0).toLowerCase() + text.slice(1);
function headline() {
  $("title").textContent = D.title;
  const { points, of } = D.score, share = of > 0 ? points / of : 0;
  const s = svg($("ring"), 120, 120, `Score: ${points.toFixed(0)} of ${of.toFixed(0)} points`);
  const around = 2 * Math.PI * 50;
  draw(s, "circle", { cx: 60, cy: 60, r: 50, fill: "none", stroke: "var(--line)", "stroke-width": 11 });
  draw(s, "circle", { cx: 60, cy: 60, r: 50, fill: "none", stroke: "var(--accent)", "stroke-width": 11, "stroke-linecap": "round", "stroke-dasharray": `${around * share} ${around}`, transform: "rotate(-90 60 60)" });
  draw(s, "text", { x: 60, y: 66, "text-anchor": "middle", "font-size": 34, "font-weight": 650, fill: "var(--ink)" }, points.toFixed(0));
  draw(s, "text", { x: 60, y: 84, "text-anchor": "middle", "font-size": 12, fill: "var(--soft)" }, "of " + of.toFixed(0));
  $("verdict").textContent = D.broken_s === null ? "The split is not complete." : `The split is complete after ${D.broken_s.toFixed(1)} s.`;
  if (D.broken_s === null) $("verdict").classList.add("warning");
  const bad = D.bad_split;
  $("split").textContent = bad ? (bad.kind ? `Bad split of type ${bad.kind}. ${bad.reason}` : "None of the published bad splits.") : `No verdict on the split: ${D.no_verdict}.`;
  if (bad && bad.kind) $("split").classList.add("warning");
  const lost = D.score.lines.filter((l) => l.points !== null && l.of - l.points >= 0.5).sort((a, b) => b.of - b.points - a.of + a.points);
  if (lost.length) {
    const l = lost[0];
    $("lost").append(`Most points lost, ${(l.of - l.points).toFixed(1).replace(/\.0$/, "")} of ${l.of}: ${lower(l.what.split(":")[0])}: ${l.found.replace(/\.$/, "")}. `);
    if (l.lost_at_s !== null) $("lost").append(jump(l.lost_at_s));
  } else $("lost").textContent = "No points were lost.";
}

// A round step, so that about `n` of them make `most`.
function step(most, n) {
  const rough = most / n, ten = Math.pow(10, Math.floor(Math.log10(rough)));
  return ten * [1, 2, 5, 10].find((k) => k * ten >= rough);
}
// Three digits, as people write them.
const short = (v) => Math.abs(v) >= 100 ? v.toFixed(0) : +v.toPrecision(3) + "";
// As wide as the page at first, so that letters keep their size on a phone.
const W = Math.min(Math.max($("main").clientWidth, 340), 1024), LEFT = 52, RIGHT = 8;
const xOf = (t) => LEFT + (t / D.seconds) * (W - LEFT - RIGHT);

// `wanted`: the rate asked for; such a plot goes in powers of ten, so that what falls short of it is seen beside what is far above.
function plot(id, lines, unit, label, wanted) {
  const H = 206, top = 12, bottom = 160;
  let most = wanted || 0;
  for (const l of lines) for (const v of l.values) if (v > most && isFinite(v)) most = v;
  if (!(most > 0)) most = 1;
  const dy = step(most, 4), high = wanted ? Math.pow(10, Math.ceil(Math.log10(most) - 1e-9)) : Math.ceil(most / dy - 1e-9) * dy;
  const low = wanted ? Math.min(10, high / 10) : 0, share = (v) => wanted ? Math.log(v / low) / Math.log(high / low) : v / high;
  const y = (v) => bottom - share(Math.min(Math.max(v, low), high)) * (bottom - top);
  const ticks = [];
  for (let v = low; v <= high * (1 + 1e-9); v = wanted ? 10 * v : v + dy) ticks.push(v);
  const s = svg($(id), W, H, label);
  for (const v of ticks) {
    draw(s, "line", { x1: LEFT, x2: W - RIGHT, y1: y(v), y2: y(v), stroke: "var(--line)" });
    draw(s, "text", { x: LEFT - 8, y: y(v) + 4, "text-anchor": "end" }, +v.toPrecision(6));
  }
  const dx = step(D.seconds, W / 90);
  for (let t = 0; t <= D.seconds + 1e-9; t += dx) draw(s, "text", { x: xOf(t), y: bottom + 18, "text-anchor": "middle" }, +t.toPrecision(6) + (t + dx > D.seconds ? " s" : ""));
  if (D.broken_s !== null) {
    draw(s, "line", { x1: xOf(D.broken_s), x2: xOf(D.broken_s), y1: top, y2: bottom, stroke: "var(--soft)", "stroke-dasharray": "2 3" });
    draw(s, "text", { x: xOf(D.broken_s) - 5, y: top + 4, "text-anchor": "end" }, "break");
  }
  if (wanted) draw(s, "line", { x1: LEFT, x2: W - RIGHT, y1: y(wanted), y2: y(wanted), stroke: "var(--now)", "stroke-dasharray": "6 4" });
  lines.forEach((l) => {
    let d = "";
    l.values.forEach((v, i) => { d += (i ? "L" : "M") + xOf(l.time(i)).toFixed(1) + " " + y(v).toFixed(1); });
    draw(s, "path", { d, fill: "none", stroke: l.color, "stroke-width": 1.6, "stroke-dasharray": l.dash || "none", "stroke-linejoin": "round" });
  });
  const mark = draw(s, "line", { y1: top - 6, y2: bottom, stroke: "var(--now)", "stroke-width": 2, class: "now" });
  const value = draw(s, "text", { y: H - 2, "text-anchor": "middle" });
  const parts = lines.map((l, i) => { if (i) draw(value, "tspan", {}, ", "); return draw(value, "tspan", { style: `fill:${l.color};font-weight:600` }); });
  const near = (l, t) => { let i = 0, n = l.values.length - 1, k = n; while (i < k) { const m = (i + k + 1) >> 1; if (l.time(m) <= t) i = m; else k = m - 1; } return l.values[i]; };
  listeners.push((t) => {
    const x = xOf(t);
    mark.setAttribute("x1", x); mark.setAttribute("x2", x);
    value.setAttribute("x", Math.min(Math.max(x, 110), W - 110));
    lines.forEach((l, i) => { parts[i].textContent = `${l.name} ${short(near(l, t) || 0)} ${unit}`; });
  });
  const seek = (e) => { const r = s.getBoundingClientRect(); setTime((((e.clientX - r.left) / r.width) * W - LEFT) / (W - LEFT - RIGHT) * D.seconds); };
  s.addEventListener("pointerdown", (e) => { s.setPointerCapture(e.pointerId); seek(e); });
  s.addEventListener("pointermove", (e) => { if (e.buttons) seek(e); });
}

function plots() {
  const load = (texts) => texts.map((text, i) => ({ name: ["left", "right"][i], color: ["var(--left)", "var(--right)"][i], dash: ["", "7 3"][i], values: floats(text), time: (k) => k * D.loads.step }));
  plot("plot-force", load(D.loads.force), "N", "Magnitude of the force displayed to each hand over time");
  plot("plot-torque", load(D.loads.torque), "N mm", "Magnitude of the torque displayed to each hand over time");
  const f = D.loads.factors;
  $("factors").textContent = `On the bone they were ${f[0][0].toFixed(0)} and ${f[0][1].toFixed(0)} times as large` + (f[0][0] === f[1][0] && f[0][1] === f[1][1] ? "." : ` (left), ${f[1][0].toFixed(0)} and ${f[1][1].toFixed(0)} times (right).`);
  const times = floats(D.rates.times), hz = floats(D.rates.hz);
  if (!hz.length) { $("rate-figure").hidden = true; return; }
  plot("plot-rate", [{ name: "possible", color: "var(--accent)", values: hz, time: (k) => times[k] }], "Hz", "Main updates that could be made in a second, over time", D.rates.wanted);
}

function strip() {
  const shades = ["#c9d6df", "#a9c5cc", "#7fb0b8", "#c2554d", "#d8d2c4"];
  const label = "Phases: " + D.phases.map(([n, s]) => `${n} ${s.toFixed(2)} s`).join(", ");
  $("strip").setAttribute("aria-label", label);
  const s = svg($("strip"), W, 44, label);
  let t = 0, free = 0;
  D.phases.forEach(([name, seconds], i) => {
    const x = xOf(t), w = xOf(t + seconds) - x;
    if (w > 0) draw(s, "rect", { x, y: 0, width: w, height: 16, fill: shades[i] });
    const text = `${name} ${seconds.toFixed(seconds < 1 ? 2 : 1)} s`, wide = 6.6 * text.length;
    const left = Math.max(Math.min(x, W - RIGHT - wide), free);
    if (seconds > 0 && left + wide < W + 20) { draw(s, "text", { x: left, y: 33 }, text); free = left + wide + 8; }
    t += seconds;
  });
  const mark = draw(s, "line", { y1: -2, y2: 18, stroke: "var(--now)", "stroke-width": 2 });
  listeners.push((t) => { mark.setAttribute("x1", xOf(t)); mark.setAttribute("x2", xOf(t)); });
}

function shots() {
  for (const shot of D.shots) {
    const f = make("figure"), img = make("img"), c = make("figcaption");
    const title = shot.title.charAt(0) + shot.title.slice(1).toLowerCase();
    img.src = "data:image/png;base64," + shot.png;
    img.width = 800; img.height = 450;
    img.alt = `The bone with both chisels from the cheek: ${title.toLowerCase()}, at ${at(shot.time)}`;
    c.append(title + ", ", jump(shot.time));
    f.append(img, c);
    $("shots").append(f);
  }
}

function rubric() {
  $("score-text").textContent = `${D.score.points.toFixed(1)} of ${D.score.of.toFixed(0)} points, by the rubric in the scenario's [targets]. What could not be measured does not count.`;
  for (const l of D.score.lines) {
    const r = make("tr"), th = make("th", l.what);
    th.scope = "row";
    const lost = l.points !== null && l.of - l.points >= 0.05;
    r.className = l.points === null ? "unknown" : lost ? "lost" : "";
    const where = make("td", undefined, "screen");
    if (lost && l.lost_at_s !== null) where.append(jump(l.lost_at_s));
    r.append(th, make("td", l.points === null ? "not known: " + l.found : l.found), make("td", l.points === null ? "\u2013 / " + l.of : `${+l.points.toFixed(1)} / ${l.of}`, "number"), where);
    // A phone shows a row in two lines; it stays a table to who hears it.
    r.setAttribute("role", "row");
    for (const cell of r.children) cell.setAttribute("role", cell === th ? "rowheader" : "cell");
    $("rubric").tBodies[0].append(r);
  }
}

const REGIONS = { buccal_front: "buccal plate, front half", buccal_back: "buccal plate, rear half", lingual_front: "lingual plate, front half", lingual_back: "lingual plate, rear half", condyle_neck: "condyle above its neck", coronoid: "coronoid process", lower_border: "lower border behind the buccal cut", ramus: "rear border of the ramus", chin: "chin" };
function split() {
  const bad = D.bad_split;
  $("bad").textContent = bad ? (bad.kind ? `Type ${bad.kind}: ` : "None of the published types: ") + bad.reason : `No verdict: ${D.no_verdict}.`;
  if (!bad) { $("regions").hidden = true; return; }
  for (const [region, shares] of Object.entries(bad.regions)) {
    const r = make("tr"), th = make("th", REGIONS[region] || region);
    th.scope = "row";
    r.append(th, ...shares.map((s) => make("td", (100 * s).toFixed(0) + " %", "number")));
    $("regions").tBodies[0].append(r);
  }
}

function figures() {
  const head = make("tr"), ref = D.reference;
  for (const [i, text] of ["Measure", "This session"].concat(ref ? ["Reference", "Difference"] : []).entries()) { const th = make("th", text, i ? "number" : ""); th.scope = "col"; head.append(th); }
  $("figures").tHead.append(head);
  $("compared").textContent = ref ? `Compared with ${ref.name}.` : "No reference session was given; osteotome report takes one with --reference.";
  const value = (row, k) => (k ? ref.rows : D.figures.rows)[row].value;
  const difference = (i) => { const [own, other] = [value(i, 0), value(i, 1)]; return own === null || other === null ? "" : (own >= other ? "+" : "\u2212") + Math.abs(own - other).toFixed(D.figures.rows[i].decimals); };
  const rows = D.figures.rows, is = (hand, f) => f.what.startsWith(hand + ": ");
  rows.forEach((f, i) => {
    // Both hands in one row.
    if (is("Right", f)) return;
    const other = is("Left", f) ? rows.findIndex((g) => is("Right", g) && g.what.slice(7) === f.what.slice(6)) : -1;
    const both = other < 0 ? [i] : [i, other], of = (text) => both.map(text).join(" / ");
    const what = other < 0 ? f.what : f.what.charAt(6).toUpperCase() + f.what.slice(7) + ", left / right";
    const unknown = both.find((k) => value(k, 0) === null);
    const all = (k) => of((j) => value(j, k) === null ? "\u2013" : value(j, k).toFixed(f.decimals)) + " " + f.unit;
    const r = make("tr"), th = make("th", what);
    th.scope = "row";
    r.append(th, unknown === undefined ? make("td", all(0), "number") : make("td", "not known: " + rows[unknown].why_not));
    if (unknown !== undefined) r.className = "unknown";
    if (ref) r.append(make("td", all(1), "number"), make("td", of(difference), "number"));
    $("figures").tBodies[0].append(r);
  });
}

function curve() {
  const all = D.curve;
  if (all.length < 2) { $("curve").append(make("p", "One session makes no curve. Give several to osteotome report, in their order; single sessions tell little about skill.")); return; }
  const box = make("div", undefined, "curves");
  $("curve").append(make("p", `${all.length} sessions in the order given; the last is this page's.`), box);
  for (const what of ["Score", "Time until the split", "Left: overshoot after the break", "Right: overshoot after the break", "Left: peak torque on the bone", "Broken face beside the plan, mean", "Crack to the canal's wall", "Left: path of the edge"]) {
    const i = all[0].rows.findIndex((r) => r.what === what), unit = all[0].rows[i].unit;
    const points = all.map((s, k) => [k, s.rows[i].value]).filter((p) => p[1] !== null);
    if (!points.length) continue;
    const f = make("figure");
    f.append(make("figcaption", what + (unit ? `, ${unit}` : "")));
    const s = svg(f, 300, 130, `${what} by session: ` + points.map((p) => `${p[0] + 1}: ${p[1].toFixed(1)}`).join(", "));
    const low = Math.min(0, ...points.map((p) => p[1])), high = Math.max(0, low + 1e-6, ...points.map((p) => p[1]));
    const x = (k) => 40 + (k / (all.length - 1)) * 245, y = (v) => 100 - ((v - low) / (high - low)) * 85;
    for (const v of [low, high]) { draw(s, "line", { x1: 40, x2: 290, y1: y(v), y2: y(v), stroke: "var(--line)" }); draw(s, "text", { x: 34, y: y(v) + 4, "text-anchor": "end" }, +v.toPrecision(3)); }
    draw(s, "path", { d: points.map((p, n) => (n ? "L" : "M") + x(p[0]) + " " + y(p[1])).join(""), fill: "none", stroke: "var(--accent)", "stroke-width": 2 });
    for (const p of points) draw(s, "circle", { cx: x(p[0]), cy: y(p[1]), r: 4, fill: "var(--accent)" });
    all.forEach((_, k) => draw(s, "text", { x: x(k), y: 122, "text-anchor": "middle" }, k + 1));
    box.append(f);
  }
}

function lists() {
  for (const [t, text] of D.events) { const li = make("li"); li.append(jump(t), make("span", text)); $("events").append(li); }
  if (!D.events.length) $("events").append(make("li", "None were recorded."));
  for (const note of D.notes) $("notes").append(make("li", note));
  $("foot").textContent = `Made by osteotome ${D.version}. This page is one file and asks nothing of any network. A simulator for training and research: not a medical device.`;
}

function controls() {
  const time = $("time");
  time.max = D.seconds;
  time.oninput = () => setTime(+time.value, "slider");
  let last = 0;
  const run = (stamp) => {
    if ($("play").getAttribute("aria-pressed") !== "true") return;
    if (last) setTime(now + ((stamp - last) / 1000) * +$("speed").value);
    last = stamp;
    if (now >= D.seconds) stop(); else requestAnimationFrame(run);
  };
  const stop = () => { $("play").setAttribute("aria-pressed", "false"); $("play").textContent = "Play"; };
  $("play").onclick = () => {
    if ($("play").getAttribute("aria-pressed") === "true") return stop();
    if (now >= D.seconds) setTime(0);
    $("play").setAttribute("aria-pressed", "true");
    $("play").textContent = "Pause";
    last = 0;
    requestAnimationFrame(run);
  };
}

headline(); plots(); strip(); shots(); rubric(); split(); figures(); curve(); lists(); controls();
