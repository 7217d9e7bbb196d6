// Step 1: which model, with which effects. Shows its equations, states and channels.

import { element, get, post, Problem, unit } from "/static/api.js";
import { equations } from "/static/equations.js";

const select = document.getElementById("model");

export class ModelCard {
  // onChange() is called when the model, or what is added to it, has changed.
  constructor(onChange) {
    this.onChange = onChange;
    this.models = new Map();
    this.document = null; // of the model with its effects
    this.effects = [];
    this.setting = null; // what a diagnosis told of its data
    select.addEventListener("change", () => this.choose({ name: select.value }));
    document.getElementById("effect-add").addEventListener("click", () => this.addEffect());
    document.getElementById("effect").addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      event.preventDefault();
      this.addEffect();
    });
  }

  async load() {
    const { models, broken_plugins } = await get("/models");
    const broken = document.getElementById("broken");
    broken.replaceChildren(...Object.entries(broken_plugins).map(([name, text]) => element("li", {}, `${name} cannot be used: ${text}`)));
    broken.hidden = !broken.childElementCount;
    this.models = new Map(models.map((one) => [one.name, one]));
    const choices = models.map((one) => element("option", { value: one.name }, `${one.name}${one.own ? " (your own)" : ""}${one.description ? ` - ${firstSentence(one.description)}` : ""}`));
    select.replaceChildren(element("option", { value: "" }, "choose ..."), ...choices);
  }

  get name() {
    return this.document ? select.value : "";
  }

  // What goes into the request: the name, or a reference where effects are added.
  reference() {
    if (!this.effects.length) return this.name;
    const reference = { name: this.name, with: this.effects };
    return this.setting ? { ...reference, setting: this.setting } : reference;
  }

  // reference: {name, with?, setting?}. Throws Problem for effects that cannot be added.
  async choose(reference) {
    select.value = this.models.has(reference.name) ? reference.name : "";
    const effects = reference.with ?? [];
    const base = this.models.get(select.value) ?? null;
    this.document = base && effects.length ? await post("/models/extend", clean(reference)) : base;
    this.effects = effects;
    this.setting = reference.setting ?? null;
    this.show();
    this.onChange();
  }

  async addEffect() {
    const input = document.getElementById("effect");
    const name = input.value.trim();
    if (name && (await this.changeEffects([...this.effects, name]))) input.value = "";
  }

  async changeEffects(effects) {
    const place = document.querySelector('[data-field="model.with"]');
    place.querySelector(".field-error")?.remove();
    try {
      await this.choose({ name: this.name, with: effects, setting: this.setting });
      return true;
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      place.append(element("p", { class: "field-error", role: "alert" }, error.errors[0]?.message ?? error.message));
      return false;
    }
  }

  show() {
    document.getElementById("model-card").hidden = !this.document;
    if (!this.document) return;
    const { description, equations: lines, nonlinear, linear, inputs, outputs, check } = this.document;
    document.getElementById("model-check-list").replaceChildren(...check.map((text) => element("li", {}, text)));
    document.getElementById("model-text").textContent = description;
    document.getElementById("model-equations").replaceChildren(equations(lines));
    const rows = [
      ["Measured", outputs],
      ["Inputs", inputs],
      ["States by particles", nonlinear],
      ["States treated exactly", linear],
    ].filter(([, channels]) => Object.keys(channels).length);
    document.getElementById("model-channels").replaceChildren(...rows.flatMap(([what, channels]) => [
      element("dt", {}, what),
      element("dd", {}, ...Object.entries(channels).map(([name, text]) => element("span", {}, withUnit(name, text)))),
    ]));
    document.getElementById("effects-count").textContent = this.effects.length ? `(${this.effects.length})` : "";
    document.getElementById("effects-details").open ||= this.effects.length > 0;
    document.getElementById("effects").replaceChildren(...this.effects.map((name) => element("li", {},
      name,
      element("button", {
        type: "button", class: "quiet small", "aria-label": `Remove ${name}`,
        onclick: () => this.changeEffects(this.effects.filter((one) => one !== name)),
      }, "×"),
    )));
  }
}

export function withUnit(name, text) {
  return text && text !== "1" ? `${name} [${unit(text)}]` : name;
}

function firstSentence(text) {
  const first = text.split(/[:;](?:\s|$)|\.(?=\s+\p{Lu}|\s*$)/u)[0]; // "eq. (34)" ends none
  return first.length > 90 ? `${first.slice(0, 88)}...` : first;
}

function clean({ name, with: effects, setting }) {
  return setting ? { name, with: effects, setting } : { name, with: effects };
}
