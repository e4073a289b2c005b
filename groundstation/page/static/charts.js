// Channels over time: a plot for each group, on one time axis, with one cursor.
// `uPlot` is the library's, which page.html loads before.

import { decimals, element, pressable, reconcile, writeIn } from "./dom.js";
import { firstFrom } from "./store.js";

const AXIS = 58, POINTS_MOST = 2500;
const SPAN_LEAST = { "°": 2, "°/s": 5, "%": 2, "m/s²": 1, V: 0.1 };
const COLORS = 6;
const height = () => Math.max(120, Math.min(190, (innerHeight - 370) / 3)); // three are seen at once
const dark = matchMedia("(prefers-color-scheme: dark)");
let colors = {}; // as the theme has them
dark.addEventListener("change", () => { colors = {}; });

const color = (name) => (colors[name] ??=
  getComputedStyle(document.documentElement).getPropertyValue(name).trim());

export class Charts {
  /** host: is given the plots. view: of the time axis. shown: groups that are shown at first.
   * clockText: what the time axis says of a time, and how fine its steps are. key: to keep a choice by.
   * playhead: a time that is marked and whose values are shown, where there is one. */
  constructor(host, store, view, { shown, clockText, key, playhead = () => null }) {
    Object.assign(this, { host, store, view, clockText, key, playhead });
    this.plots = new Map();
    this.groups = new Set(JSON.parse(localStorage.getItem(key) ?? "null") ?? shown);
    this.hidden = new Set();
    this.version = -1;
    this.sync = uPlot.sync(key);
    this.width = 0; // nothing is drawn while another part of the page is looked at
    const fit = () => {
      this.width = host.clientWidth;
      for (const { plot, body } of this.plots.values())
        if (body.clientWidth) plot.setSize({ width: body.clientWidth, height: height() });
      this.draw();
    };
    new ResizeObserver(fit).observe(host);
    window.addEventListener("resize", fit); // plots are as high as the window has room for
  }

  /** Groups that can be shown: [{group, unit, channels}]. */
  offered() {
    const found = new Map();
    for (const one of this.store.channels()) {
      if (!found.has(one.group)) found.set(one.group, { group: one.group, unit: one.unit, channels: [] });
      found.get(one.group).channels.push(one);
    }
    return [...found.values()];
  }

  show(group, on) {
    if (on) this.groups.add(group);
    else this.groups.delete(group);
    localStorage.setItem(this.key, JSON.stringify([...this.groups]));
    this.version = -1;
  }

  /** Draws what is in view. */
  draw() {
    if (!this.width) return;
    if (this.version !== this.store.version) this.#arrange();
    const [min, max] = this.view.range();
    for (const one of this.plots.values()) {
      const data = this.#data(one.group.channels, min, max);
      one.plot.batch(() => {
        one.plot.setData(data, false);
        one.plot.setScale("x", { min, max });
      });
    }
    this.#tell();
  }

