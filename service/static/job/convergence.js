// Convergence traces of a running job: one curve for each start, and the band they span.

import { get } from "/static/api.js";
import { chart } from "/static/charts.js";

const SHOWN = 8; // starts whose curves are drawn each; more of them are told by their band
const POINTS = 2000; // of what was computed before the page was opened

export class Convergence {
  constructor(job, place) {
    this.job = job;
    this.units = null; // of the model's parameters, by name
    this.place = place;
    this.traces = new Map(); // task -> {iteration, theta: {name: []}, log_likelihood, ess}
    this.charts = new Map();
    this.ess = null;
  }

  get empty() {
    return this.charts.size === 0;
  }

  // Ask for what is new of every task that iterates, and draw.
  async update(tasks, model) {
    this.units ??= await units(model);
    const iterating = tasks.filter((task) => ["computation", "estimate", "start"].includes(task.role) && task.state !== "waiting");
    for (const { task } of iterating) await this.fetch(task);
    if ([...this.traces.values()].some((trace) => trace.iteration.length > 1)) this.draw();
  }

  async fetch(task) {
    const known = this.traces.get(task);
    const after = known?.iteration.at(-1) ?? -1;
    const some = known ? "" : `&points=${POINTS}`;
    const more = await get(`${this.job}/trace?task=${task}&after=${after}${some}`);
    if (!known) this.traces.set(task, more);
    else {
      for (const key of ["iteration", "log_likelihood", "ess"]) known[key].push(...more[key]);
      for (const [name, values] of Object.entries(more.theta)) known.theta[name]?.push(...values);
    }
    const ess = more.ess.findLast((value) => value !== null);
    if (ess !== undefined) this.ess = ess;
  }

  draw() {
    const names = Object.keys(this.traces.values().next().value.theta);
    for (const name of names) {
      const unit = this.units[name];
      this.one(name, unit && unit !== "1" ? `${name} [${unit}]` : name, (trace) => trace.theta[name], true);
    }
    this.one("log-likelihood", "log-likelihood", (trace) => trace.log_likelihood);
    this.one("effective sample size", "particles", (trace) => trace.ess);
  }

  one(title, yLabel, pick, held = false) {
    const { x, columns } = aligned([...this.traces.values()].filter((trace) => trace.iteration.length), pick);
    if (!columns.some((column) => column.some((value) => value !== null))) return;
    if (held && constant(columns)) return; // not free
    const options = { title, xLabel: "iteration", yLabel, x, series: series(columns), sync: "iteration", height: 190 };
    const known = this.charts.get(title);
    if (known) known.update(options);
    else {
      const figure = document.createElement("div");
      figure.className = "figure";
      this.place.append(figure);
      this.charts.set(title, chart(figure, options));
    }
  }

  destroy() {
    for (const one of this.charts.values()) one.destroy();
    this.charts.clear();
    this.place.replaceChildren();
  }
}

// What an extension adds to a registered model has no unit here; the report will know it.
async function units(model) {
  const found = await get(`/models/${encodeURIComponent(model.split("+")[0])}`);
  return Object.fromEntries(found.parameters.map((one) => [one.name, one.unit]));
}

// All traces over one axis: every iteration that some trace has.
function aligned(traces, pick) {
  const x = [...new Set(traces.flatMap((trace) => trace.iteration))].sort((a, b) => a - b);
  const at = new Map(x.map((k, i) => [k, i]));
  const columns = traces.map((trace) => {
    const column = new Array(x.length).fill(null);
    pick(trace).forEach((value, i) => {
      column[at.get(trace.iteration[i])] = value;
    });
    return column;
  });
  return { x, columns };
}

function constant(columns) {
  const values = columns.flat().filter((value) => value !== null);
  return values.length > 1 && values.every((value) => value === values[0]);
}

function series(columns) {
  if (columns.length === 1) return [{ label: "iterate", y: columns[0], colour: "model" }];
  const rows = columns[0].map((_, i) => columns.map((column) => column[i]).filter((value) => value !== null));
  const band = [rows.map((row) => (row.length ? Math.min(...row) : null)), rows.map((row) => (row.length ? Math.max(...row) : null))];
  const middle = { label: "middle and range of the starts", y: rows.map(median), colour: "data", dash: true, band };
  const each = columns.slice(0, SHOWN).map((y, i) => ({ label: `start ${i + 1}`, y, colour: `c${(i % 6) + 1}` }));
  return columns.length > SHOWN ? [middle] : [middle, ...each];
}

function median(values) {
  if (!values.length) return null;
  const sorted = [...values].sort((a, b) => a - b);
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}
