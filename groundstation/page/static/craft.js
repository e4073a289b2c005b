// The craft in space, drawn by projecting lines: attitude, motors, and where it is if that is known.
// Body axes forward, left, up; roll left side up, pitch nose down, yaw counter-clockwise positive.

const FPS = 30;
const BLADE_TURNS_S = 3; // of a drawn rotor at full duty: a real one would only flicker
const ARM = 0.5, RING = 20; // of the drawn craft, in its own size; corners of a rotor's circle
const X_LAYOUT = [[1, -1], [-1, -1], [-1, 1], [1, 1]]; // M1 front right, then clockwise
const PLUS_LAYOUT = [[1, 0], [0, -1], [-1, 0], [0, 1]]; // M1 in front
const RADIANS = Math.PI / 180;

export class CraftView {
  /** look: what is to be drawn now {roll, pitch, yaw (deg or null), motors (% or null), position
   * ([x, y, z] in m, each may be null), plus}, or null. */
  constructor(canvas, look) {
    Object.assign(this, { canvas, look, azimuth: 215, elevation: 22, blades: [0, 0, 0, 0] });
    this.beforeMs = 0;
    new ResizeObserver(() => { [this.width, this.height] = [canvas.clientWidth, canvas.clientHeight]; })
      .observe(canvas);
    let grip = null;
    canvas.addEventListener("pointerdown", (event) => {
      grip = [event.clientX, event.clientY, this.azimuth, this.elevation];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (grip) this.#turn(grip[2] - 0.5 * (event.clientX - grip[0]), grip[3] + 0.5 * (event.clientY - grip[1]));
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { grip = null; });
    canvas.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [10, 0], ArrowRight: [-10, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] }[event.key];
      if (!by) return;
      event.preventDefault();
      this.#turn(this.azimuth + by[0], this.elevation + by[1]);
    });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { this.colors = null; });
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.frames = 0;
    requestAnimationFrame((ms) => this.#frame(ms));
  }

  #turn(azimuth, elevation) {
    this.azimuth = azimuth;
    this.elevation = Math.max(5, Math.min(85, elevation));
  }

  #frame(ms) {
    // hidden pages draw nothing
    requestAnimationFrame((next) => this.#frame(next));
    if (ms - this.beforeMs < 1000 / FPS - 4 || !this.width) return;
    const since = Math.min(0.1, (ms - this.beforeMs) / 1000);
    this.beforeMs = ms;
    this.frames += 1;
    this.#draw(this.look(), since);
  }

  #draw(state, sinceS) {
    const { canvas, width, height } = this;
    const scale = Math.min(2, window.devicePixelRatio);
    if (canvas.width !== Math.round(width * scale)) canvas.width = Math.round(width * scale);
    if (canvas.height !== Math.round(height * scale)) canvas.height = Math.round(height * scale);
    const value = (name) => getComputedStyle(canvas).getPropertyValue(`--${name}`).trim();
    this.colors ??= Object.fromEntries(["ink", "soft", "grid", "c0", "c1", "c2", "sky", "card", "line", "shade"]
      .map((name) => [name, value(name)]));
    const pen = this.pen = canvas.getContext("2d");
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.lineJoin = pen.lineCap = "round";
    const known = state && state.roll !== null && state.pitch !== null;
    const [x, y, z] = state?.position ?? [null, null, null];
    const up = z ?? 0.6;
    this.#camera(up);
    this.#ground(x ?? 0, y ?? 0);
    if (!known) {
      pen.fillStyle = this.colors.soft;
      pen.font = "14px system-ui, sans-serif";
      pen.textAlign = "center";
      pen.fillText("no attitude yet", width / 2, height / 2);
      return;
    }
    if (z > 0.2) this.#height(z); // lower, it would be written over the craft
    this.#craft(state, up, sinceS);
  }

  /** Turned about what is drawn; seen from a fixed distance. */
  #camera(up) {
    const a = this.azimuth * RADIANS, e = this.elevation * RADIANS;
    this.size = Math.min(this.width, 1.35 * this.height) * 1.35;
    Object.assign(this, { up, ca: Math.cos(a), sa: Math.sin(a), ce: Math.cos(e), se: Math.sin(e) });
  }

  /** Pixels of a point, and how far it is away. */
  #at([x, y, z]) {
    const side = -x * this.sa + y * this.ca, away = x * this.ca + y * this.sa, high = z - this.up * 0.8 - 0.15;
    const depth = 2.6 - (away * this.ce + high * this.se);
    const rise = high * this.ce - away * this.se;
    const f = this.size / Math.max(0.4, depth);
    return [this.width / 2 + f * side, this.height * 0.5 - f * rise, depth];
  }

  #path(points, close) {
    this.pen.beginPath();
    for (const point of points) this.pen.lineTo(...this.#at(point).slice(0, 2));
    if (close) this.pen.closePath();
  }

  /** Squares of half a metre that go by as the craft moves; an arrow to where x grows. */
  #ground(x, y) {
    const { pen, colors } = this;
    const shift = [x, y].map((one) => -(((one % 0.5) + 0.5) % 0.5));
    pen.lineWidth = 1;
    pen.strokeStyle = colors.line;
    pen.beginPath();
    for (let line = -2; line <= 2.001; line += 0.5) {
      for (const [from, to] of [[[line + shift[0], -2, 0], [line + shift[0], 2, 0]],
        [[-2, line + shift[1], 0], [2, line + shift[1], 0]]]) {
        pen.moveTo(...this.#at(from).slice(0, 2));
        pen.lineTo(...this.#at(to).slice(0, 2));
      }
    }
    pen.stroke();
    pen.strokeStyle = pen.fillStyle = colors.soft;
    this.#path([[0, 0, 0], [1.2, 0, 0]]);
    pen.stroke();
    this.#path([[1.3, 0, 0], [1.15, 0.06, 0], [1.15, -0.06, 0]], true);
    pen.fill();
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "left";
    const [px, py] = this.#at([1.38, 0, 0]);
    pen.fillText("x, yaw 0", px, py);
  }

  #height(z) {
    const { pen, colors } = this;
    pen.strokeStyle = colors.soft;
    pen.setLineDash([4, 4]);
    this.#path([[0, 0, 0], [0, 0, z]]);
    pen.stroke();
    pen.setLineDash([]);
    const [px, py] = this.#at([0, 0, z / 2]);
    pen.fillStyle = colors.ink;
    pen.textAlign = "left";
    pen.fillText(`${z.toFixed(2)} m`, px + 8, py);
  }

  #craft({ roll, pitch, yaw, motors, plus }, up, sinceS) {
    const { pen, colors } = this;
    const turn = rotation(roll * RADIANS, pitch * RADIANS, (yaw ?? 0) * RADIANS);
    const body = ([x, y, z]) => turn(x, y, z).map((one, axis) => one + (axis === 2 ? up : 0));
    const arms = (plus ? PLUS_LAYOUT : X_LAYOUT).map(([x, y]) => {
      const length = Math.hypot(x, y);
      return [ARM * x / length, ARM * y / length, 0];
    });
    // its shadow
    pen.fillStyle = colors.shade;
    pen.globalAlpha = 0.25;
    for (const arm of arms) {
      this.#path(circle(arm, 0.24).map((p) => { const [sx, sy] = body(p); return [sx, sy, 0]; }), true);
      pen.fill();
    }
    pen.globalAlpha = 1;
    const rotors = arms.map((arm, number) => ({ arm, number, depth: this.#at(body(arm))[2] }))
      .sort((a, b) => b.depth - a.depth);
    const middle = this.#at(body([0, 0, 0]))[2];
    let drawn = false;
    for (const { arm, number, depth } of rotors) {
      if (depth < middle && !drawn) {
        this.#hull(body);
        drawn = true;
      }
      this.#rotor(body, arm, number, motors?.[number] ?? null, sinceS);
    }
    if (!drawn) this.#hull(body);
    if (motors) arms.forEach((arm, number) => this.#duty(body, arm, number, motors[number]));
  }

  #rotor(body, arm, number, duty, sinceS) {
    const { pen, colors } = this;
    const top = [arm[0], arm[1], 0.07];
    pen.strokeStyle = colors.ink;
    pen.lineWidth = 5;
    this.#path([[0, 0, 0], arm].map(body));
    pen.stroke();
    pen.lineWidth = 3;
    this.#path([arm, top].map(body));
    pen.stroke();
    const share = Math.max(0, Math.min(1, (duty ?? 0) / 100));
    const ring = circle(top, 0.24).map(body);
    const front = arm[0] > 0.1;
    pen.fillStyle = front ? colors.c1 : colors.c0;
    pen.globalAlpha = 0.12 + 0.5 * share;
    this.#path(ring, true);
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = pen.fillStyle;
    pen.lineWidth = 1.5;
    this.#path(ring, true);
    pen.stroke();
    if (!this.still.matches) this.blades[number] += sinceS * share * BLADE_TURNS_S * 2 * Math.PI * (number % 2 ? -1 : 1);
    const [c, s] = [Math.cos(this.blades[number]), Math.sin(this.blades[number])].map((one) => 0.22 * one);
    pen.strokeStyle = colors.ink;
    pen.lineWidth = 2;
    this.#path([[top[0] - c, top[1] - s, top[2]], [top[0] + c, top[1] + s, top[2]]].map(body));
    pen.stroke();
  }

  /** A motor's duty, as an upright bar on the rotor's axis and in a number, before all else. */
  #duty(body, [x, y], number, duty) {
    const { pen, colors } = this, high = 0.07 + 0.45 * Math.max(0, Math.min(1, duty / 100));
    pen.strokeStyle = colors.c2;
    pen.lineWidth = 4;
    this.#path([[x, y, 0.07], [x, y, high]].map(body));
    if (duty > 1) pen.stroke();
    const [px, py] = this.#at(body([x, y, high + 0.1]));
    pen.fillStyle = colors.ink;
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    const text = `M${number + 1} ${duty.toFixed(0)} %`;
    pen.strokeStyle = colors.card; // readable where it lies on the craft
    pen.strokeText(text, px, py);
    pen.fillText(text, px, py);
  }

  #hull(body) {
    const { pen, colors } = this;
    const side = 0.13;
    this.#path([[side, side, 0.03], [side, -side, 0.03], [-side, -side, 0.03], [-side, side, 0.03]].map(body), true);
    pen.fillStyle = colors.ink;
    pen.fill();
    // its nose
    this.#path([[side + 0.17, 0, 0.03], [side, 0.09, 0.03], [side, -0.09, 0.03]].map(body), true);
    pen.fillStyle = colors.c1;
    pen.fill();
  }
}

function circle([x, y, z], radius) {
  return Array.from({ length: RING }, (_, corner) => {
    const angle = 2 * Math.PI * corner / RING;
    return [x + radius * Math.cos(angle), y + radius * Math.sin(angle), z];
  });
}

/** Body to world: about x, then y, then z. */
function rotation(roll, pitch, yaw) {
  const [cr, sr, cp, sp, cy, sy] = [roll, pitch, yaw].flatMap((one) => [Math.cos(one), Math.sin(one)]);
  return (x, y, z) => {
    const [y1, z1] = [cr * y - sr * z, sr * y + cr * z];
    const [x2, z2] = [cp * x + sp * z1, -sp * x + cp * z1];
    return [cy * x2 - sy * y1, sy * x2 + cy * y1, z2];
  };
}
