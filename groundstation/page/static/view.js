// Which seconds are looked at: the last ones, as they come, or some that were chosen.

import { element, pressable } from "./dom.js";

const LEAST_S = 0.05;

export class View {
  /** nowS: the end of what there is. beginS: its begin. windowS: the width when it follows; null for
   * all there is. */
  constructor({ nowS, beginS, windowS }) {
    Object.assign(this, { nowS, beginS, windowS });
    this.fixed = null;
    this.onChange = () => {};
  }

  range() {
    if (this.fixed) return this.fixed;
    const end = this.nowS();
    return [this.windowS === null ? this.beginS() : end - this.windowS, end];
  }

  fix(from, to) {
    const middle = (from + to) / 2, half = Math.max((to - from) / 2, LEAST_S / 2);
    this.fixed = [middle - half, middle + half];
    this.onChange();
  }

  follow() {
    this.fixed = null;
    this.onChange();
  }

  /** factor: of what is in view; about: a time that stays where it is. */
  zoom(factor, about) {
    const [from, to] = this.range();
    const still = about ?? (from + to) / 2;
    this.fix(still - factor * (still - from), still + factor * (to - still));
  }

  pan(share) {
    const [from, to] = this.range();
    this.fix(from + share * (to - from), to + share * (to - from));
  }
}

/** Buttons for a view. live: whether it goes on by itself; charts: that show it. */
export function viewTools(host, view, charts, { live }) {
  const tool = (text, name, work) => {
    const made = pressable("quiet", text, work);
    made.setAttribute("aria-label", name);
    made.title = name;
    host.append(made);
    return made;
  };
  const pause = live ? tool("Pause", "Pause the plots", () => (view.fixed ? view.follow() : view.fix(...view.range())))
    : tool("All", "The whole recording", () => view.follow());
  tool("−", "Zoom out", () => view.zoom(2));
  tool("+", "Zoom in", () => view.zoom(0.5));
  tool("◀", "Earlier", () => view.pan(-0.25));
  tool("▶", "Later", () => view.pan(0.25));
  if (live) {
    const label = element("label", "inline", "Seconds ");
    const select = element("select");
    select.append(...[5, 10, 20, 60, 120].map((one) => new Option(one, one, one === 20, one === 20)));
    select.addEventListener("change", () => {
      view.windowS = Number(select.value);
      view.follow();
    });
    label.append(select);
    host.append(label);
  }
  host.append(chooser(charts));
  view.onChange = () => {
    if (live) {
      pause.textContent = view.fixed ? "Go on" : "Pause";
      pause.setAttribute("aria-label", view.fixed ? "Follow what comes" : "Pause the plots");
    }
    charts.draw();
  };
  charts.host.addEventListener("dblclick", () => view.follow());
  charts.host.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.shiftKey) return; // the page scrolls
    event.preventDefault();
    const by = event.deltaY || event.deltaX;
    if (event.shiftKey) view.pan(Math.sign(by) * 0.1);
    else view.zoom(by > 0 ? 1.25 : 0.8, charts.cursor);
  }, { passive: false });
}

/** What can be plotted, to be ticked. */
function chooser(charts) {
  const made = element("details", "chooser");
  made.append(element("summary", "", "Channels"));
  const list = element("div", "choices"), filter = element("input");
  filter.type = "search";
  filter.placeholder = "find a channel";
  filter.setAttribute("aria-label", "Find a channel");
  made.append(filter, list);
  const fill = () => {
    const wanted = filter.value.toLowerCase();
    list.replaceChildren(...charts.offered()
      .filter((one) => `${one.group} ${one.channels.map((c) => c.id).join(" ")}`.toLowerCase().includes(wanted))
      .map((one) => {
        const label = element("label"), box = element("input");
        box.type = "checkbox";
        box.checked = charts.groups.has(one.group);
        box.addEventListener("change", () => {
          charts.show(one.group, box.checked);
          charts.draw();
        });
        const names = one.channels.map((c) => c.name).join(", ");
        label.append(box, ` ${one.group}`, element("span", "soft", ` ${names}`));
        return label;
      }));
  };
  filter.addEventListener("input", fill);
  made.addEventListener("toggle", () => made.open && fill());
  return made;
}
