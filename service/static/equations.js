// Equations as people type them, as MathML.
//
//   equations(lines)    -> a <div> with one line for each equation
//   equation(text)      -> a <math> element; "k1" and "x_1" get indices, sigma a Greek letter, x^2 a power,
//                          sqrt(...) a root, "a b / (c + d)" a fraction; longer names stay upright
//
// Every name and sign of the text comes out again, in its order; a screen reader gets the text itself.

const NS = "http://www.w3.org/1998/Math/MathML";
const GREEK = {
  alpha: "α", beta: "β", gamma: "γ", delta: "δ", epsilon: "ε", zeta: "ζ", eta: "η", theta: "θ", kappa: "κ",
  lambda: "λ", mu: "μ", nu: "ν", xi: "ξ", pi: "π", rho: "ρ", sigma: "σ", tau: "τ", phi: "φ", chi: "χ",
  psi: "ψ", omega: "ω", Gamma: "Γ", Delta: "Δ", Theta: "Θ", Lambda: "Λ", Sigma: "Σ", Phi: "Φ", Psi: "Ψ", Omega: "Ω",
};
const FUNCTIONS = new Set(["sin", "cos", "tan", "exp", "log", "max", "min", "sign", "clip", "arctan", "diag", "tanh", "abs"]);
const SIGNS = { "~": "∼", "-": "−", ">=": "≥", "<=": "≤", "->": "→", "...": "…", "*": "⋅" };
const TOKEN = /\s+|\d+(?:\.\d+)?(?:e[+-]?\d+)?|[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*|'+|>=|<=|->|\.\.\.|./gu;
const OPEN = { "(": ")", "[": "]", "{": "}" };
const BREAKS = new Set(["+", "-", "=", "~", ",", ";", ">=", "<=", "->", "<", ">", ":"]);

export function equations(lines) {
  const box = document.createElement("div");
  box.className = "equations";
  for (const line of lines) {
    // "step:flow: flow = ..." names the effect that an equation comes from.
    const [, effect, text] = /^([\w]+:[^\s:]+):\s+(.*)$/.exec(line) ?? [null, null, line];
    for (const part of text.split(/,\s{2,}/)) {
      const row = document.createElement("div");
      row.className = "equation";
      row.append(equation(part));
      if (effect) {
        row.classList.add("added");
        const label = document.createElement("span");
        label.className = "badge";
        label.textContent = effect;
        row.append(label);
      }
      box.append(row);
    }
  }
  return box;
}

export function equation(text) {
  const math = make("math", []);
  math.setAttribute("display", "block");
  math.setAttribute("aria-label", text);
  math.append(...new Reader(text).row());
  return math;
}

class Reader {
  constructor(text) {
    this.tokens = text.match(TOKEN) ?? [];
    this.at = 0;
  }

  skip() {
    while (this.tokens[this.at]?.trim() === "") this.at += 1;
  }

  next() {
    this.skip();
    return this.tokens[this.at];
  }

  // Terms and the signs between them, up to a closing token.
  row(close) {
    const out = [];
    let term = [];
    const flush = () => {
      out.push(...spaced(term));
      term = [];
    };
    for (let token = this.next(); token !== undefined && token !== close; token = this.next()) {
      if (token === "/" && term.length && this.fraction(close)) {
        term = [make("mfrac", [rowOf(spaced(term)), this.below])];
      } else if (BREAKS.has(token) || token === "/" || token === "*") {
        this.at += 1;
        if (token === "*") continue; // a product is written side by side
        const unary = token === "-" && !term.length && (!out.length || out.at(-1).nodeName === "mo");
        flush();
        out.push(sign(token, unary));
      } else {
        term.push(this.power(close));
      }
    }
    flush();
    return out;
  }

  // Whether "/" is followed by one factor that ends its term; then that factor is in this.below.
  fraction(close) {
    const start = this.at;
    this.at += 1;
    if (this.next() !== undefined && !BREAKS.has(this.next())) {
      this.below = this.power(close, true);
      const after = this.next();
      if (after === undefined || after === close || BREAKS.has(after)) return true;
    }
    this.at = start;
    return false;
  }

  power(close, bare = false) {
    let base = this.factor(close, bare);
    for (let token = this.next(); token === "^" || /^'+$/.test(token ?? ""); token = this.next()) {
      this.at += 1;
      // A prime stands high by itself; as an exponent it would be lost.
      if (token === "^") base = make("msup", [base, this.exponent(close)]);
      else base = make("mrow", [base, tight(["", "′", "″", "‴"][Math.min(token.length, 3)])]);
    }
    return base;
  }

  exponent(close) {
    if (this.next() === "-") {
      this.at += 1;
      return make("mrow", [sign("-", true), this.factor(close, true)]);
    }
    return this.factor(close, true);
  }

  factor(close, bare) {
    const token = this.next();
    this.at += 1;
    if (token in OPEN) {
      const inside = this.row(OPEN[token]);
      this.at += 1;
      return bare && token !== "[" ? rowOf(inside) : make("mrow", [tight(token), ...inside, tight(OPEN[token])]);
    }
    if (token === "|" && close !== "|") {
      const inside = this.row("|");
      this.at += 1;
      return make("mrow", [tight("|"), ...inside, tight("|")]);
    }
    if (token === "sqrt" && this.next() === "(") {
      this.at += 1;
      const inside = this.row(")");
      this.at += 1;
      return make("msqrt", inside);
    }
    if (/^\d/.test(token)) return make("mn", [token]);
    if (!/^[A-Za-z]/.test(token)) return sign(token, false);
    const name = identifier(token);
    const call = FUNCTIONS.has(token) || token === "N" || this.tokens[this.at] === "(";
    if (call && this.next() === "(") return make("mrow", [token === "N" ? letter(token, true) : name, this.factor(close, false)]);
    return name;
  }
}

// Factors side by side, with a little air between them.
function spaced(factors) {
  return factors.flatMap((factor, i) => {
    if (i === 0) return [factor];
    const air = make("mspace", []);
    air.setAttribute("width", "0.22em");
    return [air, factor];
  });
}

function identifier(word) {
  if (word === "dt") return make("mrow", [letter("Δ"), letter("t")]);
  if (FUNCTIONS.has(word)) return letter(word);
  const [head, ...rest] = word.split("_");
  const index = rest.join("_");
  if (head in GREEK) return withIndex(letter(GREEK[head]), index);
  const numbered = /^([A-Za-z])(\d+)$/.exec(head);
  if (numbered && !index) return withIndex(letter(numbered[1]), numbered[2]);
  if (head.length > 1) {
    const short = !index && /^([A-Z])([a-z])$/.exec(head); // Fv, Fc: a symbol with its index
    return short ? withIndex(letter(short[1]), short[2]) : letter(word);
  }
  return withIndex(letter(head), index);
}

function withIndex(base, index) {
  if (!index) return base;
  return make("msub", [base, /^\d+$/.test(index) ? make("mn", [index]) : letter(index)]);
}

// Single letters slant, words and capital Greek letters do not.
function letter(text, upright = text.length > 1 || /[ΓΔΘΛΣΦΨΩ]/.test(text)) {
  const made = make("mi", [text]);
  if (!upright) made.setAttribute("class", "slant");
  return made;
}

// A sign without space around it, no larger than the text.
function tight(text) {
  const made = make("mo", [text]);
  for (const [name, value] of [["stretchy", "false"], ["lspace", "0"], ["rspace", "0"]]) made.setAttribute(name, value);
  return made;
}

function sign(token, unary) {
  const made = make("mo", [SIGNS[token] ?? token]);
  if (unary) made.setAttribute("form", "prefix");
  if (token === "/") {
    made.setAttribute("lspace", "0.1em");
    made.setAttribute("rspace", "0.1em");
  }
  return made;
}

function rowOf(nodes) {
  return nodes.length === 1 ? nodes[0] : make("mrow", nodes);
}

function make(tag, children) {
  const made = document.createElementNS(NS, tag);
  made.append(...children);
  return made;
}
