// The page of `wimu dashboard`: takes topics and frames over a WebSocket, draws them, and sends what is asked.
"use strict";

const $ = (id) => document.getElementById(id);
// An element with properties or attributes, and its children.
const el = (tag, given = {}, ...children) => {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(given)) name in made && name !== "list" ? (made[name] = value) : made.setAttribute(name, value);
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
};
const text = (element, value) => { if (element.textContent !== value) element.textContent = value; };
const signed = (v, digits) => (v < 0 ? "−" : "+") + Math.abs(v).toFixed(digits);
const fixed = (v, digits) => v.toFixed(digits).replace("-", "−");
const significant = (v) => (v === 0 ? "0" : String(+v.toPrecision(3)).replace("-", "−"));
const minMax = (values, from, to) => {
  let low = from, high = from;
  for (let k = from + 1; k < to; k++) { if (values[k] < values[low]) low = k; if (values[k] > values[high]) high = k; }
  return low < high ? [values[low], values[high]] : [values[high], values[low]];
};

// ---- Messages

const server = {
  waiting: new Map(), next: 1, writes: false, dropped: 0,
  // The token comes after # and is kept by this tab alone.
  token() {
    if (location.hash.length > 1) {
      sessionStorage.setItem("token", location.hash.slice(1));
      history.replaceState(null, "", location.pathname);
    }
    return sessionStorage.getItem("token") || "";
  },
  open() {
    const socket = (this.socket = new WebSocket(`ws://${location.host}/socket`));
    socket.onopen = async () => {
      const { writes } = await this.ask({ do: "hello" });
      this.writes = writes;
      this.show(writes ? "connected" : "read only: open the address that wimu dashboard has printed", !writes);
      if (writes) this.ask({ do: "ports" }).then((ports) => $("ports").replaceChildren(...ports.map((value) => el("option", { value }))), () => {});
    };
    socket.onmessage = (event) => this.take(JSON.parse(event.data));
    socket.onclose = (event) => {
      for (const { fail } of this.waiting.values()) fail("the server has not answered");
      this.waiting.clear();
      if (event.code === 1008) return this.show("refused: the token is not that of this server; open the printed address", true);
      this.show("the server is gone: trying again", true);
      setTimeout(() => this.open(), 1000);
    };
  },
  show(what, bad) { text($("status"), what); $("status").className = bad ? "bad" : ""; },
  ask(what, board) {
    const id = this.next++;
    return new Promise((done, fail) => {
      if (this.socket.readyState !== 1) return fail("the server is gone");
      this.waiting.set(id, { done, fail });
      this.socket.send(JSON.stringify({ ...what, id, board, token: this.token() }));
    });
  },
  take(message) {
    if (message.t) return boards.get(message.board)?.frame(message);
    if (message.answer) {
      const { done, fail } = this.waiting.get(message.answer) || {};
      this.waiting.delete(message.answer);
      return "error" in message ? fail?.(message.error) : done?.(message.value);
    }
    if (message.dropped) { this.dropped = message.dropped; return; }
    if (message.gone) return forget(message.gone);
    const [kind, ...rest] = message.topic.split("/");
    if (kind === "board") return board(+rest[0]).topic(rest[1], message.value);
    topics[kind]?.(message.value, rest.join("/"));
  },
};
// A notice, which goes away by itself or with a click.
let notice = 0;
const say = (what, bad = false) => {
  text($("message"), what);
  $("message").className = bad ? "bad" : "";
  clearTimeout(notice);
  if (what) notice = setTimeout(() => say(""), bad ? 20000 : 8000);
};
// Asks, and shows what went wrong.
const request = (what, board) => server.ask(what, board).catch((error) => { say(error, true); throw error; });
const act = (what, board) => request(what, board).then((value) => { if (typeof value === "string") say(value); return value; }, () => {});

const boards = new Map(), files = new Map(), links = new Map();
let listed = [], paused = false, opened = "";

const topics = {
  about: (about) => { document.title = `wimu dashboard ${about.version}`; topics.folder = about.folder; },
  files: (list) => {
    listed = list;
    $("tables").replaceChildren(...list.filter((file) => /\.csv$/i.test(file.name)).map((file) => el("option", { value: file.name })));
    drawView(true);
  },
  link: (link, name) => { links.set(name, link); drawView(true); },
  file: (file, name) => {
    if (!files.has(name)) opened = name;
    files.set(name, file);
    if (!boards.size && !links.size && view === "live") choose("files");
    drawView(true);
  },
};

function board(index) {
  if (!boards.has(index)) { boards.set(index, new Board(index)); drawView(true); }
  return boards.get(index);
}

function forget(prefix) {
  const [kind, name] = [prefix.split("/")[0], prefix.split("/").slice(1).join("/")];
  if (kind === "board") { boards.get(parseInt(name))?.remove(); boards.delete(parseInt(name)); }
  if (kind === "link") links.delete(name);
  drawView(true);
}

// ---- Samples

// The latest samples, in columns.
class Ring {
  static SIZE = 1 << 16;
  constructor() { this.clear(); }
  clear() { this.t = new Float64Array(Ring.SIZE); this.v = []; this.count = 0; }
  at(k) { return this.t[k % Ring.SIZE]; }
  last() { return this.count ? this.at(this.count - 1) : 0; }
  push(t, v) {
    const from = this.count ? t.findIndex((one) => one > this.last()) : 0;
    if (from < 0) return;
    while (this.v.length < v.length) this.v.push(new Float32Array(Ring.SIZE));
    for (let k = from; k < t.length; k++, this.count++) {
      this.t[this.count % Ring.SIZE] = t[k];
      v.forEach((values, channel) => (this.v[channel][this.count % Ring.SIZE] = values[k]));
    }
  }
  // Index of the first sample from a time on.
  find(time) {
    let low = Math.max(0, this.count - Ring.SIZE), high = this.count;
    while (low < high) { const k = (low + high) >> 1; this.at(k) < time ? (low = k + 1) : (high = k); }
    return low;
  }
  // Some channels between two times in about `most` points, with their extremes, and breaks where samples are missing.
  window(from, to, channels, most) {
    const first = Math.max(this.find(from) - 1, this.count - Ring.SIZE, 0), end = Math.min(this.find(to) + 1, this.count);
    const every = Math.max(1, Math.ceil((end - first) / (most / 2)));
    const x = [], y = channels.map(() => []);
    const usual = (this.at(end - 1) - this.at(first)) / Math.max(end - 1 - first, 1);
    const plain = channels.map((channel) => this.v[channel]);
    for (let k = first; k < end; k += every) {
      const last = Math.min(k + every, end) - 1, t = this.at(k);
      if (x.length && t - x[x.length - 1] > 3 * usual) { x.push(NaN); y.forEach((column) => column.push(NaN)); }
      if (every === 1) { x.push(t); y.forEach((column, c) => column.push(plain[c][k % Ring.SIZE])); continue; }
      x.push(t, this.at(last));
      y.forEach((column, c) => {
        let pair;
        if (k % Ring.SIZE <= last % Ring.SIZE) pair = minMax(plain[c], k % Ring.SIZE, (last % Ring.SIZE) + 1);
        else pair = [plain[c][k % Ring.SIZE], plain[c][last % Ring.SIZE]];
        column.push(...pair);
      });
    }
    return { x, y };
  }
}

