// The start page: a job in four steps. Addresses that fill it in:
//
//   /?model=NAME                a model
//   /?job=ID                    what an earlier job asked, with its data
//   /?job=ID&extension=1        the same with the extension that this diagnosis found, to estimate it

import { announce, element, clearProblem, get, post, Problem, showProblem, words } from "/static/api.js";
import { DataCard } from "/static/start/data.js";
import { ModelCard } from "/static/start/model.js";
import { ParameterTable } from "/static/start/parameters.js";
import { TaskCard } from "/static/start/task.js";

const form = document.getElementById("job");
const by = (id) => document.getElementById(id);

const parameters = new ParameterTable(refresh);
const task = new TaskCard(() => {
  parameters.showKind(["estimate", "diagnose"].includes(task.kind));
  refresh();
});
const data = new DataCard(() => refresh());
const model = new ModelCard(() => {
  data.setModel(model.document);
  parameters.setModel(model.document?.parameters ?? []);
});

// ---- the request --------------------------------------------------------------------------------

function build() {
  const errors = [];
  if (!model.name) errors.push({ field: "model", message: "choose a model" });
  const { options, run_seconds } = task.request(errors);
  const request = { kind: task.kind, model: model.reference() };
  const noData = task.kind === "simulate" && !data.ready;
  const { series, test, files } = noData ? { series: [], files: [] } : data.request(errors, task.testFile);
  request.series = task.kind === "simulate" && data.job ? series.map(inputsOnly) : series;
  if (test) request.test = test;
  request.parameters = parameters.request(errors);
  request.options = options;
  if (run_seconds) request.run_seconds = run_seconds;
  if (by("job-name").value.trim()) request.name = by("job-name").value.trim();
  const tags = words(by("job-tags").value);
  if (tags.length) request.tags = tags;
  if (data.job?.names.length) request.data = data.job.names;
  return { request, files, errors };
}

// A simulation that reads an earlier job's data keeps its length in one place, the series.
function inputsOnly({ y, u, t, dt, hold, time_unit, extra }) {
  return { y, u, t, dt, hold, time_unit, extra };
}

async function send(event) {
  event.preventDefault();
  clearProblem(form);
  const { request, files, errors } = build();
  if (errors.length) return showProblem(form, new Problem(422, { errors }));
  by("go").disabled = true;
  by("sending").textContent = "Sending ...";
  try {
    const job = files.length ? await post("/jobs/upload", multipart(request, files)) : await post("/jobs", request);
    location.href = `/jobs/${job.jobID}`;
  } catch (error) {
    by("go").disabled = false;
    by("sending").textContent = "";
    if (!(error instanceof Problem)) throw error;
    openDetails(error);
    showProblem(form, error);
  }
}

function multipart(request, files) {
  const body = new FormData();
  body.append("request", JSON.stringify(request));
  for (const [name, file] of files) body.append("file", file, name);
  return body;
}

// Fields in folded parts are unfolded before a message is put beside them.
function openDetails(problem) {
  for (const { field = "" } of problem.errors) {
    if (/^(options|test|run_seconds)/.test(field)) by("options").open = true;
    if (field === "model.with") by("effects-details").open = true;
  }
}

// ---- the summary --------------------------------------------------------------------------------

function refresh() {
  const free = parameters.free().length;
  const total = parameters.parameters.length;
  const estimating = parameters.estimating;
  const mapped = data.channels.filter((c) => data.job || data.mapping.get(`${c.member}.${c.name}`)).length;
  const names = data.job ? data.job.names.join(", ") || "data of an earlier job" : data.files.map((one) => one.name).join(", ");
  const optional = task.kind === "simulate" && !data.ready;
  const checks = [
    [Boolean(model.name), model.name ? `Model ${[model.name, ...model.effects].join(" + ")}` : "Choose a model"],
    [data.ready || optional, data.ready ? `Data: ${names}` : optional ? "No data: options give the number of samples" : "Choose a data file"],
    ...(data.ready && model.name ? [[mapped === data.channels.length, mapped < data.channels.length ? `${mapped} of ${data.channels.length} channels have a column` : "Every channel has a column"]] : []),
    [true, by("job").querySelector('input[name="kind"]:checked + span strong').textContent],
    ...(model.name && estimating ? [[free > 0, `${free} of ${total} parameters free`]] : []),
  ];
  by("checks").replaceChildren(...checks.map(([good, text]) => element("li", { class: good ? "good" : "open" },
    element("span", { class: "unseen" }, good ? "done: " : "to do: "), text)));
  showRequest();
}

function showRequest() {
  if (!by("as-request").open) return;
  const { request, files } = build();
  const shown = { ...request, series: data.job ? [`... ${data.job.series.length} series of the earlier job`] : request.series };
  const call = files.length ? ["POST /jobs/upload", `file: ${files.map(([name]) => name).join(", ")}`, "request:"] : ["POST /jobs"];
  by("request-text").textContent = [...call, JSON.stringify(shown, null, 1)].join("\n");
}

// ---- filling in ---------------------------------------------------------------------------------

async function repeat(id, adopt) {
  const asked = await get(`/jobs/${id}/request`);
  const found = adopt ? (await get(`/jobs/${id}/results`)).diagnosis.extension : null;
  task.choose(adopt ? "estimate" : asked.kind);
  if (!adopt) task.fill(asked.options, asked.run_seconds);
  await model.choose(found?.model ?? asked.model);
  if (asked.series.length) data.takeJob(id, asked.series, asked.data ?? []);
  by("job-name").value = asked.name ?? "";
  by("job-tags").value = (asked.tags ?? []).join(", ");
  parameters.fill(found?.theta ?? asked.parameters.start ?? asked.parameters.values, found?.free ?? asked.parameters.free ?? null);
  const note = by("repeated");
  note.hidden = false;
  note.replaceChildren("Filled in from job ", element("a", { href: `/jobs/${id}` }, id.slice(0, 8)),
    adopt ? ", with the extension its diagnosis found. Start estimates the extended model." : ". Change what you like.",
    asked.test && !adopt ? " Its held-out data are not taken over; choose the file again under Options." : "");
}

async function example() {
  const answer = await fetch("/examples/nile.csv");
  const file = new File([await answer.blob()], "nile.csv", { type: "text/csv" });
  if (model.name !== "local-level") await model.choose({ name: "local-level" });
  await data.take([file]);
  await data.useTime("year");
  announce("The Nile flows are loaded and the model local-level is chosen.");
  by("go").focus();
}

async function open() {
  const query = new URLSearchParams(location.search);
  task.show();
  try {
    await model.load();
    if (query.get("job")) await repeat(query.get("job"), query.has("extension"));
    else if (query.get("model")) await model.choose({ name: query.get("model") });
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    showProblem(form, new Problem(error.status, { detail: error.message }));
  }
  form.dataset.ready = "";
}

form.addEventListener("submit", send);
by("as-request").addEventListener("toggle", showRequest);
by("example").addEventListener("click", example);
open();
