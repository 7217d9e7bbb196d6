// Two jobs side by side: /compare?a=ID&b=ID

import { element, get, Problem, when } from "/static/api.js";
import { download } from "/static/job/download.js";
import { showReport } from "/static/job/results.js";

const by = (id) => document.getElementById(id);
const query = new URLSearchParams(location.search);
const [a, b] = [query.get("a") ?? "", query.get("b") ?? ""];

async function open() {
  const asked = `a=${encodeURIComponent(a)}&b=${encodeURIComponent(b)}`;
  const [{ jobs }, report] = await Promise.all([get(`/compare?${asked}`), get(`/compare/report?${asked}`)]);
  by("title").textContent = report.title;
  document.title = `${report.title} - rbps`;
  by("jobs-compared").replaceChildren(...jobs.flatMap((job, i) => [i ? " and " : "", described(job)]));
  showReport(by("results"), report, null);
  by("swap").href = `/compare?a=${encodeURIComponent(b)}&b=${encodeURIComponent(a)}`;
  download(by("report"), `/compare/report?${asked}`, `compare-${a.slice(0, 8)}-${b.slice(0, 8)}.html`, "text/html");
  download(by("json"), `/compare?${asked}`, `compare-${a.slice(0, 8)}-${b.slice(0, 8)}.json`, "application/json");
  for (const id of ["swap", "report", "json"]) by(id).hidden = false;
}

function described(job) {
  const data = job.data.length ? `, ${job.data.join(", ")}` : "";
  return element("span", {}, element("a", { href: `/jobs/${job.jobID}` }, job.name || `${job.kind} ${job.jobID.slice(0, 8)}`),
    ` (${job.kind} with ${job.model}${data}, ${when(job.created)})`);
}

open().catch((error) => {
  if (!(error instanceof Problem)) throw error;
  by("problem").hidden = false;
  by("problem").textContent = error.errors.length ? "Choose two jobs in the list, then compare them." : error.message;
});
