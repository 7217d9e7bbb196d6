// Step 2: the data, and which of its columns is which channel of the model.

import { element, number, post, Problem } from "/static/api.js";
import { chart } from "/static/charts.js";
import { isTime, match } from "/static/start/match.js";
import { withUnit } from "/static/start/model.js";

const by = (id) => document.getElementById(id);

export class DataCard {
  constructor(onChange) {
    this.onChange = onChange;
    this.files = []; // [{file, name, preview}]
    this.job = null; // {id, series, names of its files}: the data of an earlier job instead of files
    this.channels = []; // [{member: "y" | "u", name, unit}]
    this.mapping = new Map(); // "y.flow" -> column
    this.extra = new Set(); // columns that a diagnosis should ask about
    this.charts = [];
    this.units = []; // of the model: [name, unit]
    this.rates = []; // those of its parameters
    by("file").addEventListener("change", () => this.take([...by("file").files]));
    for (const id of ["time", "by"]) by(id).addEventListener("change", () => this.look());
    by("dt").addEventListener("input", () => {
      this.showFacts();
      this.draw();
    });
    by("time-unit").addEventListener("change", () => (this.files.length ? this.look(by("time-unit").value.trim() || "s") : this.showChannels()));
    this.watchDrop(by("drop"));
  }

  watchDrop(place) {
    for (const name of ["dragover", "drop"]) addEventListener(name, (event) => event.preventDefault());
    place.addEventListener("dragover", () => place.classList.add("over"));
    for (const name of ["dragleave", "drop"]) place.addEventListener(name, () => place.classList.remove("over"));
    place.addEventListener("drop", (event) => this.take([...event.dataTransfer.files]));
  }

  get ready() {
    return this.files.length > 0 || this.job !== null;
  }

  // ---- what there is ----------------------------------------------------------------------------

  async take(files) {
    if (!files.length) return;
    this.complain("");
    try {
      // Names are made different, since the request tells files apart by them.
      const found = [];
      for (const file of files) {
        const name = found.some((one) => one.name === file.name) ? `${found.length + 1}-${file.name}` : file.name;
        found.push({ file, name, preview: await preview(file, name) });
      }
      [this.files, this.job] = [found, null];
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      this.complain(error.errors[0]?.message ?? error.message);
      [this.files, this.job] = [[], null]; // an earlier file would be taken for this one
      this.showChannels();
      return;
    }
    this.mapping.clear();
    this.extra.clear();
    this.offerTimes();
    this.showChannels();
    await this.leaveChannels();
  }

  // The data of an earlier job; they are sent again as they are.
  takeJob(id, series, names) {
    by("time-unit").value = series[0].time_unit ?? "s";
    [this.files, this.job] = [[], { id, series, names }];
    this.mapping.clear();
    this.extra.clear();
    this.showChannels();
  }

  async useTime(column) {
    by("time").value = column;
    await this.look();
  }

  // A column that is called like a channel of the model has its values, not the times.
  async leaveChannels() {
    const called = (column) => this.channels.some(({ name }) => name === column);
    if (!this.files.length || !called(by("time").value)) return;
    const left = this.columns().filter(({ name }) => !called(name));
    const dated = left.filter(({ dates }) => dates);
    await this.useTime((left.find(({ name }) => isTime(name)) ?? (dated.length === 1 ? dated[0] : null))?.name ?? "");
  }

  // Look at the first file again, with the chosen column as time, which may count another unit.
  async look(unit) {
    const [first] = this.files;
    this.complainAt('[data-field~="t"]', "");
    try {
      if (unit || by("time").value || by("by").value) first.preview = await preview(first.file, first.name, by("time").value, unit, by("by").value);
      by("time-unit").value = first.preview.time_unit;
      by("dt").placeholder = String(first.preview.dt ?? 1);
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      this.complainAt('[data-field~="t"]', error.message);
    }
    this.showChannels();
  }

