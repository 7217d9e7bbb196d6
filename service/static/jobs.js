// The list of jobs. Its filter, its order and its place are in the address, as the JSON call has them:
// /jobs?status=running&kind=estimate&model=servo&tag=pump&sort=-duration&cursor=17

import { announce, duration, element, get, number, patch, poll, post, printed, Problem, remove, value, when, words } from "/static/api.js";

const by = (id) => document.getElementById(id);
const FILTERS = ["status", "kind", "model", "outcome", "tag", "search"];
const KEPT = [...FILTERS, "sort", "cursor"];
const VALUES = 3; // of a result, before the others are folded away
const VERDICTS = { named: "successful", converged: "successful", nothing: "", set: "running", unknown: "failed" };
const chosen = new Set(); // jobs to compare
const PAGE = 25;
const LIVE = new Set(["accepted", "running"]);
let query = new URLSearchParams(location.search);
let known = new Map(); // jobID -> status, to tell what has changed
let asked = 0; // the latest request for the list; answers to earlier ones are dropped

function address() {
  const wanted = new URLSearchParams([...query].filter(([name, value]) => value && KEPT.includes(name)));
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
    return error.passing ? 5000 : null;
  }
  if (mine !== asked) return 2000;
  by("problem").hidden = true;
  show(list);
  return list.jobs.some((job) => LIVE.has(job.status)) ? 1500 : 6000;
}

function show({ jobs, links }) {
  const next = links.find((link) => link.rel === "next");
  const focused = document.activeElement?.dataset.key;
  const open = new Set([...document.querySelectorAll("#jobs details[open]")].map((one) => one.closest("tr").dataset.job));
  by("jobs").hidden = !jobs.length;
  by("jobs").tBodies[0].replaceChildren(...jobs.map(row));
  for (const id of open) document.querySelector(`tr[data-job="${CSS.escape(id)}"] details`)?.setAttribute("open", "");
  by("tags").replaceChildren(...[...new Set(jobs.flatMap((job) => job.tags))].sort().map((tag) => element("option", { value: tag })));
  offerComparison();
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
  const name = [job.name, `${job.kind} with ${job.model}`, when(job.created)].filter(Boolean).join(", ");
  const [model, ...effects] = job.model.split("+");
  return element("tr", { "data-job": job.jobID },
    element("td", {}, compared(job, name)),
    element("td", { class: "name" },
      element("a", { href: `/jobs/${job.jobID}`, "data-key": `open ${job.jobID}`, "aria-label": name }, job.name || job.kind),
      job.name ? element("span", { class: "muted" }, ` ${job.kind}`) : null,
      job.tags.map((tag) => element("button", { type: "button", class: "tag", "aria-label": `Only jobs with the tag ${tag}`, onclick: () => filter("tag", tag) }, tag))),
    element("td", {}, element("span", { class: `badge ${job.status}` }, job.status)),
    element("td", {}, element("span", { class: "model" }, model), effects.length ? element("span", { class: "muted" }, ` + ${effects.join(" + ")}`) : null),
    element("td", { class: "data" }, job.data.join(", ")),
    element("td", {}, element("time", { datetime: job.created }, when(job.created))),
    element("td", { class: "progress" }, ...progress(job, name)),
    element("td", { class: "outcome" }, ...outcome(job)),
    element("td", {}, element("div", { class: "actions" }, ...actions(job, name))),
  );
}

// Two jobs with results are compared; a third takes the place of the first.
function compared(job, name) {
  if (!job.links.some((link) => link.rel === "results")) return "";
  return element("input", {
    type: "checkbox", checked: chosen.has(job.jobID), "data-key": `choose ${job.jobID}`, "aria-label": `Compare ${name}`,
    onchange: (event) => {
      if (event.target.checked) chosen.add(job.jobID);
      else chosen.delete(job.jobID);
      const [first] = chosen;
      if (chosen.size > 2) {
        chosen.delete(first);
        const box = document.querySelector(`[data-key="choose ${CSS.escape(first)}"]`);
        if (box) box.checked = false;
      }
      offerComparison();
    },
  });
}

function offerComparison() {
  const [a, b] = chosen;
  by("compare").toggleAttribute("href", Boolean(b));
  if (b) by("compare").href = `/compare?a=${a}&b=${b}`;
  by("compare").setAttribute("aria-disabled", String(!b));
  by("compare").title = b ? "" : "Mark two jobs that have results";
}

function progress(job, name) {
  if (job.status === "running") {
    const left = job.estimated_end ? (new Date(job.estimated_end) - Date.now()) / 1000 : null;
    return [
      element("progress", { max: 100, value: job.progress, "aria-label": `Progress of ${name}` }),
      element("span", { class: "small muted" }, `${job.progress} %${job.stage && job.stage !== "iterations" ? `, ${job.stage}` : left > 0 ? `, iterations: ${duration(left)} left at most` : ""}`),
    ];
  }
  if (job.status === "accepted") return [element("span", { class: "muted" }, "waits")];
  const seconds = job.started && job.finished ? (new Date(job.finished) - new Date(job.started)) / 1000 : null;
  return [element("span", { class: "muted" }, seconds === null ? "" : `took ${duration(seconds)}`)];
}

