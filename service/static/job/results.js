// A report's parts on the page: sections as cards, charts drawn when they come into view.

import { element } from "/static/api.js";
import { chart } from "/static/charts.js";
import { Zoom } from "/static/job/zoom.js";

const NEAR = "800px"; // how far outside the view a chart is drawn already

export function showReport(place, report, job) {
  const contents = element("nav", { class: "contents", "aria-label": "Sections" },
    report.sections.map((one) => element("a", { href: `#${one.id}` }, one.title)));
  const summary = made(report.summary, element("section", { class: "card", "aria-label": "Summary" }));
  const sections = report.sections.map((one) => made(one.html,
    element("section", { class: "card", id: one.id, "aria-labelledby": `${one.id}-title` },
      element("h2", { id: `${one.id}-title` }, one.title))));
  place.replaceChildren(summary, contents, ...sections);
  drawCharts(place, report.charts, new Zoom(job));
  if (location.hash) document.getElementById(location.hash.slice(1))?.scrollIntoView();
}

// The HTML comes from this service, which has escaped all that others wrote.
function made(html, holder) {
  holder.append(document.createRange().createContextualFragment(html));
  return holder;
}

function drawCharts(place, charts, zoom) {
  const draw = (figure) => {
    observer.unobserve(figure);
    if (figure.childElementCount) return;
    const number = Number(figure.dataset.chart);
    const options = { ...charts[number], height: figure.classList.contains("wide") ? 280 : 220 };
    if (options.points === options.x.length) chart(figure, options);
    else zoom.add(number, (onZoom) => chart(figure, { ...options, onZoom }));
  };
  const observer = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => draw(entry.target)),
    { rootMargin: NEAR },
  );
  const figures = place.querySelectorAll("[data-chart]");
  figures.forEach((figure) => observer.observe(figure));
  addEventListener("beforeprint", () => figures.forEach(draw));
}