  offerTimes() {
    const { time, dt, columns } = this.files[0].preview;
    const offered = columns.filter((one) => !one.problem || one.dates || one.name === time?.column);
    const names = offered.map((one) => element("option", { value: one.name }, `column ${one.name}`));
    by("time").replaceChildren(element("option", { value: "" }, "samples at a fixed step"), ...names);
    by("time").value = time ? time.column : ""; // a bad one too: what is wrong with it is told
    this.found = by("time").value;
    const kinds = columns.map(({ name }) => element("option", { value: name }, `told apart by ${name}`));
    by("by").replaceChildren(element("option", { value: "" }, "one in each file"), ...kinds);
    if (dt !== null) by("dt").value = "";
    by("dt").placeholder = String(dt ?? 1);
    by("time-unit").value = this.files[0].preview.time_unit;
  }

  // The time step: as typed, else as the file has it, else 1.
  step() {
    return Number(by("dt").value.trim() || by("dt").placeholder);
  }

  setModel(model) {
    const list = (member, channels) => Object.entries(channels).map(([name, unit]) => ({ member, name, unit }));
    this.channels = model ? [...list("y", model.outputs), ...list("u", model.inputs)] : [];
    this.rates = model ? model.parameters.map((one) => [one.name, one.unit]) : [];
    this.units = model ? [...[model.nonlinear, model.linear, model.inputs, model.outputs].flatMap(Object.entries), ...this.rates] : [];
    this.mapping.clear();
    this.showChannels();
    this.leaveChannels();
  }

  // ---- mapping ----------------------------------------------------------------------------------

  showChannels() {
    by("data-card").hidden = !this.ready;
    by("example-row").hidden = this.ready;
    by("drop").classList.toggle("small", this.ready);
    by("clock").hidden = this.job !== null;
    by("dt-field").hidden = by("time").value !== "";
    by("hold-field").hidden = !this.channels.some(({ member }) => member === "u");
    for (const one of this.charts.splice(0)) one.destroy();
    if (!this.ready) return this.onChange();
    this.showFacts();
    const columns = this.columns();
    const usable = columns.filter((one) => !one.problem).map((one) => one.name);
    const guessed = this.job ? new Map() : match(this.channels, usable.filter((name) => name !== by("time").value && name !== by("by").value), new Set(columns.filter((one) => one.counts).map((one) => one.name)));
    this.selects = new Map();
    const rows = this.channels.map((channel, i) => {
      const key = `${channel.member}.${channel.name}`;
      if (this.job) this.mapping.set(key, columns[i]?.name ?? "");
      else if (!usable.includes(this.mapping.get(key))) this.mapping.set(key, guessed.get(key) ?? "");
      return this.row(channel, key, columns);
    });
    by("channels").replaceChildren(...rows);
    if (!this.channels.length) by("channels").replaceChildren(element("p", { class: "muted" }, "Choose a model to see which channels it needs."));
    this.offerExtra();
    this.draw();
  }

  // Columns that are no channel of the model.
  offerExtra() {
    const used = new Set([...this.mapping.values(), by("time").value, by("by").value]);
    const names = this.job ? spare(this.job.series[0], this.channels)
      : this.columns().filter((one) => !one.problem && !one.missing && !used.has(one.name)).map((one) => one.name);
    const open = this.channels.some(({ member, name }) => !this.mapping.get(`${member}.${name}`));
    by("extra").hidden = !names.length || !this.channels.length || open;
    by("extra-hint").textContent = this.job ? "A diagnosis asks whether the model should use them."
      : "A diagnosis asks whether the model should use the columns marked here.";
    for (const name of this.extra) if (!names.includes(name)) this.extra.delete(name);
    by("extra-columns").replaceChildren(...names.map((name) => (this.job ? element("span", {}, name)
      : element("label", { class: "inline" }, element("input", {
        type: "checkbox", checked: this.extra.has(name), onchange: (event) => {
          if (event.target.checked) this.extra.add(name);
          else this.extra.delete(name);
          this.onChange();
        },
      }), name))));
  }

