// The form of a diagnosis' page that asks for the next experiment, and the file of a designed input.

import { element, get, post, Problem } from "/static/api.js";
import { isTime } from "/static/start/match.js";

const by = (name) => document.getElementById(name);
const CELLS = { low: "number", high: "number", rate: "number", forbidden: "text", stopbands: "text" };
const HINTS = { rate: "any", forbidden: "-0.5:0.5, 2:3", stopbands: "4:6" };

export function offer(diagnosis) {
  const inputs = Object.entries(diagnosis.channels.inputs ?? {});
  if (!diagnosis.next || !inputs.length) return; // fewer than two causes were weighed, or nothing can be tried
  by("next").hidden = false;
  by("next").addEventListener("click", () => { by("design").hidden = false; by("design").scrollIntoView(); by("design-length").focus(); });
  const clock = diagnosis.time_unit ?? "s";
  for (const place of by("design").querySelectorAll("[data-clock]")) place.textContent = clock;
  for (const place of by("design").querySelectorAll("[data-frequency]")) place.textContent = clock === "s" ? "Hz" : `1/${clock}`;
  by("design-causes").replaceChildren(...Object.keys(diagnosis.next.causes).map((name) => element("label", { class: "check" },
    element("input", { type: "checkbox", checked: "", value: name }), ` ${name}`)));
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
      location.href = (await post("/jobs", request(diagnosis))).links.find((one) => one.rel === "self").href;
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      by("design-problem").hidden = false;
      by("design-problem").textContent = error.message;
    }
  });
}

// "1:2, 3:4" as [[1, 2], [3, 4]]; what is none is told with the field's name.
function bands(text, field) {
  return text.split(",").map((band) => {
    const ends = band.split(":").map((end) => (end.trim() === "" ? NaN : Number(end)));
    if (ends.length === 2 && ends.every(Number.isFinite)) return ends;
    throw new Problem(422, { detail: `${field}: '${band.trim()}' is not from:to; commas part bands, and decimals have a point` });
  });
}

function rows(id) {
  const found = {};
  for (const box of by(id).querySelectorAll("input")) {
    const own = (found[box.dataset.name] ??= {});
    const text = box.value.trim();
    if (text !== "") own[box.dataset.what] = box.type === "text" ? bands(text, box.getAttribute("aria-label")) : Number(text);
  }
  return found;
}

function request(diagnosis) {
  const wanted = [...by("design-causes").querySelectorAll("input:checked")].map((box) => box.value);
  const { model, theta, free, causes, alarm, measured } = diagnosis.next;
  const { hold } = diagnosis.extension;
  const kept = Object.entries(rows("design-states")).filter(([, one]) => "low" in one || "high" in one);
  const bounds = {
    inputs: rows("design-inputs"),
    states: Object.fromEntries(kept.map(([state, one]) => [state, [one.low ?? null, one.high ?? null]])),
    dt: Number(by("design-dt").value),
  };
  if (hold) bounds.hold = hold;
  if (diagnosis.time_unit) bounds.time_unit = diagnosis.time_unit;
  if (model.setting.substeps) bounds.substeps = model.setting.substeps;
  return {
    kind: "design",
    model,
    parameters: { start: theta, free },
    options: {
      causes: Object.fromEntries(wanted.map((name) => [name, causes[name]])),
      bounds,
      length: Number(by("design-length").value),
      alarm,
      measured,
    },
  };
}

// The head of a file of inputs, as Design.to_csv writes it: it tells the unit of time to who reads it.
function head(clock, names) {
  const time = `t [${clock}]`;
  if (clock === "s") return ["t", ...names].join(",");
  return isTime(time) ? [time, ...names].join(",") : `# time unit: ${clock}\n${["t", ...names].join(",")}`;
}

// A link to the designed input as a CSV file.
export async function inputFile(link, here, name) {
  const { design } = await get(`${here}/results`);
  const { t, u } = design.experiment;
  const names = Object.keys(u);
  const rows = t.map((time, i) => [time, ...names.map((one) => u[one][i])].join(","));
  link.href = URL.createObjectURL(new Blob([head(design.time_unit ?? "s", names), "\n", rows.join("\n"), "\n"], { type: "text/csv" }));
  link.download = name;
  link.hidden = false;
}
