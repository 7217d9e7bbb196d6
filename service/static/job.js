// One job: live while it runs, then its report.

import { announce, duration, element, get, number, poll, post, Problem, unit, when } from "/static/api.js";
import { Convergence } from "/static/job/convergence.js";
import { showReport } from "/static/job/results.js";
import { download } from "/static/job/download.js";
import { inputFile, offer } from "/static/job/design.js";

const ENDED = ["successful", "failed", "dismissed"];
const KINDS = { estimate: "Estimate", smooth: "Smoothed states", simulate: "Simulation", diagnose: "Diagnosis", design: "Experiment" };
const ATTEMPTS = 200; // rows of the table of computations

const id = location.pathname.split("/")[2];
const here = `/jobs/${id}`;
const by = (name) => document.getElementById(name);
const convergence = new Convergence(here, by("traces"));
let said = "";
let shown = ""; // values of the result that is shown: without standard errors, or causes, while it runs

poll(async () => {
  try {
    return await look();
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    by("problem").hidden = false;
    by("problem").textContent = error.message;
    return error.passing ? 3000 : null;
  }
});

async function look() {
  const job = await get(here);
  by("problem").hidden = true;
  show(job);
  const iterates = job.kind === "estimate";
  if (ENDED.includes(job.status)) {
    await end(job);
    return null;
  }
  if (iterates && job.status === "running") {
    const { tasks } = await get(`${here}/tasks`);
    showAttempts(tasks);
    await convergence.update(tasks, job.model);
    by("live").hidden = convergence.empty;
    by("facts").replaceChildren(...facts(job));
    if (!shown && hasResults(job)) await showResults(job);
  }
  // what a diagnosis knows so far comes in two steps
  const known = job.kind === "diagnose" && job.status === "running" && hasResults(job);
  if (known && JSON.stringify(job.values) !== shown) await showResults(job);
  return job.status === "accepted" ? 500 : 1000;
}

function show(job) {
  const title = job.name || `${KINDS[job.kind] ?? job.kind}: ${job.model}`;
  document.title = `${title} - rbps`;
  by("title").textContent = title;
  by("status").textContent = job.status;
  by("status").className = `badge ${job.status}`;
  by("when").textContent = [job.name && `${KINDS[job.kind]}: ${job.model}`, `Job ${id.slice(0, 8)}`, job.data.join(", "),
    `sent ${when(job.created)}`, job.finished && `ended ${when(job.finished)}`].filter(Boolean).join(", ");
  by("tags").replaceChildren(...job.tags.map((tag) => element("li", {}, element("a", { href: `/jobs?tag=${encodeURIComponent(tag)}` }, tag))));
  const going = !ENDED.includes(job.status);
  by("stop").hidden = !going;
  by("resume").hidden = !resumable(job);
  offerMore(job);
  by("repeat").hidden = job.kind === "design" || (job.status === "dismissed" && !resumable(job));
  by("repeat").href = `/?job=${id}`;
  by("progress").hidden = !going;
  if (going) {
    by("reached")?.remove();
    if (job.status === "accepted") by("bar").removeAttribute("value");
    else by("bar").value = job.progress;
    by("message").textContent = job.message || (job.status === "accepted" ? "Waiting for a worker." : "Computing.");
    by("facts").replaceChildren(...facts(job));
  }
  if (said && said !== job.status) announce(`The job is ${job.status}.`);
  said = job.status;
}

// What a job had too little of can be more when it goes on: iterations, or seconds.
function offerMore(job) {
  const iterations = job.status === "successful";
  const wanted = resumable(job) && (iterations || job.cause === "run-time-exceeded");
  if (by("more").hidden !== wanted) return; // as before, perhaps with what was typed
  by("more").hidden = !wanted;
  by("more-of").textContent = iterations ? "Iterations in all" : "Seconds, if not as many again";
  by("more-value").name = iterations ? "iterations" : "run_seconds";
  by("more-value").step = iterations ? 1 : "any";
  by("more-value").value = iterations ? 2 * job.iterations : "";
}

function resumable(job) {
  return job.links.some((link) => link.rel === "resume");
}

function facts(job) {
  const items = [["progress", `${job.progress} %`]];
  if (job.kind === "estimate") items.push(["iteration", `${job.iteration} of ${job.iterations} at most`]);
  if (job.started) {
    const spent = (new Date(job.updated) - new Date(job.started)) / 1000;
    items.push(["running for", duration((Date.now() - new Date(job.started)) / 1000)]);
    if (job.stage === "iterations" && job.iteration && spent > 0) items.push(["rate", rate(job.iteration / spent)]);
  }
  if (job.stage) items.push(["stage", job.stage]);
  if (job.estimated_end) items.push(["left of this stage, at most", duration(Math.max(0, (new Date(job.estimated_end) - Date.now()) / 1000))]);
  if (job.log_likelihood !== null) items.push(["log-likelihood", number(job.log_likelihood, 6)]);
  if (convergence.ess !== null) items.push(["effective sample size", number(convergence.ess, 3)]);
  return items.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value)));
}

function rate(perSecond) {
  return perSecond >= 1 ? `${number(perSecond, 3)} iterations/s` : `${number(1 / perSecond, 3)} s per iteration`;
}

// ---- computations -----------------------------------------------------------------------------