  row(channel, key, columns) {
    const id = `column-${key}`;
    const options = columns.map((one) => element("option", { value: one.name, disabled: one.problem !== null },
      one.problem ? `${one.name} (${one.dates ? "dates" : "not numbers"})` : one.name));
    const select = element("select", { id }, element("option", { value: "" }, "choose a column ..."), ...options);
    select.value = this.mapping.get(key);
    select.addEventListener("change", () => {
      this.mapping.set(key, select.value);
      this.offerExtra();
      this.draw();
    });
    this.selects.set(key, select);
    const what = channel.member === "y" ? "measured" : "input";
    return element("div", { class: "mapping", "data-field": `series[0].${key}` },
      element("div", {},
        element("label", { for: id }, withUnit(channel.name, channel.unit), element("span", { class: "badge" }, what)),
        this.job ? element("p", { class: "muted" }, "as in that job") : select,
        element("p", { class: "hint", "data-facts": key }),
      ),
      element("div", { "data-plot": key }),
    );
  }

  showFacts() {
    const names = this.job ? ["Data of job ", element("a", { href: `/jobs/${this.job.id}` }, this.job.id.slice(0, 8))]
      : [element("strong", {}, this.files.map((one) => one.name).join(", "))];
    const rows = this.job ? this.job.series.map((one) => length(one)) : this.files.map((one) => one.preview.rows);
    const ignored = this.files.flatMap((one) => one.preview.ignored);
    by("data-facts").replaceChildren(
      element("span", {}, ...names),
      element("span", { class: "muted" }, `${rows.map((n) => n.toLocaleString("en")).join(" + ")} samples`),
      ...problems(this.columns()).map((text) => element("span", { class: "notice warn small" }, text)),
      ...(ignored.length ? [element("span", { class: "muted" }, `not read: ${ignored.join(", ")}`)] : []),
    );
    const time = by("time").value ? this.files[0]?.preview.time : null;
    const clock = by("time-unit").value.trim() || "s";
    const [other, counted] = otherClock(this.units, this.rates, clock);
    by("time-facts").className = time?.problem || other ? "field-error" : "hint";
    by("time-facts").textContent = time?.problem ? `Column '${time.column}': ${time.problem}`
      : other ? `Times are in ${clock}, and the model has ${other[0]} in ${other[1]}: its numbers are right only if its equations convert. Else write ${counted} as their unit, where the file says ${clock} or has dates, or convert them.`
      : !time ? this.aboutStep(clock)
      : `${stamp(time.first, time)} to ${stamp(time.last, time)} ${clock}, step ${number(time.step)} ${clock}${time.regular ? "" : " (median; not regular)"}`;
  }

  aboutStep(clock) {
    const dt = this.files[0]?.preview.dt ?? null;
    if (!this.files.length || by("dt").value.trim() || dt !== null) return "";
    return `No column of times: a step of 1 ${clock} is assumed unless you give one, or choose a column.`;
  }

  // Columns of the first experiment: {name, rows, missing, minimum, maximum, problem, row, value, gaps}.
  columns() {
    return this.job ? jobColumns(this.job.series[0], this.channels) : this.files[0].preview.columns;
  }

  draw() {
    for (const one of this.charts.splice(0)) one.destroy();
    if (!this.ready) return this.onChange();
    const columns = new Map(this.columns().map((one) => [one.name, one]));
    const clock = this.clock(columns);
    for (const channel of this.channels) {
      const key = `${channel.member}.${channel.name}`;
      const column = columns.get(this.mapping.get(key));
      const facts = document.querySelector(`[data-facts="${CSS.escape(key)}"]`);
      facts.textContent = column ? describe(column, channel) : "";
      facts.className = column?.missing && channel.member === "u" ? "field-error" : "hint";
      if (!column || !column.rows) continue;
      const x = column.row.map(clock);
      this.charts.push(chart(document.querySelector(`[data-plot="${CSS.escape(key)}"]`), {
        x,
        xLabel: `time [${by("time-unit").value.trim()}]`,
        yLabel: withUnit(column.name, channel.unit),
        series: [{ label: column.name, y: column.value, colour: channel.member === "y" ? "data" : "c2", kind: channel.member === "u" ? "steps" : "line" }],
        marks: column.gaps.map(([first, last]) => [clock(first - 0.5), clock(last + 0.5)]),
        marksLabel: "missing",
        sync: "data",
        height: 150,
      }));
    }
    this.onChange();
  }