// ---- Boards

class Board {
  constructor(index) {
    Object.assign(this, { index, ring: new Ring(), cards: {}, state: null, guided: null, parameters: null, path: null, noise: null, at: 0 });
  }
  topic(name, value) {
    const before = this.state;
    this[name] = value;
    if (name === "state") {
      if (value.message && value.message !== before?.message) say(value.message, value.message.startsWith("not "));
      if (!before) drawView(true);
    }
    this.changed = true;
    drawView();
  }
  frame(message) {
    if (message.restarted) this.ring.clear();
    this.ring.push(message.t, message.v);
    if (message.q) this.q = message.q;
    if (message.up) this.up = this.up && !message.whole ? this.up.map((v, k) => v + 0.3 * (message.up[k] - v)) : message.up;
    if (!message.whole) this.at = message.at_ms;
    this.fresh = true;
    drawView();
  }
  ask(what) { return act(what, this.index); }
  remove() { for (const card of Object.values(this.cards)) card.remove(); }
}

// Times from arrival to picture, ms: the latest 300.
const latencies = [];

// ---- Drawings of a board

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (v) => { const n = Math.hypot(...v); return n > 1e-9 ? v.map((x) => x / n) : [0, 0, 1]; };
const degrees = (a, b) => (Math.atan2(Math.hypot(...cross(a, b)), dot(a, b)) * 180) / Math.PI;
// Rotates from body axes to axes with z up, by the shortest rotation that raises `up`.
const raised = (v, up) => {
  const cosine = up[2];
  if (cosine < -0.999999) return [v[0], -v[1], -v[2]];
  const axis = [up[1], -up[0], 0], a = cross(axis, v), b = cross(axis, a);
  return v.map((x, k) => x + a[k] + b[k] / (1 + cosine));
};
const turned = ([w, x, y, z], v) => {
  const a = cross([x, y, z], v), b = cross([x, y, z], a);
  return v.map((one, k) => one + 2 * (w * a[k] + b[k]));
};
// Where a viewer at −35° azimuth and 25° elevation sees a point, and how near it is.
const seen = ([x, y, z]) => {
  const [ca, sa, ce, se] = [Math.cos(-0.611), Math.sin(-0.611), Math.cos(0.436), Math.sin(0.436)];
  const right = x * ca - y * sa, away = x * sa + y * ca;
  return [right, z * ce + away * se, z * se - away * ce];
};

function canvasOf(canvas) {
  const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio)) canvas.width = Math.round(w * ratio);
  if (canvas.height !== Math.round(h * ratio)) canvas.height = Math.round(h * ratio);
  const g = canvas.getContext("2d"), style = getComputedStyle(canvas);
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, w, h);
  g.font = "600 12px system-ui, sans-serif";
  g.lineJoin = g.lineCap = "round";
  return { g, colour: (name) => style.getPropertyValue("--" + name).trim(), w, h };
}

// A board of which `place` gives where a point of its body is in the room, with the names of its X, Y and Z sides.
function drawBody(canvas, place, names = ["X", "Y", "Z"]) {
  const { g, colour, w, h } = canvasOf(canvas), scale = Math.min(w, h) / 2.7;
  if (w < 200) names = ["X", "Y", "Z"];
  const at = (v) => { const [x, y, near] = seen(place(v)); return [w / 2 + scale * x, h / 2 - scale * y, near]; };
  const half = [0.75, 0.5, 0.07];
  // The floor below it.
  g.strokeStyle = colour("line");
  g.beginPath();
  for (let k = 0; k <= 60; k++) { const a = (k / 60) * 2 * Math.PI, [x, y] = seen([Math.cos(a), Math.sin(a), -0.85]); g.lineTo(w / 2 + scale * x, h / 2 - scale * y); }
  g.stroke();
  const faces = [];
  for (let axis = 0; axis < 3; axis++) for (const side of [1, -1]) {
    const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
    const corners = [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([a, b]) => { const p = [0, 0, 0]; p[axis] = side * half[axis]; p[u] = a * half[u]; p[v] = b * half[v]; return at(p); });
    const normal = [0, 0, 0];
    normal[axis] = side;
    const room = place(normal);
    faces.push({ corners, faces: seen(room)[2], light: 0.5 + 0.5 * room[2], top: axis === 2 && side === 1 });
  }
  const arrow = (axis, front) => {
    const tip = [0, 0, 0], base = [0, 0, 0], word = [0, 0, 0];
    tip[axis] = 1.05; base[axis] = half[axis]; word[axis] = 1.2;
    const [from, to, label] = [at(base), at(tip), at(word)];
    if (to[2] > from[2] !== front) return;
    g.strokeStyle = g.fillStyle = colour("c" + axis);
    g.lineWidth = 2.5;
    g.beginPath(); g.moveTo(from[0], from[1]); g.lineTo(to[0], to[1]); g.stroke();
    g.textAlign = label[0] < w / 2 - 8 ? "right" : label[0] > w / 2 + 8 ? "left" : "center";
    g.textBaseline = "middle";
    const room = g.measureText(names[axis]).width + 2;
    g.fillText(names[axis], g.textAlign === "right" ? Math.max(label[0], room) : g.textAlign === "left" ? Math.min(label[0], w - room) : label[0], label[1]);
  };
  for (let axis = 0; axis < 3; axis++) arrow(axis, false);
  g.lineWidth = 1.2;
  for (const face of faces.filter((face) => face.faces > 0)) {
    g.beginPath();
    face.corners.forEach(([x, y]) => g.lineTo(x, y));
    g.closePath();
    g.fillStyle = colour(face.top ? "c1" : "guide");
    g.globalAlpha = 0.35 + 0.5 * face.light;
    g.fill();
    g.globalAlpha = 1;
    g.strokeStyle = colour("ink");
    g.stroke();
  }
  for (let axis = 0; axis < 3; axis++) arrow(axis, true);
}