function showAttempts(tasks) {
  by("attempts").hidden = tasks.length < 2;
  if (tasks.length < 2) return;
  const names = Object.keys(tasks.find((task) => task.estimate)?.estimate ?? {});
  const counts = {};
  const rows = tasks.slice(0, ATTEMPTS).map((task) => {
    counts[task.role] = (counts[task.role] ?? 0) + 1;
    const several = tasks.filter((other) => other.role === task.role).length > 1;
    const state = task.state + (task.restarts ? `, restarted ${task.restarts} times` : "");
    return element("tr", {},
      element("th", { scope: "row" }, several ? `${task.role} ${counts[task.role]}` : task.role),
      element("td", {}, element("span", { class: `badge ${BADGES[task.state] ?? ""}` }, state)),
      element("td", {}, task.estimate ? String(task.iteration) : ""),
      element("td", {}, task.log_likelihood === null ? "" : number(task.log_likelihood, 6)),
      names.map((name) => element("td", {}, task.estimate ? number(task.estimate[name], 5) : "")));
  });
  const head = ["", "state", "iteration", "log-likelihood", ...names];
  by("attempts-head").replaceChildren(element("tr", {}, head.map((name) => element("th", { scope: "col" }, name))));
  by("attempts-rows").replaceChildren(...rows);
}

const BADGES = { running: "running", done: "successful", stopped: "failed" };

// ---- the end ----------------------------------------------------------------------------------

async function end(job) {
  if (job.status === "failed") return failed(job);
  if (job.status === "dismissed") {
    by("problem").hidden = false;
    const told = job.message || "stopped";
    by("problem").textContent = told.startsWith("stopped") ? `This job was ${told}.` : `${told[0].toUpperCase()}${told.slice(1)}.`;
    if (hasResults(job)) return showResults(job);
    if (resumable(job)) await showHowFar(job);
    return undefined;
  }
  for (const name of ["attempts", "live"]) by(name).hidden = true;
  convergence.destroy();
  return showResults(job);
}

function hasResults(job) {
  return job.links.some((link) => link.rel === "results");
}

async function showResults(job) {
  const report = await get(`${here}/report`);
  shown = JSON.stringify(job.values);
  by("results").replaceChildren();
  showReport(by("results"), report, here);
  by("report").hidden = by("json").hidden = false;
  download(by("report"), `${here}/report`, `${job.kind}-${id.slice(0, 8)}.html`, "text/html");
  download(by("json"), `${here}/results`, `${job.kind}-${id.slice(0, 8)}.json`, "application/json");
  if (job.kind === "diagnose" && job.status === "successful") {
    const found = (await get(`${here}/results?points=2`)).diagnosis;
    by("extended").hidden = !found.causes.length;
    by("extended").href = `/?job=${id}&extension`;
    by("extended").classList.toggle("primary", found.gain?.adopt ?? false);
    offer(found);
  }
  if (job.kind === "design") await inputFile(by("input-file"), here, `input-${id.slice(0, 8)}.csv`);
  return undefined;
}

async function failed(job) {
  by("failure").hidden = false;
  by("cause").textContent = job.message;
  if (hasResults(job)) return showResults(job); // those so far, of a job whose time was up
  try {
    by("advice").textContent = (await get(`${here}/results?points=2`)).message;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    by("advice").textContent = error.advice;
  }
  by("advice").hidden = !by("advice").textContent;
  return showHowFar(job);
}

async function showHowFar(job) {
  const { tasks } = await get(`${here}/tasks`);
  showAttempts(tasks);
  await convergence.update(tasks, job.model);
  by("live").hidden = convergence.empty;
  by("live-title").textContent = "Convergence up to there";
  if (job.kind === "estimate") await showReached();
}

// The values that an estimation has reached that was stopped, or had no more time.
async function showReached() {
  try {
    const { estimate } = await get(`${here}/results?points=2`);
    const rows = Object.entries(estimate).map(([name, one]) => element("tr", {}, element("th", { scope: "row" }, name),
      element("td", {}, number(one.value, 5)), element("td", {}, unit(one.unit === "1" ? "" : one.unit)), element("td", {}, one.fixed ? "held" : "")));
    const head = element("tr", {}, ["parameter", "value", "unit", ""].map((text) => element("th", { scope: "col" }, text)));
    by("results").replaceChildren(element("section", { class: "card", id: "reached" }, element("h2", {}, "Values so far"),
      element("div", { class: "scroll" }, element("table", { class: "numbers" }, element("thead", {}, head), element("tbody", {}, rows)))));
  } catch (error) {
    if (!(error instanceof Problem)) throw error; // it had not begun, or failed
  }
}

function onClick(button, action) {
  by(button).addEventListener("click", async () => {
    by(button).disabled = true;
    try {
      await action();
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      by("problem").hidden = false;
      by("problem").textContent = error.message;
    } finally {
      by(button).disabled = false;
    }
  });
}

onClick("stop", async () => {
  if (!confirm("Stop this job? What it has computed so far is kept, and it can go on later.")) return;
  const job = await post(`${here}/stop`); // one that ended while the question was open stays as it is
  show(job);
  await end(job);
});

onClick("resume", async () => {
  const { name, value } = by("more-value");
  await post(`${here}/resume`, by("more").hidden || value === "" ? undefined : { [name]: Number(value) });
  location.reload();
});
