// The form of a diagnosis' page that asks for the next experiment, and the file of a designed input.

import { element, get, post, Problem } from "/static/api.js";

const by = (name) => document.getElementById(name);
const SHOWN = 3; // nearest names that are offered where fewer than two cannot be told apart

// What the diagnosis could not tell apart, as in service/designs.py.
export function rivals(diagnosis) {
  const rounds = diagnosis.rounds.filter((one) => one.refitted.length);
  const several = rounds.find((one) => one.refitted.filter((r) => r.equivalent).length > 1);
  const refitted = (several ?? rounds.at(-1) ?? { refitted: [] }).refitted;
  const alike = refitted.filter((one) => one.equivalent);
  if (alike.length < 2 || diagnosis.verdict === "unknown") alike.push(...refitted.filter((one) => !one.equivalent).slice(0, SHOWN));
  return alike.length > 1 && alike.every((one) => one.parameters) ? alike : [];
}

export function offer(diagnosis) {
  const causes = rivals(diagnosis);
  const inputs = Object.entries(diagnosis.channels.inputs ?? {});
  if (!causes.length || !inputs.length) return;
  by("next").hidden = false;
  by("next").addEventListener("click", () => { by("design").hidden = false; by("design").scrollIntoView(); by("design-length").focus(); });
  by("design-causes").replaceChildren(...causes.map((one) => element("label", { class: "check" },
    element("input", { type: "checkbox", checked: "", value: one.effect }), ` ${one.effect}`)));
  by("design-inputs").replaceChildren(...inputs.map(([name, unit]) => element("tr", {}, element("th", { scope: "row" }, name),
    ["low", "high", "rate"].map((what) => element("td", {}, element("input", {
      type: "number", step: "any", "data-input": name, "data-what": what, required: what === "rate" ? null : "",
      "aria-label": `${name}: ${what}`, placeholder: what === "rate" ? "any" : unit }))))));
  by("design-dt").value = diagnosis.extension.model.setting.dt;
  by("design-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    by("design-problem").hidden = true;
    try {
      location.href = (await post("/jobs", request(diagnosis, causes))).links.find((one) => one.rel === "self").href;
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      by("design-problem").hidden = false;
      by("design-problem").textContent = error.message;
    }
  });
}

function request(diagnosis, causes) {
  const inputs = {};
  for (const box of by("design-inputs").querySelectorAll("input")) {
    inputs[box.dataset.input] ??= {};
    if (box.value !== "") inputs[box.dataset.input][box.dataset.what] = Number(box.value);
  }
  const wanted = [...by("design-causes").querySelectorAll("input:checked")].map((box) => box.value);
  const chosen = causes.filter((one) => wanted.includes(one.effect));
  const setting = diagnosis.extension.model;
  return {
    kind: "design",
    model: setting.name,
    parameters: { start: diagnosis.base_theta, free: Object.keys(diagnosis.base_standard_errors) },
    options: {
      causes: Object.fromEntries(chosen.map((one) => [one.effect, one.parameters])),
      bounds: { inputs, dt: Number(by("design-dt").value) },
      length: Number(by("design-length").value),
    },
  };
}

// A link to the designed input as a CSV file.
export async function inputFile(link, here, name) {
  const { design } = await get(`${here}/results`);
  const { t, u } = design.experiment;
  const names = Object.keys(u);
  const rows = t.map((time, i) => [time, ...names.map((one) => u[one][i])].join(","));
  link.href = URL.createObjectURL(new Blob([["t", ...names].join(","), "\n", rows.join("\n"), "\n"], { type: "text/csv" }));
  link.download = name;
  link.hidden = false;
}
