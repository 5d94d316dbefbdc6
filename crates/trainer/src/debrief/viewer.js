// The 3D view: a small WebGL drawing of what moves with the bone, and of the tools.
const LOOKS = {
  bone: { name: "bone, proximal", color: [0.86, 0.79, 0.66] }, broken: { name: "broken face", color: [0.74, 0.36, 0.28] }, sawn: { name: "sawn face", color: [0.88, 0.66, 0.52] },
  crack: { name: "crack (see-through)", color: [0.95, 0.12, 0.1] }, teeth: { name: "teeth", color: [0.93, 0.92, 0.87] }, canal: { name: "nerve's canal (see-through)", color: [0.98, 0.83, 0.16] },
};
const PIECES = [[0.86, 0.79, 0.66], [0.70, 0.78, 0.80], [0.85, 0.62, 0.70], [0.72, 0.70, 0.86]];
const HANDS = [[0.42, 0.60, 1.0], [0.36, 0.86, 0.50]];

const V = { // columns first
  mul: (a, b) => { const r = new Float32Array(16); for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) { let s = 0; for (let k = 0; k < 4; k++) s += a[k * 4 + j] * b[i * 4 + k]; r[i * 4 + j] = s; } return r; },
  perspective: (angle, aspect, near, far) => { const f = 1 / Math.tan(angle / 2); return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0]); },
  sub: (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]], dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  unit: (a) => { const n = Math.hypot(...a) || 1; return a.map((c) => c / n); },
  look: (eye, to, up) => { const z = V.unit(V.sub(eye, to)), x = V.unit(V.cross(up, z)), y = V.cross(z, x); return new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -V.dot(x, eye), -V.dot(y, eye), -V.dot(z, eye), 1]); },
};

