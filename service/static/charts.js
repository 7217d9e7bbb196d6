// Curves with bands, on uPlot (a classic script that base.html loads).
//
//   const c = chart(element, {
//     title, xLabel, yLabel,           texts; a unit belongs into the label: "time [s]"
//     x,                               numbers, increasing; null and NaN in y are gaps
//     series: [{
//       label, y,
//       kind: "line" | "points" | "steps",         "line" if left out
//       band: [low, high],             two arrays; drawn as a pale area around the curve
//       colour,                        "data" | "model" | "before" | "after" | "c1" ... "c6" | "bad"; else c1, c2, ... in turn
//       dash,                          true for a dashed line
//     }],
//     marks: [[x0, x1], ...],          stretches to shade: missing values, held-out data
//     marksLabel,                      what the shade means, for the legend
//     sync,                            charts with the same text share cursor and zoom
//     height,                          CSS pixels, 220 if left out
//     log: {x: true, y: true},         logarithmic axes
//     summary,                         the text alternative; made from the curves if left out
//     onZoom,                          called as onZoom(from, to) when another part is shown, onZoom(null) for all
//   })
//   c.refine({x, series})              more points of a part: they take the place of those drawn there
//   c.update({x, series, ...})         new data or options; keeps the zoom if the user has zoomed
//   c.destroy()
//
// Mouse: drag zooms, with Shift it moves what is shown, double click shows all. Fingers: see touch.js. Keyboard: the chart takes the focus; arrow keys move the cursor
// (with Shift by ten), Home and End, + and - zoom around it, 0 shows all. Buttons in the legend hide curves.

import { fingers } from "/static/touch.js";

const HEIGHT = 220;
const PAPER = 680; // width of a printed page, A4 or letter, without its margins of 14 mm, CSS pixels
const GAP = 26; // between its two columns
const live = new Set();
let printing = false;

document.addEventListener("themechange", () => live.forEach((one) => one.redraw()));
for (const event of ["beforeprint", "afterprint"]) {
  addEventListener(event, () => {
    printing = event === "beforeprint";
    live.forEach((one) => one.fit());
  });
}

export function chart(element, options) {
  return new Chart(element, options);
}

class Chart {
  constructor(element, options) {
    this.element = element;
    this.options = { ...options };
    this.whole = { x: options.x, series: options.series };
    this.hidden = new Set();
    this.part = null; // [from, to] of x that is shown, null for all
    element.classList.add("chart");
    element.replaceChildren();
    this.heading = add(element, "div", "chart-title");
    this.frame = add(element, "div", "chart-frame");
    this.legend = add(element, "div", "chart-legend");
    this.all = add(element, "button", "small chart-all");
    this.all.type = "button";
    this.all.textContent = "Show all";
    this.all.hidden = true;
    this.all.addEventListener("click", () => {
      this.frame.focus(); // the button goes
      this.zoom(0, Infinity);
    });
    this.frame.tabIndex = 0;
    this.frame.setAttribute("role", "img");
    this.frame.addEventListener("keydown", (event) => this.key(event));
    this.frame.addEventListener("blur", () => this.plot?.setCursor({ left: -10, top: -10 }));
    this.build();
    this.observer = new ResizeObserver(() => this.fit());
    this.observer.observe(this.frame);
    live.add(this);
  }

  refine({ x: fine, series }) {
    const { x } = this.whole;
    const first = x.findIndex((v) => v >= fine[0]);
    const after = x.findIndex((v) => v > fine[fine.length - 1]);
    const last = after < 0 ? x.length : after;
    const joined = (old, part) => old && [...old.slice(0, first), ...part, ...old.slice(last)];
    this.update({
      x: joined(x, fine),
      series: this.whole.series.map((one, i) => ({
        ...one,
        y: joined(one.y, series[i].y),
        band: one.band && one.band.map((edge, k) => joined(edge, series[i].band[k])),
      })),
    });
  }

  // Back to the points of the beginning.
  coarsen() {
    if (this.options.x !== this.whole.x) this.update(this.whole);
  }