// The directions of captured poses on a sphere, the next one and the present one.
function drawSphere(canvas, poses, up, next) {
  const { g, colour, w, h } = canvasOf(canvas), scale = Math.min(w, h) / 2.35;
  const at = (v) => { const [x, y, near] = seen(v); return [w / 2 + scale * x, h / 2 - scale * y, near]; };
  g.fillStyle = colour("mark");
  g.strokeStyle = colour("soft");
  g.lineWidth = 0.6;
  g.beginPath(); g.arc(w / 2, h / 2, scale, 0, 7); g.fill(); g.stroke();
  for (const circle of [(a) => [Math.cos(a), Math.sin(a), 0], (a) => [0, Math.cos(a), Math.sin(a)], (a) => [Math.cos(a), 0, Math.sin(a)]]) {
    g.beginPath();
    let pen = false;
    for (let k = 0; k <= 72; k++) { const [x, y, near] = at(circle((k / 36) * Math.PI)); near > 0 && pen ? g.lineTo(x, y) : g.moveTo(x, y); pen = near > 0; }
    g.stroke();
  }
  const disc = (v, radius, name, ring) => {
    const [x, y, near] = at(v);
    g.globalAlpha = near > 0 ? 1 : 0.35;
    g.fillStyle = g.strokeStyle = colour(name);
    g.lineWidth = 2.5;
    g.beginPath(); g.arc(x, y, radius, 0, 7); ring ? g.stroke() : g.fill();
    g.globalAlpha = 1;
  };
  for (const pose of poses) disc(pose, 5, "c2");
  if (next) disc(next, 8, "c0", true);
  if (up) disc(up, 4, "c1");
}

// ---- Plots