function viewer() {
  const S = D.shapes, canvas = $("view");
  const gl = S && canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true, alpha: false });
  const none = (text) => { $("view-none").hidden = false; $("view-none").textContent = text; };
  if (!S) return none("The bone's motion was not recorded.");
  if (!gl) return none("This browser has no WebGL; the pictures below show the key moments.");
  gl.getExtension("OES_element_index_uint");
  const shader = (kind, text) => { const s = gl.createShader(kind); gl.shaderSource(s, text); gl.compileShader(s); if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s)); return s; };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `attribute vec3 at; attribute vec3 normal; attribute vec3 tint; attribute float born; uniform mat4 view, lens; varying vec3 n, p, c; varying float b;
    void main() { vec4 e = view * vec4(at, 1.0); n = mat3(view) * normal; p = e.xyz; c = tint; b = born; gl_Position = lens * e; gl_PointSize = 3.0; }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `precision mediump float; varying vec3 n, p, c; varying float b; uniform float time, alpha, flatness, gloss;
    void main() { if (b > time) discard; vec3 e = normalize(-p), m = normalize(n); if (dot(m, e) < 0.0) m = -m;
      float key = max(dot(m, normalize(vec3(-0.35, 0.65, 0.7))), 0.0), fill = max(dot(m, normalize(vec3(0.8, 0.1, 0.5))), 0.0), rim = 1.0 - max(dot(m, e), 0.0);
      float shine = pow(max(dot(m, normalize(e + normalize(vec3(-0.35, 0.65, 0.7)))), 0.0), 40.0) * gloss;
      vec3 lit = c * (0.26 + 0.68 * key + 0.24 * fill) + shine; float a = alpha < 1.0 ? clamp(alpha + 0.55 * rim * rim * rim, 0.0, 0.85) : 1.0;
      gl_FragColor = vec4(mix(lit, c, flatness), a); }`));
  gl.linkProgram(program);
  gl.useProgram(program);
  const where = (name) => gl.getUniformLocation(program, name), slot = ["at", "normal", "tint", "born"].map((name) => gl.getAttribLocation(program, name));
  const fill = (buffer, data, kind = gl.ARRAY_BUFFER, use = gl.DYNAMIC_DRAW) => { gl.bindBuffer(kind, buffer); gl.bufferData(kind, data, use); };
  const mesh = (positions, triangles, tint) => {
    const n = positions.length / 3, tints = new Float32Array(positions.length);
    for (let i = 0; i < n; i++) tints.set(tint(i), 3 * i);
    const m = { n: triangles.length, triangles, positions, normals: new Float32Array(positions.length), at: gl.createBuffer(), normal: gl.createBuffer(), tint: gl.createBuffer(), born: gl.createBuffer(), index: gl.createBuffer() };
    fill(m.tint, tints); fill(m.index, triangles, gl.ELEMENT_ARRAY_BUFFER, gl.STATIC_DRAW); fill(m.born, new Float32Array(n).fill(-1));
    return m;
  };
  const settle = (m) => { // normals by area, then up to the card
    const { positions: p, triangles: t, normals: n } = m;
    n.fill(0);
    for (let i = 0; i < t.length; i += 3) {
      const a = 3 * t[i], b = 3 * t[i + 1], c = 3 * t[i + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2], vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const k of [a, b, c]) { n[k] += x; n[k + 1] += y; n[k + 2] += z; }
    }
    fill(m.at, p); fill(m.normal, n);
  };
  const put = (m, mode) => {
    [m.at, m.normal, m.tint, m.born].forEach((buffer, i) => { gl.bindBuffer(gl.ARRAY_BUFFER, buffer); gl.enableVertexAttribArray(slot[i]); gl.vertexAttribPointer(slot[i], i === 3 ? 1 : 3, gl.FLOAT, false, 0, 0); });
    if (mode === undefined) { gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, m.index); gl.drawElements(gl.TRIANGLES, m.n, gl.UNSIGNED_INT, 0); } else gl.drawArrays(mode, 0, m.shown);
  };

  const parts = S.parts.map((part) => {
    const rest = floats(part.rest), fragments = new Int16Array(bytes(part.fragments)), look = LOOKS[part.kind].color;
    const m = mesh(new Float32Array(rest), new Uint32Array(bytes(part.triangles)), (i) => part.kind === "bone" ? PIECES[fragments[i] === 0 ? 0 : 1 + ((fragments[i] - 1) % 3)] : look);
    if (part.born) fill(m.born, floats(part.born));
    return Object.assign(m, { kind: part.kind, rest, fragments, nodes: new Uint32Array(bytes(part.nodes)), weights: new Int16Array(bytes(part.weights)) });
  });
  const times = floats(S.times), frames = new Int16Array(bytes(S.frames)), shift = new Float32Array(3 * S.n_nodes);
  const tools = S.tools.map((tool, i) => {
    const rest = floats(tool.positions), poses = floats(tool.poses), m = mesh(new Float32Array(rest), new Uint32Array(bytes(tool.triangles)), (v) => rest[3 * v + 2] < -9 ? HANDS[i].map((c) => 0.5 * c) : [0.8, 0.82, 0.86]);
    const n = poses.length / 7, line = new Float32Array(3 * n);
    for (let k = 0; k < n; k++) line.set(poses.subarray(7 * k, 7 * k + 3), 3 * k);
    const path = { at: gl.createBuffer(), normal: gl.createBuffer(), tint: gl.createBuffer(), born: gl.createBuffer(), shown: 0, n };
    fill(path.at, line); fill(path.normal, new Float32Array(3 * n).fill(1)); fill(path.born, new Float32Array(n).fill(-1)); fill(path.tint, new Float32Array(3 * n).map((_, k) => HANDS[i][k % 3]));
    return Object.assign(m, { rest, poses, path });
  });

  const start = { turn: S.side > 0 ? 0.56 : -0.56, tilt: 0.55, away: 3.6, aside: [0, 0, 0] };
  const eye = structuredClone(start);
  const views = { cheek: [S.side * 0.98, 0.5], front: [0, 0.2], above: [0.001, 1.5], inside: [-S.side * 2.1, 0.35] };
  eye.turn = views.cheek[0];
  let seen = "";

  const bone = (t) => {
    let k = 0;
    while (k + 1 < times.length && times[k + 1] <= t) k++;
    const next = Math.min(k + 1, times.length - 1), span = times[next] - times[k], w = span > 0 ? Math.min(Math.max((t - times[k]) / span, 0), 1) : 0;
    const a = k * shift.length, b = next * shift.length;
    for (let i = 0; i < shift.length; i++) shift[i] = S.unit * (frames[a + i] * (1 - w) + frames[b + i] * w);
    const apart = D.broken_s !== null && t >= D.broken_s ? +$("apart").value : 0;
    for (const m of parts) {
      const { rest, nodes, weights, positions, fragments } = m;
      for (let v = 0; v < fragments.length; v++) {
        const way = S.away[fragments[v]] || [0, 0, 0];
        let x = rest[3 * v] + apart * way[0], y = rest[3 * v + 1] + apart * way[1], z = rest[3 * v + 2] + apart * way[2];
        for (let j = 4 * v; j < 4 * v + 4; j++) { const s = weights[j] / 8192, n = 3 * nodes[j]; x += s * shift[n]; y += s * shift[n + 1]; z += s * shift[n + 2]; }
        positions[3 * v] = x; positions[3 * v + 1] = y; positions[3 * v + 2] = z;
      }
      settle(m);
    }
  };
  const hands = (t) => {
    for (const m of tools) {
      const n = m.path.n, s = Math.min(t / S.pose_step, n - 1), k = Math.max(Math.floor(s), 0);
      const [px, py, pz, x, y, z, w] = m.poses.subarray(7 * k, 7 * k + 7), { rest, positions } = m;
      for (let v = 0; v < rest.length; v += 3) {
        const a = rest[v], b = rest[v + 1], c = rest[v + 2], tx = 2 * (y * c - z * b), ty = 2 * (z * a - x * c), tz = 2 * (x * b - y * a);
        positions[v] = a + w * tx + y * tz - z * ty + px; positions[v + 1] = b + w * ty + z * tx - x * tz + py; positions[v + 2] = c + w * tz + x * ty - y * tx + pz;
      }
      settle(m);
      m.path.shown = k + 1;
    }
  };
  const paint = () => {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    gl.viewport(0, 0, w, h);
    gl.clearColor(0.075, 0.098, 0.125, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const r = S.radius, far = r * eye.away * Math.max(1, 1.5 * h / w), to = S.target.map((c, i) => c + eye.aside[i]);
    const from = [to[0] + far * Math.cos(eye.tilt) * Math.sin(eye.turn), to[1] - far * Math.cos(eye.tilt) * Math.cos(eye.turn), to[2] + far * Math.sin(eye.tilt)];
    gl.uniformMatrix4fv(where("view"), false, V.look(from, to, [0, 0, 1]));
    gl.uniformMatrix4fv(where("lens"), false, V.perspective(0.45, w / h, 0.1 * r, far + 12 * r));
    const see = $("transparent").checked;
    const how = (alpha, flatness, gloss) => { gl.uniform1f(where("alpha"), alpha); gl.uniform1f(where("flatness"), flatness); gl.uniform1f(where("gloss"), gloss); };
    gl.uniform1f(where("time"), now);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.depthMask(true);
    for (const m of parts) {
      if (m.kind === "bone" && see) continue;
      if ((m.kind === "crack" || m.kind === "canal") && !see) continue;
      if ((m.kind === "broken" || m.kind === "sawn") && see) continue;
      how(1, m.kind === "crack" || m.kind === "canal" ? 0.45 : 0, m.kind === "teeth" ? 0.5 : 0.12);
      put(m);
    }
    how(1, 0, 0.6);
    tools.forEach((m) => put(m));
    if ($("paths").checked) { how(1, 1, 0); gl.disable(gl.DEPTH_TEST); tools.forEach((m) => { put(m.path, gl.LINE_STRIP); put(m.path, gl.POINTS); }); gl.enable(gl.DEPTH_TEST); }
    if (see) {
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      gl.depthMask(false);
      gl.enable(gl.CULL_FACE);
      how(0.17, 0, 0.1);
      for (const side of [gl.FRONT, gl.BACK]) { gl.cullFace(side); put(parts[0]); }
      gl.disable(gl.CULL_FACE);
      gl.depthMask(true);
    }
    $("view-time").textContent = at(now) + (D.broken_s !== null && now >= D.broken_s ? ", split" : "");
  };
  let asked = false;
  const ask = () => { if (!asked) { asked = true; requestAnimationFrame(() => { asked = false; refresh(); }); } };
  const refresh = () => { const key = now + " " + $("apart").value; if (key !== seen) { seen = key; bone(now); hands(now); } paint(); };
  listeners.push(ask);
  for (const id of ["transparent", "paths", "apart"]) $(id).addEventListener("input", () => { if (id === "apart" && D.broken_s !== null && now < D.broken_s) setTime(D.seconds); ask(); });
  for (const b of document.querySelectorAll("[data-view]")) b.onclick = () => { [eye.turn, eye.tilt] = views[b.dataset.view]; eye.aside = [0, 0, 0]; ask(); };

  const turn = (dx, dy) => { eye.turn -= dx; eye.tilt = Math.min(Math.max(eye.tilt + dy, -1.55), 1.55); ask(); };
  const zoom = (factor) => { eye.away = Math.min(Math.max(eye.away * factor, 0.6), 14); ask(); };
  const move = (dx, dy) => { const far = S.radius * eye.away, right = [Math.cos(eye.turn), Math.sin(eye.turn), 0]; eye.aside = eye.aside.map((c, i) => c - far * (dx * right[i] - (i === 2 ? dy : 0))); ask(); };
  const held = new Map();
  canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); held.set(e.pointerId, [e.clientX, e.clientY]); });
  for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (e) => held.delete(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    const before = held.get(e.pointerId);
    if (!before) return;
    const dx = (e.clientX - before[0]) / canvas.clientHeight, dy = (e.clientY - before[1]) / canvas.clientHeight;
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== e.pointerId)[1];
      const was = Math.hypot(before[0] - other[0], before[1] - other[1]), is = Math.hypot(e.clientX - other[0], e.clientY - other[1]);
      if (is > 0) zoom(was / is);
      move(0.25 * dx, 0.25 * dy);
    } else if (e.shiftKey || e.buttons === 2) move(0.45 * dx, 0.45 * dy); else turn(3.5 * dx, 3 * dy);
    held.set(e.pointerId, [e.clientX, e.clientY]);
  });
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(0.0012 * e.deltaY)); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const keys = { ArrowLeft: () => turn(0.12, 0), ArrowRight: () => turn(-0.12, 0), ArrowUp: () => turn(0, 0.12), ArrowDown: () => turn(0, -0.12), "+": () => zoom(0.88), "=": () => zoom(0.88), "-": () => zoom(1.14), Home: () => { Object.assign(eye, structuredClone(start)); [eye.turn, eye.tilt] = views.cheek; ask(); } };
    if (keys[e.key]) { keys[e.key](); e.preventDefault(); }
  });
  window.addEventListener("resize", ask);
  window.addEventListener("beforeprint", paint);

  const names = Object.entries(LOOKS).map(([k, l]) => [k, l.name, l.color]).filter(([k]) => S.parts.some((p) => p.kind === k));
  names[0][1] = S.away.length > 1 ? "largest fragment" : "bone";
  if (S.away.length > 1) names.splice(1, 0, ["", "other fragment", PIECES[1]]);
  names.push(["", "left tool", HANDS[0]], ["", "right tool", HANDS[1]]);
  for (const [, name, color] of names) { const li = make("li"), i = make("i"); i.style.background = `rgb(${color.map((c) => Math.round(255 * c)).join(",")})`; li.append(i, name); $("legend").append(li); }
  refresh();
}

viewer();
setTime(D.broken_s === null ? D.seconds : D.broken_s);
