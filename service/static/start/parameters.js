// Step 4: which parameters are free, and where they start.

import { element, number, unit } from "/static/api.js";

const table = document.getElementById("parameters");
const body = table.querySelector("tbody");
const all = document.getElementById("free-all");

export class ParameterTable {
  constructor(onChange) {
    this.onChange = onChange;
    this.parameters = [];
    this.estimating = true;
    body.addEventListener("input", () => this.changed());
    all.addEventListener("change", () => {
      for (const box of this.boxes()) box.checked = all.checked;
      this.changed();
    });
  }

  boxes() {
    return [...body.querySelectorAll('input[type="checkbox"]')];
  }

  // Keeps what was typed for parameters that the new model has too.
  setModel(parameters) {
    const typed = new Map([...body.querySelectorAll("tr")].map((row) => [row.dataset.name, {
      value: row.querySelector(".value").value,
      free: row.querySelector('input[type="checkbox"]').checked,
      edited: row.querySelector(".value").value !== row.dataset.default,
    }]));
    const same = (p) => this.parameters.some((q) => q.name === p.name && q.default === p.default && q.unit === p.unit);
    this.parameters = parameters;
    body.replaceChildren(...parameters.map((p) => this.row(p, same(p) ? typed.get(p.name) : null)));
    table.hidden = !parameters.length;
    this.showKind(this.estimating);
    this.changed();
  }

  row(p, typed) {
    const text = String(p.default);
    // A model says so in words where the data cannot tell a parameter from others.
    const free = typed?.free ?? !/\bkeep it fixed\b/i.test(p.description);
    return element("tr", { "data-name": p.name, "data-default": text },
      element("td", { class: "free-column" }, element("input", {
        type: "checkbox", checked: free, "aria-label": `${p.name} is free`,
      })),
      element("th", { scope: "row" }, p.name),
      element("td", { "data-field": `parameters.start.${p.name} parameters.values.${p.name}` }, element("input", {
        type: "text", inputmode: "decimal", class: "value", value: typed?.edited ? typed.value : text,
        "aria-label": `Start value of ${p.name}${p.unit ? ` in ${p.unit}` : ""}`, autocomplete: "off",
      })),
      element("td", { class: "unit" }, p.unit === "1" ? "" : unit(p.unit)),
      element("td", { class: "muted bounds" }, bounds(p.bounds)),
      element("td", { class: "muted meaning" }, p.description),
    );
  }

  // values {name: number}; free: names, or null for all
  fill(values, free) {
    for (const row of body.querySelectorAll("tr")) {
      const value = values[row.dataset.name];
      if (value !== undefined) {
        row.querySelector(".value").value = String(value);
        row.dataset.given = ""; // an earlier job named it, so that one like it does too
      }
      if (free !== undefined) row.querySelector('input[type="checkbox"]').checked = free === null || free.includes(row.dataset.name);
    }
    this.changed();
  }

  showKind(estimating) {
    this.estimating = estimating;
    for (const cell of document.querySelectorAll("#parameters .free-column")) cell.hidden = !estimating;
    document.getElementById("value-head").textContent = estimating ? "Start value" : "Value";
    document.getElementById("parameters-hint").textContent = !this.parameters.length ? "Choose a model first." : estimating
      ? "Free parameters are estimated from their start value; the others keep it."
      : "The values at which the model runs.";
  }

  changed() {
    const boxes = this.boxes();
    all.checked = boxes.length > 0 && boxes.every((box) => box.checked);
    all.indeterminate = !all.checked && boxes.some((box) => box.checked);
    this.onChange();
  }

  free() {
    return [...body.querySelectorAll("tr")].filter((row) => row.querySelector('input[type="checkbox"]').checked).map((row) => row.dataset.name);
  }

  // {start, free} or {values}, of which each holds what is not as the model has it: a start that is given is
  // kept, where else one may be searched for. What is wrong goes into errors.
  request(errors) {
    const values = {};
    for (const row of body.querySelectorAll("tr")) {
      const text = row.querySelector(".value").value.trim();
      const member = this.estimating ? "start" : "values";
      if (text === "" || !Number.isFinite(Number(text))) {
        errors.push({ field: `parameters.${member}.${row.dataset.name}`, message: text ? `'${text}' is not a number` : "a number is needed" });
      } else if (text !== row.dataset.default || "given" in row.dataset) values[row.dataset.name] = Number(text);
    }
    const changed = Object.keys(values).length > 0;
    if (!this.estimating) return changed ? { values } : {};
    const free = this.free();
    if (!free.length && this.parameters.length) errors.push({ field: "parameters.free", message: "nothing is free; mark at least one parameter" });
    return { ...(changed && { start: values }), ...(free.length < this.parameters.length && { free }) };
  }
}

function bounds([low, high]) {
  if (low === null && high === null) return "";
  return `${low === null ? "-∞" : number(low)} ... ${high === null ? "∞" : number(high)}`;
}
