// Charts on a canvas: zoom, values under the pointer, rotation of charts in space. Written for wimu; no dependencies.
//
// `new WimuPlot(figure, chart)` draws into an element; `plot.set(chart)` replaces the data and keeps the view.
// `chart` is what Chart::json of wimu-host gives: title; axes x, y, z with units; logX, logY, equal, space; rangeX, rangeY;
// series of {name, style: "line" | "dots" | "guide", x, y, z, t, labels}; bands of {series, x, low, high}; marked intervals.
"use strict";

class WimuPlot {
  static all = [];
  static FONT = "12px system-ui, sans-serif";
  // Azimuth and elevation of the first view of space, rad.
  static VIEW = [0.6, 0.45];

  constructor(figure, chart) {
    this.figure = figure;
    const make = (parent, tag, name) => {
      const made = document.createElement(tag);
      if (name) made.className = name;
      return parent.appendChild(made);
    };
    const head = make(figure, "div", "plot-head");
    this.title = make(head, "strong");
    this.button = make(figure, "button");
    this.button.textContent = "Reset";
    this.button.onclick = () => this.reset();
    this.legend = make(figure, "div", "plot-legend");
    this.canvas = make(figure, "canvas");
    this.tip = make(figure, "div", "plot-tip");
    this.tip.style.display = "none";
    const caption = figure.querySelector("figcaption");
    if (caption) figure.append(caption);
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.hidden = new Set();
    this.set(chart);
    this.listen();
    new ResizeObserver(() => this.draw()).observe(figure);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.set(this.chart));
    WimuPlot.all.push(this);
  }

  // Replaces the chart; a view that was zoomed stays.
  set(chart) {
    const before = this.chart && this.zoomed() ? this.view : null;
    this.chart = chart;
    this.title.textContent = chart.title;
    this.canvas.setAttribute("aria-label", chart.title);
    this.canvas.title = chart.space ? "drag: rotate; wheel after a click, or pinch: zoom; double-click: reset"
      : "drag: zoom; shift and drag: move; wheel after a click, or pinch: zoom; double-click: reset";
    this.canvas.classList.toggle("space", chart.space);
    const style = getComputedStyle(this.figure);
    this.colour = (name) => style.getPropertyValue("--" + name).trim() || "#888";
    let colour = 0;
    const numbers = (values, log) => Float64Array.from(values, (v) => (v === null || (log && v <= 0) ? NaN : log ? Math.log10(v) : v));
    this.series = chart.series.map((one) => ({
      ...one, guide: one.style === "guide",
      colour: one.style === "guide" ? "guide" : "c" + (colour++ % 8),
      x: numbers(one.x, chart.logX), y: numbers(one.y, chart.logY), z: numbers(one.z || [], false),
    }));
    this.bands = (chart.bands || []).map((band) => ({
      ...band, x: numbers(band.x, chart.logX), low: numbers(band.low, chart.logY), high: numbers(band.high, chart.logY),
    }));
    this.home = this.extent();
    this.view = structuredClone(this.home);
    // In space the rotation stays, and the view follows the data.
    if (before) chart.space ? Object.assign(this.view, { turn: before.turn, zoom: before.zoom }) : (this.view = before);
    this.listSeries();
    this.pointer && this.near ? this.hover(...this.pointer) : this.draw();
  }

  listSeries() {
    const names = this.series.map((one) => [one.name, one.style, this.colour(one.colour)]).join();
    if (names === this.listed) return;
    this.listed = names;
    this.legend.replaceChildren(...this.series.filter((one) => one.name).map((one) => {
      const entry = document.createElement("span"), line = document.createElement("i");
      line.className = one.style;
      line.style[one.style === "dots" ? "background" : "borderColor"] = this.colour(one.colour);
      entry.append(line, one.name);
      return entry;
    }));
  }

  // The range of the data: of both axes, after the logarithm; in space the centre and half the width of a cube.
  extent() {
    const { chart, series } = this;
    // In space a guide is an ellipsoid, which is to be seen whole.
    const data = !chart.space && series.some((one) => !one.guide) ? series.filter((one) => !one.guide) : series;
    const span = (key) => {
      let low = Infinity, high = -Infinity;
      for (const one of data) for (const v of one[key]) if (isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
      return low > high ? [0, 1] : low === high ? [low - 0.5, high + 0.5] : [low, high];
    };
    if (chart.space) {
      // With named axes the box of the data, to whole steps of its grid; otherwise the unit sphere.
      let axes = ["x", "y", "z"].map((key) => (chart.z ? span(key) : [-1, 1]));
      const grid = WimuPlot.steps(Math.max(...axes.map(([low, high]) => high - low)), 6);
      if (chart.z) axes = axes.map(([low, high]) => [Math.floor(low / grid + 1e-9) * grid, Math.ceil(high / grid - 1e-9) * grid]);
      const centre = axes.map(([low, high]) => (low + high) / 2), halves = axes.map(([low, high]) => (high - low) / 2 || grid / 2);
      return { centre, halves, axes, grid, turn: [...WimuPlot.VIEW], zoom: 1 };
    }
    const range = (key, given, log, margin) => {
      const [low, high] = given ? given.map((v) => (log ? Math.log10(Math.max(v, 1e-300)) : v)) : span(key);
      const room = margin * (high - low);
      return [low - room, high + room];
    };
    return { x: range("x", chart.rangeX, chart.logX, 0.02), y: range("y", chart.rangeY, chart.logY, 0.06) };
  }

  zoomed() {
    return JSON.stringify(this.view) !== JSON.stringify(this.home);
  }

  reset() {
    this.look(structuredClone(this.home));
  }

  // Shows a view, also in the other charts over the same range of time.
  look(view) {
    this.view = view;
    const same = (other) => !other.chart.space && !this.chart.space && other.chart.x === this.chart.x && /^time/.test(this.chart.x) &&
      other.home.x.every((v, k) => Math.abs(v - this.home.x[k]) <= 0.05 * (this.home.x[1] - this.home.x[0]));
    for (const other of WimuPlot.all) if (other !== this && same(other)) {
      other.view.x = this.zoomed() || other.zoomed() ? [...view.x] : other.view.x;
      if (!this.zoomed()) other.view.x = [...other.home.x];
      other.draw();
    }
    this.draw();
  }

  // ---- Drawing

  draw() {
    const width = this.figure.clientWidth;
    if (!width) return;
    const { chart, canvas } = this, tall = chart.equal || chart.space;
    const height = Math.round(tall ? Math.min(Math.max(0.62 * width, 280), 480) : Math.min(Math.max(0.36 * width, 230), 320));
    const ratio = devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.style.height = height + "px";
    }
    this.button.style.display = this.zoomed() ? "block" : "none";
    this.button.style.top = canvas.offsetTop + "px";
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, width, height);
    g.font = WimuPlot.FONT;
    g.lineJoin = "round";
    this.labels = [];
    if (chart.space) this.drawSpace(g, width, height);
    else this.drawPlane(g, width, height);
  }

  drawPlane(g, width, height) {
    const { chart } = this, ink = this.colour("soft");
    this.area = { x: 60, y: 22, w: width - 68, h: height - 22 - 36 };
    this.shown = this.fitted();
    let ys = this.ticks("y");
    const left = Math.ceil(Math.max(24, ...ys.map((tick) => g.measureText(tick.text).width))) + 10;
    Object.assign(this.area, { x: left, w: width - left - 8 });
    const { x, y, w, h } = this.area;
    this.shown = this.fitted();
    ys = this.ticks("y");
    const xs = this.ticks("x");
    g.save();
    g.beginPath(); g.rect(x, y, w, h); g.clip();
    g.fillStyle = this.colour("mark");
    for (const [from, to] of chart.marked || []) {
      const [a, b] = [from, to].map((v) => this.px(chart.logX ? Math.log10(v) : v));
      g.fillRect(a, y, Math.max(b - a, 1), h);
    }
    g.strokeStyle = this.colour("line");
    g.lineWidth = 1;
    for (const minor of [true, false]) {
      g.globalAlpha = minor ? 0.4 : 1;
      g.beginPath();
      for (const tick of xs) if (!tick.text === minor) { const a = Math.round(this.px(tick.at)) + 0.5; g.moveTo(a, y); g.lineTo(a, y + h); }
      for (const tick of ys) if (!tick.text === minor) { const b = Math.round(this.py(tick.at)) + 0.5; g.moveTo(x, b); g.lineTo(x + w, b); }
      g.stroke();
    }
    for (const band of this.bands) this.drawBand(g, band);
    for (const one of this.series) this.drawSeries(g, one, (k) => [this.px(one.x[k]), this.py(one.y[k])]);
    if (this.box) {
      const [a, b, c, d] = this.box;
      g.fillStyle = this.colour("mark");
      g.fillRect(a, b, c - a, d - b);
    }
    g.restore();
    g.strokeStyle = ink;
    g.strokeRect(x + 0.5, y + 0.5, w - 1, h - 1);
    g.fillStyle = ink;
    g.textBaseline = "middle"; g.textAlign = "right";
    for (const tick of ys) if (tick.text) g.fillText(tick.text, x - 6, this.py(tick.at));
    g.textBaseline = "top"; g.textAlign = "center";
    for (const tick of xs) if (tick.text) {
      const half = g.measureText(tick.text).width / 2;
      g.fillText(tick.text, Math.min(this.px(tick.at), width - half), y + h + 5);
    }
    g.textAlign = "right"; g.fillText(chart.x + (this.offset ? ` − ${this.offset}` : ""), x + w, y + h + 20);
    g.textAlign = "left"; g.fillText(chart.y, x, 3);
    this.drawMarker(g);
  }

  drawBand(g, band) {
    const known = (k) => isFinite(band.x[k]) && isFinite(band.low[k]) && isFinite(band.high[k]);
    const line = (k, value) => g.lineTo(this.px(band.x[k]), Math.min(Math.max(this.py(value[k]), -9999), 9999));
    g.globalAlpha = 0.2;
    g.fillStyle = this.colour(this.series[band.series]?.colour || "guide");
    for (let first = 0, k = 0; k <= band.x.length; k++) if (k === band.x.length || !known(k)) {
      g.beginPath();
      for (let m = first; m < k; m++) line(m, band.low);
      for (let m = k - 1; m >= first; m--) line(m, band.high);
      g.fill();
      first = k + 1;
    }
    g.globalAlpha = 1;
  }

  drawSeries(g, one, at, back) {
    g.strokeStyle = g.fillStyle = this.colour(one.colour);
    g.lineWidth = one.guide ? 1 : 1.8;
    const dots = one.style === "dots", radius = one.x.length > 200 ? 1.7 : 4.5;
    let last = null, pen = false;
    g.beginPath();
    for (let k = 0; k < one.x.length; k++) {
      const [a, b, behind] = at(k), known = isFinite(a) && isFinite(b);
      if (known && (back === undefined || behind === back)) {
        if (dots) { g.moveTo(a + radius, b); g.arc(a, b, radius, 0, 7); } else {
          if (!pen) g.moveTo(...(last || [a, b]));
          g.lineTo(a, b);
        }
        pen = true;
      } else pen = false;
      last = known ? [a, b] : null;
    }
    dots ? g.fill() : g.stroke();
    g.textBaseline = "bottom"; g.textAlign = "left";
    g.fillStyle = this.colour("ink");
    one.labels?.forEach((label, k) => {
      const [a, b, behind] = at(k), width = g.measureText(label).width;
      // Left of the point where the right edge would cut it, below it where the upper edge would.
      const left = this.area && a + 5 + width > this.area.x + this.area.w ? a - 5 - width : a + 5;
      const low = this.area && b - 15 < this.area.y ? b + 17 : b;
      // A label upon another one would be illegible.
      const covers = ([x, y, w]) => left < x + w && x < left + width && Math.abs(low - y) < 12;
      if (!isFinite(a) || (back !== undefined && behind !== back) || this.labels.some(covers)) return;
      this.labels.push([left, low, width]);
      g.fillText(label, left, low - 3);
    });
  }

  drawMarker(g) {
    const near = this.near;
    if (!near) return;
    g.strokeStyle = this.colour("soft");
    g.lineWidth = 1;
    if (near.x !== undefined) { g.beginPath(); g.moveTo(near.x, this.area.y); g.lineTo(near.x, this.area.y + this.area.h); g.stroke(); }
    for (const [a, b, colour] of near.points) {
      g.fillStyle = this.colour(colour);
      g.beginPath(); g.arc(a, b, 4, 0, 7); g.fill();
      g.strokeStyle = this.colour("page"); g.stroke();
    }
  }

  drawSpace(g, width, height) {
    const { chart, view } = this, [hx, hy, hz] = view.halves;
    const [ca, sa] = [Math.cos(view.turn[0]), Math.sin(view.turn[0])], [ce, se] = [Math.cos(view.turn[1]), Math.sin(view.turn[1])];
    // The data fit at every azimuth; without named axes they are a sphere.
    const across = chart.z ? Math.hypot(hx, hy) : hx, up = chart.z ? across * Math.abs(se) + hz * ce : hz;
    const scale = view.zoom * Math.min((width / 2 - 46) / across, (height / 2 - 34) / up);
    this.project = (x, y, z) => {
      const [u, v, w] = [x - view.centre[0], y - view.centre[1], z - view.centre[2]];
      const depth = u * sa + v * ca;
      return [width / 2 + scale * (u * ca - v * sa), height / 2 - scale * (w * ce + depth * se), depth * ce - w * se > 0];
    };
    if (chart.z) this.drawFloor(g);
    // Of a sphere, the back is faint.
    for (const back of chart.z ? [undefined] : [true, false]) {
      g.globalAlpha = back ? 0.35 : 1;
      this.labels = [];
      for (const one of this.series) this.drawSeries(g, one, (k) => this.project(one.x[k], one.y[k], one.z[k]), back);
    }
    this.drawMarker(g);
  }

  // The floor of the data with a grid, and the vertical axis.
  drawFloor(g) {
    const { axes: [bx, by, bz], grid } = this.home, soft = this.colour("soft");
    const values = ([a, b]) => Array.from({ length: Math.round((b - a) / grid) + 1 }, (_, k) => a + k * grid);
    const line = (from, to) => { g.moveTo(...this.project(...from)); g.lineTo(...this.project(...to)); };
    g.strokeStyle = this.colour("line"); g.lineWidth = 1;
    g.beginPath();
    for (const v of values(bx)) line([v, by[0], bz[0]], [v, by[1], bz[0]]);
    for (const v of values(by)) line([bx[0], v, bz[0]], [bx[1], v, bz[0]]);
    g.stroke();
    // The edges in front, and the corner that is farthest to the left.
    const front = (edges) => edges.reduce((a, b) => (this.project(...b)[1] > this.project(...a)[1] ? b : a));
    const middle = [(bx[0] + bx[1]) / 2, (by[0] + by[1]) / 2];
    const ey = front(by.map((v) => [middle[0], v, bz[0]]))[1], ex = front(bx.map((v) => [v, middle[1], bz[0]]))[0];
    const corner = bx.flatMap((a) => by.map((b) => [a, b])).reduce((a, b) => (this.project(...b, 0)[0] < this.project(...a, 0)[0] ? b : a));
    g.strokeStyle = soft;
    g.beginPath(); line([...corner, bz[0]], [...corner, bz[1]]); g.stroke();
    g.fillStyle = soft; g.textBaseline = "middle"; g.textAlign = "center";
    // Away from the middle of the floor.
    const [ox, oy] = this.project(...middle, bz[0]);
    const text = (label, at, far) => {
      const [a, b] = this.project(...at), length = Math.max(Math.hypot(a - ox, b - oy), 1);
      const d = (far + (g.measureText(label).width / 2) * Math.abs(a - ox) / length) / length;
      g.fillText(label, a + d * (a - ox), b + d * (b - oy));
    };
    const label = (v) => WimuPlot.format(v, grid);
    for (const v of values(bx)) text(label(v), [v, ey, bz[0]], 9);
    for (const v of values(by)) text(label(v), [ex, v, bz[0]], 9);
    text(this.chart.x, [middle[0], ey, bz[0]], 32);
    text(this.chart.y, [ex, middle[1], bz[0]], 32);
    g.textAlign = "right";
    for (const v of values(bz).slice(1)) { const [a, b] = this.project(...corner, v); g.fillText(label(v), a - 5, b); }
    const [a, b] = this.project(...corner, bz[1]);
    g.textAlign = "center"; g.fillText(this.chart.z, a, b - 14);
  }

  // ---- Scales

  // The view with equal scales where they are asked for.
  fitted() {
    const { x, y } = this.view;
    if (!this.chart.equal) return { x, y };
    const unit = Math.max((x[1] - x[0]) / this.area.w, (y[1] - y[0]) / this.area.h);
    const around = ([a, b], size) => [(a + b - unit * size) / 2, (a + b + unit * size) / 2];
    return { x: around(x, this.area.w), y: around(y, this.area.h) };
  }

  px(v) { const [a, b] = this.shown.x; return this.area.x + ((v - a) / (b - a)) * this.area.w; }
  py(v) { const [a, b] = this.shown.y; return this.area.y + this.area.h - ((v - a) / (b - a)) * this.area.h; }
  // Value on an axis, after the logarithm, at a pixel.
  vx(p) { const [a, b] = this.shown.x; return a + ((p - this.area.x) / this.area.w) * (b - a); }
  vy(p) { const [a, b] = this.shown.y; return a + ((this.area.y + this.area.h - p) / this.area.h) * (b - a); }

  static steps(span, count) {
    const rough = span / Math.max(count, 1), power = 10 ** Math.floor(Math.log10(rough));
    return power * [1, 2, 5, 10].find((step) => step * power >= rough * 0.999);
  }

  // A number to the digits that a step of its axis shows.
  static format(v, step) {
    if (Math.abs(v) < step * 1e-6) return "0";
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return Math.abs(v) >= 1e7 || digits > 6 ? v.toExponential(2) : v.toFixed(Math.min(digits, 12)).replace("-", "−");
  }

  // Four significant digits.
  static short(v) {
    const size = Math.abs(v);
    if (!isFinite(v)) return "–";
    return (size !== 0 && (size < 1e-4 || size >= 1e6) ? v.toExponential(3) : String(+v.toPrecision(4))).replace("-", "−");
  }

  ticks(axis) {
    const log = axis === "x" ? this.chart.logX : this.chart.logY, [low, high] = this.shown[axis];
    let count = axis === "x" ? this.area.w / 80 : this.area.h / 38;
    if (axis === "x") this.offset = 0;
    const list = [];
    if (log && high - low > 0.9) {
      const every = Math.max(1, Math.ceil((high - low) / (1.8 * count)));
      for (let k = Math.floor(low); k <= high; k++) {
        const power = (m) => (Math.abs(k) > 3 ? `${m}e${k}` : String(+(m * 10 ** k).toPrecision(3))).replace("-", "−");
        list.push({ at: k, text: k % every === 0 ? power(1) : "" });
        if (every === 1) for (let m = 2; m < 10; m++) list.push({ at: k + Math.log10(m), text: high - low < 1.6 && (m === 2 || m === 5) ? power(m) : "" });
      }
      return list.filter((tick) => tick.at >= low && tick.at <= high);
    }
    const [a, b] = log ? [10 ** low, 10 ** high] : [low, high];
    // Numbers of poses have no fractions.
    const whole = axis === "x" && this.series.every((one) => one.style === "dots" && one.x.every((v) => !(v % 1)));
    const step = Math.max(WimuPlot.steps(b - a, count), whole ? 1 : 0);
    if (!(step > 0) || !isFinite(step)) return list;
    // Of a long time only what changes is written beside the ticks.
    if (axis === "x" && !log && Math.max(Math.abs(a), Math.abs(b)) > 1e5 && Math.abs(a) > 20 * (b - a)) {
      const round = 10 ** Math.ceil(Math.log10(b - a) + 1);
      this.offset = Math.floor(a / round) * round;
    }
    const offset = axis === "x" ? this.offset : 0;
    for (let k = Math.ceil(a / step - 1e-9); k * step <= b + step * 1e-9; k++) {
      list.push({ at: log ? Math.log10(k * step) : k * step, text: WimuPlot.format(k * step - offset, step) });
    }
    return list;
  }

  // ---- Values under the pointer

  hover(x, y) {
    this.pointer = [x, y];
    this.near = null;
    const { chart } = this, number = (v, log) => WimuPlot.short(log ? 10 ** v : v);
    // Value with the unit of its axis, after a comma or in brackets, and the axis' name if it has one beside the unit.
    const named = (axis, value, log, bare) => {
      const [, name, unit] = axis.match(/^(.*?)(?:, | \()([^()]*)\)?$/) || (/^(m|mm|%|s|ms|µT|rad)(\W|$)/.test(axis) ? [axis, "", axis] : [axis, axis, ""]);
      return `${bare ? "" : name} ${number(value, log)} ${unit}`.trim();
    };
    const lines = [], points = [];
    const timed = !chart.space && !chart.equal && this.series.some((one) => one.style === "line");
    const at = (one, k) => (chart.space ? this.project(one.x[k], one.y[k], one.z[k]) : [this.px(one.x[k]), this.py(one.y[k])]);
    const nearest = (one, distance) => {
      let best = -1, least = Infinity;
      for (let k = 0; k < one.x.length; k++) {
        const d = distance(at(one, k));
        if (d < least) [least, best] = [d, k];
      }
      return [best, least];
    };
    if (timed) {
      let first;
      this.series.forEach((one, index) => {
        if (one.guide) return;
        const [k, far] = nearest(one, ([a, b]) => (isFinite(b) ? Math.abs(a - x) : NaN));
        if (k < 0 || far > 30) return;
        first ??= one.x[k];
        const [a, b] = at(one, k), band = this.bands.find((band) => band.series === index);
        const m = band ? band.x.reduce((best, v, k2) => (Math.abs(v - one.x[k]) < Math.abs(band.x[best] - one.x[k]) ? k2 : best), 0) : -1;
        const limits = band ? ` (${number(band.low[m], chart.logY)} to ${number(band.high[m], chart.logY)})` : "";
        lines.push([one, `${one.name}: ${named(chart.y, one.y[k], chart.logY, true)}${limits}`]);
        points.push([a, b, one.colour]);
      });
      if (first !== undefined) {
        lines.unshift([null, named(chart.x, first, chart.logX)]);
        this.near = { x: this.px(first), points };
      }
    } else {
      let found = [null, -1, 25];
      for (const one of this.series) if (!one.guide) {
        const [k, far] = nearest(one, ([a, b]) => Math.hypot(a - x, b - y));
        if (far < found[2]) found = [one, k, far];
      }
      const [one, k] = found;
      if (one) {
        lines.push([one, one.labels?.[k] ? `${one.name} ${one.labels[k]}` : one.name]);
        if (one.t?.[k] !== undefined) lines.push([null, `time ${WimuPlot.short(one.t[k])} s`]);
        const axes = chart.space ? [chart.x || "X", chart.y || "Y", chart.z || "Z"] : [chart.x, chart.y];
        axes.forEach((axis, d) => lines.push([null, named(axis, [one.x, one.y, one.z][d][k], [chart.logX, chart.logY][d])]));
        const [a, b] = at(one, k);
        points.push([a, b, one.colour]);
        this.near = { points };
      }
    }
    this.tip.replaceChildren(...lines.map(([one, text]) => {
      const line = document.createElement("div");
      line.textContent = text;
      if (one) line.style.color = this.colour(one.colour);
      return line;
    }));
    this.tip.style.display = lines.length ? "block" : "none";
    if (lines.length) {
      this.tip.style.left = "0";
      const { offsetWidth: w, offsetHeight: h } = this.tip, right = x + 14 + w < this.figure.clientWidth;
      this.tip.style.left = Math.max(0, right ? x + 14 : x - 14 - w) + "px";
      this.tip.style.top = this.canvas.offsetTop + Math.max(0, y - h - 12) + "px";
    }
    this.draw();
  }

  leave() {
    this.near = null;
    this.tip.style.display = "none";
    this.draw();
  }

  // ---- Pointer, wheel and keys

  // Scales the view by a factor around a pixel.
  zoom(factor, x, y, axes = "xy") {
    const view = structuredClone(this.chart.space ? this.view : { ...this.view, ...this.fitted() });
    if (this.chart.space) view.zoom = Math.min(Math.max(view.zoom / factor, 0.2), 200);
    else for (const [axis, centre] of [["x", this.vx(x)], ["y", this.vy(y)]]) {
      if (axes.includes(axis)) view[axis] = view[axis].map((v) => centre + (v - centre) * factor);
      if (view[axis][1] - view[axis][0] < 1e-9 * Math.max(1e-9, Math.abs(centre))) return;
    }
    this.look(view);
  }

  // Moves the view by pixels; in space turns it.
  move(dx, dy) {
    const view = structuredClone(this.chart.space ? this.view : { ...this.view, ...this.fitted() });
    if (this.chart.space) view.turn = [view.turn[0] + dx * 0.01, Math.min(Math.max(view.turn[1] + dy * 0.01, -Math.PI / 2), Math.PI / 2)];
    else {
      const shift = ([a, b], part) => [a + part * (b - a), b + part * (b - a)];
      view.x = shift(view.x, -dx / this.area.w);
      view.y = shift(view.y, dy / this.area.h);
    }
    this.look(view);
  }

  // Zooms to a rectangle of pixels; a flat one changes one axis.
  zoomTo([a, b, c, d]) {
    const wide = Math.abs(c - a) > 10, high = Math.abs(d - b) > 10, view = { ...this.view, ...this.fitted() };
    const sorted = (u, v) => [Math.min(u, v), Math.max(u, v)];
    if (wide) view.x = sorted(this.vx(a), this.vx(c));
    if (high) view.y = sorted(this.vy(b), this.vy(d));
    if (wide || high) this.look(view);
  }

  listen() {
    const { canvas } = this, down = new Map();
    const at = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    const apart = () => { const [a, b] = [...down.values()]; return { x: (a[0] + b[0]) / 2, y: (a[1] + b[1]) / 2, far: Math.hypot(a[0] - b[0], a[1] - b[1]) }; };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      try { canvas.setPointerCapture(event.pointerId); } catch { /* A pointer that the browser does not know. */ }
      down.set(event.pointerId, at(event));
      this.from = at(event);
      this.pans = this.chart.space || event.shiftKey;
      if (event.pointerType === "touch" && down.size === 1) this.hover(...this.from);
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = at(event), last = down.get(event.pointerId);
      if (!last) return this.hover(...now);
      if (down.size === 2) {
        const before = apart();
        down.set(event.pointerId, now);
        const after = apart();
        this.zoom(before.far / Math.max(after.far, 1), after.x, after.y);
        if (!this.chart.space) this.move(after.x - before.x, after.y - before.y);
        return;
      }
      down.set(event.pointerId, now);
      if (this.pans) this.move(now[0] - last[0], now[1] - last[1]);
      else if (event.pointerType === "touch") this.hover(...now);
      else {
        this.leave();
        const flat = (axis) => Math.abs(now[axis] - this.from[axis]) <= 10, { x, y, w, h } = this.area;
        this.box = [flat(0) ? x : this.from[0], flat(1) ? y : this.from[1], flat(0) ? x + w : now[0], flat(1) ? y + h : now[1]];
        this.draw();
      }
    });
    const up = (event) => {
      if (!down.delete(event.pointerId) || !this.box) return;
      this.box = null;
      if (event.type === "pointerup") this.zoomTo([...this.from, ...at(event)]);
      this.draw();
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("pointerleave", (event) => { if (event.pointerType !== "touch") this.leave(); });
    canvas.addEventListener("dblclick", () => this.reset());
    canvas.addEventListener("wheel", (event) => {
      // Without a click the wheel scrolls the page.
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      this.zoom(Math.exp(Math.sign(event.deltaY) * 0.2), ...at(event), event.shiftKey ? "x" : "xy");
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const [x, y] = [canvas.clientWidth / 2, canvas.clientHeight / 2];
      const action = {
        "+": () => this.zoom(0.8, x, y), "-": () => this.zoom(1.25, x, y), 0: () => this.reset(), Escape: () => this.reset(),
        ArrowLeft: () => this.move(40, 0), ArrowRight: () => this.move(-40, 0), ArrowUp: () => this.move(0, 40), ArrowDown: () => this.move(0, -40),
      }[event.key];
      if (action) { event.preventDefault(); action(); }
    });
  }
}

for (const figure of document.querySelectorAll("figure")) {
  const data = figure.querySelector("script[type='application/json']");
  if (data) figure.plot = new WimuPlot(figure, JSON.parse(data.textContent));
}