  update(options) {
    const before = shape(this.options);
    Object.assign(this.options, options);
    if (shape(this.options) !== before) return this.build();
    const zoomed = this.zoomed();
    const range = zoomed && { min: this.plot.scales.x.min, max: this.plot.scales.x.max };
    this.plot.setData(this.data(), !zoomed);
    if (zoomed) this.plot.setScale("x", range);
    this.describe();
  }

  destroy() {
    live.delete(this);
    this.observer.disconnect();
    this.plot?.destroy();
    this.element.replaceChildren();
  }

  redraw() {
    this.plot?.redraw(false, true);
  }

  // One array for x, then for each series its curve and, where it has a band, low and high.
  data() {
    const columns = [this.options.x];
    for (const one of this.options.series) columns.push(one.y, ...(one.band ?? []));
    return columns.map((values) => Array.from(values, (v) => (Number.isFinite(v) ? v : null)));
  }

  build() {
    this.plot?.destroy();
    const { xLabel, yLabel, series, sync, log = {} } = this.options;
    const drawn = [{}];
    const bands = [];
    this.columns = []; // for each series the column of its curve
    series.forEach((one, i) => {
      const colour = () => css(`--chart-${one.colour ?? `c${(i % 6) + 1}`}`);
      const show = !this.hidden.has(one.label);
      this.columns.push(drawn.length);
      drawn.push({ label: one.label, show, ...stroke(one, colour) });
      if (one.band) {
        const at = drawn.length;
        const edge = { show, stroke: () => "transparent", width: 0, points: { show: false } };
        drawn.push(edge, { ...edge });
        bands.push({ series: [at + 1, at], fill: () => pale(colour()) });
      }
    });
    const axis = (label, size) => ({
      label,
      size,
      stroke: () => css("--muted"),
      grid: { stroke: () => css("--grid"), width: 1 },
      ticks: { stroke: () => css("--grid"), width: 1, size: 4 },
      font: "12px system-ui, sans-serif",
      labelFont: "12px system-ui, sans-serif",
      labelSize: 18,
      labelGap: 2,
    });
    const values = (plot, splits) => splits.map((v) => (v === null ? "" : short(v)));
    this.plot = new uPlot(
      {
        width: this.width(),
        height: this.options.height ?? HEIGHT,
        legend: { show: false },
        series: drawn,
        bands,
        axes: [
          { ...axis(xLabel, 30), ...(log.x ? {} : { values }) },
          { ...axis(yLabel, 62), ...(log.y ? {} : { values }) },
        ],
        scales: {
          x: { time: false, distr: log.x ? 3 : 1 },
          y: { distr: log.y ? 3 : 1, range: log.y ? undefined : padded },
        },
        cursor: {
          y: false,
          drag: { x: true, y: false },
          bind: { mousedown: (plot, target, handler) => (event) => (event.shiftKey ? this.pan(event) : handler(event)) },
          points: { size: 7 },
          sync: sync ? { key: sync, scales: ["x", null] } : undefined,
        },
        hooks: {
          drawClear: [(plot) => this.shade(plot)],
          setScale: [(plot, key) => key === "x" && this.rangeChanged()],
          setCursor: [(plot) => this.readings(plot.cursor.idx)],
        },
      },
      this.data(),
      this.frame,
    );
    fingers(this.plot, (middle, width) => this.zoom(middle, width));
    this.describe();
    this.explain();
  }

  // On paper there are two columns of charts, and the wide ones.
  width() {
    if (!printing) return Math.max(200, Math.floor(this.frame.clientWidth || 600));
    return this.element.matches(".figures > :not(.wide), .mapping *") ? (PAPER - GAP) / 2 : PAPER;
  }

  fit() {
    const width = this.width();
    const height = this.options.height ?? HEIGHT;
    if (this.plot && (this.plot.width !== width || this.plot.height !== height)) this.plot.setSize({ width, height });
  }

  zoomed() {
    const { min, max } = this.plot.scales.x;
    const x = this.plot.data[0];
    return x.length > 1 && (min > x[0] || max < x[x.length - 1]);
  }

  // ---- what is beside the curves ------------------------------------------------------------