  // Row number -> time, for drawing. Between the rows that the preview has, time is interpolated.
  clock(columns) {
    if (this.job) {
      const { t, dt } = this.job.series[0];
      return (row) => (t ? t[Math.min(Math.max(Math.round(row), 0), t.length - 1)] : row * (dt ?? 1));
    }
    if (by("by").value) return (row) => row; // records, one after the other
    const time = columns.get(by("time").value);
    const step = this.step() || 1;
    if (!time?.row.length || this.files[0].preview.time?.problem) return (row) => row * step;
    const { row: rows, value } = time;
    return (at) => {
      let i = 0;
      for (let high = rows.length - 2, low = 0; low <= high;) {
        i = (low + high) >> 1;
        if (rows[i + 1] < at) low = i + 1;
        else if (rows[i] > at) high = i - 1;
        else break;
      }
      const share = (at - rows[i]) / (rows[i + 1] - rows[i] || 1);
      return value[i] + share * ((value[i + 1] ?? value[i]) - value[i]);
    };
  }

  // ---- the request --------------------------------------------------------------------------------

  // First and last time and the step of the first experiment, or null: what effects are told of the data.
  span() {
    if (!this.ready) return null;
    if (this.job) {
      const [{ t, dt }] = this.job.series;
      const n = length(this.job.series[0]);
      return n < 2 ? null : t ? { span: [t[0], t[n - 1]], dt: (t[n - 1] - t[0]) / (n - 1) } : { span: [0, (n - 1) * (dt ?? 1)], dt: dt ?? 1 };
    }
    const { time, rows } = this.files[0].preview;
    if (by("time").value) return time.problem ? null : { span: [time.first, time.last], dt: time.step };
    const step = this.step();
    return step > 0 && rows > 1 ? { span: [0, (rows - 1) * step], dt: step } : null;
  }

  // {series, files: [[name, File]]}; what is wrong goes into errors.
  request(errors, testFile) {
    if (this.job) return { series: this.job.series, files: [] };
    if (!this.files.length) {
      errors.push({ field: "file", message: "data are needed: choose a file" });
      return { series: [], files: [] };
    }
    const columns = { y: {}, u: {} };
    for (const { member, name } of this.channels) {
      columns[member][name] = this.mapping.get(`${member}.${name}`);
      if (!columns[member][name]) errors.push({ field: `series[0].${member}.${name}`, message: "no column is chosen for this channel" });
    }
    const how = { ...columns, time_unit: by("time-unit").value.trim() || "s" };
    if (by("hold").value) how.hold = by("hold").value;
    if (by("by").value) how.by = by("by").value;
    if (this.extra.size) how.extra = [...this.extra];
    const { time } = this.files[0].preview;
    const spared = by("time").value !== this.found && !this.channels.some(({ member, name }) => columns[member][name] === this.found);
    if (by("time").value) {
      how.t = by("time").value;
      if (time?.problem) errors.push({ field: "series[0].t", message: `column '${time.column}': ${time.problem}` });
    } else if (by("dt").value.trim() || spared) {
      // No step is sent that nobody typed, so that the job notes what it assumed.
      how.dt = Number(by("dt").value);
      if (!(how.dt > 0)) errors.push({ field: "series[0].dt", message: "a positive time step is needed" });
    }
    const files = this.files.map(({ name, file }) => [name, file]);
    const request = { series: files.map(([name]) => ({ file: name, ...how })), files };
    if (testFile) {
      request.test = { file: `held-out-${testFile.name}`, ...how };
      request.files = [...files, [request.test.file, testFile]];
    }
    return request;
  }

