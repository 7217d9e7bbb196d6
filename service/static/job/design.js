// The form of a diagnosis' page that asks for the next experiment, and the file of a designed input.

import { element, get, post, Problem } from "/static/api.js";

const by = (name) => document.getElementById(name);
const CELLS = { low: "number", high: "number", rate: "number", forbidden: "text", stopbands: "text" };
const HINTS = { rate: "any", forbidden: "-0.5:0.5, 2:3", stopbands: "4:6" };
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
    Object.entries(CELLS).map(([what, type]) => element("td", {}, element("input", {
      type, step: type === "number" ? "any" : null, "data-name": name, "data-what": what, required: what in HINTS ? null : "",
      "aria-label": `${name}: ${what}`, placeholder: HINTS[what] ?? unit }))))));
  by("design-states").replaceChildren(...Object.entries(diagnosis.channels.states).map(([name, unit]) => element("tr", {},
    element("th", { scope: "row" }, name), ["low", "high"].map((what) => element("td", {}, element("input", {
      type: "number", step: "any", "data-name": name, "data-what": what, "aria-label": `${name}: ${what}`, placeholder: unit }))))));
  by("design-dt").value = diagnosis.extension.dt ?? diagnosis.extension.model.setting.dt;
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

// "1:2, 3:4" as [[1, 2], [3, 4]]; what is no number is refused by the service, which names the field.
function bands(text) {
  return text.split(",").map((band) => band.split(":").map((end) => (end.trim() === "" ? null : Number(end))));
}

function rows(id) {
  const found = {};
  for (const box of by(id).querySelectorAll("input")) {
    const own = (found[box.dataset.name] ??= {});
    const text = box.value.trim();
    if (text !== "") own[box.dataset.what] = box.type === "text" ? bands(text) : Number(text);
  }
  return found;
}

function request(diagnosis, causes) {
  const wanted = [...by("design-causes").querySelectorAll("input:checked")].map((box) => box.value);
  const chosen = causes.filter((one) => wanted.includes(one.effect));
  const { model: { name, setting }, hold } = diagnosis.extension;
  const kept = Object.entries(rows("design-states")).filter(([, one]) => "low" in one || "high" in one);
  const bounds = {
    inputs: rows("design-inputs"),
    states: Object.fromEntries(kept.map(([state, one]) => [state, [one.low ?? null, one.high ?? null]])),
    dt: Number(by("design-dt").value),
  };
  if (hold) bounds.hold = hold;
  if (setting.substeps) bounds.substeps = setting.substeps;
  return {
    kind: "design",
    model: name,
    parameters: { start: diagnosis.base_theta, free: Object.keys(diagnosis.base_standard_errors) },
    options: {
      causes: Object.fromEntries(chosen.map((one) => [one.effect, { ...one.parameters, ...told(one) }])),
      bounds,
      length: Number(by("design-length").value),
      alarm: diagnosis.rounds[0]?.threshold ?? null,
      measured: diagnosis.measured ?? null,
    },
  };
}

// What the record told of a cause's values, where the document has it in numbers.
function told({ information }) {
  return information?.matrix.flat().every((value) => value !== null) ? { information } : {};
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
