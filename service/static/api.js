// The JSON calls, for all pages.
//
//   get(path), post(path, body), patch(path, body), remove(path)   -> the JSON document; throw Problem
//   body                       an object (sent as JSON) or FormData (sent as multipart)
//   Problem                    .status, .title, .detail, .errors = [{field, message, row?, channel?}];
//                              .passing where the same call may be answered later
//   showProblem(form, problem) puts each message beside the element with data-field="<field>" (the
//                              longest prefix there is), the rest into the form's .problem element
//   clearProblem(form)
//   announce(text)             says a sentence to screen readers
//   poll(step)                 calls async step() again and again; step returns the pause in ms, or
//                              null to end. Waits while the page is hidden. Returns a function that stops it
//   element(tag, attributes, ...children)       makes DOM; text is never read as HTML
//   number(x), unit(text), when(iso), duration(seconds), value(one)     values as text
//   words("a, b")              ["a", "b"]
//
// With keys configured the first call asks for one; it lives in sessionStorage and goes along as a header.

const KEY = "api-key";

export class Problem extends Error {
  constructor(status, body) {
    super(body.detail || body.title || `the service answered ${status}`);
    this.status = status;
    this.title = body.title ?? "";
    this.type = body.type ?? "";
    this.detail = this.message;
    this.advice = body.advice ?? "";
    this.errors = body.errors ?? [];
  }

  get passing() {
    return this.status === 0 || this.status === 429 || this.status >= 500;
  }
}

export const get = (path, options) => call("GET", path, undefined, options);
export const post = (path, body, options) => call("POST", path, body, options);
export const patch = (path, body, options) => call("PATCH", path, body, options);
export const remove = (path, options) => call("DELETE", path, undefined, options);

async function call(method, path, body, options = {}) {
  for (;;) {
    const key = await currentKey();
    const headers = { Accept: "application/json", ...options.headers };
    if (key) headers["X-API-Key"] = key;
    const multipart = body instanceof FormData;
    if (body !== undefined && !multipart) headers["Content-Type"] = "application/json";
    const text = body === undefined || multipart ? body : JSON.stringify(body);
    let answer;
    try {
      answer = await fetch(path, { method, headers, body: text, cache: "no-store", signal: options.signal });
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new Problem(0, { title: "no connection", detail: "The service cannot be reached; is it running?" });
    }
    if (answer.status === 401 && needsKey()) {
      await askKey("This key is not known to the service.");
      continue;
    }
    const found = await answer.json().catch(() => null);
    if (!answer.ok) throw new Problem(answer.status, found ?? {});
    if (found === null) throw new Problem(0, { title: "cut off", detail: "The service's answer was cut off." });
    return found;
  }
}

// ---- the API key ----------------------------------------------------------------------------

const needsKey = () => document.body.dataset.keys === "needed";
let asking = null; // one dialog for all calls that wait

function currentKey() {
  if (!needsKey()) return null;
  return sessionStorage.getItem(KEY) ?? askKey("");
}

function askKey(error) {
  asking ??= new Promise((resolve, reject) => {
    const dialog = document.getElementById("key-dialog");
    const input = document.getElementById("key-input");
    document.getElementById("key-error").textContent = sessionStorage.getItem(KEY) ? error : "";
    input.value = "";
    dialog.returnValue = "cancel";
    dialog.addEventListener("close", () => {
      asking = null;
      if (dialog.returnValue === "ok" && input.value.trim()) {
        sessionStorage.setItem(KEY, input.value.trim());
        resolve(input.value.trim());
      } else {
        reject(new Problem(401, { title: "unauthorized", detail: "An API key is needed to see anything here." }));
      }
    }, { once: true });
    dialog.showModal();
    input.focus();
  });
  return asking;
}

document.getElementById("change-key")?.addEventListener("click", async () => {
  sessionStorage.removeItem(KEY);
  try {
    await askKey("");
    location.reload();
  } catch {
    announce("No key");
  }
});

// ---- messages -------------------------------------------------------------------------------

export function showProblem(form, problem) {
  clearProblem(form);
  const rest = [];
  let first = null;
  for (const error of problem.errors?.length ? problem.errors : [{ field: "", message: problem.message }]) {
    const beside = error.field && fieldElement(form, error.field);
    if (!beside) {
      rest.push(error.field ? `${error.field}: ${error.message}` : error.message);
      continue;
    }
    first ??= beside;
    mark(beside, error.message);
  }
  const place = form.querySelector(".problem");
  if (place) {
    place.hidden = false;
    place.textContent = rest.length ? rest.join("; ") : "Please correct the marked fields.";
  }
  const target = first ?? place;
  target?.scrollIntoView({ block: "center", behavior: "smooth" });
  const focusable = first?.matches("input,select,textarea,button") ? first : first?.querySelector("input,select,textarea");
  focusable?.focus({ preventScroll: true });
}