// A plot with buttons that save it as a picture and as a table.
function plotIn(parent, chart) {
  const figure = parent.appendChild(el("figure"));
  const plot = new WimuPlot(figure, chart);
  const save = (name, blob) => {
    const link = el("a", { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  };
  const name = () => plot.chart.title.replace(/[^\w]+/g, "-").toLowerCase() || "plot";
  const table = () => {
    const { series, x, y, z } = plot.chart;
    const rows = series.flatMap((one) => Array.from(one.x, (v, k) => [one.name, v, one.y[k], ...(z ? [one.z[k]] : [])].join(",")));
    return new Blob([[`series,"${x}","${y}"${z ? `,"${z}"` : ""}`, ...rows].join("\n")], { type: "text/csv" });
  };
  figure.append(el("div", { className: "save" },
    el("button", { textContent: "PNG", title: "Save the picture", ariaLabel: "Save the picture", onclick: () => plot.canvas.toBlob((blob) => save(name() + ".png", blob)) }),
    el("button", { textContent: "CSV", title: "Save the values", ariaLabel: "Save the values", onclick: () => save(name() + ".csv", table()) })));
  return plot;
}

// ---- Spectrum

// The discrete Fourier transform in place, of a power of two.
function fourier(re, im) {
  const n = re.length;
  for (let k = 1, j = 0; k < n; k++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (k < j) { [re[k], re[j]] = [re[j], re[k]]; [im[k], im[j]] = [im[j], im[k]]; }
  }
  for (let size = 2; size <= n; size *= 2) for (let start = 0; start < n; start += size) for (let k = 0; k < size / 2; k++) {
    const angle = (-2 * Math.PI * k) / size, [c, s] = [Math.cos(angle), Math.sin(angle)], a = start + k, b = a + size / 2;
    const [x, y] = [c * re[b] - s * im[b], c * im[b] + s * re[b]];
    [re[b], im[b], re[a], im[a]] = [re[a] - x, im[a] - y, re[a] + x, im[a] + y];
  }
}

// Amplitude spectral density of the latest samples of a channel: Welch's mean over Hann windows that overlap by half; none across
// a gap. Null where there are too few.
function spectrum(ring, channel) {
  const from = Math.max(0, ring.count - 8192), all = ring.count - from;
  const period = all > 1 ? (ring.last() - ring.at(from)) / (all - 1) : 0, n = 2 ** Math.floor(Math.log2(Math.min(1024, all / 2)));
  if (n < 64 || !(period > 0)) return null;
  const sum = new Float64Array(n / 2);
  let windows = 0;
  for (let start = ring.count - n; start >= from; start -= n / 2) {
    if (Math.abs(ring.at(start + n - 1) - ring.at(start) - (n - 1) * period) > 2 * period) continue;
    const re = Float64Array.from({ length: n }, (_, k) => ring.v[channel][(start + k) % Ring.SIZE]), im = new Float64Array(n);
    const mean = re.reduce((a, b) => a + b) / n;
    re.forEach((v, k) => (re[k] = (v - mean) * (0.5 - 0.5 * Math.cos((2 * Math.PI * k) / n))));
    fourier(re, im);
    for (let k = 0; k < n / 2; k++) sum[k] += re[k] ** 2 + im[k] ** 2;
    windows++;
  }
  // The mean square of the window is 3/8; both halves of the spectrum are in one.
  const density = (k) => Math.sqrt((sum[k] * 2 * period) / (0.375 * n * windows)), bins = [...sum.keys()].slice(1);
  return windows ? { x: bins.map((k) => k / (n * period)), y: bins.map(density), rate: 1 / period, seconds: period * all } : null;
}

// ---- Views. Each makes the card of a board, whose `draw` brings it up to date.

const head = (board) => {
  const name = el("h2"), about = el("small"), badges = el("span");
  const draw = () => {
    const state = board.state;
    if (!state) return;
    text(name, state.device);
    text(about, state.replay ? state.source : `${state.id}  ${state.source}`);
    const lost = state.links.filter((link) => link.lost);
    const list = [
      lost.length === state.links.length && lost.length ? ["link lost", "bad"] : lost.length ? [`${lost[0].name} lost`, "bad"] : null,
      state.recording ? ["recording", "bad"] : null,
      state.replay ? [state.replay.over ? "replay, at its end" : "replay", ""] : null,
      board.parameters ? (board.parameters.calibrated ? [`calibrated ${board.parameters.id}`, "good"] : ["uncalibrated", ""]) : null,
    ].filter(Boolean);
    const key = JSON.stringify(list);
    if (badges.key !== key) badges.replaceChildren(...list.flatMap(([what, kind]) => [el("span", { className: "badge " + kind, textContent: what }), " "]));
    badges.key = key;
  };
  return { element: el("div", { className: "head" }, name, about, badges), draw };
};

const spans = [5, 10, 30, 60, 300];
let span = 10;

function liveCard(board) {
  const top = head(board), figures = el("dl", { className: "figures" }), plots = el("div");
  const record = el("button", { textContent: "Record", onclick: () => board.ask({ do: "record" }) });
  const choose = el("select", { ariaLabel: "Time shown", onchange: () => { span = +choose.value; drawView(); } },
    ...spans.map((s) => el("option", { value: s, textContent: `${s} s`, selected: s === span })));
  const replay = el("div", { className: "row" });
  const close = el("button", { textContent: "Close", title: "Disconnect this board", onclick: () => board.ask({ do: "close" }) });
  const force = plotIn(plots, { title: "Specific force", x: "time, s", y: "m/s²", series: [] });
  const channels = ["X", "Y", "Z", "|f|", "ω X", "ω Y", "ω Z"];
  const of = el("select", { ariaLabel: "Spectrum of", onchange: () => { vibration?.figure.remove(); vibration = null; drawView(true); } });
  let rate = null, vibration = null, computed = 0, shownReplay = false;
  const drawSpectrum = () => {
    const now = performance.now(), k = +of.value, found = of.value !== "" && now - computed > 500 ? spectrum(board.ring, k) : null;
    if (!found) return;
    computed = now;
    const chart = { title: `Spectrum of ${channels[k]}, latest ${Math.round(found.seconds)} s at ${Math.round(found.rate)} Hz`, x: "frequency, Hz", y: k < 4 ? "m/s²/√Hz" : "rad/s/√Hz", logY: true, series: [{ name: channels[k], style: "line", ...found }] };
    vibration ??= plotIn(plots, chart);
    vibration.set(chart);
  };
  const curves = (plot, title, unit, channels, names) => {
    const [from, to] = plot.chart.rangeX && plot.zoomed() ? plot.view.x : [board.ring.last() - span, board.ring.last()];
    const { x, y } = board.ring.window(from, to, channels, 2 * Math.max(plot.canvas.clientWidth, 300));
    const last = board.ring.last();
    plot.set({ title, x: "time, s", y: unit, rangeX: [last - span, last], series: names.map((name, k) => ({ name, style: "line", x, y: y[k] })) });
  };
  const cells = new Map();
  const cell = (name, value) => {
    if (!cells.has(name)) { const dd = el("dd"); cells.set(name, dd); figures.append(el("div", { className: /x, y, z|state/.test(name) ? "wide" : "" }, el("dt", { textContent: name }), dd)); }
    text(cells.get(name), value);
  };
  const draw = () => {
    top.draw();
    const { state, ring } = board, line = state?.line;
    if (!state) return;
    record.hidden = !!state.replay;
    text(record, state.recording ? "Stop recording" : "Record");
    record.setAttribute("aria-pressed", !!state.recording);
    if (state.replay && !shownReplay) { shownReplay = true; replay.append(...replayControls(board)); }
    replay.draw?.();
    if (line) {
      const f = line.specific_force_m_s2;
      cell("|f|, m/s²", fixed(Math.hypot(...f), 3));
      cell("f x, y, z, m/s²", f.map((v) => signed(v, 2)).join("  "));
      if (line.angular_rate_rad_s) cell("ω x, y, z, rad/s", line.angular_rate_rad_s.map((v) => signed(v, 2)).join("  "));
      if (state.force_sd_m_s2) cell("± of f, mm/s²", significant(state.force_sd_m_s2 * 1e3));
      if (line.temperature_c !== null) cell("temperature, °C", fixed(line.temperature_c, 1));
      if (line.heading_deg !== null) cell("heading, °", fixed(line.heading_deg, 0) + (line.heading_sd_deg ? ` ± ${fixed(line.heading_sd_deg, 0)}` : " uncal."));
      if (line.phase) cell("state", line.phase + (line.valid ? "" : ", not valid"));
    }
    if (!paused && ring.count && ring.v.length) {
      curves(force, board.parameters?.calibrated && line?.corrected ? "Specific force, corrected" : "Specific force", "m/s²", [0, 1, 2, 3], ["X", "Y", "Z", "|f|"]);
      if (ring.v.length > 4) {
        rate ??= plotIn(plots, { title: "Angular rate", x: "time, s", y: "rad/s", series: [] });
        curves(rate, "Angular rate", "rad/s", [4, 5, 6], ["X", "Y", "Z"]);
      }
      if (of.options.length !== ring.v.length + 1) of.replaceChildren(el("option", { value: "", textContent: "none" }), ...channels.slice(0, ring.v.length).map((name, k) => el("option", { value: k, textContent: name })));
      drawSpectrum();
      if (board.fresh && board.at) {
        latencies.push(performance.timeOrigin + performance.now() - board.at);
        if (latencies.length > 300) latencies.shift();
      }
      board.fresh = false;
    }
  };
  return { element: el("article", {}, top.element, figures, el("div", { className: "row" }, el("label", {}, "Time shown", choose), el("label", {}, "Spectrum", of), record, close), replay, plots), draw };
}

function replayControls(board) {
  const pause = el("button", { onclick: () => board.ask({ do: "pause" }) });
  const speed = el("select", { ariaLabel: "Speed", onchange: () => board.ask({ do: "speed", value: +speed.value }) },
    ...[0.1, 0.5, 1, 2, 5, 10, 50].map((s) => el("option", { value: s, textContent: `× ${s}`, selected: s === 1 })));
  const seek = el("input", { type: "range", min: 0, max: 1, step: 0.1, ariaLabel: "Time of the recording", onchange: () => board.ask({ do: "seek", value: +seek.value }) });
  const at = el("span", { className: "soft" });
  const row = el("span", { className: "row" }, pause, speed, seek, at);
  const draw = () => {
    const { position_s, paused, over } = board.state.replay;
    text(pause, paused ? "Play" : "Pause");
    const whole = Math.max(files.get(board.state.source)?.duration_s || 0, position_s);
    seek.max = whole;
    if (document.activeElement !== seek || !seek.matches(":active")) seek.value = position_s;
    text(at, `${position_s.toFixed(1)} of ${whole.toFixed(1)} s${over ? ", end" : ""}`);
  };
  setInterval(() => row.isConnected && draw(), 200);
  return [row];
}

function spaceCard(board) {
  const top = head(board), canvas = el("canvas", { role: "img" }), attitude = el("p", { className: "soft" }), figures = el("p");
  const option = (list) => list.map(([value, textContent]) => el("option", { value, textContent }));
  const profile = el("select", { ariaLabel: "Motion profile" }, ...option([["hand", "hand"], ["foot", "foot"], ["vehicle", "vehicle"], ["free", "no assumption"]]));
  const from = (name, title) => el("input", { ariaLabel: name, placeholder: title, list: "tables", size: 16 });
  const [fixes, ranges, anchors] = [from("Fixes", "fixes: file or LINK"), from("Ranges", "ranges: file or LINK"), from("Anchors", "anchors: file")];
  const begin = () => board.ask({ do: "navigate", profile: profile.value, fixes: fixes.value, ranges: ranges.value, anchors: anchors.value });
  const start = el("button", { className: "main", onclick: () => (board.state.navigating ? board.ask({ do: "end_navigation" }) : begin()) });
  const zero = el("button", { textContent: "Zero here", onclick: () => board.ask({ do: "zero" }) });
  const paths = el("div"), hint = el("p", { className: "soft", textContent: "No path yet: the position begins at the first rest." });
  let plot = null, shown = null;
  const draw = () => {
    top.draw();
    const { state, q, up } = board;
    if (!state) return;
    if (q) drawBody(canvas, (v) => turned(q, v));
    else if (up) { const u = unit(up); drawBody(canvas, (v) => raised(v, u)); }
    const angles = q ? euler(q).map((a) => signed(a, 0) + "°") : null;
    const label = angles ? `roll ${angles[0]}, pitch ${angles[1]}, yaw ${angles[2]}; W ${q.map((v) => signed(v, 3)).join("  ").replace(/  /, " X ").replace(/  /, " Y ").replace(/  /, " Z ")}` : up ? `tilt ${fixed(degrees(unit(up), [0, 0, 1]), 0)}° (from gravity; heading is not known)` : "";
    text(attitude, label);
    canvas.setAttribute("aria-label", "the board: " + label);
    const n = state.navigated;
    text(start, state.navigating ? "End navigation" : "Navigate");
    const p = n?.position_m || state.line?.position_m;
    const aid = ([name, a]) => (a.used + a.rejected + a.late ? `; ${name}: ${a.used} used, ${a.rejected + a.late} not` : "");
    text(figures, p ? `position E ${signed(p[0], 2)}  N ${signed(p[1], 2)}  U ${signed(p[2], 2)} m` + (n
      ? ` ± ${significant(Math.hypot(...n.sigma_m))} m, ${n.resting ? "at rest" : fixed(n.speed_m_s, 2) + " m/s"}${n.valid ? "" : ", not valid"}${Object.entries(n.aids).map(aid).join("")}`
      : `, as the device computes it${state.line.valid ? "" : ", not valid"}, without σ; Navigate computes it here, with σ`) : state.navigating ? "the first position needs three seconds" : "");
    hint.hidden = !!board.path;
    if (board.path && board.path !== shown) {
      shown = board.path;
      plot ??= plotIn(paths, board.path);
      plot.set(board.path);
    }
  };
  return { element: el("article", {}, top.element, el("div", { className: "body" }, el("figure", {}, canvas), attitude), figures,
    el("div", { className: "row" }, el("label", {}, "Motion", profile), fixes, ranges, anchors, start, zero), hint, paths), draw };
}

// Roll, pitch and yaw, degrees.
const euler = ([w, x, y, z]) => [
  Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), Math.asin(Math.max(-1, Math.min(1, 2 * (w * y - x * z)))), Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
].map((a) => (a * 180) / Math.PI);

function noiseCard(board) {
  const top = head(board), words = el("p", { className: "soft", textContent: "Keep the board at rest: the curve grows to longer averaging times with every second." });
  const start = el("button", { className: "main", onclick: () => board.ask({ do: board.state.measuring ? "end_noise" : "noise" }) });
  const again = el("button", { textContent: "Start again", onclick: () => board.ask({ do: "noise" }) });
  const plots = el("div");
  let plot = null, shown = null;
  const draw = () => {
    top.draw();
    if (!board.state) return;
    text(start, board.state.measuring ? "Stop" : "Measure the noise");
    again.hidden = !board.state.measuring;
    if (board.noise && board.noise !== shown) {
      shown = board.noise;
      text(words, shown.text);
      if (shown.chart?.series[0].x.length) { plot ??= plotIn(plots, shown.chart); plot.set(shown.chart); }
    }
  };
  return { element: el("article", {}, top.element, el("div", { className: "row" }, start, again), words, plots), draw };
}

function table(headings) {
  const body = el("tbody");
  const element = el("div", { className: "table" }, el("table", {}, el("thead", {}, el("tr", {}, ...headings.map((h) => el("th", { textContent: h, scope: "col" })))), body));
  const rows = (list) => {
    const key = JSON.stringify(list);
    if (body.key === key) return;
    body.key = key;
    body.replaceChildren(...list.map((cells) => el("tr", {}, ...cells.map((cell) => el("td", { textContent: cell })))));
  };
  return { element, rows };
}

function linksCard(board) {
  const top = head(board), shown = table(["", "rate, Hz", "loss, %", "latency, ms", "largest", "kB/s", "damaged"]), note = el("p", { className: "soft" });
  const draw = () => {
    top.draw();
    if (!board.state) return;
    const ms = (v) => (v ? v.map((one) => fixed(one, 0)) : ["–", "–"]);
    shown.rows(board.state.links.map((link) => [link.lost ? `${link.name}: lost (${link.lost})` : link.name, significant(link.rate_hz), significant(100 * link.loss), ...ms(link.latency_ms), significant(link.kilobytes_s), String(link.frames_damaged)]));
    const sorted = [...latencies].sort((a, b) => a - b);
    text(note, sorted.length ? `This page: ${fixed(sorted[sorted.length >> 1], 0)} ms from arrival to picture, at most ${fixed(sorted[sorted.length - 1], 0)} ms; frames left out: ${server.dropped}.` : "");
  };
  return { element: el("article", {}, top.element, shown.element, note), draw };
}

function calibrateCard(board) {
  const top = head(board), idle = el("div"), poses = el("div"), result = el("div");
  const button = (what, label, main) => el("button", { textContent: label, className: main ? "main" : "", onclick: () => board.ask({ do: what }) });
  idle.append(
    el("p", { textContent: "A calibration needs a dozen poses: the board held still in different orientations. The page shows which one is next; any other serves as well." }),
    el("div", { className: "row" }, el("button", { textContent: "Calibrate", className: "main", onclick: () => board.ask({ do: "calibrate" }) }),
      el("button", { textContent: "With each of six sides up", onclick: () => board.ask({ do: "calibrate", six: true }) })));
  const picture = (caption) => { const canvas = el("canvas", { role: "img", ariaLabel: caption }); return [canvas, el("figure", {}, el("h3", { textContent: caption }), canvas)]; };
  const [[next, nextFigure], [now, nowFigure], [sphere, sphereFigure]] = ["next: hold it like this", "now", "poses: green, next: ring, now: blue"].map(picture);
  const count = el("h3"), instruction = el("p", { className: "instruction" }), message = el("p", { className: "soft", ariaLive: "polite" });
  const bar = (name) => { const progress = el("progress", { max: 1, ariaLabel: name }), words = el("span"); return { progress, words, element: el("div", { className: "bar" }, progress, words) }; };
  const [tilt, hold] = [bar("Tilt towards the next pose"), bar("Time at rest")];
  const sd = table(["standard deviation", "X", "Y", "Z"]), fit = el("p", { className: "soft" });
  const course = el("div");
  let plot = null, drawn = "";
  poses.append(el("div", { className: "pictures" }, nextFigure, nowFigure, sphereFigure), count, instruction, tilt.element, hold.element, message,
    el("div", { className: "row" }, button("undo", "Undo"), button("skip", "Skip"), button("finish", "Finish now"), button("end_calibration", "Stop, keep the poses")),
    sd.element, fit, course);
  const words = el("pre"), verdict = el("p", { className: "instruction", ariaLive: "polite" }), told = el("p", { className: "soft", ariaLive: "polite" });
  const push = button("push", "Push to the board", true), write = button("write_file", "Write a file"), more = button("more", "More poses");
  result.append(verdict, told, el("div", { className: "row" }, push, write, more, button("end_calibration", "Done")), words);
  const draw = () => {
    top.draw();
    const view = board.guided;
    idle.hidden = !!view;
    poses.hidden = !view || view.result !== null;
    result.hidden = !view || view.result === null;
    if (!view) return;
    if (view.result !== null) {
      text(verdict, !view.usable ? "No calibration yet: capture more poses." : view.pushed ? "Calibrated and pushed: the board corrects its samples now." : "Calibrated. Push it to the board, or write a file.");
      text(told, view.message);
      text(words, view.result);
      text(push, view.pushed ? "Push again" : "Push to the board");
      push.disabled = write.disabled = !view.usable;
      return;
    }
    const names = [0, 2, 4].map((k) => view.sides[k].replace(/^\+(.) side$/, "$1"));
    if (view.next) {
      drawBody(next, (v) => raised(v, view.next), names);
      if (view.up) { const vertical = raised(view.up, view.next); drawBody(now, (v) => raised(raised(v, view.next), vertical), names); }
    } else if (view.up) drawBody(now, (v) => raised(v, view.up), names);
    drawSphere(sphere, view.poses, view.up, view.next);
    sphere.setAttribute("aria-label", `${view.poses.length} poses captured; green: captured, ring: next, blue: now`);
    text(count, `${view.poses.length} of ${view.wanted} poses captured`);
    text(instruction, view.instruction);
    text(message, view.lost ? `link lost (${view.lost}): poses are kept` : view.message);
    if (view.up && view.next) {
      const angle = degrees(view.up, view.next);
      tilt.progress.value = 1 - angle / 180;
      const missing = view.next.map((v, k) => v - dot(view.up, view.next) * view.up[k]);
      const axis = [0, 1, 2].reduce((a, b) => (Math.abs(missing[b]) > Math.abs(missing[a]) ? b : a));
      text(tilt.words, angle <= 10 ? `${fixed(angle, 0)}° from it: reached` : `${fixed(angle, 0)}° from it: raise its ${view.sides[2 * axis + (missing[axis] < 0)]}`);
    }
    const held = view.hold.holding;
    hold.progress.value = held ? held[0] / held[1] : view.hold === "captured" ? 1 : 0;
    text(hold.words, held ? `still: ${fixed(Math.max(held[1] - held[0], 0), 1)} s more` : { waiting: "waiting for samples", moving: "moving: hold it still", captured: "captured: rotate it to the next orientation" }[view.hold]);
    const latest = view.uncertainty.at(-1);
    if (!latest) return;
    sd.rows([["bias, mg", ...latest.bias_mps2.map((v) => "± " + significant((v * 1e3) / 9.80665))], ["scale factor, %", ...latest.scale.map((v) => "± " + significant(v * 100))]]);
    text(fit, latest.no_fit ? `expected of these poses; no fit yet: ${latest.no_fit}` : "of the fit so far");
    const key = JSON.stringify(view.uncertainty);
    if (key === drawn || view.uncertainty.length < 2) return;
    drawn = key;
    const line = (name, of) => ({ name, style: "line", x: view.uncertainty.map((_, k) => k), y: view.uncertainty.map((u) => Math.max(...of(u))) });
    const chart = { title: "Largest standard deviation", x: "poses", y: "mg, %", logY: true, series: [line("bias, mg", (u) => u.bias_mps2.map((v) => (v * 1e3) / 9.80665)), line("scale factor, %", (u) => u.scale.map((v) => v * 100))] };
    plot ??= plotIn(course, chart);
    plot.set(chart);
  };
  return { element: el("article", {}, top.element, idle, poses, result), draw };
}

function parametersCard(board) {
  const top = head(board), held = table(["parameter", "value"]), remarks = el("p", { className: "soft" });
  const choose = el("select", { ariaLabel: "Calibration file" }), change = table(["changes", "board", "file"]), verdict = el("p");
  const compare = el("button", { textContent: "Show the difference", onclick: async () => {
    const found = await board.ask({ do: "difference", file: choose.value });
    if (!found) return;
    text(verdict, [found.result, ...found.notes].join("; "));
    change.element.hidden = !found.changed.length;
    change.rows(found.changed);
    push.disabled = false;
  } });
  const push = el("button", { textContent: "Push to the board", className: "main", disabled: true, onclick: () => board.ask({ do: "push_file", file: choose.value }) });
  choose.onchange = () => { push.disabled = true; text(verdict, ""); change.element.hidden = true; };
  change.element.hidden = true;
  const draw = () => {
    top.draw();
    const names = listed.map((file) => file.name).filter((name) => /\.json$/i.test(name));
    if (choose.key !== names.join()) { choose.key = names.join(); choose.replaceChildren(...names.map((name) => el("option", { textContent: name }))); choose.onchange(); }
    compare.disabled = !names.length;
    const p = board.parameters;
    if (!p) return;
    held.rows(p.calibrated ? p.rows : [["the board is uncalibrated", ""]]);
    text(remarks, p.remarks.join(" · "));
  };
  return { element: el("article", {}, top.element, held.element, remarks, el("h3", { textContent: "Another calibration" }),
    el("div", { className: "row" }, choose, compare, push), verdict, change.element), draw };
}

function settingsCard(board) {
  const top = head(board), form = el("div", { className: "settings" }), result = el("p", { className: "soft", ariaLive: "polite" });
  const number = (name) => el("input", { type: "number", min: 1, ariaLabel: name, size: 6 });
  const option = (name, list) => el("select", { ariaLabel: name }, ...list.map((value) => el("option", { value, textContent: value })));
  const carried = ["raw", "corrected", "navigation", "environment"];
  const streams = (link) => el("span", { className: "row" }, ...carried.map((name) => el("label", {}, el("input", { type: "checkbox", value: name, ariaLabel: `${name} on the ${link}` }), name)));
  const checked = (boxes) => [...boxes.querySelectorAll("input")].filter((box) => box.checked).map((box) => box.value).join(",") || "none";
  const check = (boxes, names) => boxes.querySelectorAll("input").forEach((box) => (box.checked = names.includes(box.value)));
  // The option of `wimu device settings set`, its label, its control, and how the control is set and read.
  const rows = [
    ["range", "Full-scale range, ± g", number("range"), (held) => held.range_g],
    ["rate", "Output data rate, Hz", number("rate"), (held) => held.rate_hz],
    ["resolution", "Resolution", option("resolution", ["low", "normal", "high"]), (held) => held.resolution],
    ["zupt", "Zero-velocity updates", option("zero-velocity updates", ["on", "off"]), (held) => (held.zupt ? "on" : "off")],
    ...["cable", "wireless"].flatMap((link, k) => [
      [link, `Streams on the ${link}`, streams(link), (held) => held[link].join(",") || "none"],
      ["batch", `Samples per batch, ${link}`, number(`batch, ${link}`), (held) => held.batch[k], link],
      ["every", `Decimation, ${link}`, number(`decimation, ${link}`), (held) => Math.max(held.every[k], 1), link],
    ]),
  ].map(([name, label, control, of, link]) => {
    form.append(el("div", {}, el("span", { textContent: label }), control));
    const boxes = control.tagName === "SPAN";
    return { name, of, link, get: () => (boxes ? checked(control) : control.value), set: (value) => (boxes ? check(control, value.split(",")) : (control.value = value)) };
  });
  const save = el("button", { textContent: "Write to the board", className: "main", disabled: true, onclick: () => write() });
  let held = null, asked = false;
  const show = (found) => { if (!found) return; held = found; save.disabled = false; rows.forEach((row) => row.set(String(row.of(found)))); };
  const read = () => board.ask({ do: "settings", options: [] }).then(show);
  const write = async () => {
    const changes = rows.filter((row) => row.get() !== String(row.of(held)));
    if (!changes.length) return text(result, "nothing has changed");
    const found = await board.ask({ do: "settings", options: changes.map(({ name, link, get }) => `--${name}=${link ? link + "=" : ""}${get()}`) });
    const rests = board.parameters?.calibrated && changes.some((row) => row.name === "range");
    text(result, found ? `written: the board holds what is shown${rests ? ". Its calibration is for the range before: it runs uncalibrated until that is set again" : ""}` : "not written");
    show(found);
  };
  const draw = () => {
    top.draw();
    if (!board.state || board.state.replay) return text(result, "A recording has no settings.");
    if (!asked && server.writes) { asked = true; read(); }
  };
  return { element: el("article", {}, top.element, form, el("div", { className: "row" }, save, el("button", { textContent: "Read again", onclick: read })), result), draw };
}

// The view of files is one card a file, and a list.
function fileCard(name) {
  const title = el("h2", { textContent: name }), about = el("p", { className: "soft" }), plots = el("div"), findings = el("ul", { className: "soft" });
  const drawn = [];
  let shown = null;
  const draw = () => {
    const file = files.get(name);
    if (!file || file === shown) return;
    shown = file;
    const rows = file.rows.toLocaleString("en");
    text(about, file.error || (file.done ? `${file.format}: ${rows} rows, ${significant(file.duration_s)} s` : `reading: ${rows} rows, ${significant(file.duration_s)} s so far`));
    about.setAttribute("aria-busy", !file.done);
    file.charts.forEach((chart, k) => { (drawn[k] ??= plotIn(plots, chart)).set(chart); });
    findings.replaceChildren(...file.findings.map((one) => el("li", { textContent: one })));
  };
  const close = () => {
    sections.files.cards = sections.files.cards.filter((card) => card !== made);
    files.delete(name);
    fileCards.delete(name);
    made.element.remove();
  };
  const top = el("div", { className: "head" }, title, el("button", { textContent: "Close", onclick: close }));
  const made = { element: el("article", {}, top, about, plots, findings), draw };
  return made;
}

// Sends a file in pieces, which the server writes to its folder and opens.
async function upload(file) {
  const size = 36000;
  for (let at = 0; at === 0 || at < file.size; at += size) {
    const bytes = new Uint8Array(await file.slice(at, at + size).arrayBuffer());
    say(`${file.name}: ${Math.round((100 * at) / Math.max(file.size, 1))} % sent`);
    await request({ do: "upload", file: file.name, at, data: btoa(String.fromCharCode(...bytes)), last: at + size >= file.size });
  }
  say(`${file.name} is in the folder of the dashboard`);
  choose("files");
}
const uploads = async (list) => { for (const file of list) await upload(file).catch(() => {}); };

function fileList() {
  const body = el("tbody"), note = el("p", { className: "soft" });
  const add = el("input", { type: "file", multiple: true, ariaLabel: "Add files", onchange: () => uploads(add.files) });
  const size = (bytes) => (bytes < 1e6 ? `${significant(bytes / 1e3)} kB` : `${significant(bytes / 1e6)} MB`);
  const draw = () => {
    text(note, topics.folder ? `Files of ${topics.folder}. Drop one on the page to add it.` : "");
    const key = JSON.stringify(listed);
    if (body.key === key) return;
    body.key = key;
    body.replaceChildren(...listed.filter((file) => !/\.json$/i.test(file.name)).map((file) => el("tr", {},
      el("td", { textContent: file.name }), el("td", { textContent: size(file.bytes) }),
      el("td", {}, el("div", { className: "row end" }, el("button", { textContent: "Show", onclick: () => act({ do: "open", file: file.name }) }),
        /\.mcap$/i.test(file.name) ? el("button", { textContent: "Replay", onclick: () => act({ do: "open", file: file.name }).then(() => act({ do: "play", file: file.name })).then(() => choose("live")) }) : null)))));
  };
  return { element: el("article", {}, note, add, el("div", { className: "table" }, el("table", {}, body))), draw };
}

const views = { live: ["Live", liveCard], space: ["Orientation & path", spaceCard], noise: ["Noise", noiseCard], links: ["Links", linksCard], calibrate: ["Calibrate", calibrateCard], parameters: ["Parameters", parametersCard], settings: ["Settings", settingsCard], files: ["Recordings", null] };
const sections = {}, fileCards = new Map();
let view = "live", due = false;

function choose(name) {
  view = name;
  for (const [key, { tab, section }] of Object.entries(sections)) {
    tab.setAttribute("aria-selected", key === name);
    tab.tabIndex = key === name ? 0 : -1;
    section.hidden = key !== name;
  }
  sections[name].tab.scrollIntoView({ block: "nearest", inline: "nearest" });
  drawView(true);
}

// Draws what is visible in the next picture; `all` looks for new and closed boards too.
let complete = false;
function drawView(all = false) {
  complete ||= all;
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    const { list, empty } = sections[view], whole = complete;
    complete = false;
    if (view === "files") {
      sections.files.cards ??= [fileList()];
      for (const name of files.keys()) if (!fileCards.has(name)) { const card = fileCard(name); fileCards.set(name, card); sections.files.cards.push(card); }
      for (const card of sections.files.cards) { if (!card.element.isConnected) list.append(card.element); card.draw(); }
      fileCards.get(opened)?.element.scrollIntoView({ block: "start" });
      opened = "";
      return;
    }
    for (const board of boards.values()) {
      if (!board.state) continue;
      const card = (board.cards[view] ??= (([, make]) => { const card = make(board); card.remove = () => card.element.remove(); return card; })(views[view]));
      if (!card.element.isConnected) list.append(card.element);
      if (board.fresh || board.changed || whole) card.draw();
    }
    for (const board of boards.values()) board.changed = false;
    const waits = [...links.values()];
    empty.hidden = [...boards.values()].some((board) => board.state) && !waits.length;
    const key = JSON.stringify(waits);
    if (empty.key !== key) empty.querySelector("ul").replaceChildren(...waits.map(({ link, error }) => el("li", {}, error ? `${link}: ${error} ` : `${link}: connecting … `, el("button", { textContent: "Give up", onclick: () => act({ do: "forget", link }) }))));
    empty.key = key;
    empty.querySelector("p").hidden = waits.length > 0;
    empty.classList.toggle("few", boards.size > 0);
  });
}

