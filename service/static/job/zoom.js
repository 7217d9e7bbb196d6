// Long curves are drawn with few of their points; where they are zoomed into, the service gives more.

import { get, Problem } from "/static/api.js";

const PAUSE = 150; // ms without another change of the part that is shown
const AROUND = 0.5; // of its width is fetched on either side too, so that it can be moved

export class Zoom {
  constructor(job) {
    this.job = job;
    this.charts = new Map(); // number -> chart
    this.fetched = null; // [from, to] of what is drawn finely
  }

  // make(onZoom) makes the chart of that number in the report.
  add(number, make) {
    this.charts.set(number, make((from, to) => this.changed(from, to)));
    this.fetched = null; // not for this one
  }

  changed(from, to) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => (from === null ? this.coarsen() : this.refine(from, to)), PAUSE);
  }

  coarsen() {
    if ([...this.charts.values()].some((one) => one.part)) return;
    this.asked?.abort();
    this.fetched = null;
    for (const one of this.charts.values()) one.coarsen();
  }

  async refine(from, to) {
    const width = to - from;
    const [low, high] = this.fetched ?? [Infinity, -Infinity];
    if (low <= from && to <= high && high - low <= 4 * (1 + 2 * AROUND) * width) return;
    this.asked?.abort();
    this.asked = new AbortController();
    const part = [from - AROUND * width, to + AROUND * width];
    try {
      const { charts } = await get(`${this.job}/charts?from=${part[0]}&to=${part[1]}`, { signal: this.asked.signal });
      this.fetched = part;
      for (const [number, curves] of Object.entries(charts)) {
        if (curves.x.length) this.charts.get(Number(number))?.refine(curves);
      }
    } catch (error) {
      // The coarse curves stay: a later zoom asks again.
      if (error.name !== "AbortError" && !(error instanceof Problem)) throw error;
    }
  }
}