  shade(plot) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.fillStyle = css("--chart-mark");
    for (const [from, to] of this.options.marks ?? []) {
      const left = Math.max(bbox.left, plot.valToPos(from, "x", true));
      const right = Math.min(bbox.left + bbox.width, plot.valToPos(to, "x", true));
      const width = Math.max(right - left, 2 * devicePixelRatio); // a single sample is seen too
      if (left <= bbox.left + bbox.width && right >= bbox.left) ctx.fillRect(left, bbox.top, width, bbox.height);
    }
    ctx.restore();
  }

  describe() {
    const { title } = this.options;
    this.heading.textContent = title ?? "";
    this.heading.hidden = !title;
    this.frame.setAttribute("aria-label", this.options.summary ?? summary(this.options));
    this.frame.setAttribute("aria-roledescription", "chart; arrow keys move the cursor, plus and minus zoom");
  }

  explain() {
    const { series, marks, marksLabel } = this.options;
    this.legend.replaceChildren();
    const alone = series.length === 1 && !marks?.length; // then the labels of the axes say what it is
    this.values = series.map((one, i) => {
      if (alone) return add(this.legend, "span", "chart-value");
      const button = add(this.legend, "button", "chart-key");
      button.type = "button";
      button.title = `Show or hide ${one.label}`;
      button.setAttribute("aria-pressed", String(!this.hidden.has(one.label)));
      const swatch = add(button, "span", `swatch ${one.kind ?? "line"}${one.dash ? " dash" : ""}`);
      swatch.style.color = `var(--chart-${one.colour ?? `c${(i % 6) + 1}`})`;
      button.append(one.label);
      button.addEventListener("click", () => this.toggle(one, button));
      return add(button, "span", "chart-value");
    });
    if (marks?.length && marksLabel) {
      const item = add(this.legend, "span", "chart-key");
      add(item, "span", "swatch mark");
      item.append(marksLabel);
    }
    this.at = add(this.legend, "span", "chart-at");
  }

  toggle(one, button) {
    const hide = !this.hidden.has(one.label);
    if (hide) this.hidden.add(one.label);
    else this.hidden.delete(one.label);
    const at = this.columns[this.options.series.indexOf(one)];
    for (let i = at; i <= at + (one.band ? 2 : 0); i++) this.plot.setSeries(i, { show: !hide });
    button.setAttribute("aria-pressed", String(!hide));
  }

  readings(index) {
    if (!this.values) return;
    const { x, series, xLabel } = this.options;
    const here = index !== null && index !== undefined && x.length > index;
    this.at.textContent = here ? `at ${label(xLabel)} ${short(x[index])}` : "";
    series.forEach((one, i) => {
      const value = here ? one.y[index] : null;
      this.values[i].textContent = Number.isFinite(value) ? short(value) : "";
    });
  }

  // ---- what is shown of it ------------------------------------------------------------------

  rangeChanged() {
    if (!this.plot) return; // being built
    const { min, max } = this.plot.scales.x;
    const part = this.zoomed() ? [min, max] : null;
    this.all.hidden = part === null;
    if (String(part) === String(this.part)) return;
    this.part = part;
    this.options.onZoom?.(...(part ?? [null]));
  }

  pan(event) {
    const { min, max } = this.plot.scales.x;
    const perPixel = (max - min) / this.plot.over.clientWidth;
    const from = event.clientX;
    const move = ({ clientX }) => this.zoom((min + max) / 2 - (clientX - from) * perPixel, max - min);
    addEventListener("mousemove", move);
    addEventListener("mouseup", () => removeEventListener("mousemove", move), { once: true });
  }

  // ---- keyboard -----------------------------------------------------------------------------

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { x } = this.options;
    const now = this.plot.cursor.idx ?? Math.floor(x.length / 2);
    const { min, max } = this.plot.scales.x;
    const step = event.shiftKey ? 10 : 1;
    const move = { ArrowLeft: now - step, ArrowRight: now + step, Home: 0, End: x.length - 1 }[event.key];
    if (move !== undefined) this.cursor(Math.min(Math.max(move, 0), x.length - 1));
    else if (event.key === "+" || event.key === "=") this.zoom(x[now], (max - min) / 2);
    else if (event.key === "-") this.zoom(x[now], (max - min) * 2);
    else if (event.key === "0" || event.key === "Escape") this.zoom(0, Infinity);
    else return;
    event.preventDefault();
  }

  cursor(index) {
    const { x } = this.options;
    const { min, max } = this.plot.scales.x;
    if (x[index] < min || x[index] > max) this.zoom(x[index], max - min);
    this.plot.setCursor({ left: this.plot.valToPos(x[index], "x"), top: 0 });
    this.frame.setAttribute("aria-label", this.spoken(index));
  }

  spoken(index) {
    const { x, xLabel, series } = this.options;
    const values = series.map((one) => `${one.label} ${Number.isFinite(one.y[index]) ? short(one.y[index]) : "missing"}`);
    return `${label(xLabel)} ${short(x[index])}: ${values.join(", ")}`;
  }

  // Here and in the charts that share the zoom.
  zoom(middle, width) {
    const { sync } = this.options;
    for (const one of sync ? live : [this]) {
      if (one.options.sync === sync) one.showPart(middle, width);
    }
  }

  showPart(middle, width) {
    const { x } = this.options;
    const [first, last] = [x[0], x[x.length - 1]];
    if (width >= last - first) return this.plot.setScale("x", { min: first, max: last });
    const min = Math.min(Math.max(middle - width / 2, first), last - width);
    this.plot.setScale("x", { min, max: min + width });
  }
}