  #tell() {
    for (const one of this.plots.values()) this.#values(one);
  }

  #arrange() {
    this.version = this.store.version;
    const groups = this.offered().filter((one) => this.groups.has(one.group));
    // the same channels may stand in another place of another file
    const key = (one) => `${one.group} ${one.channels.map(({ table, place, id }) => [table, place, id])}`;
    reconcile(this.host, groups, key,
      (one) => this.#make(one), () => {});
    for (const [key, one] of this.plots) {
      if (one.figure.isConnected) continue;
      one.plot.destroy();
      this.sync.unsub(one.plot);
      this.plots.delete(key);
    }
  }

  #make(group) {
    const figure = element("figure", "chart"), caption = element("figcaption");
    caption.append(element("span", "", group.unit ? `${group.group}, ${group.unit}` : group.group));
    const body = element("div", "plot");
    body.setAttribute("role", "img");
    body.setAttribute("aria-label", `${group.group} over time`);
    figure.append(caption, body);
    const legend = group.channels.map((channel, place) => {
      const made = pressable(`key s${place % COLORS}`, "", () => {
        const on = this.hidden.delete(channel.id) || !this.hidden.add(channel.id);
        made.setAttribute("aria-pressed", String(on));
        plot.setSeries(place + 1, { show: on });
      });
      made.title = "show or hide";
      const value = element("span", "value");
      made.append(`${channel.name} `, value);
      made.setAttribute("aria-pressed", String(!this.hidden.has(channel.id)));
      return { made, value };
    });
    caption.append(...legend.map((one) => one.made));
    const plot = new uPlot(this.#options(group), [[], ...group.channels.map(() => [])], body);
    this.sync.sub(plot);
    const made = { group, figure, body, plot, legend };
    this.plots.set(group.group + this.store.version, made);
    return figure;
  }

  #options(group) {
    const least = SPAN_LEAST[group.unit] ?? 0;
    const axis = { stroke: () => color("--soft"), grid: { stroke: () => color("--grid"), width: 1 },
      ticks: { stroke: () => color("--grid"), width: 1 }, font: "12px system-ui, sans-serif" };
    return {
      width: this.host.clientWidth, height: height(), legend: { show: false }, ms: 1,
      padding: [null, 32, null, null], // the last time is not cut off
      scales: {
        x: { time: false },
        y: { range: (_, low, high) => {
          if (low === null || high === null) return [0, 1];
          const middle = (low + high) / 2, half = Math.max(high - low, least, 1e-9) / 2;
          return uPlot.rangeNum(middle - half, middle + half, 0.08, false);
        } },
      },
      axes: [
        { ...axis, size: 26, space: 70, values: (_, ticks, __, ___, step) =>
          ticks.map((one) => this.clockText(one, step)) },
        { ...axis, size: AXIS, space: 20 },
      ],
      series: [{}, ...group.channels.map((one, place) => ({
        label: one.name, show: !this.hidden.has(one.id), width: 1, points: { show: false }, // 1.5 costs a browser without a GPU a fifth more
        stroke: () => color(`--c${place % COLORS}`), spanGaps: false,
      }))],
      cursor: { sync: { key: this.key }, y: false, drag: { x: true, y: false, setScale: false },
        points: { size: 6 } },
      hooks: {
        setSelect: [(plot) => {
          const { left, width } = plot.select;
          if (width > 5) this.view.fix(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
          plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        }],
        draw: [(plot) => this.#mark(plot)],
        setCursor: [() => this.#cursorMoved()],
      },
    };
  }

  #mark({ ctx, bbox, valToPos, scales }) {
    const time = this.playhead();
    if (time === null || time < scales.x.min || time > scales.x.max) return;
    const x = Math.round(valToPos(time, "x", true));
    ctx.save();
    ctx.fillStyle = color("--ink");
    ctx.fillRect(x - 1, bbox.top, 2, bbox.height);
    ctx.restore();
  }

  #cursorMoved() {
    if (this.waits) return;
    this.waits = requestAnimationFrame(() => {
      this.waits = 0;
      this.#tell();
    });
  }

  /** The time under the cursor, or null. */
  get cursor() {
    for (const { plot } of this.plots.values()) {
      const { left } = plot.cursor;
      if (left >= 0 && plot.data[0].length) return plot.posToVal(left, "x");
    }
    return null;
  }

  /** Values under the cursor, else the newest in view. */
  #values({ group, plot, legend }) {
    const times = plot.data[0];
    const marked = this.playhead();
    const place = plot.cursor.left >= 0 ? plot.cursor.idx
      : marked === null ? null : Math.max(0, firstFrom(times, marked + 1e-9) - 1);
    legend.forEach(({ value }, series) => {
      const found = plot.data[series + 1]?.[place ?? times.length - 1];
      const digits = group.unit === "V" || !group.unit ? 3 : 1;
      const text = found === null || found === undefined ? "–" : decimals(found, digits);
      writeIn(value, text);
    });
  }

  #data(channels, min, max) {
    const table = this.store.tables.get(channels[0].table);
    if (!table) return [[], ...channels.map(() => [])];
    const first = Math.max(0, firstFrom(table.times, min) - 1);
    const end = Math.min(table.times.length, firstFrom(table.times, max) + 1);
    const step = Math.max(1, Math.ceil((end - first) / POINTS_MOST));
    const times = thinned(table.times, first, end, step);
    return [times, ...channels.map(({ place, wraps }) => {
      const values = thinned(table.values[place], first, end, step);
      if (wraps) breakTurns(values);
      return values;
    })];
  }
}

function thinned(values, first, end, step) {
  if (step === 1) return Array.from(values.slice(first, end), known);
  const found = [];
  for (let place = first - (first % step) + step - 1; place < end; place += step) found.push(known(values[place]));
  return found;
}

const known = (value) => (Number.isNaN(value) ? null : value);

/** Where an angle goes on at the other end of its circle no line crosses the plot. */
function breakTurns(values) {
  for (let place = values.length - 1; place > 0; place -= 1) {
    if (values[place] !== null && Math.abs(values[place] - values[place - 1]) > 180
        && values[place - 1] !== null) values[place] = null;
  }
}
