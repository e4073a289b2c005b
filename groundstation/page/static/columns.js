// The form that asks which column of a file is which channel, with what the program guesses.

import { at, cell, element, write } from "./dom.js";

const CHOICES_MOST = 80; // columns that a menu lists; more are named by typing

/** name: of the file; form: the server's; use: given the answers. */
export function askColumns(name, why, form, use) {
  write("columns-title", `Columns of ${name}`);
  write("columns-why", [why, ...form.notes].join(" "));
  at("columns-names").replaceChildren(...form.columns.map(({ reference, text }) => new Option(text, reference)));
  const rows = form.channels.map((one) => row(one, form.columns));
  at("columns-rows").replaceChildren(...rows.map((one) => one.shown));
  at("columns-step").value = "";
  at("columns-form").onsubmit = (event) => {
    event.preventDefault();
    const chosen = rows.map((one) => one.chosen()).filter(Boolean);
    const step = Number(at("columns-step").value);
    if (!chosen.some(({ key }) => key === "time")) {
      if (!(step > 0)) return wrong("Choose the time's column, or give the seconds between rows.");
      chosen.unshift({ key: "time", column: 0, unit: "", step_s: step });
    }
    const missing = chosen.find(({ column }) => column === undefined);
    if (missing) return wrong(`${missing.key}: the file has no such column.`);
    wrong("");
    return use(chosen);
  };
  at("columns-form").oninput = () => wrong("");
  wrong("");
  at("examples-part").open = false;
  at("columns").hidden = false;
  at("columns-title").focus();
}

export function closeColumns() {
  at("columns").hidden = true;
}

/** A link that saves the text of a column map. */
export function saved(name, text) {
  const link = element("a", "", `Save the column map ${name}`);
  link.href = `data:application/toml;charset=utf-8,${encodeURIComponent(text)}`;
  link.download = name;
  return link;
}

export const wrong = (text) => write("columns-wrong", text);

function row(channel, columns) {
  const shown = element("tr"), column = chooser(channel, columns);
  const unit = element("select"), sign = element("select");
  unit.append(...channel.units.map((one) => new Option(one, one)));
  unit.value = channel.unit || channel.units[0];
  sign.append(new Option("as ours", "1"), new Option("opposite", "-1"));
  sign.value = String(channel.sign);
  for (const [one, what] of [[column, "column"], [unit, "unit"], [sign, "direction"]]) {
    one.setAttribute("aria-label", `${channel.label}: ${what}`);
  }
  const heading = element("th", "", channel.label);
  heading.scope = "row";
  shown.append(heading, ...[column, unit, channel.signed ? sign : "", channel.why].map(cell));
  const told = () => {
    unit.disabled = sign.disabled = column.value === "";
    shown.lastChild.textContent = column.value === first ? channel.why : "";
  };
  const first = column.value;
  column.addEventListener("change", told);
  told();
  return { shown, chosen: () => column.value && {
    key: channel.key, column: referenceOf(columns, column.value), unit: unit.value, sign: Number(sign.value) } };
}

function chooser(channel, columns) {
  const many = columns.length > CHOICES_MOST, made = element(many ? "input" : "select");
  if (many) {
    made.setAttribute("list", "columns-names");
    made.placeholder = "none";
  } else {
    made.append(new Option("none", ""), ...columns.map(({ reference, text }) => new Option(text, reference)));
  }
  made.value = channel.column ?? "";
  return made;
}

/** A name, or a number where the column's name is not its own. */
const referenceOf = (columns, value) => columns.find(({ reference }) => String(reference) === value)?.reference;