// ---- details --------------------------------------------------------------------------------

// Options that need a new plot when they change; data alone does not.
function shape({ xLabel, yLabel, series, sync, log, height, marks, marksLabel }) {
  return JSON.stringify([xLabel, yLabel, sync, log, height, marks?.length > 0, marksLabel, series.map((s) => [s.label, s.kind, s.colour, s.dash, !!s.band])]);
}

function stroke(one, colour) {
  if (one.kind === "points") {
    return {
      stroke: colour,
      paths: () => null,
      points: { show: true, size: 4, width: 0, fill: colour, stroke: () => "transparent" },
    };
  }
  return {
    stroke: colour,
    width: 1.6,
    dash: one.dash ? [6, 4] : undefined,
    paths: one.kind === "steps" ? uPlot.paths.stepped({ align: 1 }) : undefined,
    points: { show: (plot, at) => sparse(plot, at), size: 4, fill: colour },
  };
}

// Single values between gaps make no line; few values are shown as dots too.
function sparse(plot, at) {
  const y = plot.data[at];
  return y.length <= 40 || y.some((v, i) => v !== null && (y[i - 1] ?? null) === null && (y[i + 1] ?? null) === null);
}

function padded(plot, low, high) {
  if (low === null) return [0, 1];
  const pad = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
  return [low - pad, high + pad];
}

function summary({ title, xLabel, x, series }) {
  const span = x.length ? `${label(xLabel)} from ${short(x[0])} to ${short(x[x.length - 1])}` : "no data yet";
  const curves = series.map((one) => {
    let [low, high, missing] = [Infinity, -Infinity, 0];
    for (const v of one.y) {
      if (!Number.isFinite(v)) missing += 1;
      else [low, high] = [Math.min(low, v), Math.max(high, v)];
    }
    const range = low <= high ? `between ${short(low)} and ${short(high)}` : "without values";
    return `${one.label} ${range}${missing && low <= high ? `, ${missing} missing` : ""}`;
  });
  return `${title ? `${title}: ` : ""}${curves.join("; ")}; ${span}`;
}

function label(text) {
  return (text ?? "x").replace(/\s*\[.*\]$/, "");
}

function short(v) {
  if (v === 0) return "0";
  const size = Math.abs(v);
  if (size >= 1e6 || size < 1e-4) return v.toExponential(2).replace(/\.?0+e/, "e").replace("e+", "e");
  return String(Number(v.toPrecision(6)));
}

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim() || "#888";
}

function pale(colour) {
  return /^#[0-9a-f]{6}$/i.test(colour) ? `${colour}33` : colour;
}

function add(parent, tag, className) {
  const made = document.createElement(tag);
  made.className = className;
  parent.append(made);
  return made;
}