function outcome(job) {
  const verdict = job.outcome ? element("span", { class: `badge ${VERDICTS[job.outcome] ?? ""}` }, job.outcome.replaceAll("-", " ")) : null;
  if (job.status !== "successful" || job.kind === "diagnose") return [verdict, " ", printed(job.message) || latest(job)];
  const items = job.values.map((one) => element("div", {}, element("dt", {}, one.name), element("dd", {}, value(one))));
  const list = (some) => element("dl", { class: "values" }, some);
  return [verdict, list(items.slice(0, VALUES)),
    items.length > VALUES ? element("details", {}, element("summary", {}, `${items.length - VALUES} more`), list(items.slice(VALUES))) : null].filter(Boolean);
}

function latest(job) {
  return job.log_likelihood === null ? "" : `log-likelihood ${number(job.log_likelihood, 6)}`;
}

function actions(job, name) {
  const button = (text, key, onclick) => element("button", {
    type: "button", class: "small", "data-key": `${key} ${job.jobID}`, "aria-label": `${text}: ${name}`, onclick,
  }, text);
  const link = (text, href, label) => element("a", { class: "button small", href, "data-key": `${text} ${job.jobID}`, "aria-label": `${label}: ${name}` }, text);
  if (LIVE.has(job.status)) return [button("Name", "labels", () => label(job)), button("Stop", "end", () => end(job, "Stop this job?", "It stops at once; what it has computed so far is kept, and it can go on later.", "Stop the job", () => post(`/jobs/${job.jobID}/stop`)))];
  const kept = job.links.some((one) => one.rel === "resume");
  if (job.status === "dismissed" && !kept) return [];
  return [
    button("Name", "labels", () => label(job)),
    ...(job.kind === "design" ? [] : [link("Repeat", `/?job=${job.jobID}`, "Repeat with changes")]),
    ...(job.kind === "diagnose" && job.status === "successful" ? [link("Extend", `/?job=${job.jobID}&extension=1`, "Estimate the extension it found")] : []),
    button("Remove", "end", () => end(job, "Remove this job?", "Its data and its results are removed for good.", "Remove", () => remove(`/jobs/${job.jobID}`))),
  ];
}

async function label(job) {
  const dialog = by("labels");
  by("label-name").value = job.name;
  by("label-tags").value = job.tags.join(", ");
  by("label-error").textContent = "";
  for (;;) {
    dialog.returnValue = "cancel";
    dialog.showModal();
    await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
    if (dialog.returnValue !== "ok") return;
    try {
      await patch(`/jobs/${job.jobID}`, { name: by("label-name").value.trim(), tags: words(by("label-tags").value) });
      break;
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      by("label-error").textContent = error.errors[0]?.message ?? error.message;
    }
  }
  await refresh();
}

async function end(job, title, text, yes, act) {
  const dialog = by("sure");
  by("sure-title").textContent = title;
  by("sure-text").textContent = `${job.kind} with ${job.model}, ${when(job.created)}. ${text}`;
  by("sure-yes").textContent = yes;
  dialog.returnValue = "no";
  dialog.showModal();
  await new Promise((resolve) => dialog.addEventListener("close", resolve, { once: true }));
  if (dialog.returnValue !== "yes") return;
  await act();
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

async function filter(name, wanted) {
  await change({ [name]: wanted, cursor: "" });
  fillForm();
}

function fillForm() {
  for (const name of [...FILTERS, "sort"]) {
    const wanted = query.get(name) ?? "";
    const input = by(name);
    if (input.options && ![...input.options].some((one) => one.value === wanted)) input.append(element("option", { value: wanted }, wanted));
    input.value = wanted;
  }
  showOrder();
}

function showOrder() {
  const sort = query.get("sort") || "-created";
  for (const head of document.querySelectorAll("th[data-sort]")) {
    const mine = head.dataset.sort === sort.replace(/^-/, "");
    head.setAttribute("aria-sort", !mine ? "none" : sort.startsWith("-") ? "descending" : "ascending");
  }
}

// A click on a column's head sorts by it, another the other way round.
function sortBy(key) {
  const now = query.get("sort") || "-created";
  const next = now === key ? `-${key}` : key;
  return filter("sort", next === "-created" ? "" : next);
}

async function offerModels() {
  const { models } = await get("/models");
  by("model").append(...models.map((one) => element("option", {}, one.name)));
}

by("filters").addEventListener("change", (event) => change({ [event.target.name]: event.target.value, cursor: "" }));
by("filters").addEventListener("submit", (event) => event.preventDefault());
by("clear").addEventListener("click", async () => {
  await change(Object.fromEntries([...FILTERS, "cursor"].map((name) => [name, ""])));
  fillForm();
});
by("sort").addEventListener("change", () => filter("sort", by("sort").value));
for (const head of document.querySelectorAll("th[data-sort]")) head.querySelector("button").addEventListener("click", () => sortBy(head.dataset.sort));
by("older").addEventListener("click", () => change({ cursor: by("older").dataset.cursor }));
by("newer").addEventListener("click", () => change({ cursor: "" }));
addEventListener("popstate", () => {
  query = new URLSearchParams(location.search);
  fillForm();
  refresh();
});
offerModels().then(fillForm, () => fillForm()); // the list itself says what is wrong
poll(refresh);
