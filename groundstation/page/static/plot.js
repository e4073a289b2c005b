// Lines over the last seconds on a canvas, in the colours of the theme.

const SHOWN_MS = 20000;
const GAP_MS = 500; // rows further apart are not joined
const LEFT = 46;
const STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000];

export class Plot {
  /** field: of the rows, an array of numbers; names: one for each of its numbers. */
  constructor(canvas, legend, field, names) {
    this.canvas = canvas;
    this.field = field;
    this.rows = [];
    this.values = names.map((name, place) => {
      const item = document.createElement("span");
      item.className = `s${place}`;
      legend.append(item);
      return { name, item };
    });
  }

  /** nowMs: to which the ages of the rows refer. */
  add(rows, nowMs) {
    for (const row of rows) {
      if (row[this.field]) this.rows.push([nowMs - 1000 * row.age_s, row[this.field]]);
    }
    while (this.rows.length && this.rows[0][0] < nowMs - SHOWN_MS) this.rows.shift();
  }

  draw(nowMs) {
    const { canvas, rows } = this;
    const scale = window.devicePixelRatio;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) return; // another part of the page is looked at
    if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
      canvas.width = Math.round(width * scale);
      canvas.height = Math.round(height * scale);
    }
    const style = getComputedStyle(canvas);
    const pen = canvas.getContext("2d");
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, width, height);
    const newest = rows[rows.length - 1]?.[1];
    this.values.forEach(({ name, item }, place) => {
      const value = newest?.[place];
      item.textContent = `${name} ${value === undefined || value === null ? "–" : value.toFixed(1)}`;
    });
    const { low, high, step } = this.range();
    const x = (ms) => LEFT + (width - LEFT) * (1 - (nowMs - ms) / SHOWN_MS);
    const y = (value) => 6 + (height - 12) * (high - value) / (high - low);
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = style.getPropertyValue("--soft");
    pen.strokeStyle = style.getPropertyValue("--grid");
    pen.lineWidth = 1;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.beginPath();
    for (let mark = low; mark <= high + step / 2; mark += step) {
      pen.moveTo(LEFT, y(mark));
      pen.lineTo(width, y(mark));
      pen.fillText(mark.toFixed(0), LEFT - 6, y(mark));
    }
    pen.stroke();
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, 0, width - LEFT, height);
    pen.clip();
    pen.lineWidth = 1.6;
    for (let place = 0; place < this.values.length; place += 1) {
      pen.strokeStyle = style.getPropertyValue(`--c${place}`);
      pen.beginPath();
      let before = null;
      for (const [ms, values] of rows) {
        const value = values[place];
        if (value === null || value === undefined) { before = null; continue; }
        if (before === null || ms - before > GAP_MS) pen.moveTo(x(ms), y(value));
        else pen.lineTo(x(ms), y(value));
        before = ms;
      }
      pen.stroke();
    }
    pen.restore();
  }

  range() {
    let low = Infinity, high = -Infinity;
    for (const [, values] of this.rows) {
      for (const value of values) {
        if (value === null) continue;
        low = Math.min(low, value);
        high = Math.max(high, value);
      }
    }
    if (low > high) [low, high] = [0, 1];
    const span = Math.max(high - low, 1);
    const step = STEPS.find((one) => span / one <= 4) ?? span;
    return { low: Math.floor(low / step) * step, high: Math.ceil((high + 1e-6) / step) * step, step };
  }
}
