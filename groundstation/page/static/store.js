// Series by table: what a craft sends, or what a file holds; times in s, ever later.

const GAP_S = 0.5; // rows further apart are not joined, nor those five usual steps apart
const GROUPS = [ // as they are offered; what is not here stands under the name before its dot
  ["attitude", "Attitude", "°"], ["gyro", "Rates", "°/s"], ["motors", "Motors", "%"],
  ["accelerometer", "Specific force", "m/s²"], ["rotors", "Rotor speeds", "rev/s"],
  ["battery", "Battery", "V"],
];

export class Store {
  /** keepS: older rows are forgotten. */
  constructor(keepS = Infinity) {
    this.keepS = keepS;
    this.tables = new Map();
    this.version = 0; // counts changes of the channels
  }

  /** tables: by name {columns: [...], rows: [[time, value or null, ...], ...]}. */
  add(tables) {
    for (const [name, { columns, rows }] of Object.entries(tables)) {
      let table = this.tables.get(name);
      if (!table || table.columns.join() !== columns.join()) {
        table = { columns, times: [], values: columns.map(() => []), stepS: GAP_S / 5 };
        this.tables.set(name, table);
        this.version += 1;
      }
      for (const row of rows) this.#put(table, row);
      this.#forget(table);
    }
  }

  /** The same from whole arrays: {columns, times, values: [array, ...]}. */
  set(tables) {
    this.tables = new Map(Object.entries(tables));
    this.version += 1;
  }

  #put(table, [time, ...values]) {
    const { times } = table;
    const before = times[times.length - 1];
    if (time <= before) {
      if (before - time < 1) return;
      times.length = 0; // another clock
      for (const column of table.values) column.length = 0;
    }
    const stepS = time - before;
    if (stepS > Math.max(GAP_S, 5 * table.stepS)) {
      times.push(before + stepS / 2);
      for (const column of table.values) column.push(null);
    } else if (stepS) table.stepS += 0.05 * (stepS - table.stepS);
    times.push(time);
    values.forEach((value, place) => table.values[place].push(value));
  }

  #forget(table) {
    const { times } = table;
    const since = times[times.length - 1] - this.keepS;
    if (!(times[0] < since - 0.2 * this.keepS)) return;
    const first = firstFrom(times, since);
    times.splice(0, first);
    for (const column of table.values) column.splice(0, first);
  }

  /** Everything there is: [{id, table, place, name, group, unit, wraps}]. */
  channels() {
    const found = [];
    for (const [table, { columns }] of this.tables) {
      columns.forEach((id, place) => {
        const dot = id.indexOf(".");
        const prefix = dot < 0 ? table : id.slice(0, dot), name = dot < 0 ? id : id.slice(dot + 1);
        const known = table === "telemetry" && GROUPS.find(([one]) => one === prefix);
        const wraps = /(^|[._])(roll|yaw)$/.test(id);
        found.push({ id, table, place, name, group: known ? known[1] : prefix,
          unit: known ? known[2] : "", wraps });
      });
    }
    return found;
  }

  newest(table = "telemetry") {
    return this.tables.get(table)?.times.at(-1) ?? null;
  }

  oldest(table = "telemetry") {
    return this.tables.get(table)?.times[0] ?? null;
  }

  /** A channel's value at a time, between its neighbours; null where there is none near. */
  at(table, id, time) {
    const found = this.tables.get(table);
    const place = found ? found.columns.indexOf(id) : -1;
    if (place < 0 || !found.times.length) return null;
    const next = firstFrom(found.times, time), { times } = found, values = found.values[place];
    if (next === 0 || next === times.length) {
      const edge = next === 0 ? 0 : times.length - 1;
      return Math.abs(times[edge] - time) < 2 * GAP_S ? values[edge] : null;
    }
    const [a, b] = [values[next - 1], values[next]];
    if (a === null || b === null) return a ?? b;
    const share = (time - times[next - 1]) / (times[next] - times[next - 1]);
    return a + (Math.abs(b - a) > 180 ? (share > 0.5 ? b - a : 0) : share * (b - a));
  }
}

/** The first place of ``times`` that is no earlier than ``time``. */
export function firstFrom(times, time) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1;
    else high = middle;
  }
  return low;
}
