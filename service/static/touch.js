// Fingers on a chart: one that moves sideways marks a stretch to zoom into, as the mouse does; two pinch and
// move what is shown. Up and down they scroll the page, see touch-action in app.css.

const LEAST = 12; // CSS pixels: less is a tap

// ``zoom(middle, width)`` shows a part of x.
export function fingers(plot, zoom) {
  const { over } = plot;
  const down = new Map(); // pixels from the left where each finger is
  let start = null; // where the only finger came down
  const at = (event) => event.clientX - over.getBoundingClientRect().left;
  const mark = (left, width) => plot.setSelect({ left, width, top: 0, height: width && over.clientHeight }, false);
  const show = (...pixels) => {
    const [from, to] = pixels.map((pixel) => plot.posToVal(pixel, "x"));
    zoom((from + to) / 2, to - from);
  };

  // What was under the fingers stays under them.
  const pinch = ([a, b], [c, d]) => {
    if (Math.min(Math.abs(b - a), Math.abs(d - c)) < LEAST) return;
    const scale = (b - a) / (d - c);
    const left = a - c * scale;
    show(left, left + over.clientWidth * scale);
  };

  over.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "touch") return;
    down.set(event.pointerId, at(event));
    start = down.size === 1 ? at(event) : null;
    mark(0, 0);
  });
  over.addEventListener("pointermove", (event) => {
    if (!down.has(event.pointerId)) return;
    const before = [...down.values()];
    const now = at(event);
    down.set(event.pointerId, now);
    if (down.size === 2) return pinch(before, [...down.values()]);
    if (start === null) return;
    mark(Math.min(start, now), Math.abs(now - start));
    plot.setCursor({ left: now, top: 0 });
  });
  for (const end of ["pointerup", "pointercancel"]) {
    over.addEventListener(end, (event) => {
      if (!down.delete(event.pointerId)) return;
      const { left, width } = plot.select;
      mark(0, 0);
      if (end === "pointerup" && start !== null && width > LEAST) show(left, left + width);
      start = null;
    });
  }
}