function start() {
  Object.entries(views).forEach(([name, [title]], k) => {
    const tab = el("button", { textContent: title, role: "tab", id: "tab-" + name, title: `key ${k + 1}`, onclick: () => choose(name) });
    tab.setAttribute("aria-controls", "view-" + name);
    const list = el("div", { className: "boards" });
    const empty = el("div", { className: "empty", hidden: true }, el("p", {}, "No board yet. Enter its LINK above and press Connect. Without hardware, run ", el("code", { textContent: "wimu simulate" }), " and connect ", el("code", { textContent: "tcp://127.0.0.1:7100" }), "."), el("ul"));
    const section = el("section", { id: "view-" + name, role: "tabpanel" }, empty, list);
    section.setAttribute("aria-labelledby", tab.id);
    sections[name] = { tab, section, list, empty };
    $("tabs").append(tab);
    $("views").append(section);
  });
  $("tabs").addEventListener("keydown", (event) => {
    const names = Object.keys(views), step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    choose(names[(names.indexOf(view) + step + names.length) % names.length]);
    sections[view].tab.focus();
  });
  $("connect").addEventListener("submit", (event) => {
    event.preventDefault();
    say("");
    act({ do: "connect", link: $("link").value.trim() || $("link").placeholder });
  });
  const pause = () => { paused = !paused; $("pause").setAttribute("aria-pressed", paused); text($("pause"), paused ? "Go on" : "Pause"); drawView(true); };
  $("pause").onclick = pause;
  $("message").onclick = () => say("");
  const carries = (event) => event.dataTransfer?.types.includes("Files");
  addEventListener("dragover", (event) => { if (carries(event)) { event.preventDefault(); document.body.classList.add("drop"); } });
  addEventListener("dragleave", (event) => { if (!event.relatedTarget) document.body.classList.remove("drop"); });
  addEventListener("drop", (event) => {
    document.body.classList.remove("drop");
    if (carries(event)) { event.preventDefault(); uploads([...event.dataTransfer.files]); }
  });
  $("help").onclick = () => $("keys").showModal();
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
    if (event.key === " " && event.target.tagName === "BUTTON") return;
    const first = [...boards.values()].find((board) => board.state), names = Object.keys(views);
    const guided = (what, with_result) => first?.guided && (first.guided.result !== null) === with_result && first.ask({ do: what });
    const action = {
      " ": pause, "?": () => $("keys").showModal(), r: () => first?.ask({ do: "record" }), z: () => first?.ask({ do: "zero" }),
      c: () => { choose("calibrate"); if (first && !first.guided) first.ask({ do: "calibrate" }); },
      u: () => guided("undo", false), s: () => guided("skip", false), f: () => guided("finish", false), p: () => guided("push", true),
    }[event.key] || (names[+event.key - 1] && event.target.tagName !== "CANVAS" ? () => choose(names[+event.key - 1]) : null);
    if (action && !$("keys").open) { event.preventDefault(); action(); }
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawView(true));
  addEventListener("resize", () => drawView(true));
  choose("live");
  server.token();
  server.open();
}

start();