  complain(text) {
    this.complainAt('[data-field~="file"]', text);
  }

  complainAt(where, text) {
    const place = document.querySelector(where);
    place.querySelector(".field-error")?.remove();
    if (text) place.append(element("p", { class: "field-error", role: "alert" }, text));
  }
}

function preview(file, name, time, unit, records) {
  const form = new FormData();
  form.append("file", file, name);
  if (time) form.append("t", time);
  if (unit) form.append("time_unit", unit);
  if (records) form.append("by", records);
  return post("/preview", form);
}

// What of the model counts time otherwise than the data, [name, unit], and in what, as engine/statespace/clock.py.
function otherClock(units, rates, clock) {
  const counts = (words) => ([, text]) => new RegExp(`(^|[^\\p{L}])(${words})(?!\\p{L})`, "u").test(text);
  const seconds = counts("s|Hz");
  const found = units.find(seconds);
  if (clock === "s" ? found : rates.some(counts(clock.replace(/[^\p{L}]/gu, "."))) && !rates.some(seconds)) return [];
  if (found) return [found, "s"];
  const rate = ([, text]) => /\/.*?(?<!\p{L})(min|hr?|d|day|week|month|year)(?!\p{L})/u.exec(text)?.[1];
  const other = rates.find((one) => rate(one) && rate(one) !== clock);
  return other ? [other, rate(other)] : [];
}

// A time with as many digits as tell it from the next.
function stamp(x, { first, last, step }) {
  const largest = Math.max(Math.abs(first), Math.abs(last));
  return String(Number(x.toPrecision(Math.min(Math.max(5, Math.ceil(Math.log10(largest / step)) + 2), 15))));
}

function length(series) {
  return (series.y ?? series.u ?? series.t).length;
}

// The columns of a job's series, as a preview has them.
function jobColumns(series, channels) {
  const index = { y: 0, u: 0 };
  return channels.map(({ member, name }) => {
    const at = index[member]++;
    const value = member === "u" && series.extra?.[name] ? series.extra[name] : (series[member] ?? []).map((row) => row[at] ?? null);
    const there = value.filter((v) => v !== null);
    const gaps = [];
    value.forEach((v, i) => {
      if (v !== null) return;
      if (gaps.at(-1)?.[1] === i - 1) gaps.at(-1)[1] = i;
      else gaps.push([i, i]);
    });
    const [minimum, maximum] = there.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    return { name, rows: value.length, missing: value.length - there.length, minimum, maximum, problem: null, row: value.map((_, i) => i), value, gaps };
  });
}

// What is wrong with columns that cannot be used. A second line of units spoils them all.
function problems(columns) {
  const bad = columns.filter((one) => one.problem && !one.dates);
  if (bad.length === columns.length && bad.every((one) => /\bline 2\b/.test(one.problem))) {
    return [`No column can be used: line 2 holds no numbers. If it is a line of units, delete it; the model says which units it needs. (${bad[0].problem})`];
  }
  return bad.map((one) => `Column ${one.name} cannot be used: ${one.problem}`);
}

// Extra channels of a job's series that the model does not use.
function spare(series, channels) {
  const used = new Set(channels.map((one) => one.name));
  return Object.keys(series.extra ?? {}).filter((name) => !used.has(name));
}

function describe(column, channel) {
  const values = `${(column.rows - column.missing).toLocaleString("en")} values, ${number(column.minimum)} to ${number(column.maximum)}`;
  if (!column.missing) return values;
  const missing = `${column.missing.toLocaleString("en")} missing`;
  return channel.member === "u" ? `${missing}; an input must be known at every sample` : `${values}; ${missing}`;
}
