"use strict";
(() => {
  const root = document.documentElement;
  const theme = document.getElementById("theme");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme || (dark.matches ? "dark" : "light")) === "dark";
  const name = () => { theme.textContent = isDark() ? "Light" : "Dark"; };
  theme.hidden = false;
  theme.addEventListener("click", () => { root.dataset.theme = isDark() ? "light" : "dark"; name(); });
  dark.addEventListener("change", name);
  name();

  const place = document.getElementById("parameter-table");
  if (!place) return;
  const body = place.querySelector("tbody");
  const rows = [...body.rows];
  const heads = [...place.querySelectorAll("thead th")];

  // Numbers of one unit stand together, by size; what is missing comes last.
  const unit = heads.findIndex((head) => head.textContent === "unit");
  const key = (row, column) => {
    const cell = row.cells[column];
    if ("value" in cell.dataset) {
      return { unit: row.cells[unit].textContent, size: Math.abs(Number(cell.dataset.value)) };
    }
    return { text: cell.textContent, missing: ["", "-"].includes(cell.textContent) };
  };
  const words = (a, b) => a.localeCompare(b, "en", { numeric: true });
  const compare = (a, b, sign) => {
    if (Boolean(a.missing) !== Boolean(b.missing)) return a.missing ? 1 : -1;
    if (a.missing) return 0;
    if (a.text !== undefined) return sign * words(a.text, b.text);
    return words(a.unit, b.unit) || sign * (a.size - b.size);
  };
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
      const keyed = rows.map((row) => [key(row, column), row]);
      keyed.sort(([a], [b]) => compare(a, b, sign));
      body.append(...keyed.map(([, row]) => row));
    });
  });

  const filter = document.getElementById("filter");
  const status = document.getElementById("status");
  const count = document.getElementById("count");
  const column = heads.findIndex((head) => head.textContent === "status");
  const show = () => {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const row of rows) {
      const text = row.cells[0].textContent.toLowerCase();
      const fits = words.every((word) => text.includes(word));
      row.hidden = !fits || (status.value !== "" && row.cells[column].textContent !== status.value);
      shown += row.hidden ? 0 : 1;
    }
    count.textContent = `${shown} of ${rows.length}`;
  };
  filter.addEventListener("input", show);
  status.addEventListener("change", show);
  place.parentElement.querySelector(".tools").hidden = false;
  show();
})();
