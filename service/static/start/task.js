// Step 3: the question, and how to answer it.

const kinds = [...document.querySelectorAll('input[name="kind"]')];
const ONLY_EM = ["first", "iterations", "particles", "starts", "bootstrap", "intervals"];
const details = document.getElementById("options");

export class TaskCard {
  constructor(onChange) {
    this.onChange = onChange;
    for (const radio of kinds) radio.addEventListener("change", () => this.show());
    details.addEventListener("input", () => this.show());
  }

  get kind() {
    return kinds.find((radio) => radio.checked).value;
  }

  choose(kind) {
    kinds.find((radio) => radio.value === kind).checked = true;
    this.show();
  }

  show() {
    for (const box of details.querySelectorAll("[data-kind]")) box.hidden = !box.dataset.kind.split(" ").includes(this.kind);
    // the fit of the simulation has starts of its own and no iterations of EM
    const simulation = document.getElementById("estimate-method").value === "simulation";
    for (const name of ONLY_EM) document.querySelector(`[data-kind="estimate"] [data-field="options.${name}"]`).hidden = simulation;
    const text = this.inputs().filter((input) => input.dataset.type !== "bool" && input.value !== "").slice(0, 3)
      .map((input) => `${label(input)} ${input.selectedOptions?.[0].textContent.split(",")[0] ?? input.value}`);
    document.getElementById("options-text").textContent = text.join(", ");
    this.onChange();
  }

  inputs() {
    return [...details.querySelectorAll(`[data-kind="${this.kind}"] [data-option]`)].filter((input) => !input.closest("[hidden]"));
  }

  get testFile() {
    return ["estimate", "diagnose"].includes(this.kind) ? document.getElementById("test-file").files[0] ?? null : null;
  }

  fill(options, runSeconds) {
    for (const input of this.inputs()) {
      const value = options[input.dataset.option];
      if (value === undefined) continue;
      if (input.dataset.type === "bool") input.checked = value;
      else input.value = value === null ? "" : Array.isArray(value) ? value.join(", ") : String(value);
    }
    document.getElementById("run-seconds").value = runSeconds ?? "";
    this.show();
  }

  // {options, run_seconds?}; what is wrong goes into errors. An empty field leaves the default.
  request(errors) {
    const options = {};
    for (const input of this.inputs()) {
      const [name, type, text] = [input.dataset.option, input.dataset.type, input.value.trim()];
      if (type === "bool") options[name] = input.checked;
      else if (text === "") continue;
      else if (type === "text") options[name] = text;
      else if (type === "list") options[name] = text.split(/[,\s]+/).filter(Boolean);
      else if (Number.isFinite(Number(text)) && (type === "float" || Number.isInteger(Number(text)))) options[name] = Number(text);
      else errors.push({ field: `options.${name}`, message: `'${text}' is not a ${type === "int" ? "whole " : ""}number` });
    }
    const seconds = document.getElementById("run-seconds").value.trim();
    if (seconds === "") return { options };
    if (!(Number(seconds) > 0)) errors.push({ field: "run_seconds", message: "a positive number of seconds is needed" });
    return { options, run_seconds: Number(seconds) };
  }
}

function label(input) {
  return document.querySelector(`label[for="${input.id}"]`).textContent.toLowerCase();
}
