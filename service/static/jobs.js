// The list of jobs. Its filter and its place are in the address, as the JSON call has them:
// /jobs?status=running&kind=estimate&model=servo&cursor=17

import { announce, duration, element, get, number, poll, Problem, remove, when } from "/static/api.js";

const by = (id) => document.getElementById(id);
const FILTERS = ["status", "kind", "model"];
const PAGE = 25;
const LIVE = new Set(["accepted", "running"]);
let query = new URLSearchParams(location.search);
let known = new Map(); // jobID -> status, to tell what has changed
let asked = 0; // the latest request for the list; answers to earlier ones are dropped

function address() {
  const wanted = new URLSearchParams([...query].filter(([name, value]) => value && [...FILTERS, "cursor"].includes(name)));
  return `/jobs${wanted.size ? `?${wanted}` : ""}`;
}

async function refresh() {
  const wanted = new URLSearchParams(address().split("?")[1]);
  wanted.set("limit", PAGE);
  const mine = ++asked;
  let list;
  try {
    list = await get(`/jobs?${wanted}`);
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    by("problem").hidden = false;
    by("problem").textContent = error.message;
    return error.status === 0 ? 5000 : null;
  }
  if (mine !== asked) return 2000;
  by("problem").hidden = true;
  show(list);
  return list.jobs.some((job) => LIVE.has(job.status)) ? 1500 : 6000;
}

function show({ jobs, links }) {
  const next = links.find((link) => link.rel === "next");
  const focused = document.activeElement?.dataset.key;
  by("jobs").hidden = !jobs.length;
  by("jobs").tBodies[0].replaceChildren(...jobs.map(row));
  if (focused) document.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
  const filtered = FILTERS.some((name) => query.get(name));
  by("none").hidden = jobs.length > 0;
  by("none").textContent = filtered ? "No job matches this filter." : query.get("cursor") ? "There are no older jobs." : "There are no jobs yet. A new job needs a model and a file of measured data.";
  by("clear").hidden = !filtered;
  by("newer").hidden = !query.get("cursor");
  by("older").hidden = !next;
  if (next) by("older").dataset.cursor = new URLSearchParams(next.href.split("?")[1]).get("cursor");
  const changed = jobs.filter((job) => known.has(job.jobID) && known.get(job.jobID) !== job.status);
  if (changed.length) announce(changed.map((job) => `${job.kind} with ${job.model} is ${job.status}`).join("; "));
  known = new Map(jobs.map((job) => [job.jobID, job.status]));
}

function row(job) {
  const name = `${job.kind} with ${job.model}, ${when(job.created)}`;
  const [model, ...effects] = job.model.split("+");
  return element("tr", { "data-job": job.jobID },
    element("td", {}, element("span", { class: `badge ${job.status}` }, job.status)),
    element("td", {}, element("a", { href: `/jobs/${job.jobID}`, "data-key": `open ${job.jobID}`, "aria-label": name }, job.kind)),
    element("td", {}, model, effects.length ? element("span", { class: "muted" }, ` + ${effects.join(" + ")}`) : null),
    element("td", {}, element("time", { datetime: job.created }, when(job.created))),
    element("td", { class: "progress" }, ...progress(job, name)),
    element("td", { class: "outcome" }, outcome(job)),
    element("td", {}, element("div", { class: "actions" }, ...actions(job, name))),
  );
}

function progress(job, name) {
  if (job.status === "running") {
    const left = job.estimated_end ? (new Date(job.estimated_end) - Date.now()) / 1000 : null;
    return [
      element("progress", { max: 100, value: job.progress, "aria-label": `Progress of ${name}` }),
      element("span", { class: "small muted" }, `${job.progress} %${job.stage && !["iterations"].includes(job.stage) ? `, ${job.stage}` : left > 0 ? `, iterations ${duration(left)} more at most` : ""}`),
    ];
  }
  if (job.status === "accepted") return [element("span", { class: "muted" }, "waits")];
  const seconds = job.started && job.finished ? (new Date(job.finished) - new Date(job.started)) / 1000 : null;
  return [element("span", { class: "muted" }, seconds === null ? "" : `took ${duration(seconds)}`)];
}

function outcome(job) {
  if (job.message) return job.message;
  return job.log_likelihood === null ? "" : `log-likelihood ${number(job.log_likelihood, 6)}`;
}

function actions(job, name) {
  const button = (text, key, onclick) => element("button", {
    type: "button", class: "small", "data-key": `${key} ${job.jobID}`, "aria-label": `${text}: ${name}`, onclick,
  }, text);
  const link = (text, href, label) => element("a", { class: "button small", href, "data-key": `${text} ${job.jobID}`, "aria-label": `${label}: ${name}` }, text);
  if (LIVE.has(job.status)) return [button("Stop", "end", () => end(job, "Stop this job?", "It stops at once; what it has computed so far is kept, and it can go on later.", "Stop the job"))];
  const kept = job.links.some((one) => one.rel === "resume");
  if (job.status === "dismissed" && !kept) return [];
  return [
    link("Repeat", `/?job=${job.jobID}`, "Repeat with changes"),
    ...(job.kind === "diagnose" && job.status === "successful" ? [link("Extend", `/?job=${job.jobID}&extension=1`, "Estimate the extension it found")] : []),
    button("Remove", "end", () => end(job, "Remove this job?", "Its data and its results are removed for good.", "Remove")),
  ];
}

async function end(job, title, text, yes) {
  const dialog = by("sure");
  by("sure-title").textContent = title;
  by("sure-text").textContent = `${job.kind} with ${job.model}, ${when(job.created)}. ${text}`;
  by("sure-yes").textContent = yes;
  dialog.returnValue = "no";
  dialog.showModal();
  await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
  if (dialog.returnValue !== "yes") return;
  await remove(`/jobs/${job.jobID}`);
  await refresh();
}

async function change(values) {
  for (const [name, value] of Object.entries(values)) {
    if (value) query.set(name, value);
    else query.delete(name);
  }
  history.pushState(null, "", address());
  await refresh();
}

function fillForm() {
  for (const name of FILTERS) {
    const value = query.get(name) ?? "";
    const select = by(name);
    if (![...select.options].some((one) => one.value === value)) select.append(element("option", { value }, value));
    select.value = value;
  }
}

async function offerModels() {
  const { models } = await get("/models");
  by("model").append(...models.map((one) => element("option", {}, one.name)));
}

by("filters").addEventListener("change", (event) => change({ [event.target.name]: event.target.value, cursor: "" }));
by("filters").addEventListener("submit", (event) => event.preventDefault());
by("clear").addEventListener("click", async () => {
  await change({ status: "", kind: "", model: "", cursor: "" });
  fillForm();
});
by("older").addEventListener("click", () => change({ cursor: by("older").dataset.cursor }));
by("newer").addEventListener("click", () => change({ cursor: "" }));
addEventListener("popstate", () => {
  query = new URLSearchParams(location.search);
  fillForm();
  refresh();
});
offerModels().then(fillForm, () => fillForm()); // the list itself says what is wrong
poll(refresh);