export function clearProblem(form) {
  for (const old of form.querySelectorAll(".field-error[data-made]")) old.remove();
  for (const bad of form.querySelectorAll("[aria-invalid]")) {
    bad.removeAttribute("aria-invalid");
    bad.removeAttribute("aria-describedby");
  }
  const place = form.querySelector(".problem");
  if (place) {
    place.hidden = true;
    place.textContent = "";
  }
}

// 'series[0].y.flow' is beside data-field="series[0].y.flow", else "series[0].y", else "series[0]", ...
function fieldElement(form, field) {
  const known = new Map();
  for (const one of form.querySelectorAll("[data-field]")) {
    for (const name of one.dataset.field.split(/\s+/)) known.set(name, one);
  }
  for (let name = field; name; name = name.replace(/(\.[^.[\]]+|\[\d+\])$|^[^.[\]]+$/, "")) {
    if (known.has(name)) return known.get(name);
  }
  return null;
}

let made = 0;

function mark(beside, message) {
  const id = `error-${++made}`;
  const text = element("p", { class: "field-error", id, "data-made": "" }, message);
  const input = beside.matches("input,select,textarea") ? beside : beside.querySelector("input,select,textarea") ?? beside;
  input.setAttribute("aria-invalid", "true");
  input.setAttribute("aria-describedby", id);
  if (beside.matches("input,select,textarea")) beside.after(text);
  else beside.append(text);
}

export function announce(text) {
  document.getElementById("announcer").textContent = text;
}

// ---- polling --------------------------------------------------------------------------------

export function poll(step) {
  let stopped = false;
  (async () => {
    while (!stopped) {
      const pause = await step();
      if (pause === null) return;
      await new Promise((resolve) => setTimeout(resolve, pause));
      while (document.hidden && !stopped) {
        await new Promise((resolve) => document.addEventListener("visibilitychange", resolve, { once: true }));
      }
    }
  })();
  return () => {
    stopped = true;
  };
}

// ---- DOM and text ---------------------------------------------------------------------------

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "value") made.value = value;
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return made;
}

export function number(x, digits = 5) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "-";
  const size = Math.abs(x);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) {
    return x.toExponential(digits - 1).replace(/\.?0+e/, "e").replace("e+", "e");
  }
  return String(Number(x.toPrecision(digits)));
}

// "1e8 m^3" as "10⁸ m³"
export function unit(text) {
  const raised = (digits) => digits.replace(/[-0-9.]/g, (c) => "⁻·_⁰¹²³⁴⁵⁶⁷⁸⁹"["-._0123456789".indexOf(c)]);
  return text.replace(/\b1e(-?\d+)/g, (_, power) => `10${raised(power)}`).replace(/\^(-?[\d.]+)/g, (_, power) => raised(power));
}

// A key value of a job: {name, value, standard_error, unit}.
export function value({ value: x, standard_error: error, unit: text }) {
  const plain = text && text !== "1" ? `${/^\d+e/.test(text) ? " ×" : ""} ${unit(text)}` : "";
  const order = (y) => Math.floor(Math.log10(Math.abs(y)));
  const digits = x && error ? Math.min(Math.max(4, order(x) - order(error) + 2), 12) : 4;  // of the error two
  return `${number(x, digits)}${error === null ? "" : ` ± ${number(error, 2)}`}${plain}`;
}

// A sentence of the engine with its units and signs as they are printed.
export function printed(text) {
  return text.replace(/\bx (1e-?\d+)/g, (_, factor) => `× ${unit(factor)}`).replace(/\+-/g, "±")
    .replace(/(?<=\p{L})\^-?\d+(?!\.?\d)/gu, (power) => unit(`x${power}`).slice(1));
}

export function words(text) {
  return text.split(",").map((word) => word.trim()).filter(Boolean);
}

export function when(iso) {
  if (!iso) return "";
  const time = new Date(iso);
  const today = new Date().toDateString() === time.toDateString();
  const clock = time.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit" });
  return today ? clock : `${time.toLocaleDateString()} ${clock}`;
}

export function duration(seconds) {
  if (seconds === null || !Number.isFinite(seconds)) return "";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}
